"""Constant mass: unknowns without the end point, forces that do not depend on velocities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from symsimpson.codegen.coupled import (
    Closing,
    Increment,
    constant_mass_velocity,
    correction_names,
    end_point,
    impulses,
    node_point,
)
from symsimpson.codegen.expression import Expression
from symsimpson.codegen.linear_solve import solve_in_pairs
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.codegen.weighted import WeightedRows, bend
from symsimpson.discrete.combined_rows import force_factor, inertia_factor, simplified
from symsimpson.discrete.reductions import Separable

__all__ = ["SeparableSolver"]


class SeparableSolver:
    """Rows sum_m S_km M Y_m + h sum_i A_ik (h b_i L_q(q_i)) = 0 of the bends Y, combined by tests.

    Only the matrix is written in combined factors. Of the rows each is evaluated by itself, with
    the same rounded S and A wherever they stand; the one of X_d, too, where that is no unknown.
    """

    cyclic: tuple[int, ...] = ()
    multipliers: tuple[Increment, ...] = ()

    def __init__(self, low: Lowering, part: Separable) -> None:
        self._low, self._part = low, part
        self.coordinates = part.coordinates
        self._unknowns = [(m, a) for m in part.columns for a in part.coordinates]
        end = low.equations.scheme.degree
        follows = part.last is not None and self._unknowns
        self._carried = [(end, a) for a in part.coordinates] if follows else []
        self.increments = [*self._unknowns, *self._carried]

    def corrections(self) -> Mapping[Increment, Expression]:
        """Return what one Newton iteration adds to each increment."""
        if not self._unknowns:
            return {}
        low, part, h = self._low, self._part, self._low.h
        define, names, group = low.graph.define, low.names.coordinates, part.coordinates
        scheme, points, total = low.equations.scheme, self._points(), low.graph.total
        right, matrix = [], []
        for number, test in enumerate(part.tests):
            for a in group:
                terms = [self._row(k, a) * c for k, c in enumerate(test) if c != 0]
                right.append(-define(f"R_{number}_{names[a]}", total(terms), "residual"))
                row = []
                for m, b in self._unknowns:
                    terms = [self._mass(a, b) * inertia_factor(test, scheme, m)]
                    for i, point in points.items():
                        factor = simplified(force_factor(test, scheme, i) * scheme.A[i][m])
                        if factor != 0:
                            slope = low.template.entry(point, f"node {i}", "F_q", a, b)
                            terms.append(h**2 * slope * factor)
                    name = f"J_{number}_{names[a]}_{m}_{names[b]}"
                    row.append(define(name, total(terms), "Jacobian"))
                matrix.append(row)
        hints = correction_names(low, self._unknowns)
        corrections = solve_in_pairs(low.graph, matrix, right, hints, "elimination")
        changes = dict(zip(self._unknowns, corrections, strict=True))
        return changes | self._end_of_path(changes) if self._carried else changes

    def _points(self) -> dict[int, Point]:
        """Return the nodes whose forces enter the rows."""
        tests, scheme = self._part.tests, self._low.equations.scheme
        if self._part.last is not None:
            tests = (*tests, self._part.last_test(scheme.degree))
        return {
            i: node_point(self._low, i, self.coordinates, moving=False)
            for i in range(scheme.stages)
            if any(force_factor(test, scheme, i) != 0 for test in tests)
        }

    def _row(self, k: int, a: int) -> Expression:
        """Return a row by itself, h times D_k L_d."""
        low, h, points = self._low, self._low.h, self._points()
        define, name = low.graph.define, f"R_{k}_{low.names.coordinates[a]}_alone"
        weighted = self._weighted(points)
        if k > 0:
            return define(name, self._inertia(k, a) + h * weighted.row(k, a), "residual")
        moved = self._moved([x[-1] for x in zip(*low.increments, strict=True)], a, "X")
        rows = [self._row(m, a) for m in range(1, low.equations.scheme.degree)]
        value = h * weighted.start(a) - moved - weighted.rest(rows)
        return define(name, value, "residual")

    def _weighted(self, points: Mapping[int, Point]) -> WeightedRows:
        """Return the rows of the forces at some nodes.

        At the end of the path the force is in no row: what it adds to p1 it takes from D_0.
        """

        def force(i: int, a: int) -> Expression:
            if i not in points:
                return self._low.graph.of(0)
            return self._low.template.entry(points[i], f"node {i}", "F", a)

        return WeightedRows(self._low, force)

    def _moved(self, x: Sequence[Expression], a: int, hint: str) -> Expression:
        """Return M x, component a."""
        terms = [self._mass(a, b) * x[b] for b in self.coordinates]
        name = f"M_{self._low.names.coordinates[a]}_{hint}"
        return self._low.graph.define(name, self._low.graph.total(terms), "residual")

    def _inertia(self, k: int, a: int) -> Expression:
        """Return sum_m S_km M Y_m, 0 < k, m < d: straight paths are in none of these rows."""
        low, d = self._low, self._low.equations.scheme.degree
        terms = []
        for m in range(1, d):
            bends = {b: bend(low, m, b) for b in self.coordinates}
            x = [bends.get(b, low.graph.of(0)) for b in range(low.n)]
            terms.append(low.scheme.stiffness[k][m] * self._moved(x, a, f"Y{m}"))
        name = f"inertia_{k}_{low.names.coordinates[a]}"
        return low.graph.define(name, low.graph.total(terms), "residual")

    def _end_of_path(self, changes: Mapping[Increment, Expression]) -> dict[Increment, Expression]:
        """Return the correction of X_d where it is no unknown, from its row, linearised.

        So it takes the values that it would have as an unknown, and the force at the solution need
        not be known before the end of the path is.
        """
        low, last, d = self._low, self._part.last, self._low.equations.scheme.degree
        assert last is not None
        h, scheme, section = low.h, low.equations.scheme, "end of the path"
        total, stiffness = low.graph.total, scheme.stiffness
        names, group = low.names.coordinates, self.coordinates
        test = self._part.last_test(d)
        impulses = []
        for a in group:
            terms = [self._row(last, a)]
            for i, point in self._points().items():
                factor = force_factor(test, scheme, i)
                if factor == 0:
                    continue
                slopes = [
                    low.scheme.A[i][m]
                    * low.template.entry(point, f"node {i}", "F_q", a, b)
                    * changes[m, b]
                    for m, b in self._unknowns
                ]
                terms.append(h**2 * total(slopes) * factor)
            impulses.append(low.graph.define(f"impulse_{names[a]}", total(terms), section))
        moved = constant_mass_velocity(low, group, impulses, "dv", section)
        scale = simplified(-1 / stiffness[last][d])
        corrections: dict[Increment, Expression] = {}
        for number, a in enumerate(group):
            terms = [
                changes[m, a] * simplified(scale * stiffness[last][m]) for m in self._part.columns
            ]
            change = total([moved[number] * scale, *terms])
            corrections[d, a] = low.graph.define(f"d_{names[a]}_X{d}", change, section)
        return corrections

    def close(self) -> Closing:
        """Return q1 - q0 and p1 - p0 = h sum_i b_i L_q(q_i)."""
        dq, low = self._moves(), self._low
        return Closing(dq, impulses(low, self.coordinates, end_point(low, dq), moving=False))

    def _moves(self) -> dict[int, Expression]:
        """Return q1 - q0 at the solution."""
        low = self._low
        if self._part.last is None or self._carried:
            return {a: low.increments[-1][a] for a in self.coordinates}
        # a straight path: h M^-1 (p0 + h b_0 L_q(q0))
        weighted = self._weighted(self._points())
        momenta = [weighted.start(a) for a in self.coordinates]
        v = constant_mass_velocity(low, self.coordinates, momenta, "dv", "end of the path")
        return {a: low.h * x for a, x in zip(self.coordinates, v, strict=True)}

    def _mass(self, a: int, b: int) -> Expression:
        return self._low.template.entry(self._low.start_point(), "mass", "M", a, b)
