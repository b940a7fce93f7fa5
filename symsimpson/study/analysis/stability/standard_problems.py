"""Stress tests of a scheme on standard problems: the linear oscillator, and a pass of a pole.

Let the axis of a body pass the pole of spherical angles at a distance eps with a speed v. Its
angles then change by half a turn within the time eps/v, which a longer step cannot follow. The unit
vector n along the axis is regular at the pole. For a symmetric top it satisfies
I n'' = -I |n'|^2 n + p n x n' - c (e - n (n e)). Here p is the momentum of the spin (0 for the
spherical pendulum), c is the torque of gravity, and e points against gravity.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray

from symsimpson.api.compiling import compile as compile_system
from symsimpson.api.stepper import Stepper
from symsimpson.errors import ResolutionWarning
from symsimpson.program.status import Status
from symsimpson.reference import FirstOrder, rk4
from symsimpson.run.ended import raise_if_interrupted
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import without_step_warnings
from symsimpson.systems import harmonic_oscillator, lagrange_top, spherical_pendulum

#: Number of steps of the reference solution for n in each step of the scheme.
FINER = 200
#: Spin of the top about its axis, in rad/s.
SPIN = 252.0


@dataclass(frozen=True)
class PolePass:
    """One run past a pole of spherical angles.

    :func:`pole_sweep` returns a list of them.

    Attributes
    ----------
    system, scheme : str
        The names of the system and of the scheme.
    distance : float
        The closest distance of the axis from the pole, in rad.
    status : Status
        The status of the run.
    error : float
        The largest component of the error of the unit vector along the axis, at the last state.
    energy_error : float
        The largest relative energy error.
    warned : bool
        Whether the run warned that its steps did not resolve the pass.

    Examples
    --------
    >>> from symsimpson.study.analysis.stability import pole_sweep
    >>> top, pendulum = pole_sweep("simpson", [0.1])
    >>> pendulum.status.name, pendulum.warned
    ('SUCCESS', False)
    """

    system: str
    scheme: str
    distance: float
    status: Status
    error: float
    energy_error: float
    warned: bool


@dataclass(frozen=True)
class _PoleProblem:
    """A top or a pendulum, in SI units; ``down`` if theta is measured from the downward axis."""

    stepper: Stepper
    inertia: float
    torque: float
    spin: float
    down: bool
    speed: float
    h: float
    t_end: float


def pole_sweep(
    scheme: str | Scheme = "simpson",
    distances: Sequence[float] = tuple(10.0 ** -np.arange(1, 10)),
    *,
    phase: float = 0.0,
) -> list[PolePass]:
    """Run the Lagrange top and the spherical pendulum past a pole at several distances.

    Parameters
    ----------
    scheme : str or Scheme, default "simpson"
        The scheme to test.
    distances : sequence of float, default 0.1, 0.01, ..., 1e-9
        The closest distances from the pole, in rad.
    phase : float, default 0.0
        The time of the closest approach within a step, from 0 to 1.

    Returns
    -------
    list of PolePass
        The runs of the top at each distance, then the runs of the pendulum.
    """
    top, pendulum = lagrange_top(), spherical_pendulum()
    m, g, l, inertia, spin_inertia = top.parameters.values()
    mass, length, gravity = pendulum.parameters.values()
    problems = [
        _PoleProblem(
            compile_system(top, scheme),
            inertia,
            m * g * l,
            SPIN * spin_inertia,
            down=False,
            speed=8.0,
            h=0.005,
            t_end=0.4,
        ),
        _PoleProblem(
            compile_system(pendulum, scheme),
            mass * length**2,
            mass * gravity * length,
            0.0,
            down=True,
            speed=3.0,
            h=0.02,
            t_end=1.0,
        ),
    ]
    return [
        _run_past_pole(problem, float(distance), phase)
        for problem in problems
        for distance in distances
    ]


def _run_past_pole(problem: _PoleProblem, distance: float, phase: float) -> PolePass:
    """Integrate a motion that passes the pole at half of its duration."""
    steps = round(problem.t_end / problem.h)
    h = problem.t_end / steps
    z = -1.0 if problem.down else 1.0
    near = [np.sin(distance), 0.0, z * np.cos(distance), 0.0, problem.speed, 0.0]
    equations = _axis_equations(problem)
    half = FINER * steps // 2 + round(phase * FINER)
    start = rk4(equations, near, h=-h / FINER, steps=half, every=half)[1][-1]
    path = rk4(equations, start, h=h / FINER, steps=FINER * steps, every=FINER)[1][:, :3]
    stepper = problem.stepper
    q0, v0 = _angles(start[:3], start[3:], problem)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", ResolutionWarning)
        run = raise_if_interrupted(
            stepper.integrate(q0, v0=v0, h=h, steps=steps, on_failure="return")
        )
    axes = _axis(run.q, problem)
    done = len(axes) - 1
    return PolePass(
        stepper.system,
        stepper.scheme,
        distance,
        run.status,
        float(np.abs(axes[done] - path[done]).max()),
        float(np.abs(run.energy_error).max()),
        any(issubclass(warning.category, ResolutionWarning) for warning in warned),
    )


def _axis_equations(problem: _PoleProblem) -> FirstOrder:
    """Return the differential equations of the unit vector n and its velocity."""
    n = sp.Matrix(sp.symbols("n:3", real=True))
    v = sp.Matrix(sp.symbols("v:3", real=True))
    p, c = sp.symbols("p c", real=True)
    up = sp.Matrix([0, 0, 1])
    rates = -v.dot(v) * n + p * n.cross(v) - c * (up - n * n[2])
    values = {p: problem.spin / problem.inertia, c: problem.torque / problem.inertia}
    return FirstOrder("axis", (*n, *v), (), (*v, *rates), values, ("p", "c"))


def _angles(n: Floats, v: Floats, problem: _PoleProblem) -> tuple[list[float], list[float]]:
    """Return the angles and their velocities for an axis n and its velocity v."""
    z = -n[2] if problem.down else n[2]
    theta = float(np.arctan2(np.hypot(n[0], n[1]), z))
    phi = float(np.arctan2(n[1], n[0]) if problem.down else np.arctan2(n[0], -n[1]))
    c, s = np.cos(theta), np.sin(theta)
    if problem.down:
        along = np.array([c * np.cos(phi), c * np.sin(phi), s])
        across = np.array([-np.sin(phi), np.cos(phi), 0.0])
        return [theta, phi], [float(v @ along), float(v @ across / s)]
    along = np.array([c * np.sin(phi), -c * np.cos(phi), -s])
    across = np.array([np.cos(phi), np.sin(phi), 0.0])
    turn = float(v @ across / s)
    return [phi, theta, 0.0], [turn, float(v @ along), SPIN - turn * c]


def _axis(q: Floats, problem: _PoleProblem) -> Floats:
    """Return the axis for angles q, shape (N, 3)."""
    if problem.down:
        theta, phi = q.T
        axis = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)]
    else:
        phi, theta, _ = q.T
        axis = [np.sin(theta) * np.sin(phi), -np.sin(theta) * np.cos(phi), np.cos(theta)]
    return np.array(axis).T


STEPS = 4000
#: A trajectory from (1, 0) is unstable if it exceeds this distance.
FAR = 1e6


@without_step_warnings()
def linear_limits(scheme: str | Scheme, largest: float = 6.0, width: float = 1e-4) -> list[float]:
    """Find the values of h omega at which the linear oscillator changes its stability.

    Runs of the compiled stepper with h = 1 and omega as parameter decide. Bisection locates each
    change.

    Parameters
    ----------
    scheme : str or Scheme
        The scheme to test.
    largest : float, default 6.0
        The largest value of h omega.
    width : float, default 1e-4
        The tolerance of the bisection.

    Returns
    -------
    list of float
        The values of h omega in ascending order. The first is a change from stable to unstable.
    """
    q = harmonic_oscillator().coordinates[0]
    stepper = compile_system(harmonic_oscillator(), scheme)

    def stable(x: Floats) -> NDArray[np.bool_]:
        ensemble = stepper.ensemble(
            np.ones((x.size, 1)),
            p0=np.zeros((x.size, 1)),
            h=1.0,
            steps=STEPS,
            every=None,
            parameters={"m": 1.0, "k": x**2},
            reduce={"least": ("min", q), "largest": ("max", q)},
        )
        near = [np.abs(ensemble.reduced[name]) < FAR for name in ("least", "largest")]
        return (ensemble.status == 0) & near[0] & near[1]

    return _edges(stable, largest, width)


def _edges(
    stable: Callable[[Floats], NDArray[np.bool_]], largest: float, width: float
) -> list[float]:
    """Find the arguments at which ``stable`` changes, by a scan and bisection."""
    grid = np.linspace(0.01, largest, round(largest / 0.01))
    values = stable(grid)
    edges = np.flatnonzero(values[:-1] != values[1:])
    low, high, left = grid[edges], grid[edges + 1], values[edges]
    while edges.size and (high - low).max() > width:
        middle = (low + high) / 2
        same = stable(middle) == left
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return [float(x) for x in (low + high) / 2]


def theory_limits(scheme: str | Scheme, largest: float = 6.0) -> list[float]:
    """Return the limits of :func:`linear_limits` from the tables of the scheme.

    The step of L = v^2/2 - q^2/2 is a linear map R of (q, p). It is stable if |trace R| <= 2. For
    Simpson's scheme the limits are 2 sqrt(2), 2 sqrt(3) and 2 sqrt(6).

    Parameters
    ----------
    scheme : str or Scheme
        The scheme.
    largest : float, default 6.0
        The largest value of h omega.

    Returns
    -------
    list of float
        The values of h omega in ascending order.

    Examples
    --------
    >>> from symsimpson.study.analysis.stability import theory_limits
    >>> [round(x, 6) for x in theory_limits("simpson")]
    [2.828427, 3.464102, 4.898979]
    """
    method = read_scheme(scheme)

    def stable_at(x: float) -> bool:
        try:
            return bool(abs(np.trace(method.oscillator(x))) - 2 <= 1e-12)
        except np.linalg.LinAlgError:  # R is singular for this h omega
            return False

    def stable(x: Floats) -> NDArray[np.bool_]:
        return np.array([stable_at(value) for value in x.tolist()])

    return _edges(stable, largest, 1e-12)


def energy_map(
    stepper: Stepper,
    steps: ArrayLike,
    parameter: str,
    values: ArrayLike,
    *,
    state: Mapping[str, Any],
    t_end: float,
) -> Floats:
    """Map the largest relative energy error over step sizes and values of a parameter.

    Parameters
    ----------
    stepper : Stepper
        The stepper to test.
    steps : array_like, shape (a,)
        The step sizes. Each is changed to the nearest one that divides ``t_end``.
    parameter : str
        The name of the parameter.
    values : array_like, shape (b,)
        The values of the parameter.
    state : mapping
        The initial state: q0, and v0 or p0.
    t_end : float
        The final time of each run.

    Returns
    -------
    ndarray, shape (a, b)
        The range of the energy, divided by its mean. It is infinite if the run failed.
    """
    column = np.asarray(values, dtype=np.float64)
    q0 = np.tile(np.asarray(state["q0"], dtype=np.float64), (column.size, 1))
    velocities = {key: value for key, value in state.items() if key != "q0"}
    rows = []
    for h in np.asarray(steps, dtype=np.float64):
        count = max(1, round(t_end / h))
        with without_step_warnings():
            ensemble = stepper.ensemble(
                q0,
                **velocities,
                h=t_end / count,
                steps=count,
                parameters={parameter: column},
                reduce={kind: (kind, "energy") for kind in ("min", "max", "mean")},
            )
        energy = ensemble.reduced
        good = (ensemble.status == 0) & np.isfinite(energy["mean"])
        row = np.full(column.size, np.inf)
        size = np.maximum(np.abs(energy["mean"][good]), 1e-300)
        row[good] = (energy["max"][good] - energy["min"][good]) / size
        rows.append(row)
    return np.array(rows)
