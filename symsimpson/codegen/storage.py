"""How a system of equations stands in the workspace: dense, or a band along a chain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from symsimpson.schemes.scheme import Scheme

__all__ = ["Storage", "node_stride"]

#: Nodes are filled up to a multiple of this: a vector register of the widest machines.
REGISTER = 8


@dataclass(frozen=True)
class Storage:
    """Places of matrix entries of a large system.

    Dense, unknown ``row * n + s`` belongs to coordinate s and block ``row`` (one for each control
    point that is solved for). Banded, coordinates are taken in another order in which those that
    meet in a term of L stand close; s is the place there, and the unknown is ``s * blocks + row``.
    Elimination with row pivoting widens a band of half-width b to b below and 2 b above.
    """

    order: tuple[int, ...]  #: The coordinate at each place.
    band: int  #: Largest distance of two places whose coordinates meet; n - 1 if dense.
    banded: bool
    #: Whether blocks of a dense system stand together at each place, as in a band: elimination
    #: takes all of one item before the next one.
    by_place: bool = False

    @classmethod
    def dense(cls, n: int, *, by_place: bool = False) -> Storage:
        """Keep the order, and all entries."""
        return cls(tuple(range(n)), n - 1, banded=False, by_place=by_place)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.order)

    @property
    def node_size(self) -> int:
        """Rows of an n by n matrix."""
        return self.n * (2 * self.band + 1) if self.banded else self.n**2

    @property
    def node_stride(self) -> int:
        """From an entry of an n by n matrix to the one below it."""
        return 2 * self.band if self.banded else self.n

    @property
    def node_offset(self) -> int:
        """Where the first entry of an n by n matrix stands."""
        return self.band if self.banded else 0

    def band_of(self, entries: Iterable[tuple[int, int]]) -> int:
        """Return the largest distance of the places of these pairs of coordinates."""
        place = {a: s for s, a in enumerate(self.order)}
        return max((abs(place[i] - place[j]) for i, j in entries), default=0)

    def size(self, blocks: int) -> int:
        """Rows of a matrix of all unknowns."""
        unknowns = self.unknowns(blocks)
        return unknowns * (3 * self._half(blocks) + 1) if self.banded else unknowns**2

    def unknowns(self, blocks: int) -> int:
        """Count all unknowns."""
        return self.n * blocks

    def node_constants(self) -> dict[str, object]:
        """Return what loops over the entries of an n by n matrix must know."""
        return {
            "COORDINATE": self.order,
            "BAND": self.band,
            "NODE_STRIDE": self.node_stride,
            "NODE_OFFSET": self.node_offset,
        }

    def constants(self, prefix: str, blocks: int, before: int = 0) -> dict[str, object]:
        """Return what loops over the entries of a system of blocks times n unknowns must know.

        So many entries stand ``before`` its own.
        """
        half, unknowns = self._half(blocks), self.unknowns(blocks)
        return {
            f"{prefix}_ROW_STEP": 1 if self.banded or self.by_place else self.n,
            f"{prefix}_PLACE_STEP": blocks if self.banded or self.by_place else 1,
            f"{prefix}_STRIDE": 3 * half if self.banded else unknowns,
            f"{prefix}_OFFSET": before + (half if self.banded else 0),
        }

    def bounds(self, prefix: str, blocks: int) -> dict[str, object]:
        """Return how far from the diagonal an elimination finds entries: below, and above it."""
        half, unknowns = self._half(blocks), self.unknowns(blocks)
        return {
            f"{prefix}_LOWER": half if self.banded else max(unknowns - 1, 0),
            f"{prefix}_UPPER": 2 * half if self.banded else max(unknowns - 1, 0),
        }

    def _half(self, blocks: int) -> int:
        return blocks * (self.band + 1) - 1


def node_stride(scheme: Scheme) -> int:
    """Return the rows of a value that all nodes have: more than nodes where these are lanes."""
    register = REGISTER // 2 if scheme.stages <= REGISTER // 2 else REGISTER
    full = -(-scheme.stages // register) * register
    return full if scheme.by_stages else scheme.stages
