"""Run time against error: schemes and other programs on one problem, in one process."""

from __future__ import annotations

import gc
import json
import os
import platform
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import StorageError, SymsimpsonError, reject
from symsimpson.program.configuration import versions_of
from symsimpson.program.input_values import read_array, read_count, read_number
from symsimpson.program.numbers import FLOAT64
from symsimpson.schemes.scheme import Scheme
from symsimpson.study.bench.contenders import (
    Contender,
    Problem,
    Runnable,
    make_problem,
    ours,
    peers,
    read_peers,
)
from symsimpson.support.calling import explained
from symsimpson.support.files import write_text
from symsimpson.support.names import in_a_row
from symsimpson.support.progress import waiting

#: Written into files; those of another version are not compared with.
FORMAT = 1
#: A timing takes at least so long, by repetition.
LEAST_SECONDS = 1e-3
#: A choice that takes longer than this once is not made finer.
MOST_SECONDS = 2.0
#: After so many slow choices a sweep ends, and it leaves out so many behind each of them.
MOST_SLOW, LEAP = 3, 3
#: A run that takes this long is not run twice to be warm, unless it takes so many times as long as
#: the one before, which may be the time of a compiler. Every second number of steps behind it is
#: left out.
LONG_SECONDS, MUCH_LONGER = 0.1, 4.0
#: What has been timed for so long is timed no more: noise is short against it.
ENOUGH_SECONDS = 0.5
#: A run over this part of the time measures the cost of a call alone.
CALL_FRACTION = 1e-6
#: Errors are not followed below this: it is rounding.
FLOOR = 3e-14


