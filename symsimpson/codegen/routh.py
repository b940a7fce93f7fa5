"""Discrete Routh reduction: cyclic coordinates solved for linearly inside each iteration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from math import prod

from symsimpson.codegen.coupled import (
    Closing,
    Increment,
    correction_names,
    end_point,
    end_slope,
    node_point,
)
from symsimpson.codegen.expression import Expression
from symsimpson.codegen.levels import Level
from symsimpson.codegen.linear_solve import solve_in_pairs, solve_symmetric
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.codegen.weighted import WeightedRows, weighted_residual
from symsimpson.discrete.combined_rows import simplified
from symsimpson.discrete.reductions import Routh

__all__ = ["RouthSolver"]

Vector = list[Expression]

#: Stand for the ends of the path among the numbers of nodes.
START, END = -2, -1


@dataclass(frozen=True)
class _Node:
    """A node with M_yy = L D L^T there: D (its diagonal), ``D_inverse``, L, and T = L^-1 L_o.

    ``momentum`` is L^-1 (p - beta) with beta = M_yx v_x + a_y, and then L^-1 (L_vy - beta), which
    is that and what the multipliers have ``added``.
    """

    number: int
    point: Point
    D: Vector
    D_inverse: Vector
    L: list[Vector]
    T: list[Vector]
    momentum: Vector = field(default_factory=list)
    added: Vector = field(default_factory=list)


class RouthSolver:
    """D_k L_d for the other coordinates, at the velocities that the cyclic momenta give."""

    multipliers: tuple[Increment, ...] = ()

    def __init__(self, low: Lowering, part: Routh) -> None:
        self._low, self._part = low, part
        self.coordinates, self.cyclic = part.coordinates, part.cyclic
        self.increments = [(m, a) for m in part.columns for a in part.coordinates]
        self._size = range(len(part.cyclic))
        self._weights, self._total = low.scheme.weights, low.graph.total
        self._multipliers = [(r, c) for r in range(len(part.annihilator)) for c in self._size]

    def corrections(self) -> Mapping[Increment, Expression]:
        """Return what one Newton iteration adds to each increment."""
        low, part, eqs, total = self._low, self._part, self._low.equations, self._total
        define, names = low.graph.define, low.names.coordinates
        nodes = self._solved_nodes(None)
        entry = partial(self._entry, nodes)
        weighted = WeightedRows(low, lambda i, a: entry(i, "F", a), lambda i, a: entry(i, "P", a))
        right = weighted_residual(low, weighted, part.rows, part.coordinates)
        tangent = _Tangent(self, nodes)
        matrix = []
        for k in part.rows:
            for a in part.coordinates:
                row = []
                for m, b in self.increments:
                    fixed = total(eqs.second_derivative(k, a, m, b, entry))
                    name = f"J_{k}_{names[a]}_{m}_{names[b]}"
                    value = fixed + tangent.along((k, a), (m, b))
                    row.append(define(name, value, "Jacobian at constant momenta"))
                matrix.append(row)
        hints = correction_names(low, self.increments)
        corrections = solve_in_pairs(low.graph, matrix, right, hints, "elimination")
        return dict(zip(self.increments, corrections, strict=True))

    def close(self) -> Closing:
        """Return q1 - q0, of cyclic coordinates h sum_i b_i v_y(q_i), and p1 - p0 of the others."""
        low, h = self._low, self._low.h
        dq = {a: low.increments[-1][a] for a in self.coordinates}
        end = end_point(low, dq)
        nodes = self._solved_nodes(end)
        weighted = WeightedRows(low, lambda i, a: self._entry(nodes, i, "F", a))
        dp = {a: weighted.impulse(a) for a in self.coordinates}
        for a in self.cyclic:
            dq[a] = self._total(h * self._weights[n.number] * _velocity(n, a) for n in nodes)
        return Closing(dq, dp, self._checks(nodes, end))

    def _entry(self, nodes: list[_Node], i: int, what: str, *index: int) -> Expression:
        section = f"node {i}, all velocities known"
        return self._low.template.entry(nodes[i].point, section, what, *index)

    def _checks(self, nodes: list[_Node], end: Point) -> Mapping[str, Expression]:
        """Return h^2 d^T M_yy^-1 d, d being what L_vy at the end of the path differs from p_y by.

        Where M_yy changes much within a step, near a pole of spherical angles, the velocities of
        the cyclic coordinates are no polynomial, and d is as large as p. The second value tells
        how much D changes: the sum over its entries of sum_i D_i sum_i 1/D_i less what it is for a
        constant.
        """
        low, last, define, total = self._low, nodes[-1], self._low.graph.define, self._total
        seen = list(nodes)
        if last.point.q == end.q:
            D_inverse, x = last.D_inverse, last.added
        else:
            closing = self._factors(end, END)
            D_inverse, x = closing.D_inverse, self._left(closing, nodes)
            seen += [closing, self._factors(low.start_point(), START)]
        terms = [D_inverse[k] * x[k] ** 2 for k in self._size]
        value = define("cyclic_jump_squared", low.h**2 * total(terms), "predictor")
        products = [
            total(n.D[k] for n in seen) * total(n.D_inverse[k] for n in seen)
            for k in self._size
            if low.graph.level(seen[0].D[k]) > Level.RUN
        ]
        spread = total(products) - len(seen) ** 2 * len(products)
        change = define("cyclic_mass_change", spread / len(seen) ** 2, "predictor")
        return {"CYCLIC_JUMP_SQUARED": value, "CYCLIC_MASS_CHANGE": change}

    def _left(self, end: _Node, nodes: list[_Node]) -> Vector:
        """Return L^-1 (L_vy - p) at the end of the path, where no node stands."""
        low, part, scheme = self._low, self._part, self._low.equations.scheme
        names, section = low.names.coordinates, "predictor"
        used = range(scheme.stages - scheme.degree, scheme.stages)
        c = scheme.quadrature.nodes
        weights = [
            simplified(prod((1 - c[j]) / (c[i] - c[j]) for j in used if j != i)) for i in used
        ]
        v = list(end.point.v or [low.nothing] * low.n)
        for a in part.coordinates:
            v[a] = end_slope(low, a) / low.h
        for a in part.cyclic:
            velocity = self._total(
                _velocity(nodes[i], a) * w for w, i in zip(weights, used, strict=True)
            )
            v[a] = low.graph.define(f"v_{names[a]}_path", velocity, section)
        point = replace(end.point, suffix=f"{end.point.suffix}_path", v=tuple(v))
        left = [low.template.entry(point, section, "P", a) - low.p[a] for a in part.cyclic]
        return self.forward(end, left, "left")

    def solve(self, nodes: list[_Node], right: Vector, hint: str) -> Vector:
        """Solve for multipliers: sum_i C_ri C_si / b_i T^T D^-1 T."""
        C, S = self._part.annihilator, self._multipliers
        b = self._low.equations.scheme.quadrature.weights

        def entry(r: int, c: int, s: int, e: int) -> Expression:
            return self._total(
                n.T[k][c]
                * n.D_inverse[k]
                * n.T[k][e]
                * simplified(C[r][n.number] * C[s][n.number] / b[n.number])
                for n in nodes
                for k in self._size
            )

        define = self._low.graph.define
        matrix = [
            [define(f"S_{r}{c}_{s}{e}", entry(r, c, s, e), "multipliers") for s, e in S]
            for r, c in S
        ]
        hints = [f"{hint}_{r}_{c}" for r, c in S]
        return solve_symmetric(self._low.graph, matrix, right, hints, "multipliers")[0]

    def project(self, nodes: list[_Node], vectors: list[Vector], hint: str) -> Vector:
        """Return sum_i C_ri T_i^T D_i^-1 x_i for each multiplier."""
        C, define = self._part.annihilator, self._low.graph.define
        return [
            define(
                f"{hint}_{r}_{c}",
                self._total(
                    n.T[k][c] * n.D_inverse[k] * vectors[n.number][k] * C[r][n.number]
                    for n in nodes
                    for k in self._size
                ),
                "multipliers",
            )
            for r, c in self._multipliers
        ]

    def forward(self, node: _Node, vector: Vector, hint: str) -> Vector:
        """Solve L x = vector."""
        solution: Vector = []
        for r in self._size:
            taken = [-term * solution[c] for c in range(r) for term in node.L[r][c].terms]
            rest = self._total([vector[r], *taken])
            solution.append(self._define(f"{hint}{r}", rest, node.number))
        return solution

    def _define(self, hint: str, value: Expression, i: int) -> Expression:
        where = {START: "start", END: "end"}.get(i, str(i))
        section = f"node {i}: cyclic mass L D L^T" if i >= 0 else "predictor"
        return self._low.graph.define(f"{hint}_{where}", value, section)

    def _solved_nodes(self, end: Point | None) -> list[_Node]:
        """Evaluate the nodes and find the velocities of the cyclic coordinates there."""
        part, b = self._part, self._weights
        middle = self._factored(part.reference, end)
        nodes = [self._node(i, end, middle) for i in range(len(b))]
        negative = [[-x for x in node.momentum] for node in nodes]
        right = self.project(nodes, negative, "g")
        multipliers = dict(zip(self._multipliers, self.solve(nodes, right, "lambda"), strict=True))
        closing = end is not None
        return [self._moving(node, multipliers, closing=closing) for node in nodes]

    def _moving(
        self, node: _Node, multipliers: Mapping[tuple[int, int], Expression], *, closing: bool
    ) -> _Node:
        """Complete a node.

        L_vy = p + sum_r C_ri / b_i lambda_r and v_y = L^-T D^-1 L^-1 (L_vy - beta).
        """
        low, C, i = self._low, self._part.annihilator, node.number
        b = low.equations.scheme.quadrature.weights[i]
        section = f"node {i}, all velocities known"
        momentum, added = [], []
        for k in self._size:
            terms = [
                node.T[k][c] * multipliers[r, c] * simplified(C[r][i] / b)
                for r, c in self._multipliers
            ]
            added.append(self._total(terms))
            value = self._total([node.momentum[k], *terms])
            momentum.append(low.graph.define(f"mu{k}_{i}", value, section))
        v = list(node.point.v or ())
        for k in reversed(self._size):
            terms = [-node.L[m][k] * v[self._part.cyclic[m]] for m in self._size if m > k]
            value = self._total([node.D_inverse[k] * momentum[k], *terms])
            a = self._part.cyclic[k]
            v[a] = low.graph.define(f"v_{low.names.coordinates[a]}_{i}", value, section)
        # while a step is closed, velocities differ from those of the iteration under the same names
        suffix = f"{node.point.suffix}_closed" if closing else node.point.suffix
        point = replace(node.point, suffix=suffix, v=tuple(v))
        return replace(node, momentum=momentum, added=added, point=point)

    def _factored(self, i: int, end: Point | None) -> _Node:
        """Return a node with the factors of its cyclic mass matrix."""
        point = node_point(self._low, i, self.coordinates, moving=True, end=end)
        return self._factors(point, i)

    def _factors(self, point: Point, i: int) -> _Node:
        """Factorise the cyclic mass matrix at a node, or at an end of the path."""
        low = self._low
        section = f"node {i}: cyclic mass L D L^T" if i >= 0 else "predictor"

        def factor(what: str, *index: int) -> Expression:
            return low.template.entry(point, section, what, *index)

        cyclic, names = self._part.cyclic, low.names.coordinates
        D = [factor("D", a) for a in cyclic]
        D_inverse = [
            self._define(f"inv_D_{names[a]}", 1 / d, i) for a, d in zip(cyclic, D, strict=True)
        ]
        L = [
            [
                factor("L0", cyclic[r], cyclic[c]) + factor("L", cyclic[r], cyclic[c])
                if c < r
                else low.graph.of(int(r == c))
                for c in self._size
            ]
            for r in self._size
        ]
        identity = [[low.graph.of(int(r == c)) for c in self._size] for r in self._size]
        return _Node(i, point, D, D_inverse, L, identity)

    def _node(self, i: int, end: Point | None, middle: _Node) -> _Node:
        """Return a node with L^-1 (p - beta) and T = 1 + L^-1 (L_o - L)."""
        low, part = self._low, self._part
        node = middle if i == middle.number else self._factored(i, end)
        section = f"node {i}: cyclic mass L D L^T"
        v = node.point.v or ()
        free = []
        for a in part.cyclic:
            beta = [low.template.entry(node.point, section, "a", a)]
            beta += [
                low.template.entry(node.point, section, "M", a, x) * v[x] for x in part.coordinates
            ]
            free.append(low.p[a] - self._total(beta))
        momentum = self.forward(node, free, "free")
        T = [list(row) for row in node.T]
        if node is not middle:
            for c in self._size:
                for r in range(c + 1, len(self._size)):
                    terms = [-node.L[r][k] * T[k][c] for k in range(c + 1, r)]
                    value = self._total([middle.L[r][c], -node.L[r][c], *terms])
                    T[r][c] = self._define(f"T{r}{c}", value, i)
        return replace(node, T=T, momentum=momentum)


def _velocity(node: _Node, a: int) -> Expression:
    assert node.point.v is not None
    return node.point.v[a]


class _Tangent:
    """The part of D_m D_k L_d that comes from the velocities of the cyclic coordinates.

    They change by L^-T D^-1 (C/b T kappa - H) with H = L^-1 (L_vq A + M_yx B / h), where kappa
    keeps them a polynomial of degree d - 1; the Jacobian changes by
    -h sum_i b_i H_k^T D^-1 H_m + h Q_k^T S^-1 Q_m, Q = sum_i C_i T_i^T D_i^-1 H_i.
    """

    def __init__(self, solver: RouthSolver, nodes: list[_Node]) -> None:
        self._solver, self._nodes = solver, nodes
        self._low, self._part = solver._low, solver._part
        self._turned: dict[tuple[int, int], tuple[Vector, Vector]] = {}
        self._projected: dict[tuple[int, int], Vector] = {}
        self._answers: dict[tuple[int, int], Vector] = {}

    def along(self, k: tuple[int, int], m: tuple[int, int]) -> Expression:
        """Return the entry for control points and coordinates k and m."""
        low, size = self._low, range(len(self._part.cyclic))
        h, b = low.h, low.scheme.weights
        terms = []
        for node in self._nodes:
            left, right = self._slope(node, *k), self._slope(node, *m)
            i = node.number
            terms += [-h * b[i] * left[r] * node.D_inverse[r] * right[r] for r in size]
        if self._part.annihilator:
            answer = self._answer(m)
            terms += [h * x * y for x, y in zip(self._project(k), answer, strict=True)]
        return low.graph.total(terms)

    def _slope(self, node: _Node, m: int, b: int) -> Vector:
        """Return H for a control point and a coordinate."""
        i, scheme, h = node.number, self._low.scheme, self._low.h
        A, B = scheme.A[i][m], scheme.B[i][m]
        zero = [self._low.graph.of(0)] * len(self._part.cyclic)
        position = self._parts(node, b)[0] if A != 0 else zero
        velocity = self._parts(node, b)[1] if B != 0 else zero
        return [A * x + B * y / h for x, y in zip(position, velocity, strict=True)]

    def _parts(self, node: _Node, b: int) -> tuple[Vector, Vector]:
        """Return L^-1 L_vq and L^-1 M_yx for a coordinate."""
        i, template = node.number, self._low.template
        if (i, b) not in self._turned:
            section, point = f"node {i}, all velocities known", node.point
            mixed = [template.entry(point, section, "P_q", y, b) for y in self._part.cyclic]
            mass = [template.entry(point, section, "M", y, b) for y in self._part.cyclic]
            name = self._low.names.coordinates[b]
            self._turned[i, b] = (
                self._solver.forward(node, mixed, f"E_{name}_"),
                self._solver.forward(node, mass, f"F_{name}_"),
            )
        return self._turned[i, b]

    def _project(self, m: tuple[int, int]) -> Vector:
        """Return Q for a control point and a coordinate."""
        if m not in self._projected:
            vectors = [self._slope(node, *m) for node in self._nodes]
            hint = f"Q_{m[0]}_{self._low.names.coordinates[m[1]]}"
            self._projected[m] = self._solver.project(self._nodes, vectors, hint)
        return self._projected[m]

    def _answer(self, m: tuple[int, int]) -> Vector:
        """Return S^-1 Q."""
        if m not in self._answers:
            hint = f"kappa_{m[0]}_{self._low.names.coordinates[m[1]]}"
            self._answers[m] = self._solver.solve(self._nodes, self._project(m), hint)
        return self._answers[m]
