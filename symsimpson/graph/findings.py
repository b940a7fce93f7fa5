"""Identities and dependences of values, tested at random points of a finite field.

If a value changes with a symbol, it certainly depends on this symbol. If it does not change at two
points, it is independent with an error probability below 2^-100. Functions that the field does not
know count as dependent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from symsimpson.graph.field import LARGER, PRIME, Element, Evaluation, PrimeField
from symsimpson.graph.nodes import ZERO, Graph, Value, scale
from symsimpson.graph.rebuild import fix_symbols, rebuild_node
from symsimpson.graph.roots import dependent_radicands, radicands

POINTS = 2
#: Points to merge nodes. With 10^4 nodes, the probability of a chance agreement is below 2^-100.
MERGING_POINTS = 3
#: Number of further points after divisions by zero.
TRIES = 20
#: Functions with the same identities in the field as in the real numbers.
KNOWN = frozenset(["sin", "cos", "exp", "sinh", "cosh", "tanh"])


def evaluate_at_points(
    graph: Graph, roots: Sequence[int], count: int, opaque: frozenset[int]
) -> list[Evaluation]:
    """Evaluate nodes at ``count`` random points of the field.

    Raises ZeroDivisionError if a division by zero occurs at too many points.
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


class IdentityTest:
    """Identity tests for ``values`` and their descendants.

    ``before`` is an earlier instance for the same graph. If no square root is new, its dependences
    of square roots are used again.
    """

    def __init__(
        self, graph: Graph, values: Sequence[Value], before: IdentityTest | None = None
    ) -> None:
        self._graph = graph
        roots = [n for _, n in values]
        self.radicands = frozenset(radicands(graph, graph.descendants(roots)))
        self.dependent: frozenset[int] = (
            dependent_radicands(graph, roots)
            if before is None or not self.radicands <= before.radicands
            else before.dependent
        )
        self.points = evaluate_at_points(graph, roots, POINTS, self.dependent)
        self._known_opaque: dict[int, bool] = {}

    def vanishes(self, value: Value) -> bool:
        """Return whether a value is identically zero."""
        return not value[0] or all(not at.values[value[1]] for at in self.points)

    def equal(self, first: Value, second: Value) -> bool:
        """Return whether two values are identically equal."""
        return all(at[first] == at[second] for at in self.points)

    def depends(self, value: Value, x: int) -> bool:
        """Return whether a value depends on a symbol."""
        if not value[0] or x not in self._graph.nodes[value[1]].symbols:
            return False
        return any(value[1] in at.depending_on(x) for at in self.points)

    def drop_symbols(self, value: Value, symbols: Iterable[int]) -> Value:
        """Return an equal value without symbols on which it does not depend, where possible."""
        if self.vanishes(value):
            return ZERO
        present = self._graph.nodes[value[1]].symbols
        for x in [x for x in symbols if x in present and not self.depends(value, x)]:
            value = fix_symbols(self._graph, value, [x]) or value
        return value

    def affine(self, values: Sequence[Value], symbols: Sequence[int]) -> list[bool]:
        """Return for each value whether it is affine in the symbols: second differences vanish."""
        answer = [True] * len(values)
        for number, point in enumerate(self.points):
            corners = [[at[value] for value in values] for at in _corners(point, symbols, number)]
            arithmetic = point.arithmetic
            for k, (base, first, other, both) in enumerate(zip(*corners, strict=True)):
                left, right = arithmetic.plus(base, both), arithmetic.plus(first, other)
                answer[k] = answer[k] and left == right
        return answer

    def opaque(self, value: Value) -> bool:
        """Return whether a value contains functions without identities in the field."""
        if value[1] not in self._known_opaque:
            nodes = self._graph.descendants([value[1]])
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
    """Yield evaluations at the corners of a parallelogram: z, z + u, z + w, z + u + w."""
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


def merge_equal_nodes(
    graph: Graph, values: Sequence[Value], level: Callable[[int], int]
) -> list[Value]:
    """Rewrite values so that no two nodes in them are equal as functions.

    Among equal nodes, a node of the lowest ``level`` remains. A product is preferred to a sum,
    because the terms of a sum may cancel digits.
    """
    roots = [n for _, n in values]
    try:
        points = evaluate_at_points(graph, roots, MERGING_POINTS, dependent_radicands(graph, roots))
    except ZeroDivisionError:
        return list(values)
    classes: dict[tuple[object, ...], list[int]] = {}
    marks: dict[int, int] = {}
    key_of: dict[int, tuple[object, ...]] = {}
    for n in graph.descendants([0, *roots]):
        key = tuple(at.values[n] if n else 1 for at in points)
        marks[n], key_of[n] = _split_sign(key, points) if any(key) else (0, key)
        classes.setdefault(key_of[n], []).append(n)

    def choose(order: Callable[[int], tuple[int, ...]]) -> dict[int, int]:
        chosen = {key: min(members, key=order) for key, members in classes.items()}
        return {n: chosen[key] for n, key in key_of.items()}

    sums_last = choose(lambda n: (level(n), graph.nodes[n].kind == "sum", n))
    done = _rewrite(graph, roots, marks, sums_last)
    if done is None:  # a product contains the sum that it replaces
        done = _rewrite(graph, roots, marks, choose(lambda n: (level(n), n)))
    assert done is not None
    return [scale(c, done[n]) for c, n in values]


def _rewrite(
    graph: Graph, roots: Sequence[int], marks: dict[int, int], representatives: dict[int, int]
) -> dict[int, Value] | None:
    """Rebuild nodes from the representatives; None if these depend on each other in a cycle."""
    done: dict[int, Value] = {n: ZERO for n, mark in marks.items() if not mark}
    open_: set[int] = set()
    work = [n for n in roots if n not in done]
    while work:
        n = work[-1]
        if n in done:
            work.pop()
            continue
        other = representatives[n]
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
            done[n] = rebuild_node(graph, n, done, graph)
        else:
            done[n] = scale(marks[n] * marks[other], done[other])
        open_.discard(n)
        work.pop()
    return done


def _split_sign(
    key: tuple[object, ...], points: Sequence[Evaluation]
) -> tuple[int, tuple[object, ...]]:
    """Return a sign, and a key that a node and its negative share."""
    pairs = zip(key, points, strict=True)
    other = tuple(_negative(x, at.arithmetic.prime) for x, at in pairs)
    return (1, key) if repr(key) <= repr(other) else (-1, other)


def _negative(x: object, prime: int) -> object:
    if isinstance(x, tuple):
        return tuple(-y % prime for y in x)
    assert isinstance(x, int)
    return -x % prime
