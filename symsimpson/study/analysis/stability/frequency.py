"""The fastest linear oscillation at a state, the strongest damping, and the steps these allow."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
import sympy as sp

from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import StabilityWarning
from symsimpson.graph.derive import Derivatives
from symsimpson.graph.nodes import ZERO, Value, scaled
from symsimpson.program.program import Program
from symsimpson.reference.first_order import Lines
from symsimpson.schemes.named import read_scheme
from symsimpson.study.analysis.stability.standard_problems import theory_limits
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn

#: Limits beyond this are as good as none.
LARGEST = 12.0
#: The Hessian of larger systems takes too long for a warning.
MOST_COORDINATES = 12
#: Smaller steps than this, times the frequency, are stable with every scheme.
ALWAYS_STABLE = 1.5


def largest_frequency(
    system: MechanicalSystem, q: Iterable[float], parameters: Iterable[float], t: float = 0.0
) -> float:
    """Return the largest omega of K x = omega^2 M x, K the Hessian of V at q.

    With constraints K is that of V + lambda.phi for the lambda that holds q at rest, and x is what
    they allow. It is 0 if none is positive, or K or M have no value there. ``parameters`` are the
    values of all parameters, in the order of the system, then those of inputs.
    """
    try:
        matrices = _matrices(system)(*map(float, (*q, *parameters, t)))
        mass, stiffness = _allowed(*matrices) if system.plain.held else (matrices[-1], matrices[0])
        squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return 0.0
    return math.sqrt(max(0.0, float(squares.max(initial=0.0))))


def fastest_rotation(
    system: MechanicalSystem, q: Iterable[float], parameters: Iterable[float], t: float = 0.0
) -> float:
    """Return the largest |Im lambda| of M x'' + (A - A^T - D) x' + K x = 0 at rest, A = da/dq.

    So fast does the motion beside q turn or swing: also that of a charge in a magnetic field, of
    which V knows nothing. It is 0 where one of the matrices has no value. Arguments are those of
    :func:`largest_frequency`.
    """
    n = system.n
    try:
        stiffness, turning, mass = _turning(system)(*map(float, (*q, *[0.0] * n, *parameters, t)))
        solved = np.linalg.solve(mass, np.concatenate([-stiffness, turning], axis=1))
        rates = np.linalg.eigvals(np.vstack([np.eye(2 * n)[n:], solved]))
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return 0.0
    return float(np.abs(rates.imag).max())


@lru_cache(maxsize=64)
def _turning(system: MechanicalSystem) -> Callable[..., Any]:
    """Return a function of q, v, the parameters and t for K, A^T - A + D, and M."""
    plain, n = system.plain, system.n
    graph, derivatives = plain.graph, Derivatives(plain.graph)
    q, v = plain.numbers(plain.q), plain.numbers(plain.v)
    slopes = [[derivatives(a, x) for x in q] for a in plain.a]
    stiffness = [derivatives(derivatives(plain.V, x), y) for x in q for y in q]
    turning = [
        graph.add([slopes[j][i], scaled(-1, slopes[i][j]), derivatives(plain.f[i], v[j])])
        for i in range(n)
        for j in range(n)
    ]
    return _function(system, {"K": stiffness, "G": turning}, (*plain.q, *plain.v), [(n, n)] * 3)


@lru_cache(maxsize=64)
def _matrices(system: MechanicalSystem) -> Callable[..., Any]:
    """Return a function of q, the parameters and t for K, V_q, Phi, each Hess phi, and M."""
    plain, n = system.plain, system.n
    derivatives, q = Derivatives(plain.graph), plain.numbers(plain.q)
    energies = [plain.V, *plain.constraints.values()]
    slopes = [[derivatives(energy, x) for x in q] for energy in energies]
    stiffness, *bends = ([derivatives(slope, x) for slope in row for x in q] for row in slopes)
    entries = {
        "K": stiffness,
        "F": slopes[0],
        "Phi": [x for row in slopes[1:] for x in row],
        "B": [x for bend in bends for x in bend],
    }
    for row in plain.velocity_constraints.values():  # they allow less, and hold nothing at rest
        entries["Phi"] += row[:-1]
        entries["B"] += [ZERO] * n**2
    m = len(plain.held)
    return _function(system, entries, plain.q, [(n, n), (n,), (m, n), (m, n, n), (n, n)])


def _allowed(
    K: Floats, force: Floats, slopes: Floats, bends: Floats, M: Floats
) -> tuple[Floats, Floats]:
    """Return M and the Hessian of V + lambda.phi for what constraints allow."""
    n, m = len(M), len(slopes)
    matrix = np.block([[M, slopes.T], [slopes, np.zeros((m, m))]])
    multipliers = np.linalg.solve(matrix, np.concatenate([-force, np.zeros(m)]))[n:]
    free = np.linalg.svd(slopes)[2][m:].T
    return free.T @ M @ free, free.T @ (K + np.tensordot(multipliers, bends, 1)) @ free


def largest_damping(
    system: MechanicalSystem,
    q: Iterable[float],
    v: Iterable[float],
    parameters: Iterable[float],
    t: float = 0.0,
) -> float:
    """Return the largest rate of M^-1 D, D = -df/dv, at which forces damp velocities; 0 if none.

    Arguments are those of :func:`largest_frequency`, and n velocities.
    """
    if not system.plain.forces:
        return 0.0
    try:
        drag, mass = _drag(system)(*map(float, (*q, *v, *parameters, t)))
        rates = np.linalg.eigvals(np.linalg.solve(mass, -drag)).real
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return 0.0
    return max(0.0, float(rates.max()))


@lru_cache(maxsize=64)
def _drag(system: MechanicalSystem) -> Callable[..., Any]:
    """Return a function of q, v, the parameters and t for (df/dv, M)."""
    plain = system.plain
    derivatives, v = Derivatives(plain.graph), plain.numbers(plain.v)
    slopes = [derivatives(force, x) for force in plain.f for x in v]
    return _function(system, {"D": slopes}, (*plain.q, *plain.v), [(system.n, system.n)] * 2)


def _function(
    system: MechanicalSystem,
    entries: dict[str, list[Value]],
    state: tuple[sp.Symbol, ...],
    shapes: Sequence[tuple[int, ...]],
) -> Callable[..., list[Floats]]:
    """Return a function of a state, parameters, inputs and t for arrays of shapes, M the last."""
    plain, size = system.plain, range(system.n)
    entries["M"] = [plain.entry(i, j) for i in size for j in size]
    outputs: dict[tuple[Hashable, ...], Value] = {
        (name, k): x for name, values in entries.items() for k, x in enumerate(values)
    }
    function = Lines(plain, outputs).function(state, "math")
    ends = np.cumsum([math.prod(shape) for shape in shapes])[:-1]

    def found(*numbers: float) -> list[Floats]:
        parts = np.split(np.array(function(*numbers), dtype=np.float64), ends)
        return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]

    return found


@cache
def largest_stable(scheme: str) -> float:
    """Return h omega up to which a scheme is stable for a linear oscillator; inf if for all."""
    if read_scheme(scheme).unbounded:
        return math.inf
    edges = theory_limits(scheme, LARGEST)
    return edges[0] if edges else math.inf


def warn_of_step(
    program: Program,
    system: MechanicalSystem,
    q: Iterable[float],
    v: Iterable[float],
    values: Iterable[float],
    h: float,
    t: float,
) -> None:
    """Warn of a step that does not resolve what is fast at the start: oscillations, or damping."""
    if system.plain.held:
        warn_of_turning(program, system, v, h)
    if system.n > MOST_COORDINATES:
        return
    if not system.plain.held:  # else M says little of what damps
        _warn_of_damping(program, system, (q, v, values, t), h)
    omega = largest_frequency(system, q, values, t)
    if abs(h) * omega >= ALWAYS_STABLE:
        limit = largest_stable(program.scheme)
        if abs(h) * omega > limit:
            warn(
                f"{program.system}, {program.scheme}: h={h:g} is beyond the limit of linear "
                f"stability. The fastest oscillation at the start has omega={omega:.4g}; h omega "
                f"is {abs(h) * omega:.3g}, and from {limit:.3g} on oscillations may grow.\n"
                f"Take h below {limit / omega:.3g}, or a Gauss scheme ('midpoint', 'gauss8'), "
                "which is linearly stable for every h.",
                StabilityWarning,
            )
            return
    if not system.plain.held:
        omega = fastest_rotation(system, q, values, t)
    if abs(h) * omega > math.pi:
        warn(
            f"{program.system}, {program.scheme}: what turns or swings fastest at the start, of "
            f"omega={omega:.4g}, turns by {abs(h) * omega:.3g} rad in a step of h={h:g}. From pi "
            "on states one step apart cannot show that: it looks slower, or as if it turned the "
            f"other way, and is not resolved.\nTake h below {math.pi / omega:.3g}, and well below "
            "for accuracy; or leave it so, if only slow parts of the motion matter.",
            StabilityWarning,
        )


def _warn_of_damping(
    program: Program, system: MechanicalSystem, state: tuple[Any, ...], h: float
) -> None:
    """Warn where momenta would keep a part that damping takes from the motion in no time."""
    rate = largest_damping(system, *state)
    if rate == 0:
        return
    scheme = read_scheme(program.scheme)
    if abs(h) * rate <= 2 * scheme.degree or not scheme.symmetric:
        return
    warn(
        f"{program.system}, {program.scheme}: h={h:g} does not resolve the strongest damping at "
        f"the start, of rate {rate:.4g}: the damped part of the momenta hardly decays, or "
        f"alternates in sign.\nTake h below {2 * scheme.degree / rate:.3g}, or the scheme 'radau3' "
        "or 'radau5', with which it decays.",
        StabilityWarning,
    )


#: A path of a few control points does not resolve a larger turn in a step, in radians.
LARGEST_TURN = 1.5


@lru_cache(maxsize=64)
def _quaternions(system: MechanicalSystem) -> tuple[tuple[int, ...], ...]:
    """Return the places of four coordinates whose squares a constraint adds up to a number."""
    plain, groups = system.plain, []
    place = {x: i for i, x in enumerate(plain.numbers(plain.q))}
    for value in plain.constraints.values():
        symbols = plain.graph.nodes[value[1]].symbols
        if len(symbols) != 4 or not symbols <= place.keys():
            continue  # before SymPy is asked, which takes long for many constraints
        group = sorted(place[x] for x in symbols)
        phi = plain.written(value)
        squares = sum((plain.q[i] ** 2 for i in group), sp.S.Zero)
        scale = sp.diff(phi, plain.q[group[0]], 2) / 2
        if scale.is_number and scale != 0 and sp.expand(phi / scale - squares + 1) == 0:
            groups.append(tuple(group))
    return tuple(groups)


def fastest_turn(system: MechanicalSystem, v: Iterable[float]) -> float:
    """Return the largest angular velocity of bodies turned by unit quaternions, 0 without any.

    It is twice the length of the velocity of the quaternion.
    """
    rates = list(map(float, v))
    speeds = [2 * math.hypot(*(rates[i] for i in group)) for group in _quaternions(system)]
    return max(speeds, default=0.0)


def warn_of_turning(
    program: Program, system: MechanicalSystem, v: Iterable[float], h: float
) -> None:
    """Warn of a step in which a body turns too far."""
    speed = fastest_turn(system, v)
    if speed * abs(h) > LARGEST_TURN:
        warn(
            f"{program.system}, {program.scheme}: a step of h={h:g} turns a body by "
            f"{speed * abs(h):.3g} rad, at {speed:.4g} rad/s; with quaternions a step "
            f"resolves about {LARGEST_TURN} rad.\nTake h below {LARGEST_TURN / speed:.3g}; or use "
            "Euler angles, where the spin of a symmetric body is cyclic and any step resolves it.",
            StabilityWarning,
        )
