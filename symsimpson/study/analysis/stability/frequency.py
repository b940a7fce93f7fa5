"""The fastest oscillation and the strongest damping at a state, and warnings of large steps."""

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
from symsimpson.graph.nodes import ZERO, Value, scale
from symsimpson.program.program import Program
from symsimpson.reference.first_order import SystemOutputs
from symsimpson.schemes.named import read_scheme
from symsimpson.study.analysis.stability.standard_problems import theory_limits
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn

#: Largest value of h omega at which a limit of stability is searched.
LARGEST = 12.0
#: For systems with more coordinates, the Hessian of V takes too long for a warning.
MAX_COORDINATES = 12
#: Every scheme is stable for smaller values of h omega.
ALWAYS_STABLE = 1.5


def largest_frequency(
    system: MechanicalSystem, q: Iterable[float], parameters: Iterable[float], t: float = 0.0
) -> float:
    """Return the largest omega of K x = omega^2 M x, with the Hessian K of V at q.

    With constraints, K is the Hessian of V + lambda.phi, and x satisfies the linearised
    constraints. The multipliers lambda belong to a motion that begins at q with v = 0. The result
    is 0 if no omega^2 is positive, or if K or M is undefined at q. ``parameters`` are the values of
    all parameters, in the order of the system, and then of the inputs.
    """
    try:
        matrices = _stiffness_function(system)(*map(float, (*q, *parameters, t)))
        mass, stiffness = matrices[-1], matrices[0]
        if system.plain.constraint_names:
            mass, stiffness = _project_on_constraints(*matrices)
        squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return 0.0
    return math.sqrt(max(0.0, float(squares.max(initial=0.0))))


def fastest_rotation(
    system: MechanicalSystem, q: Iterable[float], parameters: Iterable[float], t: float = 0.0
) -> float:
    """Return the largest angular frequency of motions near q, rotations included.

    It is the largest |Im lambda| of M x'' + (A - A^T - D) x' + K x = 0 at v = 0, with A = da/dq.
    A rotation may be independent of V, such as the motion of a charge in a magnetic field. The
    result is 0 if one of the matrices is undefined. Arguments as for :func:`largest_frequency`.
    """
    n = system.n
    try:
        values = map(float, (*q, *[0.0] * n, *parameters, t))
        stiffness, gyroscopic, mass = _gyroscopic_function(system)(*values)
        solved = np.linalg.solve(mass, np.concatenate([-stiffness, gyroscopic], axis=1))
        rates = np.linalg.eigvals(np.vstack([np.eye(2 * n)[n:], solved]))
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return 0.0
    return float(np.abs(rates.imag).max())


@lru_cache(maxsize=64)
def _gyroscopic_function(system: MechanicalSystem) -> Callable[..., Any]:
    """Return a function of q, v, parameters, inputs and t for K, A^T - A + D and M."""
    plain, n = system.plain.resting, system.n
    graph, derivatives = plain.graph, Derivatives(plain.graph)
    q, v = plain.numbers(plain.q), plain.numbers(plain.v)
    slopes = [[derivatives(a, x) for x in q] for a in plain.a]
    stiffness = [derivatives(derivatives(plain.V, x), y) for x in q for y in q]
    gyroscopic = [
        graph.add([slopes[j][i], scale(-1, slopes[i][j]), derivatives(plain.f[i], v[j])])
        for i in range(n)
        for j in range(n)
    ]
    entries = {"K": stiffness, "G": gyroscopic}
    return _function(system, entries, (*plain.q, *plain.v), [(n, n)] * 3)


@lru_cache(maxsize=64)
def _stiffness_function(system: MechanicalSystem) -> Callable[..., Any]:
    """Return a function of q, parameters, inputs and t for K, V_q, Phi, Hess phi and M."""
    plain, n = system.plain.resting, system.n
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
    for row in plain.velocity_constraints.values():  # no static force: their Hessian is zero
        entries["Phi"] += row[:-1]
        entries["B"] += [ZERO] * n**2
    m = len(plain.constraint_names)
    return _function(system, entries, plain.q, [(n, n), (n,), (m, n), (m, n, n), (n, n)])


def _project_on_constraints(
    K: Floats, V_q: Floats, Phi: Floats, hessians: Floats, M: Floats
) -> tuple[Floats, Floats]:
    """Return M and the Hessian of V + lambda.phi, projected onto the null space of Phi."""
    n, m = len(M), len(Phi)
    matrix = np.block([[M, Phi.T], [Phi, np.zeros((m, m))]])
    multipliers = np.linalg.solve(matrix, np.concatenate([-V_q, np.zeros(m)]))[n:]
    null_space = np.linalg.svd(Phi)[2][m:].T
    stiffness = K + np.tensordot(multipliers, hessians, 1)
    return null_space.T @ M @ null_space, null_space.T @ stiffness @ null_space


def largest_damping(
    system: MechanicalSystem,
    q: Iterable[float],
    v: Iterable[float],
    parameters: Iterable[float],
    t: float = 0.0,
) -> float:
    """Return the largest eigenvalue of M^-1 D with D = -df/dv, or 0 if none is positive.

    It is the largest rate at which forces damp velocities. Arguments as for
    :func:`largest_frequency`, with the velocities v.
    """
    if not system.plain.forces:
        return 0.0
    try:
        slopes, mass = _damping_function(system)(*map(float, (*q, *v, *parameters, t)))
        rates = np.linalg.eigvals(np.linalg.solve(mass, -slopes)).real
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return 0.0
    return max(0.0, float(rates.max()))


