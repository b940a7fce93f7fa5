"""Zeros of roots at which a force jumps, and motions that pass them."""

import time

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.study.analysis.stability.kinks import kink_passed

x, y, z = ss.coordinates("x y z")
a, k = sp.Symbol("a", real=True), sp.Symbol("k", positive=True)
R = sp.sqrt(x**2 + y**2 + z**2)


def system(V, parameters=None, **more):
    kinetic = sum(q.diff() ** 2 for q in (x, y, z)) / 2
    return ss.MechanicalSystem(
        "kinked",
        coordinates=(x, y, z),
        kinetic=kinetic,
        potential=V,
        parameters=parameters or {},
        **more,
    )


#: A straight path past the origin at 1e-6, at t = 1.05, in steps of 0.1.
T = np.arange(0.0, 2.05, 0.1)
PATH = np.stack([T - 1.05, np.full_like(T, 1e-6), 0 * T], axis=1)


@pytest.mark.parametrize(
    ("V", "values", "passed"),
    [
        (R, {}, True),  # the force is a unit vector
        (-4.85 * sp.log(1 + R / 2) / R, {}, True),  # 4.85/8 on both sides
        (k * (R - a) ** 2 / 2, {k: 2.0, a: 0.5}, True),  # k a on both sides
        (sp.exp(-R), {}, True),
        (k * sp.sqrt(x**2) * 0 + sp.sqrt((x**2 + y**2) * k) + z**2, {k: 3.0}, True),
        (sp.sqrt(x**2 + y**2 + a**2), {a: 0.0}, True),
        (sp.sqrt(x**2 + y**2 + a**2), {a: 0.5}, False),
        (sp.sqrt(z**2 + 0.035**2), {}, False),
        (x * y / sp.sqrt(x**2 + y**2), {}, True),
        (-1 / R, {}, False),  # a pole
        (sp.log(R), {}, False),
        (-1 / R + R, {}, False),  # still a pole
        (R**3, {}, False),
        (sp.cos(R), {}, False),  # even in R
        (sp.sin(R) / R, {}, False),
        (sp.sqrt((x - 5) ** 2 + y**2), {}, False),  # elsewhere
        (x**2 + sp.sin(y), {}, False),
        (sp.sqrt(2 + x + y**2), {}, False),
    ],
)
def test_forces_that_jump_are_told_from_those_that_do_not(V, values, passed):
    found = kink_passed(system(V, values), T, PATH, list(values.values()))
    assert (found is not None) == passed
    if passed:
        assert found[0] == pytest.approx(1.05, abs=1e-9)
        assert found[1].startswith("a zero of sqrt(")


def test_the_first_of_several_is_told_as_it_was_written():
    V = sp.sqrt((x - 0.75) ** 2 + y**2) + sp.sqrt((x + 0.55) ** 2 + y**2)
    when, text, remedy = kink_passed(system(V), T, PATH, [])
    assert when == pytest.approx(0.5)
    assert text == "a zero of sqrt((x + 0.55)**2 + y**2)"
    assert "epsilon" in remedy


def test_a_motion_that_goes_around_in_steps_of_its_size_has_not_passed():
    around = np.stack([np.cos(T), np.sin(T), 0 * T], axis=1)
    for size in (1.0, 1e-3, 1e-9):
        assert kink_passed(system(R), T, size * around, []) is None


def test_kinks_of_forces_and_of_retimed_systems():
    forced = system(x**2, forces={y: -k * y / sp.sqrt(x**2 + y**2)}, parameters={k: 1.0})
    across = PATH[:, [1, 0, 2]]
    assert kink_passed(forced, T, across, [1.0])[0] == pytest.approx(1.05)
    driven = system(
        x**2, forces={y: -k * y / sp.sqrt((x - sp.cos(ss.time)) ** 2 + y**2)}, inputs=(k,)
    )
    moving = across + np.stack([np.cos(T), 0 * T, 0 * T], axis=1)
    assert kink_passed(driven, T, moving, [1.0])[0] == pytest.approx(1.05, abs=0.01)
    assert kink_passed(driven, T, across, [1.0]) is None
    retimed = system(R).retimed(1 + x**2)
    assert kink_passed(retimed, T, PATH, [0.5, 1.0]) == kink_passed(system(R), T, PATH, [])
    assert kink_passed(retimed, T, PATH + 1, [0.5, 1.0]) is None


