"""Indicators of chaos: values that are known, and the same of single runs and of ensembles."""

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss

#: m = 1, l = 0.25, g = 9.81.
VALUES = {"m1": 1.0, "m2": 1.0, "l1": 0.25, "l2": 0.25}
REGULAR, CHAOTIC = [0.8, 1.0], [2.0, 2.5]


@pytest.fixture(scope="module")
def pendulum():
    return ss.compile(ss.systems.double_pendulum(), "simpson")


@pytest.mark.slow
def test_the_exponent_of_a_chaotic_motion(pendulum):
    """2.88 on the mean of 16 orbits, which scatter by 0.08; MEGNO grows as half of it."""
    for h in (0.01, 0.005):
        chaos = pendulum.lyapunov(CHAOTIC, p0=[0, 0], h=h, t_end=400, parameters=VALUES)
        assert abs(chaos.exponents[0] - 2.88) < 0.25
        assert abs(chaos.megno[-1] / (chaos.exponents[0] * 400 / 2) - 1) < 0.03
        assert abs(chaos.exponents.sum()) < 1e-12
        assert chaos.sali[np.searchsorted(chaos.t, 10.0)] < 1e-10
        assert chaos.sali[-1] == 0


@pytest.mark.slow
def test_a_regular_motion_has_no_exponents(pendulum):
    """They fall as ln(t)/t does, and SALI as 1/t."""
    chaos = pendulum.lyapunov(REGULAR, p0=[0, 0], h=0.01, t_end=400, parameters=VALUES)
    at = np.searchsorted(chaos.t, [50 - 1e-9, 200 - 1e-9, 400 - 1e-9])
    times = chaos.t[at]
    assert (chaos.history[at, 0] < np.log(times) / times).all()
    assert (np.diff(chaos.history[at, 0]) < 0).all()
    assert abs(chaos.exponents.sum()) < 1e-12
    assert 0.01 < chaos.sali[-1] < 1
    assert chaos.megno[-1] < 2.1


@pytest.mark.slow
def test_exponents_of_linear_motion_are_those_of_the_matrix():
    """A damped oscillator loses area by exp(-c h/m) a step; an exponent each is half of that."""
    system = ss.systems.damped_oscillator()
    chaos = ss.compile(system).lyapunov([1.0], v0=[0.0], h=0.01, t_end=200)
    values = dict(
        zip(*(ss.compile(system).parameters, ss.compile(system).program.defaults), strict=True)
    )
    rate = values["c"] / values["m"]
    assert np.abs(chaos.exponents + rate / 2).max() < 0.01
    assert abs(chaos.exponents.sum() + rate) < 1e-6  # h^4


@pytest.mark.slow
def test_where_variations_are_made_orthonormal_does_not_matter(pendulum):
    given = {"p0": [0, 0], "h": 0.01, "t_end": 40, "parameters": VALUES}
    often = pendulum.lyapunov(CHAOTIC, **given, every=5)
    seldom = pendulum.lyapunov(CHAOTIC, **given, every=20)
    assert np.abs(often.history[3::4] - seldom.history).max() < 1e-9
    few = pendulum.lyapunov(CHAOTIC, **given, exponents=2)
    assert few.gali.shape == (len(few.t), 1)
    # the area of two unit vectors, and the shorter diagonal
    angle = np.arcsin(few.gali[:, 0])
    assert np.allclose(few.sali, 2 * np.sin(angle / 2), rtol=1e-8)


def test_gali_is_the_volume_of_the_variations(pendulum):
    """Of a short run: from the derivative of the flow itself."""
    from symsimpson.derivatives.lyapunov import directions

    chaos = pendulum.lyapunov([0.8, 1.0], p0=[0, 0], h=0.01, steps=60, every=20)
    run = pendulum.integrate([0.8, 1.0], p0=[0, 0], h=0.01, steps=60, every=20, tangents=4)
    for k in range(1, 4):
        moved = run.tangent[k] @ directions(4, 4)
        units = moved / np.linalg.norm(moved, axis=0)
        for count in (2, 3, 4):
            volume = np.sqrt(np.linalg.det(units[:, :count].T @ units[:, :count]))
            assert abs(chaos.gali[k - 1, count - 2] / volume - 1) < 1e-10
        growth = np.log(np.linalg.norm(moved[:, 0])) / (0.2 * k)
        assert abs(chaos.history[k - 1, 0] - growth) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scheme"),
    sweep(
        [
            ("double_pendulum", "simpson"),
            ("henon_heiles", "gauss8"),
            ("lagrange_top", "gauss4"),
            ("fermi_pasta_ulam", "simpson"),
        ],
        1,
    ),
)
def test_ensembles_tell_what_single_runs_tell(name, scheme):
    system = getattr(ss.systems, name)()
    stepper, state = ss.compile(system, scheme), dict(system.reference_state)
    q0 = np.array(state.pop("q0"), dtype=float)
    starts = q0 + 0.01 * np.arange(11)[:, None]
    reduce = {"lambda": "lyapunov", "megno": "megno", "sali": "sali"}
    first = stepper.coordinates[0]
    both = {**reduce, "highest": ("max", first)}
    found = stepper.ensemble(starts, **state, h=0.01, steps=210, reduce=both)
    alone = stepper.ensemble(starts, **state, h=0.01, steps=210, reduce=reduce, threads=1)
    plain = stepper.ensemble(starts, **state, h=0.01, steps=210, reduce={"highest": ("max", first)})
    assert np.allclose(found.reduced["highest"], plain.reduced["highest"], rtol=1e-12)
    for key in reduce:
        assert np.array_equal(found.reduced[key], alone.reduced[key])
    for k in (0, 10):
        chaos = stepper.lyapunov(starts[k], **state, h=0.01, steps=210, exponents=2)
        told = [chaos.exponents[0], chaos.megno[-1], chaos.sali[-1]]
        assert np.allclose(told, [found.reduced[key][k] for key in reduce], rtol=1e-9)


@pytest.mark.slow
def test_stored_states_do_not_disturb_what_is_told(pendulum):
    given = {"p0": [0, 0], "h": 0.01, "steps": 100, "reduce": {"l": "lyapunov"}}
    every = pendulum.ensemble([[2.0, 2.5], REGULAR], **given, every=7)
    last = pendulum.ensemble([[2.0, 2.5], REGULAR], **given)
    assert np.array_equal(every.reduced["l"], last.reduced["l"])


def test_what_cannot_be_told_is_refused(pendulum):
    for match, changed in {
        "has 4 of them": {"exponents": 5},
        "made orthonormal after 20": {"steps": 10},
    }.items():
        with pytest.raises(ss.InputError, match=match):
            pendulum.lyapunov(REGULAR, p0=[0, 0], **{"h": 0.01, "steps": 100, **changed})
    with pytest.raises(ss.InputError, match="Take 20 at least"):
        pendulum.ensemble([REGULAR], p0=[0, 0], h=0.01, steps=10, reduce={"l": "lyapunov"})
    with pytest.raises(ss.InputError, match="lyapunov, megno, sali"):
        pendulum.ensemble([REGULAR], p0=[0, 0], h=0.01, steps=10, reduce={"l": "chaos"})


@pytest.mark.slow
def test_exponents_are_drawn(pendulum):
    chaos = pendulum.lyapunov(REGULAR, p0=[0, 0], h=0.01, steps=100)
    assert len(chaos.plot().lines) == 4
    assert "exponents" in repr(chaos)