@lru_cache(maxsize=64)
def _damping_function(system: MechanicalSystem) -> Callable[..., Any]:
    """Return a function of q, v, parameters, inputs and t for df/dv and M."""
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
    """Return a function of state, parameters, inputs and t that evaluates ``entries`` and M.

    It returns an array of each of the ``shapes``, M as the last one.
    """
    plain, size = system.plain.resting, range(system.n)
    entries["M"] = [plain.entry(i, j) for i in size for j in size]
    outputs: dict[tuple[Hashable, ...], Value] = {
        (name, k): x for name, values in entries.items() for k, x in enumerate(values)
    }
    function = SystemOutputs(plain, outputs).function(state, "math")
    ends = np.cumsum([math.prod(shape) for shape in shapes])[:-1]

    def evaluate(*numbers: float) -> list[Floats]:
        parts = np.split(np.array(function(*numbers), dtype=np.float64), ends)
        return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]

    return evaluate


@cache
def largest_stable(scheme: str) -> float:
    """Return the limit of h omega for a stable linear oscillator; inf if there is none."""
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
    """Warn of a step size that does not resolve oscillations or damping at the initial state.

    ``values`` are the values of all parameters, in the order of the system, and then of the inputs.
    """
    if system.plain.constraint_names:
        warn_of_rotation(program, system, v, h)
    if system.n > MAX_COORDINATES:
        return
    if (
        not system.plain.constraint_names
    ):  # with constraints, M^-1 D does not give the rates of damping
        _warn_of_damping(program, system, (q, v, values, t), h)
    omega = largest_frequency(system, q, values, t)
    if abs(h) * omega >= ALWAYS_STABLE:
        limit = largest_stable(program.scheme)
        if abs(h) * omega > limit:
            warn(
                f"{program.system}, {program.scheme}: h={h:g} exceeds the limit of linear "
                f"stability. The fastest oscillation at the initial state has omega={omega:.4g}; h "
                f"omega is {abs(h) * omega:.3g}. Oscillations may grow from {limit:.3g} on.\n"
                f"Take h below {limit / omega:.3g}. Or take a Gauss scheme ('midpoint', 'gauss8'), "
                "which is linearly stable for every h.",
                StabilityWarning,
            )
            return
    if not system.plain.constraint_names:
        omega = fastest_rotation(system, q, values, t)
    if abs(h) * omega > math.pi:
        warn(
            f"{program.system}, {program.scheme}: a step of h={h:g} does not resolve the fastest "
            f"oscillation or rotation at the initial state. Its frequency is omega={omega:.4g}, so "
            f"that its phase turns by {abs(h) * omega:.3g} rad in a step. Above pi rad, the states "
            "show a slower motion, or a motion in the opposite direction.\n"
            f"Take h below {math.pi / omega:.3g}, and much smaller for accuracy. Ignore this "
            "warning if only the slow parts of the motion matter.",
            StabilityWarning,
        )


def _warn_of_damping(
    program: Program, system: MechanicalSystem, state: tuple[Any, ...], h: float
) -> None:
    """Warn if the scheme does not damp momenta that forces damp within less than a step."""
    rate = largest_damping(system, *state)
    if rate == 0:
        return
    scheme = read_scheme(program.scheme)
    if abs(h) * rate <= 2 * scheme.degree or not scheme.symmetric:
        return
    warn(
        f"{program.system}, {program.scheme}: h={h:g} does not resolve the strongest damping at "
        f"the initial state. Its rate is {rate:.4g}. The damped part of the momenta hardly decays, "
        f"or alternates in sign.\nTake h below {2 * scheme.degree / rate:.3g}. Or take the scheme "
        "'radau3' or 'radau5', with which it decays.",
        StabilityWarning,
    )


#: The largest rotation in a step, in rad, that a path of a few control points resolves.
LARGEST_TURN = 1.5


@lru_cache(maxsize=64)
def _find_quaternions(system: MechanicalSystem) -> tuple[tuple[int, ...], ...]:
    """Return the indices of unit quaternions: four coordinates with a constraint |q| = 1."""
    plain, groups = system.plain, []
    place = {x: i for i, x in enumerate(plain.numbers(plain.q))}
    for value in plain.constraints.values():
        symbols = plain.graph.nodes[value[1]].symbols
        if len(symbols) != 4 or not symbols <= place.keys():
            continue  # before SymPy is asked, which takes long for many constraints
        group = sorted(place[x] for x in symbols)
        phi = plain.to_sympy(value)
        squares = sum((plain.q[i] ** 2 for i in group), sp.S.Zero)
        scale = sp.diff(phi, plain.q[group[0]], 2) / 2
        if scale.is_number and scale != 0 and sp.expand(phi / scale - squares + 1) == 0:
            groups.append(tuple(group))
    return tuple(groups)


def fastest_turn(system: MechanicalSystem, v: Iterable[float]) -> float:
    """Return the largest angular velocity of bodies with unit quaternions; 0 without any.

    It is twice the norm of the velocity of the quaternion.
    """
    rates = list(map(float, v))
    speeds = [2 * math.hypot(*(rates[i] for i in group)) for group in _find_quaternions(system)]
    return max(speeds, default=0.0)


def warn_of_rotation(
    program: Program, system: MechanicalSystem, v: Iterable[float], h: float
) -> None:
    """Warn of a step in which a body with a quaternion rotates by more than ``LARGEST_TURN``."""
    speed = fastest_turn(system, v)
    if speed * abs(h) > LARGEST_TURN:
        warn(
            f"{program.system}, {program.scheme}: a step of h={h:g} turns a body by "
            f"{speed * abs(h):.3g} rad, at {speed:.4g} rad/s. With quaternions, a step resolves "
            f"about {LARGEST_TURN} rad.\nTake h below {LARGEST_TURN / speed:.3g}. Or use Euler "
            "angles: the spin of a symmetric body is then cyclic, and any step resolves it.",
            StabilityWarning,
        )
