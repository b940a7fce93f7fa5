"""Records of comparisons of run time and error: a table, a figure, a file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from symsimpson.errors import InputError, StorageError
from symsimpson.support.files import write_text

#: Written into files; those of another version are not compared with.
FORMAT = 1


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
        from symsimpson.plotting.errors import plot_work_precision

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
            raise StorageError(
                f"{os.fspath(path)}: the record cannot be read: {error.strerror}.\n"
                "Write one with symsimpson bench SYSTEM --out FILE."
            ) from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise StorageError(
                f"{os.fspath(path)}: no record of run times: {type(error).__name__}: {error}.\n"
                "Write one with symsimpson bench SYSTEM --out FILE."
            ) from error

    def compare(self, before: WorkPrecision) -> str:
        """Return the ratio of run times now and before, for each contender and level.

        Raises
        ------
        InputError
            If the problems differ.
        """
        same = ("system", "t_end", "q0", "p0")
        if any(getattr(self, name) != getattr(before, name) for name in same):
            raise InputError(
                f"{before.system} to t = {before.t_end:g} and {self.system} to t = {self.t_end:g} "
                "are two problems, or start elsewhere.\nCompare records of one problem."
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
