"""Problems of optimal control: derivatives of their programmes, outcomes, what is refused."""

import io
import pickle
import signal

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.control import check_derivatives

import symsimpson as ss

pytest.importorskip("casadi")

x, y = ss.coordinates("x y")
u, w = sp.symbols("u w", real=True)
m, k = sp.symbols("m k", positive=True)
#: Masses that move, friction, time, two inputs.
SYSTEM = ss.MechanicalSystem.from_lagrangian(
    "slide",
    m * (x.diff() ** 2 + (1 + x**2) * y.diff() ** 2) / 2
    + x.diff() * y / 5
    - k * (x**4 + y**2) / 2
    + x * sp.sin(3 * ss.time),
    (x, y),
    {m: 1.2, k: 2.0},
    forces={x: u * sp.cos(y) - x.diff() * y.diff() / 3, y: w - y.diff() / 5},
    inputs=(u, w),
)
CART = ss.MechanicalSystem(
    "cart", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0, forces={x: u}, inputs=(u,)
)
REST = {"start": {x: 0, x.diff(): 0}, "end": {x: 1, x.diff(): 0}}


def cart(**more):
    return ss.OptimalControl(CART, **{"cost": u**2, "duration": 1, **REST, **more})


def everything(**more):
    """A problem in which all that may be asked for is."""
    given = {
        "cost": u**2 + w**2 / 2 + x**2 * y.diff() ** 2 + k * y**4 + x * ss.time,
        "final_cost": m * x.diff() ** 2 + sp.exp(y) * ss.time,
        "start": {x: 0.1, "y": -0.2, x.diff(): 0, "v_y": 0},
        "end": {x: 1, x.diff() * m: k / 5, x + y: (-3, 3)},
        "duration": (0.8, 2.0),
        "bounds": {u: (-30, 30), x: (-2, 2), y.diff(): (-9, None)},
        "path": [x * y - 3, (-4, x.diff() + u / 50, 8)],
        "unknowns": {k: (1.5, 2.5)},
        "conditions": {y.diff() * m: x.diff() + x * k / 9},
    }
    return ss.OptimalControl(SYSTEM, **given | more)


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4", "radau5"]))
def test_derivatives_are_exact(scheme):
    check_derivatives(everything(), scheme)


def test_all_that_may_be_asked_for_is_there_in_the_end():
    found = everything().solve("lobatto6", steps=20)
    assert found.success, found.message
    assert found.violation < 1e-8
    run = found.trajectory
    assert abs(run.v[-1, 0] * 1.2 - found.unknowns["k"] / 5) < 1e-8
    assert abs(run["x"][-1] - 1) < 1e-8
    assert 0.8 <= found.duration <= 2.0
    assert 1.5 <= found.unknowns["k"] <= 2.5
    again, off = found.simulate(refine=8)
    assert off < 1e-5
    assert again.success
    names = found.inputs(np.linspace(0, found.duration, 7))
    assert sorted(names) == ["u", "w"]
    assert names["u"].shape == (7,)
    ends = found.input_values  # of Lobatto's nodes the last is the first of the next step
    assert (ends[:-1, -1] == ends[1:, 0]).all()
    assert found.layout.inputs.max() - found.layout.inputs.min() + 1 == 2 * (20 * 3 + 1)


def test_the_motion_is_a_run_of_the_scheme():
    """Steps that were not solved, but written down as equations, are those of the stepper."""
    found = cart(cost=u**2 + x**2).solve("simpson", steps=8)
    given = {"u": found.input_values[..., 0]}
    run = ss.compile(CART).integrate(
        found.q[0], p0=found.p[0], h=found.duration / 8, steps=8, inputs=given
    )
    assert np.abs(run.q - found.q).max() < 1e-12
    assert np.abs(run.p - found.p).max() < 1e-12


