"""Inputs at run time: what they may be, and that every way to take steps takes the same ones."""

import math

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.stepping.driving import interpolate_inputs

H, STEPS = 0.02, 60
START = {"q0": [0.0, 0.1], "v0": [0.0, 0.0]}
rng = np.random.default_rng(3)
HELD = rng.normal(size=STEPS)


def driven_chain():
    """Inputs on a system so large that its steps are loops."""
    q = ss.coordinates(" ".join(f"x{i}" for i in range(12)))
    u, w = sp.symbols("u w")
    kinetic = sum((2 + sp.sin(x)) * x.diff() ** 2 for x in q) / 4
    potential = sum((a - b) ** 2 + (a - b) ** 4 / 3 for a, b in zip(q[1:], q, strict=False))
    return ss.MechanicalSystem(
        "driven_chain",
        coordinates=q,
        kinetic=kinetic,
        potential=potential + q[0] ** 2,
        forces={"first": {q[0]: u - q[0].diff()}, "last": {q[-1]: w * q[-1] - u * q[-1].diff()}},
        inputs=(u, w),
    )


def stepper(scheme="simpson", **options):
    return ss.compile(ss.systems.driven_cart_pole(), scheme, **options)


def at_nodes(made, h=H, steps=STEPS):
    return np.sin(3 * made.node_times(h, steps))


def test_inputs_that_are_held_are_not_rounded_between_nodes():
    program = ss.compile(driven_chain(), "gauss6").program
    values, at = rng.normal(size=(1, 4, 1, 2)), rng.uniform(0, 1, (4, 5))
    found = interpolate_inputs(program, np.repeat(values, 3, axis=2), np.arange(4), at)
    assert (found == values).all()


def test_node_times():
    times = stepper("gauss6").node_times(0.1, 3, t0=2.0)
    assert times.shape == (3, 3)
    c = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
    assert np.abs(times - (2 + 0.1 * (np.arange(3)[:, None] + c))).max() < 1e-15
    precise = stepper("gauss6", precision=40).node_times("0.1", 1)
    assert abs(precise[0, 0] - (sp.Rational(1, 2) - sp.sqrt(15) / 10).n(45) / 10) < 1e-40
    with pytest.raises(ss.InputError, match="has no inputs"):
        ss.compile(ss.systems.pendulum()).node_times(0.1, 3)


def cart(*names):
    (x,), u = ss.coordinates("x"), sp.symbols(names)
    force = {"forces": {x: sum(u)}, "inputs": tuple(u)}
    return ss.MechanicalSystem(
        "cart", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0 * x, **force
    )


def test_functions_of_time_are_evaluated_at_the_nodes():
    """In one call, or one by one if they take single numbers."""
    made, k = ss.compile(cart("u"), "gauss4"), {"v0": [0.0], "h": 0.1, "t0": 2.0}
    values = np.sin(made.node_times(0.1, 4, 2.0))
    right = made.integrate([0.0], **k, steps=4, inputs={"u": values}).q[-1]
    for given in ({"u": np.sin}, {"u": math.sin}, np.sin):
        assert (made.integrate([0.0], **k, steps=4, inputs=given).q[-1] == right).all()
    short = made.integrate([0.0], v0=[0.0], h=0.15, t0=2.0, t_end=2.4, inputs={"u": np.sin})
    assert (short.steps, short.q[-1]) == (3, pytest.approx(right, abs=1e-5))
    members = made.ensemble([[0.0], [1.0]], **k, steps=4, inputs={"u": math.sin})
    assert np.abs(members.q[:, 0] - [0, 1] - right).max() < 1e-15
    loop = made.start([0.0], **k)
    for _ in range(4):
        loop.step(np.sin)
    assert abs(loop.q - right) < 1e-15


