"""Constraints of positions that move: golden values, order, work, and forces in closed form.

``tests/data/golden_moving.json`` has states at the end of motions, with 22 digits, from equations
in coordinates that need no constraint.
"""

import json

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.in_c import InC
from support.places import DATA
from support.rolling import allowed_state, moved_by_time

import symsimpson as ss

GOLDEN = {x["name"]: x for x in json.loads((DATA / "golden_moving.json").read_text())}


def system_of(case):
    q = ss.coordinates(" ".join(case["coordinates"]))
    known = dict(zip(case["coordinates"], q, strict=True)) | {"t": ss.time}
    known |= zip(case["velocities"], (x.diff() for x in q), strict=True)
    return ss.MechanicalSystem(
        "moving",
        coordinates=q,
        kinetic=sp.sympify(case["kinetic"], locals=known),
        potential=sp.sympify(case["potential"], locals=known),
        constraints=[sp.sympify(x, locals=known) for x in case["constraints"]],
    )


def numbers(texts):
    return np.array([float(x) for x in texts])


def run_of(case, stepper, steps):
    start = numbers(case["q0"]), numbers(case["v0"])
    return stepper.integrate(start[0], v0=start[1], h=float(case["t_end"]) / steps, steps=steps)


def error_of(case, run):
    truth = numbers(case["q"] + case["v"])
    return np.abs(np.concatenate([run.q[-1], run.v[-1]]) - truth).max()


@pytest.mark.parametrize("name", sweep(GOLDEN, 1))
def test_golden_motions(name):
    case = GOLDEN[name]
    run = run_of(case, ss.compile(system_of(case), "gauss12"), 100)
    assert error_of(case, run) < 1e-10
    assert np.abs(run.constraint_error).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["midpoint", "simpson", "gauss4", "lobatto6", "gauss6"])
@pytest.mark.parametrize("name", GOLDEN)
def test_orders(name, scheme):
    case, stepper = GOLDEN[name], ss.compile(system_of(GOLDEN[name]), scheme)
    errors = [error_of(case, run_of(case, stepper, steps)) for steps in (24, 48)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(stepper.order, abs=0.3)


@pytest.mark.slow
def test_the_energy_changes_by_the_work_of_the_constraint():
    case = GOLDEN["pivot moved sideways"]
    stepper = ss.compile(system_of(case), "simpson")
    runs = [run_of(case, stepper, steps) for steps in (40, 80)]
    errors = [np.abs(run.energy_balance).max() for run in runs]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.1)
    assert np.ptp(runs[0].work["constraints"]) > 1e3 * errors[0]
    with pytest.raises(ss.InputError, match="moving constraints do work"):
        _ = runs[0].energy_error


def test_a_mass_without_freedom_feels_the_force_that_moves_it():
    """As many constraints as coordinates: m x'' + k x = -lambda."""
    (x,) = ss.coordinates("x")
    motion = sp.sin(3 * ss.time)
    system = ss.MechanicalSystem(
        "shaker",
        coordinates=[x],
        kinetic=x.diff() ** 2,
        potential=x**2,
        constraints={"drive": x - motion},
    )
    run = ss.compile(system, "gauss6").integrate([0.0], v0=[3.0], h=0.05, steps=40)
    truth = np.sin(3 * run.t)
    np.testing.assert_allclose(run.q[:, 0], truth, atol=1e-14)
    np.testing.assert_allclose(run["lambda_drive"], 16 * truth, atol=1e-13)


@pytest.mark.slow
def test_many_digits_keep_a_step_reversible():
    system = moved_by_time(rolling=True)
    stepper, state = ss.compile(system, "simpson", precision=50), allowed_state(system)
    with mp.workdps(50):
        h = mp.mpf(1) / 20
        there = stepper.integrate(state["q0"], v0=state["v0"], h=h, steps=4)
        back = stepper.integrate(there.q[-1], p0=there.p[-1], h=-h, steps=4, t0=there.t[-1])
        assert max(abs(back.q[-1] - there.q[0])) < 1e-45
        assert max(abs(back.v[-1] - there.v[0])) < 1e-45
        assert abs(there.constraint_error).max() < 1e-48


@pytest.mark.slow
@pytest.mark.parametrize("rolling", [False, True])
def test_ensembles_files_and_c_take_the_same_steps(rolling, tmp_path):
    system = moved_by_time(rolling)
    stepper, state = ss.compile(system, "gauss4"), allowed_state(system)
    run = stepper.integrate(**state, h=0.05, steps=20, t0=0.0)
    several = {name: np.stack([x] * 3) for name, x in state.items()}
    together = stepper.ensemble(**several, h=0.05, steps=20)
    np.testing.assert_allclose(together.q[2], run.q[-1], rtol=1e-13)
    loaded = ss.load(ss.generate(system, "gauss4", directory=tmp_path))
    np.testing.assert_array_equal(loaded.integrate(**state, h=0.05, steps=20).q, run.q)
    in_c = InC(stepper, tmp_path)
    in_c.begin(0.05, run.q[0], p=run.p[0])
    for k in range(20):
        in_c.step(0.05, t=run.t[k])
    np.testing.assert_allclose(in_c.get()[0], run.q[-1], rtol=1e-13)


@pytest.mark.slow
def test_states_between_steps_and_certificates():
    system = moved_by_time()
    stepper, state = ss.compile(system, "gauss6"), allowed_state(system)
    run = stepper.integrate(**state, h=0.05, steps=20)
    fine = stepper.integrate(**state, h=0.025, steps=40)
    np.testing.assert_allclose(run.at(fine.t).q, fine.q, atol=1e-5)
    assert stepper.certify(**state).passed


def test_what_is_refused():
    system = moved_by_time()
    state = allowed_state(system)
    stepper = ss.compile(system, "simpson")
    with pytest.raises(ss.InputError, match=r"'rod'(.|\n)*consistent\(q0, v0, t=0.5\) returns"):
        stepper.integrate(**state, h=0.01, steps=1, t0=0.5)
    with pytest.raises(ss.InputError, match="v0 violates the constraint 'rod'"):
        stepper.integrate(state["q0"], v0=0 * state["v0"], h=0.01, steps=1)
    with pytest.raises(ss.SchemeError, match="drifts of kahan_li8 violate the moving constraints"):
        ss.compile(system, "kahan_li8")
    with pytest.raises(ss.InputError, match="contain the time"):
        ss.OptimalControl(system, cost=1, duration=1.0)
    (x,), u = ss.coordinates("x"), sp.Symbol("u")
    with pytest.raises(ss.ModelError, match="'1' depends on the input u"):
        ss.MechanicalSystem(
            "d",
            coordinates=[x],
            kinetic=x.diff() ** 2,
            potential=x,
            constraints=[x - u],
            inputs=[u],
        )
