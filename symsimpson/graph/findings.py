"""Identities of values, found at random points of a finite field.

A value depends on a symbol if it changes with that symbol: this is a proof. Independence is tested
at two points, with an error below 2^-100. Functions that the field does not know count as changing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from symsimpson.graph.field import LARGER, PRIME, Element, Evaluation, PrimeField
from symsimpson.graph.nodes import ZERO, Graph, Value, scaled
from symsimpson.graph.rebuild import again, fixed
from symsimpson.graph.roots import dependent_radicands, radicands

POINTS = 2
#: Points at which nodes are merged: that two of 10^4 agree by chance has odds below 2^-100.
MERGING_POINTS = 3
#: Other points are tried this often where something is divided by zero.
TRIES = 20
#: Functions that a field knows as well as algebra does.
KNOWN = frozenset(["sin", "cos", "exp", "sinh", "cosh", "tanh"])


def evaluations(
    graph: Graph, roots: Sequence[int], count: int, opaque: frozenset[int]
) -> list[Evaluation]:
    """Evaluate nodes at several points of the field.

    Raises ZeroDivisionError if something is divided by zero wherever one looks.
    """
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


class Findings:
    """Answers about values, and what they are made of.

    ``values`` are all that will be asked about. What is known of roots is taken over from findings
    ``before``, of values of the same graph, if no root is new.
    """

    def __init__(
        self, graph: Graph, values: Sequence[Value], before: Findings | None = None
    ) -> None:
        self._graph = graph
        roots = [n for _, n in values]
        self.radicands = frozenset(radicands(graph, graph.reached(roots)))
        self.dependent: frozenset[int] = (
            dependent_radicands(graph, roots)
            if before is None or not self.radicands <= before.radicands
            else before.dependent
        )
        self.points = evaluations(graph, roots, POINTS, self.dependent)
        self._known_opaque: dict[int, bool] = {}

    def vanishes(self, value: Value) -> bool:
        """Return whether a value is zero."""
        return not value[0] or all(not at.values[value[1]] for at in self.points)

    def equal(self, first: Value, second: Value) -> bool:
        """Return whether two values are the same."""
        return all(at[first] == at[second] for at in self.points)

    def depends(self, value: Value, x: int) -> bool:
        """Return whether a value depends on a symbol."""
        if not value[0] or x not in self._graph.nodes[value[1]].symbols:
            return False
        return any(value[1] in at.depending_on(x) for at in self.points)

    def freed(self, value: Value, symbols: Iterable[int]) -> Value:
        """Write a value without the symbols that it does not depend on, where that can be."""
        if self.vanishes(value):
            return ZERO
        present = self._graph.nodes[value[1]].symbols
        for x in [x for x in symbols if x in present and not self.depends(value, x)]:
            value = fixed(self._graph, value, [x]) or value
        return value

    def affine(self, values: Sequence[Value], symbols: Sequence[int]) -> list[bool]:
        """Tell of each value whether its second differences in some symbols vanish."""
        answer = [True] * len(values)
        for number, point in enumerate(self.points):
            corners = [[at[value] for value in values] for at in _corners(point, symbols, number)]
            arithmetic = point.arithmetic
            for k, (base, first, other, both) in enumerate(zip(*corners, strict=True)):
                left, right = arithmetic.plus(base, both), arithmetic.plus(first, other)
                answer[k] = answer[k] and left == right
        return answer

    def opaque(self, value: Value) -> bool:
        """Return whether a value holds functions of which the field knows nothing."""
        if value[1] not in self._known_opaque:
            nodes = self._graph.reached([value[1]])
            self._known_opaque[value[1]] = any(map(self._is_opaque, nodes))
        return self._known_opaque[value[1]]

    def _is_opaque(self, n: int) -> bool:
        kind, parts, _ = self._graph.nodes[n]
        if kind == "function":
            return parts[0] not in KNOWN
        return kind == "product" and any(
            e.denominator > 2 or (e.denominator == 2 and m in self.dependent) for m, e in parts
        )


def _corners(at: Evaluation, symbols: Sequence[int], number: int) -> Iterable[Evaluation]:
    """Return a parallelogram of points: z, z + u, z + w, z + u + w."""
    draw = PrimeField(number + 1000, at.arithmetic.prime)
    for u, w in ((0, 0), (1, 0), (0, 1), (1, 1)):
        moved: dict[int, Element] = {
            x: draw.plus(
                draw.draw("base", x),
                draw.plus(u * draw.draw("first", x), w * draw.draw("second", x)),
            )
            for x in symbols
        }
        yield at.at(moved)


def merged(graph: Graph, values: Sequence[Value], level: Callable[[int], int]) -> list[Value]:
    """Write values so that no two nodes in them are equal as functions.

    Of equal nodes one of the lowest ``level`` stays; a product rather than a sum, in which digits
    may cancel.
    """
    roots = [n for _, n in values]
    try:
        points = evaluations(graph, roots, MERGING_POINTS, dependent_radicands(graph, roots))
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
