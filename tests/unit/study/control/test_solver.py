"""Small distances, small costs, and what a guess says little of."""

import warnings

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

pytest.importorskip("casadi")

(x,), u, s = ss.coordinates("x"), *sp.symbols("u s", real=True)
REST = {x: 0, x.diff(): 0}


def body(mass=1, potential=0 * x):
    return ss.MechanicalSystem(
        "body",
        coordinates=(x,),
        kinetic=mass * x.diff() ** 2 / 2,
        potential=potential,
        forces={x: u},
        inputs=(u,),
    )


def moved(far=0, speed=0, mass=1, second=1, begin=0, scheme="simpson", **more):
    """Go so far from rest to rest, or come to rest again where one begins, at a speed."""
    return ss.OptimalControl(
        body(mass),
        cost=u**2,
        start={x: begin, x.diff(): speed},
        end={x: begin + far, x.diff(): 0},
        duration=second,
        **more,
    ).solve(scheme, steps=8)


@pytest.mark.parametrize("small", [1e-6, 1e-9, 1e-13, 1e-20])
def test_small_distances_and_velocities_count(small):
    """By u = (12 t - 6) x and u = (6 t - 4) v."""
    found = moved(far=small)
    assert found.success
    assert found.cost == pytest.approx(12 * small**2, rel=1e-9, abs=0)
    found = moved(speed=small)
    assert found.success
    assert found.cost == pytest.approx(4 * small**2, rel=1e-9, abs=0)
    assert found.p[0, 0] == pytest.approx(small, rel=1e-9, abs=0)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["simpson", "lobatto6", "gauss6"])
@pytest.mark.parametrize("mass", [1e-27, 1e24])
@pytest.mark.parametrize("second", [1e-15, 3e7])
def test_neither_masses_nor_times_matter(mass, second, scheme):
    for far in (1e-10, 1.0, 1e11):
        unit = (mass * far) ** 2 / second**3
        found = moved(far=far, mass=mass, second=second, scheme=scheme)
        assert found.success
        assert found.cost == pytest.approx(12 * unit, rel=1e-9, abs=0)
        found = moved(speed=far / second, mass=mass, second=second, scheme=scheme)
        assert found.cost == pytest.approx(4 * unit, rel=1e-9, abs=0)


@pytest.mark.slow
def test_small_distances_count_far_from_0_and_within_wide_bounds():
    far = sp.Rational("1e-9")
    assert moved(far=far, begin=1).cost == pytest.approx(12e-18, rel=1e-6, abs=0)
    assert moved(speed=1e-9, begin=1).cost == pytest.approx(4e-18, rel=1e-6, abs=0)
    found = moved(speed=1e-9, bounds={x: (-10, 10), u: (-5, 5), x.diff(): (-3, 3)})
    assert found.cost == pytest.approx(4e-18, rel=1e-6, abs=0)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-9, 1, 1e6])
def test_a_motion_that_is_far_larger_than_its_guess_is_found(unit):
    """Of the guess a start is known that is small beside the motion."""
    near = {x: 1e-9 * unit, x.diff(): 0}
    signal = {s: lambda t: unit * np.sin(3 * t)}
    cost = (x - s) ** 2 + u**2
    found, right = (
        ss.OptimalControl(body(), cost=cost, start=start, duration=3, signals=signal).solve(
            "gauss6", steps=10
        )
        for start in (near, REST)
    )
    assert found.status is ss.ControlStatus.SOLVED
    assert found.cost == pytest.approx(right.cost, rel=1e-7, abs=0)
    falling = body(potential=9.81 * unit * x)
    problem = ss.OptimalControl(
        falling, cost=(x + 2 * unit) ** 2 + u**2 / 100, start=near, duration=1
    )
    found = problem.solve("gauss6", steps=10)
    assert found.status is ss.ControlStatus.SOLVED
    assert found.cost / unit**2 == pytest.approx(1.7320362, rel=1e-6)


def test_the_error_of_a_cost_of_0_is_relative_to_the_guess():
    oscillator = body(potential=x**2 / 2)
    given = {"start": {x: 1, x.diff(): 0}, "duration": 3}
    followed = ss.OptimalControl(oscillator, cost=(x - sp.cos(ss.time)) ** 2 + u**2, **given)
    exact = {x: sp.cos(ss.time)}  # whose cost is 0, too
    for guess in (None, exact):
        found = followed.solve("lobatto6", steps=10, error=1e-8, guess=guess)
        assert found.layout.steps <= 80
        assert found.cost < 1e-15
        assert found.error < 1e-8
    # a motion without inputs that meets all conditions
    for end in ({x: np.cos(3), x.diff(): -np.sin(3)}, {x: np.cos(3)}):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = ss.OptimalControl(oscillator, cost=u**2, end=end, **given).solve(
                "lobatto6", steps=10, error=1e-8
            )
        assert found.layout.steps <= 80


def test_the_error_of_a_cost_is_relative_to_it_where_the_guess_costs_nothing():
    found = moved(far=1e-6, scheme="midpoint")
    problem = ss.OptimalControl(
        body(), cost=u**2, start=REST, end={x: 1e-6, x.diff(): 0}, duration=1
    )
    finer = problem.solve("midpoint", steps=8, error=1e-3)
    assert finer.error < 1e-3
    assert abs(finer.cost / 12e-12 - 1) < 2e-3 < abs(found.cost / 12e-12 - 1)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["lobatto6", "gauss4"])
@pytest.mark.parametrize(
    ("kg", "metre", "second"),
    [(1, 1, 1), (1e-27, 1e-10, 1e-15), (1e24, 1e11, 3e7), (1e3, 1e-3, 60), (1, 1, 1e-9)],
)
def test_a_swing_up_is_found_in_the_same_way_in_all_units(kg, metre, second, scheme):
    """Kelly's cart-pole: 58.80766746, SIAM Review 59 (2017) 849."""
    th, newton = sp.Function("th")(ss.time), kg * metre / second**2
    m, l, g = 0.3 * kg, 0.5 * metre, 9.81 * metre / second**2
    system = ss.MechanicalSystem(
        "cart_pole",
        coordinates=(x, th),
        kinetic=(kg + m) * x.diff() ** 2 / 2
        + m * l * x.diff() * th.diff() * sp.cos(th)
        + m * l**2 * th.diff() ** 2 / 2,
        potential=-m * g * l * sp.cos(th),
        forces={x: u},
        inputs=(u,),
    )
    rest = {x.diff(): 0, th.diff(): 0}
    found = ss.OptimalControl(
        system,
        cost=u**2,
        start={x: 0, th: 0, **rest},
        end={x: metre, th: sp.pi, **rest},
        duration=2 * second,
        bounds={u: (-20 * newton, 20 * newton), x: (-2 * metre, 2 * metre)},
    ).solve(scheme, steps=40)
    assert found.status is ss.ControlStatus.SOLVED
    assert found.iterations <= 14
    assert found.cost / (newton**2 * second) == pytest.approx(58.80766746, rel=1e-4)
