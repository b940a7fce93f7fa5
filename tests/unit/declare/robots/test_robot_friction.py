"""Dry friction of joints from files, and contacts of robots."""

import pickle

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import brentq

import symsimpson as ss
from symsimpson.declare.coordinates import time

BAR = (
    '<inertial><origin xyz="0 0 -1"/><mass value="2"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.02"/></inertial>'
)
HINGE = """<joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
  <dynamics friction="{}" damping="0"/></joint>"""
LEVER = 2 * 9.81  # mass, gravity and distance of the centre


def pendulum(size=4.0, more="", **options):
    text = f'<robot name="r"><link name="a"/><link name="b">{BAR}</link>{HINGE.format(size)}'
    return ss.from_urdf(f"{text}{more}</robot>", **options)


def joint(name, kind, inside='<dynamics friction="0.2"/>'):
    """Return a link below b, and its joint."""
    return (
        f'<link name="c {name}">{BAR}</link><joint name="{name}" type="{kind}"><parent link="b"/>'
        f'<child link="c {name}"/><axis xyz="0 0 1"/>{inside}</joint>'
    )


def test_name_velocity_and_limit():
    system = pendulum(more=joint("s", "prismatic") + joint("p", "planar"))
    j, s, x, y, theta = system.coordinates
    rates = {name: element.velocity for name, element in system.friction.items()}
    names = ["j", "s", "p_x", "p_y", "p_theta"]
    expected = (v.diff(time) for v in (j, s, x, y, theta))
    assert rates == dict(zip((f"{name}.slip" for name in names), expected, strict=True))
    limits = [element.limit for element in system.friction.values()]
    assert limits == [sp.Symbol(f"friction_{name}") for name in names]
    assert [system.parameters[x] for x in limits] == [4.0, 0.2, 0.2, 0.2, 0.2]
    assert pickle.loads(pickle.dumps(system)) == system


def test_velocities_in_coordinates_of_bodies():
    """The velocity of a joint is that of its coordinate, at the same state."""
    more = joint("s", "prismatic")
    joints, bodies = (pendulum(more=more, form=form) for form in ("joints", "bodies"))
    assert joints.friction.keys() == bodies.friction.keys()
    given = {"j": 0.3, "s": 0.2}, {"j": 0.7, "s": -0.4}
    q, v = bodies.state(*given)
    at = dict(zip((x.diff(time) for x in bodies.coordinates), v, strict=True))
    at |= dict(zip(bodies.coordinates, q, strict=True))
    for name, speed in given[1].items():
        velocity = bodies.friction[f"{name}.slip"].velocity
        assert float(velocity.subs(at)) == pytest.approx(speed, abs=1e-14)


def test_what_has_no_friction():
    for system in (pendulum(0), pendulum(friction=False), pendulum(0, form="bodies")):
        assert not system.friction
        assert system.modes is None
        assert [*map(str, system.parameters)] == ["damping_j"]
    slides = joint("s", "prismatic")
    assert [*pendulum(more=slides, locked={"j": 0.1}).friction] == ["s.slip"]
    mimic = joint("k", "continuous", '<mimic joint="j"/><dynamics friction="1"/>')
    with pytest.warns(ss.ModelWarning, match="dry friction of k is left out.*\n.*with_contacts"):
        assert [*pendulum(more=mimic).friction] == ["j.slip"]
    with pytest.warns(ss.ModelWarning, match="dry friction of free is left out"):
        pendulum(more=joint("free", "floating"))


@pytest.mark.filterwarnings("error")
def test_no_warning_if_friction_is_left_out():
    pendulum(more=joint("free", "floating"), friction=False)


def test_contacts_and_friction_of_users():
    robot = pendulum(more=joint("s", "prismatic"))
    mu, height = sp.Symbol("mu"), robot.frame("b")[0][2] + 1
    with_floor = robot.with_contacts({"floor": ss.Contact(height - robot.joints["s"])})
    assert [*with_floor.contacts] == ["floor"]
    assert with_floor.friction == robot.friction
    slide = robot.joints["s"].diff(time)
    stiff = ss.Friction(slide, limit=mu, static=2 * mu)
    both = with_floor.with_contacts(friction={"s.slip": stiff}, parameters={mu: 0.5})
    assert [*both.modes.names] == ["floor", "j.slip", "s.slip"]
    assert both.friction["s.slip"] == stiff
    assert both.parameters[mu] == 0.5
    assert both.table() == robot.table()
    np.testing.assert_array_equal(both.state({"s": 1.0}), robot.state({"s": 1.0}))
    assert pickle.loads(pickle.dumps(both)) == both
    with pytest.raises(ss.ModelError, match="not a Contact"):
        robot.with_contacts({"floor": height})
    with pytest.raises(ss.ModelError, match=r"'j\.slip'"):
        robot.with_contacts({"j.slip": ss.Contact(height)})


@pytest.mark.slow
def test_a_pendulum_stops_at_each_turn_and_sticks():
    """Friction dissipates 4 |q1 - q0| in a swing, and sticks where it carries the weight."""
    turns = [1.2]
    while LEVER * abs(np.sin(q0 := turns[-1])) > 4:
        terms = np.cos(q0), 4 * np.sign(q0), q0

        def energy(q, c, friction, q0):
            return LEVER * (np.cos(q) - c) - friction * (q0 - q)

        turns.append(brentq(energy, 0.99 * q0, -q0, args=terms, xtol=1e-13))
    assert len(turns) == 4
    stepper = ss.compile(pendulum(), "gauss8")
    run = stepper.integrate([turns[0]], v0=[0.0], h=0.01, t_end=4.0)
    assert run.modes.states == [(-1,), (1,), (-1,), (0,)]
    np.testing.assert_allclose(run.events("j.slip").q[:, 0], turns[1:], atol=1e-9)
    assert run["j"][-1] == pytest.approx(turns[-1], abs=1e-9)
    assert run["friction_j.slip"][-1] == pytest.approx(-LEVER * np.sin(turns[-1]), abs=1e-8)
    rough = stepper.integrate([0.5], v0=[0.0], h=0.01, steps=9, parameters={"friction_j": 10.0})
    assert rough.modes.states == [(0,)]


@pytest.mark.slow
@pytest.mark.parametrize("form", ["joints", "bodies"])
def test_both_forms_stop_at_the_same_time(form):
    """Without gravity, the deceleration is constant."""
    system = pendulum(0.5, gravity=(0, 0, 0), form=form)
    q0, v0 = system.state({"j": 0.1}, {"j": 1.0})
    run = ss.compile(system, "gauss4").integrate(q0, v0=v0, h=0.05, t_end=5.0)
    assert run.modes.states == [(1,), (0,)]
    np.testing.assert_allclose(run.modes.t, [0.0, 2.1 / 0.5], atol=1e-7)
    np.testing.assert_allclose(run.q[-1], system.state({"j": 0.1 + 2.1})[0], atol=1e-7)
