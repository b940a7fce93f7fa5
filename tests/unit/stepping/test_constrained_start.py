"""Starts, results and steppers of systems with constraints."""

import ast
import re

import mpmath
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.rods import rod_of

import symsimpson as ss
from symsimpson.stepping.run import Run

SYSTEM = ss.systems.cartesian_pendulum()
START = {"q0": [0.6, 0.0, -0.8], "v0": [0.4, 1.7, 0.3]}


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(SYSTEM)


def test_results(stepper):
    run = stepper.integrate(**START, h=0.01, steps=50)
    assert run.multipliers.shape == run.constraint_error.shape == (51, 1)
    assert run.constraint_forces.shape == (51, 3)
    # m (v.v + g.q) / l^2: the tension by the length
    tension = 1.3 * ((run.v**2).sum(axis=1) - 9.81 * run["z"])
    assert np.abs(run["lambda_rod"] - tension).max() < 1e-12
    assert np.abs(run.constraint_forces + run.multipliers * run.q).max() < 1e-13
    assert np.abs(run.constraint_error).max() < 5e-16
    assert run[10:20].multipliers.shape == (10, 1)
    with pytest.raises(KeyError, match="lambda_rod"):
        run["lambda_other"]
    free = ss.compile(ss.systems.pendulum()).integrate([1.0], [0.0], h=0.1, steps=3)
    assert free.multipliers.shape == (4, 0)
    assert free.constraint_forces.shape == (4, 1)


def test_starts_that_miss_are_refused_with_what_would_do(stepper):
    told = r"q0 violates the constraint 'rod'.*0\.12(.|\n)*consistent.*q0=\[0\.65"
    with pytest.raises(ss.InputError, match=told):
        stepper.integrate([0.6, 0, -0.7], START["v0"], h=0.01, steps=1)
    with pytest.raises(ss.InputError, match="v0 violates the constraint 'rod'"):
        stepper.integrate(START["q0"], [0.4, 1.7, 0.4], h=0.01, steps=1)
    with pytest.raises(ss.InputError, match=r"p0 has a component(.|\n)*Or pass v0"):
        stepper.integrate(START["q0"], p0=[0.4, 1.7, 0.4], h=0.01, steps=1)
    with pytest.raises(ss.InputError, match="of member 1"):
        stepper.ensemble([START["q0"], [0, 0.6, 0.7]], v0=[0, 0, 0], h=0.01, steps=1)
    with pytest.raises(ss.ModelError, match=r"the gradient of the constraint .* is zero"):
        stepper.integrate([0, 0, 0], START["v0"], h=0.01, steps=1)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("off", [0.0, 1e-13, 1e-9])
def test_a_square_has_no_slope_where_rounding_gives_it_one(angle, off):
    x, y = ss.coordinates("x y")
    circle = (1000 * x) ** 2 + y**2 - 1  # in kilometres and metres
    place = [(1 + off) * np.cos(angle) / 1000, (1 + off) * np.sin(angle)]
    system = {"coordinates": (x, y), "kinetic": (x.diff() ** 2 + y.diff() ** 2) / 2}
    squared, plain = (
        ss.MechanicalSystem("wire", **system, potential=y, constraints=[phi])
        for phi in (circle**2, circle)
    )
    with pytest.raises(ss.ModelError, match=r"the gradient of the constraint .* is zero"):
        ss.compile(squared).integrate(place, [0, 0], h=0.01, steps=1)
    assert ss.compile(plain).integrate(place, [0, 0], h=0.01, steps=1).success


def test_a_short_rod_far_away_has_a_slope():
    x, y = ss.coordinates("x y")
    system = ss.MechanicalSystem(
        "far",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=10 * y,
        constraints=[(x - 6371000) ** 2 + y**2 - sp.Rational(1, 100)],
    )
    assert ss.compile(system).integrate([6371000.0, -0.1], [0, 0], h=0.01, steps=1).success


