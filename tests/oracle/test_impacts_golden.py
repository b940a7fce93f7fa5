"""Runs with impacts against golden values, and against what the exact motion keeps.

``tests/data/golden_contact.json``: ``impacts``, steps that are split where a gap closes, of 34
digits; ``chains``, balls in a line that touch.
"""

import json
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.golden import read_system
from support.places import DATA

import symsimpson as ss

GOLDEN = json.loads((DATA / "golden_contact.json").read_text())
IMPACTS = {case["name"]: case for case in GOLDEN["impacts"]}
CHAINS = {case["name"]: case for case in GOLDEN["chains"]}


def read(values):
    return np.array(values, dtype=float)


def run_of(case, **more):
    q, values, texts = read_system(case)
    (lagrangian,) = texts([case["lagrangian"]])
    system = ss.MechanicalSystem.from_lagrangian(case["name"], lagrangian, q, values)
    gaps = texts(one["expression"] for one in case["events"])
    events = [
        ss.Event(gap, name="wall", action=ss.Impact(sp.Rational(one["restitution"])))
        for gap, one in zip(gaps, case["events"], strict=True)
    ]
    return ss.compile(system, case["scheme"]).integrate(
        read(case["q0"]),
        v0=read(case["v0"]),
        h=float(case["h"]),
        steps=case["N"],
        events=events,
        **more,
    )


@pytest.mark.parametrize("name", sweep(IMPACTS, 3))
def test_golden_impacts(name):
    case = IMPACTS[name]
    run, near = run_of(case), 1e-9 if name == "elliptic_billiard" else 1e-12
    hits = run.events("wall")
    assert len(hits) == case["impacts"]
    times = read(case["times"])
    assert np.abs(hits.t[: len(times)] - times).max() < near
    for found, key in ((run.q, "q"), (run.p, "p")):
        right = read(case["final"][key])
        assert np.abs(found[-1] - right).max() < near * max(1, np.abs(right).max())


@pytest.mark.parametrize("name", sweep(x for x, case in IMPACTS.items() if "tangent" in case))
def test_golden_tangents_through_an_impact(name):
    """By the length of the parts of the step: the vector field is off by the scheme's error."""
    case = IMPACTS[name]
    right = read(case["tangent"])
    found = run_of(case, tangents=4).tangent[-1]
    assert np.abs(found - right).max() < 1e-11 * np.abs(right).max()


@pytest.mark.slow
def test_a_billiard_in_an_ellipse_keeps_its_caustic():
    """Energy, and the product of the angular momenta about the foci: straight steps are exact."""
    case = IMPACTS["elliptic_billiard"]
    hits = run_of(case | {"N": 600_000}, every=None).events("wall")
    assert len(hits) > 1e5
    assert np.abs(hits.energy / hits.energy[0] - 1).max() < 1e-12
    focus = np.sqrt(1.5**2 - 1.0)
    (x, y), (px, py) = hits.q.T, hits.p.T
    product = ((x - focus) * py - y * px) * ((x + focus) * py - y * px)
    assert np.abs(product - product[0]).max() < 1e-10


def cradle(case):
    count = len(case["masses"])
    q = ss.coordinates(f"x:{count}")
    masses = [float(m) for m in case["masses"]]
    system = ss.MechanicalSystem(
        "cradle",
        coordinates=q,
        kinetic=sum(m * x.diff() ** 2 / 2 for m, x in zip(masses, q, strict=True)),
        potential=0 * q[0],
    )
    action = ss.Impact(sp.Rational(case["restitution"]))
    gaps = [
        ss.Event(b - a - 1, name=f"gap {k}", action=action) for k, (a, b) in enumerate(pairwise(q))
    ]
    return ss.compile(system), gaps


@pytest.mark.parametrize("name", sorted(CHAINS))
def test_balls_that_touch_hit_pair_by_pair(name):
    """The fastest approach first, until none approaches: one ball leaves for one that came."""
    case = CHAINS[name]
    stepper, gaps = cradle(case)
    q0 = np.arange(len(case["masses"]), dtype=float)
    run = stepper.integrate(q0, v0=read(case["v0"]), h=0.1, steps=1, events=gaps)
    assert np.abs(run.v[-1] - read(case["v"])).max() < 1e-13
    hits = [run.events(gap.name) for gap in gaps]
    assert sum(map(len, hits)) == case["pairs"]
    assert all(hit.simultaneous.all() for hit in hits if len(hit))


