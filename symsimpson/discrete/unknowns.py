"""Unknowns of a step: blocks, one after the other."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Unknowns"]


@dataclass(frozen=True)
class Unknowns:
    """Blocks of unknowns and their sizes.

    The increments X_1..X_d of the control points come first, a block of ``coordinates`` for each.
    Their sizes are measured with the diagonal of M(q0); what stands behind them, ``others``, is
    not part of the path and not measured: multipliers, for one.

    Examples
    --------
    >>> unknowns = Unknowns(control_points=2, coordinates=3)
    >>> unknowns.size, unknowns.place(2, 0)
    (6, 3)
    """

    control_points: int
    coordinates: int
    others: tuple[int, ...] = ()

    @property
    def measured(self) -> int:
        """Number of increments."""
        return self.control_points * self.coordinates

    @property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.measured + sum(self.others)

    @property
    def behind(self) -> int:
        """Number of unknowns behind the increments."""
        return sum(self.others)

    def place(self, k: int, a: int) -> int:
        """Return the place of X_k of coordinate a, k from 1 on; behind X_d, of the others."""
        if k > self.control_points:
            return self.measured + sum(self.others[: k - self.control_points - 1]) + a
        return (k - 1) * self.coordinates + a