def test_starts_that_nearly_do_are_mended(stepper):
    run = stepper.integrate([0.6, 0, -0.8 + 3e-10], START["v0"], h=0.01, steps=1)
    assert abs(run.constraint_error[0, 0]) < 3e-16
    many = ss.compile(SYSTEM, precision=40)
    digits = many.integrate([0.6, 0, -0.8], ["0.4", "1.7", "0.3"], h="0.01", steps=1)
    assert abs(digits.constraint_error).max() < mpmath.mpf(10) ** -39


def test_starts_that_are_not_led_onto_the_constraints_are_refused(stepper, monkeypatch):
    monkeypatch.setattr("symsimpson.stepping.constrained_start.MOST_ITERATIONS", 1)
    with pytest.raises(ss.InputError, match="q0 does not reach the constraint 'rod'"):
        stepper.integrate([0.6, 0, -0.8 + 3e-10], START["v0"], h=0.01, steps=1)


@pytest.mark.slow
def test_folded_linkages_are_told():
    """A parallelogram with its bars in a line may go either way."""
    t1, t2, t3 = ss.coordinates("t1 t2 t3")
    kinetic = sum(t.diff() ** 2 for t in (t1, t2, t3))
    gap = [f(t1) + 2 * f(t2) - f(t3) for f in (sp.cos, sp.sin)]
    system = ss.MechanicalSystem(
        "parallelogram",
        coordinates=(t1, t2, t3),
        kinetic=kinetic,
        potential=0,
        constraints={"loop_x": gap[0] - 2, "loop_y": gap[1]},
    )
    with pytest.raises(
        ss.ModelError,
        match=r"'loop_x', 'loop_y' are linearly dependent|gradient of the constraint .* is zero",
    ):
        ss.compile(system).integrate([0, 0, 0], [1, 0, 1], h=0.01, steps=1)