@dataclass(frozen=True)
class Point:
    """One choice of one contender.

    Attributes
    ----------
    name : str
    what : str
        "steps" or "tolerance".
    choice : float
    error : float
    best, median : float
        Seconds.
    evaluations : int
        Newton iterations, evaluations of the right-hand side, or Taylor steps.
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
    """Run time against error on one problem.

    Attributes
    ----------
    system : str
    t_end : float
    q0, p0 : tuple of float
    solution_error : float
        Estimated error of what errors are taken against.
    levels : tuple of float
    points : tuple of Point
    compile_seconds : mapping from str to float
        Until the first result of a contender, if nothing was compiled before.
    machine : mapping
        Processor, load, versions.
    call_seconds : mapping from str to float
        What a run of a single short step takes: the call itself, most of all.
    """

    system: str
    t_end: float
    q0: tuple[float, ...]
    p0: tuple[float, ...]
    solution_error: float
    levels: tuple[float, ...]
    points: tuple[Point, ...]
    compile_seconds: Mapping[str, float]
    machine: Mapping[str, Any]
    call_seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """The contenders."""
        return tuple(dict.fromkeys(point.name for point in self.points))

    def fastest(self, name: str, error: float) -> Point | None:
        """Return the fastest point of a contender with at most this error; or None."""
        good = [p for p in self.points if p.name == name and p.error <= error]
        return min(good, key=lambda point: point.median) if good else None

    def plot(self, *, ax: Any = None) -> Any:
        """Draw median run time against error; returns the axes. Needs matplotlib."""
        from symsimpson.plotting.run_figures import plot_work_precision

        return plot_work_precision(self, ax=ax)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write all of it to a file in JSON.

        Raises
        ------
        StorageError
            If the file cannot be written.
        """
        text = json.dumps({"format": FORMAT} | asdict(self), indent=1) + "\n"
        return write_text(path, text, "record")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> WorkPrecision:
        """Read a file that ``save`` wrote.

        Raises
        ------
        StorageError
            If it cannot be read, or is something else.
        """
        try:
            content: dict[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
            if content.pop("format") != FORMAT:
                raise ValueError("another format")
            points = tuple(Point(**point) for point in content.pop("points"))
            content |= {name: tuple(content[name]) for name in ("q0", "p0", "levels")}
            return cls(points=points, **content)
        except OSError as error:
            reject(
                f"{os.fspath(path)}: the record cannot be read: {error.strerror}.",
                remedy="Write one with symsimpson bench SYSTEM --out FILE.",
                error=StorageError,
                cause=error,
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            reject(
                f"{os.fspath(path)}: no record of run times: {type(error).__name__}: {error}.",
                remedy="Write one with symsimpson bench SYSTEM --out FILE.",
                error=StorageError,
                cause=error,
            )

    def compare(self, before: WorkPrecision) -> str:
        """Return the ratio of run times now and before, for each contender and level.

        Raises
        ------
        InputError
            If the problems differ.
        """
        same = ("system", "t_end", "q0", "p0")
        if any(getattr(self, name) != getattr(before, name) for name in same):
            reject(
                f"{before.system} to t = {before.t_end:g} and {self.system} to t = {self.t_end:g} "
                "are two problems, or start elsewhere.",
                remedy="Compare records of one problem.",
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
            cells = "".join(f"{_time(p.median):>12}" if p else f"{'-':>12}" for p in points)
            call = self.call_seconds.get(name)
            lines.append(f"{name:<26}{cells}{_time(call) if call else '-':>12}")
        return "\n".join(lines)


def _time(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


@dataclass
class _Entry:
    name: str
    what: str
    choice: float
    run: Any
    error: float
    evaluations: int
    number: int
    times: list[float]


@waiting("measuring run time against error")
@explained()
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
    """Measure run time against the error of the state at the end.

    Every scheme and every peer runs with choices from coarse to fine; all runs alternate in one
    process, warm, compile time apart, best and median of several rounds kept. Errors are taken
    against a solution in 20 digits with its own error estimate.

    Parameters
    ----------
    system : MechanicalSystem
        If it is retimed, schemes run in both times, and other programs in the user's.
    schemes : str, Scheme or sequence of them
    peers : "installed" or sequence of str
        "runge-kutta" (compiled RK4 and DOP853 of our own), "scipy", "heyoka",
        "numbalsoda", "diffrax"; () for none.
    errors : float or sequence of float
        Levels of the table, between 1e-14 and 1.
    state : mapping, optional
        q0, and v0 or p0; the system's reference state if left out.
    t_end : float
    repeats : int
        Rounds.

    Returns
    -------
    WorkPrecision
        Prints as a table; has a figure, and a file in JSON to compare later runs with.

    Raises
    ------
    InputError
        If the input makes no sense, or a peer is not installed.

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
        reject(f"t_end is {t_end!r}.", remedy="Pass a positive number.")
    read_peers(peers)  # before anything is measured
    schemes = in_a_row(schemes)
    problem = make_problem(system, state, t_end)
    entries, seconds, calls = [], {}, []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a peer at a tolerance beyond its means
        for contender in _contenders(problem, schemes, peers):
            begin = time.perf_counter()
            _once(contender, contender.choices[0], problem)
            seconds[contender.name] = time.perf_counter() - begin
            entries += _sweep(contender, problem, min(errors))
        brief = replace(problem, t_end=CALL_FRACTION * problem.t_end)
        for contender in _contenders(brief, schemes, peers):
            coarsest = 1.0 if contender.what == "steps" else contender.choices[0]
            for _ in range(2):  # once more, when nothing is made or loaded any longer
                call = _once(contender, coarsest, brief)
            calls += [] if call is None else [call]
        for turn in range(repeats):
            for entry in (*entries, *calls):
                if turn == 0 and sum(entry.times) < ENOUGH_SECONDS:
                    entry.times.clear()  # that of the sweep
                if sum(entry.times) < ENOUGH_SECONDS:
                    entry.times.append(_timed(entry.run, entry.number))
    points = [
        Point(e.name, e.what, e.choice, e.error, min(e.times), median(e.times), e.evaluations)
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
        _machine(),
        {e.name: median(e.times) for e in calls},
    )


def _read_levels(errors: Any) -> tuple[float, ...]:
    """Read levels of the error, of which there may be one by itself; raises InputError."""
    levels = np.atleast_1d(read_array("errors", errors, FLOAT64))
    if levels.ndim > 1 or not levels.size or not ((levels >= 1e-14) & (levels <= 1)).all():
        reject(f"errors are {errors!r}.", remedy="Pass levels between 1e-14 and 1: [1e-6].")
    return tuple(levels.tolist())


def _contenders(
    problem: Problem, schemes: Sequence[str | Scheme], names: str | Sequence[str]
) -> Iterable[Contender[Runnable]]:
    for scheme in schemes:
        yield ours(problem, scheme)
        if problem.retimed is not None:
            yield ours(problem, scheme, problem.retimed)
    yield from peers(problem, names)


def _once(
    contender: Contender[Runnable], choice: float, problem: Problem, before: float = 0.0
) -> _Entry | None:
    """Run a choice, once more if it was not warm yet; None if it raised an error.

    ``before`` has the seconds that a coarser choice took.
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
    return _Entry(*of, run, error, outcome.evaluations, number, [spent])


def _sweep(contender: Contender[Runnable], problem: Problem, finest: float) -> list[_Entry]:
    """Run choices from coarse to fine until they are accurate enough, stagnate or are too slow."""
    entries: list[_Entry] = []
    slow, place, before = 0, 0, 0.0
    while place < len(contender.choices):
        entry = _once(contender, contender.choices[place], problem, before)
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
            place += 0 if entries else LEAP  # a coarse run may go astray and take long
        if best < max(FLOOR, finest / 4) or (slow and entries) or slow > MOST_SLOW:
            break
        if len(entries) > 12 and best == min(e.error for e in entries[:-8]):
            break
    return entries


def _timed(run: Any, number: int) -> float:
    collecting = gc.isenabled()
    gc.disable()
    try:
        begin = time.perf_counter()
        for _ in range(number):
            run()
        return (time.perf_counter() - begin) / number
    finally:
        if collecting:
            gc.enable()


def _machine() -> dict[str, Any]:
    """Say where it was measured."""
    others = ("scipy", "heyoka", "numbalsoda", "diffrax")
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": round(load, 2),
        "python": platform.python_version(),
        "system": platform.system(),
        "versions": versions_of(("symsimpson", "numba", "numpy", "sympy", *others)),
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":")[1].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()
