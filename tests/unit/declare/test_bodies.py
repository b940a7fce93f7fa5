"""Bodies that turn: conventions, states, joints."""

import os

import numpy as np
import pytest
import sympy as sp
from sympy.physics.mechanics import (
    LagrangesMethod,
    Point,
    ReferenceFrame,
    RigidBody,
    dynamicsymbols,
    inertia,
)

import symsimpson as ss


def turned(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = [k for k in range(3) if k != axis]
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = (-s, s) if axis != 1 else (s, -s)
    return R


def numbers(matrix, body, q, v=None):
    values = dict(zip(body.coordinates, q, strict=True))
    if v is not None:
        matrix = matrix.subs({x.diff(): y for x, y in zip(body.coordinates, v, strict=True)})
    return np.array(matrix.subs(values), dtype=float)


def test_angles_are_those_of_the_catalogue():
    body = ss.RigidBody("b", inertia=(1, 2, 3))
    angles = (0.3, 0.7, 1.1)
    q, v = body.state(angles=angles, angular_velocity=(0.1, 0.2, 0.3))
    R = numbers(body.rotation, body, q)
    assert np.abs(R - turned(2, 0.3) @ turned(0, 0.7) @ turned(2, 1.1)).max() < 1e-15
    assert np.abs(numbers(body.angular_velocity, body, q, v)[:, 0] - [0.1, 0.2, 0.3]).max() < 1e-15
    again, _ = body.state(rotation=R)
    assert np.abs(again - q).max() < 1e-15
    axis = ss.systems.lagrange_top().positions["centre of mass"]
    top = ss.systems.lagrange_top()
    l = next(a for a in top.parameters if a.name == "l")
    of_angles = sp.Matrix(axis).subs(dict(zip(top.coordinates, angles, strict=True))).subs({l: 1})
    assert np.abs(R[:, 2] - np.array(of_angles, dtype=float)[:, 0]).max() < 1e-15


@pytest.mark.parametrize("k", range(4))
def test_rotations_by_any_large_component(k):
    body = ss.RigidBody("b", inertia=(1, 2, 3))
    q = np.full(4, 0.1)
    q[k] = np.sqrt(1 - 0.03)
    found, _ = body.state(rotation=numbers(body.rotation, body, q))
    assert min(np.abs(found - q).max(), np.abs(found + q).max()) < 1e-14


def test_formulas_are_those_of_sympy():
    space, frame = ReferenceFrame("N"), ReferenceFrame("B")
    q = dynamicsymbols("q0:4")
    frame.orient_quaternion(space, q)
    assert sp.simplify(frame.ang_vel_in(space).to_matrix(frame) - ss.body_rates(q)) == sp.zeros(
        3, 1
    )
    assert sp.simplify(frame.dcm(space).T - ss.rotation_matrix(q)) == sp.zeros(3, 3)


def test_rates_of_a_quaternion_that_is_an_expression_of_the_time():
    w = sp.Symbol("w")
    turning = sp.cos(w * ss.time / 2), 0, 0, sp.sin(w * ss.time / 2)
    assert sp.simplify(ss.body_rates(turning) - sp.Matrix([0, 0, w])) == sp.zeros(3, 1)


@pytest.mark.slow
def test_bodies_of_sympy_come_in():
    """With a singular mass matrix, as SymPy writes the energy; the motion is the same."""
    q = dynamicsymbols("q0:4")
    space, frame, centre = ReferenceFrame("N"), ReferenceFrame("B"), Point("O")
    frame.orient_quaternion(space, q)
    centre.set_vel(space, 0)
    rigid = RigidBody("body", centre, frame, 1, (inertia(frame, 1, 1.5, 0.8), centre))
    method = LagrangesMethod(rigid.kinetic_energy(space), q, hol_coneqs=[sum(s**2 for s in q) - 1])
    system = ss.MechanicalSystem.from_lagranges_method("sympy_body", method)
    body = ss.RigidBody("b", inertia=(1, 1.5, 0.8))
    start = body.state(angles=(0.3, 0.7, 1.1), angular_velocity=(0.4, -0.8, 1.2))
    own = ss.MechanicalSystem(
        "own_body",
        coordinates=body.coordinates,
        kinetic=body.kinetic,
        potential=0,
        constraints=body.constraints,
    )
    runs = [ss.compile(s).integrate(*start, h=0.01, steps=50) for s in (system, own)]
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-8  # J0 enters the errors of a step


@pytest.mark.slow
def test_a_free_body_falls():
    m, g = sp.symbols("m g", positive=True)
    body = ss.RigidBody("b", inertia=sp.Matrix([[2, 1, 0], [1, 2, 0], [0, 0, 3]]), mass=m)
    assert len(body.coordinates) == 7
    system = ss.MechanicalSystem(
        "falling",
        coordinates=body.coordinates,
        kinetic=body.kinetic,
        potential=m * g * body.position[2],
        constraints=body.constraints,
        parameters={m: 2.0, g: 10.0},
    )
    q, v = body.state(angular_velocity=(1, 0.1, 0), position=(0, 0, 5), velocity=(1, 0, 0))
    run = ss.compile(system).integrate(q, v, h=0.01, t_end=1.0)
    assert np.abs(run.q[-1, 4:] - [1.0, 0.0, 0.0]).max() < 1e-12
    assert np.abs(run.energy_error).max() < 1e-9
    place = numbers(body.point((0, 0, 1)), body, q)[:, 0]
    assert place.tolist() == [0, 0, 6]


def test_what_is_refused():
    with pytest.raises(ss.ModelError, match="neither three moments"):
        ss.RigidBody("b", inertia=(1, 2))
    with pytest.raises(ss.ModelError, match="neither three moments"):
        ss.RigidBody("b", inertia=sp.Matrix([[1, 2, 0], [0, 1, 0], [0, 0, 1]]))
    with pytest.raises(ss.ModelError, match="no name"):
        ss.quaternion("a b")
    with pytest.raises(ss.ModelError, match="four components"):
        ss.rotation_matrix((1, 0, 0))
    with pytest.raises(ss.ModelError, match="cannot coincide"):
        ss.coincide((1, 2), (1, 2, 3))
    body = ss.RigidBody("b", inertia=(1, 2, 3))
    with pytest.raises(ss.InputError, match="exclude one another"):
        body.state(angles=(0, 0, 0), quaternion=(1, 0, 0, 0))
    with pytest.raises(ss.InputError, match=r"length 1\.1"):
        body.state(quaternion=(1.1, 0, 0, 0))
    with pytest.raises(ss.InputError, match="is not a rotation matrix"):
        body.state(rotation=-np.eye(3))
    with pytest.raises(ss.InputError, match="angles is"):
        body.state(angles=(0, 0))
    with pytest.raises(ss.InputError, match="angular_velocity is"):
        body.state(angular_velocity=(10**400, 0, 0))


@pytest.mark.parametrize("given", [None, 3, "x+"])
def test_what_is_no_quaternion_and_no_point(given):
    for make in (ss.rotation_matrix, ss.body_rates):
        with pytest.raises(ss.ModelError, match="four components, but"):
            make(given)
    with pytest.raises(ss.ModelError, match="a point has components, but"):
        ss.coincide(given, (1, 2))


@pytest.mark.parametrize("vector", [None, "x+", (1, 2), [1, [2], 3]])
def test_what_is_no_vector_in_a_body(vector):
    with pytest.raises(ss.ModelError, match=r"not three|has none|neither a number"):
        ss.RigidBody("b", inertia=(1, 2, 3)).to_space(vector)


@pytest.mark.parametrize("mass", ["", "x+", "sin()", [1.0, 2.0]])
def test_what_is_no_mass_or_moment(mass):
    with pytest.raises(ss.ModelError, match="the mass of 'b' is"):
        ss.RigidBody("b", inertia=(1, 2, 3), mass=mass)
    with pytest.raises(ss.ModelError, match="the fourth moment of 'b' is"):
        ss.RigidBody("b", inertia=(1, 2, 3), fourth=mass)


def test_moments_that_no_body_has_are_told():
    turned = np.array([[3, 0, -2], [0, 1, 0], [-2, 0, 3]])  # of moments 1, 1 and 5
    for moments in ((1, 1, 5), turned):
        with pytest.warns(ss.ModelWarning, match="'b' is greater than the sum of the other two"):
            ss.RigidBody("b", inertia=moments)
    a, b = sp.symbols("a b", positive=True)
    plane = (sp.sqrt(2), sp.pi, sp.sqrt(2) + sp.pi)
    for moments in (plane, (0.0833, 0.0833, 0.1667), (1, 1, 0), (a, a, b), (1, 1, 5 * a)):
        ss.RigidBody("b", inertia=moments)  # a warning fails here


def test_a_quaternion_that_nothing_holds_is_told():
    body = ss.RigidBody("loose", inertia=(1, 2, 3), mass=1)
    given = {"coordinates": body.coordinates, "kinetic": body.kinetic, "potential": 0}
    with pytest.warns(ss.ModelWarning, match="quaternion of the body 'loose'") as found:
        ss.MechanicalSystem("loose", **given)
    assert found[0].filename == __file__
    ss.MechanicalSystem("held", **given, constraints=body.constraints)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: ss.RigidBody(), "is missing name=, inertia="),
        (lambda: ss.RigidBody("b", (1, 1, 1), m=1), "has no argument m="),
        (lambda: ss.RigidBody("b", (1, 1, 1)).state(angle=1), "Did you mean angles="),
        (lambda: ss.RigidBody("b", (1, 1, 1)).state(position=(1, 0, 0)), "has no position"),
        (lambda: ss.RigidBody("b", (-1, 1, 1)), "has a negative moment of inertia"),
        (
            lambda: ss.RigidBody("b", [[1, 0, 0], [0, 1, 2], [0, 2, 1]]),
            "has a negative moment of inertia",
        ),
        (lambda: ss.RigidBody("b", "abc"), "neither three moments"),
        (lambda: ss.coincide(1, 2), "a point has components"),
        (lambda: ss.Event(), "is missing expression="),
        (lambda: ss.Event("x", terminate=True), "Did you mean terminal="),
        (lambda: ss.Impact(e=0.5), "It takes restitution="),
        (lambda: ss.Change(velocity={}), "Did you mean velocities="),
        (lambda: ss.samples([1.0], dt=1), "It takes values=, period="),
    ],
)
def test_arguments_that_there_are_not(call, told):
    with pytest.raises(ss.SymsimpsonError, match=told):
        call()


