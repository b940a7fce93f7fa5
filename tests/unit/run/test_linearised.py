"""The steps of a run as linear maps: by the state, by parameters, by inputs at nodes."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.errors import InputError

(x, theta), u = ss.coordinates("x theta"), sp.Symbol("u")
mass = sp.Symbol("m", positive=True)
CART = ss.MechanicalSystem(
    "driven_cart",
    coordinates=(x, theta),
    kinetic=mass * x.diff() ** 2
    + theta.diff() ** 2 / 2
    + x.diff() * theta.diff() * sp.cos(theta) / 2,
    potential=-sp.cos(theta),
    parameters={mass: 1.0},
    inputs=(u,),
    forces={"push": {x: u}, "drag": {theta: -theta.diff() / 5}},
)
START = {"q0": [0.1, 0.4], "p0": [0.2, -0.1], "h": 0.05}


@pytest.fixture(scope="module")
def cart():
    return ss.compile(CART, "simpson")


def test_they_are_the_derivatives_of_single_steps(cart):
    values = np.random.default_rng(0).normal(size=(6, 3))
    found = cart.linearise(**START, steps=6, wrt=("u", "m"), inputs={"u": values})
    assert found.by_state.shape == (6, 4, 4)
    assert found.by_input["u"].shape == (6, 4, 3)
    for k in range(6):
        q1, p1, D = cart.tangent(
            found.q[k],
            p=found.p[k],
            h=0.05,
            t=found.t[k],
            wrt=("q", "p", "u", "m"),
            inputs={"u": values[k]},
        )
        assert D[:, :4] == pytest.approx(found.by_state[k], abs=1e-15)
        assert D[:, 4] == pytest.approx(found.by_input["u"][k].sum(axis=1), abs=1e-16)
        assert D[:, 5] == pytest.approx(found.by_parameter["m"][k], abs=1e-16)
        assert np.r_[q1, p1] == pytest.approx(np.r_[found.q[k + 1], found.p[k + 1]], abs=1e-15)


def test_inputs_at_nodes_move_the_end_as_they_say(cart):
    values = np.array([[0.3, -0.2, 0.7]])
    found = cart.linearise(**START, steps=1, wrt="u", inputs={"u": values}).by_input["u"][0]
    for node in range(3):
        ends = []
        for change in (1e-4, -1e-4):
            moved = values.copy()
            moved[0, node] += change
            run = cart.integrate(**START, steps=1, inputs={"u": moved})
            ends.append(np.r_[run.q[-1], run.p[-1]])
        assert (ends[0] - ends[1]) / 2e-4 == pytest.approx(found[:, node], abs=1e-10)


@pytest.mark.slow
def test_a_run_is_the_product_of_its_steps():
    stepper = ss.compile(ss.systems.double_pendulum(), "gauss8")
    found = stepper.linearise([0.8, 1.0], p0=[0.05, 0], h=0.05, steps=4)
    run = stepper.integrate([0.8, 1.0], p0=[0.05, 0], h=0.05, steps=4, tangents=4)
    whole = np.linalg.multi_dot(found.by_state[::-1])
    assert np.abs(whole - run.tangent[-1]).max() < 1e-11
    assert np.array_equal(found.q, run.q)


def test_constraints_and_their_projection_are_in_it():
    stepper = ss.compile(ss.systems.cartesian_pendulum(), "simpson")
    state = ss.systems.cartesian_pendulum().reference_state
    found = stepper.linearise(**state, h=0.05, steps=3)
    *_, D = stepper.tangent(found.q[1], p=found.p[1], h=0.05)
    assert np.abs(D - found.by_state[1]).max() < 1e-13


@pytest.mark.slow
def test_it_has_many_digits():
    stepper = ss.compile(CART, "simpson", precision=40)
    found = stepper.linearise(**START, steps=2, wrt="u", inputs={"u": 0.25})
    J = np.kron([[0, 1], [-1, 0]], np.eye(2))
    free = ss.compile(ss.systems.double_pendulum(), "simpson", precision=40)
    A = free.linearise([0.3, 0.2], p0=[0, 0], h=0.1, steps=1).by_state[0]
    assert abs(A.T @ J @ A - J).max() < 1e-37
    assert found.by_input["u"].dtype == object


def test_what_cannot_be_done_is_said(cart):
    with pytest.raises(InputError, match="no parameter or input 'w'"):
        cart.linearise(**START, steps=2, wrt="w")
    retimed = ss.compile(ss.systems.kepler().retimed("encounters"))
    with pytest.raises(InputError, match="linearisations do not support a time transf"):
        retimed.linearise([1.0, 0.0], v0=[0.0, 1.0], h=0.1, steps=2)


SHAKEN = ss.MechanicalSystem(
    "shaken_cart",
    coordinates=(x, theta),
    kinetic=CART.kinetic + x.diff() * x * sp.sin(ss.time),
    potential=CART.potential + sp.cos(2 * ss.time) * x**3,
    parameters={mass: 1.25},
    inputs=(u,),
    forces=CART.forces,
)


@pytest.mark.parametrize(
    ("system", "scheme"),
    sweep(
        [
            (SHAKEN, "simpson"),
            (ss.systems.cartesian_pendulum(), "simpson"),
            (ss.systems.damped_pendulum(), "gauss4"),
            (SHAKEN, "midpoint"),
        ]
    ),
)
def test_steps_are_differentiated_by_their_size_and_their_time(system, scheme):
    stepper = ss.compile(system, scheme)
    state = getattr(system, "reference_state", START)
    start = {key: state[key] for key in ("q0", "v0", "p0") if key in state}
    given = {"inputs": {"u": 0.4}} if system.inputs else {}
    # from a state that constraints allow
    run = stepper.integrate(**start, h=0.1, steps=1, **given)
    q, p = run.q[-1], run.p[-1]

    def end(h, t):
        return np.concatenate(stepper.tangent(q, p=p, h=h, t=t, **given)[:2])

    def slope(by_h, by_t):
        step = 1e-3
        ends = [end(0.1 + k * by_h * step, 0.5 + k * by_t * step) for k in (-2, -1, 1, 2)]
        return (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step)

    *_, D = stepper.tangent(q, p=p, h=0.1, t=0.5, wrt=("h", "t"), **given)
    found = stepper.linearise(q, p0=p, h=0.1, steps=1, t0=0.5, wrt=("h", "t"), **given)
    for k, (name, way) in enumerate((("h", (1, 0)), ("t", (0, 1)))):
        assert np.abs(D[:, k] - slope(*way)).max() < 1e-9
        assert np.abs(found.by_parameter[name][0] - D[:, k]).max() < 1e-14


def test_gradients_by_the_size_of_all_steps():
    stepper = ss.compile(ss.systems.double_pendulum())
    q1, q2 = ss.systems.double_pendulum().coordinates
    asked = {"p0": [0, 0], "steps": 50, "running": q1.diff() ** 2 * sp.cos(q2), "cost": "q1**2"}

    def gradient(h):
        return stepper.gradient([0.8, 1.0], **asked, h=h, wrt=("h",))

    difference = (gradient(0.02 + 1e-6).value - gradient(0.02 - 1e-6).value) / 2e-6
    assert gradient(0.02).parts["h"] == pytest.approx(difference, rel=1e-6)


@pytest.mark.plain
@pytest.mark.parametrize(
    ("system", "scheme"),
    sweep(
        [
            (ss.systems.cartesian_pendulum(), "gauss4"),
            (ss.systems.chaplygin_sleigh(), "simpson"),
            (ss.systems.rolling_disc(), "midpoint"),
        ]
    ),
)
def test_gradients_by_the_size_of_steps_with_constraints(system, scheme):
    stepper, state = ss.compile(system, scheme), dict(system.reference_state)
    start = stepper.integrate(**state, h=0.1, steps=1)
    names = [*stepper.coordinates, *(f"p_{q}" for q in stepper.coordinates)]
    cost = "+".join(f"{k + 1}*{name}" for k, name in enumerate(names))
    asked = {"steps": 3, "cost": cost, "running": system.coordinates[-1].diff() ** 2}

    def gradient(h):
        return stepper.gradient(start.q[1], p0=start.p[1], **asked, h=h, wrt=("h",))

    ends = [gradient(0.1 + k * 1e-3).value for k in (-2, -1, 1, 2)]
    slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / 12e-3
    assert gradient(0.1).parts["h"] == pytest.approx(slope, rel=1e-6)


def test_what_moves_the_times_of_a_run_is_refused():
    with pytest.raises(InputError, match="h moves the times of all steps"):
        ss.compile(SHAKEN).gradient(
            [0.2, 0.4], p0=[0, 0], h=0.1, steps=3, cost="x", wrt="h", inputs={"u": 0.1}
        )


def test_bands_take_coordinates_in_an_order_of_their_own():
    """A ring whose order is not its own inverse: one step by a parameter and by h."""
    q, k = ss.coordinates("q:17"), sp.Symbol("k", positive=True)
    ring = ss.MechanicalSystem(
        "ring",
        coordinates=q,
        kinetic=sum(a.diff() ** 2 for a in q) / 2,
        potential=k * sum((q[i] - q[i - 1]) ** 4 for i in range(17)) + k * q[5] ** 2,
        parameters={k: 1.2},
    )
    stepper, (q0, v0) = ss.compile(ring, "midpoint"), np.random.default_rng(2).normal(size=(2, 17))
    order = np.array(stepper.program.header.coordinate_order)
    assert (order[order] != np.arange(17)).any()
    maps = stepper.linearise(q0, v0=v0, h=0.05, steps=1, wrt=("k", "h"))

    def end(h=0.05, k=1.2):
        run = stepper.integrate(q0, p0=v0, h=h, steps=1, parameters={"k": k})
        return np.hstack([run.q[-1], run.p[-1]])

    d = 1e-6
    by_k = (end(k=1.2 + d) - end(k=1.2 - d)) / (2 * d)
    by_h = (end(h=0.05 + d) - end(h=0.05 - d)) / (2 * d)
    assert np.abs(maps.by_parameter["k"][0] - by_k).max() < 1e-6
    assert np.abs(maps.by_parameter["h"][0] - by_h).max() < 1e-6