ANGLE = sp.atan2(y, x)
#: Around the origin, through the cut at an angle of pi.
TURN = np.stack([np.cos(3 * T - 1), np.sin(3 * T - 1), 0 * T], axis=1)
CUT = (np.pi + 1) / 3


@pytest.mark.parametrize(
    ("V", "more", "passed"),
    [
        (ANGLE / 4, {}, True),  # V jumps, the force does not
        (ANGLE**2 / 2, {}, True),  # the other way around
        (k * (ANGLE - a) ** 2 / 2, {"parameters": {k: 2.0, a: 0.5}}, True),
        (x**2, {"forces": {x: -y * ANGLE, y: x * ANGLE}}, True),
        (x**2, {"forces": {x: sp.atan2(y.diff(), x.diff())}}, False),  # not looked at
        (sp.cos(ANGLE - 1), {}, False),
        (sp.atan2(y, x + 5), {}, False),
        (sp.atan2(y, -x) + 1000, {}, True),  # at t = 1/3
        (sp.atan2(z, x), {}, False),  # along the cut
    ],
)
def test_cuts_of_angles(V, more, passed):
    values = list(more.get("parameters", {}).values())
    found = kink_passed(system(V, **more), T, TURN, values)
    assert (found is not None) == passed
    if found:
        assert found[0] == pytest.approx(1 / 3 if V.has(-x) else CUT, abs=1e-2)
        assert found[1].startswith("the cut of atan2(y, ")


def test_a_run_across_a_cut_is_told():
    stepper = ss.compile(system(ANGLE / 4), "midpoint")
    with pytest.warns(ss.ResolutionWarning, match=r"the cut of atan2\(y, x\).*\n.*cosine and sine"):
        stepper.integrate([-1, 0.1, 0], v0=[0, -1, 0], h=0.01, t_end=1.0)


def test_a_radial_orbit_in_a_halo_passes_its_cusp():
    V = -4.85 * sp.log(1 + R / 2) / R - 0.757 / sp.sqrt(
        x**2 + y**2 + (0.375 + sp.sqrt(z**2 + 0.035**2)) ** 2
    )
    halo = system(V)
    stepper = ss.compile(halo, "simpson")
    with pytest.warns(ss.ResolutionWarning, match=r"a zero of sqrt\(x\*\*2 \+ y\*\*2 \+ z\*\*2\)"):
        radial = stepper.integrate([1, 0, 0], v0=[0, 0, 0], h=0.02, t_end=2.0)
    when, text, _ = kink_passed(halo, radial.t, radial.q, [])
    k = np.flatnonzero(np.diff(np.sign(radial.q[:, 0])))[0]
    assert radial.t[k] <= when <= radial.t[k + 1]
    assert text == "a zero of sqrt(x**2 + y**2 + z**2)"
    orbit = stepper.integrate([1, 0, 0], v0=[0, 0.8, 0.1], h=0.02, t_end=2.0)
    assert kink_passed(halo, orbit.t, orbit.q, []) is None


def test_long_runs_are_judged_at_once():
    t = np.linspace(0.0, 1e4, 100_001)
    q = np.stack([np.cos(t), 0.3 * np.sin(t), np.sin(1.7 * t)], axis=1)
    for V, seconds in ((R + x**2, 1.0), (x**2, 0.01)):
        held = system(V)
        kink_passed(held, t[:3], q[:3], [])
        begun = time.process_time()
        assert kink_passed(held, t, q, []) is None
        assert time.process_time() - begun < seconds
