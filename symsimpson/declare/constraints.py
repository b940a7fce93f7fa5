"""Constraints of positions, phi(q) = 0, or of velocities, A(t, q) v = b(t, q).

L - lambda.phi is the Lagrangian with multipliers lambda, so that p' = L_q - Phi^T lambda with
Phi = dphi/dq (Hairer, Lubich and Wanner, Geometric Numerical Integration, VII.1). Constraints
A v = b, of wheels that roll or of blades, pull by -A^T nu (Lagrange and d'Alembert): their rows
follow those of Phi.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from symsimpson.declare.checks import fail, spell
from symsimpson.declare.plain import SAMPLES, Held, Plain, Symbols
from symsimpson.declare.quadratic import (
    has_full_rank,
    is_well_conditioned,
    mass_rows,
    rank,
    samples,
)
from symsimpson.errors import ModelWarning
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.evaluate import doubles
from symsimpson.graph.findings import Findings
from symsimpson.graph.nodes import ZERO, Graph, Value, scaled
from symsimpson.graph.rebuild import fixed, rebuilt
from symsimpson.support.calling import warn
from symsimpson.support.names import counted

Read = Callable[[str, Any], Value]
#: Entries below this, relative to the largest, are zero at random points of doubles.
NOTHING = 1e-9


class Accelerations(NamedTuple):
    """Values that determine accelerations and multipliers."""

    rows: list[list[Value]]  #: W: Phi, then A.
    push: list[Value]  #: L_q + f - (d L_v/dq) v - d L_v/dt.
    curve: list[Value]  #: How Phi v and A v - b change with q and t, so that W v' = -curve.
    rates: list[Value]  #: Phi v, then A v - b.


def names_of(name: str, constraints: Any, taken: Sequence[str] | None = None) -> dict[str, sp.Expr]:
    """Return the constraints by name; those of a list are called "1", "2", ...

    Those of velocities are told by the names that are ``taken`` by others, which they leave out.
    Raises ModelError if they are no mapping from texts to expressions, and no sequence of
    expressions.
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
        raise fail(
            name,
            f"{what} is {spell(constraints)!r}, neither a list nor a mapping.",
            f"Write {what}=[{example}], or with names: {what}={{{shown!r}: {example}}}.",
        )
    for key, expression in expressions.items():
        if not isinstance(key, str) or not key.strip() or not key.isprintable():
            raise fail(
                name,
                f"the constraint's name {key!r} is not a text that can be printed.",
                f"Write {what}={{{shown!r}: {example}}}.",
            )
        if isinstance(expression, sp.Equality):
            expressions[key] = expression.lhs - expression.rhs
    return expressions


def read_constraints(
    name: str, given: Mapping[str, sp.Expr], symbols: Symbols, read: Read
) -> dict[str, Value]:
    """Check constraints and read them into the graph.

    Raises ModelError if one is not an equation of positions.
    """
    graph = symbols.graph
    values: dict[str, Value] = {}
    q = set(symbols.numbers(symbols.q))
    for key, expression in given.items():
        _check_positions(name, key, expression, symbols)
        value = read(f"constraint {key!r}", expression)
        findings = Findings(graph, [value])
        present = graph.nodes[value[1]].symbols & q
        if not any(findings.depends(value, x) for x in present):
            what = "is true everywhere" if findings.vanishes(value) else "depends on no coordinate"
            raise fail(
                name,
                f"the constraint {key!r}, {spell(expression)} = 0, {what}.",
                "It says nothing about the motion, or cannot be met. Leave it out, or write what "
                "vanishes on all positions that are allowed.",
            )
        values[key] = value
    return values


def accelerations(
    graph: Graph,
    L: Value,
    held: Held,
    f: Sequence[Value],
    places: tuple[Sequence[int], Sequence[int], int],
) -> Accelerations:
    """Return what determines accelerations and multipliers: M v' + W^T lambda = push.

    ``f`` are forces by coordinate, ``places`` the nodes of q and of v, and that of t.
    """
    q, v, time = places
    derivatives, rows = Derivatives(graph), slopes(graph, held.phi, q)
    rates = [graph.add(graph.products(row, v)) for row in rows]
    rows += [list(row[:-1]) for row in held.rows]
    rates += held.rates(graph, v)
    curve = []
    for rate in rates:
        moving = graph.products([derivatives(rate, x) for x in q], v)
        curve.append(graph.add([*moving, derivatives(rate, time)]))
    forces, momenta = gradient(graph, L, q), gradient(graph, L, v)
    push = []
    for force, applied_force, momentum in zip(forces, f, momenta, strict=True):
        *turned, drift = gradient(graph, momentum, [*q, time])
        moving = graph.products([scaled(-1, slope) for slope in turned], v)
        push.append(graph.add([force, applied_force, *moving, scaled(-1, drift)]))
    return Accelerations(rows, push, curve, rates)


