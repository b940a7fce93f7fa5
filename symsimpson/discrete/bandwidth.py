"""Orders of coordinates with a small bandwidth. Neighbours are coordinates in a common term."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from symsimpson.discrete.families import Family


def list_neighbours(term_families: Iterable[Family], n: int) -> list[set[int]]:
    """List the neighbours of each of the n coordinates."""
    near: list[set[int]] = [set() for _ in range(n)]
    for family in term_families:
        for member in family.coordinates:
            for i in member:
                near[i].update(member)
    return [others - {i} for i, others in enumerate(near)]


def order_coordinates(near: list[set[int]]) -> tuple[tuple[int, ...], int]:
    """Return an order with a small bandwidth (reverse Cuthill-McKee) and the bandwidth [1]_.

    The given order is returned if its bandwidth is as small. ``near`` has the neighbours of each
    coordinate.

    References
    ----------
    .. [1] E. Cuthill and J. McKee, Reducing the bandwidth of sparse symmetric matrices,
       Proc. 24th ACM National Conference (1969), 157-172.
    """
    left = set(range(len(near)))
    order: list[int] = []

    def degree(i: int) -> tuple[int, int]:
        return len(near[i]), i

    while left:
        start = _periphery(min(left, key=degree), near)
        queue = [start]
        left.discard(start)
        for i in queue:
            following = sorted(near[i] & left, key=degree)
            left.difference_update(following)
            queue += following
        order += queue
    order.reverse()
    given, reordered = tuple(range(len(near))), tuple(order)
    best = min((given, reordered), key=lambda order: band_of(order, near))
    return best, band_of(best, near)


def band_of(order: Sequence[int], near: list[set[int]]) -> int:
    """Return the bandwidth of an order: the largest distance of two neighbours."""
    place = {i: s for s, i in enumerate(order)}
    return max(
        (abs(place[i] - place[j]) for i, others in enumerate(near) for j in others), default=0
    )


def _periphery(start: int, near: list[set[int]]) -> int:
    """Return a pseudo-peripheral coordinate, far from the others in its connected component."""
    reach = -1
    while True:
        level, seen, count = {start}, {start}, 0
        while following := {j for i in level for j in near[i]} - seen:
            level, count = following, count + 1
            seen |= following
        if count <= reach:
            return start
        reach = count
        start = min(level, key=lambda i: (len(near[i]), i))