def parallelogram():
    """Bars of lengths 2 and 1 in a loop, uniform in its angles."""
    t1, t2, t3 = ss.coordinates("t1 t2 t3")
    w1, w2, w3 = (t.diff() for t in (t1, t2, t3))
    kinetic = 2 * w1**2 / 3 + 2 * w2**2 / 3 + w3**2 / 6 + w1 * w2 * sp.cos(t1 - t2)
    gap = [f(t1) + 2 * f(t2) - f(t3) for f in (sp.cos, sp.sin)]
    return ss.MechanicalSystem(
        "parallelogram",
        coordinates=(t1, t2, t3),
        kinetic=kinetic,
        potential=0,
        constraints={"loop_x": gap[0] - 2, "loop_y": gap[1]},
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.ResolutionWarning")
def test_folds_on_the_way_are_told():
    stepper = ss.compile(parallelogram())
    with pytest.warns(
        ss.ConstraintWarning, match=r"nearly linearly dependent at about t=2\.1"
    ) as told:
        run = stepper.integrate([1.0, 0.0, 1.0], [1.0, 0.0, 1.0], h=0.02, steps=150)
    assert run.success
    assert len(told) == 1
    assert "nearly linearly dependent" in run.message
    # the fold stands at a step
    rate = np.pi - 1
    with pytest.raises(
        ss.ConvergenceError, match=r"'loop_x', 'loop_y' are linearly dependent at t=1, at step 20"
    ):
        stepper.integrate([1.0, 0.0, 1.0], [rate, 0.0, rate], h=0.05, steps=20)
    run = stepper.integrate(
        [1.0, 0.0, 1.0], [rate, 0.0, rate], h=0.05, steps=20, on_failure="return"
    )
    assert run.status is ss.Status.SINGULAR_CONSTRAINTS
    assert (run.steps, len(run)) == (19, 20)
    with pytest.raises(ss.ConvergenceError, match="'loop_x', 'loop_y' are linearly dependent"):
        stepper.integrate(
            [1.0, 0.0, 1.0], [rate / 10] * 1 + [0.0, rate / 10], h=0.05, t_eval=[1.0, 12.8]
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(["four_bar", "slider_crank", "jointed_bodies"]))
def test_linkages_that_do_not_fold_are_not_warned_of(name):
    system = ss.systems.CONSTRAINED[name]()
    run = ss.compile(system).integrate(**system.reference_state, h=0.02, steps=500)
    assert run.success
    assert "close" not in run.message


def test_steps_by_themselves_are_those_of_a_run(stepper):
    run = stepper.integrate(**START, h=0.01, steps=5)
    q, p = run.q[0], run.p[0]
    for k in range(1, 6):
        q, p = stepper.step(q, p=p, h=0.01)
        assert np.abs(q - run.q[k]).max() < 1e-15


@pytest.mark.slow
def test_lanes_and_states_between(stepper):
    q0 = np.array([START["q0"], [0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
    v0 = np.array([START["v0"], [1.0, 0.0, 0.0], [0.0, 0.5, 0.5]])
    many = stepper.ensemble(q0, v0=v0, h=0.01, steps=100, every=10)
    for k in range(3):
        one = stepper.integrate(q0[k], v0[k], h=0.01, steps=100, every=10)
        assert np.abs(one.q - many.q[k]).max() < 1e-14
        assert np.abs(one.multipliers - many.multipliers[k]).max() < 1e-11
    whole = stepper.integrate(**START, h=0.01, steps=100)
    between = whole.at([0.333, 0.777])
    assert np.abs(between.constraint_error).max() < 1e-15
    fine = stepper.integrate(**START, h=0.001, steps=333)
    assert np.abs(between.q[0] - fine.q[-1]).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["cartesian_pendulum", pytest.param("jointed_bodies", marks=pytest.mark.slow)]
)
def test_pivots_in_rows_lead_to_the_same_states(name):
    """The kernels that take over where a fixed order of elimination fails; and plain loops."""
    system = ss.systems.CONSTRAINED[name]()
    stepper = ss.compile(system)
    whole = stepper.integrate(**system.reference_state, h=0.01, steps=20)
    run = Run(stepper.program, stepper.program.values(None), 0.01, 0.0, (1, 21), ("robust",))
    run.begin(*map(np.array, system.reference_state.values()), velocity=True)
    run.advance(20)
    assert run.alive
    assert np.abs(run.q[:, :, 0] - whole.q).max() < 1e-14
    assert np.abs(run.p[:, :, 0] - whole.p).max() < 1e-13


def test_explicit_schemes_say_why_not():
    with pytest.raises(ss.SchemeError, match="order 4 only for drifts along straight lines"):
        ss.compile(SYSTEM, "blanes_moan4")


@pytest.mark.slow
def test_forces_and_time_beside_constraints():
    """Friction on a bob, against the pendulum in its angle."""
    x, y, theta = ss.coordinates("x y theta")
    c, w = sp.symbols("c w", positive=True)
    drive = sp.cos(w * ss.time)
    held = ss.MechanicalSystem(
        "held",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y,
        forces={x: drive - c * x.diff(), y: -c * y.diff()},
        parameters={c: 0.2, w: 3.0},
        constraints=[x**2 + y**2 - 1],
    )
    free = ss.MechanicalSystem(
        "free",
        coordinates=(theta,),
        kinetic=theta.diff() ** 2 / 2,
        potential=-9.81 * sp.cos(theta),
        forces={theta: drive * sp.cos(theta) - c * theta.diff()},
        parameters={c: 0.2, w: 3.0},
    )
    first = ss.compile(held, "gauss8").integrate([0.6, -0.8], [0.8, 0.6], h=0.02, steps=200)
    angle = np.arctan2(0.6, 0.8)
    second = ss.compile(free, "gauss8").integrate([angle], [1.0], h=0.02, steps=200)
    assert np.abs(first["x"] - np.sin(second["theta"])).max() < 1e-10
    assert np.abs(first.energy_balance).max() < 1e-9
    assert np.abs(first.work["total"] - second.work["total"]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scheme"), [("four_bar", "gauss6"), ("hanging_chain", "simpson")])
def test_residual_and_jacobian_with_multipliers(name, scheme):
    """Derivatives against differences; residuals of a step that was solved are zero."""
    system = getattr(ss.systems, name)(*([6] if name == "hanging_chain" else []))
    stepper = ss.compile(system, scheme, precision=30)
    n, m, d = system.n, len(system.constraints), stepper.program.header.degree
    q0 = np.array(system.reference_state["q0"])
    random, h = np.random.default_rng(1), 0.1
    p0, u = 0.1 * random.normal(size=n), random.normal(size=d * (n + m))

    def split(u):
        return q0 + 0.01 * u[: d * n].reshape(d, n), u[d * n :].reshape(d, m)

    def residual(u):
        nodes, mu = split(u)
        return stepper.residual(q0, p0, nodes, h, multipliers=mu)

    nodes, mu = split(u)
    exact = stepper.jacobian(q0, p0, nodes, h, multipliers=mu).astype(float)
    exact[:, : d * n] *= 0.01
    moved = [(residual(u + 1e-4 * e) - residual(u - 1e-4 * e)) / 2e-4 for e in np.eye(len(u))]
    assert np.abs(exact - np.array(moved, dtype=float).T).max() < 1e-8 * np.abs(exact).max()
    assert np.abs(exact[: d * n, d * n :]).max() > 0.1
    without = stepper.residual(q0, p0, nodes, h)
    still = stepper.residual(q0, p0, nodes, h, multipliers=0 * mu)
    assert max(abs(still[: d * n] - without)) < 1e-28


def test_multipliers_of_another_shape():
    stepper = ss.compile(ss.systems.four_bar(), precision=20)
    with pytest.raises(
        ss.InputError, match=r"multipliers has shape \(1,\), but must .*four_bar has 2"
    ):
        stepper.residual([1, 0, 1], [0, 0, 0], np.ones((2, 3)), 0.1, multipliers=[1.0])
    free = ss.compile(ss.systems.pendulum(), "midpoint", precision=20)
    with pytest.raises(ss.InputError, match="Omit them for a system without constraints"):
        free.residual([1], [0], [[1]], 0.1, multipliers=np.ones((1, 0)))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.ResolutionWarning")
def test_members_that_fold_are_told_apart():
    """Of three members one goes over the fold, one stands in it at a step, one never meets it."""
    stepper, rates = ss.compile(parallelogram()), [1.0, np.pi - 1, 0.01]
    starts = np.tile([1.0, 0.0, 1.0], (3, 1))
    given = np.array([[rate, 0.0, rate] for rate in rates])
    with pytest.warns(ss.ConstraintWarning, match="in 1 of 3 members, the first of them 0") as told:
        many = stepper.ensemble(starts, v0=given, h=0.05, steps=50, every=1)
    assert len(told) == 1
    assert told[0].filename == __file__
    assert many.status.tolist() == [0, ss.Status.SINGULAR_CONSTRAINTS, 0]
    assert many.steps.tolist() == [50, 19, 50]
    assert np.isnan(many.q[1, 20:]).all()
    assert np.isfinite(many.q[1, :20]).all()
    few = stepper.ensemble(starts, v0=given, h=0.05, steps=50, every=10)
    assert few.status.tolist() == [0, ss.Status.SINGULAR_CONSTRAINTS, 0]


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_starts_are_judged_alike_in_any_unit_of_length(unit):
    system = rod_of(unit)
    stepper = ss.compile(system)
    for q, other, told in (
        ([1.5, 0], {"v0": [0, 0]}, "q0 violates"),
        ([1 + 1e-8, 0], {"v0": [0, 0]}, "q0 violates"),
        ([1, 0], {"v0": [0.5, 0]}, "v0 violates"),
        ([1, 0], {"v0": [1e-8, 0]}, "v0 violates"),
        ([1, 0], {"p0": [0.5, 0]}, "p0 has a component along"),
    ):
        second = {name: np.multiply(x, unit) for name, x in other.items()}
        with pytest.raises(ss.InputError, match=told):
            stepper.integrate(np.multiply(q, unit), **second, h=0.01, steps=1)
    # at rest, where the motion turns, and beside rounding
    for q, other in (([0, -1], {"v0": [0, 0]}), ([1, 0], {"v0": [1e-15, 1e-12]})):
        second = {name: np.multiply(x, unit) for name, x in other.items()}
        run = stepper.integrate(np.multiply(q, unit), **second, h=0.01, steps=1)
        assert np.abs(run.q[0] - np.multiply(q, unit)).max() <= 1e-15 * unit
    q, v = system.consistent([1.5 * unit, 1e-3 * unit], [0.5 * unit, 0.2 * unit])
    assert abs(q @ q / unit**2 - 1) < 1e-14
    assert abs(q @ v) < 1e-15 * unit**2
    stepper.integrate(q, v0=v, h=0.01, steps=1)


def test_terms_that_are_large_against_q_and_cancel():
    """The bob of a rod hangs at the origin, its pivot is elsewhere."""
    x, y = ss.coordinates("x y")
    system = ss.MechanicalSystem(
        "rod",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y,
        constraints={"rod": x**2 + (y - 0.7) ** 2 - 0.49},
    )
    stepper = ss.compile(system)
    for place in ([0.0, 0.0], [1e-9, 0.0]):
        q, v = system.consistent(place, [0.1, 0.0])
        for start in (place, q):
            stepper.integrate(start, v0=v, h=0.01, steps=1)
        assert abs(v[0] - 0.1) < 1e-8
    with pytest.raises(ss.InputError, match="q0 violates"):
        stepper.integrate([1e-3, 0.0], v0=[0.0, 0.0], h=0.01, steps=1)


def test_the_call_that_is_advised_has_the_parameters_of_the_run():
    bars = ss.systems.four_bar()
    q, v = bars.consistent([1.0, 0.3, 1.4], [1.3, 0.0, 0.0])
    stepper, given = ss.compile(bars), {"h": 0.01, "steps": 2, "parameters": {"l1": 1.05}}
    with pytest.raises(ss.InputError, match="returns the nearest start") as told:
        stepper.integrate(q, v0=v, **given)
    call = re.search(r"system\.consistent\(q0, v0, parameters=(.*)\) returns", str(told.value))
    q, v = bars.consistent(q, v, parameters=ast.literal_eval(call[1]))
    assert stepper.integrate(q, v0=v, **given).success


def test_the_nearest_start_is_no_whole_turns_away():
    """Newton's method may go round and round: what angles say is the same without it."""
    bars = ss.systems.four_bar()
    near = np.array([1.0, 0.3257, 1.4134])
    q, _ = bars.consistent(near, [0, 0, 0], parameters={"l1": 5.0})
    assert np.abs(q - near).max() < np.pi


def test_starts_are_judged_in_the_unit_of_what_a_constraint_is_made_of():
    """A quaternion beside an orbit in metres, and a rod of nanometres beside radians a second."""
    x, a, b = ss.coordinates("x a b")
    m, l = sp.symbols("m l", positive=True)
    craft = ss.MechanicalSystem(
        "craft",
        coordinates=(x, a, b),
        kinetic=m * (x.diff() ** 2 + a.diff() ** 2 + b.diff() ** 2) / 2,
        potential=0,
        parameters={m: 1.0},
        constraints={"unit": a**2 + b**2 - 1},
    )
    stepper = ss.compile(craft, "midpoint")
    for far in (7e9, 1.5e11):
        assert stepper.integrate([far, 0.6, 0.8], v0=[7e3, 0.4, -0.3], h=1e-3, steps=1).success
        with pytest.raises(ss.InputError, match="q0 violates the constraint 'unit'"):
            stepper.integrate([far, 0.61, 0.8], v0=[7e3, 0.4, -0.3], h=1e-3, steps=1)
    rod = ss.MechanicalSystem(
        "rod",
        coordinates=(x, a, b),
        kinetic=m * (x.diff() ** 2 + a.diff() ** 2 + l**2 * b.diff() ** 2) / 2,
        potential=0,
        parameters={m: 3e-26, l: 2e-9},
        constraints={"across": x - l * sp.sin(b), "along": a + l * sp.cos(b)},
    )
    stepper = ss.compile(rod, "midpoint")
    start, along = [0.0, -2e-9, 0.0], [1e3, 0.0, 5e11]
    assert stepper.integrate(start, v0=along, h=1e-14, steps=1).success
    with pytest.raises(ss.InputError, match="v0 violates the constraint 'along'"):
        stepper.integrate(start, v0=[1e3, 4e2, 5e11], h=1e-14, steps=1)
