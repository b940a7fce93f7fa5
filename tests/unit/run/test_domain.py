"""Derivatives of runs whose motion leaves the domain of V."""

import pytest
import sympy as sp

import symsimpson as ss

X, Y = ss.coordinates("x y")
WELL = ss.MechanicalSystem(  # its force is real beyond x = 0, its energy is not
    "well_left",
    coordinates=(X, Y),
    kinetic=(X.diff() ** 2 + Y.diff() ** 2) / 2,
    potential=sp.log(X) + Y**2,
)
HOW = {"q0": [0.5, 0.4], "v0": [-0.5, 0.2], "h": 0.02}  # 22 steps lead to x < 0


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(WELL)


@pytest.mark.parametrize("recorded", [10**6, 1])  # the way in one piece, and in several
def test_they_are_refused_where_the_energy_is_no_number(stepper, recorded, monkeypatch):
    monkeypatch.setattr("symsimpson.run.gradients.MOST_RECORDED", recorded)
    with pytest.raises(ss.ConvergenceError, match=r"not a finite real number at t=0\.44") as caught:
        stepper.gradient(**HOW, steps=24, cost="x", wrt="q")
    assert caught.value.status == ss.Status.NOT_FINITE
    assert caught.value.step == 21
    with pytest.raises(ss.ConvergenceError, match="after step 22"):
        stepper.linearise(**HOW, steps=24)
    inside = stepper.gradient(**HOW, steps=21, cost="x", wrt="q")
    assert inside.value == stepper.integrate(**HOW, steps=21).q[-1, 0]