@pytest.mark.slow
def test_functions_beside_numbers_and_their_slopes():
    both, k = ss.compile(cart("u", "w"), "gauss4"), {"v0": [0.0], "h": 0.1, "t0": 2.0}
    mixed = both.integrate([0.0], **k, steps=4, inputs={"u": lambda t: 1 if t < 2.2 else 0, "w": 0})
    assert mixed["v_x"][-1] == pytest.approx(0.2, abs=1e-15)
    given = {"u": np.sin, "w": 1.0}
    slopes = both.gradient([0.0], **k, steps=4, inputs=given, cost="x", wrt=("u", "w"))
    assert slopes.parts["u"].shape == (4, 2)
    assert slopes.parts["u"].sum() == pytest.approx(slopes.parts["w"], rel=1e-12)


def test_functions_that_give_no_numbers():
    made, k = ss.compile(cart("u")), {"v0": [0.0], "h": 0.1, "steps": 3}
    for wrong, told in (
        (lambda t: np.array([t]).ravel()[:1], r"input u: its function returns shape \(1,\)"),
        (lambda t: None, "input u is .*not real numbers"),
        (lambda t: math.nan, "input u is nan at u"),
    ):
        with pytest.raises(ss.InputError, match=f"(?s){told}"):
            made.integrate([0.0], **k, inputs={"u": wrong})
    with pytest.raises(ZeroDivisionError) as caught:
        made.integrate([0.0], **k, inputs={"u": lambda t: 1 / 0})
    assert caught.value.__notes__ == [
        "The function that is passed as input u raised this at t=0.0."
    ]
    with pytest.raises(
        ss.InputError, match=r"change the times.\nPass the values instead: f\(stepper.node_t"
    ):
        made.gradient([0.0], **k, inputs={"u": np.sin}, cost="x", wrt="h")


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8", "radau3", "midpoint"]))
@pytest.mark.parametrize("form", ["held", "nodes"])
def test_calls_of_step_are_one_run_to_the_bit(scheme, form):
    made = stepper(scheme)
    given = HELD if form == "held" else at_nodes(made)
    run = made.integrate(**START, h=H, steps=STEPS, inputs={"u": given})
    loop = made.start(**START, h=H)
    for j in range(STEPS):
        loop.step(given[j] if form == "held" else given[j][:, None])
        assert (loop.q == run.q[j + 1]).all()
        assert (loop.p == run.p[j + 1]).all()
    assert loop.t == run.t[-1]
    assert (loop.v == run.v[-1]).all()
    assert loop.steps == STEPS
    # and a step by itself, but for what compensated sums carry along
    q1, _ = made.step(run.q[9], p=run.p[9], h=H, t=run.t[9], inputs={"u": given[9]})
    assert np.abs(q1 - run.q[10]).max() < 1e-14


@pytest.mark.slow
@pytest.mark.plain
def test_loops_over_terms_take_the_same_inputs_as_straight_lines():
    system = driven_chain()
    inputs = {"u": rng.normal(size=(20, 3)), "w": rng.normal(size=20)}
    state = {"q0": np.linspace(0, 1, 12), "v0": np.zeros(12)}
    looped = ss.compile(system, "simpson")
    assert not looped.program.header.unrolled
    run = looped.integrate(**state, h=0.05, steps=20, inputs=inputs)
    precise = ss.compile(system, "simpson", precision=30)
    exact = precise.integrate(
        **state, h=0.05, steps=2, inputs={k: x[:2] for k, x in inputs.items()}
    )
    assert np.abs((run.q[2] - exact.q[2]).astype(float)).max() < 1e-15
    assert np.abs(run.energy_balance).max() < 1e-3

    def smooth(scheme):
        made = ss.compile(system, scheme)
        times = made.node_times(0.05, 20)
        driven = {"u": np.sin(times), "w": np.cos(2 * times)}
        return made.integrate(**state, h=0.05, steps=20, inputs=driven).q[-1]

    assert np.abs(smooth("gauss8") - smooth("gauss12")).max() < 1e-11
    assert np.abs(smooth("simpson") - smooth("gauss12")).max() < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["blanes_moan4", "suzuki4", "kahan_li6"], 1))
