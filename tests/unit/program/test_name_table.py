"""A user's own names, in every route: whatever SymPy takes, by symbol and by name."""

import pickle

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss

t = ss.time
NAMES = [r"\theta_1", "lambda", "x 1", r"\dot{q}", "x'", "ϕ", "_x", "None", "$a$b$"]
STEPS = 100


class Case:
    """Two coordinates, of which the second has the module's name of the first."""

    def __init__(self, name):
        self.name = name
        self.q, self.other = sp.Function(name)(t), sp.Function("q0")(t)
        self.m, self.u = sp.Symbol(f"{name}_m", positive=True), sp.Symbol(f"{name}_u")
        m, q, other = self.m, self.q, self.other
        square = q.diff() ** 2 + other.diff() ** 2
        self.stepper = ss.compile(
            ss.MechanicalSystem(
                "named",
                coordinates=(q, other),
                kinetic=m * square / 2,
                potential=-m * sp.cos(q) + other**2 / 2,
                parameters={m: 1.3},
                forces={q: self.u},
                inputs=(self.u,),
                invariants={f"{name} v": q.diff()},
            )
        )
        self.given = {"v0": [0.0, 0.1], "h": 0.03, "steps": STEPS, "inputs": {self.u: 0.1}}
        self.run = self.stepper.integrate([1.0, 0.2], **self.given)


@pytest.fixture(scope="module", params=sweep(NAMES, 2))
def case(request):
    return Case(request.param)


def test_states_by_name(case):
    for key in (case.q, case.name, f"{case.name}(t)"):
        run = case.stepper.integrate(
            {case.other: 0.2, key: 1.0},
            v0={"q0": 0.1, case.q: 0.0},
            h=0.03,
            steps=STEPS,
            inputs={f"{case.name}_u": 0.1},
            parameters={f"{case.name}_m": 1.3},
        )
        assert (run.q == case.run.q).all()
    many = case.stepper.ensemble({case.q: [1.0, 1.1, 1.2], "q0": 0.2}, **case.given)
    assert many.q.shape == (3, 2)
    assert np.allclose(many.q[0], case.run.q[-1], rtol=0, atol=1e-13)
    with pytest.raises(ss.InputError, match="different shapes"):
        case.stepper.ensemble({case.q: [1.0, 1.1], "q0": [0.1, 0.2, 0.3]}, **case.given)


def test_expressions(case):
    q, name, run = case.q, case.name, case.run
    right = run.t[1:][np.diff(np.sign(run.q[:, 0])) != 0]
    assert right.size == 1  # it crosses zero once, within the step before
    expressions = [q, name, sp.Eq(q, 0), q * case.m, f"2*{name}", f"{name} - 0*q0", f"{name}(t)"]
    for expression in expressions:
        assert np.allclose(run.events(expression).t, right, atol=0.03), expression
    assert len(run.events(q, wrap=[name])) == len(run.events(q, wrap=q)) == 1
    turns = run.events(q.diff()).t
    assert (run.events(ss.momenta(q)[0]).t == run.events(f"v_{name}").t).all()
    assert np.allclose(run.events(f"v_{name}").t, turns, rtol=0, atol=1e-12)
    assert (case.stepper.poincare(q, [1.0, 0.2], **case.given).t == run.events(name).t).all()
    found = case.stepper.ensemble(
        [[1.0, 0.2]], **case.given, reduce={"low": ("min", q), "v": ("min", f"v_{name}")}
    )
    assert np.allclose(found.reduced["low"], run.q[:, 0].min(), atol=1e-12)
    assert np.allclose(found.reduced["v"], run.v[:, 0].min(), atol=1e-12)


def test_derivatives(case):
    stepper, start = case.stepper, ([1.0, 0.2],)
    by_symbol = stepper.gradient(
        *start, **case.given, cost=case.q**2 * case.m, wrt=("q", case.m, case.u)
    )
    by_name = stepper.gradient(
        *start,
        **case.given,
        cost=f"{case.name}**2 * {case.name}_m",
        wrt=("q", case.m.name, case.u.name),
    )
    assert list(by_symbol.parts) == list(by_name.parts) == ["q", case.m.name, case.u.name]
    assert (by_symbol.gradient == by_name.gradient).all()
    run = stepper.integrate(*start, **case.given, sensitivities=[case.m, case.u.name])
    assert list(run.sensitivity) == [case.m.name, case.u.name]
    slope = 2 * run.q[-1, 0] * case.m.subs(case.m, 1.3) * run.sensitivity[case.u.name][-1, 0]
    assert float(slope) == pytest.approx(float(by_symbol.parts[case.u.name]), rel=1e-9)


