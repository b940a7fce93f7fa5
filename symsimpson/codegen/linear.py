"""Linear forces: a step is a product of shears, with matrices made once a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

from symsimpson.codegen.coupled import Closing, Explicit, end_point
from symsimpson.codegen.expression import Expression, Number
from symsimpson.codegen.linear_solve import solve_symmetric
from symsimpson.codegen.lower import Lowering
from symsimpson.discrete.reductions import Linear
from symsimpson.errors import GenerationError
from symsimpson.graph.derive import Derivatives
from symsimpson.graph.nodes import Exact, Graph, Value, exact
from symsimpson.graph.rebuild import rebuilt

__all__ = ["LinearSolver"]

Vector = dict[int, Expression]


class LinearSolver(Explicit):
    """Kicks p += c(q) and drifts q += D p, symmetric to the last bit, so that a step is symplectic.

    Only entries on and below the diagonal of a matrix are computed; those above are the same
    numbers. Rounded coefficients then give another symplectic step, not a step that drifts.
    """

    def __init__(self, low: Lowering, part: Linear) -> None:
        self._low, self.coordinates = low, part.coordinates
        self._shears = part.shears
        plain, group = low.equations.plain, self.coordinates
        q = plain.numbers(plain.q)
        derivatives = Derivatives(plain.graph)
        slope = {a: derivatives(plain.V, q[a]) for a in group}
        second = {(a, b): derivatives(slope[a], q[b]) for a in group for b in group}
        masses = {(a, b): plain.entry(a, b) for a in group for b in group}
        values = [*masses.values(), *second.values(), *slope.values()]
        at, point_values = _somewhere(plain.graph, values, q)
        constants = iter([low.known(value) for value in point_values])
        self._M = {place: next(constants) for place in masses}
        self._K = {place: next(constants) for place in second}
        self._f = {
            a: low.graph.total([-next(constants), *(self._K[a, b] * at for b in group)])
            for a in group
        }

    def close(self) -> Closing:
        """Return q1 - q0, after all shears but the last, and p1 - p0 with the last, at q1."""
        low = self._low
        q: Vector = {a: low.q[a] for a in self.coordinates}
        moved: Vector = dict.fromkeys(self.coordinates, low.graph.of(0))
        impulse: Vector = dict.fromkeys(self.coordinates, low.graph.of(0))
        p: Vector = {a: low.p[a] for a in self.coordinates}
        for number, (is_kick, coefficients) in enumerate(self._shears[:-1]):
            if is_kick:
                change = self._kick(number, coefficients, q)
                self._add(impulse, change, f"kick_{number}")
                p = self._moved(low.p, low.p_low, impulse, f"p_{number}")
            else:
                change = self._drift(coefficients, p)
                self._add(moved, change, f"drift_{number}")
                q = self._moved(low.q, low.q_low, moved, f"q_{number}")
        end = end_point(low, moved)
        # products of shears are symmetric: the last kick is the first one
        last = self._kick(0, self._shears[-1][1], {a: end.q[a] for a in self.coordinates})
        self._add(impulse, last, f"kick_{len(self._shears) - 1}")
        return Closing(moved, impulse)

    def _add(self, total: Vector, change: Vector, hint: str) -> None:
        for a in self.coordinates:
            named = self._define(f"{hint}_{self._low.names.coordinates[a]}", change[a])
            total[a] = total[a] + named

    def _moved(
        self, old: Sequence[Expression], rest: Sequence[Expression], change: Vector, hint: str
    ) -> Vector:
        """Round the exact value: a shear by a function of that is symplectic, rounded or not."""
        small = {a: self._define(f"{hint}_{a}_step", rest[a] + change[a]) for a in self.coordinates}
        return {a: self._define(f"{hint}_{a}", old[a] + small[a]) for a in self.coordinates}

    def _define(self, hint: str, value: Expression) -> Expression:
        return self._low.graph.define(hint, value, "shears")

    def _kick(self, number: int, c: tuple[Number, Number], q: Vector) -> Vector:
        """Apply (1/h) M (c1 z + c2 z^2) q with z q = -h^2 M^-1 (f - K q)."""
        h, group, total = self._low.h, self.coordinates, self._low.graph.total
        steps = {b: self._solve(self._M, [self._K[a, b] for a in group], "K") for b in group}
        shift = self._solve(self._M, [self._f[a] for a in group], "f")

        def through(a: int, column: list[Expression]) -> Expression:
            """Return row a of K times a column."""
            return total(self._K[a, b] * x for b, x in zip(group, column, strict=True))

        kicks: Vector = {}
        matrix: dict[tuple[int, int], Expression] = {}
        for a in group:
            constant = -(h * self._f[a] * c[0] + h**3 * through(a, shift) * c[1])
            for b in group:
                if b <= a:
                    value = h * self._K[a, b] * c[0] + h**3 * through(a, steps[b]) * c[1]
                    matrix[a, b] = matrix[b, a] = self._define(f"kick_{number}_{a}_{b}", value)
            kicks[a] = self._define(f"kick_{number}_{a}", constant)
        return {a: total([kicks[a], *(matrix[a, b] * q[b] for b in group)]) for a in group}

    def _drift(self, coefficients: tuple[Number, Number], p: Vector) -> Vector:
        """Apply b (M/h + e h K)^-1 to p."""
        h, group, graph = self._low.h, self.coordinates, self._low.graph
        start, slope = map(graph.of, coefficients)
        stiff = {
            (a, b): self._define(f"N_{a}_{b}", self._M[a, b] / h + slope * h * self._K[a, b])
            for a in group
            for b in group
        }
        inverse: dict[tuple[int, int], Expression] = {}
        for b in group:
            column = self._solve(stiff, [start if a == b else graph.of(0) for a in group], "drift")
            for a, value in zip(group, column, strict=True):
                if a >= b:
                    inverse[a, b] = inverse[b, a] = value
        return {a: graph.total(inverse[a, b] * p[b] for b in group) for a in group}

    def _solve(
        self, matrix: Mapping[tuple[int, int], Expression], right: list[Expression], hint: str
    ) -> list[Expression]:
        group = self.coordinates
        rows = [[matrix[a, b] for b in group] for a in group]
        hints = [f"{hint}_{a}" for a in group]
        return solve_symmetric(self._low.graph, rows, right, hints, "shears")[0]


def _somewhere(
    graph: Graph, values: Sequence[Value], q: Sequence[int]
) -> tuple[Exact, list[Value]]:
    """Evaluate values at q = 0, or where they are defined if that is nowhere at q = 0."""
    for number in (Fraction(0), Fraction(1), Fraction(2), Fraction(7, 3), Fraction(-5, 11)):
        try:
            point_values = rebuilt(graph, values, dict.fromkeys(q, (number, 0)))
        except ZeroDivisionError:
            continue
        return exact(number), point_values
    raise GenerationError(
        "forces that are linear have no value at any point that was tried.\n"
        "Simplify the potential, or compile with exploit=()."
    )
