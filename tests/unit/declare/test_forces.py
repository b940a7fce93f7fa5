"""Forces, dissipation and time in declarations: what is read, what is found, what is refused."""

import numpy as np
import pytest
import sympy as sp
from support.bodies import hanging_particle
from sympy.physics import mechanics as me

import symsimpson as ss
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluate_doubles

t = ss.time
x, y = ss.coordinates("x y")
c, k, w = sp.symbols("c k w", positive=True)
u = sp.Symbol("u")
T, V = (x.diff() ** 2 + y.diff() ** 2) / 2, k * x**2 / 2 + y**4
VALUES = {c: 0.1, k: 2.0, w: 3.0}


def declared(**more):
    given = {"coordinates": (x, y), "kinetic": T, "potential": V, "parameters": VALUES, **more}
    return ss.MechanicalSystem("forced", **given)


SPEED = sp.sqrt(x.diff() ** 2 + y.diff() ** 2)


def slopes_at(force, v):
    """Return the force on x, and its slopes by both velocities, in doubles."""
    plain = declared(forces={x: force}).plain
    f = plain.f[0]
    values = [f, *gradient(plain.graph, f, plain.numbers(plain.v))]
    known = dict.fromkeys([*plain.numbers(plain.q), plain.time], 0.5)
    known |= dict(zip(plain.numbers(plain.v), v, strict=True))
    known |= dict(zip(plain.numbers(plain.parameters), VALUES.values(), strict=True))
    return evaluate_doubles(plain.graph, values, known)


@pytest.mark.parametrize(
    ("force", "v", "right"),
    [
        (-c * SPEED * x.diff(), (0.0, 0.0), (0, 0, 0)),
        (-c * SPEED * x.diff(), (3.0, 4.0), (-1.5, -0.68, -0.24)),
        (-c * SPEED * x.diff(), (3e-60, 4e-60), (-1.5e-120, -0.68e-60, -0.24e-60)),
        (-(k + c * SPEED) * x.diff(), (0.0, 0.0), (0, -2, 0)),
        (-c * sp.sqrt((x.diff() - w) ** 2) * (x.diff() - w), (3.0, 1.0), (0, 0, 0)),
        (-c * sp.sqrt((x.diff() - y.diff()) ** 2) * (x.diff() - y.diff()), (7.0, 7.0), (0, 0, 0)),
        (
            -c
            * sp.sqrt(x.diff() ** 2 + y.diff() ** 2 + 2 * sp.cos(x - y) * x.diff() * y.diff())
            * x.diff(),
            (0.0, 0.0),
            (0, 0, 0),
        ),
        (-c * x.diff() * (x.diff() ** 2) ** ((w - 1) / 2), (0.0, 1.0), (0, 0, 0)),
        (-c * x.diff() * (x.diff() ** 2) ** sp.Rational(1, 4), (0.0, 1.0), (0, 0, 0)),
    ],
)
def test_drag_has_slopes_at_rest(force, v, right):
    np.testing.assert_allclose(
        slopes_at(force, v), right, rtol=1e-13, atol=1e-40 * (max(v) ** 2 or 1)
    )


@pytest.mark.parametrize(
    "force",
    [
        -c * x.diff() / SPEED,
        -c * sp.sqrt(x.diff()),
        -c * (x.diff() ** 2) ** sp.Rational(1, 4),
        -c * x.diff() * SPEED + x.diff() / SPEED,
    ],
)
def test_a_force_without_a_slope_at_rest_stays_so(force):
    assert not np.isfinite(slopes_at(force, (0.0, 0.0))).all()


def test_roots_that_are_never_zero_stay():
    plain = declared(forces={x: -c * sp.sqrt(x.diff() ** 2 + k**2) * x.diff()}).plain
    assert "Tiny" not in {node.parts[0] for node in plain.graph.nodes if node.kind == "constant"}
    drag = declared(forces={x: -c * SPEED * x.diff()})
    assert sp.expand(drag.equations[0].rhs + c * SPEED * x.diff()) == 0