def test_costates_are_derivatives_of_the_least_cost():
    """By the state where it begins, against differences of the costs of other starts."""
    given = {"duration": 1.5, "cost": u**2 + x**4, "end": {x: 1}}

    def least(q, v):
        problem = cart(**given, start={x: q, x.diff(): v})
        return problem.solve("simpson", steps=20, tolerance=1e-11)

    by_q, by_p = least(0.2, 0.1).costates
    d = 1e-4
    assert abs((least(0.2 + d, 0.1).cost - least(0.2 - d, 0.1).cost) / (2 * d) - by_q[0, 0]) < 1e-6
    assert abs((least(0.2, 0.1 + d).cost - least(0.2, 0.1 - d).cost) / (2 * d) - by_p[0, 0]) < 1e-6


def test_costates_end_with_the_slope_of_the_final_cost():
    problem = ss.OptimalControl(
        CART,
        cost=u**2 + x**2,
        final_cost=2 * x**2 + x.diff() ** 2,
        start={x: 1, x.diff(): 0.5},
        duration=2,
    )
    found = problem.solve("gauss6", steps=30)
    by_q, by_p = found.costates
    assert abs(by_q[-1, 0] - 4 * found.q[-1, 0]) < 1e-8
    assert abs(by_p[-1, 0] - 2 * found.p[-1, 0]) < 1e-8
    assert abs(by_q[-1, 0]) > 1e-2


def test_more_steps_until_the_cost_is_as_exact_as_asked():
    found = cart(cost=u**2 + x**2).solve("midpoint", steps=10, error=1e-5)
    assert found.error < 1e-5
    assert found.layout.steps > 20
    again = pickle.loads(pickle.dumps(found))
    assert again.costates[0].tolist() == found.costates[0].tolist()
    with pytest.warns(ss.ResolutionWarning, match="with 192 steps the relative error"):
        cart(cost=u**2 + x**2).solve("midpoint", steps=3, error=1e-9)
    exact = cart(cost=u**2 + x**2).solve("gauss6", steps=20).cost
    assert abs(found.cost / exact - 1) < 1e-5


def test_solutions_are_saved_with_the_numbers_they_have(tmp_path):
    path = tmp_path / "cart.npz"
    found = cart(cost=u**2 + x**2).solve("gauss4", steps=6)
    found.save(path)
    again = cart(cost=u**2 + x**2).open(path)
    assert again.x.tolist() == found.x.tolist()
    assert again.costates[1].tolist() == found.costates[1].tolist()
    assert (again.status, again.history, again.cost) == (found.status, found.history, found.cost)
    assert cart(cost=u**2 + x**2).solve("gauss4", steps=6, guess=again).iterations <= 2
    heavy = ss.MechanicalSystem(
        "cart", coordinates=(x,), kinetic=x.diff() ** 2, potential=0, forces={x: u}, inputs=(u,)
    )
    given = {"cost": u**2 + x**2, "duration": 1}
    others = [
        cart(),
        everything(),
        cart(cost=u**2 + x**2, bounds={u: (-1, 1)}),
        cart(cost=u**2 + x**2, end={x: 1, x.diff(): 0.1}),
        ss.OptimalControl(heavy, **given, **REST),
    ]
    for other in others:
        with pytest.raises(ss.InputError, match="the solution of another problem, with 6 steps"):
            other.open(path)
    with pytest.raises(ss.StorageError, match=r"cannot be read: No such file.*\n.*save\(path\)"):
        cart().open(path.with_name("other.npz"))
    whole = path.read_bytes()
    for damaged in (whole[:-30], b"", b"no archive", whole.replace(b"saved", b"sawed")):
        path.write_bytes(damaged)
        with pytest.raises(ss.StorageError, match="not a solution of symsimpson"):
            cart(cost=u**2 + x**2).open(path)
    for change in ({"x": found.x[:, None]}, {"multipliers": np.nan * found.multipliers}):
        held = dict(np.load(io.BytesIO(whole)))
        np.savez(path, **held | change)
        with pytest.raises(ss.StorageError, match="ValueError"):
            cart(cost=u**2 + x**2).open(path)
    held["saved"] = np.array(str(held["saved"]).replace('"steps": 6', '"steps": 600000000'))
    np.savez(path, **held)
    with pytest.raises(ss.InputError, match="of another problem, with 600000000 steps"):
        cart(cost=u**2 + x**2).open(path)
    with pytest.raises(ss.StorageError, match="there is no folder"):
        found.save(tmp_path / "nowhere" / "cart.npz")


