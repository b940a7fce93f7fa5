"""Orders of coordinates in which those that meet in a term stand close."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from symsimpson.discrete.families import Family


def neighbours(term_families: Iterable[Family], n: int) -> list[set[int]]:
    """List the coordinates that meet each one in some term."""
    near: list[set[int]] = [set() for _ in range(n)]
    for family in term_families:
        for member in family.coordinates:
            for i in member:
                near[i].update(member)
    return [others - {i} for i, others in enumerate(near)]


def ordering(near: list[set[int]]) -> tuple[tuple[int, ...], int]:
    """Order coordinates so that those that meet stand close (reverse Cuthill-McKee).

    They stay as they are where that is as good. The largest distance of two that meet comes with
    their new order.

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
    kept, moved = range(len(near)), tuple(order)
    best = min((tuple(kept), moved), key=lambda order: band_of(order, near))
    return best, band_of(best, near)


def band_of(order: Sequence[int], near: list[set[int]]) -> int:
    """Measure the largest distance, in an order, of two coordinates that meet."""
    place = {i: s for s, i in enumerate(order)}
    return max(
        (abs(place[i] - place[j]) for i, others in enumerate(near) for j in others), default=0
    )


def _periphery(start: int, near: list[set[int]]) -> int:
    """Walk to a coordinate far from all others of its group."""
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
