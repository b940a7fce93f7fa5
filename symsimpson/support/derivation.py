"""Records of derivations: the time of each part, with the result."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

_collected: ContextVar[dict[str, float] | None] = ContextVar("collected", default=None)


@contextmanager
def collecting() -> Iterator[dict[str, float]]:
    """Collect the seconds of all stages that are timed inside, by their names."""
    seconds: dict[str, float] = {}
    token = _collected.set(seconds)
    try:
        yield seconds
    finally:
        _collected.reset(token)


@contextmanager
def timed(stage: str) -> Iterator[None]:
    """Add the seconds that a block takes to a stage, if they are collected."""
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds = _collected.get()
        if seconds is not None:
            seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start


#: The running cost L(t, q, v) of a system, whose integral over a step is the discrete Lagrangian.
LAGRANGIAN = "the Lagrangian"


@dataclass(frozen=True)
class Derivation:
    """The text of a module, and how it came about."""

    text: str
    seconds: Mapping[str, float]  #: Of the stages: reading, structure, jet, text.
    #: Of the jet at a node: forces, momenta and their derivatives; None if terms are summed up in
    #: loops over families.
    operations: int | None
    unrolled: bool  #: Whether the kernels are written out, else loops.


@dataclass(frozen=True, repr=False)
class Report:
    """Times of deriving and compiling a stepper; shown as a table.

    Attributes
    ----------
    seconds : mapping from str to float
        Of the stages: reading, structure, jet, text, and compilation as far as it was needed.
    lines : int
        Of the module's text.
    operations : int or None
        Of the jet at a node; None if terms are summed up in loops, or nothing was derived here.
    form : str
        "unrolled", "loops", or "" if nothing was derived here.
    """

    seconds: Mapping[str, float]
    lines: int
    operations: int | None
    form: str

    def rows(self) -> list[tuple[str, str]]:
        """List names and values."""
        pairs = [(stage, f"{value:.2f} s") for stage, value in self.seconds.items()]
        form = f", {self.form}" if self.form else ""
        pairs.append(("module", f"{self.lines} lines{form}"))
        if self.operations is not None:
            pairs.append(("jet of L", f"{self.operations} operations at a node"))
        return pairs

    def __repr__(self) -> str:
        return "\n".join(f"{name:<12} {value}" for name, value in self.rows())

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in self.rows())
        return f"<table>{rows}</table>"
