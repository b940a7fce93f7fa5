"""Stress tests of a scheme on standard problems: the linear oscillator, a pass of a pole.

The angles of a body turn by half a turn within the time eps/v where its axis passes the pole of
spherical angles at a distance eps and a speed v; a step that is longer cannot follow. The unit
vector n along the axis is regular there; its equations are those of a symmetric top with
I n'' = -I |n'|^2 n + p n x n' - c (e - n (n e)), where p is the momentum of the spin (0 for the
spherical pendulum), c the torque of gravity and e points against gravity.
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
from symsimpson.run.ended import uninterrupted
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import without_step_warnings
from symsimpson.systems import harmonic_oscillator, lagrange_top, spherical_pendulum

#: Steps of the solution in space for each step of the scheme.
FINER = 200
#: Rate of the top about its axis, in rad/s.
SPIN = 252.0


@dataclass(frozen=True)
class PolePass:
    """One run past a pole.

    Attributes
    ----------
    system, scheme : str
    distance : float
        Of the closest approach, in radians.
    status : Status
    error : float
        Largest difference of the axis to the motion in space at the end of the run, or before the
        step at which it stopped.
    energy_error : float
        Largest relative energy error.
    warned : bool
        Whether the run warned that its steps did not resolve the pass.
    """

    system: str
    scheme: str
    distance: float
    status: Status
    error: float
    energy_error: float
    warned: bool


@dataclass(frozen=True)
class _Case:
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
    """Run the Lagrange top and the spherical pendulum past a pole at some distances.

    Parameters
    ----------
    scheme : str or Scheme
    distances : sequence of float
        In radians.
    phase : float
        Where within a step the pole is met, from 0 to 1.

    Returns
    -------
    list of PolePass
        For the top, then for the pendulum.
    """
    top, pendulum = lagrange_top(), spherical_pendulum()
    m, g, l, inertia, spin_inertia = top.parameters.values()
    mass, length, gravity = pendulum.parameters.values()
    cases = [
        _Case(
            compile_system(top, scheme),
            inertia,
            m * g * l,
            SPIN * spin_inertia,
            down=False,
            speed=8.0,
            h=0.005,
            t_end=0.4,
        ),
        _Case(
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
        _run_past_pole(case, float(distance), phase) for case in cases for distance in distances
    ]


def _run_past_pole(case: _Case, distance: float, phase: float) -> PolePass:
    """Integrate a run that passes the pole at half of its time."""
    steps = round(case.t_end / case.h)
    h = case.t_end / steps
    z = -1.0 if case.down else 1.0
    near = [np.sin(distance), 0.0, z * np.cos(distance), 0.0, case.speed, 0.0]
    equations = _in_space(case)
    half = FINER * steps // 2 + round(phase * FINER)
    start = rk4(equations, near, h=-h / FINER, steps=half, every=half)[1][-1]
    path = rk4(equations, start, h=h / FINER, steps=FINER * steps, every=FINER)[1][:, :3]
    stepper = case.stepper
    q0, v0 = _angles(start[:3], start[3:], case)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", ResolutionWarning)
        run = uninterrupted(stepper.integrate(q0, v0=v0, h=h, steps=steps, on_failure="return"))
    axes = _axis(run.q, case)
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


def _in_space(case: _Case) -> FirstOrder:
    """Write the equations of the axis."""
    n = sp.Matrix(sp.symbols("n:3", real=True))
    v = sp.Matrix(sp.symbols("v:3", real=True))
    p, c = sp.symbols("p c", real=True)
    up = sp.Matrix([0, 0, 1])
    rates = -v.dot(v) * n + p * n.cross(v) - c * (up - n * n[2])
    values = {p: case.spin / case.inertia, c: case.torque / case.inertia}
    return FirstOrder("axis", (*n, *v), (), (*v, *rates), values, ("p", "c"))


def _angles(n: Floats, v: Floats, case: _Case) -> tuple[list[float], list[float]]:
    """Return angles and their velocities for an axis and its velocity."""
    z = -n[2] if case.down else n[2]
    theta = float(np.arctan2(np.hypot(n[0], n[1]), z))
    phi = float(np.arctan2(n[1], n[0]) if case.down else np.arctan2(n[0], -n[1]))
    c, s = np.cos(theta), np.sin(theta)
    if case.down:
        along = np.array([c * np.cos(phi), c * np.sin(phi), s])
        across = np.array([-np.sin(phi), np.cos(phi), 0.0])
        return [theta, phi], [float(v @ along), float(v @ across / s)]
    along = np.array([c * np.sin(phi), -c * np.cos(phi), -s])
    across = np.array([np.cos(phi), np.sin(phi), 0.0])
    turn = float(v @ across / s)
    return [phi, theta, 0.0], [turn, float(v @ along), SPIN - turn * c]


def _axis(q: Floats, case: _Case) -> Floats:
    if case.down:
        theta, phi = q.T
        axis = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)]
    else:
        phi, theta, _ = q.T
        axis = [np.sin(theta) * np.sin(phi), -np.sin(theta) * np.cos(phi), np.cos(theta)]
    return np.array(axis).T


STEPS = 4000
#: A trajectory from (1, 0) that comes further than this is unstable.
FAR = 1e6


@without_step_warnings()
def linear_limits(scheme: str | Scheme, largest: float = 6.0, width: float = 1e-4) -> list[float]:
    """Find where the linear oscillator turns unstable or stable again, as h omega grows.

    Runs of the compiled stepper decide, those of an ensemble with h = 1; each edge is bisected to
    ``width``.

    Parameters
    ----------
    scheme : str or Scheme
    largest : float
        Largest h omega looked at.
    width : float

    Returns
    -------
    list of float
        Edges, the first from stable to unstable.
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
    """Find where a property changes, by a scan and bisection."""
    grid = np.linspace(0.01, largest, round(largest / 0.01))
    seen = stable(grid)
    edges = np.flatnonzero(seen[:-1] != seen[1:])
    low, high, before = grid[edges], grid[edges + 1], seen[edges]
    while edges.size and (high - low).max() > width:
        middle = (low + high) / 2
        here = stable(middle) == before
        low, high = np.where(here, middle, low), np.where(here, high, middle)
    return [float(x) for x in (low + high) / 2]


