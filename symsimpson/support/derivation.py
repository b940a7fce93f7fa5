"""Derived module texts, and the time that each stage of a derivation took."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

_collected: ContextVar[dict[str, float] | None] = ContextVar("collected", default=None)


@contextmanager
def collect_times() -> Iterator[dict[str, float]]:
    """Collect the seconds of stages that :func:`time_stage` measures in this context, by name."""
    seconds: dict[str, float] = {}
    token = _collected.set(seconds)
    try:
        yield seconds
    finally:
        _collected.reset(token)


@contextmanager
def time_stage(stage: str) -> Iterator[None]:
    """Add the seconds of a block to a stage, if :func:`collect_times` is active."""
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
    """The text of a module, with the figures of its derivation."""

    text: str
    seconds: Mapping[str, float]  #: Time of each stage: reading, structure, jet, text.
    #: Operations of the jet at a node: forces, momenta and their derivatives. None if loops over
    #: families sum the terms.
    operations: int | None
    unrolled: bool  #: Whether the kernels are unrolled; otherwise they contain loops.


@dataclass(frozen=True, repr=False)
class Report:
    """The time to derive and compile a stepper, and the size of its code. Printed as a table.

    Attributes
    ----------
    seconds : mapping from str to float
        The time of each stage in seconds: "reading", "structure", "jet", "text", "compilation".
        Compilation counts only what was compiled so far.
    lines : int
        The number of lines of the generated module.
    operations : int or None
        The number of operations of the jet (forces, momenta and their derivatives) at a node.
        None if loops sum the terms, or if the module was read from a file.
    form : str
        "unrolled" or "loops". "" if the module was read from a file.

    Examples
    --------
    >>> Report({"reading": 0.02, "jet": 0.31}, lines=412, operations=38, form="unrolled")
    reading      0.02 s
    jet          0.31 s
    module       412 lines, unrolled
    jet of L     38 operations at a node
    """

    seconds: Mapping[str, float]
    lines: int
    operations: int | None
    form: str

    def rows(self) -> list[tuple[str, str]]:
        """List the rows of the table: pairs of a name and a value."""
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
