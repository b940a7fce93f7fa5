"""Kernels of small systems: a step as straight lines, values known before computed once."""

from __future__ import annotations

from collections.abc import Iterable

import sympy as sp

from symsimpson.codegen.ir import Kernel, Loop, Row, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.linear_solve import solve_blocks, solve_symmetric
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point

__all__ = ["STATE", "lanes", "momentum_stores", "straight_kernels", "velocity"]

#: Levels that a kernel computes which is called on a bare state (q, p).
STATE = (Level.STEP, Level.ITERATION)


def straight_kernels(low: Lowering) -> list[Kernel]:
    """Make the kernels of a step: start, legendre, newton, advance."""
    newton, advance = _newton(low), _advance(low)
    return [_start(low), _legendre(low), newton, advance]


def lanes(body: Iterable[Statement]) -> tuple[Statement, ...]:
    """Wrap statements in the loop over lanes."""
    return (Loop("lane", "LANES", tuple(body)),)


def velocity(
    low: Lowering, point: Point, p: tuple[sp.Expr, ...], section: str
) -> tuple[list[sp.Expr], sp.Expr]:
    """Solve M v = p - a; the second value is negative if M is not positive definite."""
    n, entry = low.n, low.template.entry
    mass = [[entry(point, section, "M", i, j) for j in range(n)] for i in range(n)]
    right = [p[i] - entry(point, section, "a", i) for i in range(n)]
    wishes = [f"v_{name}_{point.suffix}" for name in low.names.coordinates]
    v, pivots = solve_symmetric(low.graph, mass, right, wishes, section)
    define = low.graph.define
    deficits = [define("deficit", d - sp.Abs(d, evaluate=False), section) for d in pivots]
    return v, define("deficit", sp.Add(*deficits), section)


def _node(low: Lowering, i: int, end: Point | None = None) -> Point:
    """Give the point of node i in terms of the increments; ``end`` stands for a node at q1."""
    scheme, define, h = low.equations.scheme, low.graph.define, low.equations.h
    A, B, d = scheme.A[i], scheme.B[i], scheme.degree
    section = f"node {i}"

    def combined(row: tuple[sp.Expr, ...], a: int) -> sp.Expr:
        return sp.Add(*(row[k] * low.increments[k - 1][a] for k in range(1, d + 1)))

    names = list(enumerate(low.names.coordinates))
    v = tuple(define(f"v_{name}_{i}", combined(B, a) / h, section) for a, name in names)
    if low.equations.at_start(i):
        return Point(str(i), low.q, v)
    if end is not None and A[d] == 1 and all(value == 0 for value in A[:d]):
        return Point(end.suffix, end.q, v)
    q = tuple(define(f"{name}_{i}", low.q[a] + combined(A, a), section) for a, name in names)
    return Point(str(i), q, v)


def _newton(low: Lowering) -> Kernel:
    """One Newton iteration for the increments of the control points."""
    eqs, define, n = low.equations, low.graph.define, low.n
    scheme, names = eqs.scheme, low.names.coordinates
    points = [_node(low, i) for i in range(scheme.stages)]

    def entry(i: int, what: str, *index: int) -> sp.Expr:
        if what == "L_v":
            return momentum[i][index[0]]
        return low.template.entry(points[i], f"node {i}", what, *index)

    momentum: list[list[sp.Expr]] = []
    for i, point in enumerate(points):  # all entries of a node together, for the reader
        section = f"node {i}"
        momentum.append(
            [
                define(f"Lv_{name}_{i}", low.template.momentum(point, section, a), section)
                for a, name in enumerate(names)
            ]
        )
        for a in range(n):
            entry(i, "L_q", a)
            for b in range(n):
                entry(i, "L_qv", a, b)
                entry(i, "L_qq", a, b)
    right = []
    for k in eqs.rows:
        for a, name in enumerate(names):
            value = eqs.derivative(k, a, entry) + (low.p[a] if k == 0 else 0)
            right.append(-define(f"R_{k}_{name}", value, "residual D_k L_d"))
    columns = [(m, b) for m in eqs.columns for b in range(n)]
    matrix = [
        [
            define(
                f"J_{k}_{names[a]}_{m}_{names[b]}",
                eqs.second_derivative(k, a, m, b, entry),
                "Jacobian D_m D_k L_d",
            )
            for m, b in columns
        ]
        for k in eqs.rows
        for a in range(n)
    ]
    wishes = [f"d_{name}_X{m}" for m in eqs.columns for name in names]
    found = solve_blocks(low.graph, matrix, right, n, wishes, "elimination")
    stores, corrections, increments = [], [], []
    for position, m in enumerate(eqs.columns):
        for a, name in enumerate(names):
            old, change = low.increments[m - 1][a], found[position * n + a]
            new = define(f"{name}_X{m}_new", old + change, "update")
            stores.append(Store(Row("INCREMENT", (m - 1) * n + a), new, keep=old))
            corrections.append(low.metric[a] * change**2)
            increments.append(low.metric[a] * new**2)
    for block, terms in (
        ("CORRECTION_SQUARED", corrections),
        ("INCREMENT_SQUARED", increments),
    ):
        value = define(block.lower(), sp.Add(*terms), "update")
        stores.append(Store(Row(block, 0), value))
    doc = "One Newton iteration for the increments X_k of the control points."
    return Kernel("newton", doc, lanes(low.statements(stores, (Level.ITERATION,))))


