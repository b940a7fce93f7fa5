"""A part's share of a step: what all parts have in common, and the general one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import sympy as sp

from symsimpson.codegen.linear_solve import solve_symmetric
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.codegen.weighted import WeightedRows, bend, unit_row, weighted_residual
from symsimpson.discrete.reductions import Coupled

__all__ = ["CoupledSolver", "Explicit", "Solver", "constant_mass_velocity", "node_point"]

#: Stands where a point must not be asked for a coordinate of another part.
NOTHING = sp.Symbol("nothing", real=True)


class Solver(Protocol):
    """What a part contributes to the kernels of a step."""

    @property
    def coordinates(self) -> Sequence[int]:
        """The part's coordinates, without cyclic ones."""
        ...

    @property
    def unknowns(self) -> Sequence[tuple[int, int]]:
        """Control point and coordinate of each Newton unknown."""
        ...

    @property
    def carried(self) -> Sequence[tuple[int, int]]:
        """The same of increments that follow from them in each iteration."""
        ...

    def system(self) -> tuple[list[sp.Expr], list[list[sp.Expr]]]:
        """Return right-hand side and matrix of a Newton iteration."""
        ...

    def carry(
        self, changes: Mapping[tuple[int, int], sp.Expr]
    ) -> Mapping[tuple[int, int], sp.Expr]:
        """Return the new values of what is carried, from the changes of the unknowns."""
        ...

    def increments(self) -> Mapping[int, sp.Expr]:
        """Return q1 - q0 at the solution."""
        ...

    def impulses(self, end: Point) -> Mapping[int, sp.Expr]:
        """Return p1 - p0 at the solution, where it is not zero; ``end`` is q1."""
        ...


class Explicit:
    """What parts have in common whose steps need no equations to be solved."""

    unknowns: tuple[tuple[int, int], ...] = ()
    carried: tuple[tuple[int, int], ...] = ()

    def system(self) -> tuple[list[sp.Expr], list[list[sp.Expr]]]:
        """Return nothing to solve."""
        return [], []

    def carry(
        self, changes: Mapping[tuple[int, int], sp.Expr]
    ) -> Mapping[tuple[int, int], sp.Expr]:
        """Return nothing: no increment is left over."""
        return {}


def constant_mass_velocity(
    low: Lowering, group: Sequence[int], momentum: Sequence[sp.Expr], hint: str, section: str
) -> list[sp.Expr]:
    """Solve M v = p for coordinates whose M is constant; velocities are named after the hint."""
    start = low.start_point()
    mass = [[low.template.entry(start, "mass", "M", a, b) for b in group] for a in group]
    hints = [f"{hint}_{low.names.coordinates[a]}" for a in group]
    return solve_symmetric(low.graph, mass, momentum, hints, section)[0]


def node_point(
    low: Lowering, i: int, coordinates: Sequence[int], *, moving: bool, end: Point | None = None
) -> Point:
    """Return the point of node i in terms of the increments; ``end`` stands for a node at q1.

    Velocities are there if it is ``moving``.
    """
    scheme, define, h = low.equations.scheme, low.graph.define, low.equations.h
    A, B, d = scheme.A[i], scheme.B[i], scheme.degree
    section, names = f"node {i}", low.names.coordinates

    def combined(row: tuple[sp.Expr, ...], a: int) -> sp.Expr:
        return sp.Add(*(row[k] * bend(low, k, a) for k in range(1, d) if row[k] != 0))

    v = [NOTHING] * low.n
    if moving:
        for a in coordinates:
            slope = low.increments[-1][a] + combined(B, a)
            v[a] = define(f"v_{names[a]}_{i}", slope / h, section)
    if low.equations.at_start(i):
        return Point(str(i), low.q, tuple(v))
    if end is not None and A[d] == 1 and all(value == 0 for value in A[:d]):
        return Point(end.suffix, end.q, tuple(v))
    q = [NOTHING] * low.n
    place = unit_row(A)
    for a in coordinates:
        if place is None:
            shift = scheme.quadrature.nodes[i] * low.increments[-1][a] + combined(A, a)
        else:
            shift = low.increments[place - 1][a]
        q[a] = define(f"{names[a]}_{i}", low.q[a] + shift, section)
    return Point(str(i), tuple(q), tuple(v))


class CoupledSolver:
    """All increments are unknowns: D_k L_d = 0 for 0 < k < d and p0 + D_0 L_d = 0."""

    carried: tuple[tuple[int, int], ...] = ()

    def __init__(self, low: Lowering, part: Coupled) -> None:
        self._low, self._part = low, part
        self.coordinates = part.coordinates
        self.unknowns = [(m, a) for m in part.columns for a in part.coordinates]

    def system(self) -> tuple[list[sp.Expr], list[list[sp.Expr]]]:
        """Return right-hand side and matrix of a Newton iteration."""
        low, part, eqs = self._low, self._part, self._low.equations
        define, names, group = low.graph.define, low.names.coordinates, part.coordinates
        stages = range(eqs.scheme.stages)
        points = [node_point(low, i, group, moving=True) for i in stages]

        def entry(i: int, what: str, *index: int) -> sp.Expr:
            return low.template.entry(points[i], f"node {i}", what, *index)

        for i in stages:  # all entries of a node together, for the reader
            for a in group:
                entry(i, "P", a)
                entry(i, "F", a)
                for b in group:
                    for what in ("F_q", "F_v", "P_q"):
                        entry(i, what, a, b)
        weighted = WeightedRows(low, lambda i, a: entry(i, "F", a), lambda i, a: entry(i, "P", a))
        right = weighted_residual(low, weighted, part.rows, group)
        matrix = [
            [
                define(
                    f"J_{k}_{names[a]}_{m}_{names[b]}",
                    eqs.second_derivative(k, a, m, b, entry),
                    "Jacobian D_m D_k L_d",
                )
                for m, b in self.unknowns
            ]
            for k in part.rows
            for a in group
        ]
        return right, matrix

    def carry(
        self, changes: Mapping[tuple[int, int], sp.Expr]
    ) -> Mapping[tuple[int, int], sp.Expr]:
        """Return nothing: every increment is an unknown."""
        return {}

    def increments(self) -> Mapping[int, sp.Expr]:
        """Return q1 - q0 at the solution."""
        return {a: self._low.increments[-1][a] for a in self.coordinates}

    def impulses(self, end: Point) -> Mapping[int, sp.Expr]:
        """Return p1 - p0 = h sum_i b_i L_q(q_i, v_i)."""
        low, eqs = self._low, self._low.equations
        points = [
            node_point(low, i, self.coordinates, moving=True, end=end)
            for i in range(eqs.scheme.stages)
        ]

        def entry(i: int, what: str, *index: int) -> sp.Expr:
            return low.template.entry(points[i], f"node {i}", what, *index)

        for i in range(eqs.scheme.stages):
            for a in self.coordinates:
                entry(i, "F", a)
        weighted = WeightedRows(low, lambda i, a: entry(i, "F", a))
        return {a: weighted.impulse(a) for a in self.coordinates}