def test_kicks_take_inputs_where_they_stand(scheme):
    x, y = ss.coordinates("x y")
    u = sp.Symbol("u")
    system = ss.MechanicalSystem(
        "kicked",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=x**2 * y + x**4 / 4 + y**2,
        forces={x: u * sp.cos(y)},
        inputs=(u,),
    )
    made, state = ss.compile(system, scheme), {"q0": [0.5, 0.2], "v0": [0.1, 0.0]}

    def error(count):
        times = made.node_times(2 / count, count)
        run = made.integrate(**state, h=2 / count, steps=count, inputs={"u": np.sin(2 * times)})
        return np.abs(run.q[-1] - exact).max()

    fine = ss.compile(system, "gauss12")
    times = fine.node_times(0.05, 40)
    exact = fine.integrate(**state, h=0.05, steps=40, inputs={"u": np.sin(2 * times)}).q[-1]
    order = np.log2(error(20) / error(40))
    assert abs(order - made.order) < 0.3
    held = made.integrate(**state, h=0.1, steps=20, inputs={"u": HELD[:20]})
    loop = made.start(**state, h=0.1)
    for value in HELD[:20]:
        loop.step(value)
    assert (loop.q == held.q[-1]).all()


@pytest.mark.slow
def test_loops_over_kicks_take_inputs_where_they_stand():
    q = ss.coordinates(" ".join(f"x{i}" for i in range(20)))
    u = sp.Symbol("u")
    bends = [a - b for a, b in zip(q[1:], q, strict=False)]
    system = ss.MechanicalSystem(
        "kicked_chain",
        coordinates=q,
        kinetic=sum(x.diff() ** 2 for x in q) / 2,
        potential=sum(x**2 / 2 + x**4 / 4 for x in bends),
        forces={q[0]: u, q[3]: -u * q[3]},
        inputs=(u,),
    )
    state = {"q0": np.sin(np.arange(20.0)), "v0": np.zeros(20)}

    def end(scheme, steps):
        made = ss.compile(system, scheme)
        inputs = {"u": np.sin(3 * made.node_times(1 / steps, steps))}
        return made.integrate(**state, h=1 / steps, steps=steps, inputs=inputs).q[-1]

    assert not ss.compile(system, "kahan_li8").program.header.unrolled
    assert np.abs(end("kahan_li8", 20) - end("gauss8", 20)).max() < 1e-9


@pytest.mark.slow
def test_ensembles_give_each_member_its_inputs():
    made = stepper()
    own = rng.normal(size=(11, STEPS))
    found = made.ensemble(**START, h=H, steps=STEPS, inputs={"u": own})
    shared = made.ensemble(
        np.tile(START["q0"], (11, 1)),
        v0=START["v0"],
        h=H,
        steps=STEPS,
        inputs=HELD[:, None],
        every=STEPS,
    )
    for k in range(11):
        run = made.integrate(**START, h=H, steps=STEPS, inputs={"u": own[k]})
        assert (found.q[k] == run.q[-1]).all()
    alone = made.integrate(**START, h=H, steps=STEPS, inputs={"u": HELD})
    assert (shared.q[:, -1] == alone.q[-1]).all()


@pytest.mark.slow
def test_states_between_steps_have_the_inputs_of_their_step():
    made = stepper("gauss8")
    run = made.integrate(**START, h=H, steps=STEPS, inputs={"u": HELD}, every=4)
    fine = made.integrate(**START, h=H / 4, steps=4 * STEPS, inputs={"u": np.repeat(HELD, 4)})
    places = np.array([1, 7, 16, 50, 239])
    assert np.abs(run.at(places * H / 4).q - fine.q[places]).max() < 1e-13
    smooth = made.integrate(**START, h=H, steps=STEPS, inputs={"u": at_nodes(made)}, every=4)
    finer = made.integrate(
        **START, h=H / 4, steps=4 * STEPS, inputs={"u": at_nodes(made, H / 4, 4 * STEPS)}
    )
    assert np.abs(smooth.at(places * H / 4).q - finer.q[places]).max() < 1e-12
    # at the start of a step, outside of its nodes, a cubic polynomial stands for the input
    assert np.abs(smooth.power["motor"] - finer.power["motor"][::16]).max() < (3 * H) ** 4 / 24
    assert np.abs(smooth.energy_balance).max() < 1e-13


