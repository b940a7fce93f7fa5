"""The difference of two runs along their path: what it is relative to, and where it is taken."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.study.analysis.candidates import PathError, compare_paths

x, y = ss.coordinates("x y")


def compared(system, q0, p0, *, h=0.5, steps=8, bound=1e-3, **given):
    stepper = ss.compile(system)
    coarse, fine = (stepper.integrate(q0, p0=p0, h=h / k, steps=k * steps, **given) for k in (1, 2))
    return coarse, fine, compare_paths(coarse, fine, h * steps, bound)


def test_the_whole_path_counts_and_not_its_end():
    """Friction brings all paths to rest."""
    system = ss.MechanicalSystem(
        "damped",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=x**2 / 2,
        dissipation=x.diff() ** 2,
    )
    coarse, fine, found = compared(system, [1.0], [0.0], h=1.0, steps=30)
    assert abs(coarse.q[-1] - fine.q[-1]) < 1e-10
    off = np.abs(coarse.q - fine.q[::2]).max()
    assert found.largest >= off > 1e-3
    assert found.violation_time == 1.0


@pytest.mark.parametrize("constant", [0.0, 3.0, 3e9])
def test_momenta_are_relative_to_their_change(constant):
    """A constant one, however large, does not hide what another does; zero divides nothing."""
    system = ss.MechanicalSystem(
        "beside",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=1 - sp.cos(x),
        units={"x": "rad", "y": "m"},
    )
    _, _, found = compared(system, [1.0, 0.0], [0.0, constant])
    alone = ss.MechanicalSystem(
        "alone", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=1 - sp.cos(x)
    )
    assert found.largest == pytest.approx(compared(alone, [1.0], [0.0])[2].largest, rel=1e-6)


@pytest.mark.parametrize("q0", [0.0, -1.1 * 9.81 / 7.3])
def test_at_an_equilibrium_rounding_is_no_error(q0):
    system = ss.MechanicalSystem(
        "hanging",
        coordinates=(x,),
        kinetic=1.1 * x.diff() ** 2 / 2,
        potential=7.3 * x**2 / 2 + (1.1 * 9.81 * x if q0 else 0),
    )
    _, _, found = compared(system, [q0], [0.0])
    assert found == PathError(pytest.approx(0.0, abs=1e-14))


@pytest.mark.parametrize("meter", [1e-27, 1e24])
def test_units_do_not_matter(meter):
    """Coordinates of one unit are relative to the one that moves most."""
    system = ss.MechanicalSystem(
        "two_units",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 / meter**2 + y.diff() ** 2) / 2,
        potential=1 - sp.cos(x / meter) + y**2 / 2,
        units={"x": "m", "y": "rad"},
    )
    _, _, found = compared(system, [meter, 1.0], [0.5 / meter, 0.0])
    assert found.largest == pytest.approx(1.335518e-4, rel=1e-5)


def test_velocities_jump_at_impacts_in_both_runs():
    ball = ss.MechanicalSystem(
        "ball", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=1 - sp.cos(x - 2)
    )
    floor = ss.Event(x, name="floor", action=ss.Impact(0.9))
    coarse, fine, found = compared(ball, [1.5], [-2.0], h=0.05, steps=40, events=[floor])
    assert [record.t for record in coarse.records] != [record.t for record in fine.records]
    assert found.largest < 1e-4
    other = compare_paths(
        coarse,
        ss.compile(ball).integrate(
            [1.5],
            p0=[-2.0],
            h=0.025,
            steps=80,
            events=[ss.Event(x, name="floor", action=ss.Impact())],
        ),
        2.0,
        1e-3,
    )
    assert other.violation_time == pytest.approx(coarse.records[0].t, abs=0.05)


def test_an_event_ends_both_runs_at_nearly_the_same_time():
    swing = ss.systems.pendulum()
    stop = ss.Event("theta - 0.5", name="stop", terminal=True)
    coarse, fine, found = compared(swing, [1.0], [0.0], h=0.05, steps=40, events=[stop])
    assert coarse.ended_by == fine.ended_by == "stop"
    assert coarse.t[-1] != fine.t[-1]
    assert found.largest < 1e-3
    late = compare_paths(
        coarse, ss.compile(swing).integrate([1.0], p0=[0.0], h=0.025, steps=80), 2.0, 1e-3
    )
    assert late.largest > 0.1  # it does not end there


def test_a_run_that_fails_has_no_bound():
    steep = ss.MechanicalSystem(
        "steep", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=sp.log(x)
    )
    stepper = ss.compile(steep)
    fails = stepper.integrate([1.0], p0=[-1.0], h=0.1, steps=40, on_failure="return")
    assert not fails.success
    assert compare_paths(fails, fails, 4.0, 1e-3) == PathError(np.inf, float(fails.t[-1]))
