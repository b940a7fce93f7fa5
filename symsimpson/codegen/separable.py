"""Constant mass: unknowns without the end point, forces that do not depend on velocities."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import sympy as sp

from symsimpson.codegen.coupled import constant_mass_velocity, node_point
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.discrete.reductions import Separable

__all__ = ["SeparableSolver"]


class SeparableSolver:
    """Rows sum_m S_km M X_m / h + h sum_i b_i A_ik L_q(q_i) + p0 [k = 0] = 0, combined by tests."""

    def __init__(self, low: Lowering, part: Separable) -> None:
        self._low, self._part = low, part
        self.coordinates = part.coordinates
        self.unknowns = [(m, a) for m in part.columns for a in part.coordinates]
        end = low.equations.scheme.degree
        carried = part.last is not None and self.unknowns
        self.carried = [(end, a) for a in part.coordinates] if carried else []

    def _force_factor(self, test: tuple[sp.Expr, ...], i: int) -> sp.Expr:
        """Give b_i sum_k test_k A_ik: how often the force at node i enters a row."""
        scheme = self._low.equations.scheme
        weight = scheme.quadrature.weights[i]
        return sp.radsimp(weight * sp.Add(*(c * x for c, x in zip(test, scheme.A[i], strict=True))))

    def _inertia_factor(self, test: tuple[sp.Expr, ...], m: int) -> sp.Expr:
        """Give sum_k test_k S_km."""
        stiffness = self._low.equations.scheme.stiffness
        return sp.radsimp(sp.expand(sp.Add(*(c * stiffness[k][m] for k, c in enumerate(test)))))

    def system(self) -> tuple[list[sp.Expr], list[list[sp.Expr]]]:
        """Give right-hand side and matrix of a Newton iteration."""
        low, part, h = self._low, self._part, self._low.equations.h
        define, names, group = low.graph.define, low.names.coordinates, part.coordinates
        scheme = low.equations.scheme
        used = [
            i
            for i in range(scheme.stages)
            if any(self._force_factor(test, i) != 0 for test in part.tests)
        ]
        points = {i: node_point(low, i, group, moving=False) for i in used}

        def entry(i: int, what: str, *index: int) -> sp.Expr:
            return low.template.entry(points[i], f"node {i}", what, *index)

        for i in used:
            for a in group:
                entry(i, "L_q", a)
                for b in group:
                    entry(i, "L_qq", a, b)
        right, matrix = [], []
        mass = {(a, b): self._mass(a, b) for a in group for b in group}
        for number, test in enumerate(part.tests):
            for a in group:
                terms = [test[0] * low.p[a]]
                for m in part.columns:
                    factor = self._inertia_factor(test, m) / h
                    terms += [factor * mass[a, b] * low.increments[m - 1][b] for b in group]
                terms += [h * self._force_factor(test, i) * entry(i, "L_q", a) for i in used]
                residual = define(f"R_{number}_{names[a]}", sp.Add(*terms), "residual")
                right.append(-residual)
                row = []
                for m, b in self.unknowns:
                    terms = [self._inertia_factor(test, m) * mass[a, b] / h]
                    for i in used:
                        factor = sp.radsimp(self._force_factor(test, i) * scheme.A[i][m])
                        if factor != 0:
                            terms.append(h * factor * entry(i, "L_qq", a, b))
                    name = f"J_{number}_{names[a]}_{m}_{names[b]}"
                    row.append(define(name, sp.Add(*terms), "Jacobian"))
                matrix.append(row)
        return right, matrix

    def carry(
        self, changes: Mapping[tuple[int, int], sp.Expr]
    ) -> Mapping[tuple[int, int], sp.Expr]:
        """Give the new X_d where it is no unknown, from its row with the force linearised.

        So it takes the values that it would have as an unknown, and the force at the solution need
        not be known before the end of the path is.
        """
        if not self.carried:
            return {}
        low = self._low
        scheme, section = low.equations.scheme, "end of the path"

        def force(i: int, point: Point, a: int) -> sp.Expr:
            terms = [low.template.entry(point, f"node {i}", "L_q", a)]
            for m, b in self.unknowns:
                slope = low.template.entry(point, f"node {i}", "L_qq", a, b)
                terms.append(scheme.A[i][m] * slope * changes[m, b])
            return low.graph.define(
                f"Lq_{low.names.coordinates[a]}_{i}_new", sp.Add(*terms), section
            )

        new = {(m, b): low.increments[m - 1][b] + changes[m, b] for m, b in self.unknowns}
        return self._end_of_path(force, new)

    def increments(self) -> Mapping[int, sp.Expr]:
        """Give q1 - q0 at the solution."""
        low, d = self._low, self._low.equations.scheme.degree
        if self._part.last is None or self.carried:
            return {a: low.increments[d - 1][a] for a in self.coordinates}

        def force(i: int, point: Point, a: int) -> sp.Expr:
            return low.template.entry(point, f"node {i}", "L_q", a)

        return {a: value for (_, a), value in self._end_of_path(force, {}).items()}

    def _end_of_path(
        self,
        force: Callable[[int, Point, int], sp.Expr],
        X: Mapping[tuple[int, int], sp.Expr],
    ) -> dict[tuple[int, int], sp.Expr]:
        """Solve the row left over for X_d."""
        low, h, last = self._low, self._low.equations.h, self._part.last
        assert last is not None
        scheme, group, section = low.equations.scheme, self.coordinates, "end of the path"
        d = scheme.degree
        test = tuple(sp.Integer(k == last) for k in range(d + 1))
        used = [i for i in range(scheme.stages) if self._force_factor(test, i) != 0]
        points = {i: node_point(low, i, group, moving=False) for i in used}
        impulses = []
        for a in group:
            terms = [h * self._force_factor(test, i) * force(i, points[i], a) for i in used]
            name = f"impulse_{low.names.coordinates[a]}"
            impulses.append(low.graph.define(name, sp.Add(test[0] * low.p[a], *terms), section))
        velocity = constant_mass_velocity(low, group, impulses, "dv", section)
        scale = sp.radsimp(-1 / scheme.stiffness[last][d])
        found: dict[tuple[int, int], sp.Expr] = {}
        for number, a in enumerate(group):
            terms = [
                sp.radsimp(scale * scheme.stiffness[last][m]) * X[m, a] for m in self._part.columns
            ]
            value = sp.Add(scale * h * velocity[number], *terms)
            name = f"{low.names.coordinates[a]}_X{d}_new"
            found[d, a] = low.graph.define(name, value, section)
        return found

    def impulses(self, end: Point) -> Mapping[int, sp.Expr]:
        """Give p1 - p0 = h sum_i b_i L_q(q_i)."""
        low, eqs = self._low, self._low.equations
        points = [
            node_point(low, i, self.coordinates, moving=False, end=end)
            for i in range(eqs.scheme.stages)
        ]

        def entry(i: int, what: str, *index: int) -> sp.Expr:
            return low.template.entry(points[i], f"node {i}", what, *index)

        return {a: eqs.impulse(a, entry) for a in self.coordinates}

    def _mass(self, a: int, b: int) -> sp.Expr:
        return self._low.template.entry(self._low.start_point(), "mass", "M", a, b)