def test_the_cost_is_told_while_it_is_sought(capsys, monkeypatch):
    pytest.importorskip("tqdm")
    cart(cost=u**2 + x**4).solve(steps=4, progress=True)
    assert "cart, 4 steps: cost" in capsys.readouterr().err
    cart(cost=u**2 + x**4).solve(steps=4, progress=False)
    assert capsys.readouterr() == ("", "")


def test_a_motion_that_repeats_itself():
    """A mass on a spring that is driven, at least effort through two places, round and round."""
    problem = ss.OptimalControl(
        CART,
        cost=(u + 4 * x) ** 2 + (x - sp.cos(ss.time)) ** 2,
        duration=2 * np.pi,
        conditions={x: x, "v_x": x.diff()},
    )
    found = problem.solve("gauss6", steps=24)
    assert found.success
    assert np.abs(found.q[-1] - found.q[0]).max() < 1e-10
    assert np.abs(found.p[-1] - found.p[0]).max() < 1e-10
    by_q, by_p = found.costates  # and so do these
    assert np.abs(by_q[-1] - by_q[0]).max() < 1e-7
    assert np.abs(by_p[-1] - by_p[0]).max() < 1e-7
    # x = a cos t: (u + 4 x)^2 = (3 a)^2 cos^2, (a - 1)^2 cos^2; least at a = 1 / 10
    assert np.abs(found.q[:, 0] - np.cos(found.t) / 10).max() < 1e-6
    with pytest.raises(ss.InputError, match="conditions is list"):
        cart(conditions=[x])


def test_parameters_of_a_motion_that_was_measured():
    """Of a pendulum with friction, from its angle with noise; and from the exact angle, exactly."""
    th = ss.coordinates("theta")[0]
    s, l, c = sp.Symbol("s"), *sp.symbols("l c", positive=True)
    swing = ss.MechanicalSystem(
        "pendulum",
        coordinates=(th,),
        kinetic=l**2 * th.diff() ** 2 / 2,
        potential=-9.81 * l * sp.cos(th),
        parameters={l: 1.0, c: 0.1},
        forces={th: -c * th.diff()},
    )
    right = {l: 0.83, c: 0.07}
    run = ss.compile(swing, "gauss8").integrate([1.2], v0=[0.0], h=0.02, t_end=6, parameters=right)
    noise = 0.02 * np.random.default_rng(1).normal(size=301)
    for measured, off in ((run.q[:, 0] + noise, 5e-3), (lambda t: run.at(t).q[:, 0], 1e-8)):
        problem = ss.OptimalControl(
            swing,
            cost=(th - s) ** 2,
            duration=6,
            unknowns={l: (0.3, 3), c: (0.01, 1)},
            signals={s: measured},
        )
        found = problem.solve("lobatto6", steps=60)
        assert found.success, found.message
        assert abs(found.unknowns["l"] - 0.83) < off
        assert abs(found.unknowns["c"] - 0.07) < off