@pytest.mark.slow
def test_work_of_an_input_is_counted_with_its_own_values():
    run = stepper("gauss8").integrate(**START, h=H, steps=STEPS, inputs={"u": HELD})
    done = np.concatenate([[0.0], np.cumsum(HELD * np.diff(run["x"]))])  # u dx, u held
    assert np.abs(run.work["motor"] - done).max() < 1e-13
    assert (run.inputs["u"] == HELD).all()
    assert np.abs(run.power["motor"][:-1] - HELD * run["v_x"][:-1]).max() < 1e-14


@pytest.mark.parametrize("period", [1e9, 1e300, 2**70])
def test_samples_may_be_held_for_longer_than_the_run(period):
    made = stepper()
    held = {"u": ss.samples([0.3, 0.4], period=period)}
    run = made.integrate(**START, h=H, steps=STEPS, inputs=held)
    other = made.integrate(**START, h=H, steps=STEPS, inputs={"u": 0.3})
    assert (run.q == other.q).all()
    slope = made.gradient(**START, h=H, steps=STEPS, inputs=held, cost="x", wrt="u").parts["u"]
    assert slope[0] != 0


def test_samples_are_held_for_their_period():
    made = stepper()
    given = {"u": ss.samples(HELD[:15], period=4 * H)}
    run = made.integrate(**START, h=H, steps=STEPS, inputs=given)
    other = made.integrate(**START, h=H, steps=STEPS, inputs={"u": np.repeat(HELD[:15], 4)})
    assert (run.q == other.q).all()


