"""Orders of steps with velocity constraints, on systems with M(q), forces, time and b."""

import numpy as np
import pytest
from support.cases import sweep
from support.rolling import allowed_state, carried_by_time

import symsimpson as ss

SCHEMES = {
    "midpoint": 2,
    "simpson": 4,
    "gauss4": 4,
    "lobatto2": 2,
    "lobatto6": 6,
    "gauss6": 6,
    "lobatto8": 8,
    "gauss8": 8,
    "radau3": 3,
    "radau5": 5,
}
#: Steps from which errors are those of the scheme, and above rounding.
STEPS = {2: (40, 80, 160), 3: (40, 80, 160), 4: (40, 80, 160), 5: (20, 40, 80), 6: (20, 40, 80)}


def ends(system, state, scheme, t_end, counts):
    stepper = ss.compile(system, scheme)
    for steps in counts:
        run = stepper.integrate(**state, h=t_end / steps, steps=steps, every=steps)
        yield np.concatenate([run.q[-1], run.v[-1]])


def orders(system, state, scheme, t_end):
    counts = STEPS.get(SCHEMES[scheme], (5, 10, 20))
    (truth,) = ends(system, state, "gauss12", t_end, (150,))
    errors = [np.abs(end - truth).max() for end in ends(system, state, scheme, t_end, counts)]
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize("scheme", sweep(sorted(SCHEMES, key="simpson".__ne__)))
def test_order_with_rows_that_move(scheme):
    """Two rows, of which both depend on the time, M(q), a gyroscopic term, damping and a drive."""
    system = carried_by_time()
    found = orders(system, allowed_state(system), scheme, 2.0)
    assert abs(found[-1] - SCHEMES[scheme]) < (0.15 if SCHEMES[scheme] < 8 else 0.6)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
def test_order_of_a_rolling_disc(scheme):
    disc = ss.systems.rolling_disc()
    found = orders(disc, dict(disc.reference_state), scheme, 1.0)
    assert abs(found[-1] - SCHEMES[scheme]) < (0.15 if SCHEMES[scheme] < 8 else 0.6)


@pytest.mark.slow
def test_energy_and_constraints_of_a_long_run():
    """No drift in a million steps; the energy swings by as much in each quarter."""
    disc = ss.systems.rolling_disc()
    run = ss.compile(disc).integrate(**disc.reference_state, h=0.02, steps=1_000_000, every=50)
    quarters = np.array_split(run.energy_error, 4)
    swings = [np.abs(part).max() for part in quarters]
    assert max(swings) < 1.02 * min(swings)
    means = np.array([part.mean() for part in quarters])
    assert np.abs(means - means.mean()).max() < 0.02 * max(swings)
    assert np.abs(run.velocity_constraint_error).max() < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["gauss4", *sweep(["midpoint", "lobatto6"], 0)])
def test_work_of_constraints_has_the_order_of_the_scheme(scheme):
    ball = ss.systems.ball_on_turntable()
    stepper, left = ss.compile(ball, scheme), []
    for steps in (20, 40):
        run = stepper.integrate(**ball.reference_state, h=2 / steps, steps=steps, record="work")
        left.append(np.abs(run.energy_balance).max())
        assert np.array_equal(run.work["constraints"], run.work["total"])
    assert abs(np.log2(left[0] / left[1]) - SCHEMES[scheme]) < 0.2
    with pytest.raises(ss.InputError, match="moving constraints do work"):
        run.energy_error  # noqa: B018
