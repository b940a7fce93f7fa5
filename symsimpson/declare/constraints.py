"""Constraints of positions, phi(t, q) = 0, and of velocities, A(t, q) v = b(t, q).

L - lambda.phi is the Lagrangian with multipliers lambda, so p' = L_q - Phi^T lambda with
Phi = dphi/dq (Hairer, Lubich and Wanner, Geometric Numerical Integration, VII.1). Constraints
A v = b describe rolling wheels and blades. They exert the force -A^T nu (Lagrange and d'Alembert),
and their rows follow the rows of Phi. A phi that contains the time moves: Phi v = -phi_t.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from symsimpson.declare.checks import reject_model, spell
from symsimpson.declare.plain import SAMPLES, ConstraintRows, Plain, Symbols
from symsimpson.declare.quadratic import has_full_rank, is_well_conditioned, mass_rows, rank, sample
from symsimpson.errors import ModelWarning
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.evaluate import evaluate_doubles
from symsimpson.graph.findings import IdentityTest
from symsimpson.graph.nodes import ZERO, Graph, Value, scale
from symsimpson.graph.rebuild import fix_symbols, rebuild
from symsimpson.support.calling import warn
from symsimpson.support.names import counted

Read = Callable[[str, Any], Value]
#: Relative size below which an entry counts as zero at a random point.
NOTHING = 1e-9


class Accelerations(NamedTuple):
    """The coefficients of M v' + W^T lambda = push and W v' = -curve."""

    rows: list[list[Value]]  #: W: Phi, then A.
    push: list[Value]  #: L_q + f - (d L_v/dq) v - d L_v/dt.
    curve: list[Value]  #: The rates of change of Phi v + phi_t and A v - b by q and t.
    rates: list[Value]  #: Phi v + phi_t, then A v - b.


def name_constraints(
    name: str, constraints: Any, taken: Sequence[str] | None = None
) -> dict[str, sp.Expr]:
    """Return the constraints by name; constraints of a list are called "1", "2", ...

    Pass ``taken`` for velocity constraints only: the names of the constraints of positions.
    Numbers continue after these.
    """
    if constraints is None:
        return {}
    if isinstance(constraints, (sp.Expr, sp.Equality)):
        constraints = [constraints]
    if isinstance(constraints, sp.MatrixBase):
        constraints = list(constraints)
    what, example, shown = "constraints", "x**2 + y**2 - l**2", "rod"
    if taken is not None:
        what, example, shown = "velocity_constraints", "x.diff() - y*z.diff()", "wheel"
    if hasattr(constraints, "tolist") and not isinstance(constraints, sp.Basic):
        constraints = constraints.tolist()  # an array of NumPy
    if isinstance(constraints, Mapping):
        expressions = dict(constraints)
    elif isinstance(constraints, Sequence) and not isinstance(constraints, str):
        numbers = (str(i) for i in count(len(taken or ()) + 1) if str(i) not in (taken or ()))
        expressions = {next(numbers): expression for expression in constraints}
    else:
        reject_model(
            name,
            f"{what} is {spell(constraints)!r}, neither a list nor a mapping.",
            f"Write {what}=[{example}], or with names: {what}={{{shown!r}: {example}}}.",
        )
    for key, expression in expressions.items():
        if not isinstance(key, str) or not key.strip() or not key.isprintable():
            reject_model(
                name,
                f"the constraint's name {key!r} is not a printable string.",
                f"Write {what}={{{shown!r}: {example}}}.",
            )
        if isinstance(expression, sp.Equality):
            expressions[key] = expression.lhs - expression.rhs
    return expressions


def read_constraints(
    name: str, given: Mapping[str, sp.Expr], symbols: Symbols, read: Read
) -> dict[str, Value]:
    """Check that constraints are equations of positions, and read them into the graph."""
    graph = symbols.graph
    values: dict[str, Value] = {}
    q = set(symbols.numbers(symbols.q))
    for key, expression in given.items():
        _check_positions(name, key, expression, symbols)
        value = read(f"constraint {key!r}", expression)
        findings = IdentityTest(graph, [value])
        present = graph.nodes[value[1]].symbols & q
        if not any(findings.depends(value, x) for x in present):
            what = "is true everywhere" if findings.vanishes(value) else "depends on no coordinate"
            reject_model(
                name,
                f"the constraint {key!r}, {spell(expression)} = 0, {what}. It does not restrict "
                "the motion, or cannot be satisfied.",
                "Remove it, or write an expression that vanishes at all allowed positions.",
            )
        values[key] = value
    return values


def accelerations(
    graph: Graph,
    L: Value,
    constraints: ConstraintRows,
    f: Sequence[Value],
    places: tuple[Sequence[int], Sequence[int], int],
) -> Accelerations:
    """Derive the coefficients of accelerations and multipliers: M v' + W^T lambda = push.

    The forces ``f`` have one entry for each coordinate. The ``places`` are the nodes of q, the
    nodes of v and the node of t.
    """
    q, v, time = places
    derivatives, rows = Derivatives(graph), slopes(graph, constraints.phi, q)
    sides = constraints.sides(graph, time)
    rows += [list(row[:-1]) for row in constraints.rows]
    rates = [
        graph.add([*graph.products(row, v), scale(-1, b)])
        for row, b in zip(rows, sides, strict=True)
    ]
    curve = []
    for rate in rates:
        moving = graph.products([derivatives(rate, x) for x in q], v)
        curve.append(graph.add([*moving, derivatives(rate, time)]))
    forces, momenta = gradient(graph, L, q), gradient(graph, L, v)
    push = []
    for force, applied_force, momentum in zip(forces, f, momenta, strict=True):
        *turned, drift = gradient(graph, momentum, [*q, time])
        moving = graph.products([scale(-1, slope) for slope in turned], v)
        push.append(graph.add([force, applied_force, *moving, scale(-1, drift)]))
    return Accelerations(rows, push, curve, rates)


def slopes(graph: Graph, phi: Iterable[Value], q: Sequence[int]) -> list[list[Value]]:
    """Return Phi = dphi/dq, one row for each constraint."""
    derivatives = Derivatives(graph)
    return [[derivatives(value, x) for x in q] for value in phi]


def check_number(
    name: str, rows: Mapping[str, Sequence[Value]], symbols: Symbols, *, driven: bool
) -> None:
    """Reject constraints that prevent all motion, or that depend on each other.

    The mapping ``rows`` has the row of Phi or A of each constraint. Constraints that move are
    ``driven``: there may be as many as coordinates. The message names the first constraints that
    depend on each other.
    """
    if not rows:
        return
    if len(rows) >= len(symbols.q) + driven:
        reject_model(
            name,
            f"{counted(len(rows), 'constraint')} on {counted(len(symbols.q), 'coordinate')}, so "
            "nothing can move.",
            "Declare fewer constraints than coordinates. There may be as many if one of them "
            "moves, for example x = sin(t).",
        )
    every = list(rows.values())
    if has_full_rank(symbols, every):
        return
    names = list(rows)
    for number in range(1, len(every) + 1):
        if rank(symbols.graph, every[:number]) == number:
            continue
        without = (every[:k] + every[k + 1 : number] for k in range(number - 1))
        others = [k for k, left in enumerate(without) if rank(symbols.graph, left) == len(left)]
        with_it = ", ".join(repr(names[k]) for k in [*others, number - 1])
        reject_model(
            name,
            f"the constraints {with_it} depend on each other: one of them follows from the others. "
            "Their multipliers are not unique.",
            "Remove one of them.",
        )


def check_constrained_mass(
    name: str, M: Mapping[tuple[int, int], Value], rows: Sequence[Sequence[Value]], symbols: Symbols
) -> None:
    """Reject a kinetic energy that vanishes for velocities that satisfy the constraints."""
    mass = mass_rows(M, range(len(symbols.q)))
    columns = [list(column) for column in zip(*rows, strict=True)]
    matrix = [row + column for row, column in zip(mass, columns, strict=True)]
    matrix += [[*row, *[ZERO] * len(rows)] for row in rows]
    if has_full_rank(symbols, matrix):
        return
    bare = [i for i, row in enumerate(mass) if not any(c for c, _ in row)]
    which = ", ".join(spell(symbols.back[symbols.q[i]]) for i in bare)
    reject_model(
        name,
        "some velocities that the constraints allow carry no kinetic energy"
        + (f"; {which} {'has' if len(bare) == 1 else 'have'} no mass." if bare else ".")
        + " Such a motion has no equation.",
        "Give each body its own kinetic energy, or use fewer coordinates.",
    )


def regular_mass(plain: Plain, parameters: Iterable[float]) -> bool:
    """Return whether M is regular without constraints, at random positions with these parameters.

    M is singular, for example, for a quaternion whose length has no inertia.
    """
    size, random = range(len(plain.q)), np.random.default_rng(21)
    entries = [plain.entry(i, j) for i in size for j in size]
    known = dict(zip(plain.numbers(plain.parameters), map(float, parameters), strict=True))
    for _ in range(SAMPLES):
        place = random.uniform(0.3, 1.0, len(plain.q))
        point = known | dict(zip(plain.numbers(plain.q), place.tolist(), strict=True))
        point[plain.time] = 0.5
        matrix = evaluate_doubles(plain.graph, entries, point)
        if is_well_conditioned(np.reshape(matrix, (len(size), len(size)))):
            return True
    return False


def _check_positions(name: str, key: str, expression: Any, symbols: Symbols) -> None:
    """Reject velocities and inputs in a constraint of positions."""
    if not isinstance(expression, sp.Expr):
        return  # read_expression rejects it
    present = expression.atoms(sp.Symbol, sp.Derivative)
    velocities = [x for x in present if symbols.replace.get(x) in symbols.v]
    if velocities:
        reject_model(
            name,
            f"the constraint {key!r} contains the velocity {spell(velocities[0])}, so it is not a "
            "constraint of positions.",
            "Declare it as velocity_constraints={...}, as for a rolling wheel or a blade. If it is "
            "the time derivative of an equation of positions, declare that equation.",
        )
    driven = [u for x in symbols.u if (u := symbols.back[x]) in expression.free_symbols]
    if driven:
        reject_model(
            name,
            f"the constraint {key!r} depends on the input {spell(driven[0])}. Inputs have values "
            "at nodes only, so the constraint would jump.",
            "Prescribe the motion by a function of symsimpson.time and of parameters.",
        )


def read_velocity_constraints(
    name: str,
    given: Mapping[str, sp.Expr],
    taken: Mapping[str, Any],
    symbols: Symbols,
    read: Callable[[str, Any], Value],
) -> dict[str, tuple[Value, ...]]:
    """Return the row of A, followed by b, for each velocity constraint A v - b = 0.

    The mapping ``taken`` has the names of the constraints of positions. The function ``read``
    checks an expression and reads it; its first argument names the expression.
    """
    reject_here = partial(reject_model, name)
    graph, v = symbols.graph, symbols.numbers(symbols.v)
    rows: dict[str, tuple[Value, ...]] = {}
    for key, expression in given.items():
        if key in taken:
            reject_here(
                f"two constraints are called {key!r}, one of positions and one of velocities. "
                f"run['lambda_{key}'] would be ambiguous.",
                "Rename one of them.",
            )
        value = read(f"velocity constraint {key!r}", expression)
        driven = graph.nodes[value[1]].symbols & set(symbols.numbers(symbols.u))
        if driven:
            which = next(u for u, (_, n) in symbols.known.items() if n in driven)
            reject_here(
                f"the velocity constraint {key!r} depends on the input {spell(which)}. Inputs have "
                "values at nodes only, but a constraint holds between them.",
                "Prescribe the motion by a function of time, or by a parameter.",
            )
        if graph.nodes[value[1]].symbols.isdisjoint(v):
            nothing = IdentityTest(graph, [value]).vanishes(value)
            reject_here(
                f"the velocity constraint {key!r}, {spell(expression)} = 0, "
                + ("is true everywhere." if nothing else "contains no velocity."),
                "It does not restrict the motion. Remove it."
                if nothing
                else "It is a constraint of positions. Declare it as constraints={...}.",
            )
        rows[key] = split_row(name, key, expression, value, symbols)
    return rows


def split_row(
    name: str, key: str, expression: Any, value: Value, symbols: Symbols
) -> tuple[Value, ...]:
    """Split A v - b into the row of A, followed by b."""
    graph, v = symbols.graph, symbols.numbers(symbols.v)
    if not IdentityTest(graph, [value]).affine([value], v)[0]:
        reject_model(
            name,
            f"the velocity constraint {key!r}, {spell(expression)} = 0, is not linear in the "
            "velocities. This does not determine its constraint force.",
            "Write it as A(q, t) v = b(q, t), if possible.",
        )
    values = [*gradient(graph, value, v), value]
    try:
        *row, rest = rebuild(graph, values, dict.fromkeys(v, ZERO))
    except ZeroDivisionError:  # terms that cancel have velocities in their denominators
        moved = [graph.add([values[-1], *(scale(-1, x) for x in graph.products(values[:-1], v))])]
        *row, rest = (fix_symbols(graph, x, v) or x for x in [*values[:-1], *moved])
    findings = IdentityTest(graph, [*row, rest])
    *row, rest = (ZERO if findings.vanishes(x) else x for x in (*row, rest))
    if not any(c for c, _ in row):
        reject_model(
            name,
            f"the velocity constraint {key!r}, {spell(expression)} = 0, "
            + ("cannot be satisfied" if rest[0] else "is true everywhere")
            + ", because its velocities cancel each other.",
            "Check its terms, or remove it.",
        )
    return (*row, scale(-1, rest))


def warn_of_integrable(
    name: str,
    rows: Mapping[str, tuple[Value, ...]],
    of_positions: Sequence[Sequence[Value]],
    symbols: Symbols,
) -> None:
    """Warn of velocity constraints that follow from equations of positions (theorem of Frobenius).

    Let omega = A dq - b dt. A constraint A v = b is integrable if d omega(x, y) = 0 for all
    displacements x, y that the constraints allow. The function tests all constraints together,
    including the rows ``of_positions``, and each velocity constraint separately.
    """
    if not rows:
        return
    driven = len(rows) + len(of_positions) == len(symbols.q)  # b moves the last coordinate
    whole = not driven and _integrable(rows, of_positions, symbols)
    names = (
        list(rows) if whole else [key for key in rows if _integrable({key: rows[key]}, (), symbols)]
    )
    # with b, the equation of positions contains the time, and need not be known
    names = [key for key in names if not rows[key][-1][0]]
    if not names:
        return
    which = ", ".join(map(repr, names))
    several = len(names) > 1
    warn(
        f"system '{name}': the velocity constraint{'s' if several else ''} {which} "
        f"follow{'' if several else 's'} from {'equations' if several else 'an equation'} of "
        "positions.\n"
        "Declared as constraints={...}, the equations of positions hold up to round-off at every "
        "step, and the step is symplectic. Otherwise positions drift from them with the error of "
        "the scheme.",
        ModelWarning,
    )


def _integrable(
    rows: Mapping[str, tuple[Value, ...]], of_positions: Sequence[Sequence[Value]], symbols: Symbols
) -> bool:
    """Return whether the rows are integrable together, tested at a few random points."""
    graph, size = symbols.graph, len(symbols.q) + 1
    places = [*symbols.numbers(symbols.q), symbols.numbers([symbols.t])[0]]
    forms = [[*row[:-1], scale(-1, row[-1])] for row in rows.values()]
    allowed = [*forms, *([*row, ZERO] for row in of_positions)]
    derivatives = Derivatives(graph)
    turns = [derivatives(x, place) for form in forms for x in form for place in places]
    for numbers in sample(symbols, [*(x for row in allowed for x in row), *turns]):
        matrix = np.reshape(numbers[: len(allowed) * size], (len(allowed), size))
        slopes = np.reshape(numbers[len(allowed) * size :], (len(forms), size, size))
        length = np.linalg.norm(matrix, axis=1)
        if not (np.isfinite(matrix).all() and np.isfinite(slopes).all() and length.all()):
            return False
        matrix, slopes = matrix / length[:, None], slopes / length[: len(forms), None, None]
        free = np.linalg.svd(matrix)[2][len(allowed) :]
        turned = [free @ (slope - slope.T) @ free.T for slope in slopes]
        if np.abs(turned).max(initial=0.0) > NOTHING * (1 + np.abs(slopes).max()):
            return False
    return True