@pytest.mark.slow
def test_held_inputs_lose_no_order_and_those_of_a_formula_do():
    """Held values of a smooth input are of order 1, its values at nodes of that of the scheme."""
    made = stepper("lobatto6")

    def runs(count):
        h = 1.2 / count
        times = made.node_times(h, count)
        steps = np.repeat(HELD[:6], count // 6)
        for given in (np.sin(3 * times), np.sin(3 * times[:, 0]), steps):
            yield made.integrate(**START, h=h, steps=count, inputs={"u": given}, every=None).q[0]

    few, more, most = (list(runs(count)) for count in (24, 48, 384))
    orders = []
    for a, b, c in zip(few, more, most, strict=True):
        orders.append(np.log2(np.abs(a - c).max() / np.abs(b - c).max()))
    assert abs(orders[0] - 6) < 0.3
    assert orders[1] < 1.4
    assert abs(orders[2] - 6) < 0.4


@pytest.mark.slow
def test_checkpoints_and_files_keep_runs_with_inputs(tmp_path):
    made, inputs = stepper(), {"u": HELD}
    file = tmp_path / "run.ckpt"
    run = made.integrate(**START, h=H, steps=STEPS, inputs=inputs, checkpoint=file)
    assert (ss.resume(file, inputs=inputs).q == run.q).all()
    with pytest.raises(ss.InputError, match="the input u has no values"):
        ss.resume(file)
    with pytest.raises(ss.InputError, match="contains a run with other inputs"):
        ss.resume(file, inputs={"u": 2 * HELD})
    run.save(tmp_path / "run.nc")
    again = ss.open_trajectory(tmp_path / "run.nc")
    assert (again.at([0.311]).q == run.at([0.311]).q).all()
    assert (again.work["motor"] == run.work["motor"]).all()
    stored = made.ensemble(
        **START, h=H, steps=STEPS, store=tmp_path / "some", inputs={"u": np.stack([HELD, -HELD])}
    )
    assert (stored.q[0] == run.q[-1]).all()
    with pytest.raises(ss.InputError, match="contains another ensemble: inputs differ"):
        made.ensemble(
            **START, h=H, steps=STEPS, store=tmp_path / "some", inputs={"u": np.stack([HELD, HELD])}
        )


def test_events_and_sections_take_inputs():
    made, inputs = stepper(), {"u": HELD}
    run = made.integrate(**START, h=H, steps=STEPS, inputs=inputs)
    section = made.poincare("v_theta", **START, h=H, steps=STEPS, inputs=inputs)
    assert len(section) > 0
    assert (section.t == run.events("v_theta").t).all()


@pytest.mark.slow
def test_certificates_hold_inputs():
    assert stepper().certify(inputs={"u": 2.0}).passed
    with pytest.raises(ss.InputError, match="no input 'w'"):
        stepper().certify(inputs={"w": 2.0})


WRONG = {
    "missing": (None, "the input u has no values"),
    "another": ({"w": HELD}, "there is no input 'w'"),
    "short": ({"u": HELD[:-1]}, r"shape \(59,\)\. The run has 60 steps of 3 nodes"),
    "members": ({"u": np.zeros((5, STEPS))}, r"shape \(5, 60\)"),
    "not a number": ({"u": np.where(np.arange(STEPS) == 7, np.nan, HELD)}, r"u\[7\]"),
    "text": ({"u": "fast"}, "not real numbers"),
    "period": ({"u": ss.samples(HELD, period=0.05)}, r"2.5 steps of h=0.02(.|\n)*h=0.0166"),
    "few samples": (
        {"u": ss.samples(HELD[:3], period=0.1)},
        r"shape \(15,\) after conversion of samples",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_message(name):
    given, message = WRONG[name]
    with pytest.raises(ss.InputError, match=message):
        stepper().integrate(**START, h=H, steps=STEPS, inputs=given)


def test_other_messages():
    free = ss.compile(ss.systems.pendulum())
    with pytest.raises(ss.InputError, match="pendulum: the system has no inputs"):
        free.integrate([1.0], v0=[0.0], h=0.1, steps=3, inputs={"u": HELD})
    with pytest.raises(ss.InputError, match="different numbers of members"):
        ss.compile(driven_chain()).ensemble(
            np.zeros(12),
            v0=np.zeros(12),
            h=0.1,
            steps=10,
            inputs={"u": np.zeros((3, 10)), "w": np.zeros((2, 10))},
        )
    with pytest.raises(ss.InputError, match="last axis must have length 2: u, w"):
        ss.compile(driven_chain()).start(np.zeros(12), v0=np.zeros(12), h=0.1).step(np.zeros(3))
    with pytest.raises(ss.InputError, match="may mean"):
        stepper().ensemble(np.zeros((3, 2)), v0=[0.0, 0.0], h=0.1, steps=3, inputs=np.zeros((3, 3)))
    with pytest.raises(ss.InputError, match=r"input u has no values\. Its"):
        ss.choose(ss.systems.driven_cart_pole(), [0.0, 0.1], v0=[0.0, 0.0], t_end=1.0, error=1e-6)
    loop = stepper().start(**START, h=H)
    with pytest.raises(ss.InputError, match=r"needs values for the inputs u.*\n.*loop\.step\(u\)"):
        loop.step()
    with pytest.raises(ss.InputError, match="not finite"):
        loop.step(np.nan)
    assert loop.steps == 0


@pytest.mark.slow
def test_a_loop_that_fails_stays_where_it_was():
    loop = stepper().start(**START, h=H)
    loop.step(1.0)
    before = loop.q
    with pytest.raises(ss.ConvergenceError, match=r"step 1 of 2 at t=0\.02") as caught:
        loop.step(1e300)
    assert caught.value.step == 1
    assert (loop.q == before).all()
