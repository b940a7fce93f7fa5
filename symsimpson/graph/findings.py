"""Dependence of values on symbols, found by moving these in a finite field.

That something moves is a proof; that it does not is an identity test at two points, whose error is
below 2^-100. What is made of functions of which the field knows nothing counts as moving.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from symsimpson.graph.field import Element, Evaluation, PrimeField
from symsimpson.graph.merge import evaluations
from symsimpson.graph.nodes import ZERO, Graph, Value
from symsimpson.graph.rebuild import fixed
from symsimpson.graph.roots import dependent_radicands, radicands

POINTS = 2
#: Functions that a field knows as well as algebra does.
KNOWN = frozenset(["sin", "cos", "exp", "sinh", "cosh", "tanh"])


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
        self._moved: dict[tuple[int, int], set[int]] = {}
        self._known_opaque: dict[int, bool] = {}

    def vanishes(self, value: Value) -> bool:
        """Return whether a value is zero."""
        return not value[0] or all(not at.values[value[1]] for at in self.points)

    def equal(self, first: Value, second: Value) -> bool:
        """Return whether two values are the same."""
        return all(at[first] == at[second] for at in self.points)

    def _moved_at(self, number: int, x: int) -> set[int]:
        if (number, x) not in self._moved:
            self._moved[number, x] = self.points[number].depending_on(x)
        return self._moved[number, x]

    def depends(self, value: Value, x: int) -> bool:
        """Return whether a value depends on a symbol."""
        if not value[0] or x not in self._graph.nodes[value[1]].symbols:
            return False
        return any(value[1] in self._moved_at(number, x) for number in range(POINTS))

    def idle(self, value: Value, symbols: Iterable[int]) -> list[int]:
        """List the symbols that stand in a value which does not depend on them."""
        present = self._graph.nodes[value[1]].symbols
        return [x for x in symbols if x in present and not self.depends(value, x)]

    def freed(self, value: Value, symbols: Iterable[int]) -> Value:
        """Write a value without the symbols that it does not depend on, where that can be."""
        if self.vanishes(value):
            return ZERO
        for x in self.idle(value, symbols):
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
