"""Runs past the pole of spherical angles, compared with the motion in space.

The angles turn by half a turn within the time eps/v, at a distance eps and a speed v; a step that
is longer cannot follow. The unit vector n along the body's axis is regular there; its equations are
those of a symmetric top with I n'' = -I |n'|^2 n + p n x n' - c (e - n (n e)), where p is the
momentum of the spin (0 for the spherical pendulum), c the torque of gravity and e points against
gravity.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from symsimpson.api.compiling import compile as compile_system
from symsimpson.api.stepper import Stepper
from symsimpson.errors import ResolutionWarning
from symsimpson.program.status import Status
from symsimpson.reference import FirstOrder, rk4
from symsimpson.run.ended import uninterrupted
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.array_types import Floats
from symsimpson.systems import lagrange_top, spherical_pendulum

__all__ = ["PolePass", "pole_sweep"]

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
