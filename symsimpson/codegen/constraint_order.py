"""How constraints stand among the coordinates: one order of both, for one matrix of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from symsimpson.codegen.storage import Storage
from symsimpson.discrete.bandwidth import band_of, neighbours, ordering
from symsimpson.discrete.families import Family

__all__ = ["Held", "dense", "smaller"]


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
