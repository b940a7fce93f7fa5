"""Storage of matrices: places of the entries of coordinates, of constraints, of both."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from symsimpson.discrete.bandwidth import band_of, neighbours, ordering
from symsimpson.discrete.families import Family
from symsimpson.discrete.reductions import Routh
from symsimpson.schemes.scheme import Scheme

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

    @classmethod
    def dense(cls, n: int) -> Storage:
        """Keep the order, and all entries."""
        return cls(tuple(range(n)), n - 1, banded=False)

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
            f"{prefix}_ROW_STEP": 1 if self.banded else self.n,
            f"{prefix}_PLACE_STEP": blocks if self.banded else 1,
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


@dataclass(frozen=True)
class Held:
    """Places of coordinates and constraints in an order in which those that meet stand close.

    Each constraint stands behind all coordinates in it: a symmetric elimination then needs no
    exchange of rows.
    """

    storage: Storage  #: Of both; the item at each place is a coordinate, or n plus a constraint.
    #: That of the coordinate at each place of coordinates alone, then that of each constraint.
    place: tuple[int, ...]
    count: int  #: Number of constraints.
    velocities: int = 0  #: Number of those, the last ones, that are constraints of velocities.
    #: Whether elimination takes all increments before the multipliers, and exchanges no rows.
    in_order: bool = False

    @classmethod
    def dense(cls, n: int, count: int, velocities: int = 0, *, in_order: bool = False) -> Held:
        """Put the constraints behind all coordinates, and keep all entries."""
        storage, places = Storage.dense(n + count), tuple(range(n + count))
        return cls(storage, places, count, velocities, in_order or velocities > 0)

    @classmethod
    def chain(
        cls,
        order: Sequence[int],
        members: Sequence[frozenset[int]],
        near: Sequence[set[int]],
        velocities: int = 0,
    ) -> Held:
        """Put each constraint right behind the last of its coordinates.

        Coordinates stand in an ``order``; ``members`` are those in each constraint, and ``near``
        those that meet each one.
        """
        n, at = len(order), {a: s for s, a in enumerate(order)}
        behind: list[list[int]] = [[] for _ in order]
        for c, coordinates in enumerate(members):
            behind[max(at[a] for a in coordinates)].append(n + c)
        both = [item for s, a in enumerate(order) for item in (a, *behind[s])]
        place = {item: s for s, item in enumerate(both)}
        distances = [abs(place[a] - place[b]) for a, others in enumerate(near) for b in others]
        distances += [place[n + c] - place[a] for c, some in enumerate(members) for a in some]
        places = tuple(place[item] for item in (*order, *range(n, len(both))))
        storage = Storage(tuple(both), max(distances), banded=True)
        return cls(storage, places, len(members), velocities)

    def entry(self, i: int, j: int) -> int:
        """Return where two coordinates, or constraints behind these, meet in the node's matrix."""
        first = self.storage.node_offset + self.place[i] * self.storage.node_stride
        return first + self.place[j]

    def constants(self, blocks: int) -> dict[str, object]:
        """Return what loops over coordinates and constraints must know."""
        n = len(self.storage.order) - self.count
        steps = self.storage.constants("HELD", blocks)
        step = steps["HELD_ROW_STEP"]
        return {
            "CONSTRAINTS": self.count,
            **({"HOLONOMIC": self.count - self.velocities} if self.velocities else {}),
            "HELD_PLACE": self.place,
            "CONSTRAINT_AT": tuple(item - n if item >= n else -1 for item in self.storage.order),
            "HELD_PLACES": len(self.place),
            "HELD_SIZE": self.storage.node_size,
            "HELD_BAND": self.storage.band,
            "HELD_STRIDE": self.storage.node_stride,
            "HELD_OFFSET": self.storage.node_offset,
            "HELD_PLACE_STEP": steps["HELD_PLACE_STEP"],
            "HELD_ROW_STEP": n if self.in_order else step,
            "HELD_PULL_STEP": self.count if self.in_order else step,
            "HELD_SHIFT": (blocks - 1) * n if self.in_order else 0,
        }


def dense(n: int, constraints: int, velocities: int = 0) -> tuple[Storage, Held | None]:
    """Keep the order of coordinates, constraints behind them if there are any, and all entries."""
    return Storage.dense(n), Held.dense(n, constraints, velocities) if constraints else None


def smaller(
    storage: Storage,
    held: Held | None,
    terms: Sequence[Family],
    met: Sequence[Family],
    degree: int,
    rolling: Sequence[frozenset[int]] = (),
) -> tuple[Storage, Held | None]:
    """Return bands where these are smaller than what is given.

    ``terms`` are those of L, ``met`` the constraints, and ``rolling`` has the coordinates in each
    velocity constraint.
    """
    near = neighbours([*terms, *met], storage.n)
    for member in rolling:
        for i in member:
            near[i] |= member - {i}
    order, band = ordering(near)
    if held is None:
        banded = Storage(order, band, banded=True)
        return (banded if banded.size(degree) < storage.size(degree) else storage), None
    members = {
        c: frozenset(member)
        for family in met
        for c, member in zip(family.constraints, family.coordinates, strict=True)
    }
    positions = held.count - len(rolling)
    every = [*(members[c] for c in range(positions)), *rolling]
    chain = Held.chain(order, every, near, len(rolling))
    if chain.storage.size(degree) >= held.storage.size(degree):
        return storage, held
    return Storage(order, band_of(order, neighbours(terms, storage.n)), banded=True), chain


@dataclass(frozen=True)
class LoopKernels:
    """How kernels go over coordinates, unknowns and matrix entries in loops."""

    storage: Storage
    degree: int
    held: Held | None  #: How constraints stand among the coordinates, if there are any.
    #: Whether M is, so that its factors may stay in their place from step to step.
    constant_mass: bool = False
    #: Whether Newton's method needs no exchange of rows, but for a few steps.
    in_order: bool = False
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
