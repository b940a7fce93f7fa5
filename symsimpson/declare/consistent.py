"""The nearest state that satisfies the constraints of a system."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.declare import constraints
from symsimpson.declare.declared import Declared, read_values, read_vector
from symsimpson.errors import reject
from symsimpson.graph.evaluate import doubles
from symsimpson.graph.nodes import Value
from symsimpson.support.array_types import Floats
from symsimpson.support.lengths import bending_length
from symsimpson.support.names import constraint_called, spelled

#: Iterations for positions; what is left of constraints, relative to their slopes and to q.
MOST, NEAR = 200, 1e-15
#: What may be left of constraints of positions, likewise.
MET = 1e-12
#: Steps along the constraints; as small a part of a state, or of what is missed, is none.
SLIDES, STILL = 100, 1e-9
#: M with a diagonal of ones is singular where its least eigenvalue is below this.
SINGULAR = 1e-9
#: What rounding leaves of terms that cancel, in units of them.
CANCELLED = 1e-14
#: What may be left of constraints of velocities, relative to their rows and to v.
ALLOWED = 1e-12


def consistent(
    system: Declared,
    q0: ArrayLike,
    v0: ArrayLike,
    fixed: Iterable[Any],
    parameters: Mapping[Any, Any] | None,
    t: float,
) -> tuple[Floats, Floats]:
    """Return the nearest q and v with phi(q) = 0, Phi v = 0 and A v = b, measured by M(q0)."""
    names = [spelled(q) for q in system.coordinates]
    q, v = read_vector(system, "q0", q0), read_vector(system, "v0", v0)
    try:
        t = float(t)
    except (TypeError, ValueError, OverflowError):
        t = np.nan
    if not np.isfinite(t):
        reject(f"{system.name}: t is no finite number.", remedy="Pass one, as t=0.0.")
    single = isinstance(fixed, str) or hasattr(fixed, "free_symbols")
    if not (single or isinstance(fixed, Iterable)):
        reject(
            f"{system.name}: fixed is {fixed!r}, no coordinates.",
            remedy=f"Name them: fixed=[{names[0]!r}].",
        )
    held = {spelled(x) for x in ((fixed,) if single else fixed)}
    unknown = held - set(names)
    if unknown:
        reject(
            f"{system.name}: fixed names {', '.join(sorted(unknown))}, but the coordinates are "
            f"{', '.join(names)}."
        )
    values = read_values("parameters", "parameter", system.parameters, parameters)
    if not (system.constraints or system.velocity_constraints):
        return q, v
    free = [i for i, name in enumerate(names) if name not in held]
    at = _functions(system, values, t)
    m = len(system.constraints)
    _, slopes, mass = at(q)
    metric = _positive(mass, slopes)[np.ix_(free, free)]

    def of_positions(q: Floats) -> tuple[Floats, Floats]:
        values, slopes, _ = at(q)
        return values[:m], slopes[:m]

    # the nearest of all; where the way to it does not settle, from one that Newton's method
    # reaches along the constraints
    for nearest in (True, False):
        configuration, left = _followed(of_positions, q, free, metric, nearest=nearest)
        if left <= MET or _rounded(of_positions, configuration):
            break
    else:
        reject(
            f"{system.name}: there is no state near q0={_shown(q)} "
            "that satisfies the constraints"
            + (f" with {', '.join(sorted(held))} as given" if held else "")
            + ".\nGive a start that is nearer, or hold fewer coordinates fixed."
        )
    configuration = _unwound(of_positions, configuration, q, free)
    q = _slid(of_positions, configuration, q[free], free, metric)
    b, slopes, mass = at(q)
    b = np.where(np.arange(len(b)) < m, 0.0, b)
    if not all(np.isfinite(x).all() for x in (b, slopes, mass)):
        reject(
            f"{system.name}: constraints or the mass matrix have no finite value at "
            f"q0={_shown(q)}, t={t:g}.",
            remedy="Give a start where they have one.",
        )
    metric, given = _positive(mass, slopes)[np.ix_(free, free)], v.copy()
    for _ in range(2):  # once more, for what rounding has left
        v[free] += _nearest(metric, slopes[:, free], np.zeros(len(free)), b - slopes @ v)
    speed = max(np.abs(v).max(), np.abs(given).max())
    off = _relative(b - slopes @ v, slopes, speed)
    if not off.max() <= ALLOWED:
        names = [*system.constraints, *system.velocity_constraints]
        reject(
            f"{system.name}: no velocities at q0={_shown(q)} satisfy the constraint "
            f"{constraint_called(names[int(np.argmax(off))])}"
            + (f" with those of {', '.join(sorted(held))} as given" if held else "")
            + ".\nGive another start, or hold fewer coordinates fixed."
        )
    return q, v


def _followed(
    at: Callable[[Floats], tuple[Floats, Floats]],
    start: Floats,
    free: Sequence[int],
    metric: Floats,
    *,
    nearest: bool,
) -> tuple[Floats, float]:
    """Return positions that satisfy the constraints, and how far off they are."""
    q, goal, best, stalled = start.copy(), start[free], np.inf, 0
    for _ in range(MOST):
        phi, slopes = at(q)
        if not len(phi):
            return q, 0.0
        reach = max(np.abs(q).max(), np.abs(start).max())
        off = _relative(phi, slopes, reach)
        if not np.isfinite(off).all():
            return q, np.inf
        worst = float(off.max())
        stalled = 0 if worst < 0.5 * best else stalled + 1
        best = min(best, worst)
        # near the end the way back to the start would but add noise
        back = nearest and worst > 1e-9
        wish = goal - q[free] if back else np.zeros(len(free))
        step = _nearest(metric, slopes[:, free], wish, -phi)
        if worst <= NEAR and (np.abs(step) <= 1e-15 * reach).all():
            break
        if stalled > 20:
            break
        share, rest = 1.0, NEAR * reach * np.linalg.norm(slopes)
        while not nearest and share > 1e-3:  # no further than phi falls
            moved = q.copy()
            moved[free] += share * step
            if np.linalg.norm(at(moved)[0]) <= (1 - share / 4) * np.linalg.norm(phi) + rest:
                break
            share /= 2
        q[free] += share * step
    return q, best


def _unwound(
    at: Callable[[Floats], tuple[Floats, Floats]], q: Floats, goal: Floats, free: Sequence[int]
) -> Floats:
    """Leave whole turns out, where constraints are met without them, too: those of angles are."""
    turns = 2 * np.pi * np.round((q - goal) / (2 * np.pi))
    for i in [i for i in free if turns[i]]:
        moved = q.copy()
        moved[i] -= turns[i]
        phi, slopes = at(moved)
        if _relative(phi, slopes, float(np.abs(moved).max())).max(initial=0.0) <= MET:
            q = moved
    return q


def _slid(
    at: Callable[[Floats], tuple[Floats, Floats]],
    q: Floats,
    goal: Floats,
    free: Sequence[int],
    metric: Floats,
) -> Floats:
    """Go along the constraints, from a state that satisfies them, as near to a goal as may be."""

    def away(q: Floats) -> float:
        miss = q[free] - goal
        return float(miss @ metric @ miss)

    for _ in range(SLIDES):
        slopes, share = at(q)[1][:, free], 1.0
        step = _nearest(metric, slopes, goal - q[free], np.zeros(len(slopes)))
        while share > STILL and not np.abs(share * step).max() <= STILL * np.abs(q).max():
            moved = q.copy()
            moved[free] += share * step
            there, left = _followed(at, moved, free, metric, nearest=False)
            if left <= MET and away(there) < (1 - STILL) * away(q):
                break
            share /= 2
        else:
            return q
        q = there
    return q


def _relative(miss: Floats, slopes: Floats, reach: float) -> Floats:
    """Return by how much constraints are missed, in units of their slopes and of a state.

    What has no size is missed wholly, or not at all.
    """
    size = np.linalg.norm(slopes, axis=1) * reach
    ratios: Floats = np.abs(miss) / np.where(size > 0, size, np.maximum(np.abs(miss), 1e-300))
    return ratios


def _rounded(at: Callable[[Floats], tuple[Floats, Floats]], q: Floats) -> bool:
    """Return whether but rounding is left of constraints, whose terms may be large against q."""
    phi, slopes = at(q)
    if not (np.isfinite(phi).all() and np.isfinite(slopes).all()):
        return False
    terms = np.linalg.norm(slopes, axis=1) * bending_length(lambda x: at(x)[1], q)
    return bool((np.abs(phi) <= CANCELLED * terms).all())


def _shown(numbers: Floats) -> list[float]:
    """Round numbers for a message, to digits that say something in any unit."""
    return [float(f"{x:.6g}") for x in numbers]


def _positive(mass: Floats, slopes: Floats) -> Floats:
    """Return M, or where that is singular M with weights of what constraints take."""
    units = np.sqrt(np.where(np.diag(mass) > 0, np.diag(mass), 1.0))
    if np.linalg.eigvalsh(mass / np.outer(units, units))[0] > SINGULAR:
        return mass
    squares = (slopes**2).sum(axis=1)
    return mass + np.trace(mass) * slopes.T @ (slopes / np.where(squares > 0, squares, 1)[:, None])


def _nearest(metric: Floats, slopes: Floats, wish: Floats, change: Floats) -> Floats:
    """Return the step nearest to a wish with a given change of phi to first order."""
    n, m = len(wish), len(change)
    # in units in which M has a diagonal of one, and each row the length one
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


def _functions(
    system: Declared, values: Sequence[float], t: float
) -> Callable[[Floats], tuple[Floats, Floats, Floats]]:
    """Return phi and behind it b, Phi and behind it A, and M, as a function of q."""
    plain, n = system.plain, system.n
    graph, places = plain.graph, plain.numbers(plain.q)
    phi, rows = list(plain.constraints.values()), list(plain.velocity_constraints.values())
    slopes = [x for row in constraints.slopes(graph, phi, places) for x in row]
    slopes += [x for row in rows for x in row[:-1]]
    mass = [plain.entry(i, j) for i in range(n) for j in range(n)]
    wanted: list[Value] = [*phi, *(row[-1] for row in rows), *slopes, *mass]
    known = dict(zip(plain.numbers(plain.parameters), values, strict=True))
    known[plain.time] = t

    def at(q: Floats) -> tuple[Floats, Floats, Floats]:
        point = known | dict(zip(places, q.tolist(), strict=True))
        numbers = np.array(doubles(graph, wanted, point))
        m = len(phi) + len(rows)
        slopes, mass = numbers[m : m + m * n], numbers[m + m * n :]
        return numbers[:m], slopes.reshape(m, n), mass.reshape(n, n)

    return at
