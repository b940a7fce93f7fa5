"""Loops over coordinates, unknowns and matrix entries: where these stand, and which there are."""

from __future__ import annotations

from dataclasses import dataclass

from symsimpson.codegen.constraint_order import Held
from symsimpson.codegen.storage import Storage
from symsimpson.discrete.reductions import Routh

__all__ = ["LoopKernels"]


@dataclass(frozen=True)
class LoopKernels:
    """How kernels go over coordinates, unknowns and matrix entries in loops."""

    storage: Storage
    degree: int
    held: Held | None  #: How constraints stand among the coordinates, if there are any.
    #: Whether M is, so that its factors may stay in their place from step to step.
    constant_mass: bool
    #: Whether Newton's method needs no exchange of rows, but for a few steps.
    in_order: bool = False
    carried: bool = False  #: Whether velocity constraints do work.
    written: bool = False  #: Whether the equations of a step are written out.
    routh: Routh | None = None  #: Which cyclic coordinates follow from their momenta, if some do.

    @property
    def rolling(self) -> bool:
        """Whether some constraints are those of velocities."""
        return self.held is not None and self.held.velocities > 0

    @property
    def cleared(self) -> int:
        """Rows of the matrix of all unknowns that sums or elimination begin with as zero."""
        storage = self.held.storage if self.held else self.storage
        return storage.size(self.degree) if self.held or storage.banded else 0

    @property
    def pivots(self) -> dict[str, object]:
        """Where each pivot of M stands among the factors."""
        storage = self.held.storage if self.held else self.storage
        places = self.held.place[: self.storage.n] if self.held else range(self.storage.n)
        step, offset = storage.node_stride + 1, storage.node_offset
        return {} if self.constant_mass else {"PIVOT_AT": tuple(i * step + offset for i in places)}
