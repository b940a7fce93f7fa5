"""Steps with velocity constraints against golden values of 50 digits, and exact motions.

``tests/data/golden_contact.json``, ``runs``: decimal inputs, the first step, the last state and its
multipliers, found by a program of its own and confirmed by a second one; ``exact``: motions in
closed form.
"""

import json

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.golden import read_system
from support.places import DATA

import symsimpson as ss

GOLDEN = json.loads((DATA / "golden_contact.json").read_text())
RUNS = {case["name"]: case for case in GOLDEN["runs"]}
EXACT = {case["case"]: case for case in GOLDEN["exact"]}
#: Affine rows with forces, beside a constraint of positions, and a singular M come first.
FIRST = ("affine_forced_simpson", "turntable_simpson")


def system_of(case):
    q, values, read = read_system(case)
    forces = {x: f for x, f in zip(q, read(case["forces"]), strict=True) if f != 0}
    return ss.MechanicalSystem.from_lagrangian(
        case["name"],
        *read([case["lagrangian"]]),
        q,
        values,
        constraints=read(case["constraints"]),
        velocity_constraints=read(case["velocity_constraints"]),
        forces=forces or None,
    )


def errors_of(case, stepper, number):
    def read(texts):
        return np.frompyfunc(number, 1, 1)(texts)

    values = {
        name: number(sp.Rational(x).p) / number(sp.Rational(x).q)
        for name, x in case["parameters"].items()
    }
    run = stepper.integrate(
        read(case["q0"]),
        v0=read(case["v0"]),
        h=number(case["h"]),
        steps=case["N"],
        t0=number(case["t0"]),
        parameters=values,
    )
    first, last = case["first_step"], case["final"]
    found = {
        "q1": (run.q[1], first["q1"]),
        "p1": (run.p[1], first["p1"]),
        "q": (run.q[-1], last["q"]),
        "p": (run.p[-1], last["p"]),
        "v": (run.v[-1], last["v"]),
        "multipliers": (run.multipliers[-1], last["multipliers_of_state"]),
    }
    return {
        name: float(max(abs(got - read(right))) / max(1, *abs(read(right))))
        for name, (got, right) in found.items()
    }


@pytest.mark.parametrize("name", sweep(sorted(RUNS, key=lambda name: name not in FIRST), 2))
def test_golden_runs(name):
    case = RUNS[name]
    errors = errors_of(case, ss.compile(system_of(case), case["scheme"]), float)
    assert max(errors.values()) < 1e-13, errors


@pytest.mark.parametrize("name", sweep(["sleigh_simpson", *sorted(RUNS)[:3]]))
def test_golden_runs_in_many_digits(name):
    case = RUNS[name]
    stepper = ss.compile(system_of(case), case["scheme"], precision=45)
    with mp.workdps(45):
        errors = errors_of(case, stepper, mp.mpf)
    assert max(errors.values()) < 1e-30, errors


@pytest.mark.slow
def test_a_step_back_undoes_a_step():
    """Also with forces, rows that move with the time, and one constraint of positions."""
    for name in ("affine_forced_simpson", "turntable_simpson"):
        case = RUNS[name]
        stepper = ss.compile(system_of(case), case["scheme"], precision=50)
        with mp.workdps(50):
            q, v = (np.frompyfunc(mp.mpf, 1, 1)(case[key]) for key in ("q0", "v0"))
            t, h = mp.mpf(case["t0"]), mp.mpf(case["h"])
            there = stepper.integrate(q, v0=v, h=h, steps=4, t0=t)
            back = stepper.integrate(there.q[-1], p0=there.p[-1], h=-h, steps=4, t0=there.t[-1])
            assert max(abs(back.q[-1] - q)) < 1e-45
            assert max(abs(back.v[-1] - there.v[0])) < 1e-45


def test_a_sleigh_turns_as_tanh():
    case = {key: float(x) for key, x in EXACT["sleigh"].items() if key != "case"}
    sleigh = ss.systems.chaplygin_sleigh()
    values = {"m": case["m"], "J": case["I0"], "a": case["a"]}
    # on the energy surface of the motion that turns by sech from w0 on, without speed
    errors = []
    for steps in (60, 120):
        run = ss.compile(sleigh, "gauss6").integrate(
            [0.0, 0.0, 0.0],
            v0=[0.0, 0.0, case["w0"]],
            h=case["t"] / steps,
            steps=steps,
            parameters=values,
        )
        truth = [case["x"], case["y"], case["th"]]
        errors.append(np.abs(run.q[-1] - truth).max())
    assert errors[1] < 1e-8
    assert 5.8 < np.log2(errors[0] / errors[1]) < 6.2


@pytest.mark.slow
def test_a_ball_on_a_turntable_goes_round_on_a_circle():
    """About a centre that follows from its start, at 2/7 of the rate of the table."""
    ball = ss.systems.ball_on_turntable()
    run = ss.compile(ball, "gauss6").integrate(**ball.reference_state, h=0.05, steps=200)
    rate = 1.1 * 2 / 7
    q, v = run.q[:, :2], run.v[:, :2]
    centre = q + np.column_stack([-v[:, 1], v[:, 0]]) / rate
    assert np.abs(centre - centre[0]).max() < 1e-9
    assert np.abs(run.constraint_error).max() < 1e-15
    assert np.abs(run.velocity_constraint_error).max() < 2e-15


def test_a_coin_keeps_its_momentum_and_energy():
    """A p_yaw that no constraint pulls at is constant to rounding; so is the energy here."""
    case = RUNS["coin_midpoint"]
    run = ss.compile(system_of(case), "midpoint").integrate(
        np.array(case["q0"], float), v0=np.array(case["v0"], float), h=0.05, steps=300
    )
    assert np.ptp(run["p_ph"]) < 1e-15
    assert np.abs(run.energy_error).max() < 1e-13
