"""Storage of matrices: places of entries of coordinates and constraints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from symsimpson.discrete.bandwidth import band_of, list_neighbours, order_coordinates
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.families import Family

#: Nodes are filled up to a multiple of this: a vector register of the widest machines.
REGISTER = 8


@dataclass(frozen=True)
class Storage:
    """Places of matrix entries of a large system.

    A matrix has one block of n unknowns for each control point that is solved for. In dense storage
    unknown ``row * n + s`` belongs to block ``row`` and coordinate s. In banded storage the unknown
    is ``s * blocks + row``, where s is the place of the coordinate in another order. There,
    coordinates that share a term of L are close to each other. Elimination with row pivoting
    widens a band of half-width b to b below and 2 b above the diagonal.
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
        """Offset of the first entry of an n by n matrix."""
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
        """Return the strides of an n by n matrix, as constants of a module."""
        return {
            "COORDINATE": self.order,
            "BAND": self.band,
            "NODE_STRIDE": self.node_stride,
            "NODE_OFFSET": self.node_offset,
        }

    def constants(self, prefix: str, blocks: int, before: int = 0) -> dict[str, object]:
        """Return the strides of a matrix of blocks times n unknowns, as constants of a module.

        ``before`` counts the entries in front of the matrix.
        """
        half, unknowns = self._half(blocks), self.unknowns(blocks)
        return {
            f"{prefix}_ROW_STEP": 1 if self.banded else self.n,
            f"{prefix}_PLACE_STEP": blocks if self.banded else 1,
            f"{prefix}_STRIDE": 3 * half if self.banded else unknowns,
            f"{prefix}_OFFSET": before + (half if self.banded else 0),
        }

    def bounds(self, prefix: str, blocks: int) -> dict[str, object]:
        """Return the half-widths below and above the diagonal that an elimination visits."""
        half, unknowns = self._half(blocks), self.unknowns(blocks)
        return {
            f"{prefix}_LOWER": half if self.banded else max(unknowns - 1, 0),
            f"{prefix}_UPPER": 2 * half if self.banded else max(unknowns - 1, 0),
        }

    def _half(self, blocks: int) -> int:
        return blocks * (self.band + 1) - 1


def node_stride(equations: DiscreteEquations) -> int:
    """Return the rows of a value of all nodes; nodes that are lanes fill vector registers."""
    scheme, canonical = equations.scheme, equations.plain.hamiltonian is not None
    register = REGISTER // 2 if scheme.stages <= REGISTER // 2 else REGISTER
    full = -(-scheme.stages // register) * register
    return full if canonical or scheme.by_stages else scheme.stages


@dataclass(frozen=True)
class Border:
    """The order of coordinates and constraints in a bordered matrix, and their places in it.

    Coordinates and constraints that interact are close to each other. Each constraint follows all
    of its coordinates, so that a symmetric elimination needs no exchange of rows.
    """

    storage: Storage  #: Of both; the item at each place is a coordinate, or n plus a constraint.
    #: That of the coordinate at each place of coordinates alone, then that of each constraint.
    place: tuple[int, ...]
    count: int  #: Number of constraints.
    velocities: int = 0  #: Number of velocity constraints, which come last.
    #: Whether elimination takes all increments before the multipliers, and exchanges no rows.
    in_order: bool = False

    @classmethod
    def dense(
        cls, n: int, count: int, velocities: int = 0, *, in_order: bool = False
    ) -> Border | None:
        """Put the constraints after all coordinates; return None without constraints."""
        if not count:
            return None
        storage, places = Storage.dense(n + count), tuple(range(n + count))
        return cls(storage, places, count, velocities, in_order or velocities > 0)

    @classmethod
    def chain(
        cls,
        order: Sequence[int],
        members: Sequence[frozenset[int]],
        near: Sequence[set[int]],
        velocities: int = 0,
    ) -> Border:
        """Put each constraint right after the last of its coordinates.

        ``order`` is the order of coordinates. ``members`` has the coordinates of each constraint,
        and ``near`` the coordinates that interact with each coordinate.
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
        """Return the entry of two items in the bordered matrix; constraints follow coordinates."""
        first = self.storage.node_offset + self.place[i] * self.storage.node_stride
        return first + self.place[j]

    def constants(self, blocks: int) -> dict[str, object]:
        """Return the tables for loops over coordinates and constraints."""
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


def choose_storage(
    storage: Storage,
    held: Border | None,
    terms: Sequence[Family],
    met: Sequence[Family],
    degree: int,
    rolling: Sequence[frozenset[int]] = (),
) -> tuple[Storage, Border | None]:
    """Return banded storage where it is smaller than the given one.

    ``terms`` are families of terms of L, and ``met`` families of constraints. ``rolling`` has the
    coordinates of each velocity constraint.
    """
    near = list_neighbours([*terms, *met], storage.n)
    for member in rolling:
        for i in member:
            near[i] |= member - {i}
    order, band = order_coordinates(near)
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
    chain = Border.chain(order, every, near, len(rolling))
    if chain.storage.size(degree) >= held.storage.size(degree):
        return storage, held
    return Storage(order, band_of(order, list_neighbours(terms, storage.n)), banded=True), chain


def pivot_places(storage: Storage, held: Border | None) -> tuple[int, ...]:
    """Return the entry of each pivot of M among its factors, in the order of places."""
    places = held.place[: storage.n] if held else range(storage.n)
    factors = held.storage if held else storage
    return tuple(i * (factors.node_stride + 1) + factors.node_offset for i in places)
