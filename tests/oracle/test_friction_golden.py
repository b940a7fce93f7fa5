"""Contacts and dry friction against golden values: sequences, times, states, forces and orders."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.friction import CASES, brake, events_of, number, read_case, run_case

import symsimpson as ss

TIMES = {"table": 1e-9}  # where impacts accumulate


@pytest.mark.parametrize("scheme", sweep(["gauss6", "gauss8"], 0))
@pytest.mark.parametrize("name", sweep(CASES, 0))
def test_golden_cases(name, scheme):
    case = CASES[name]
    run = run_case(name, scheme, number(case["h"]) / 4)
    found, known = events_of(run), case["events"]
    assert [one[1:] for one in found] == [tuple(one[1:]) for one in known]
    times = np.array([one[0] for one in known], dtype=float)
    near = TIMES.get(name, 1e-9 if scheme == "gauss6" else 1e-11)
    assert np.abs([one[0] for one in found] - times).max() < near
    final = case["final"]
    for state, key in ((run.q, "q"), (run.v, "v")):
        right = np.array(final[key], dtype=float)
        assert np.abs(state[-1] - right).max() < 1e-9 * max(1, np.abs(right).max())
    assert run.modes.at(run.t[-1]) == final["mode"]
    for prefix, values in (
        ("normal_", final.get("normal", {})),
        ("friction_", final.get("friction", {})),
    ):
        for key, value in values.items():
            right = 0.0 if value is None else float(value)
            assert abs(run[prefix + key][-1] - right) < 1e-9 * max(1, abs(right))


ORDERS = [
    ("midpoint", 2, 0.025),
    ("simpson", 4, 0.025),
    ("gauss4", 4, 0.025),
    ("gauss6", 6, 0.0125),
]


@pytest.mark.parametrize(("scheme", "order", "h"), sweep(ORDERS, 0))
def test_orders_through_changes(scheme, order, h):
    case = CASES["locking_pendulum"]  # 13 changes
    times = np.array([one[0] for one in case["events"]], dtype=float)
    right = np.concatenate([np.array(case["final"][key], dtype=float) for key in "qv"])
    of_times, of_ends = [], []
    for halving in range(3):
        run = run_case("locking_pendulum", scheme, h / 2**halving)
        of_times.append(np.abs([one.t for one in run.records] - times).max())
        of_ends.append(np.abs(np.concatenate([run.q[-1], run.v[-1]]) - right).max())
    for errors in (of_times, of_ends):
        found = -np.diff(np.log2(errors))
        assert np.abs(found - order).max() < 0.35


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "most"), [("simpson", 4e-5), ("gauss6", 6e-9)])
def test_belt_over_99_periods(scheme, most):
    system, q0, v0 = read_case("belt")
    period = 8.0688878715914054708912
    run = ss.compile(system, scheme).integrate(q0, v0=v0, h=0.1, t_end=99 * period)
    slips = [t for t, _, kind in events_of(run) if kind == "slip-"]
    assert len(slips) == 99
    assert abs(slips[-1] - (5 + 98 * period)) < most


@pytest.mark.slow
def test_critical_friction_of_a_falling_rod():
    system, q0, v0 = read_case("falling_rod")
    stepper, critical = ss.compile(system, "gauss6"), 15 * np.sqrt(10) / 128
    q0, t_end = [0.0, np.cos(1e-3), 1e-3], 3.0
    ends = {"events": [ss.Event("th - 1", name="low", terminal=True)]}
    for mu, slips_back in ((critical - 1e-4, True), (critical + 1e-4, False)):
        start = {"h": 0.005, "t_end": t_end, "parameters": {"mu": mu}, **ends}
        run = stepper.integrate(q0, v0=v0, **start)
        kinds = [one.kind for one in run.records if one.kind]
        assert (kinds[0] == "slip-") == slips_back


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.0, 2.0, 4.0])
def test_painleve_is_never_a_success(rate):
    system, *_ = read_case("falling_rod")
    angle = np.arctan(0.5)
    q0 = [0.0, np.cos(angle), angle]
    v0 = [-5 + np.cos(angle) * rate, -np.sin(angle) * rate, rate]
    given = {"parameters": {"mu": 1.5, "g": 9.81}, "on_failure": "return"}
    run = ss.compile(system, "gauss6").integrate(q0, v0=v0, h=0.01, t_end=1.0, **given)
    assert run.status is ss.Status.CONTACT_PARADOX
    assert "tip" in run.message


@pytest.mark.slow
def test_rows_hold_after_many_steps():
    system, q0, v0 = read_case("incline")
    run = ss.compile(system, "gauss8").integrate(q0, v0=v0, h=2e-5, steps=100_000)
    assert np.abs(run["y"]).max() < 1e-14
    held = (run.t > 0.62) & (run.t < 1.8)
    assert np.abs(run["v_x"][held]).max() < 1e-14
    assert run["normal_floor"].min() > -1e-9
    most = 0.5 * run["normal_floor"]
    assert (np.abs(run["friction_floor.slip"]) <= most * (1 + 1e-9)).all()


@pytest.mark.slow
def test_a_stopped_block_stays():
    run = ss.compile(brake(0.5), "gauss6").integrate([0.4], v0=[0.1], h=0.05, steps=100_000)
    after = np.flatnonzero(run.t > run.modes.t[-1])
    assert len({*run.q[after, 0].tolist()}) == 1
    assert len(run.records) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["locking_pendulum", "falling_rod", "ball"])
def test_energy_balance(name):
    run = run_case(name, "gauss8", number(CASES[name]["h"]) / 4, record="work")
    assert np.abs(run.energy_balance).max() < 1e-9 * max(1, np.abs(run.energy).max())
    assert {*run.modes.names[-1:]} <= run.work.keys()


def whole_difference(stepper, q0, p0, j, d=1e-6, **given):
    """Differentiate whole runs by a component of the initial state."""
    ends = []
    for sign in (1, -1):
        start = np.concatenate([q0, p0])
        start[j] += sign * d
        run = stepper.integrate(start[: len(q0)], p0=start[len(q0) :], every=None, **given)
        ends.append(np.concatenate([run.q[-1], run.p[-1]]))
    return (ends[0] - ends[1]) / (2 * d)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "t_end", "parameters"),
    [("locking_pendulum", 5.0, ("F1", "g")), ("belt", 8.0, ("Fk", "k"))],
)
def test_derivatives_through_changes(name, t_end, parameters):
    system, q0, v0 = read_case(name)
    stepper, given = ss.compile(system, "gauss8"), {"h": number(CASES[name]["h"]), "t_end": t_end}
    n = len(q0)
    run = stepper.integrate(q0, v0=v0, tangents=2 * n, sensitivities=parameters, **given)
    assert len(run.modes) > 1
    for j in range(n):  # momenta begin where a sign of friction changes
        right = whole_difference(stepper, q0, run.p[0], j, **given)
        assert np.abs(run.tangent[-1][:, j] - right).max() < 1e-6 * max(1, np.abs(right).max())
    defaults = {str(key): value for key, value in system.parameters.items()}
    for key in parameters:
        ends = [
            stepper.integrate(q0, v0=v0, parameters={key: defaults[key] + d}, **given)
            for d in (1e-6, -1e-6)
        ]
        right = np.concatenate([ends[0].q[-1] - ends[1].q[-1], ends[0].p[-1] - ends[1].p[-1]])
        assert np.abs(run.sensitivity[key][-1] - right / 2e-6).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.08, 0.15])
def test_steady_steps_of_a_rimless_wheel(slope):
    """Its speed after an impact is 2 cot(2 alpha) sqrt(g/l sin(alpha) sin(gamma)) (McGeer 1990)."""
    x, y = ss.coordinates("x y")
    alpha, g = np.pi / 8, 9.81
    places = 2 * np.sin(alpha) * np.arange(12)
    wheel = ss.MechanicalSystem(
        "wheel",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=g * (y * np.cos(slope) - x * np.sin(slope)),
        contacts=[ss.Contact(sp.sqrt((x - place) ** 2 + y**2) - 1) for place in places],
    )
    given = {"h": 0.01, "steps": 2000, "events": [ss.Event(x - places[-1], terminal=True)]}
    run = ss.compile(wheel, "gauss6").integrate([0.0, 1.0], v0=[1.2, 0.0], **given)
    hits = [one for one in run.records if one.kind == "impact"]
    before, after = (
        np.linalg.norm([getattr(x, p) for x in hits], axis=1) for p in ("p", "p_after")
    )
    assert np.abs(after / before - np.cos(2 * alpha)).max() < 1e-12
    steady = 2 / np.tan(2 * alpha) * np.sqrt(g * np.sin(alpha) * np.sin(slope))
    distance = after - steady
    assert abs(distance[-1]) < 0.02 * abs(distance[0])
    assert len(hits) == 11