def wall(restitution):
    a, b = ss.coordinates("a b")
    l, g = 1, sp.Rational(981, 100)
    kinetic = a.diff() ** 2 + b.diff() ** 2 / 2 + a.diff() * b.diff() * sp.cos(a - b)
    system = ss.MechanicalSystem(
        "wall", coordinates=(a, b), kinetic=kinetic, potential=-2 * g * sp.cos(a) - g * sp.cos(b)
    )
    gap = l * sp.sin(a) + l * sp.sin(b) + sp.Rational(1, 2)
    return system, ss.Event(gap, name="wall", action=ss.Impact(restitution))


@pytest.mark.parametrize(
    ("scheme", "order", "restitution"),
    sweep([("simpson", 4, 0.7), ("midpoint", 2, 1.0), ("lobatto6", 6, 0.7), ("gauss6", 6, 1.0)]),
)
def test_order_through_an_impact(scheme, order, restitution):
    """Of the time of impact, which is smooth in h, and by and large of the end."""
    system, event = wall(restitution)
    start = {"q0": [0.9, 0.6], "v0": [0.0, 0.0]}

    def end(scheme, steps):
        run = ss.compile(system, scheme).integrate(
            **start, h=1.2 / steps, steps=steps, events=[event]
        )
        return run.events("wall").t[0], np.concatenate([run.q[-1], run.v[-1]])

    truth = end("gauss12", 120)
    counts = (12, 24, 48) if order == 6 else (24, 48, 96)
    times, states = zip(*(end(scheme, steps) for steps in counts), strict=True)
    off = np.abs(np.array(times) - truth[0])
    assert abs(np.log2(off[0] / off[-1]) / 2 - order) < 0.35
    errors = [np.abs(state - truth[1]).max() for state in states]
    assert np.log2(errors[0] / errors[-1]) / 2 > order - 0.6  # where in its step it falls scatters


@pytest.mark.slow
def test_elastic_impacts_keep_the_level_of_the_energy():
    """On the grid of times that was kept; no drift, where a grid anew from each impact has one."""
    (x,) = ss.coordinates("x")
    bowl = ss.MechanicalSystem(
        "oscillator", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=x**2 / 2 + x**4 / 4
    )
    event = ss.Event(x + sp.Rational(3, 10), name="wall", action=ss.Impact())
    how = {"h": 0.1, "steps": 4_000_000, "every": 10}
    run = ss.compile(bowl, "midpoint").integrate([1.0], v0=[0.0], **how, events=[event])
    assert len(run.events("wall")) > 1e5
    error = np.abs(run.energy - run.energy[0])
    assert error[-40_000:].max() < 1.05 * error[:40_000].max()


def test_a_switch_keeps_the_order_at_a_kink():
    """A spring that is four times as stiff on one side: split where it switches, order four."""
    (x,) = ss.coordinates("x")
    k = sp.Symbol("k", positive=True)
    stiff = ss.MechanicalSystem(
        "kinked",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=k
        * (sp.Rational(5, 2) * x**2 + sp.Rational(3, 2) * x * sp.sqrt(x**2 + 1e-300))
        / 2,
        parameters={k: 1.0},
    )
    kink = ss.Event(x, name="kink", action=ss.Switch())
    stepper, errors = ss.compile(stiff), {}
    # half a turn on the stiff side, one on the soft: the period is pi/2 + pi
    for events in ((kink,), ()):
        ends = [
            stepper.integrate([1.0], v0=[0.0], h=7.0 / n, steps=n, events=list(events) or None)
            for n in (80, 160)
        ]
        time = 7.0 - (np.pi / 2 + np.pi)
        phase = time if time < np.pi / 4 else None
        truth = np.cos(2 * time) if phase is not None else _kinked(time)
        errors[len(events)] = [abs(run.q[-1, 0] - truth) for run in ends]
    assert 3.7 < np.log2(errors[1][0] / errors[1][1]) < 4.3
    assert errors[0][1] > 30 * errors[1][1]


def _kinked(time):
    """Where the mass is: cos(2 t) while x > 0, then -2 sin(t - pi/4), then back."""
    if time < np.pi / 4 + np.pi:
        return -2 * np.sin(time - np.pi / 4)
    return np.sin(2 * (time - np.pi / 4 - np.pi))


def test_a_bouncing_ball_ends_where_its_impacts_accumulate():
    case = IMPACTS["bouncing_ball"]
    with pytest.raises(ss.ConvergenceError, match="acts ever faster") as found:
        run_of(case | {"N": 100})
    run = found.value.trajectory
    assert run.status is ss.Status.EVENTS_ACCUMULATE
    assert float(run.message.split("up to t=")[1].split(". ")[0]) == pytest.approx(
        float(case["accumulate_at"]), abs=1e-12
    )
    assert run.t[-1] == pytest.approx(4.05)
    assert len(run.events("wall")) > 30
