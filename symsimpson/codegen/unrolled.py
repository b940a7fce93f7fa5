"""Kernels of small systems: a step written out, values known before computed once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import sympy as sp

from symsimpson.codegen.composed import ComposedSolver
from symsimpson.codegen.coupled import NOTHING, CoupledSolver, Solver
from symsimpson.codegen.ir import Call, Kernel, Loop, Row, Statement, Store, When
from symsimpson.codegen.levels import Level
from symsimpson.codegen.linear import LinearSolver
from symsimpson.codegen.linear_solve import solve_blocks, solve_symmetric
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.routh import RouthSolver
from symsimpson.codegen.separable import SeparableSolver
from symsimpson.codegen.template import Point
from symsimpson.discrete.reductions import Composed, Coupled, Linear, Part, Routh, Separable

__all__ = [
    "ACCEPTANCE",
    "CONVERGENCE",
    "STATE",
    "lanes",
    "momentum_stores",
    "unrolled_kernels",
    "velocity",
]

#: What ends an iteration, and a step.
CONVERGENCE, ACCEPTANCE = (
    Call("check_convergence", ("W", "lane")),
    Call("check_acceptance", ("W", "lane")),
)
#: Levels that a kernel computes which is called on a bare state (q, p).
STATE = (Level.STEP, Level.ITERATION)


_SOLVERS: dict[type, Callable[..., Solver]] = {
    Composed: ComposedSolver,
    Coupled: CoupledSolver,
    Linear: LinearSolver,
    Routh: RouthSolver,
    Separable: SeparableSolver,
}


def unrolled_kernels(low: Lowering) -> list[Kernel]:
    """Make the kernels of a step: start, legendre, newton, advance, newton_pivoted."""
    solvers = [_SOLVERS[type(part)](low, part) for part in low.equations.parts]
    iterated = [_newton(low, solvers)] if unknowns(solvers) else []
    step = [*iterated, _advance(low, solvers)]  # first: it finds out what start must leave
    pivoted = [_pivoted(low, solvers)] if iterated else []
    return [_start(low, solvers), _legendre(low), *step, *pivoted]


def unknowns(solvers: Iterable[Solver]) -> list[tuple[int, int]]:
    """List control point and coordinate of each Newton unknown, part after part."""
    return [unknown for solver in solvers for unknown in solver.unknowns]


def solved(solvers: Iterable[Solver]) -> list[tuple[int, int]]:
    """List control point and coordinate of each increment that an iteration changes."""
    return [x for solver in solvers for x in (*solver.unknowns, *solver.carried)]


def lanes(body: Iterable[Statement]) -> tuple[Statement, ...]:
    """Wrap statements in the loop over lanes."""
    return (Loop("lane", "range(LANES)", tuple(body)),)


def velocity(
    low: Lowering, point: Point, p: Sequence[sp.Expr], section: str, suffix: str | None = None
) -> tuple[list[sp.Expr], sp.Expr]:
    """Solve M v = p - a; the second value is negative if M is not positive definite.

    Velocities have the point's suffix unless another one is given.
    """
    found: dict[int, sp.Expr] = {}
    deficits: list[sp.Expr] = []
    for part in low.equations.parts:
        v, pivots = _velocities(low, point, p, section, _mass_order(part), suffix)
        found |= v
        deficits += [
            low.graph.define("deficit", d - sp.Abs(d, evaluate=False), section)
            for d in pivots
            if not d.is_positive or d.free_symbols  # of others only a run can tell
        ]
    deficit = low.graph.define("deficit", sp.Add(*deficits), section)
    return [found[a] for a in range(low.n)], deficit


def _velocities(
    low: Lowering,
    point: Point,
    p: Sequence[sp.Expr],
    section: str,
    group: Sequence[int],
    suffix: str | None = None,
) -> tuple[dict[int, sp.Expr], list[sp.Expr]]:
    """Solve M v = p - a for a group of coordinates; returns the pivots of L D L^T too."""
    entry = low.template.entry
    mass = [[entry(point, section, "M", i, j) for j in group] for i in group]
    right = [p[i] - entry(point, section, "a", i) for i in group]
    hints = [f"v_{low.names.coordinates[i]}_{suffix or point.suffix}" for i in group]
    v, pivots = solve_symmetric(low.graph, mass, right, hints, section)
    return dict(zip(group, v, strict=True)), pivots


def _newton(low: Lowering, solvers: Sequence[Solver]) -> Kernel:
    """One Newton iteration for the increments of the control points."""
    names = low.names.coordinates
    found: list[sp.Expr] = []
    for solver in solvers:
        right, matrix = solver.system()
        hints = [f"d_{names[a]}_X{m}" for m, a in solver.unknowns]
        size = len(solver.coordinates)
        found += solve_blocks(low.graph, matrix, right, size, hints, "elimination")
    stores = _update(low, solvers, found)
    doc = "One Newton iteration for the increments X_k of the control points."
    return Kernel("newton", doc, lanes((*low.statements(stores, (Level.ITERATION,)), CONVERGENCE)))


def _pivoted(low: Lowering, solvers: Sequence[Solver]) -> Kernel:
    """The same iteration with row pivoting."""
    every = unknowns(solvers)
    stores = []
    first = 0
    for solver in solvers:
        right, matrix = solver.system()
        for i, row in enumerate(matrix):
            stores.append(Store(Row("RESIDUAL", first + i), -right[i]))
            entries = dict.fromkeys(range(len(every)), sp.S.Zero) | dict(enumerate(row, first))
            place = (first + i) * len(every)
            stores += [Store(Row("JACOBIAN", place + j), value) for j, value in entries.items()]
        first += len(right)
    assembled = low.statements(stores, STATE)  # the other iteration may keep other values
    update = _update(low, solvers, [-x for x in low.solution[: len(every)]])
    closing = low.statements(update, (Level.ITERATION,))
    doc = "One Newton iteration with row pivoting, where the fixed order of elimination fails."
    call = Call("solve_pivoted", ("W", "lane"))
    return Kernel("newton_pivoted", doc, lanes((When((*assembled, call, *closing, CONVERGENCE)),)))


def _update(
    low: Lowering, solvers: Sequence[Solver], corrections: Sequence[sp.Expr]
) -> list[Store]:
    """Apply a Newton correction and measure it."""
    define, names = low.graph.define, low.names.coordinates
    changes = dict(zip(unknowns(solvers), corrections, strict=True))
    new = {(m, a): low.increments[m - 1][a] + change for (m, a), change in changes.items()}
    for solver in solvers:
        for (m, a), value in solver.carry(changes).items():
            new[m, a] = value
            changes[m, a] = define(f"d_{names[a]}_X{m}", value - low.increments[m - 1][a], "update")
    stores, squares, increments = [], [], []
    for (m, a), value in new.items():
        named = define(f"{names[a]}_X{m}_new", value, "update")
        row = Row("INCREMENT", (m - 1) * low.n + a)
        stores.append(Store(row, named, keep=low.increments[m - 1][a]))
        squares.append(low.mass_diagonal[a] * changes[m, a] ** 2)
        increments.append(low.mass_diagonal[a] * named**2)
    for block, terms in (
        ("CORRECTION_SQUARED", squares),
        ("INCREMENT_SQUARED", increments),
    ):
        value = define(block.lower(), sp.Add(*terms), "update")
        stores.append(Store(Row(block, 0), value))
    return stores


def _advance(low: Lowering, solvers: Sequence[Solver]) -> Kernel:
    """Close a step and predict the next one."""
    names, every = low.names.coordinates, unknowns(solvers)
    q: dict[int, tuple[sp.Expr, sp.Expr]] = {}
    p: dict[int, tuple[sp.Expr, sp.Expr]] = {}

    def moved(changes: Mapping[int, sp.Expr]) -> None:
        for a, change in changes.items():
            q[a] = low.compensated(names[a], low.q[a], low.q_low[a], change)

    for solver in solvers:
        moved(solver.increments())
    end = Point("end", tuple(q[a][0] if a in q else NOTHING for a in range(low.n)))
    for solver in solvers:
        for a, impulse in solver.impulses(end).items():
            p[a] = low.compensated(f"p_{names[a]}", low.p[a], low.p_low[a], impulse)
        if isinstance(solver, RouthSolver):
            moved(solver.cyclic_increments())
    momentum = tuple(p[a][0] if a in p else low.p[a] for a in range(low.n))
    stores, masses = _predicted(low, solvers, end, momentum) if every else ([], {})
    for block, old, values in (
        ("POSITION", low.q, {a: new for a, (new, _) in q.items()}),
        ("POSITION_LOW", low.q_low, {a: rest for a, (_, rest) in q.items()}),
        ("MOMENTUM", low.p, {a: new for a, (new, _) in p.items()}),
        ("MOMENTUM_LOW", low.p_low, {a: rest for a, (_, rest) in p.items()}),
    ):
        stores += [Store(Row(block, a), values[a], keep=old[a]) for a in sorted(values)]
    low.statements(stores, (Level.ITERATION,))  # finds out what else must be kept for a step
    to = dict(zip((*low.q, *low.p), (*end.q, *momentum), strict=True))
    to |= {low.mass_diagonal[a]: value for a, value in masses.items()}
    for symbol, row in low.hoisted_at(Level.STEP):
        following = low.moved(symbol, to)
        if following != symbol:  # it is made of constant momenta alone
            stores.append(Store(row, following, keep=symbol))
    body = lanes((*low.statements(stores, (Level.ITERATION,)), *((ACCEPTANCE,) if every else ())))
    if every:
        doc = "Close a step: p1 and q1 by compensated sums, then predict the next increments."
        return Kernel("advance", doc, body)
    doc = "Take as many steps as W[COUNT] says, without Newton's method."
    return Kernel("advance", doc, (Loop("step", "range(int(W[COUNT, 0]))", body),))


def _predicted(
    low: Lowering, solvers: Sequence[Solver], end: Point, momentum: tuple[sp.Expr, ...]
) -> tuple[list[Store], dict[int, sp.Expr]]:
    """Predict the next increments; keep what is needed to accept the step or take it back."""
    eqs, define, n = low.equations, low.graph.define, low.n
    scheme, names, d = eqs.scheme, low.names.coordinates, eqs.scheme.degree
    every = solved(solvers)
    state = (*low.q, *low.q_low, *low.p, *low.p_low)
    stores = [Store(Row("PREVIOUS", i), old) for i, old in enumerate(state)]
    section = "predictor"
    masses: dict[int, sp.Expr] = {}
    jump: list[sp.Expr] = []
    cyclic: list[tuple[sp.Expr, sp.Expr]] = []
    following: dict[tuple[int, int], sp.Expr] = {}
    for part, solver in zip(eqs.parts, solvers, strict=True):
        group = solver.coordinates if solver.unknowns else ()
        v = _velocities(low, end, momentum, "velocity at q1", _mass_order(part))[0]
        path = {a: [low.increments[j][a] for j in range(d)] for a in group}
        slopes: dict[int, sp.Expr] = {}
        if isinstance(part, Routh) and solver.unknowns:
            for a in part.cyclic:
                masses[a] = low.template.entry(end, "velocity at q1", "M", a, a)
        for a in group:
            masses[a] = low.template.entry(end, "velocity at q1", "M", a, a)
            slope = sp.Add(*(scheme.end_slope[j] * path[a][j] for j in range(d)))
            slopes[a] = slope / eqs.h
            bend = define(f"bend_{names[a]}", eqs.h * v[a] - slope, section)
            jump.append(masses[a] * bend**2)
            for k in sorted(m for m, b in every if b == a):
                terms = [scheme.extrapolation[k - 1][j] * path[a][j] for j in range(d)]
                value = sp.Add(scheme.correction[k - 1] * bend, *terms)
                following[k, a] = define(f"{names[a]}_X{k}_next", value, section)
        if isinstance(solver, RouthSolver) and solver.unknowns:
            cyclic.append(solver.velocity_jump(end, slopes))
    error = [
        low.mass_diagonal[a] * (low.increments[m - 1][a] - low.predicted[m - 1][a]) ** 2
        for m, a in every
    ]  # fmt: skip
    for m, a in sorted(every):
        place, value = (m - 1) * n + a, following[m, a]
        old, guess = low.increments[m - 1][a], low.predicted[m - 1][a]
        stores.append(Store(Row("PREVIOUS", 4 * n + place), guess))
        stores.append(Store(Row("SOLVED", place), old))
        stores.append(Store(Row("INCREMENT", place), value, keep=old))
        stores.append(Store(Row("PREDICTED", place), value, keep=guess))
    stores += [Store(Row("MASS_DIAGONAL", a), masses[a], keep=low.mass_diagonal[a]) for a in masses]
    measured = {"velocity_jump_squared": jump, "prediction_error_squared": error}
    if cyclic:
        measured["cyclic_jump_squared"] = [squared for squared, _ in cyclic]
        measured["cyclic_mass_change"] = [spread for _, spread in cyclic]
    for name, terms in measured.items():
        stores.append(Store(Row(name.upper(), 0), define(name, sp.Add(*terms), section)))
    return stores, masses


def _mass_order(part: Part) -> tuple[int, ...]:
    """List the coordinates that M couples in a part, cyclic ones first.

    In L D L^T what comes last is found first, and nothing else is computed.
    """
    return (*(part.cyclic if isinstance(part, Routh) else ()), *part.coordinates)


def _start(low: Lowering, solvers: Sequence[Solver]) -> Kernel:
    """From q and p to the first increments."""
    eqs, define, n = low.equations, low.graph.define, low.n
    point, section = low.start_point(), "velocity"
    v, deficit = velocity(low, point, low.p, section)
    every = solved(solvers)
    stores = [Store(row, symbol) for symbol, row in low.hoisted_at(Level.STEP)]
    for a, name in enumerate(low.names.coordinates):
        stores.append(Store(Row("VELOCITY", a), v[a]))
        masses = low.template.entry(point, section, "M", a, a)
        if any(b == a for _, b in every):
            stores.append(Store(Row("MASS_DIAGONAL", a), masses))
        for k in range(1, eqs.scheme.degree + 1):
            if (k, a) in every:
                increment = eqs.scheme.points[k] * eqs.h * v[a]
                value = define(f"{name}_X{k}_first", increment, section)
                stores.append(Store(Row("INCREMENT", (k - 1) * n + a), value))
                stores.append(Store(Row("PREDICTED", (k - 1) * n + a), value))
    stores.append(Store(Row("MASS_PIVOT", 0), deficit))
    more = ", and increments of constant velocity" if every else ""
    doc = f"Begin at (q, p): what depends on q alone{more}."
    return Kernel("start", doc, lanes(low.statements(stores, STATE)))


def _legendre(low: Lowering) -> Kernel:
    """The momentum of a velocity."""
    point = Point(f"{low.start_point().suffix}_given", low.q, low.v)
    stores = momentum_stores(low, point)
    return Kernel("legendre", "p = dL/dv from q and v.", lanes(low.statements(stores, STATE)))


def momentum_stores(low: Lowering, point: Point) -> list[Store]:
    """Store p = M v + a at a point."""
    section = "momentum"
    return [
        Store(
            Row("MOMENTUM", a),
            low.graph.define(f"p_{name}_of_v", low.template.entry(point, section, "P", a), section),
        )
        for a, name in enumerate(low.names.coordinates)
    ]
