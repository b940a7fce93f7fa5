"""Work-precision diagrams: run time against error for schemes and other programs."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from timeit import timeit
from typing import Any

import numpy as np

from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import StorageError, SymsimpsonError, reject
from symsimpson.program.configuration import versions_of
from symsimpson.program.input_values import read_array, read_count, read_number
from symsimpson.program.numbers import FLOAT64
from symsimpson.schemes.scheme import Scheme
from symsimpson.study.bench.contenders import (
    BenchmarkProblem,
    Contender,
    Runnable,
    make_peer_contenders,
    make_problem,
    make_scheme_contender,
    read_peers,
)
from symsimpson.support.calling import explain_arguments
from symsimpson.support.files import write_text
from symsimpson.support.names import as_tuple
from symsimpson.support.progress import announce

#: Version of the file format.
FORMAT = 1
#: Shorter runs are repeated until a timing takes this long, in seconds.
LEAST_SECONDS = 1e-3
#: A run that takes longer than this, in seconds, counts as slow.
MOST_SECONDS = 2.0
#: More slow runs than MOST_SLOW end the sequence. Without a useful run, LEAP choices are skipped
#: after each slow run.
MOST_SLOW, LEAP = 3, 3
#: A run of at least LONG_SECONDS is not repeated to warm up. It is if it takes MUCH_LONGER times as
#: long as the run before, as it may include compilation. After a long run, every second number of
#: steps is skipped.
LONG_SECONDS, MUCH_LONGER = 0.1, 4.0
#: A run with this total time, in seconds, is not timed again.
ENOUGH_SECONDS = 0.5
#: A run over this fraction of the duration measures the overhead of a call.
CALL_FRACTION = 1e-6
#: Smaller errors are round-off errors, and end the sequence.
FLOOR = 3e-14


@dataclass(frozen=True)
class Measurement:
    """The run time and the error of one contender for one choice of steps or tolerance.

    Attributes
    ----------
    name : str
        The name of the contender.
    what : str
        The kind of choice: "steps" or "tolerance".
    choice : float
        The number of steps, or the tolerance.
    error : float
        The largest relative error of the final state.
    best, median : float
        The shortest and the median run time of all rounds, in seconds.
    evaluations : int
        The number of Newton iterations, evaluations of the right-hand side, or Taylor steps.
    """

    name: str
    what: str
    choice: float
    error: float
    best: float
    median: float
    evaluations: int


@dataclass(frozen=True, repr=False)
class WorkPrecision:
    """Run time against error of several contenders on one problem.

    Attributes
    ----------
    system : str
        The name of the system.
    t_end : float
        The final time.
    q0, p0 : tuple of float
        The initial coordinates and momenta.
    solution_error : float
        The estimated error of the reference solution.
    levels : tuple of float
        The error levels of the table.
    points : tuple of Measurement
        The measurements of all contenders and choices.
    compile_seconds : mapping from str to float
        The time to the first result of each contender, in seconds. It includes compilation.
    machine : mapping
        The processor, the number of cores, the load, and versions of software.
    call_seconds : mapping from str to float
        The median time of a run over a very short duration, in seconds, for each contender. It
        measures the overhead of a call.

    Examples
    --------
    >>> import symsimpson as ss
    >>> record = ss.work_precision(ss.systems.pendulum(), "midpoint", peers=(), errors=0.01,
    ...                            t_end=0.5, repeats=1)
    >>> record.names, record.levels
    (('midpoint',), (0.01,))
    """

    system: str
    t_end: float
    q0: tuple[float, ...]
    p0: tuple[float, ...]
    solution_error: float
    levels: tuple[float, ...]
    points: tuple[Measurement, ...]
    compile_seconds: Mapping[str, float]
    machine: Mapping[str, Any]
    call_seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the contenders, in the order of their runs."""
        return tuple(dict.fromkeys(point.name for point in self.points))

    def fastest(self, name: str, error: float) -> Measurement | None:
        """Return the fastest measurement of a contender with at most this error; or None.

        Parameters
        ----------
        name : str
            The name of the contender.
        error : float
            The largest error.

        Returns
        -------
        Measurement or None
            The measurement with the smallest median run time; None if none is accurate enough.
        """
        good = [p for p in self.points if p.name == name and p.error <= error]
        return min(good, key=lambda point: point.median) if good else None

    def plot(self, *, ax: Any = None) -> Any:
        """Draw the median run time against the error.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The axes to draw in. The default is a new figure.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, with logarithmic scales.

        Raises
        ------
        InputError
            If matplotlib is not installed.
        """
        from symsimpson.plotting.run_figures import plot_work_precision

        return plot_work_precision(self, ax=ax)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Save the record to a JSON file.

        Parameters
        ----------
        path : str or path-like
            The name of the file.

        Returns
        -------
        pathlib.Path
            The path of the file.

        Raises
        ------
        StorageError
            If the file cannot be written.
        """
        text = json.dumps({"format": FORMAT} | asdict(self), indent=1) + "\n"
        return write_text(path, text, "record")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> WorkPrecision:
        """Read a record from a file that ``save`` wrote.

        Parameters
        ----------
        path : str or path-like
            The name of the file.

        Returns
        -------
        WorkPrecision
            The record.

        Raises
        ------
        StorageError
            If the file cannot be read, or is not a record.
        """
        try:
            content: dict[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
            if content.pop("format") != FORMAT:
                raise ValueError("another format")
            points = tuple(Measurement(**point) for point in content.pop("points"))
            content |= {name: tuple(content[name]) for name in ("q0", "p0", "levels")}
            return cls(points=points, **content)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            if isinstance(error, OSError):
                what = f"the record cannot be read: {error.strerror}."
            else:
                what = f"the file is not a record of run times: {type(error).__name__}: {error}."
            remedy = "Write one with symsimpson bench SYSTEM --out FILE."
            reject(what, os.fspath(path), "", remedy, error=StorageError, cause=error)

    def compare(self, before: WorkPrecision) -> str:
        """Return a table with the ratios of run times to the run times of an earlier record.

        Parameters
        ----------
        before : WorkPrecision
            The earlier record of the same problem.

        Returns
        -------
        str
            One line for each contender, with one ratio for each error level. Ratios below 1 are
            faster.

        Raises
        ------
        InputError
            If the records have different problems or initial states.
        """
        same = ("system", "t_end", "q0", "p0")
        if any(getattr(self, name) != getattr(before, name) for name in same):
            reject(
                f"the records have different problems: {before.system} to t = {before.t_end:g}, "
                f"and {self.system} to t = {self.t_end:g}, or different initial states.",
                remedy="Compare records of the same problem.",
            )
        lines = [f"run time now, in units of that before ({before.machine.get('processor')})"]
        for name in self.names:
            cells = []
            for level in self.levels:
                now, then = self.fastest(name, level), before.fastest(name, level)
                cells.append(f"{now.median / then.median:>12.2f}" if now and then else f"{'-':>12}")
            lines.append(f"{name:<26}{''.join(cells)}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        machine = self.machine
        lines = [
            f"{self.system} to t = {self.t_end:g}: median run time at an error of the end state",
            f"  {machine.get('processor')}, load {machine.get('load')}; "
            f"errors against a solution known to {self.solution_error:.0e}",
            f"{'':<26}" + "".join(f"{level:>12.0e}" for level in self.levels) + f"{'a call':>12}",
        ]
        for name in self.names:
            points = [self.fastest(name, level) for level in self.levels]
            seconds = [p.median if p else None for p in points] + [self.call_seconds.get(name)]
            lines.append(f"{name:<26}" + "".join(f"{_format_seconds(s):>12}" for s in seconds))
        return "\n".join(lines)


def _format_seconds(seconds: float | None) -> str:
    if not seconds:
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


@dataclass
class _TimedRun:
    name: str
    what: str
    choice: float
    run: Any
    error: float
    evaluations: int
    number: int
    times: list[float]


@announce("measuring run time against error")
@explain_arguments()
def work_precision(
    system: MechanicalSystem,
    schemes: str | Scheme | Sequence[str | Scheme] = ("midpoint", "simpson"),
    peers: str | Sequence[str] = "installed",
    errors: float | Sequence[float] = (1e-3, 1e-6, 1e-9, 1e-12),
    *,
    state: Mapping[str, Any] | None = None,
    t_end: float = 10.0,
    repeats: int = 5,
) -> WorkPrecision:
    """Measure the run time of schemes and other programs against the error of the final state.

    Each contender runs with step sizes or tolerances from coarse to fine. All runs alternate in
    one process. Compile time is measured separately. Errors are differences from a reference
    solution with 20 digits, whose error is estimated, too.

    Parameters
    ----------
    system : MechanicalSystem
        The system, without constraints. With a time transformation, schemes run with and without
        it, and other programs run in physical time.
    schemes : str, Scheme or sequence of them
        The schemes to measure. The default is ``("midpoint", "simpson")``.
    peers : "installed" or sequence of str
        The other programs: "runge-kutta" (compiled RK4 and DOP853), "scipy", "heyoka",
        "numbalsoda" or "diffrax". The default is all that are installed. Pass () for none.
    errors : float or sequence of float
        The error levels of the table, between 1e-14 and 1. The default is (1e-3, 1e-6, 1e-9,
        1e-12).
    state : mapping, optional
        The initial state: q0, and v0 or p0. The default is the system's reference state.
    t_end : float
        The final time. The default is 10.
    repeats : int
        The number of rounds of timings. The default is 5.

    Returns
    -------
    WorkPrecision
        The record of all measurements. It prints as a table, plots a diagram, and can be saved.

    Raises
    ------
    InputError
        If an argument is invalid, or if a named program is not installed.

    Examples
    --------
    >>> import symsimpson as ss
    >>> found = ss.work_precision(ss.systems.pendulum(), ["simpson"], peers=(), errors=[1e-6],
    ...                           t_end=2.0, repeats=1)
    >>> found.fastest("simpson", 1e-6).error <= 1e-6
    True
    """
    errors = _read_levels(errors)
    read_count("repeats", repeats, 1)
    if not read_number("t_end", t_end, FLOAT64) > 0:
        reject(f"t_end is {t_end!r}, which is not positive.", remedy="Pass a positive number.")
    read_peers(peers)  # raise errors before the measurements
    schemes = as_tuple(schemes)
    problem = make_problem(system, state, t_end)
    entries, seconds, calls = [], {}, []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # programs warn of tolerances that they cannot reach
        for contender in _contenders(problem, schemes, peers):
            begin = time.perf_counter()
            _run_choice(contender, contender.choices[0], problem)
            seconds[contender.name] = time.perf_counter() - begin
            entries += _run_choices(contender, problem, min(errors))
        brief = replace(problem, t_end=CALL_FRACTION * problem.t_end)
        for contender in _contenders(brief, schemes, peers):
            coarsest = 1.0 if contender.what == "steps" else contender.choices[0]
            for _ in range(2):  # the second run is warm
                call = _run_choice(contender, coarsest, brief)
            calls += [] if call is None else [call]
        for turn in range(repeats):
            for entry in (*entries, *calls):
                if turn == 0 and sum(entry.times) < ENOUGH_SECONDS:
                    entry.times.clear()  # discard the time of the first sequence
                if sum(entry.times) < ENOUGH_SECONDS:
                    entry.times.append(timeit(entry.run, number=entry.number) / entry.number)
    points = [
        Measurement(e.name, e.what, e.choice, e.error, min(e.times), median(e.times), e.evaluations)
        for e in entries
    ]
    return WorkPrecision(
        system.name,
        problem.t_end,
        tuple(problem.q0.tolist()),
        tuple(problem.p0.tolist()),
        problem.solution_error,
        errors,
        tuple(points),
        seconds,
        _describe_machine(),
        {e.name: median(e.times) for e in calls},
    )


def _read_levels(errors: Any) -> tuple[float, ...]:
    """Return error levels; a single number is one level. Raises InputError."""
    levels = np.atleast_1d(read_array("errors", errors, FLOAT64))
    if levels.ndim > 1 or not levels.size or not ((levels >= 1e-14) & (levels <= 1)).all():
        remedy = "Pass levels between 1e-14 and 1, for example [1e-6]."
        reject(f"errors are {errors!r}, which are not valid levels.", remedy=remedy)
    return tuple(levels.tolist())


def _contenders(
    problem: BenchmarkProblem, schemes: Sequence[str | Scheme], names: str | Sequence[str]
) -> Iterable[Contender[Runnable]]:
    for scheme in schemes:
        yield make_scheme_contender(problem, scheme)
        if problem.retimed is not None:
            yield make_scheme_contender(problem, scheme, problem.retimed)
    yield from make_peer_contenders(problem, names)


def _run_choice(
    contender: Contender[Runnable], choice: float, problem: BenchmarkProblem, before: float = 0.0
) -> _TimedRun | None:
    """Run a choice, twice if that is short, and return its timing; None if it raised an error.

    ``before`` has the seconds of the coarser choice.
    """
    run, read = contender.make(choice)
    try:
        spent = 0.0
        for _ in range(2):
            if spent < LONG_SECONDS or spent > MUCH_LONGER * before:
                begin = time.perf_counter()
                result = run()
                spent = time.perf_counter() - begin
    except KeyboardInterrupt:
        raise
    except (SymsimpsonError, ArithmeticError, ValueError):
        return None
    outcome = read(result)
    error = problem.error(outcome.q, outcome.p)
    number = max(1, int(LEAST_SECONDS / max(spent, 1e-9)))
    of = contender.name, contender.what, choice
    return _TimedRun(*of, run, error, outcome.evaluations, number, [spent])


def _run_choices(
    contender: Contender[Runnable], problem: BenchmarkProblem, finest: float
) -> list[_TimedRun]:
    """Run choices from coarse to fine until they reach ``finest``, stagnate or are too slow."""
    entries: list[_TimedRun] = []
    slow, place, before = 0, 0, 0.0
    while place < len(contender.choices):
        entry = _run_choice(contender, contender.choices[place], problem, before)
        place += 1
        if entry is None:
            continue
        before = entry.times[0]
        place += contender.what == "steps" and entry.times[0] > LONG_SECONDS
        if entry.error < 1:
            entries.append(entry)
        best = min((e.error for e in entries), default=1.0)
        if entry.times[0] > MOST_SECONDS:
            slow += 1
            place += 0 if entries else LEAP  # a coarse run may diverge and take long
        if best < max(FLOOR, finest / 4) or (slow and entries) or slow > MOST_SLOW:
            break
        if len(entries) > 12 and best == min(e.error for e in entries[:-8]):
            break
    return entries


def _describe_machine() -> dict[str, Any]:
    """Return the processor, the load and the versions of software."""
    others = ("scipy", "heyoka", "numbalsoda", "diffrax")
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return {
        "processor": _find_processor(),
        "cores": os.cpu_count(),
        "load": round(load, 2),
        "python": platform.python_version(),
        "system": platform.system(),
        "versions": versions_of(("symsimpson", "numba", "numpy", "sympy", *others)),
    }


def _find_processor() -> str:
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if line.startswith("model name"):
                return line.split(":")[1].strip()
    return platform.processor() or platform.machine()