@pytest.mark.slow
def test_a_body_falls_from_rest():
    """y = -(vt^2/g) log(cosh(g t/vt)): on the first step, alone and as a member of an ensemble."""
    v = y.diff()
    fall = ss.MechanicalSystem(
        "fall",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + v**2) / 2,
        potential=k * y,
        parameters={k: 9.81, c: 0.2},
        forces={"drag": {x: -c * SPEED * x.diff(), y: -c * SPEED * v}},
    )
    begin = {"q0": [0, 0], "v0": [0, 0], "h": 0.05}
    for end, scheme, close, options in (
        (5.0, "simpson", 3e-7, {}),
        (5.0, "gauss6", 1e-11, {}),
        (0.2, "gauss6", 1e-11, {"precision": 20}),
    ):
        right = -5 * np.log(np.cosh(np.sqrt(9.81 * 0.2) * end))
        stepper = ss.compile(fall, scheme, **options)
        assert abs(float(stepper.integrate(**begin, t_end=end).q[-1, 1]) - right) < close
        if not options:
            members = stepper.ensemble([[0, 0]] * 2, v0=[[0, 0], [0, 1]], h=0.05, t_end=end)
            assert abs(members.q[0, 1] - right) < close
            assert np.isfinite(stepper.integrate(**begin, steps=9, tangents=4).tangent).all()


WRONG = {
    "no mapping": ({"forces": x}, "the forces are 'x', not a mapping"),
    "no coordinate": ({"forces": {sp.Symbol("z"): 1}}, "force on z, which is not a coordinate"),
    "on a velocity": ({"forces": {x.diff(): 1}}, r"not a coordinate(.|\n)*Write forces={x: ...}"),
    "second derivative": ({"forces": {x: x.diff(t, 2)}}, "a derivative of order 2"),
    "acceleration in dissipation": ({"dissipation": x.diff(t, 2) ** 2}, "the dissipation contains"),
    "another t": (
        {"forces": {x: sp.cos(sp.Symbol("t", real=True))}},
        "not the time(.|\n)*Use symsimpson.time",
    ),
    "unknown symbol": ({"forces": {x: sp.Symbol("u")}}, "unknown symbol u"),
    "sign": ({"forces": {x: -sp.sign(x.diff())}}, r"sign(.|\n)*tanh\(x/eps\)"),
    "abs": ({"forces": {x: -sp.Abs(x.diff()) * x.diff()}}, r"Abs(.|\n)*sqrt\(x\*\*2 \+ eps"),
    "no velocity": ({"dissipation": x**2}, "depends on no velocity"),
    "linear": ({"dissipation": x.diff() * x}, "linear in velocities"),
    "text": ({"forces": {x: "-c*v"}}, "the force on x is the string"),
    "without coordinates": ({"forces": {"drag": -x.diff()}}, "not a mapping from coordinates"),
    "by name": ({"forces": {"x": -x.diff()}}, r"forces=\{x: ...\}, with the coordinate itself"),
    "taken": ({"forces": {"total": {x: 1}}}, "two forces would have the name 'total'"),
    "twice": ({"forces": {x: 1, "x": {y: 1}}}, "two forces would have the name 'x'"),
    "two dissipations": ({"forces": {"dissipation": {x: 1}}}, "the name 'dissipation'"),
    "input in T": (
        {"kinetic": (1 + u) * T, "forces": {x: u}, "inputs": (u,)},
        "kinetic energy depends on the input u(.|\\n)*Write its effect as a force",
    ),
    "input in V": ({"potential": u * x, "forces": {x: u}, "inputs": (u,)}, "the input u"),
    "idle input": ({"inputs": (u,)}, "no force contains the input u"),
    "text as input": ({"forces": {x: u}, "inputs": "u"}, "inputs are 'u', not a tuple of symbols"),
    "a number as input": ({"inputs": (1,)}, "neither a symbol nor a function of time"),
    "input like a parameter": ({"inputs": (sp.Symbol("c"),)}, "an input and a parameter"),
    "input twice": ({"forces": {x: u}, "inputs": (u, u)}, "an input and another input"),
    "whole input": ({"inputs": (sp.Symbol("n", integer=True),)}, "declared an integer"),
    "acceleration of an input": (
        {"forces": {x: me.dynamicsymbols("u").diff()}, "inputs": (me.dynamicsymbols("u"),)},
        "an unknown velocity",
    ),
    "position of a velocity": ({"positions": {"bob": (x + y.diff(), y)}}, "on the velocity y'"),
}


@pytest.mark.parametrize("name", WRONG)
def test_message(name):
    given, message = WRONG[name]
    with pytest.raises(ss.ModelError, match=message):
        declared(**given)


