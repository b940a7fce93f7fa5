"""The benchmark bicycle: eigenvalues of its upright ride, accelerations, loads, and orders."""

import json

import numpy as np
import pytest
from support.cases import sweep
from support.places import DATA

import symsimpson as ss

GOLDEN = json.loads((DATA / "golden_contact.json").read_text())["exact"]
(EIGENVALUES,) = (case["eigenvalues"] for case in GOLDEN if case["case"] == "whipple_bicycle")
BICYCLE = ss.systems.whipple_bicycle()
#: A scheme whose errors are rounding.
FINE = "gauss6"
#: Steps in a second from which errors are those of the scheme, and above rounding.
STEPS = {"midpoint": (40, 80), "simpson": (40, 80), "gauss4": (40, 80), "lobatto6": (20, 40)}
ORDERS = {"midpoint": 2, "simpson": 4, "gauss4": 4, "lobatto6": 6}


def upright(speed):
    return np.zeros(8), speed * np.array([1, 0, 0, 0, 0, 0, -1 / 0.3, -1 / 0.35])


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("speed", EIGENVALUES)
def test_eigenvalues_of_the_upright_ride(speed):
    """Of D: none for what constraints do not allow, one for a steady ride elsewhere or faster."""
    h = 0.0025
    D = ss.compile(BICYCLE, FINE).tangent(*upright(float(speed)), h=h)[2]
    factors = np.linalg.eigvals(D).astype(complex)
    factors = factors[np.abs(factors) > 1e-6]
    # of positions and momenta, the first constraint takes one each, those of velocities four
    assert len(factors) == 2 * 8 - 2 - 4
    found = list(np.log(factors) / h)
    for real, imaginary in EIGENVALUES[speed]:
        exact = complex(float(real), float(imaginary))
        nearest = min(found, key=lambda x: abs(x - exact))
        assert abs(nearest - exact) < 1e-10
        found.remove(nearest)
    assert np.abs(found).max() < 1e-5  # in a Jordan block rounding counts by its root


@pytest.mark.slow
def test_accelerations_of_a_leaning_bicycle():
    """Far from upright: P. Basu-Mandal, A. Chatterjee, J. M. Papadopoulos, 2007, table 1.

    Proc. R. Soc. A 463, 1983; theirs are z up, a lean that is pi/2 upright and a pitch that is pi.
    """
    angles = [0.0, np.pi / 2 - 0.9501292851472, np.pi - 3.1257073014894, -0.2311385135743]
    rates = [-0.7830033527065, -0.6068425835418, 0.0119185528069, -0.4859824687093]
    rates += [-8.9129896614890, -8.0133620584155]
    accelerations = [-0.8353281706379, 7.8555281128244, -0.1205543897884, 4.6198904039403]
    accelerations += [-1.8472554144217, -2.4548072904550]
    given = [0.0, 0.0, *angles, 0.0, 0.0], [-0.3 * (rates[2] + rates[4]), 0.0, *rates]
    # of 13 digits; what they leave goes to coordinates that follow from the others
    q, v = BICYCLE.consistent(*given, fixed=("lean", "steer", "rear"))
    assert max(np.abs(q - given[0]).max(), np.abs(v - given[1]).max()) < 1e-12
    # differences of doubles would lose the digits asked for
    stepper, h = ss.compile(BICYCLE, FINE, precision=20), 2e-3
    after, before = (stepper.integrate(q, v, h=sign * h, steps=4).v[1:] for sign in (1, -1))
    weights = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
    found = weights @ (after - before).astype(float) / h
    assert np.abs(found[2:] - accelerations).max() < 1e-11


@pytest.mark.slow
@pytest.mark.plain
def test_loads_and_heights():
    """The front wheel carries its share of the weight; masses are where positions say."""
    stepper = ss.compile(BICYCLE)
    ride = stepper.integrate(*upright(4.6), h=0.01, steps=1)
    assert np.abs(ride["lambda_front_contact"] - 9.81 * 32.16 / 1.02).max() < 1e-11
    start = [0.1, 0.2, 0.3, 0.5, 0.0, 0.6, 0.0, 0.0]
    q, v = BICYCLE.consistent(start, [2, 0.4, 0, 0.5, 0, -0.4, -8, -7], fixed=("lean", "steer"))
    run = stepper.integrate(q, v, h=0.01, steps=10)
    masses = {"rear hub": 2.0, "rider": 85.0, "handlebar": 4.0, "front hub": 3.0}
    heights = sum(9.81 * m * run.points[name][:, 2] for name, m in masses.items())
    assert np.abs(heights - (run.energy - run.kinetic_energy)).max() < 1e-11


def test_the_reference_state_is_allowed():
    q, v = BICYCLE.consistent(**BICYCLE.reference_state)
    assert np.abs(q).max() < 1e-15
    assert np.abs(v - BICYCLE.reference_state["v0"]).max() < 1e-14


@pytest.mark.plain
@pytest.mark.parametrize("scheme", sweep(ORDERS, 0))
def test_orders_of_a_ride_that_balances_itself(scheme):
    """At 4.6 m/s what is left of a push decays; errors of the energy and of the end by h."""

    def ridden(scheme, steps, t_end=1):
        stepper = ss.compile(BICYCLE, scheme)
        return stepper.integrate(**BICYCLE.reference_state, h=1 / steps, steps=t_end * steps)

    exact, errors = ridden(FINE, 200), []
    for run in (ridden(scheme, steps) for steps in STEPS[scheme]):
        off = np.abs(run.q[-1] - exact.q[-1]).max()
        errors.append([off, np.abs(run.energy_error).max()])
    found = np.log2(np.divide(*errors))
    assert np.abs(found - ORDERS[scheme]).max() < 0.3
    lean = ridden(scheme, 25, 20)["lean"]
    assert np.abs(lean[-100:]).max() < 0.05 * np.abs(lean[:100]).max()
