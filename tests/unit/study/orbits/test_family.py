"""Families of orbits: ends, bifurcations, files and figures."""

import signal

import matplotlib as mpl
import numpy as np
import pytest
import sympy as sp
from support.orbit_cases import found

import symsimpson as ss
from symsimpson.study.orbits.continuation import Continuation

mpl.use("Agg")


@pytest.fixture(scope="module")
def swing():
    stepper = ss.compile(ss.systems.pendulum(), "gauss8")
    return stepper.periodic([0.5], [0.0], period=2.04, steps=32, fixed={"v_theta": 0})


def test_to_a_value_and_beyond(swing, tmp_path):
    family = swing.family("energy", to=-5.0, count=40)
    assert family.status is ss.FamilyStatus.REACHED
    assert family["energy"][-1] == pytest.approx(-5.0, abs=1e-13)
    assert (np.diff(family["period"]) > 0).all()
    assert not family.bifurcations
    longer = family.extend(count=2)
    assert len(longer) == len(family) + 2
    assert longer["energy"][-1] > -5.0
    with pytest.raises(ss.InputError, match="no quantity 'foo'"):
        family["foo"]


def test_files(swing, tmp_path):
    family, stepper = swing.family("energy", count=2), swing.search.stepper
    place, fixed = tmp_path / "swings.npz", {"v_theta": 0}
    family.save(place)
    again = stepper.open_family(place, fixed=fixed)
    assert again.status is family.status
    np.testing.assert_array_equal(again["period"], family["period"])
    longer, expected = again.extend(count=1), family.extend(count=1)
    np.testing.assert_allclose(longer["period"], expected["period"], rtol=1e-13)
    with pytest.raises(ss.InputError, match="found with fixed=, and you passed no symbolic"):
        stepper.open_family(place)
    with pytest.raises(ss.StorageError, match="another system or scheme"):
        ss.compile(ss.systems.pendulum(), "gauss4").open_family(place)
    with pytest.raises(ss.StorageError, match="family cannot be read"):
        stepper.open_family(tmp_path / "nothing")
    with pytest.raises(ss.InputError, match="extension"):
        family.save(tmp_path / "swings")
    whole = place.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", whole[:300] + b"0" * 30 + whole[330:]):
        place.write_bytes(damaged)
        with pytest.raises(ss.StorageError, match="not a family of symsimpson"):
            stepper.open_family(place)


@pytest.mark.slow
def test_files_of_driven_orbits(tmp_path):
    """The period is an expression, and the orbit has been found in eight segments."""
    (x,) = ss.coordinates("x")
    w, v = sp.Symbol("w"), x.diff(ss.time)
    drive = 0.3 * sp.cos(w * ss.time) - v / 10
    system = ss.MechanicalSystem(
        "duffing",
        coordinates=[x],
        kinetic=v**2 / 2,
        potential=x**2 / 2 + x**4 / 4,
        parameters={w: 1.2},
        forces={x: drive},
    )
    stepper, period = ss.compile(system, "gauss6"), 2 * sp.pi / w
    orbit = stepper.periodic([0.5], [0.0], period=period, steps=32)
    orbit = stepper.periodic(guess=orbit, period=period, steps=32)
    orbit.save(tmp_path / "one.npz")
    one = stepper.open_family(tmp_path / "one.npz", period=period)
    np.testing.assert_allclose(one[0].q0, orbit.q0, rtol=1e-12)
    assert not one.bifurcations
    family = orbit.family("w", to=1.3, count=40)
    family.save(tmp_path / "family.npz")
    again = stepper.open_family(tmp_path / "family.npz", period=period).extend(to=1.35, count=20)
    assert again.status is ss.FamilyStatus.REACHED
    with pytest.raises(ss.InputError, match="found with period="):
        stepper.open_family(tmp_path / "family.npz")


@pytest.mark.slow
def test_along_a_parameter_and_the_period(swing):
    with pytest.raises(ss.InputError, match="leave 1 of the quantities free beside l"):
        swing.family("l", to=2.0)
    slower = swing.family("period", to=3.0)
    assert slower["period"][-1] == pytest.approx(3.0, abs=1e-13)
    with pytest.raises(ss.InputError, match="is unknown"):
        swing.family("mass")
    fixed = swing.search.stepper.periodic(
        [0.5], [0.0], period=2.04, steps=32, fixed={"theta": 0.5, "v_theta": 0}
    )
    with pytest.raises(ss.InputError, match="leave no family along energy"):
        fixed.family("energy")
    longer = fixed.family("l", to=2.0)
    assert longer.status is ss.FamilyStatus.REACHED
    np.testing.assert_allclose(longer["period"] / longer["l"] ** 0.5, fixed.period, rtol=1e-9)


@pytest.mark.slow
def test_ends_at_an_equilibrium(swing):
    family = swing.family("energy", step=-0.01, count=200)
    assert family.status is ss.FamilyStatus.EQUILIBRIUM
    assert family["energy"][-1] < -9.7


@pytest.mark.slow
def test_ctrl_c_keeps_the_family(swing, monkeypatch):
    step, calls = Continuation._step, []

    def interrupted(self, *given):
        calls.append(given)
        if len(calls) == 4:
            signal.raise_signal(signal.SIGINT)
        return step(self, *given)

    monkeypatch.setattr(Continuation, "_step", interrupted)
    family = swing.family("energy", count=50)
    assert family.status is ss.FamilyStatus.INTERRUPTED
    assert len(family) == 4


@pytest.mark.slow
def test_figures(swing):
    family = swing.family("energy", to=-5.0, count=40)
    assert family.plot().get_ylabel() == "period"
    assert family.plot("energy", "frequency").get_xlabel() == "energy"
    assert swing.plot().get_ylabel() == "p_theta"
    assert swing.plot_multipliers().get_ylabel() == "imaginary part"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["unstable", "stable"])
def test_an_unstable_orbit_has_manifolds(kind):
    """Deviations grow by the multiplier in each period."""
    orbit = found("lyapunov_L1", "gauss8", 96)
    runs = orbit.manifold(kind, size=1e-9, count=6, periods=1)
    assert len(runs) == 6
    assert np.abs(runs.energy - orbit.energy).max() < 1e-8
    states = np.concatenate([runs.q, runs.p], axis=2)
    ends = np.concatenate([orbit.trajectory.q, orbit.trajectory.p], axis=1)
    places = np.unique(np.linspace(0, 96, 6, endpoint=False).round().astype(int))
    first, last = (np.linalg.norm(states[:, k] - ends[places], axis=1) for k in (0, -1))
    growth = last / first
    assert np.abs(growth / abs(orbit.multipliers[0]) - 1).max() < 0.01