def test_a_dissipation_that_drives_is_told():
    with pytest.warns(ss.ModelWarning, match="negative(.|\n)*c > 0") as found:
        declared(dissipation=-c * x.diff() ** 2 / 2)
    assert found[0].filename == __file__
    declared(dissipation=(x**2 - 1) * x.diff() ** 2)  # one that may do either is left alone


def test_forces_by_coordinate_and_by_name():
    system = declared(
        forces={y: -w * x, "motor": {x: sp.cos(w * t), y: 1}}, dissipation=c * x.diff() ** 2 / 2
    )
    assert list(system.plain.forces) == ["y", "motor", "dissipation"]
    written = [system.plain.to_sympy(value) for value in system.plain.f]
    q, v, a = system.plain.q, system.plain.v, system.plain.parameters
    assert sp.expand(written[0] - sp.cos(a[2] * system.plain.t) + a[0] * v[0]) == 0
    assert sp.expand(written[1] - 1 + a[2] * q[0]) == 0


def test_inputs_are_symbols_or_functions_of_time():
    function = me.dynamicsymbols("torque")
    system = declared(forces={x: u * sp.cos(y), y: function}, inputs=(u, function))
    assert ss.compile(system).inputs == ("u", "torque")
    assert system != declared(forces={x: u * sp.cos(y), y: function}, inputs=(function, u))


def test_a_force_changes_the_digest():
    digests = {
        declared(**more).digest
        for more in (
            {},
            {"forces": {x: -c * x.diff()}},
            {"forces": {y: -c * x.diff()}},
            {"forces": {"a": {x: -c * x.diff()}}},
            {"dissipation": c * x.diff() ** 2},
        )
    }
    assert len(digests) == 5
    assert declared(forces={}) == declared()


SURVIVES = {
    "none": ({}, {"separable": True, "linear": False, "subsystems": 2}),
    "of q": ({"forces": {x: -w * y}}, {"separable": True, "subsystems": 1}),
    "of v": ({"forces": {x: -c * x.diff()}}, {"separable": False, "subsystems": 2}),
    "of the other's v": ({"forces": {x: -c * y.diff()}}, {"separable": False, "subsystems": 1}),
    "that is nothing": ({"forces": {x: y - y}}, {"separable": True, "subsystems": 2, "forced": ()}),
    "cancelling": (
        {"forces": {"a": {x: c * x.diff()}}, "dissipation": c * x.diff() ** 2 / 2},
        {"separable": True, "forced": ()},
    ),
    "M of t": ({"kinetic": (2 + sp.sin(t)) * T}, {"constant_mass": False, "autonomous": False}),
    "V of t": ({"potential": V * (1 + t)}, {"constant_mass": True, "separable": True}),
}


@pytest.mark.parametrize("name", SURVIVES)
def test_findings_are_decided_on_l_and_f_together(name):
    given, expected = SURVIVES[name]
    structure = declared(**given).structure
    for finding, value in expected.items():
        found = getattr(structure, finding)
        assert (len(found) if finding == "subsystems" else found) == value
    assert "forces" in str(structure) or not structure.forced


def test_linear_forces_are_not_exploited_beside_others():
    linear = {"potential": k * x**2 / 2 + y**2}
    assert declared(**linear).structure.linear
    assert not declared(**linear, forces={x: sp.cos(t)}).structure.linear
    assert not declared(potential=k * x**2 / 2 * sp.cos(t)).structure.linear


def test_cyclic_needs_that_no_force_contains_or_moves_it():
    polar = {"kinetic": (x.diff() ** 2 + x**2 * y.diff() ** 2) / 2, "potential": -k / x}
    assert declared(**polar).structure.cyclic == ("y",)
    assert declared(**polar, dissipation=c * x.diff() ** 2).structure.cyclic == ("y",)
    assert declared(**polar, forces={x: -y.diff()}).structure.cyclic == ("y",)
    for force in ({y: -c * y.diff()}, {x: sp.sin(y)}, {y: 1}):
        assert declared(**polar, forces=force).structure.cyclic == ()


@pytest.mark.slow
def test_a_force_of_a_cyclic_velocity_takes_the_general_path():
    """Elimination would need its derivative, which L does not have: corrections shrink slowly."""
    polar = {"kinetic": (x.diff() ** 2 + x**2 * y.diff() ** 2) / 2, "potential": -k / x}
    unknowns = {}
    for name, force in {"of x'": -x.diff() / 9, "of y'": -(y.diff() ** 2) / 9}.items():
        stepper = ss.compile(declared(**polar, forces={x: force}))
        unknowns[name] = stepper.program.header.newton_unknowns
        run = stepper.integrate([1.0, 0.0], [0.1, 1.4], h=0.05, steps=50)
        assert np.ptp(run["p_y"]) == 0
        assert run.newton_iterations[10:].max() <= 4
    assert unknowns == {"of x'": 2, "of y'": 4}


