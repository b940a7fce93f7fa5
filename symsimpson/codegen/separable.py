"""Constant mass: unknowns without the end point, forces that do not depend on velocities."""

from __future__ import annotations

from collections.abc import Mapping

import sympy as sp

from symsimpson.codegen.coupled import node_point
from symsimpson.codegen.linear_solve import solve_symmetric
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
        self._found: dict[tuple[int, int], sp.Expr] = {}

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

    def increments(self) -> Mapping[int, sp.Expr]:
        """Give q1 - q0 at the solution: X_d by its own row where it is no unknown."""
        low, part, h = self._low, self._part, self._low.equations.h
        scheme, group = low.equations.scheme, part.coordinates
        d, last = scheme.degree, part.last
        self._found = {(m, a): low.increments[m - 1][a] for m, a in self.unknowns}
        if last is not None:
            test = tuple(sp.Integer(k == last) for k in range(d + 1))
            used = [i for i in range(scheme.stages) if self._force_factor(test, i) != 0]
            points = {i: node_point(low, i, group, moving=False) for i in used}
            impulses = []
            for a in group:
                terms = [
                    h * self._force_factor(test, i)
                    * low.template.entry(points[i], f"node {i}", "L_q", a)
                    for i in used
                ]  # fmt: skip
                value = sp.Add(test[0] * low.p[a], *terms)
                name = f"impulse_{low.names.coordinates[a]}"
                impulses.append(low.graph.define(name, value, "end of the path"))
            velocity = self._velocity(impulses)
            scale = sp.radsimp(-1 / scheme.stiffness[last][d])
            for number, a in enumerate(group):
                terms = [
                    sp.radsimp(scale * scheme.stiffness[last][m]) * low.increments[m - 1][a]
                    for m in part.columns
                ]
                value = sp.Add(scale * h * velocity[number], *terms)
                name = f"{low.names.coordinates[a]}_X{d}"
                self._found[d, a] = low.graph.define(name, value, "end of the path")
        return {a: self._found[d, a] for a in group}

    def impulses(self, end: Point) -> Mapping[int, sp.Expr]:
        """Give p1 - p0 = h sum_i b_i L_q(q_i)."""
        low, eqs = self._low, self._low.equations
        points = [
            node_point(low, i, self.coordinates, moving=False, end=end, X=self._found)
            for i in range(eqs.scheme.stages)
        ]

        def entry(i: int, what: str, *index: int) -> sp.Expr:
            return low.template.entry(points[i], f"node {i}", what, *index)

        return {a: eqs.impulse(a, entry) for a in self.coordinates}

    def path_end(self, a: int) -> sp.Expr:
        """Give X_d at the solution."""
        return self._found[self._low.equations.scheme.degree, a]

    def _mass(self, a: int, b: int) -> sp.Expr:
        return self._low.template.entry(self._low.start_point(), "mass", "M", a, b)

    def _velocity(self, momentum: list[sp.Expr]) -> list[sp.Expr]:
        """Solve M v = p with the constant M."""
        group = self.coordinates
        mass = [[self._mass(a, b) for b in group] for a in group]
        wishes = [f"dv_{self._low.names.coordinates[a]}" for a in group]
        return solve_symmetric(self._low.graph, mass, momentum, wishes, "end of the path")[0]
