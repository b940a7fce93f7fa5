"""The derivative of a step written out, line by line, for small systems.

All its columns are solved with one elimination, in the order of Newton's method; then variations
are multiplied by it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import sympy as sp

from symsimpson.codegen.coupled import node_point
from symsimpson.codegen.ir import Call, Kernel, Load, Loop, Row, Section, Statement, Store, When
from symsimpson.codegen.levels import Level
from symsimpson.codegen.linear_solve import solve_blocks
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.codegen.unrolled import increments, lanes, part_solvers

__all__ = ["MOST_TERMS", "is_written", "written_tangent"]

#: More products than this, about two a line, are left to loops.
MOST_TERMS = 4000
#: Where the step that was taken stands, by where the next one does.
_BEFORE = {"POSITION": "PREVIOUS", "INCREMENT": "SOLVED"}


def is_written(low: Lowering) -> bool:
    """Return whether the derivative of a step is written out."""
    eqs, n = low.equations, low.n
    if not eqs.rows or eqs.plain.constraints or not eqs.scheme.exact:
        return False
    size = eqs.unknowns.size
    columns = 2 * n + len(low.varied)
    terms = columns * (size**2 + 2 * eqs.scheme.stages * n**2) + size**3 / 3
    return terms <= MOST_TERMS and len(set(increments(part_solvers(low)))) == size


def written_tangent(low: Lowering) -> Kernel:
    """Return the kernel that carries variations to the end of the step that was taken."""
    stores = [
        Store(Row("DERIVATIVE", j * 2 * low.n + i), entry)
        for j, column in enumerate(_Step(low).columns())
        for i, entry in enumerate(column)
    ]
    levels = (Level.STEP, Level.ITERATION, Level.LATE)
    lines = _taken(low.statements(stores, levels))
    moved = Loop(
        "variation",
        "range(int(W[TANGENTS, lane]))",
        (Call("move_variation", ("W", "variation", "lane")),),
    )
    doc = "Carry variations of the state to the end of the step that was taken."
    return Kernel("tangent", doc, lanes((When((*lines, moved)),)))


def _taken(statements: Iterable[Statement]) -> tuple[Statement, ...]:
    """Load the step that was taken in the place of the next one."""
    found: list[Statement] = []
    for one in statements:
        if isinstance(one, Section):
            found.append(Section(one.title, _taken(one.body)))
        elif isinstance(one, Load) and one.row.block in _BEFORE:
            found.append(Load(one.target, Row(_BEFORE[one.row.block], one.row.index)))
        else:
            found.append(one)
    return tuple(found)


class _Step:
    """The derivatives of (q1, p1) by q0, by p0 and by what is varied."""

    def __init__(self, low: Lowering) -> None:
        self._low, self._eqs, self._n = low, low.equations, low.n
        scheme = low.equations.scheme
        self._nodes = range(scheme.stages)
        self._points: list[Point] = [
            node_point(low, i, range(low.n), moving=True) for i in self._nodes
        ]
        self._unknowns = [(k, a) for k in self._eqs.columns for a in range(low.n)]
        self._matrix = [
            [self._second(k, a, m, b) for m, b in self._unknowns]
            for k in self._eqs.rows
            for a in range(low.n)
        ]

    def columns(self) -> Iterable[list[sp.Expr]]:
        """Return the columns, each of 2 n entries."""
        for b in range(self._n):
            start = [sp.S(int(a == b)) for a in range(2 * self._n)]
            right = [
                sp.Add(*(self._second(k, a, m, b) for m in range(self._eqs.scheme.degree + 1)))
                for k in self._eqs.rows
                for a in range(self._n)
            ]
            direct = [self._impulse(a, b, None) for a in range(self._n)]
            yield self._column(f"q{b}", right, start, direct)
        for b in range(self._n):
            start = [sp.S(int(a == b + self._n)) for a in range(2 * self._n)]
            right = [sp.S(int(k == 0 and a == b)) for k in self._eqs.rows for a in range(self._n)]
            yield self._column(f"p{b}", right, start, [sp.S.Zero] * self._n)
        for name in self._low.varied:
            yield self._by_parameter(name)

    def _by_parameter(self, name: str) -> list[sp.Expr]:
        eqs, weights = self._eqs, self._eqs.scheme.quadrature.weights
        A, B = eqs.scheme.A, eqs.scheme.B

        def entry(what: str, i: int, a: int) -> sp.Expr:
            slope = self._low.slopes.entry(self._points[i], f"node {i}", what, a, name)
            return self._grown(i) * slope

        right = [
            sp.Add(
                *(
                    eqs.h * weights[i] * A[i][k] * entry("F_a", i, a)
                    + weights[i] * B[i][k] * entry("P_a", i, a)
                    for i in self._nodes
                )
            )
            for k in eqs.rows
            for a in range(self._n)
        ]
        direct = [
            sp.Add(*(eqs.h * weights[i] * entry("F_a", i, a) for i in self._nodes))
            for a in range(self._n)
        ]
        return self._column(name, right, [sp.S.Zero] * (2 * self._n), direct)

    def _column(
        self,
        name: str,
        right: Sequence[sp.Expr],
        start: Sequence[sp.Expr],
        direct: Sequence[sp.Expr],
    ) -> list[sp.Expr]:
        """Return a column from dR, from dq0 and dp0, and from what p1 changes by at once."""
        low, n, degree = self._low, self._n, self._eqs.scheme.degree
        define = low.graph.define
        minus = [define(f"R_{name}_{i}", -x, "right sides") for i, x in enumerate(right)]
        hints = [f"d_X{k}_{low.names.coordinates[a]}_{name}" for k, a in self._unknowns]
        found = solve_blocks(low.graph, self._matrix, minus, n, hints, "elimination")
        dX = dict(zip(self._unknowns, found, strict=True))
        end = [start[a] + dX[degree, a] for a in range(n)]
        for a in range(n):
            impulse = sp.Add(*(self._impulse(a, b, k) * x for (k, b), x in dX.items()))
            end.append(low.growth(sp.S.NegativeOne) * (start[n + a] + direct[a] + impulse))
        return [define(f"D_{i}_{name}", x, "derivative of the step") for i, x in enumerate(end)]

    def _second(self, k: int, a: int, m: int, b: int) -> sp.Expr:
        """Return D_m D_k L_d."""

        def entry(i: int, what: str, *index: int) -> sp.Expr:
            return self._grown(i) * self._entry(i, what, *index)

        names = self._low.names.coordinates
        value = self._eqs.second_derivative(k, a, m, b, entry)
        return self._low.graph.define(
            f"J_{k}_{names[a]}_{m}_{names[b]}", value, "Jacobian D_m D_k L_d"
        )

    def _impulse(self, a: int, b: int, k: int | None) -> sp.Expr:
        """Return the derivative of h sum_i b_i F_i by X_k, or by all control points at once."""
        scheme, h = self._eqs.scheme, self._eqs.h
        terms = []
        for i in self._nodes:
            weight = scheme.quadrature.weights[i] * self._grown(i)
            shift, slope = (sp.S.One, sp.S.Zero) if k is None else (scheme.A[i][k], scheme.B[i][k])
            if shift != 0:
                terms.append(h * weight * shift * self._entry(i, "F_q", a, b))
            if slope != 0:
                terms.append(weight * slope * self._entry(i, "F_v", a, b))
        names = self._low.names.coordinates
        hint = f"P_{names[a]}_{'0' if k is None else k}_{names[b]}"
        return self._low.graph.define(hint, sp.Add(*terms), "derivatives of p1 - p0")

    def _entry(self, i: int, what: str, *index: int) -> sp.Expr:
        return self._low.template.entry(self._points[i], f"node {i}", what, *index)

    def _grown(self, i: int) -> sp.Expr:
        return self._low.growth(self._eqs.scheme.quadrature.nodes[i])
