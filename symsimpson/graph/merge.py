"""Nodes that are equal as functions, or equal up to their sign, found by values and made one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from symsimpson.graph.field import LARGER, PRIME, Evaluation, PrimeField
from symsimpson.graph.nodes import ZERO, Graph, Value, scaled
from symsimpson.graph.rebuild import again
from symsimpson.graph.roots import dependent_radicands

#: Points at which nodes are compared: that two of 10^4 agree by chance has odds below 2^-100.
POINTS = 3
#: Other points are tried this often where something is divided by zero.
TRIES = 20


def evaluations(
    graph: Graph, roots: Sequence[int], count: int, opaque: frozenset[int] | None = None
) -> list[Evaluation]:
    """Evaluate nodes at several points of the field.

    Raises ZeroDivisionError if something is divided by zero wherever one looks.
    """
    if opaque is None:
        opaque = dependent_radicands(graph, roots)
    points: list[Evaluation] = []
    for seed in range(count + TRIES):
        try:
            numbers = PrimeField(seed, PRIME if seed < TRIES // 2 else LARGER)
            points.append(Evaluation(graph, roots, numbers, opaque))
        except ZeroDivisionError:
            continue
        if len(points) == count:
            return points
    raise ZeroDivisionError


def merged(graph: Graph, values: Sequence[Value], level: Callable[[int], int]) -> list[Value]:
    """Write values so that no two nodes in them are equal as functions.

    Of equal nodes one of the lowest ``level`` stays; a product rather than a sum, in which digits
    may cancel.
    """
    roots = [n for _, n in values]
    try:
        points = evaluations(graph, roots, POINTS)
    except ZeroDivisionError:
        return list(values)
    classes: dict[tuple[object, ...], list[int]] = {}
    marks: dict[int, int] = {}
    key_of: dict[int, tuple[object, ...]] = {}
    for n in graph.reached([0, *roots]):
        key = tuple(at.values[n] if n else 1 for at in points)
        marks[n], key_of[n] = _unsigned(key, points) if any(key) else (0, key)
        classes.setdefault(key_of[n], []).append(n)

    def stays(order: Callable[[int], tuple[int, ...]]) -> dict[int, int]:
        chosen = {key: min(members, key=order) for key, members in classes.items()}
        return {n: chosen[key] for n, key in key_of.items()}

    sums_last = stays(lambda n: (level(n), graph.nodes[n].kind == "sum", n))
    done = _rewritten(graph, roots, marks, sums_last)
    if done is None:  # a product that is made of the sum
        done = _rewritten(graph, roots, marks, stays(lambda n: (level(n), n)))
    assert done is not None
    return [scaled(c, done[n]) for c, n in values]


def _rewritten(
    graph: Graph, roots: Sequence[int], marks: dict[int, int], stays: dict[int, int]
) -> dict[int, Value] | None:
    """Write nodes anew with those that stay; None if these are made of each other."""
    done: dict[int, Value] = {n: ZERO for n, mark in marks.items() if not mark}
    open_: set[int] = set()
    work = [n for n in roots if n not in done]
    while work:
        n = work[-1]
        if n in done:
            work.pop()
            continue
        other = stays[n]
        if other == n:
            missing = [m for m in graph.arguments(n) if m not in done]
        else:
            missing = [] if other in done else [other]
        if missing:
            if n in open_:
                return None
            open_.add(n)
            work += missing
            continue
        if other == n:
            done[n] = again(graph, n, done, graph)
        else:
            done[n] = scaled(marks[n] * marks[other], done[other])
        open_.discard(n)
        work.pop()
    return done


def _unsigned(
    key: tuple[object, ...], points: Sequence[Evaluation]
) -> tuple[int, tuple[object, ...]]:
    """Return the same key for a node and its negative, and which of them it is."""
    pairs = zip(key, points, strict=True)
    other = tuple(_negative(x, at.arithmetic.prime) for x, at in pairs)
    return (1, key) if repr(key) <= repr(other) else (-1, other)


def _negative(x: object, prime: int) -> object:
    if isinstance(x, tuple):
        return tuple(-y % prime for y in x)
    assert isinstance(x, int)
    return -x % prime
