"""Gradients of runs: exact, whatever the cost is made of, and whatever they are taken by."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.chains import swinging_chain
from support.forms import limited
from support.tangents import check_adjoint

import symsimpson as ss
from symsimpson.run import gradients
from symsimpson.stepping.run import Run

H, STEPS = 0.01, 60


def differences(value, x, size=1e-4):
    """Differences of fourth order of a function of an array, in its shape."""
    slopes = np.empty(np.shape(x))
    for place in np.ndindex(slopes.shape):
        total = 0.0
        for number, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
            there = np.array(x, dtype=float)
            there[place] += number * size
            total += weight * value(there)
        slopes[place] = total / (12 * size)
    return slopes


@pytest.fixture(scope="module")
def double_pendulum():
    return ss.compile(ss.systems.double_pendulum(), "simpson")


@pytest.fixture(scope="module")
def costs():
    """A cost of each kind, with velocities, momenta, parameters and the time in them."""
    q1, q2 = ss.systems.double_pendulum().coordinates
    data = np.where(np.arange(7) % 3, 0.3, np.nan)
    return {
        "cost": sp.cos(q1) * q2.diff() ** 2 + sp.Symbol("p_q1"),
        "running": q1**2 + q2.diff() ** 2 * sp.cos(ss.time),
        "samples": {q2: np.linspace(0.2, 1, 7), "v_q1*l1": data},
        "every": 10,
    }


@pytest.mark.parametrize("given", sweep(["p", "v"]))
def test_gradients_are_those_of_the_cost(double_pendulum, costs, given):
    def gradient(x):
        return double_pendulum.gradient(
            x[:2],
            **{f"{given}0": x[2:4]},
            parameters={"l1": x[4], "g": x[5]},
            h=H,
            steps=STEPS,
            wrt=("q", given, "l1", "g"),
            **costs,
        )

    x = np.array([0.8, 1.0, 0.1, -0.2, 0.25, 9.81])
    found = gradient(x)
    truth = differences(lambda x: gradient(x).value, x)
    assert np.abs(found.gradient - truth).max() < 1e-7 * np.abs(truth).max()
    assert list(found.parts) == ["q", given, "l1", "g"]


@pytest.mark.slow
def test_runs_that_are_taken_again_have_the_same_gradient(double_pendulum, costs, monkeypatch):
    def gradient():
        return double_pendulum.gradient(
            [0.8, 1.0], v0=[0.1, -0.2], h=H, steps=STEPS, wrt=("q", "v", "l1"), **costs
        )

    whole = gradient()
    calls = []
    advance = Run.advance
    monkeypatch.setattr(
        Run, "advance", lambda run, stop: (calls.append(stop), advance(run, stop))[1]
    )
    monkeypatch.setattr(gradients, "MOST_RECORDED", 100)
    again = gradient()
    assert calls[:9] == [7, 14, 21, 28, 35, 42, 49, 56, 60]  # there, in pieces of sqrt(60)
    assert calls[9:] == [56, 49, 42, 35, 28, 21, 14, 7]  # and all but the last once more
    assert np.abs(again.gradient - whole.gradient).max() < 1e-14 * np.abs(whole.gradient).max()
    assert np.array_equal(again.gradient[:2], whole.gradient[:2])


def carts(scheme):
    x, a = ss.coordinates("x a")
    u, w, k, c = sp.symbols("u w k c", positive=True)
    cart = ss.MechanicalSystem(
        "cart",
        coordinates=(x, a),
        parameters={k: 2.0, c: 0.1},
        kinetic=((1 + sp.cos(a) ** 2) * x.diff() ** 2 + a.diff() ** 2 + x.diff() * a.diff()) / 2,
        potential=k * sp.cos(a),
        forces={x: u - c * x.diff() ** 3, a: w * x},
        inputs=(u, w),
    )
    return ss.compile(cart, scheme), {"running": (x - sp.sin(ss.time)) ** 2 + u**2, "cost": a**2}


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4", "lobatto6", "midpoint"], 1))
def test_gradients_by_inputs_have_the_shape_of_the_inputs(scheme):
    stepper, costs = carts(scheme)
    nodes, steps = len(stepper.node_times(0.1, 1)[0]), 8
    rng = np.random.default_rng(5)
    shapes = [(), (steps,), (steps, 1), (steps, nodes)]
    pairs = [*zip(shapes, reversed(shapes), strict=True), ((steps, 1), (steps, nodes))]
    for shape, other in pairs:
        given = {"u": rng.normal(size=shape), "w": rng.normal(size=other)}

        def gradient(given, wrt=("u", "k")):
            return stepper.gradient(
                [0.1, 0.2], v0=[0, 1], h=0.1, steps=steps, inputs=given, wrt=wrt, **costs
            )

        found = gradient(given)
        truth = differences(lambda u: gradient({**given, "u": u}).value, given["u"])  # noqa: B023
        assert found.parts["u"].shape == shape
        assert np.abs(found.parts["u"] - truth).max() < 1e-8
        assert found.gradient.shape == (truth.size + 1,)


@pytest.mark.slow
def test_gradients_by_samples_of_inputs_that_are_held_for_a_period():
    stepper, costs = carts("simpson")

    def gradient(values):
        return stepper.gradient(
            [0.1, 0.2],
            v0=[0, 1],
            h=0.1,
            steps=8,
            wrt="u",
            **costs,
            inputs={"u": ss.samples(values, period=0.3), "w": 1.0},
        )

    values = np.array([0.5, -1.0, 2.0, 7.0])  # the last is never reached
    truth = differences(lambda u: gradient(u).value, values)
    found = gradient(values)
    assert np.abs(found.parts["u"] - truth).max() < 1e-8
    assert found.parts["u"][3] == 0


@pytest.mark.parametrize(
    ("name", "scheme"),
    sweep(
        [
            ("damped_oscillator", "simpson"),
            ("heavy_top", "gauss6"),
            ("lagrange_top", "simpson"),
            ("fermi_pasta_ulam", "gauss4"),
            ("kepler", "lobatto6"),
            ("double_pendulum", "gauss8"),
        ],
        0,
    ),
)
def test_the_adjoint_is_the_transpose_of_the_tangent(name, scheme):
    """On reduced paths, written out and by loops."""
    stepper = ss.compile(getattr(ss.systems, name)(), scheme)
    state = dict(getattr(ss.systems, name)().reference_state)
    q0, n = state.pop("q0"), stepper.n
    varied = stepper.parameters[:1]
    run = stepper.integrate(q0, **state, h=H, steps=30, tangents=2 * n, sensitivities=varied)
    weights = np.random.default_rng(1).normal(size=2 * n)
    names = [*stepper.coordinates, *(f"p_{q}" for q in stepper.coordinates)]
    cost = "+".join(f"({float(w)!r})*{x}" for w, x in zip(weights, names, strict=True))
    wrt = ("q", "v" if "v0" in state else "p", *varied)
    found = stepper.gradient(q0, **state, h=H, steps=30, cost=cost, wrt=wrt)
    truth = weights @ run.tangent[-1]
    of_parameter = weights @ run.sensitivity[varied[0]][-1]
    scale = np.abs(truth).max() + abs(of_parameter)
    assert abs(found.parts[varied[0]] - of_parameter) < 1e-13 * scale
    if "p0" in state:
        assert np.abs(found.gradient[: 2 * n] - truth).max() < 1e-13 * scale


@pytest.mark.plain
@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4"]))
def test_derivatives_by_loops_in_bands(scheme, monkeypatch):
    """They are those of straight lines, and the adjoint is the transpose of the tangent."""
    system = swinging_chain(*sp.symbols("m k", positive=True))
    z = np.random.default_rng(2).normal(size=12) / 2
    given = {"p0": z[6:], "h": 0.05, "steps": 2, "tangents": 12, "sensitivities": ("m", "k")}
    straight = ss.compile(system, scheme).integrate(z[:6], **given)
    limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    stepper = ss.compile(system, scheme, exploit=("sparse",))
    assert "BAND = 1\n" in stepper.source
    run = stepper.integrate(z[:6], **given)
    assert np.abs(run.tangent - straight.tangent).max() < 1e-12
    for name, found in run.sensitivity.items():
        assert np.abs(found - straight.sensitivity[name]).max() < 1e-12
    check_adjoint(stepper, z, 0.05, 2)


@pytest.mark.slow
def test_scipy_takes_a_gradient_and_products_with_the_hessian(double_pendulum):
    from scipy.optimize import minimize

    truth = double_pendulum.integrate(
        [0.8, 1.0], v0=[0, 0], h=H, steps=100, every=10, parameters={"l1": 0.3, "l2": 0.2}
    )
    samples = {"q1": truth["q1"], "q2": truth["q2"]}

    def objective(x):
        return double_pendulum.gradient(
            [0.8, 1.0],
            v0=[0, 0],
            h=H,
            steps=100,
            every=10,
            samples=samples,
            parameters={"l1": x[0], "l2": x[1]},
            wrt=("l1", "l2"),
        )

    found = minimize(
        objective,
        [0.28, 0.22],
        jac=True,
        method="trust-ncg",
        hessp=ss.hessian_product(objective),
        tol=1e-10,
    )
    assert np.abs(found.x - [0.3, 0.2]).max() < 1e-8


def test_a_run_in_many_digits_has_a_gradient():
    stepper = ss.compile(ss.systems.pendulum(), "midpoint", precision=25)
    values = []
    for angle in ("1", "1.0000000001"):
        found = stepper.gradient(
            [angle],
            v0=["0.3"],
            h="0.01",
            steps=3,
            cost="v_theta**2",
            wrt=("q", "l"),
            samples={"sin(theta)": [0, 0, 0, 0]},
        )
        values.append(found.value)
    assert abs((values[1] - values[0]) / 1e-10 - found.parts["q"][0]) < 1e-8


X, K = ss.coordinates("x")[0], sp.Symbol("k")
QUARTIC = ss.MechanicalSystem(
    "quartic",
    coordinates=(X,),
    kinetic=X.diff() ** 2 / 2,
    potential=K * X**2 / 2 + X**4 / 4,
    parameters={K: 1.0},
)
TIMED = ss.MechanicalSystem(
    "timed",
    coordinates=(X,),
    kinetic=(2 + sp.sin(ss.time)) * X.diff() ** 2 / 2,
    potential=K * X**2 / 2 + X * sp.sin(ss.time),
    parameters={K: 1.0},
)
IN_TIME = {
    "cost": {"cost": "v_x*t**2 + p_x"},
    "samples": {"samples": {"t*x": np.linspace(0, 1, 5)}, "every": 5},
    "running": {"running": ss.time * X**2},
}


@pytest.mark.parametrize("cost", IN_TIME)
@pytest.mark.parametrize(("system", "by"), [(QUARTIC, "h"), (QUARTIC, "t"), (TIMED, "t")])
def test_costs_in_which_the_time_stands(system, by, cost):
    """With h and the start the times of states are varied, too."""
    stepper = ss.compile(system, "gauss4")

    def gradient(move=0.0):
        given = {"h": 0.05 + move * (by == "h"), "t0": 0.3 + move * (by == "t")}
        return stepper.gradient([0.7], [0.2], **given, steps=20, wrt=by, **IN_TIME[cost])

    if (by, cost) == ("h", "running"):
        with pytest.raises(ss.InputError, match="running= contains the time"):
            gradient()
        return
    slope = differences(lambda move: gradient(float(move)).value, np.float64(0.0))
    np.testing.assert_allclose(gradient().parts[by], slope, rtol=1e-8)


def test_the_state_may_be_named_as_it_is_given():
    given = {"h": 0.05, "steps": 10, "cost": "x**2"}
    stepper = ss.compile(QUARTIC)
    found = stepper.gradient([0.7], [0.2], **given, wrt=("q0", "k", "v0"))
    short = stepper.gradient([0.7], [0.2], **given, wrt=("q", "k", "v"))
    assert list(found.parts) == ["q0", "k", "v0"]
    assert (found.gradient == short.gradient).all()
    with pytest.raises(ss.InputError, match="wrt contains 'p', but the run starts with v0"):
        stepper.gradient([0.7], [0.2], **given, wrt="p0")
    with pytest.raises(ss.InputError, match="Pass each variable once"):
        stepper.gradient([0.7], [0.2], **given, wrt=("q", "q0"))


def test_symbols_of_parameters_are_not_the_state():
    v = sp.Symbol("v")
    belt = ss.MechanicalSystem(
        "belt",
        coordinates=(X,),
        kinetic=X.diff() ** 2 / 2,
        potential=v * X**2 / 2,
        parameters={v: 1.0},
    )
    stepper, given = ss.compile(belt), {"h": 0.05, "steps": 10, "cost": "x**2"}
    by_start = stepper.gradient([0.7], [0.2], **given, wrt="v").parts["v"]
    by_symbol = stepper.gradient([0.7], [0.2], **given, wrt=v).parts["v"]

    def at(value):
        return stepper.gradient([0.7], [0.2], **given, wrt="q", parameters={v: value}).value

    assert by_start.shape == (1,)
    assert by_symbol == pytest.approx((at(1.001) - at(0.999)) / 0.002, rel=1e-5)
    by_name = stepper.tangent([0.7], [0.2], h=0.05, wrt=("q", v))[2]
    assert by_name.shape == (2, 2)
    assert abs(by_name[1, 1] + 0.05 * 0.7) < 1e-3
    with pytest.raises(ss.InputError, match="in a separate call"):
        stepper.gradient([0.7], [0.2], **given, wrt=("v", v))


@pytest.mark.slow
def test_what_a_gradient_cannot_be_of_is_refused(double_pendulum):
    import pandas as pd

    def gradient(**changed):
        given = {"v0": [0, 0], "h": H, "steps": 10, "cost": "q1", "wrt": "l1", **changed}
        return double_pendulum.gradient([0.8, 1.0], **given)

    for match, changed in {
        "there is no cost": {"cost": None},
        "wrt is empty": {"wrt": ()},
        "run starts with v0": {"wrt": ("q", "p")},
        "Pass each variable once": {"wrt": ("q", "q")},
        "no parameter or input 'l3'": {"wrt": ("l3",)},
        "contains the energy": {"cost": "energy"},
        "unknown name|contains 'x'": {"cost": "x + 1"},
        "must have shape \\(11,\\)": {"samples": {"q1": [1, 2]}},
        "contain no finite number": {"samples": {"q1": [np.nan] * 11}},
        "samples is a ndarray": {"samples": np.zeros(11), "cost": None},
        "samples is a GreaterThan": {"samples": sp.Symbol("x") >= 0, "cost": None},
        "running is a Series": {"running": pd.Series([1, 2])},
    }.items():
        with pytest.raises(ss.InputError, match=match):
            gradient(**changed)
    with pytest.raises(ss.ModelError, match="running cost"):
        gradient(running=sp.Symbol("x"))
    with pytest.raises(ss.SchemeError, match="no derivatives"):
        ss.compile(ss.systems.henon_heiles(), "kahan_li6").gradient(
            [0, 0.1], v0=[0.4, 0], h=H, steps=10, cost="x", wrt="q"
        )
    with pytest.warns(ss.StabilityWarning), pytest.raises(ss.ConvergenceError):
        gradient(h=5.0)


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "gauss8"], 1))
def test_gradients_by_the_initial_state_alone(scheme):
    stepper = ss.compile(ss.systems.pendulum(), scheme)
    start = {"h": 0.01, "steps": 50}
    x = np.array([1.0, 0.2])

    def value(z):
        return stepper.integrate(z[:1], v0=z[1:], **start).q[-1, 0] ** 2

    for names, part in ((("q",), slice(0, 1)), ("v", slice(1, 2)), (["q", "v"], slice(0, 2))):
        found = stepper.gradient(x[:1], v0=x[1:], **start, cost="theta**2", wrt=names)
        assert found.gradient == pytest.approx(differences(value, x)[part], rel=1e-9)


@pytest.mark.slow
def test_the_slope_of_a_rest_is_that_of_what_is_divided(double_pendulum):
    """But where it jumps: Mod(a, b) is a - b floor(a/b)."""
    q1, _ = ss.systems.double_pendulum().coordinates
    given = {"v0": [0.5, 1.0], "h": H, "steps": STEPS, "wrt": ("q", "l1")}
    for rest, plain in (
        (sp.Mod(3 * q1, 2) ** 2, lambda q: (3 * q - 2 * np.floor(1.5 * q), 3)),
        ("(-q1 % 0.3)**2", lambda q: (-q - 0.3 * np.floor(-q / 0.3), -1)),
    ):
        found = double_pendulum.gradient([1.0, 2.0], **given, cost=rest)
        of_q = double_pendulum.gradient([1.0, 2.0], **given, cost=q1)
        value, slope = plain(of_q.value)
        assert found.value == pytest.approx(value**2, rel=1e-12)
        assert found.gradient == pytest.approx(2 * value * slope * of_q.gradient, rel=1e-12)
