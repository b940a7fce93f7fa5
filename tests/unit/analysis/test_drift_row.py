"""The row of a certificate on drift: violent motions, and what rolls."""

import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.analysis.energy_checks import drift


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.errors.ResolutionWarning")
def test_violent_motions_change_their_level_with_half_the_step_too(monkeypatch):
    """The energy of three pendulums wanders by 3e-1 with h, by 3e-3 with h/2."""
    monkeypatch.setattr("symsimpson.analysis.certify.CHECKS", (drift,))
    chain = ss.systems.n_pendulum(3)
    certificate = ss.compile(chain, "gauss8").certify([2.0, 1.0, 0.0], v0=[0.0] * 3, h=1 / 64)
    assert certificate.passed, certificate


@pytest.mark.slow
def test_the_energy_of_what_rolls_is_watched(monkeypatch):
    """A coin turns through 2e5 rad: the rounding of its angles turns the constraints, too."""
    monkeypatch.setattr("symsimpson.analysis.certify.CHECKS", (drift,))
    x, y, roll, turn = ss.coordinates("x y roll turn")
    coin = ss.MechanicalSystem(
        "coin",
        coordinates=(x, y, roll, turn),
        kinetic=(x.diff() ** 2 + y.diff() ** 2 + (roll.diff() ** 2 + turn.diff() ** 2) / 50) / 2,
        potential=0,
        velocity_constraints={
            "along": x.diff() - sp.cos(turn) * roll.diff() / 5,
            "aside": y.diff() - sp.sin(turn) * roll.diff() / 5,
        },
    )
    certificate = ss.compile(coin, "gauss4").certify([0.0] * 4, v0=[0.4, 0.0, 2.0, 1.0], h=4.0)
    assert certificate.passed, certificate
    assert [row.name for row in certificate.checks] == ["watched"]
