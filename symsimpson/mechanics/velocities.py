"""Velocity constraints A(t, q) v = b(t, q), of wheels that roll and of blades: read and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import sympy as sp

from symsimpson.errors import ModelWarning
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.findings import Findings
from symsimpson.graph.nodes import ZERO, Value, scaled
from symsimpson.graph.rebuild import fixed, rebuilt
from symsimpson.mechanics.checks import fail, spell
from symsimpson.mechanics.plain import Symbols
from symsimpson.mechanics.quadratic import samples
from symsimpson.support.calling import warn

__all__ = ["read_velocity_constraints", "warn_of_integrable"]

#: Entries below this, relative to the largest, are zero at random points of doubles.
NOTHING = 1e-9


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