def test_a_motion_that_is_followed():
    """The least cost is that of an expression of the time, which a signal stands for."""
    s = sp.Symbol("s", real=True)
    ahead = cart(cost=u**2 + (x - s) ** 2, signals={s: lambda t: np.sin(3 * t)})
    right = cart(cost=u**2 + (x - sp.sin(3 * ss.time)) ** 2).solve("gauss4", steps=8).cost
    assert abs(ahead.solve("gauss4", steps=8).cost / right - 1) < 1e-12
    below = cart(path=[x - s], signals={s: [0.3, 1.2]}).solve("gauss4", steps=8)
    assert (below.q[:, 0] < 0.3 + 0.9 * below.t + 0.02).all()
    for signals, told in (
        ([s], "signals is list"),
        ({"s": 1}, "not a symbol"),
        ({u: 1}, "a name of the system"),
        ({s: [[1.0]]}, "of shape"),
        ({s: lambda t: t[:2]}, "returns shape"),
        ({s: "sin"}, "not real, where real numbers belong"),
        ({s: np.nan}, "not finite at all times"),
    ):
        with pytest.raises(ss.InputError, match=told):
            cart(cost=u**2 + s, signals=signals).solve("gauss4", steps=2)
    with pytest.raises(KeyError) as caught:
        cart(cost=u**2 + s, signals={s: lambda t: {}[0]}).solve("gauss4", steps=2)
    assert "passed as signals[s] raised this" in caught.value.__notes__[0]
    with pytest.raises(ss.InputError, match=r"duration is .*, but signals need"):
        cart(cost=u**2 + s, signals={s: 1.0}, duration=(1, 2))
    for more in ({"final_cost": s}, {"start": {x: s}}, {"conditions": {x: s}}):
        with pytest.raises(ss.InputError, match="contains the signal s"):
            cart(**more, signals={s: 1.0})


def test_gains_hold_a_run_near_the_solution():
    found = cart().solve("simpson", steps=40)
    gains = found.lqr(np.eye(2), 0.01 * np.eye(1))
    assert gains.shape == (40, 1, 2)
    with pytest.raises(ss.InputError, match="Q has shape"):
        found.lqr(np.eye(3), np.eye(1))
    stepper, h = ss.compile(CART), found.duration / 40
    ends = []
    for own in (gains, 0 * gains):
        loop = stepper.start([0.1], p0=[0.1], h=h)
        for k in range(40):
            off = np.concatenate([loop.q - found.q[k], loop.p - found.p[k]])
            loop.step((found.input_values[k, :, 0] - own[k] @ off)[:, None])
        ends.append(abs(loop.q[0] - 1))
    assert ends[0] < ends[1] / 2


def test_guesses():
    problem = cart(duration=(0.5, 3), cost=1 + u**2)
    first = problem.solve("simpson", steps=10)
    again = problem.solve("lobatto6", steps=15, guess=first)
    assert again.iterations <= first.iterations
    given = {x: lambda t: t**2, "u": [1.0, -1.0], "duration": 2.0}
    assert abs(problem.solve("simpson", steps=10, guess=given).cost - first.cost) < 1e-8
    for guess, told in (
        ({"z": 1.0}, "guess contains 'z'"),
        ({x: np.zeros((2, 2))}, "of shape"),
        ({x: lambda t: t[:1]}, "returns shape"),
        ({x: np.nan}, "not finite at all times"),
        (3.0, "guess is float"),
    ):
        with pytest.raises(ss.InputError, match=told):
            problem.solve(steps=4, guess=guess)


def test_what_is_not_guessed_begins_in_the_middle_of_its_bounds():
    for bounds, middle in (((0.5, 4.5), 1.5), ((-1.0, 2.0), 0.5), ((None, 3.0), 1.2)):
        c = sp.Symbol("c", real=True)
        pulled = ss.MechanicalSystem(
            "pulled",
            coordinates=(x,),
            kinetic=x.diff() ** 2 / 2,
            potential=c * x**2,
            parameters={c: 1.2},
        )
        problem = ss.OptimalControl(pulled, cost=x**2, duration=1, unknowns={c: bounds})
        assert abs(problem.solve(steps=2, most_iterations=0).unknowns["c"] - middle) < 1e-12
    free = cart(duration=(0.5, 2.0)).solve(steps=2, most_iterations=0)
    assert abs(free.duration - 1.0) < 1e-12


