"""Indicators of chaos: values that are known, and the same of single runs and of ensembles."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.run.lyapunov import STEP_PART, initial_variations, random_directions

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
    chaos = pendulum.lyapunov([0.8, 1.0], p0=[0, 0], h=0.01, steps=60, every=20)
    run = pendulum.integrate([0.8, 1.0], p0=[0, 0], h=0.01, steps=60, every=20, tangents=4)
    part = pendulum.integrate([0.8, 1.0], p0=[0, 0], h=STEP_PART * 0.01, steps=1, tangents=4)
    *columns, weights = initial_variations(part.tangent[1], 0.01, 4).T
    for k in range(1, 4):
        moved = np.sqrt(weights)[:, None] * (run.tangent[k] @ np.transpose(columns))
        units = moved / np.linalg.norm(moved, axis=0)
        for count in (2, 3, 4):
            volume = np.sqrt(np.linalg.det(units[:, :count].T @ units[:, :count]))
            assert abs(chaos.gali[k - 1, count - 2] / volume - 1) < 1e-10
        growth = np.log(np.linalg.norm(moved[:, 0])) / (0.2 * k)
        assert abs(chaos.history[k - 1, 0] - growth) < 1e-12


def test_variations_have_lengths_without_units():
    """Of an oscillator in metres and seconds, and the same in other units."""
    weights = []
    for kg, m, s in ((1.0, 1.0, 1.0), (1e-27, 1e-10, 1e-15)):
        h, mass, k = 0.8 * s, 2.0 * kg, 18.0 * kg / s**2
        turn, omega = STEP_PART * h * np.sqrt(k / mass), np.sqrt(k / mass)
        d = np.array(
            [
                [np.cos(turn), np.sin(turn) / (mass * omega)],
                [-np.sin(turn) * mass * omega, np.cos(turn)],
            ]
        )
        columns = initial_variations(d, h, 2)
        q, p = m, kg * m / s
        weights.append(columns[:, 2] * [q**2, p**2] / (kg * m**2 / s))
        product = columns[:, :2].T @ (columns[:, 2:] * columns[:, :2])
        np.testing.assert_allclose(product, np.eye(2), atol=1e-15)
        assert columns[0, 2] * columns[1, 2] == pytest.approx(1, rel=1e-15)
    np.testing.assert_allclose(*weights, rtol=1e-14)
    assert weights[0][0] == pytest.approx(2.0 * 3.0, rel=0.02)  # m omega; 1/m is that of a step


def test_pairs_of_first_variations_are_conjugate():
    columns = random_directions(6, 6)
    J = np.kron([[0, 1], [-1, 0]], np.eye(3))
    np.testing.assert_allclose(columns.T @ columns, np.eye(6), atol=1e-15)
    form = columns.T @ J @ columns
    np.testing.assert_allclose(np.abs(form), np.eye(6)[::-1], atol=1e-15)
    np.testing.assert_allclose(random_directions(6, 2), columns[:, :2], atol=1e-15)


KG, METRE, SECOND = (1.0, 1e-27, 1e24, 1.7), (1.0, 1e-10, 1e11, 0.3), (1.0, 1e-15, 3.2e7, 2.9)


def henon_heiles():
    x, y = ss.coordinates("x y")
    M, a, w = sp.symbols("M a w", positive=True)
    potential = M * w**2 * ((x**2 + y**2) / 2 + (x**2 * y - y**3 / 3) / a)
    kinetic = M * (x.diff() ** 2 + y.diff() ** 2) / 2
    values = {M: 1.0, a: 1.0, w: 1.0}
    system = {"coordinates": (x, y), "kinetic": kinetic, "potential": potential}
    return ss.MechanicalSystem("units", **system, parameters=values), lambda kg, m, s: (
        {"q0": [0, 0.1 * m], "v0": [0.3 * m / s, 0]},
        {"M": kg, "a": m, "w": 1 / s},
    )


def cart():
    """Metres beside radians, from rest, with drag."""
    x, theta = ss.coordinates("x theta")
    M, l, g, k, c = sp.symbols("M l g k c", positive=True)
    turning = l * x.diff() * theta.diff() * sp.cos(theta)
    system = ss.MechanicalSystem(
        "cart",
        coordinates=(x, theta),
        kinetic=M * (x.diff() ** 2 + turning + l**2 * theta.diff() ** 2 / 2),
        potential=M * g * l * (1 - sp.cos(theta)) + k * x**2 / 2,
        parameters=dict.fromkeys((M, l, g, k, c), 1.0),
        dissipation=c * x.diff() ** 2 / 2,
    )
    return system, lambda kg, m, s: (
        {"q0": [0.1 * m, 0.4], "v0": [0, 0]},
        {"M": kg, "l": m / 2, "g": 9.81 * m / s**2, "k": 3 * kg / s**2, "c": 0.1 * kg / s},
    )


def bead():
    """A particle on a circle, in Cartesian coordinates."""
    x, y = ss.coordinates("x y")
    M, l, g = sp.symbols("M l g", positive=True)
    system = ss.MechanicalSystem(
        "bead",
        coordinates=(x, y),
        kinetic=M * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=M * g * y,
        parameters={M: 1.0, l: 1.0, g: 1.0},
        constraints=[x**2 + y**2 - l**2],
    )
    return system, lambda kg, m, s: (
        {"q0": [m, 0], "v0": [0, 0]},
        {"M": kg, "l": m, "g": 9.81 * m / s**2},
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "scheme", "h"),
    [(henon_heiles, "gauss8", 0.1), (cart, "simpson", 0.02), (bead, "midpoint", -0.02)],
)
def test_indicators_do_not_depend_on_units(make, scheme, h):
    system, values = make()
    stepper, told = ss.compile(system, scheme), []
    reduce = {"lambda": "lyapunov", "megno": "megno", "sali": "sali"}
    for kg, m, s in zip(KG, METRE, SECOND, strict=True):
        start, parameters = values(kg, m, s)
        how = start | {"h": h * s, "parameters": parameters, "steps": 1000}
        chaos = stepper.lyapunov(**how)
        told.append([*s * chaos.exponents, chaos.megno[-1], chaos.sali[-1], *chaos.gali[-1]])
        if system.constraints:
            continue
        if stepper.program.header.conservative:
            assert np.abs(chaos.exponents + chaos.exponents[::-1]).max() * s < 1e-12
        many = stepper.ensemble(**how | {"q0": [start["q0"]] * 3}, reduce=reduce).reduced
        pair = stepper.lyapunov(**how, exponents=2)
        right = [pair.exponents[0], pair.megno[-1], pair.sali[-1]]
        np.testing.assert_allclose([many[key][2] for key in reduce], right, rtol=1e-9)
    np.testing.assert_allclose(told[1:], [told[0]] * 3, rtol=1e-8)


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
        "has 4 Lyapunov exponents": {"exponents": 5},
        "fewer than every=20": {"steps": 10},
    }.items():
        with pytest.raises(ss.InputError, match=match):
            pendulum.lyapunov(REGULAR, p0=[0, 0], **{"h": 0.01, "steps": 100, **changed})
    with pytest.raises(ss.InputError, match="Take at least 20 steps"):
        pendulum.ensemble([REGULAR], p0=[0, 0], h=0.01, steps=10, reduce={"l": "lyapunov"})
    with pytest.raises(ss.InputError, match="lyapunov, megno, sali"):
        pendulum.ensemble([REGULAR], p0=[0, 0], h=0.01, steps=10, reduce={"l": "chaos"})


@pytest.mark.slow
def test_exponents_are_drawn(pendulum):
    chaos = pendulum.lyapunov(REGULAR, p0=[0, 0], h=0.01, steps=100)
    assert len(chaos.plot().lines) == 4
    assert "exponents" in repr(chaos)