EVIL = "__import__('os').environ.setdefault('EVALUATED', '1')"
MOVING = ss.RigidBody("moving", inertia=(1, 2, 3), mass=1)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (
            lambda: ss.RigidBody("b", (1, 2, 3), mass=EVIL),
            "the mass of 'b' is .*never evaluates text",
        ),
        (lambda: ss.RigidBody("b", (1, 2, 3), fourth=EVIL), "the fourth moment of 'b' is"),
        (lambda: ss.RigidBody("b", (1, 2, EVIL)), "an inertia of 'b' is"),
        (lambda: ss.RigidBody("b", [[1, 0, 0], [0, 1, 0], [0, 0, EVIL]]), "an inertia of 'b' is"),
        (lambda: ss.RigidBody("b", (1, 2, None)), "an inertia of 'b' is None"),
        (lambda: MOVING.point((0, 0, EVIL)), "a component of a point is"),
        (lambda: MOVING.to_space((0, 0, EVIL)), "a component of a point is"),
        (lambda: ss.coincide((0, 0, EVIL), (0, 0, 0)), "a component of a point is"),
        (lambda: ss.rotation_matrix((1, 0, 0, EVIL)), "a component of a quaternion is"),
        (lambda: ss.body_rates(MOVING.quaternion, (1, 0, 0, EVIL)), "a component of a quaternion"),
    ],
)
def test_text_is_not_evaluated(call, told, monkeypatch):
    monkeypatch.setenv("EVALUATED", "")
    monkeypatch.delenv("EVALUATED")
    with pytest.raises(ss.ModelError, match=f"(?s){told}"):
        call()
    assert "EVALUATED" not in os.environ