def slopes(graph: Graph, phi: Iterable[Value], q: Sequence[int]) -> list[list[Value]]:
    """Return Phi, a row for each constraint."""
    derivatives = Derivatives(graph)
    return [[derivatives(value, x) for x in q] for value in phi]


def check_number(
    name: str, rows: Mapping[str, Sequence[Value]], symbols: Symbols, *, driven: bool
) -> None:
    """Reject constraints that leave nothing to move, or that depend on each other.

    ``name`` is the system's name. ``rows`` has the row of each constraint on velocities, Phi or A.
    If a row of A v = b has a b, they are ``driven``, and as many as coordinates move.
    Raises ModelError with the names of the fewest first ones that depend on each other.
    """
    if not rows:
        return
    if len(rows) >= len(symbols.q) + driven:
        raise fail(
            name,
            f"{counted(len(rows), 'constraint')} on {counted(len(symbols.q), 'coordinate')}.",
            "Nothing could move. There must be fewer constraints than coordinates, or as many if a "
            "velocity constraint has a right-hand side, as x' = cos(t).",
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
        raise fail(
            name,
            f"the constraints {with_it} depend on each other: one of them follows from the others.",
            "The forces that hold them would not be determined. Leave one out.",
        )


def check_held_mass(
    name: str, M: Mapping[tuple[int, int], Value], rows: Sequence[Sequence[Value]], symbols: Symbols
) -> None:
    """Refuse kinetic energies that vanish for velocities which the constraints leave free.

    Raises ModelError.
    """
    mass = mass_rows(M, range(len(symbols.q)))
    columns = [list(column) for column in zip(*rows, strict=True)]
    matrix = [row + column for row, column in zip(mass, columns, strict=True)]
    matrix += [[*row, *[ZERO] * len(rows)] for row in rows]
    if has_full_rank(symbols, matrix):
        return
    bare = [i for i, row in enumerate(mass) if not any(c for c, _ in row)]
    which = ", ".join(spell(symbols.back[symbols.q[i]]) for i in bare)
    raise fail(
        name,
        "some velocities that the constraints allow carry no kinetic energy"
        + (f"; {which} {'has' if len(bare) == 1 else 'have'} no mass." if bare else "."),
        "Such a motion has no equation. Give each body its own kinetic energy, or use fewer "
        "coordinates.",
    )


def regular_mass(plain: Plain, parameters: Iterable[float]) -> bool:
    """Return whether M is regular without constraints, at random positions with these parameters.

    Where it is not, as with a rotation that has no inertia of its length, constraints help out.
    """
    size, random = range(len(plain.q)), np.random.default_rng(21)
    entries = [plain.entry(i, j) for i in size for j in size]
    known = dict(zip(plain.numbers(plain.parameters), map(float, parameters), strict=True))
    for _ in range(SAMPLES):
        place = random.uniform(0.3, 1.0, len(plain.q))
        point = known | dict(zip(plain.numbers(plain.q), place.tolist(), strict=True))
        point[plain.time] = 0.5
        matrix = doubles(plain.graph, entries, point)
        if is_well_conditioned(np.reshape(matrix, (len(size), len(size)))):
            return True
    return False


def _check_positions(name: str, key: str, expression: Any, symbols: Symbols) -> None:
    """Refuse velocities, the time and inputs by messages of their own."""
    if not isinstance(expression, sp.Expr):
        return  # what else it is, reading tells
    present = expression.atoms(sp.Symbol, sp.Derivative)
    velocities = [x for x in present if symbols.replace.get(x) in symbols.v]
    if velocities:
        raise fail(
            name,
            f"the constraint {key!r} contains the velocity {spell(velocities[0])}: it is no "
            "constraint of positions.",
            "Give it as velocity_constraints={...}, as those of a wheel that rolls or of a blade; "
            "if it is the time derivative of an equation of positions, give that equation.",
        )
    if symbols.t in expression.xreplace(symbols.replace).free_symbols:
        raise fail(
            name,
            f"the constraint {key!r} depends on the time.",
            "Constraints that move are not integrated to rounding. Choose a coordinate that "
            "follows the prescribed motion, and write it into T and V, where t may stand; or give "
            f"velocity_constraints={{{key!r}: phi.diff(symsimpson.time)}}, which keeps phi to the "
            "error of the scheme.",
        )


def read_velocity_constraints(
    name: str,
    given: Mapping[str, sp.Expr],
    taken: Mapping[str, Any],
    symbols: Symbols,
    read: Callable[[str, Any], Value],
) -> dict[str, tuple[Value, ...]]:
    """Return the row of A, and b behind it, of each velocity constraint A v - b = 0.

    ``name`` is that of the system, and ``taken`` has names of other constraints; ``read`` checks an
    expression and reads it, and its first argument says what it is. Raises ModelError if one is not
    linear in the velocities, or holds none of them.
    """
    refuse = partial(fail, name)
    graph, v = symbols.graph, symbols.numbers(symbols.v)
    rows: dict[str, tuple[Value, ...]] = {}
    for key, expression in given.items():
        if key in taken:
            raise refuse(
                f"two constraints are called {key!r}, one of positions and one of velocities.",
                f"run['lambda_{key}'] could be either. Rename one of them.",
            )
        value = read(f"velocity constraint {key!r}", expression)
        driven = graph.nodes[value[1]].symbols & set(symbols.numbers(symbols.u))
        if driven:
            which = next(u for u, (_, n) in symbols.known.items() if n in driven)
            raise refuse(
                f"the velocity constraint {key!r} depends on the input {spell(which)}.",
                "Inputs have values at nodes, and a constraint holds between them. Prescribe the "
                "motion by a function of time, or by a parameter.",
            )
        if graph.nodes[value[1]].symbols.isdisjoint(v):
            nothing = Findings(graph, [value]).vanishes(value)
            raise refuse(
                f"the velocity constraint {key!r}, {spell(expression)} = 0, "
                + ("is true everywhere." if nothing else "contains no velocity."),
                "It says nothing about the motion. Leave it out."
                if nothing
                else "It is a constraint of positions. Give it as constraints={...}.",
            )
        rows[key] = _row(name, key, expression, value, symbols)
    return rows


def _row(name: str, key: str, expression: Any, value: Value, symbols: Symbols) -> tuple[Value, ...]:
    """Split A v - b into the row of A and b."""
    graph, v = symbols.graph, symbols.numbers(symbols.v)
    if not Findings(graph, [value]).affine([value], v)[0]:
        raise fail(
            name,
            f"the velocity constraint {key!r}, {spell(expression)} = 0, is not linear in the "
            "velocities.",
            "Such a condition does not determine the force that holds it, not without a further "
            "rule. Write it as A(q, t) v = b(q, t), if it can be.",
        )
    values = [*gradient(graph, value, v), value]
    try:
        *row, rest = rebuilt(graph, values, dict.fromkeys(v, ZERO))
    except ZeroDivisionError:  # terms that cancel are divided by velocities
        moved = [graph.add([values[-1], *(scaled(-1, x) for x in graph.products(values[:-1], v))])]
        *row, rest = (fixed(graph, x, v) or x for x in [*values[:-1], *moved])
    findings = Findings(graph, [*row, rest])
    *row, rest = (ZERO if findings.vanishes(x) else x for x in (*row, rest))
    if not any(c for c, _ in row):
        raise fail(
            name,
            f"the velocity constraint {key!r}, {spell(expression)} = 0, "
            + ("cannot be met: no velocity is left in it." if rest[0] else "is true everywhere."),
            "Its velocities cancel each other. Look at its terms, or leave it out.",
        )
    return (*row, scaled(-1, rest))


def warn_of_integrable(
    name: str,
    rows: Mapping[str, tuple[Value, ...]],
    held: Sequence[Sequence[Value]],
    symbols: Symbols,
) -> None:
    """Warn of velocity constraints that follow from equations of positions, by Frobenius' theorem.

    With omega = A dq - b dt they do if d omega(x, y) = 0 for all displacements x, y that the
    constraints allow, together with those of positions or each alone.
    """
    if not rows:
        return
    driven = len(rows) + len(held) == len(symbols.q)  # by the time, if not held by equations
    whole = not driven and _integrable(rows, held, symbols)
    names = (
        list(rows) if whole else [key for key in rows if _integrable({key: rows[key]}, (), symbols)]
    )
    # with b the time stands in the equation of positions, which cannot be asked for
    names = [key for key in names if not rows[key][-1][0]]
    if not names:
        return
    which = ", ".join(map(repr, names))
    several = len(names) > 1
    warn(
        f"system '{name}': the velocity constraint{'s' if several else ''} {which} "
        f"follow{'' if several else 's'} from {'equations' if several else 'an equation'} of "
        "positions.\n"
        "Given as constraints={...}, positions would satisfy it to rounding at every step, and the "
        "step would be symplectic. As it is, they drift from it with the error of the scheme.",
        ModelWarning,
    )


def _integrable(
    rows: Mapping[str, tuple[Value, ...]], held: Sequence[Sequence[Value]], symbols: Symbols
) -> bool:
    """Return whether the rows are integrable together, at a few random points."""
    graph, size = symbols.graph, len(symbols.q) + 1
    places = [*symbols.numbers(symbols.q), symbols.numbers([symbols.t])[0]]
    forms = [[*row[:-1], scaled(-1, row[-1])] for row in rows.values()]
    allowed = [*forms, *([*row, ZERO] for row in held)]
    derivatives = Derivatives(graph)
    turns = [derivatives(x, place) for form in forms for x in form for place in places]
    for numbers in samples(symbols, [*(x for row in allowed for x in row), *turns]):
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