def test_what_is_shown(case):
    run, name = case.run, case.name
    assert case.stepper.coordinates == (name, "q0")
    assert (run[case.q] == run.q[:, 0]).all()
    assert (run[case.q.diff()] == run.v[:, 0]).all()
    assert (run[f"p_{name}"] == run.p[:, 0]).all()
    assert (run["q0"] == run.q[:, 1]).all()
    assert list(run.to_pandas().columns)[:2] == [name, "q0"]
    assert list(run.to_xarray().coord.values) == [name, "q0"]
    assert list(run.invariants) == [f"{name} v"]
    assert list(run.parameters) == [case.m.name]
    assert list(run.inputs) == [case.u.name]
    assert list(run.work) == [name, "total"]
    assert (pickle.loads(pickle.dumps(run))[case.q] == run[case.q]).all()


def test_a_task_for_others_is_written_in_names_of_the_module(case):
    """A store has the module alone: its workers know no names of a user."""
    from symsimpson.program.observed import read_reductions
    from symsimpson.program.program import read_program

    asked = {
        "low": ("min", case.q * case.m),
        "v": ("max", f"v_{case.name} + q0"),
        "other": ("max", "q0 + 1"),
        "energy": ("max", case.q * sp.Symbol("kinetic_energy")),
    }
    own = read_reductions(case.stepper.program, asked)
    others = read_program(case.stepper.source, "the module in a store")
    read = read_reductions(others, {one.name: (one.kind, one.expression) for one in own})
    assert [one.text for one in read] == [one.text for one in own]


@pytest.mark.parametrize("name", ["a+b", "12", "x*y", "cos(x)"])
def test_names_that_are_expressions_are_found_by_their_symbols_alone(name):
    q = sp.Function(name)(t)
    stepper = ss.compile(
        ss.MechanicalSystem(
            "spelled", coordinates=(q,), kinetic=q.diff() ** 2 / 2, potential=-sp.cos(q)
        )
    )
    run = stepper.integrate({q: 1.0}, v0=[0.0], h=0.03, steps=STEPS)
    assert len(run.events(q)) == 1
    assert (run[name] == run.q[:, 0]).all()
    if name != "12":  # that is a number, and has no zero
        with pytest.raises(ss.InputError, match="it contains"):
            run.events(name)
    assert len(run.events("12 - 12*t/2", direction=-1)) == 1


def test_names_that_are_not_there(case):
    with pytest.raises(ss.InputError, match="there is no quantity 'nothing'") as told:
        case.run["nothing"]
    assert isinstance(told.value, KeyError)
    assert str(told.value).startswith("there is no")  # not in quotes
    with pytest.raises(ss.InputError, match="unknown name 'beta'"):
        case.run.events(sp.Symbol("beta"))
    with pytest.raises(
        ss.InputError, match=r"it contains the unknown name 'q00'\. Did you mean q0\?"
    ):
        case.run.events("q00")
    with pytest.raises(ss.InputError, match="no input 'w'"):
        case.stepper.integrate([1.0, 0.2], **(case.given | {"inputs": {"w": 1.0}}))


@pytest.mark.slow
def test_a_certificate_and_another_time():
    """Both make further steppers of the module, which know these names, too."""
    x, y = (sp.Function(name)(t) for name in (r"\xi_1", "y'"))
    mu = sp.Symbol(r"\mu", positive=True)
    system = ss.MechanicalSystem(
        "attracted",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-mu / sp.sqrt(x**2 + y**2),
        parameters={mu: 1.0},
    )
    start = {"q0": {x: 1.0, y: 0.0}, "v0": {x: 0.0, y: 0.8}}
    assert ss.compile(system, "simpson").certify(**start, parameters={mu: 1.1}).passed
    retimed = ss.compile(system.retimed("encounters"), "simpson")
    run = retimed.integrate(**start, h=0.05, t_end=2.0, sensitivities=[mu])
    assert list(run.sensitivity) == [r"\mu"]
    assert retimed.certify(**start).passed