def _advance(low: Lowering) -> Kernel:
    """Close a step and predict the next one."""
    eqs, define, n = low.equations, low.graph.define, low.n
    scheme, names, d = eqs.scheme, low.names.coordinates, eqs.scheme.degree
    stores: list[Store] = []

    def keep(block: str, old: tuple[sp.Symbol, ...], values: list[sp.Expr]) -> None:
        for i, value in enumerate(values):
            stores.append(Store(Row(block, i), value, keep=old[i]))

    q = [low.compensated(names[a], low.q[a], low.q_low[a], low.increments[-1][a]) for a in range(n)]
    end = Point("end", tuple(new for new, _ in q))
    points = [_node(low, i, end) for i in range(scheme.stages)]

    def entry(i: int, what: str, *index: int) -> sp.Expr:
        return low.template.entry(points[i], f"node {i}", what, *index)

    for i in range(scheme.stages):
        for a in range(n):
            entry(i, "L_q", a)
    p = [
        low.compensated(f"p_{names[a]}", low.p[a], low.p_low[a], eqs.impulse(a, entry))
        for a in range(n)
    ]
    section = "velocity at q1"
    v, _ = velocity(low, end, tuple(new for new, _ in p), section)
    metric = [low.template.entry(end, section, "M", a, a) for a in range(n)]
    section = "predictor"
    surprise = [
        low.metric[a] * (low.increments[k][a] - low.predicted[k][a]) ** 2
        for k in range(d)
        for a in range(n)
    ]
    increments: list[list[sp.Expr]] = [[] for _ in range(d)]
    mismatch = []
    for a, name in enumerate(names):
        slope = sp.Add(*(scheme.end_slope[j] * low.increments[j][a] for j in range(d)))
        bend = define(f"bend_{name}", eqs.h * v[a] - slope, section)
        mismatch.append(metric[a] * bend**2)
        for k in range(d):
            terms = [scheme.extrapolation[k][j] * low.increments[j][a] for j in range(d)]
            value = sp.Add(scheme.correction[k] * bend, *terms)
            increments[k].append(define(f"{name}_X{k + 1}_next", value, section))
    state = (*low.q, *low.q_low, *low.p, *low.p_low)
    predicted = [value for values in low.predicted for value in values]
    stores += [Store(Row("PREVIOUS", i), old) for i, old in enumerate((*state, *predicted))]
    solved = [value for values in low.increments for value in values]
    stores += [Store(Row("SOLVED", i), value) for i, value in enumerate(solved)]
    keep("POSITION", low.q, [new for new, _ in q])
    keep("POSITION_LOW", low.q_low, [rest for _, rest in q])
    keep("MOMENTUM", low.p, [new for new, _ in p])
    keep("MOMENTUM_LOW", low.p_low, [rest for _, rest in p])
    for k in range(d):
        for a in range(n):
            row = Row("INCREMENT", k * n + a)
            stores.append(Store(row, increments[k][a], keep=low.increments[k][a]))
            row = Row("PREDICTED", k * n + a)
            stores.append(Store(row, increments[k][a], keep=low.predicted[k][a]))
    keep("VELOCITY", low.v, v)
    keep("METRIC", low.metric, metric)
    for name, terms in (("mismatch_squared", mismatch), ("surprise_squared", surprise)):
        stores.append(Store(Row(name.upper(), 0), define(name, sp.Add(*terms), section)))
    low.statements(stores, (Level.ITERATION,))  # finds out what else must be kept for a step
    to = dict(zip((*low.q, *low.p), (*end.q, *(new for new, _ in p)), strict=True))
    to |= dict(zip(low.metric, metric, strict=True))
    for symbol, row in low.hoisted_at(Level.STEP):
        stores.append(Store(row, low.moved(symbol, to), keep=symbol))
    doc = "Close a step: p1 and q1 by compensated sums, then predict the next increments."
    return Kernel("advance", doc, lanes(low.statements(stores, (Level.ITERATION,))))


def _start(low: Lowering) -> Kernel:
    """From q and p to the first increments."""
    eqs, define, n = low.equations, low.graph.define, low.n
    point, section = low.start_point(), "velocity"
    v, deficit = velocity(low, point, low.p, section)
    stores = [Store(row, symbol) for symbol, row in low.hoisted_at(Level.STEP)]
    for a, name in enumerate(low.names.coordinates):
        stores.append(Store(Row("VELOCITY", a), v[a]))
        metric = low.template.entry(point, section, "M", a, a)
        stores.append(Store(Row("METRIC", a), metric))
        for k in range(1, eqs.scheme.degree + 1):
            increment = eqs.scheme.points[k] * eqs.h * v[a]
            value = define(f"{name}_X{k}_first", increment, section)
            stores.append(Store(Row("INCREMENT", (k - 1) * n + a), value))
            stores.append(Store(Row("PREDICTED", (k - 1) * n + a), value))
    stores.append(Store(Row("MASS_PIVOT", 0), deficit))
    doc = "Begin at (q, p): what depends on q alone, and increments of constant velocity."
    return Kernel("start", doc, lanes(low.statements(stores, STATE)))


def _legendre(low: Lowering) -> Kernel:
    """The momentum of a velocity."""
    point = Point(low.start_point().suffix, low.q, low.v)
    stores = momentum_stores(low, point)
    return Kernel("legendre", "p = dL/dv from q and v.", lanes(low.statements(stores, STATE)))


def momentum_stores(low: Lowering, point: Point) -> list[Store]:
    """Store p = M v + a at a point."""
    section = "momentum"
    return [
        Store(
            Row("MOMENTUM", a),
            low.graph.define(f"p_{name}_of_v", low.template.momentum(point, section, a), section),
        )
        for a, name in enumerate(low.names.coordinates)
    ]