def test_numbers_are_as_they_are_written():
    for end in (1.00000001, 0.300000001, 10.0000001, np.float64(0.1)):
        assert cart(end={x: end, x.diff(): 0}).solve("gauss4", steps=2).q[-1, 0] == end


def test_a_bound_holds_at_the_last_state_too():
    away = cart(end={}, final_cost=-x, cost=u**2 / 100, bounds={x: (None, 2.0)})
    for steps in (1, 8):
        found = away.solve("simpson", steps=steps)
        assert found.success, found.message
        assert abs(found.q[-1, 0] - 2.0) < 1e-6


def test_outcomes_that_are_no_solution_keep_what_there_is():
    weak = cart(bounds={u: (-1, 1)}).solve(steps=10)  # too weak to be there in time
    assert weak.status is ss.ControlStatus.INFEASIBLE
    assert not weak.success
    assert "has an error of" in weak.message
    assert weak.violation > 1e-3
    assert not weak.trajectory.success
    fast = cart(start={x: 0}, end={x: 1}, bounds={x.diff(): (-1, 0.5)})
    assert not fast.solve("lobatto6", steps=10).success
    lost = cart(cost=u**2 + 1 / x).solve(steps=4)
    assert lost.status is ss.ControlStatus.NOT_FINITE
    assert lost.q.shape == (5, 1)
    short = cart(cost=u**4 + x**2).solve(steps=10, most_iterations=1)
    assert short.status is ss.ControlStatus.ITERATION_LIMIT
    assert short.q.shape == (11, 1)
    assert len(short.history["obj"]) == 2


def test_ctrl_c_returns_the_iterate(monkeypatch):
    from symsimpson.study.control.transcription import NonlinearProgram

    plain, calls = NonlinearProgram.curvatures, []

    def curvatures(*given):
        calls.append(1)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return plain(*given)

    monkeypatch.setattr(NonlinearProgram, "curvatures", curvatures)
    found = cart(cost=u**4 + sp.cosh(x)).solve(steps=10, tolerance=1e-11)
    assert found.status is ss.ControlStatus.INTERRUPTED
    assert np.isfinite(found.q).all()


def test_what_cannot_be_solved_is_said_before():
    with pytest.raises(ss.InputError, match="have no control points"):
        cart().solve("kahan_li8")
    for name, value in (
        ("steps", 0),
        ("tolerance", -1),
        ("error", np.nan),
        ("most_iterations", -1),
        ("most_iterations", True),
        ("progress", "x"),
    ):
        with pytest.raises(ss.InputError, match=f"{name} is {value!r}"):
            cart().solve(**{name: value})
    with pytest.raises(ss.InputError, match="is declared positive"):
        everything(unknowns={m: (-3, 3)})
    with pytest.raises(ss.ModelError, match="z"):
        cart(cost=sp.Symbol("z") ** 2)
    with pytest.raises(ss.InputError, match="which optimal control does not accept"):
        ss.OptimalControl("cart", cost=1, duration=1)
    free = ss.MechanicalSystem("free", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=x**2)
    with pytest.raises(ss.InputError, match="conditions than inputs can satisfy"):
        ss.OptimalControl(free, duration=1, **REST).solve(steps=5)
    with pytest.warns(ss.ResolutionWarning, match="act only in sums"):
        cart().solve(ss.galerkin("gauss", 3, 1), steps=5)


def test_figures():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    found = cart(bounds={u: (-9, 9)}).solve("simpson", steps=6)
    upper, lower = found.plot().axes
    assert [line.get_label() for line in upper.get_lines()] == ["x"]
    assert len(lower.get_lines()) == 3  # with two bounds
    left, right = found.plot_sparsity().axes
    programme, *_ = found.layout.nlp
    assert left.get_title() == f"Jacobian: {len(programme.jacobian_places[0])} entries"
    assert right.get_ylim()[0] == found.layout.size - 0.5
    (searched,) = found.plot_iterations().axes
    assert len(searched.get_lines()[0].get_xdata()) == found.iterations + 1
    pyplot.close("all")
