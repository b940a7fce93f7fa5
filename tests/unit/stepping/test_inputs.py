"""Bad input is refused before anything is computed; good input comes in every form."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(ss.systems.double_pendulum(), "midpoint")


EXACT = {"steps": None, "exact_h": True}
GOOD = {"q0": [0.5, 0.2], "p0": [0.0, 0.1], "h": 0.1, "steps": 3}
WRONG = {
    "shape": ({"q0": [0.5]}, r"q0 has shape \(1,\), expected \(2,\)"),
    "rows": ({"q0": [[0.5, 0.2]]}, r"q0 has shape \(1, 2\)"),
    "scalar": ({"p0": 0.0}, r"p0 has shape \(\)"),
    "ragged": ({"q0": [0.5, [1, 2]]}, "q0 is .* not real numbers"),
    "nan": ({"q0": [0.5, np.nan]}, "q0 is not finite for q2"),
    "infinity": ({"p0": [np.inf, 0]}, "p0 is not finite for q1"),
    "complex": ({"q0": [0.5j, 1]}, "q0 is .* not real numbers"),
    "text": ({"q0": ["a", "b"]}, "q0 is .* not real numbers"),
    "nothing": ({"q0": [None, 0.0]}, r"q0 is \[None, 0.0\], not real numbers"),
    "digits": ({"q0": ["1", "2"]}, "q0 is .* not real numbers"),
    "none": ({"q0": None}, "q0 is None, not real numbers|q0 has shape"),
    "zero step": ({"h": 0.0}, "the step size h is 0"),
    "nan step": ({"h": float("nan")}, "h is nan, not a finite real number"),
    "text step": ({"h": "0.1"}, "h is .*not a finite real number"),
    "part of a step": (
        EXACT | {"t_end": 0.35},
        r"t_end=0.35 is 3.5 steps of h=0.1 after t0=0, not a whole number.*\n.*steps=4, or exact_h",
    ),
    "less than a step": (EXACT | {"t_end": 0.05}, r"Use h=0\.05, steps=1, "),
    "thirds": (EXACT | {"t_end": 1.0, "h": 0.3}, r"h=0\.25, steps=4, "),
    "late": (
        EXACT | {"t0": 1e7, "t_end": 10000000.25, "h": 0.1},
        r"t_end=10000000.25 is 2.5 steps .* after t0=10000000, not",
    ),
    "masked step": ({"h": np.ma.masked}, "h is masked, not a finite real number"),
    "masked start": ({"t0": np.ma.masked}, "t0 is masked, not"),
    "masked end": ({"steps": None, "t_end": np.ma.masked}, "t_end is masked, not"),
    "masked value": ({"parameters": {"m1": np.ma.masked}}, "parameter m1 is masked, not"),
    "masked position": ({"q0": [0.5, np.ma.masked]}, "q0 has masked entries"),
    "masked position by name": ({"q0": {"q1": np.ma.masked, "q2": 0.2}}, "q0 has masked entries"),
    "masked momentum": ({"p0": np.ma.masked}, "p0 has masked entries"),
    "masked time": ({"t_eval": [0.1, np.ma.masked]}, "t_eval has masked entries"),
    "no end": ({"steps": None}, "exactly one of t_end and steps, but has neither"),
    "two ends": ({"t_end": 0.3}, "exactly one of t_end and steps, but has both"),
    "backwards": ({"steps": None, "t_end": -1.0}, "cannot reach t_end=-1"),
    "negative steps": ({"steps": -1}, "steps is -1"),
    "part of a count": ({"steps": 2.5}, "steps is 2.5, not a whole number"),
    "every": ({"every": 0}, "every is 0"),
    "boolean": ({"every": True}, "every is True, not a whole number"),
    "absurd": ({"steps": 10**15}, "do not fit into memory"),
    "more absurd": ({"steps": 10**30}, "Pass a whole number"),
    "tiny step": ({"steps": None, "t_end": 1.0, "h": 1e-100}, "is too long; the limit is"),
    "least step": ({"h": -1e-310}, "the step size h is -1e-310. Its square"),
    "both": ({"v0": [0, 0]}, "exactly one of v0 and p0, but has both"),
    "neither": ({"p0": None}, "exactly one of v0 and p0, but has neither"),
    "name": ({"parameters": {"mass": 1.0}}, "no parameter 'mass'.\nThe system has m1, m2"),
    "value": ({"parameters": {"m1": np.nan}}, "parameter m1 is nan"),
    "sign": ({"parameters": {"m1": -1.0}}, "m1 is declared positive, but its value is -1"),
    "list": ({"parameters": [1.0]}, "parameters is .* not a mapping"),
    "failure": ({"on_failure": "ignore"}, "on_failure is 'ignore'"),
}


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_message(stepper, changes, message):
    with pytest.raises(ss.InputError, match=f"(?s){message}") as caught:
        stepper.integrate(**(GOOD | changes))
    assert isinstance(caught.value, ValueError)
    assert "\n" in str(caught.value)


def test_an_end_far_from_zero_is_rounded_as_times_are(stepper):
    far = GOOD | {"steps": None, "t0": 1e9, "h": 1e-3}
    run = stepper.integrate(**far, t_end=1e9 + 400 * 1e-3)
    assert (len(run.t) - 1, run.t[-1]) == (400, 1e9 + 0.4)
    with pytest.raises(ss.InputError, match=r"t_end=1000000000\.35 is 3\.5.* t0=1000000000, not"):
        stepper.integrate(**(far | {"h": 0.1, "t_end": 1e9 + 0.35}), exact_h=True)


@pytest.mark.parametrize(
    ("h", "t0", "t_end", "steps"),
    [(0.03, 0.0, 0.1, 4), (-0.03, 0.1, 0.0, 4), (0.3, 1.0, 1.05, 1), (0.1, 0.0, 0.35, 4)],
)
def test_a_step_that_does_not_divide_the_time_is_shortened(stepper, h, t0, t_end, steps):
    """Twice: short runs, of which the step has been looked at, take it, too."""
    asked = GOOD | {"steps": None, "h": h, "t0": t0, "t_end": t_end}
    for run in (stepper.integrate(**asked), stepper.integrate(**asked)):
        assert (run.steps, run.h) == (steps, (t_end - t0) / steps)
        assert run.t[-1] == pytest.approx(t_end, rel=1e-15, abs=1e-15)
        assert (
            f" The step size is h={run.h:.15g}, not {h:.15g}, so that {steps} step" in run.message
        )
    same = stepper.integrate(**(GOOD | {"h": run.h, "t0": t0, "steps": steps}))
    assert (run.q == same.q).all()
    assert "The step size is" not in same.message
    saved = stepper.integrate(**asked, t_eval=[t_end])
    assert "The step size is" in saved.message
    assert (saved.q[-1] == run.q[-1]).all()


def test_a_masked_default_is_no_value():
    (x,), k = ss.coordinates("x"), sp.Symbol("k")
    given = {"coordinates": (x,), "kinetic": x.diff() ** 2 / 2, "potential": k * x}
    with pytest.raises(ss.ModelError, match="parameter k has the value --, which"):
        ss.MechanicalSystem("masked", parameters={k: np.ma.masked}, **given)
    system = ss.MechanicalSystem("masked", parameters={k: 1.0}, **given)
    for wrong in ({"q0": [np.ma.masked]}, {"parameters": {"k": np.ma.masked}}):
        with pytest.raises(ss.InputError, match="masked"):
            system.linearise(**({"q0": [0.0]} | wrong))


def test_rounding_of_times_is_no_part_of_a_step(stepper):
    """Of late ones, and of quotients that are so large: advice to take the same h is none."""
    late = stepper.integrate(
        **(GOOD | {"steps": None, "t0": 1e7 + 0.1, "t_end": 1e7 + 0.3, "h": 1e-3})
    )
    assert late.steps == 200
    with pytest.raises(ss.InputError, match="do not fit into memory"):
        stepper.integrate(**(GOOD | {"steps": None, "t_end": 1000.0, "h": 1e-9}))


def test_step_and_equations_check_too(stepper):
    with pytest.raises(ss.InputError, match="q0 has shape"):
        stepper.step([1.0], [0.0, 0.0], h=0.1)
    with pytest.raises(ss.InputError, match="nodes has shape"):
        stepper.residual([0.5, 0.2], [0.0, 0.1], [0.5, 0.2], 0.1)
    for h, told in ((0, "the step size h is 0"), (1e-200, "leave the range of double")):
        with pytest.raises(ss.InputError, match=told):
            stepper.jacobian([0.5, 0.2], [0.0, 0.1], [[0.5, 0.2], [0.5, 0.2]], h)
    with pytest.raises(ss.InputError, match=r"nodes is .* not real numbers"):
        stepper.jacobian([0.5, 0.2], [0.0, 0.1], "nodes", 0.1)


def test_mass_matrix_must_be_positive_definite():
    pole = ss.compile(ss.systems.spherical_pendulum(), "midpoint")
    with pytest.raises(ss.InputError, match=r"not positive definite|not finite"):
        pole.integrate([0.0, 0.0], p0=[0.1, 0.1], h=0.01, steps=1)
    x, y = ss.coordinates("x y")
    c = sp.Symbol("c", real=True)
    system = ss.MechanicalSystem(
        "coupled",
        coordinates=(x, y),
        potential=0,
        parameters={c: 0.5},
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2 + c * x.diff() * y.diff(),
    )
    stepper = ss.compile(system, "midpoint")
    assert stepper.integrate([0, 0], v0=[1, 0], h=0.1, steps=1).status == 0
    with pytest.raises(ss.InputError, match=r"not positive definite.*'c': 2.0"):
        stepper.integrate([0, 0], v0=[1, 0], h=0.1, steps=1, parameters={c: 2.0})


def test_forms_of_input_agree(stepper):
    m1 = next(iter(ss.systems.double_pendulum().parameters))
    base = stepper.integrate(**GOOD, parameters={"m1": 2.0})
    strided = np.array([0.5, 9.0, 0.2, 9.0])[::2]
    strided.flags.writeable = False
    for changes in (
        {"q0": strided},
        {"q0": (0.5, 0.2)},
        {"h": np.float64(0.1)},
        {"steps": np.int32(3)},
        {"steps": 3.0},
        {"q0": [sp.Rational(1, 2), sp.Rational(1, 5)]},
        {"steps": None, "t_end": 0.3},
        {"parameters": {m1: 2}},
    ):
        run = stepper.integrate(**({**GOOD, "parameters": {"m1": 2.0}} | changes))
        assert (run.q == base.q).all()
    assert base.parameters["m1"] == 2.0
    assert (stepper.integrate(**GOOD).q[1:] != base.q[1:]).all()


def test_strides(stepper):
    every = stepper.integrate(**(GOOD | {"steps": 10}))
    third = stepper.integrate(**(GOOD | {"steps": 10}), every=3)
    last = stepper.integrate(**(GOOD | {"steps": 10}), every=None)
    assert third.q.shape == (4, 2)
    assert (third.q == every.q[::3]).all()
    assert (third.t == every.t[::3]).all()
    assert third.newton_iterations[1] == every.newton_iterations[1:4].sum()
    assert last.q.shape == last.p.shape == (1, 2)
    assert (last.q[0] == every.q[-1]).all()
    assert last.t.tolist() == [every.t[-1]]
    assert last.newton_iterations[0] == every.newton_iterations.sum()
    assert stepper.integrate(**(GOOD | {"steps": 0})).q.tolist() == [[0.5, 0.2]]


def test_velocities_and_momenta_agree(stepper):
    by_velocity = stepper.integrate([0.5, 0.2], v0=[1.0, -0.5], h=0.01, steps=20)
    by_momentum = stepper.integrate([0.5, 0.2], p0=by_velocity.p[0], h=0.01, steps=20)
    assert (by_velocity.q == by_momentum.q).all()
    stepped = stepper.step([0.5, 0.2], p=by_velocity.p[0], h=0.01)[0]
    assert stepped.tolist() == by_momentum.q[1].tolist()
    again = stepper.step([0.5, 0.2], [1.0, -0.5], h=0.01)[0]
    assert again.tolist() == stepped.tolist()


def test_energy_error_is_relative_to_its_scale():
    stepper = ss.compile(ss.systems.pendulum(), "midpoint")
    run = stepper.integrate([np.pi / 2], v0=[0.0], h=0.1, steps=10, parameters={"l": 1.0})
    offset = stepper.integrate([0.0], v0=[0.0], h=0.1, steps=2)
    assert np.isclose(run.energy_error[-1] * run.energy_scale, run.energy[-1] - run.energy[0])
    assert run.energy_scale > 1.0  # |H0| is 1e-16
    assert offset.energy_error.tolist() == [0.0, 0.0, 0.0]


def test_without_mass_it_is_not_the_position_that_is_wrong():
    (x,), m, k = ss.coordinates("x"), *sp.symbols("m k")
    light = ss.compile(
        ss.MechanicalSystem(
            "light",
            coordinates=(x,),
            kinetic=m * x.diff() ** 2 / 2,
            potential=k * x**2 / 2,
            parameters={m: 1.0, k: 2.0},
        ),
        "midpoint",
    )
    for given in ({"v0": [0.0]}, {"p0": [1.0]}):
        with pytest.raises(
            ss.InputError, match=r"(?s)mass matrix is singular at.*m is 0\."
        ) as told:
            light.integrate([1.0], **given, h=0.1, steps=1, parameters={m: 0})
        assert "Start from another position" not in str(told.value)
    pole = ss.compile(ss.systems.spherical_pendulum(), "midpoint")
    with pytest.raises(ss.InputError, match="singular point of the coordinates"):
        pole.integrate([0.0, 0.0], p0=[0.1, 0.1], h=0.01, steps=1)


def test_inputs_that_are_no_numbers_say_where():
    cart = ss.compile(ss.systems.driven_cart_pole(), "midpoint")
    (name,) = cart.inputs
    start = {"q0": [0.0, 0.1], "v0": [0.0, 0.0], "h": 0.01, "steps": 3}
    with pytest.raises(ss.InputError, match=f"input {name} is nan, not finite"):
        cart.integrate(**start, inputs={name: float("nan")})
    with pytest.raises(ss.InputError, match=rf"input {name} is inf at {name}\[1\], not finite"):
        cart.integrate(**start, inputs={name: [0.0, np.inf, 0.0]})
