"""Kernels of small systems: a step written out, values known before computed once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from symsimpson.codegen.affine import AffineSolver
from symsimpson.codegen.composed import ComposedSolver
from symsimpson.codegen.constrained import ConstrainedSolver, held_velocities
from symsimpson.codegen.coupled import (
    CoupledSolver,
    Increment,
    Solver,
    end_of,
    end_slope,
    newton_rows,
    node_point,
)
from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Call, Function, IfActive, Kernel, Loop, Row, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.linear import LinearSolver
from symsimpson.codegen.linear_solve import solve_symmetric
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.pivots import begun_pivots, least_pivot
from symsimpson.codegen.routh import RouthSolver
from symsimpson.codegen.separable import SeparableSolver
from symsimpson.codegen.template import Point
from symsimpson.discrete.reductions import (
    Affine,
    Composed,
    Constrained,
    Coupled,
    Linear,
    Routh,
    Separable,
)

__all__ = [
    "SOLVERS",
    "STATE",
    "acceptance",
    "convergence",
    "energy_stores",
    "increments",
    "lanes",
    "legendre",
    "momentum_stores",
    "part_solvers",
    "step_equations",
    "unrolled_kernels",
    "velocity",
]

#: What a step that is taken back begins with again.
KEEP_STEP = Call("keep_step")
#: Levels that a kernel computes which is called on a bare state (q, p).
STATE = (Level.STEP, Level.ITERATION)

ITERATION = "One Newton iteration for the increments X_k of the control points."

#: Which solver a kind of part has.
SOLVERS: dict[type, Callable[..., Solver]] = {
    Affine: AffineSolver,
    Composed: ComposedSolver,
    Constrained: ConstrainedSolver,
    Coupled: CoupledSolver,
    Linear: LinearSolver,
    Routh: RouthSolver,
    Separable: SeparableSolver,
}


def unrolled_kernels(low: Lowering, equations: Function | None) -> list[Kernel]:
    """Make the kernels of a step: start, legendre, newton, advance.

    Newton's method solves these equations, if they are given; else those of each part.
    """
    solvers = part_solvers(low)
    newton = []
    if equations is not None:
        newton = [_newton_of(equations)]
    elif increments(solvers):
        newton = [_newton(low, solvers)]
    step = [*newton, _advance(low, solvers)]
    # what they need of the left node is known before them: it is kept from step to step
    return [_start(low, solvers, low.hoisted_at(Level.STEP)), legendre(low), *step]


def step_equations(low: Lowering, computed: Iterable[Level]) -> Function:
    """Write out the equations of a step; values of other levels are known before."""
    eqs, every = low.equations, range(low.n)
    low.graph.asked.clear()
    points = [node_point(low, i, every, moving=True) for i in range(eqs.scheme.stages)]
    unknowns = [(m, a) for m in eqs.columns for a in every]
    matrix, right = newton_rows(low, points, eqs.rows, unknowns, every)
    size = len(unknowns)
    stores = [Store(Row("RESIDUAL", i), -value) for i, value in enumerate(right)]
    stores += [
        Store(Row("JACOBIAN", i * size + j), value)
        for i, row in enumerate(matrix)
        for j, value in enumerate(row)
    ]
    doc = "Residual and Jacobian of the step, rows in the order of elimination."
    time = () if eqs.plain.autonomous else ("t",)
    lines = low.statements(stores, computed)
    return Function("step_equations", doc, lines, ("W", "h", *time, "lane"))


def part_solvers(low: Lowering) -> list[Solver]:
    """Return the solver of each part."""
    return [SOLVERS[type(part)](low, part) for part in low.equations.parts]


def increments(solvers: Iterable[Solver]) -> list[Increment]:
    """List the increments that an iteration changes, part after part."""
    return [increment for solver in solvers for increment in solver.increments]


def lanes(body: Iterable[Statement]) -> tuple[Statement, ...]:
    """Wrap statements in the loop over lanes."""
    return (Loop("lane", "range(LANES)", tuple(body)),)


def velocity(
    low: Lowering, point: Point, p: Sequence[Expression], section: str, suffix: str | None = None
) -> tuple[list[Expression], list[Expression]]:
    """Solve M v = p - a; returns the pivots of M, too, all positive if it is positive definite.

    Velocities have the point's suffix unless another one is given.
    """
    velocities: dict[int, Expression] = {}
    pivots: list[Expression] = []
    for part in low.equations.parts:
        v, more = _velocities(low, point, p, section, part.mass_order, suffix)
        velocities |= v
        pivots += more
    return [velocities[a] for a in range(low.n)], pivots


def _velocities(
    low: Lowering,
    point: Point,
    p: Sequence[Expression],
    section: str,
    group: Sequence[int],
    suffix: str | None = None,
) -> tuple[dict[int, Expression], list[Expression]]:
    """Solve M v = p - a for a group of coordinates; returns the pivots of L D L^T too."""
    if low.equations.plain.constraints:
        v, pivots, _ = held_velocities(low, point, p, section, group, suffix or point.suffix)
        return dict(zip(group, v, strict=True)), pivots
    entry = low.template.entry
    mass = [[entry(point, section, "M", i, j) for j in group] for i in group]
    right = [p[i] - entry(point, section, "a", i) for i in group]
    hints = [f"v_{low.names.coordinates[i]}_{suffix or point.suffix}" for i in group]
    v, pivots = solve_symmetric(low.graph, mass, right, hints, section)
    return dict(zip(group, v, strict=True)), pivots


def _newton_of(equations: Function) -> Kernel:
    """One Newton iteration for all equations of a step."""
    update = IfActive((Call("update_increments"),))
    body: tuple[Statement, ...] = (equations.call, Call("solve_in_pairs"), update)
    body += convergence(False)
    return Kernel("newton", ITERATION, lanes(body), straight=True)


def _newton(low: Lowering, solvers: Sequence[Solver]) -> Kernel:
    """One Newton iteration for the increments of the control points."""
    changes: dict[Increment, Expression] = {}
    for solver in solvers:
        changes |= solver.corrections()
    define, names = low.graph.define, low.names.coordinates
    stores: list[Store] = []
    sizes: dict[int, tuple[list[Expression], list[Expression]]] = {}
    degree = low.equations.scheme.degree
    for (m, a), change in changes.items():
        place = low.equations.unknowns.place(m, a)
        if m > degree:  # a multiplier, which is not measured
            old = low.impulses[m - degree - 1][a]
            new = define(f"{old.name}_new", old + change, "update")
            stores.append(Store(Row("INCREMENT", place), new, moving=True))
            continue
        new = define(f"{names[a]}_X{m}_new", low.increments[m - 1][a] + change, "update")
        stores.append(Store(Row("INCREMENT", place), new, moving=True))
        corrections, squares = sizes.setdefault(a, ([], []))
        corrections.append(low.mass_diagonal[a] * change**2)
        squares.append(low.mass_diagonal[a] * new**2)
    for k, block in enumerate(("CORRECTION", "INCREMENT")):
        terms = {a: low.graph.total(of[k]) for a, of in sizes.items()}
        if len(terms) > 1:
            for a, term in terms.items():
                terms[a] = define(f"{block.lower()}_{names[a]}", term, "update")
                stores.append(Store(Row(f"OWN_{block}", a), terms[a]))
        value = define(f"{block.lower()}_squared", low.graph.total(terms.values()), "update")
        stores.append(Store(Row(f"{block}_SQUARED", 0), value))
    lines = low.statements(stores, (Level.ITERATION,))
    return Kernel("newton", ITERATION, lanes((*lines, *convergence(bool(low.multipliers)))))


def convergence(held: bool) -> tuple[Call, ...]:
    """Return what ends an iteration, where there are constraints or none."""
    names = ("check_rounding", "check_convergence") if held else ("check_convergence",)
    return tuple(map(Call, names))


def acceptance(held: bool, moving: bool) -> tuple[Call, ...]:
    """Return what ends a step, where there are constraints or none, and if M is ``moving``."""
    names = ("expect_rounding", "check_acceptance") if held else ("check_acceptance",)
    pivots = (Call("check_pivots"),) if moving else ()
    return (*map(Call, names), *pivots)


def _advance(low: Lowering, solvers: Sequence[Solver]) -> Kernel:
    """Close a step and predict the next one."""
    names, iterated = low.names.coordinates, bool(increments(solvers))
    q: dict[int, tuple[Expression, Expression]] = {}
    p: dict[int, tuple[Expression, Expression]] = {}
    closings = [solver.close() for solver in solvers]
    for closing in closings:
        for a, change in closing.dq.items():
            q[a] = low.moved_on(a, change)
        for a, impulse in closing.dp.items():
            p[a] = low.compensated(f"p_{names[a]}", low.p[a], low.p_low[a], impulse)
    end = end_of(low, [q[a][0] for a in range(low.n)])
    momentum = tuple(p[a][0] if a in p else low.p[a] for a in range(low.n))
    stores, masses = _predicted(low, solvers, end, momentum) if iterated else ([], {})
    stores += [
        Store(Row("PASSED", 0), closing.passed)
        for closing in closings
        if closing.passed is not None
    ]
    checks: dict[str, list[Expression]] = {}
    for closing in closings if iterated else ():
        for block, size in closing.checks.items():
            checks.setdefault(block, []).append(size)
    for block, sizes in checks.items():
        value = low.graph.define(block.lower(), low.graph.total(sizes), "predictor")
        stores.append(Store(Row(block, 0), value))
    for block, values in (("POSITION", q), ("MOMENTUM", p)):
        for name, k in ((block, 0), (f"{block}_LOW", 1)):
            stores += [Store(Row(name, a), values[a][k], moving=True) for a in sorted(values)]
    low.keep(stores, (Level.ITERATION,))
    to = dict(zip((*low.q, *low.p), (*end.q, *momentum), strict=True))
    to |= {low.mass_diagonal[a]: value for a, value in masses.items()}
    for symbol, row in low.hoisted_at(Level.STEP):
        following = low.moved(symbol, to)
        if following != symbol:  # it is made of constant momenta alone
            stores.append(Store(row, following, moving=True))
    closed = low.statements(stores, (Level.ITERATION,))
    if iterated:
        doc = "Close a step: p1 and q1 by compensated sums, then predict the next increments."
        checked = acceptance(bool(low.multipliers), bool(low.scales))
        return Kernel("advance", doc, lanes((KEEP_STEP, *closed, *checked)))
    doc = "Take as many steps as W[COUNT] says, without Newton's method."
    return Kernel("advance", doc, (Loop("step", "range(int(W[COUNT, 0]))", lanes(closed)),))


def _predicted(
    low: Lowering, solvers: Sequence[Solver], end: Point, momentum: tuple[Expression, ...]
) -> tuple[list[Store], dict[int, Expression]]:
    """Predict the next increments, and compare those of this step with theirs."""
    eqs, define, section = low.equations, low.graph.define, "predictor"
    scheme, names, d = low.scheme, low.names.coordinates, eqs.scheme.degree
    total = low.graph.total
    every = sorted(increments(solvers))
    masses: dict[int, Expression] = {}
    pivots: list[Expression] = []
    jump: list[Expression] = []
    following: dict[Increment, Expression] = {}
    for part, solver in zip(eqs.parts, solvers, strict=True):
        v, more = _velocities(low, end, momentum, "velocity at q1", part.mass_order)
        pivots += more
        if not solver.increments:
            continue
        for a in part.mass_order:
            masses[a] = low.template.entry(end, "velocity at q1", "M", a, a)
        for a in solver.coordinates:
            path = [X[a] for X in low.increments]
            bend = define(f"bend_{names[a]}", low.h * v[a] - end_slope(low, a), section)
            jump.append(masses[a] * bend**2)
            for k in sorted(m for m, b in every if b == a):
                terms = [scheme.extrapolation[k - 1][j] * path[j] for j in range(d)]
                value = total([scheme.correction[k - 1] * bend, *terms])
                following[k, a] = define(f"{names[a]}_X{k}_next", value, section)
    error = [
        low.mass_diagonal[a] * (low.increments[m - 1][a] - low.predicted[m - 1][a]) ** 2
        for m, a in increments(solvers)
    ]
    stores = []
    for block in ("INCREMENT", "PREDICTED"):
        for m, a in every:
            row = Row(block, eqs.unknowns.place(m, a))
            stores.append(Store(row, following[m, a], moving=True))
    for k, a in (unknown for solver in solvers for unknown in solver.multipliers):  # as they were
        row = Row("PREDICTED", eqs.unknowns.place(k, a))
        stores.append(Store(row, low.impulses[k - d - 1][a]))
    stores += [Store(Row("MASS_DIAGONAL", a), masses[a], moving=True) for a in masses]
    stores += least_pivot(low, pivots, Row("MASS_PIVOT", 0), "velocity at q1")
    measured = {"velocity_jump_squared": jump, "prediction_error_squared": error}
    for name, terms in measured.items():
        stores.append(Store(Row(name.upper(), 0), define(name, total(terms), section)))
    return stores, masses


def _start(
    low: Lowering, solvers: Sequence[Solver], kept: Sequence[tuple[Expression, Row]]
) -> Kernel:
    """From q and p to the first increments, and to what is ``kept`` from step to step."""
    eqs, define = low.equations, low.graph.define
    point, section = low.start_point(), "velocity"
    v, pivots = velocity(low, point, low.p, section)
    every = increments(solvers)
    iterated = {a for _, a in every}
    stores = [Store(row, symbol) for symbol, row in kept]
    for a, name in enumerate(low.names.coordinates):
        stores.append(Store(Row("VELOCITY", a), v[a]))
        if a in iterated:
            mass = low.template.entry(point, section, "M", a, a)
            stores.append(Store(Row("MASS_DIAGONAL", a), mass))
        for k in range(1, eqs.scheme.degree + 1):
            if (k, a) in every:
                increment = low.scheme.points[k] * low.h * v[a]
                value = define(f"{name}_X{k}_first", increment, section)
                for block in ("INCREMENT", "PREDICTED"):
                    stores.append(Store(Row(block, eqs.unknowns.place(k, a)), value))
    if low.multipliers:
        taken = held_velocities(low, point, low.p, section, range(low.n), point.suffix)[2]
        stores += [Store(Row("MULTIPLIER", c), nu) for c, nu in enumerate(taken)]
    for k, a in (unknown for solver in solvers for unknown in solver.multipliers):
        for block in ("INCREMENT", "PREDICTED"):  # they enter linearly: any start will do
            stores.append(Store(Row(block, eqs.unknowns.place(k, a)), low.graph.of(0)))
    stores += begun_pivots(low, pivots, section)
    more = ", and increments of constant velocity" if every else ""
    doc = f"Begin at (q, p): what depends on q alone{more}."
    return Kernel("start", doc, lanes(low.statements(stores, STATE)))


def energy_stores(low: Lowering) -> tuple[Store, ...]:
    """Return H = v.(p - a)/2 + V, the first of the two alone, and v."""
    point, section = low.start_point(), "energy"
    v, _ = velocity(low, point, low.p, "velocity")
    terms = [
        v[i] * (low.p[i] - low.template.entry(point, section, "a", i)) / 2 for i in range(low.n)
    ]
    kinetic = low.graph.define("kinetic_value", low.graph.total(terms), section)
    value = low.template.entry(point, section, "V") + kinetic
    return (
        Store(Row("ENERGY", 0), low.graph.define("energy_value", value, section)),
        Store(Row("KINETIC", 0), kinetic),
        *(Store(Row("VELOCITY", a), v[a]) for a in range(low.n)),
    )


def legendre(low: Lowering) -> Kernel:
    """The momentum of a velocity."""
    start = low.start_point()
    point = Point(f"{start.suffix}_given", low.q, low.v, start.t, start.u)
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
