"""Steps at rest and what runs are warned of: forces that cancel, linear steps, drag, poles."""

import warnings

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.forms import limited

import symsimpson as ss

(X,) = ss.coordinates("x")


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8", "midpoint", "radau5", "gauss16"]))
def test_rest_between_two_walls(scheme):
    """At x = 0 forces of the size 1 cancel: increments are smaller than their rounding."""
    walls = ss.MechanicalSystem(
        "walls",
        coordinates=(X,),
        kinetic=X.diff() ** 2 / 2,
        potential=1 / (1 - X) + 1 / (1 + X),
        parameters={},
    )
    run = ss.compile(walls, scheme).integrate([1e-13], v0=[0.0], h=0.1, t_end=50.0)
    assert np.abs(run.q).max() < 1.1e-13  # omega = 2: it swings with its amplitude
    assert run.q.min() < -0.5e-13 or scheme == "radau5"


@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "lobatto6"]))
def test_what_moves_little_is_solved_beside_what_moves_far(scheme, loops, monkeypatch):
    """A pendulum in a craft on its orbit moves by 1e-13 of what the craft does, in the metric M."""
    if loops:
        limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    x, y, a = ss.coordinates("x y a")
    m, GM, w = sp.symbols("m GM w", positive=True)
    T, V = a.diff() ** 2 / 2, -(w**2) * sp.cos(a)
    craft = ss.MechanicalSystem(
        "craft",
        coordinates=(x, y, a),
        kinetic=T + m * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=V - GM * m / sp.sqrt(x**2 + y**2),
        parameters={m: 500.0, GM: 1.327e20, w: 0.4},
    )
    alone = ss.MechanicalSystem(
        "alone", coordinates=(a,), kinetic=T, potential=V, parameters={w: 0.4}
    )
    given = {"h": 0.5, "steps": 400}
    run = ss.compile(craft, scheme).integrate([1.5e11, 0, 1.0], v0=[0, 3e4, 0.1], **given)
    exact = ss.compile(alone, scheme).integrate([1.0], v0=[0.1], **given)
    assert np.abs(run.q[:, 2] - exact.q[:, 0]).max() < 1e-13


def test_a_linear_step_is_taken_whatever_h_is():
    """Midpoint turns the velocity of a charge by 2 atan(h B/2) a step: B h = 18."""
    x, y = ss.coordinates("x y")
    B = sp.Symbol("B", positive=True)
    L = (x.diff() ** 2 + y.diff() ** 2) / 2 + B / 2 * (x * y.diff() - y * x.diff())
    stepper = ss.compile(
        ss.MechanicalSystem.from_lagrangian("field", L, (x, y), {B: 18.0}), "midpoint"
    )
    with pytest.warns(ss.StabilityWarning, match="turns by 18 rad"):
        run = stepper.integrate([0, 0], v0=[0, 1], h=1.0, steps=5)
    turned = 10 * np.arctan(9.0)
    assert np.abs(run.v[-1] - [np.sin(turned), np.cos(turned)]).max() < 1e-10


@pytest.mark.slow
def test_what_drag_does_not_explain_is_warned_of():
    """A close passage that steps do not resolve, with a drag that takes 1e-6 of the energy."""
    x, y = ss.coordinates("x y")
    bodies = ss.MechanicalSystem(
        "dragged",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-1 / sp.sqrt(x**2 + y**2),
        parameters={},
        dissipation=1e-6 * (x.diff() ** 2 + y.diff() ** 2) / 2,
    )
    stepper = ss.compile(bodies)
    for every in (1, None):
        with pytest.warns(ss.ResolutionWarning, match="has a permanent error"):
            stepper.integrate([1.9, 0], v0=[0, 0.16], h=0.02, t_end=40, every=every)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stepper.integrate([1.0, 0], v0=[0, 1.0], h=0.02, t_end=40)


@pytest.mark.slow
def test_a_pole_that_steps_jump_is_told():
    """In polar coordinates with little angular momentum r would become negative."""
    r, a = ss.coordinates("r a")
    central = ss.MechanicalSystem(
        "central",
        coordinates=(r, a),
        parameters={},
        kinetic=r.diff() ** 2 / 2 + r**2 * a.diff() ** 2 / 2,
        potential=r**2 / 2,
    )
    stepper = ss.compile(central, "gauss8")
    for _ in range(2):  # a short run that was made before is looked at, too
        with pytest.warns(ss.ResolutionWarning, match=r"singular point(.|\n)*constraint"):
            stepper.integrate([1.0, 0.0], p0=[0.0, 1e-4], h=0.05, t_end=5.0)


def test_steps_that_are_lost_in_times_are_refused():
    stepper = ss.compile(ss.systems.pendulum())
    for t0 in (1e15, -1e17):
        with pytest.raises(ss.InputError, match="below round-off"):
            stepper.integrate([0.2], v0=[0.0], h=0.05, steps=10, t0=t0)
