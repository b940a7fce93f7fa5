"""Members of an ensemble that are run once more: they fail, or their steps are in doubt."""

import warnings

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss


@pytest.mark.slow
def test_members_that_fail_leave_the_others_alone():
    """A planet without angular momentum falls into its sun; those beside it do not notice."""
    stepper = ss.compile(ss.systems.kepler(), exploit=())
    q0 = np.tile([1.0, 0.0], (20, 1))
    p0 = np.column_stack([np.zeros(20), np.linspace(0.8, 1.2, 20)])
    healthy = stepper.ensemble(q0, p0=p0, h=0.02, steps=200, every=20)
    p0[[3, 17], 1] = 0.0
    found = stepper.ensemble(q0, p0=p0, h=0.02, steps=200, every=20)
    bad = np.isin(np.arange(20), (3, 17))
    assert (found.status[~bad] == 0).all()
    assert (found.status[bad] > ss.Status.INTERRUPTED).all()
    assert (found.q[~bad] == healthy.q[~bad]).all()
    assert found.message.startswith("18 SUCCESS, 2 ")
    run = stepper.integrate(q0[3], p0=p0[3], h=0.02, steps=200, every=20, on_failure="return")
    assert found.status[3] == run.status
    assert found.steps[3] == run.steps
    assert (found.q[3, : len(run.q)] == run.q).all()
    assert np.isnan(found.q[3, len(run.q) :]).all()


@pytest.mark.slow
def test_members_that_fail_are_not_warned_of_one_by_one():
    """Their steps are too large; a figure of 64 by 64 members would warn thousands of times."""
    springs = np.array([1e2, 5e3, 8e3, 1e4])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = ss.compile(ss.systems.elastic_pendulum()).ensemble(
            [1.02, 0.4], v0=[0.0, 0.0], h=0.0561, steps=400, parameters={"k": springs}
        )
    assert [one.category for one in told] == [ss.StabilityWarning, ss.ResolutionWarning]
    assert "member 1: " in str(told[0].message)
    assert "h omega is 3.97" in str(told[0].message)
    assert found.status.tolist() == [0, 0, *[ss.Status.STEP_TOO_LARGE] * 2]


@pytest.mark.slow
def test_members_that_only_robust_kernels_take_are_reduced_too():
    """An angle of 1e9 rad is beyond the quick sine; its member is run again by itself."""
    stepper = ss.compile(ss.systems.pendulum())
    turn = 2 * np.pi * 159154943
    angles = np.array([[0.5], [0.5 + turn], [1.0]])
    reduce = {
        "lowest": ("min", "theta"),
        "mean": ("mean", "sin(theta)**2 + min(theta, 0)*0"),
        "crossing": ("first", "-p_theta - 0.1"),
        "never": ("first", "-2*pi"),
        "at once": ("first", "atan2(1, 2) + t"),
    }
    given = {"v0": [0.0], "h": 0.05, "steps": 100, "reduce": reduce}
    found = stepper.ensemble(angles, every=10, **given)
    assert (found.status == 0).all()
    assert np.isfinite(found.q).all()
    assert found.reduced["lowest"][1] == pytest.approx(found.reduced["lowest"][0] + turn, abs=1e-5)
    for name in ("mean", "crossing"):
        assert found.reduced[name][1] == pytest.approx(found.reduced[name][0], abs=1e-5)
    assert np.isnan(found.reduced["never"][1])
    assert found.reduced["at once"][1] == 0
    last = stepper.ensemble(angles, **given)
    assert (last.q[1] == found.q[1, -1]).all()


@pytest.mark.slow
def test_a_start_at_a_singular_point_has_its_status():
    stepper = ss.compile(ss.systems.spherical_pendulum())
    q0 = np.tile([1.0, 0.5], (9, 1))
    q0[4] = 0.0
    found = stepper.ensemble(q0, p0=[0.1, 0.1], h=0.01, steps=10)
    assert found.status.tolist() == [0] * 4 + [ss.Status.BAD_INPUT] + [0] * 4
    assert found.steps[4] == 0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.ResolutionWarning")
def test_members_whose_nodes_are_not_solved_go_on_with_newtons_method():
    stepper = ss.compile(ss.systems.double_pendulum(), "gauss8")
    q0 = np.linspace(0.5, 3, 8)[:, None] * [1, -1]
    given = {"v0": [0, 0], "h": 0.07, "steps": 100, "every": None}
    found = stepper.ensemble(q0, **given)
    for member in range(8):  # the last ones need it, and it tells that their steps are too large
        run = stepper.integrate(q0[member], **given, on_failure="return")
        assert (found.status[member], found.steps[member]) == (run.status, run.steps)
        assert (found.q[member] == run.q[-1]).all()
    assert found.status[7] == ss.Status.STEP_TOO_LARGE


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
    with pytest.warns(ss.ResolutionWarning, match="member 3, and possibly others: comet") as told:
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
    told = (
        "member 0, and possibly others, does not reach its end in a single run: "
        "quartic, gauss8: step 112"
    )
    with pytest.warns(ss.ResolutionWarning, match=told):
        stepper.ensemble([[1.0], [0.0]], v0=[0.5], h=3.5, steps=400)


def test_where_no_member_could_begin_it_says_why():
    (r,) = ss.coordinates("r")
    system = ss.MechanicalSystem(
        "shrinking", coordinates=(r,), kinetic=(2 - r) * r.diff() ** 2 / 2, potential=0
    )
    stepper = ss.compile(system, "gauss4")
    with pytest.raises(ss.InputError, match="not positive definite"):
        stepper.ensemble([[10.0]] * 8, v0=[1.2], h=0.1, steps=10)


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
        with pytest.warns(ss.ResolutionWarning, match="member 22, and possibly others"):
            stepper.ensemble([1.0, 0.0], v0=v0, h=0.05, t_end=10.0, every=every)


def test_a_member_tells_the_time_of_its_steps():
    stepper = ss.compile(ss.systems.kepler().retimed("encounters"))
    many = stepper.ensemble(STARTS[:2], v0=SPEEDS[:2], h=0.1, steps=4, every=2)
    run = stepper.integrate(STARTS[1], v0=SPEEDS[1], h=0.1, steps=4, every=2)
    assert (many[1].tau == run.tau).all()
    assert (many[1].tau == many.tau[1]).all()
