"""Prescribed motions: coordinates that are eliminated, and the forces that move them."""

import pickle

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

x, th = ss.coordinates("x theta")
M, m, l, A, w, u = sp.symbols("M m l A w u")
FAST = (x.diff() + l * sp.cos(th) * th.diff()) ** 2 + (l * sp.sin(th) * th.diff()) ** 2
CART = {
    "coordinates": (x, th),
    "kinetic": M * x.diff() ** 2 / 2 + m * FAST / 2,
    "potential": -9.81 * m * l * sp.cos(th),
    "parameters": {M: 2.0, m: 1.0, l: 0.7, A: 0.3, w: 4.0},
    "forces": {"drag": {x: -x.diff() / 3, th: -th.diff() / 30}, "wind": {x: sp.cos(th) / 5}},
}
MOTION = A * sp.sin(w * ss.time)


def cart(**more):
    return ss.MechanicalSystem("cart", **(CART | more))


def test_a_prescribed_motion_is_that_of_a_constraint():
    system = cart(prescribed={x: MOTION}, positions={"bob": (x + l * sp.sin(th), -l * sp.cos(th))})
    assert system.coordinates == (th,)
    run = ss.compile(system, "gauss8").integrate([0.5], v0=[0.1], h=0.02, steps=100)
    held = ss.compile(cart(constraints={"drive": x - MOTION}), "gauss8")
    other = held.integrate([0, 0.5], v0=[1.2, 0.1], h=0.02, steps=100)
    np.testing.assert_allclose(run["theta"], other["theta"], atol=1e-13)
    np.testing.assert_allclose(run["x"], other["x"], atol=1e-13)
    np.testing.assert_allclose(run["v_x"], other["v_x"], atol=1e-13)
    np.testing.assert_allclose(run["force_x"], -other["lambda_drive"], atol=1e-12)
    bob = run["x"] + 0.7 * np.sin(run["theta"])
    np.testing.assert_allclose(run["bob"][:, 0], bob, atol=1e-14)
    assert np.abs(run.energy_balance).max() < 1e-12


@pytest.mark.slow
def test_inputs_and_ensembles():
    """The force at an input that jumps, and forces of all members."""
    forces = {"forces": {th: u}, "inputs": [u]}
    given = {"h": 0.01, "steps": 10, "inputs": {"u": np.arange(10.0)}}
    moved = ss.compile(cart(**forces, prescribed={x: A * ss.time**2}))
    held = ss.compile(cart(**forces, constraints={"drive": x - A * ss.time**2}))
    run, other = (
        moved.integrate([0.5], v0=[0], **given),
        held.integrate([0, 0.5], v0=[0, 0], **given),
    )
    np.testing.assert_allclose(run["force_x"], -other["lambda_drive"], atol=1e-12)
    several = moved.ensemble([[0.5], [0.6]], v0=[0], every=1, **given)
    np.testing.assert_allclose(several[0]["force_x"], run["force_x"], atol=1e-13)
    with pytest.raises(ss.InputError, match="single members only"):
        _ = several["force_x"]
    plain = ss.compile(cart(prescribed={x: MOTION}))
    several = plain.ensemble([[0.5], [0.6]], v0=[0.1], h=0.02, steps=20, every=5)
    run = plain.integrate([0.6], v0=[0.1], h=0.02, steps=20, every=5)
    np.testing.assert_allclose(several["force_x"][1], run["force_x"], atol=1e-13)


def test_a_constant_velocity_is_a_prescribed_motion_too():
    """Terms of degree 0 and 1 in the velocities appear without the time."""
    free = cart(prescribed={x: A * ss.time}, forces={})
    run = ss.compile(free, "gauss6").integrate([0.5], v0=[0.0], h=0.02, steps=50)
    other = ss.compile(cart(prescribed={x: sp.S.Zero}, forces={}), "gauss6")
    still = other.integrate([0.5], v0=[0.0], h=0.02, steps=50)
    np.testing.assert_allclose(run.q, still.q, atol=1e-13)  # Galilei


def test_copies_and_lagrangians():
    system = cart(prescribed={x: MOTION})
    copy = pickle.loads(pickle.dumps(system))
    assert copy == system
    assert copy.motion.names == ("x", "v_x", "force_x")
    given = {"parameters": CART["parameters"], "forces": CART["forces"]}
    lagrangian = CART["kinetic"] - CART["potential"]
    other = ss.MechanicalSystem.from_lagrangian(
        "cart", lagrangian, (x, th), **given, prescribed={x: MOTION}
    )
    assert sp.simplify(system.lagrangian - other.lagrangian) == 0


@pytest.mark.parametrize(
    ("prescribed", "told"),
    [
        ([1], "prescribed is a list, not a mapping"),
        ({sp.Symbol("x"): 1}, "contains x, which is not one of the coordinates x, theta"),
        ({x: th}, "the prescribed motion of x, theta, contains a coordinate"),
        ({x: u}, "contains u, which is no parameter"),
        ({x: 1, th: 2}, "the motions of all coordinates are prescribed"),
    ],
)
def test_what_is_refused(prescribed, told):
    with pytest.raises(ss.ModelError, match=told):
        cart(prescribed=prescribed)