def theory_limits(scheme: str | Scheme, largest: float = 6.0) -> list[float]:
    """Return the same edges from the scheme's tables: where |trace R| passes 2.

    The step (q0, p0) -> (q1, p1) of L = v^2/2 - q^2/2 is linear; for Simpson's scheme the edges are
    2 sqrt(2), 2 sqrt(3) and 2 sqrt(6).
    """
    method = read_scheme(scheme)

    def stable_at(x: float) -> bool:
        try:
            return bool(abs(np.trace(method.oscillator(x))) - 2 <= 1e-12)
        except np.linalg.LinAlgError:  # a pole of the map
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
    """Map the largest relative energy error over step sizes and a parameter.

    Parameters
    ----------
    stepper : Stepper
    steps : array_like, shape (a,)
        Step sizes; each is fitted to divide ``t_end``.
    parameter : str
    values : array_like, shape (b,)
    state : mapping
        q0, and v0 or p0.
    t_end : float

    Returns
    -------
    ndarray, shape (a, b)
        The range of the energy in units of its mean; infinite where a run failed.
    """
    column = np.asarray(values, dtype=np.float64)
    q0 = np.tile(np.asarray(state["q0"], dtype=np.float64), (column.size, 1))
    other = {key: value for key, value in state.items() if key != "q0"}
    rows = []
    for h in np.asarray(steps, dtype=np.float64):
        count = max(1, round(t_end / h))
        with without_step_warnings():
            ensemble = stepper.ensemble(
                q0,
                **other,
                h=t_end / count,
                steps=count,
                parameters={parameter: column},
                reduce={kind: (kind, "energy") for kind in ("min", "max", "mean")},
            )
        seen = ensemble.reduced
        good = (ensemble.status == 0) & np.isfinite(seen["mean"])
        row = np.full(column.size, np.inf)
        size = np.maximum(np.abs(seen["mean"][good]), 1e-300)
        row[good] = (seen["max"][good] - seen["min"][good]) / size
        rows.append(row)
    return np.array(rows)
