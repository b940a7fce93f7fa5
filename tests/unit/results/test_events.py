"""Zeros of expressions, located on the dense output."""

import mpmath
import numpy as np
import pytest
import sympy as sp
import sympy.physics.mechanics
from support.cases import sweep

import symsimpson as ss
from symsimpson.run import chosen


@pytest.fixture(scope="module")
def pendulum():
    return ss.compile(ss.systems.pendulum(), "gauss16")


def swing(stepper, angle=1.0, **options):
    return stepper.integrate([angle], v0=[0.0], **({"h": 0.05, "steps": 200} | options))


def test_zeros_of_a_pendulum_are_those_of_elliptic_functions(pendulum):
    run = swing(pendulum)
    quarter = float(mpmath.ellipk(np.sin(0.5) ** 2)) / np.sqrt(9.81 / run.parameters["l"])
    found = run.events("theta")
    expected = quarter * np.arange(1, 2 * len(found), 2)
    assert len(found) == int((10 / quarter + 1) // 2)
    assert np.abs(found.t - expected).max() < 1e-12
    assert np.abs(found["theta"]).max() < 1e-14
    assert (found.direction == np.where(np.arange(len(found)) % 2, 1, -1)).all()


def test_direction_and_kinds_of_expression(pendulum):
    run = swing(pendulum)
    every = run.events("theta")
    assert (run.events("theta", direction=1).t == every.t[1::2]).all()
    assert (run.events("theta", direction=-1).t == every.t[::2]).all()
    (theta,) = ss.coordinates("theta")
    assert (run.events(theta).t == every.t).all()
    assert np.abs(run.events(sp.Eq(sp.sin(theta), 0)).t - every.t).max() < 1e-13
    later = run.events("t - 3.125")
    assert abs(later.t[0] - 3.125) < 1e-14
    assert len(later) == 1
    assert np.abs(run.events("p_theta")["theta"]).min() > 0.999  # the turning points


def test_runs_backwards_count_their_own_way(pendulum):
    run = swing(pendulum, h=-0.05)
    found = run.events("theta", direction=-1)
    assert (np.diff(found.t) < 0).all()
    assert (found["v_theta"] > 0).all()  # theta goes down as the run goes back in time


def test_wrapped_angles_are_not_crossed_where_they_jump(pendulum):
    run = pendulum.integrate([0.1], v0=[9.0], h=0.05, steps=400)  # over the top
    assert run["theta"][-1] > 20
    assert len(run.events("theta")) == 0
    found = run.events("theta", wrap=True)
    turns = np.floor(run["theta"][-1] / (2 * np.pi))
    assert len(found) == turns
    assert np.abs(found["theta"]).max() < 1e-12
    assert (np.abs(run.events("theta - 1", wrap="theta")["theta"] - 1) < 1e-12).all()


@pytest.mark.parametrize("place", sweep(["3.14", "3", "2.5", "3.1", "-3.1", "3.141592653589793"]))
@pytest.mark.parametrize("h", sweep([0.1, -0.1, 0.01]))
def test_wrapped_zeros_near_the_seam_are_all_found(pendulum, place, h):
    run = pendulum.integrate([1.0], v0=[10.0], h=h, steps=round(7 / abs(h)))
    turns = abs(run.events(f"sin((theta - ({place}))/2)").t)
    for wrap in (True, np.True_, "theta", ss.coordinates("theta")[0], ["theta"]):
        found = run.events(f"theta - ({place})", wrap=wrap)
        assert len(found) == len(turns) > 8
        assert np.abs(abs(found.t) - turns).max() < 1e-12
    assert len(run.events(f"sin(theta - ({place}))", wrap=True)) == len(
        run.events(f"sin(theta - ({place}))")
    )


def test_a_users_own_names_come_before_those_of_the_module():
    x, y = sp.physics.mechanics.dynamicsymbols("φ q0")
    k1, k2 = sp.symbols("_k a0", positive=True)
    system = ss.MechanicalSystem(
        "renamed",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=k1 * x**2 / 2 + k2 * y**2 / 2,
        parameters={k1: 1.0, k2: 9.0},
    )
    stepper = ss.compile(system)
    given = {"v0": [0, 0], "h": 0.05, "steps": 100}
    run = stepper.integrate([1.0, 1.0], **given)
    assert abs(run.events(y).t[0] - np.pi / 6) < 1e-5
    assert abs(run.events(x).t[0] - np.pi / 2) < 1e-5
    assert (run["q0"] == run.q[:, 1]).all()
    assert (run["φ"] == run.q[:, 0]).all()
    assert np.abs(9 * run.events(y - k2 / 90)["q0"] - 0.9).max() < 1e-12
    many = stepper.ensemble([[1.0, 0.5]], **given, reduce={"least": ("min", y)})
    assert abs(many.reduced["least"][0] + 0.5) < 1e-3


def test_poles_are_no_zeros(pendulum):
    assert len(swing(pendulum).events("1/theta")) == 0


def test_the_first_state_is_no_crossing(pendulum):
    for velocity in (1.0, -1.0):
        run = pendulum.integrate([0.0], v0=[velocity], h=0.05, steps=30)
        found = run.events("theta")
        assert len(found) == 1
        assert found.t[0] > 0.5


@pytest.mark.slow
def test_sections_do_not_disturb_the_run_and_equal_its_events(monkeypatch):
    stepper = ss.compile(ss.systems.henon_heiles(), "gauss8")
    given = {"v0": [0.4, 0.0], "h": 0.25, "steps": 2000}
    run = stepper.integrate([0.0, 0.1], **given)
    wanted = run.events("x", direction=1)
    for piece in (8192, 7, 1):
        monkeypatch.setattr(chosen, "PIECE", piece)
        found = stepper.poincare("x", [0.0, 0.1], **given, direction=1)
        assert (found.t == wanted.t).all()
        assert (found.y == wanted.y).all()
    assert found.status is ss.Status.SUCCESS
    swing = np.abs(run.energy - run.energy[0]).max()
    assert np.abs(found.energy - run.energy[0]).max() < 2 * swing < 2e-12
    fine = stepper.integrate([0.0, 0.1], v0=[0.4, 0.0], h=0.125, steps=4000)
    assert np.abs(fine.events("x", direction=1).y - wanted.y)[:, :50].max() < 1e-7


@pytest.mark.slow
def test_zeros_at_stored_states_are_counted_once(pendulum):
    """A zero at the end of a piece is that of one piece alone."""
    run = swing(pendulum, steps=20)
    for k in range(1, 20):
        for sign in ("", "-"):
            shifted = f"{sign}(t - {float(run.t[k])!r})"
            for piece in (3, 4, 100):
                with pytest.MonkeyPatch.context() as patch:
                    patch.setattr(chosen, "PIECE", piece)
                    found = pendulum.poincare(shifted, [1.0], v0=[0.0], h=0.05, steps=20)
                assert found.t.tolist() == [run.t[k]]


@pytest.mark.slow
def test_velocities_in_expressions(pendulum):
    """A turning point is where velocity and momentum are zero; in ensembles, too."""
    (theta,) = ss.coordinates("theta")
    run = swing(pendulum)
    turning = run.events("p_theta")
    for expression in ("v_theta", theta.diff(), sp.Eq(2 * theta.diff(), 0)):
        assert np.abs(run.events(expression).t - turning.t).max() < 1e-12
    section = pendulum.poincare(theta.diff(), [1.0], v0=[0.0], h=0.05, steps=200)
    assert np.abs(section.t - turning.t).max() < 1e-12
    many = pendulum.ensemble(
        [[1.0], [0.5]], v0=[0.0], h=0.05, steps=200, reduce={"fastest": ("max", theta.diff())}
    )
    assert many["fastest"][0] == run["v_theta"].max()
    top = ss.compile(ss.systems.double_pendulum())
    path = top.integrate([0.8, 1.0], v0=[0.0, 0.1], h=0.01, steps=300)
    zeros = path.events("v_q2")
    assert np.abs(zeros["v_q2"]).max() < 1e-12 * np.abs(path["v_q2"]).max()
    assert len(zeros) > 3


def test_a_name_of_two_quantities_is_refused():
    (x,), p_x = ss.coordinates("x"), sp.Symbol("p_x", positive=True)
    system = ss.MechanicalSystem(
        "twofold",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=p_x * x**2,
        parameters={p_x: 2.0},
    )
    run = ss.compile(system).integrate([1.0], v0=[0.0], h=0.05, steps=60)
    with pytest.raises(ss.InputError, match="'p_x' is a parameter, and the name of another"):
        run.events("p_x")


def test_energy_in_an_expression(pendulum):
    run = swing(pendulum)
    middle = float(run.energy[0])
    assert len(run.events(f"energy - {middle - 1}")) == 0


@pytest.mark.slow
def test_interrupted_and_failed_sections_keep_what_they_found(monkeypatch):
    stepper = ss.compile(ss.systems.henon_heiles(), "simpson")
    calls = []

    def stop(*arguments, **options):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return original(*arguments, **options)

    original = chosen.find_zeros
    monkeypatch.setattr(chosen, "find_zeros", stop)
    monkeypatch.setattr(chosen, "PIECE", 500)
    with pytest.raises(ss.Interrupted, match="interrupted at t=") as caught:
        stepper.poincare("x", [0.0, 0.1], v0=[0.4, 0.0], h=0.1, steps=5000)
    assert 0 < len(caught.value.trajectory) < 100
    assert caught.value.trajectory.t[-1] <= 100
    with pytest.raises(ss.ConvergenceError) as failed:  # beyond the escape energy
        stepper.poincare("x", [0.0, 0.1], v0=[2.4, 1.0], h=0.1, steps=5000)
    assert isinstance(failed.value.trajectory, ss.Events)
    kept = stepper.poincare("x", [0.0, 0.1], v0=[2.4, 1.0], h=0.1, steps=5000, on_failure="return")
    assert kept.status is failed.value.status


@pytest.mark.parametrize(
    ("expression", "options", "message"),
    [
        ("theta", {"direction": 2}, "direction is 2"),
        ("theta", {"wrap": "psi"}, "not a coordinate"),
        ("psi", {}, "contains the unknown name 'psi'"),
        ("__import__('os').system('true')", {}, "contains"),
        ("theta.real", {}, "contains"),
        ("(", {}, "no expression"),
        ("atan2(theta)", {}, r"atan2 cannot take 1 argument\."),
        ("sin(theta, 2)", {}, "sin cannot take 2 arguments"),
        ("theta - 1e400", {}, "too large"),
        ("theta - " + "1" * 400, {}, "too large"),
        ("theta", {"wrap": 5}, "not a coordinate"),
        ("x" * 3000, {}, "characters"),
    ],
)
def test_bad_questions(pendulum, expression, options, message):
    with pytest.raises(ss.InputError, match=message):
        swing(pendulum).events(expression, **options)


def test_many_digits_are_refused():
    run = ss.compile(ss.systems.pendulum(), precision=30).integrate([1.0], v0=[0.0], h=0.1, steps=3)
    with pytest.raises(ss.InputError, match="many digits"):
        run.events("theta")


def test_zeros_after_the_last_stored_state_are_found(pendulum):
    whole = swing(pendulum, steps=35).events("theta")
    part = swing(pendulum, steps=35, every=12)
    assert len(whole) == 2
    assert part.t[-1] < whole.t[1] < 35 * 0.05
    assert np.abs(whole.t - part.events("theta").t).max() < 1e-12


@pytest.mark.parametrize("name", sweep(["lambda", "x'", "class"]))
def test_symbols_of_any_name(name):
    """As SymPy has them; a text with them could be read as something else."""
    (x,), k = ss.coordinates("x"), sp.Symbol(name)
    system = ss.MechanicalSystem(
        "odd", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=k * x**2, parameters={k: 2.0}
    )
    stepper = ss.compile(system)
    run = stepper.integrate([1.0], v0=[0.0], h=0.05, steps=60)
    assert np.abs(run.events(sp.Eq(k * x, 1)).t - run.events("x - 0.5").t).max() < 1e-12
    many = stepper.ensemble([[1.0]], v0=[0.0], h=0.05, steps=60, reduce={"a": ("max", k * x)})
    assert many.reduced["a"][0] == pytest.approx(2.0)
    with pytest.raises(ss.InputError, match=r"contains|no expression"):
        run.events(sp.Symbol("__import__('os').getcwd()"))


@pytest.mark.slow
def test_sections_of_an_angle(pendulum):
    """A turning pendulum passes theta = 1 once in each turn; the jump of the rest is no zero."""
    theta = ss.systems.pendulum().coordinates[0]
    run = pendulum.integrate([0.2], v0=[9.0], h=0.02, steps=500)
    assert run.q[-1, 0] > 8 * np.pi
    right = run.events(sp.sin((theta - 1) / 2)).t
    for expression in (
        sp.Mod(theta, 2 * sp.pi) - 1,
        "Mod(theta, 2*pi) - 1",
        "theta % (2*pi) - 1",
        sp.Eq(sp.Mod(theta, 2 * sp.pi), 1),
    ):
        found = run.events(expression)
        assert found.t == pytest.approx(right, abs=1e-12)
        assert (found.direction == 1).all()
    again = pendulum.poincare("theta % (2*pi) - 1", [0.2], v0=[9.0], h=0.02, steps=500)
    assert again.t == pytest.approx(right, abs=1e-12)
    at_zero = run.events("Mod(theta + pi, 2*pi) - pi").t
    assert at_zero == pytest.approx(run.events("sin(theta/2)").t, abs=1e-12)


@pytest.mark.parametrize("kind", ["text", "symbols", "equation"])
def test_a_rest_that_never_changes_its_sign(pendulum, kind):
    theta = ss.systems.pendulum().coordinates[0]
    rest = sp.Mod(theta, 2 * sp.pi)
    expression = {"text": "theta % 2", "symbols": rest, "equation": sp.Eq(rest, 0)}[kind]
    with pytest.raises(
        ss.InputError, match=r"never changes its sign.*\n.*Mod\(q1 \+ pi, 2\*pi\) - pi"
    ):
        swing(pendulum).events(expression)


def test_what_never_changes_has_no_zeros(pendulum):
    for constant in ("g - 9.81", sp.Integer(0)):
        with pytest.raises(ss.InputError, match="contains no coordinate, velocity or time, so"):
            swing(pendulum).events(constant)


@pytest.mark.filterwarnings("error")
def test_values_that_overflow_are_no_zeros_and_do_not_warn():
    (z,) = ss.coordinates("z")
    fall = ss.MechanicalSystem("fall", coordinates=(z,), kinetic=z.diff() ** 2 / 2, potential=z)
    run = ss.compile(fall).integrate([0.0], v0=[2.0], h=0.01, steps=400)
    found = run.events(sp.exp(2000 * z) - 2)
    assert np.abs(found["z"] - np.log(2) / 2000).max() < 1e-12
    assert len(found) == 2