@pytest.mark.slow
def test_prescribed_motion_in_t_is_sorted():
    """T of a pendulum on a moving pivot has terms without the velocity, and linear in it."""
    pivot = sp.sin(w * t) / 10
    X, Y = pivot + sp.sin(x), -sp.cos(x)
    energy = (X.diff(t) ** 2 + Y.diff(t) ** 2) / 2
    one = ss.MechanicalSystem(
        "pivot", coordinates=(x,), kinetic=energy, potential=9.81 * Y, parameters={w: 3.0}
    )
    other = ss.MechanicalSystem.from_lagrangian("pivot", energy - 9.81 * Y, (x,), {w: 3.0})
    runs = [ss.compile(s).integrate([0.3], [0.1], h=0.05, steps=40) for s in (one, other)]
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-14
    assert np.abs(runs[0].energy - runs[1].energy).max() < 1e-13
    with pytest.raises(ss.ModelError, match="not a quadratic form in the velocities"):
        ss.MechanicalSystem("moving", coordinates=(x,), kinetic=(x.diff() + 1) ** 2, potential=x**2)


def body_with_loads():
    m, l, g = sp.symbols("m l g", positive=True)
    theta, frame, turned, bob, body = hanging_particle(m, l)
    loads = [(bob, -m * g * frame.y), (turned, -c * theta.diff() * frame.z)]
    method = me.LagrangesMethod(me.Lagrangian(frame, body), [theta], forcelist=loads, frame=frame)
    return method, (m, l, g), theta


def test_forcelist_of_lagranges_method_gives_the_equations_of_sympy():
    method, (m, l, g), theta = body_with_loads()
    values = {m: 1.2, l: 0.7, g: 9.81, c: 0.3}
    system = ss.MechanicalSystem.from_lagranges_method("loaded", method, values)
    method.form_lagranges_equations()
    acceleration = method.rhs()[1].subs(values)
    run = ss.compile(system).integrate([0.4], [0.5], h=0.01, steps=100)
    rate = sp.lambdify((theta, theta.diff()), acceleration, "math")
    v = run.v[:, 0]
    found = (v[:-4] - 8 * v[1:-3] + 8 * v[3:-1] - v[4:]) / 0.12
    truth = [rate(a, b) for a, b in zip(run.q[2:-2, 0], v[2:-2], strict=True)]
    assert np.abs(found - truth).max() < 1e-6
    assert list(run.work) == ["forcelist", "total"]
    assert sp.simplify(system.potential + m * g * l * sp.cos(theta)) == 0
    assert np.abs(run.energy_balance).max() < 1e-6


def test_a_forcelist_that_has_a_potential_is_no_force():
    m, l, k, g = sp.symbols("m l k g", positive=True)
    theta, frame, turned, bob, body = hanging_particle(m, l)
    loads = [(bob, -m * g * frame.y), (turned, -k * theta * frame.z)]
    lagrangian = me.Lagrangian(frame, body)
    method = me.LagrangesMethod(lagrangian, [theta], forcelist=loads, frame=frame)
    values = {m: 1.2, l: 0.7, k: 0.3, g: 9.81}
    system = ss.MechanicalSystem.from_lagranges_method("hung", method, values)
    assert not system.forces
    run = ss.compile(system).integrate([0.4], [0.5], h=0.01, steps=200)
    assert np.abs(run.energy_error).max() < 1e-6
    V = -m * g * l * sp.cos(theta) + k * theta**2 / 2
    plain = ss.MechanicalSystem.from_lagrangian("hung", lagrangian - V, [theta], values)
    other = ss.compile(plain).integrate([0.4], [0.5], h=0.01, steps=200)
    assert np.abs(run.q - other.q).max() < 1e-13


@pytest.mark.slow
def test_odd_names_of_forces_stay_out_of_the_module():
    odd = '"; import os #'
    stepper = ss.compile(declared(forces={odd: {x: -c * x.diff()}}))
    assert "import os" not in stepper.source
    run = stepper.integrate([1.0, 0.2], [0.0, 0.0], h=0.1, steps=3)
    assert list(run.work) == [odd, "total"]  # what a user writes is what is shown
