"""Members that need more than their block gives: they fail alone, or are run by themselves."""

import warnings

import numpy as np
import pytest

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
