"""The nearest state that satisfies the constraints of a system."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.declare import constraints
from symsimpson.declare.declared import Declared, read_values, read_vector
from symsimpson.errors import reject
from symsimpson.graph.evaluate import evaluate_doubles
from symsimpson.graph.nodes import Value
from symsimpson.support.array_types import Floats
from symsimpson.support.lengths import bending_length
from symsimpson.support.names import constraint_called, spelled

#: Iterations for positions, and the error at which they stop.
MOST, NEAR = 200, 1e-15
#: Largest relative error of constraints of positions that counts as satisfied.
MET = 1e-12
#: Steps along the constraints, and the smallest relative change that is worth a step.
SLIDES, STILL = 100, 1e-9
#: M, scaled to a diagonal of ones, is singular if its least eigenvalue is below this.
SINGULAR = 1e-9
#: Round-off error of terms that cancel, relative to these terms.
CANCELLED = 1e-14
#: Largest error of velocity constraints, relative to their rows and to v.
ALLOWED = 1e-12


def consistent(
    system: Declared,
    q0: ArrayLike,
    v0: ArrayLike,
    fixed: Iterable[Any],
    parameters: Mapping[Any, Any] | None,
    t: float,
) -> tuple[Floats, Floats]:
    """Return the nearest q and v with phi = 0, Phi v = -phi_t and A v = b, in the norm of M(q0)."""
    names = [spelled(q) for q in system.coordinates]
    q, v = read_vector(system, "q0", q0), read_vector(system, "v0", v0)
    try:
        t = float(t)
    except (TypeError, ValueError, OverflowError):
        t = np.nan
    if not np.isfinite(t):
        reject("t is not a finite number.", system.name, remedy="Pass a number, such as t=0.0.")
    single = isinstance(fixed, str) or hasattr(fixed, "free_symbols")
    if not (single or isinstance(fixed, Iterable)):
        reject(
            f"fixed is {fixed!r}, not a list of coordinates.",
            where=system.name,
            remedy=f"Pass coordinates or their names: fixed=[{names[0]!r}].",
        )
    constant = {spelled(x) for x in ((fixed,) if single else fixed)}
    unknown = constant - set(names)
    if unknown:
        reject(
            f"fixed contains {', '.join(sorted(unknown))}, which the system does not have.",
            where=system.name,
            remedy=f"The coordinates are {', '.join(names)}.",
        )
    values = read_values("parameters", "parameter", system.parameters, parameters)
    if not (system.constraints or system.velocity_constraints):
        return q, v
    free = [i for i, name in enumerate(names) if name not in constant]
    fixed_names = ", ".join(sorted(constant))
    at = _evaluator(system, values, t)
    m = len(system.constraints)
    *_, slopes, mass = at(q)
    metric = _definite_mass(mass, slopes)[np.ix_(free, free)]

    def of_positions(q: Floats) -> tuple[Floats, Floats]:
        phi, _, slopes, _ = at(q)
        return phi, slopes[:m]

    # first search for the nearest positions; if that fails, apply damped Newton iterations
    for nearest in (True, False):
        configuration, left = _satisfy(of_positions, q, free, metric, nearest=nearest)
        if left <= MET or _is_round_off(of_positions, configuration):
            break
    else:
        reject(
            f"there is no state near q0={_round_digits(q)} that satisfies the constraints"
            + (f" with {fixed_names} fixed." if constant else "."),
            where=system.name,
            remedy="Pass an initial state that is nearer, or fix fewer coordinates.",
        )
    configuration = _remove_turns(of_positions, configuration, q, free)
    q = _slide(of_positions, configuration, q[free], free, metric)
    _, b, slopes, mass = at(q)
    if not all(np.isfinite(x).all() for x in (b, slopes, mass)):
        reject(
            f"constraints or the mass matrix are not finite at q0={_round_digits(q)}, t={t:g}.",
            where=system.name,
            remedy="Pass an initial state at which they are finite.",
        )
    metric, given = _definite_mass(mass, slopes)[np.ix_(free, free)], v.copy()
    for _ in range(2):  # the second step removes round-off errors of the first
        v[free] += _nearest_step(metric, slopes[:, free], np.zeros(len(free)), b - slopes @ v)
    speed = max(np.abs(v).max(), np.abs(given).max())
    errors = _relative_errors(b - slopes @ v, slopes, speed)
    if not errors.max() <= ALLOWED:
        names = [*system.constraints, *system.velocity_constraints]
        reject(
            f"no velocities at q0={_round_digits(q)} satisfy the constraint "
            f"{constraint_called(names[int(np.argmax(errors))])}"
            + (f" with the velocities of {fixed_names} fixed." if constant else "."),
            where=system.name,
            remedy="Pass another initial state, or fix fewer coordinates.",
        )
    return q, v


def _satisfy(
    at: Callable[[Floats], tuple[Floats, Floats]],
    start: Floats,
    free: Sequence[int],
    metric: Floats,
    *,
    nearest: bool,
) -> tuple[Floats, float]:
    """Return positions that satisfy the constraints, and their relative error.

    If ``nearest``, the positions are as near to the start as possible. If not, damped Newton
    iterations reduce phi from the start.
    """
    q, goal, best, stalled = start.copy(), start[free], np.inf, 0
    for _ in range(MOST):
        phi, slopes = at(q)
        if not len(phi):
            return q, 0.0
        reach = max(np.abs(q).max(), np.abs(start).max())
        errors = _relative_errors(phi, slopes, reach)
        if not np.isfinite(errors).all():
            return q, np.inf
        worst = float(errors.max())
        stalled = 0 if worst < 0.5 * best else stalled + 1
        best = min(best, worst)
        # near the solution, a step back towards the start would only add noise
        back = nearest and worst > 1e-9
        wish = goal - q[free] if back else np.zeros(len(free))
        step = _nearest_step(metric, slopes[:, free], wish, -phi)
        if worst <= NEAR and (np.abs(step) <= 1e-15 * reach).all():
            break
        if stalled > 20:
            break
        share, rest = 1.0, NEAR * reach * np.linalg.norm(slopes)
        while not nearest and share > 1e-3:  # halve the step until phi decreases
            moved = q.copy()
            moved[free] += share * step
            if np.linalg.norm(at(moved)[0]) <= (1 - share / 4) * np.linalg.norm(phi) + rest:
                break
            share /= 2
        q[free] += share * step
    return q, best


def _remove_turns(
    at: Callable[[Floats], tuple[Floats, Floats]], q: Floats, goal: Floats, free: Sequence[int]
) -> Floats:
    """Subtract whole turns from coordinates if the constraints allow it, as for angles."""
    turns = 2 * np.pi * np.round((q - goal) / (2 * np.pi))
    for i in [i for i in free if turns[i]]:
        moved = q.copy()
        moved[i] -= turns[i]
        phi, slopes = at(moved)
        if _relative_errors(phi, slopes, float(np.abs(moved).max())).max(initial=0.0) <= MET:
            q = moved
    return q


def _slide(
    at: Callable[[Floats], tuple[Floats, Floats]],
    q: Floats,
    goal: Floats,
    free: Sequence[int],
    metric: Floats,
) -> Floats:
    """Move along the constraints to the state nearest to a goal, from one that satisfies them."""

    def distance(q: Floats) -> float:
        miss = q[free] - goal
        return float(miss @ metric @ miss)

    for _ in range(SLIDES):
        slopes, share = at(q)[1][:, free], 1.0
        step = _nearest_step(metric, slopes, goal - q[free], np.zeros(len(slopes)))
        while share > STILL and not np.abs(share * step).max() <= STILL * np.abs(q).max():
            moved = q.copy()
            moved[free] += share * step
            there, left = _satisfy(at, moved, free, metric, nearest=False)
            if left <= MET and distance(there) < (1 - STILL) * distance(q):
                break
            share /= 2
        else:
            return q
        q = there
    return q


def _relative_errors(miss: Floats, slopes: Floats, reach: float) -> Floats:
    """Return the errors of constraints relative to their slopes times the size of the state.

    If a constraint has no slope, its error is 1, or 0 if it is satisfied exactly.
    """
    size = np.linalg.norm(slopes, axis=1) * reach
    ratios: Floats = np.abs(miss) / np.where(size > 0, size, np.maximum(np.abs(miss), 1e-300))
    return ratios


def _is_round_off(at: Callable[[Floats], tuple[Floats, Floats]], q: Floats) -> bool:
    """Return whether phi is only round-off error of its terms, which may be larger than q."""
    phi, slopes = at(q)
    if not (np.isfinite(phi).all() and np.isfinite(slopes).all()):
        return False
    terms = np.linalg.norm(slopes, axis=1) * bending_length(lambda x: at(x)[1], q)
    return bool((np.abs(phi) <= CANCELLED * terms).all())


def _round_digits(numbers: Floats) -> list[float]:
    """Round numbers for a message to six significant digits."""
    return [float(f"{x:.6g}") for x in numbers]


def _definite_mass(mass: Floats, slopes: Floats) -> Floats:
    """Return M, or if it is singular, M plus a positive weight times W^T W of the constraints."""
    units = np.sqrt(np.where(np.diag(mass) > 0, np.diag(mass), 1.0))
    if np.linalg.eigvalsh(mass / np.outer(units, units))[0] > SINGULAR:
        return mass
    squares = (slopes**2).sum(axis=1)
    return mass + np.trace(mass) * slopes.T @ (slopes / np.where(squares > 0, squares, 1)[:, None])


def _nearest_step(metric: Floats, slopes: Floats, wish: Floats, change: Floats) -> Floats:
    """Return the step nearest to a wish that has a prescribed change of phi to first order."""
    n, m = len(wish), len(change)
    # in units in which M has a diagonal of ones and each row has length one
    units = np.sqrt(np.where(np.diag(metric) > 0, np.diag(metric), 1.0))
    rows = slopes / units
    length = np.linalg.norm(rows, axis=1)
    length[length == 0] = 1.0
    rows /= length[:, None]
    matrix = np.zeros((n + m, n + m))
    matrix[:n, :n], matrix[:n, n:], matrix[n:, :n] = metric / np.outer(units, units), rows.T, rows
    right = np.concatenate([metric @ wish / units, change / length])
    solution: Floats = np.linalg.lstsq(matrix, right, rcond=None)[0][:n]
    return solution / units


def _evaluator(
    system: Declared, values: Sequence[float], t: float
) -> Callable[[Floats], tuple[Floats, Floats, Floats, Floats]]:
    """Return a function of q that computes phi, (-phi_t, b), the rows (Phi, A), and M."""
    plain, n = system.plain, system.n
    graph, places = plain.graph, plain.numbers(plain.q)
    held = plain.write_constraints(graph)
    slopes = [x for row in constraints.slopes(graph, held.phi, places) for x in row]
    slopes += [x for row in held.rows for x in row[:-1]]
    mass = [plain.entry(i, j) for i in range(n) for j in range(n)]
    sides = held.sides(graph, plain.time)
    wanted: list[Value] = [*held.phi, *sides, *slopes, *mass]
    known = dict(zip(plain.numbers(plain.parameters), values, strict=True))
    known[plain.time] = t

    def at(q: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        point = known | dict(zip(places, q.tolist(), strict=True))
        numbers = np.array(evaluate_doubles(graph, wanted, point))
        m, count = len(held.phi), len(sides)
        phi, b, slopes, mass = np.split(numbers, np.cumsum([m, count, count * n]))
        return phi, b, slopes.reshape(count, n), mass.reshape(n, n)

    return at
