"""What ensembles tell of members whose steps did not resolve the motion."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss


def kepler(drag=0.0):
    x, y = ss.coordinates("x y")
    c = sp.Symbol("c")
    return ss.MechanicalSystem(
        "comet",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-1 / sp.sqrt(x**2 + y**2),
        parameters={c: drag},
        dissipation=c * (x.diff() ** 2 + y.diff() ** 2) / 2,
    )


#: Far end of orbits: the first three are nearly circles, the last comes to 0.026 of the centre.
STARTS = np.array([[1.0, 0.0], [1.1, 0.0], [1.2, 0.0], [1.9, 0.0]])
SPEEDS = np.array([[0.0, 1.0], [0.0, 0.95], [0.0, 0.9], [0.0, 0.16]])


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, None])
@pytest.mark.parametrize("drag", [0.0, 1e-6])
def test_one_member_that_is_not_resolved(drag, every):
    """Its energy is off by more than 1 behind the encounter; friction explains 1e-5 of it."""
    stepper = ss.compile(kepler(drag), "simpson")
    given = {"h": 0.02, "steps": 2000, "every": every}
    with pytest.warns(ss.ResolutionWarning, match="member 3, as others may: comet") as told:
        stepper.ensemble(STARTS, v0=SPEEDS, **given)
    assert len(told) == 1
    stepper.ensemble(STARTS[:3], v0=SPEEDS[:3], **given)  # in silence


def test_steps_that_turn_by_more_than_half_a_turn():
    """A charge in a field B turns by h B; from pi on it looks as if it turned the other way."""
    x, y = ss.coordinates("x y")
    B = sp.Symbol("B")
    system = ss.MechanicalSystem(
        "charge",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        gyroscopic=B / 2 * (x * y.diff() - y * x.diff()),
        potential=0,
        parameters={B: 1.0},
    )
    stepper = ss.compile(system, "midpoint")
    given = {"v0": [1.0, 0.0], "h": 0.1, "steps": 50}
    stepper.ensemble([0.0, 0.0], parameters={"B": [1.0, 3.0, 30.0]}, **given)
    with pytest.warns(ss.StabilityWarning, match=r"member 2: charge, midpoint: .*turns by 3.2 rad"):
        stepper.ensemble([0.0, 0.0], parameters={"B": [1.0, 30.0, 32.0]}, **given)


@pytest.mark.filterwarnings("ignore::symsimpson.errors.StabilityWarning")
@pytest.mark.parametrize("every", [1, None])
def test_members_far_beyond_stability_end_as_single_runs_do(every):
    """Positions grow to 1e200, whose squares are no numbers."""
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "spring", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=x**2 / 2
    )
    stepper = ss.compile(system, "suzuki4")
    given = {"v0": [0.5], "h": 30.0, "steps": 20, "every": every}
    single = stepper.integrate([1.0], **given, on_failure="return")
    many = stepper.ensemble([[1.0], [0.0]], **given)
    assert single.status is ss.Status.NOT_FINITE
    assert (many.status == single.status).all()
    assert many.steps[0] == single.steps


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.errors.StabilityWarning")
def test_members_that_fail_by_themselves_are_told():
    """Lanes do not look at the energy of each step, at which a single run ends."""
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "quartic", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=x**4 / 4
    )
    stepper = ss.compile(system, "gauss8")
    told = "member 0, as others may, does not come to its end by itself: quartic, gauss8: step 112"
    with pytest.warns(ss.ResolutionWarning, match=told):
        stepper.ensemble([[1.0], [0.0]], v0=[0.5], h=3.5, steps=400)


def test_where_no_member_could_begin_it_says_why():
    tau, r, phi = ss.coordinates("tau r phi")
    f = 1 - 2 / r
    metric = (-f * tau.diff() ** 2 + r.diff() ** 2 / f + r**2 * phi.diff() ** 2) / 2
    system = ss.MechanicalSystem("metric", coordinates=(tau, r, phi), kinetic=metric, potential=0)
    stepper = ss.compile(system, "gauss4")
    with pytest.raises(ss.InputError, match="not positive definite"):
        stepper.ensemble([[0, 10.0, 0]] * 8, v0=[1.2, 0, 0.04], h=0.1, steps=10)


@pytest.mark.slow
def test_the_energy_of_each_of_many_members_is_looked_at():
    """Member 22 of 1000 falls into the centre and comes out at x = 9163, its energy at 531011."""
    v0 = np.tile([0.0, 1.0], (1000, 1))
    v0[22] = 0.0
    x, y = ss.coordinates("x y")
    kinetic, centre = (x.diff() ** 2 + y.diff() ** 2) / 2, -1 / sp.sqrt(x**2 + y**2)
    about = {"kinetic": kinetic, "potential": centre, "parameters": {}}
    system = ss.MechanicalSystem("comet", coordinates=(x, y), **about)
    stepper = ss.compile(system, "suzuki4")
    for every in (None, 50):
        with pytest.warns(ss.ResolutionWarning, match="member 22, as others may"):
            stepper.ensemble([1.0, 0.0], v0=v0, h=0.05, t_end=10.0, every=every)


def test_a_member_tells_the_time_of_its_steps():
    stepper = ss.compile(ss.systems.kepler().retimed("encounters"))
    many = stepper.ensemble(STARTS[:2], v0=SPEEDS[:2], h=0.1, steps=4, every=2)
    run = stepper.integrate(STARTS[1], v0=SPEEDS[1], h=0.1, steps=4, every=2)
    assert (many[1].tau == run.tau).all()
    assert (many[1].tau == many.tau[1]).all()
