"""What values show in a notebook."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.support import markup

HOSTILE = "<img src=x onerror=alert(1)>"


class Checker(HTMLParser):
    """Gathers tags, and refuses what is not closed in its order."""

    def __init__(self):
        super().__init__()
        self.open, self.tags = [], set()

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        if not self.get_starttag_text().endswith("/>"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open[-1] != tag:
            assert tag in ("polyline", "circle")
            return
        self.open.pop()


def tags_of(text):
    checker = Checker()
    checker.feed(text)
    checker.close()
    assert checker.open == []
    return checker.tags


@pytest.fixture(scope="module")
def shown():
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system, "gauss6")
    run = stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.02, t_end=5)
    ensemble = stepper.ensemble(
        np.linspace(0.1, 1, 20)[:, None] * [1, 1],
        v0=[0, 0],
        h=0.02,
        steps=50,
        reduce={HOSTILE: ("max", "q1")},
    )
    return {
        "stepper": stepper,
        "trajectory": run,
        "states": run[3:9],
        "one state": run[3:4],
        "none": run[3:3],
        "last": stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.1, steps=0),
        "events": run.events("q1"),
        "ensemble": ensemble,
        "structure": system.structure,
        "certificate": ss.compile(ss.systems.pendulum()).certify(),
        "chaos": stepper.lyapunov([0.8, 1.0], p0=[0, 0], h=0.02, steps=40),
        "between": run.sol,
        "event": ss.Event("q1", name=HOSTILE, action=ss.Impact(0.8)),
    }


@pytest.mark.slow
def test_html_is_whole_and_holds_what_matters(shown):
    expected = {
        "stepper": "iterated over 3 stages",
        "trajectory": "largest energy error",
        "states": "7 states",
        "events": "zeros of",
        "ensemble": "20 SUCCESS",
        "certificate": "passed",
        "structure": "mass matrix",
        "chaos": "exponents",
        "between": "gauss6: t from 0 to 5",
        "event": "Impact(restitution=0.8)",
    }
    for name, value in shown.items():
        text = value._repr_html_()
        assert tags_of(text) <= {
            "div",
            "b",
            "table",
            "thead",
            "tbody",
            "tr",
            "th",
            "td",
            "svg",
            "polyline",
            "circle",
            "span",
        }, name
        assert expected.get(name, "").replace("7 states", "6 states") in text
        assert len(text) < 200_000
        assert repr(value)


@pytest.mark.slow
def test_hostile_names_stay_text(shown):
    assert "img" not in tags_of(shown["event"]._repr_html_())
    assert HOSTILE not in shown["ensemble"]._repr_html_()
    assert "&lt;img" in shown["ensemble"]._repr_html_()
    (x,) = ss.coordinates("x")
    mass = sp.Symbol(HOSTILE, positive=True)
    system = ss.MechanicalSystem(
        "spring",
        coordinates=(x,),
        kinetic=mass * x.diff() ** 2 / 2,
        potential=x**4,
        parameters={mass: 1.0},
        invariants={HOSTILE: x},
    )
    stepper = ss.compile(system)
    run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=5)
    for value in (stepper, run, system.structure):
        assert "img" not in tags_of(value._repr_html_())
    assert "img" not in system._repr_latex_()
    assert "a_{0}" in system._repr_latex_()


def test_members_that_run_backwards_show_where_to():
    pendulum = ss.compile(ss.systems.pendulum())
    back = pendulum.ensemble([[0.1], [0.2]], v0=[0.0], h=-0.1, steps=30, every=10)
    assert "-3, 4 states of each stored" in back._repr_html_()


def test_iterations_are_shown_by_the_steps_that_they_are_of():
    pendulum = ss.compile(ss.systems.pendulum())
    run = pendulum.integrate([1.0], v0=[0.0], h=0.1, steps=59, every=30)
    whole = pendulum.integrate([1.0], v0=[0.0], h=0.1, steps=30)
    shown = f"{whole.newton_iterations.sum() / 30:.2f}"
    assert re.search(f"iterations a step.*?{shown}", run._repr_html_(), re.DOTALL)


def test_every_cell_is_escaped():
    cells = [[HOSTILE, HOSTILE], [HOSTILE, HOSTILE]]
    for text in (markup.table(cells), markup.facts(cells), markup.box(HOSTILE)):
        assert "img" not in tags_of(text)
        assert "&lt;img" in text


@pytest.mark.slow
def test_failed_runs_say_so():
    stepper = ss.compile(ss.systems.henon_heiles())
    run = stepper.integrate([0.0, 0.1], v0=[2.4, 1.0], h=0.1, steps=500, on_failure="return")
    text = run._repr_html_()
    assert run.status.name in text
    assert "with h=0.1 failed" in text


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        (r"\theta_1", r"\dot{\theta}_{1}"),
        (r"\varphi", r"\dot{\varphi}"),
        ("θ", r"\dot{θ}"),
        ("q_{12}", r"\dot{q}_{12}"),
        ("x'", r"\dot{x'}"),
        (r"\href", r"\dot{q}_{0}"),
        (r"\theta}", r"\dot{q}_{0}"),
        ("x$", r"\dot{q}_{0}"),
        ("_", r"\dot{q}_{0}"),
    ],
)
def test_names_in_latex(name, shown):
    q = sp.Function(name)(ss.time)
    system = ss.MechanicalSystem("s", coordinates=(q,), kinetic=q.diff() ** 2, potential=q**2)
    assert f"T &= {shown}^{{2}}" in system._repr_latex_()


def test_systems_and_schemes_in_latex():
    text = ss.systems.double_pendulum()._repr_latex_()
    for part in ("T &=", "V &=", "M &=", r"p_{q_{1}} &=", r"\dot{p}_{q_{2}} &="):
        assert part in text
    assert text.count(r"\begin{aligned}") == text.count(r"\end{aligned}") == 1
    assert "M &=" not in ss.systems.n_pendulum(6)._repr_latex_()
    assert r"\frac{2}{3}" in ss.SIMPSON._repr_latex_()
    assert "order 16" in ss.galerkin("gauss", nodes=8, degree=8)._repr_latex_()
    assert "order 4" in ss.composition("suzuki4")._repr_latex_()


def test_pictures_leave_out_what_is_not_finite():
    x = np.arange(5.0)
    drawn = markup.curves(x, [np.array([0, np.nan, 1, np.inf, 2.0])])
    points = re.search('points="([^"]*)"', drawn)[1].split()
    assert len(points) == 3
    assert "nan" not in markup.scatter(x, np.full(5, np.nan))
    assert markup.curves(np.arange(10_000.0), [np.arange(10_000.0)]).count(",") <= markup.POINTS


def test_one_of_a_kind_is_told_in_the_singular():
    stepper = ss.compile(ss.systems.pendulum(), "midpoint")
    given = {"q0": [1.0], "v0": [0.0], "h": 0.1, "steps": 1}
    told = "pendulum, midpoint: 1 step of h=0.1, 1 state stored"
    run = stepper.integrate(**given, every=None)
    assert repr(run) == f"Trajectory({told}, SUCCESS)"
    assert "1 state, 0.1 <= t" in repr(run[0])
    assert "1 state stored" in run._repr_html_()
    assert "1 member, 1 state of each" in repr(stepper.ensemble(**given))
    assert repr(stepper.linearise(**given)).startswith("Linearisation(1 step, ")
    assert "with 1 node," in repr(ss.galerkin("gauss", 1, 1))
    with pytest.raises(ss.InputError, match="got 1 positional argument, and takes none"):
        ss.Switch("x")


def test_events_and_problems_show_what_was_given():
    (x,), u = ss.coordinates("x"), sp.Symbol(HOSTILE, real=True)
    cart = ss.MechanicalSystem(
        "cart",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=0 * x,
        forces={x: u},
        inputs=(u,),
    )
    problem = ss.OptimalControl(cart, cost=u**2, start={x: 0}, end={x: 1}, duration=1)
    text = problem._repr_html_()
    assert tags_of(text) == {"div", "b", "table", "tbody", "tr", "th", "td"}
    assert "Optimal control of cart" in text
    assert ">x(t) = 1<" in text
    assert "bounds" not in text
    event = ss.Event(x, name=HOSTILE, direction=1)._repr_html_()
    assert "img" not in tags_of(event)
    assert "direction" in event
    assert "terminal" not in event
    assert len(ss.Event(x, name=9999 * "n")._repr_html_()) < 1000


def test_solutions_of_optimal_control_are_shown():
    pytest.importorskip("casadi")
    (x,), u = ss.coordinates("x"), sp.Symbol("u", real=True)
    cart = ss.MechanicalSystem(
        "cart",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=0 * x,
        forces={x: u},
        inputs=(u,),
    )
    still = {x: 0, x.diff(): 0}
    problem = ss.OptimalControl(cart, cost=u**2, start=still, end=still | {x: 1}, duration=1)
    text = problem.solve(steps=4)._repr_html_()
    assert tags_of(text) >= {"svg", "polyline", "span"}
    assert ">12<" in text
    assert "A local optimum was found." in text


def test_results_complete_public_names():
    stepper = ss.compile(ss.systems.pendulum())
    floor = ss.Event("theta", name="down")
    given = {"v0": [0.0], "h": 0.1, "steps": 20}
    run = stepper.integrate([1.0], **given, events=[floor])
    many = stepper.ensemble([[1.0], [2.0]], **given, every=5, reduce={"top": ("max", "theta")})
    saved = stepper.integrate([1.0], **given, save=["energy"])
    results = [run, run[2:4], many, many[0], run.events("theta"), run.events("down"), saved]
    results.append(stepper.integrate([1.0], v0=[0.0], h=0.1, t_eval=[0, 1]))
    hidden = {"begun", "driven", "program", "recorded_values", "tau_values", "varied_by"}
    for result in results:
        names = dir(result)
        assert not hidden & set(names)
        assert not [name for name in names if name.startswith("_")]
        assert {"t", "plot", "to_pandas"} <= set(names)
        for key in result._ipython_key_completions_():
            assert len(result[key]) == len(result[key])
    assert {"energy_error", "sol", "events", "h", "tau"} <= set(dir(run))
    assert {"energy_error", "tau", "at"} <= set(dir(run[2:4]))
    assert {"theta", "v_theta", "bob", "energy"} <= set(run._ipython_key_completions_())
    assert {"top", "l"} <= set(many._ipython_key_completions_())
    assert saved._ipython_key_completions_() == ["t", "energy"]
    assert "0x" not in repr(run.sol)
    assert repr(run.sol) == "DenseOutput(pendulum, simpson: t from 0 to 2)"


def test_states_and_members_follow_one_another():
    stepper = ss.compile(ss.systems.pendulum())
    run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=5)
    many = stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=6, every=2)
    for some in (run, run[1:4], run.at([0.05, 0.1]), many, many[1], run.events("theta")):
        states = list(some)
        assert len(states) == len(some)
        for k, state in enumerate(states):
            assert type(state) is type(some[k])
            assert (state.t == some[k].t).all()
            assert (state.q == some[k].q).all()
    first, *_, last = run
    assert (first.energy_error, last.t) == (0, 0.5)
    assert [float(state["theta"][0]) for state in run] == run["theta"].tolist()
    for wrong in (run, [run, run], many):
        with pytest.raises(ss.InputError, match=r"is not an array.\nPass one of its arrays"):
            np.asarray(wrong)
