"""Quantities by attribute, by name and by number: of runs, and of all members of an ensemble."""

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.text.quantity import QUANTITIES, SCALARS

SYSTEM = ss.systems.spherical_pendulum()


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(SYSTEM)


@pytest.fixture(scope="module")
def run(stepper):
    return stepper.integrate(**SYSTEM.reference_state, h=0.02, steps=50, every=10)


@pytest.fixture(scope="module")
def many(stepper):
    q0, v0 = (SYSTEM.reference_state[name] for name in ("q0", "v0"))
    return stepper.ensemble(
        [q0, np.add(q0, 0.1), q0],
        v0=v0,
        h=0.02,
        steps=50,
        every=10,
        parameters={"g": [9.81, 9.81, 4.0]},
        reduce={"highest": ("max", "theta")},
    )


def test_a_quantity_of_the_table_has_attribute_name_column_and_variable(run, many):
    frame, data = run.to_pandas(), run.to_xarray()
    for one in QUANTITIES.values():
        value = getattr(run, one.name)
        assert value.shape[1:] == ((len(one.shown(run.program.names)),) if one.axis else ())
        for k, name in enumerate(one.shown(run.program.names)):
            column = value[:, k] if one.axis else value
            assert (run[name] == column).all()
            assert (name in frame) == (one.axis != "constraints")
        assert (one.name in data) == (one.axis != "constraints")
        assert getattr(many, one.name).shape[:2] == many.q.shape[:2]


def test_the_kinetic_energy_is_half_of_p_times_v(run):
    np.testing.assert_allclose(run.kinetic_energy, (run.p * run.v).sum(axis=1) / 2, rtol=1e-14)
    half = float(run.kinetic_energy[:2].mean())
    t = run.events(f"kinetic_energy - {half!r}").t[0]
    assert abs(run.at(t).kinetic_energy[0] - half) < 1e-12


def test_a_cost_of_an_energy_is_refused(stepper):
    start = SYSTEM.reference_state
    for one in SCALARS:
        with pytest.raises(ss.InputError, match="contains the energy or a part of it"):
            stepper.gradient(**start, h=0.01, steps=2, cost=f"2*{one.name}", wrt=("q",))


@pytest.mark.parametrize("one", SCALARS, ids=lambda one: one.name)
def test_no_coordinate_has_the_name_of_a_quantity(one):
    (q,) = ss.coordinates(one.name)
    with pytest.raises(ss.ModelError, match=f"has the name of the {one.doc}"):
        ss.MechanicalSystem("named", coordinates=(q,), kinetic=q.diff() ** 2 / 2, potential=q**2)


def test_energies_share_a_unit():
    (x,) = ss.coordinates("x")
    given = {"coordinates": (x,), "kinetic": x.diff() ** 2 / 2, "potential": x**2 / 2}
    system = ss.MechanicalSystem("spring", **given, units={"energy": "J"})
    assert system.units["kinetic_energy"] == "J"
    system = ss.MechanicalSystem("spring", **given, units={"kinetic_energy": "eV"})
    assert system.units == {"kinetic_energy": "eV"}


def test_a_reduction_keeps_its_column_beside_quantities(stepper):
    start = SYSTEM.reference_state
    asked = {"kinetic_energy": ("max", "kinetic_energy")}
    many = stepper.ensemble([start["q0"]], v0=start["v0"], h=0.02, steps=50, reduce=asked)
    assert many.to_pandas()["kinetic_energy"].iloc[0] == many.reduced["kinetic_energy"][0]
    assert many.kinetic_energy[0] < many.reduced["kinetic_energy"][0]


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 3, -1, np.int64(3), np.int32(-2)])
def test_a_number_gives_a_state(run, number):
    state = run[number]
    assert isinstance(state, ss.States)
    assert (state.q == run.q[[number]]).all()
    assert state.t[0] == run.t[number]
    assert state.energy[0] == run.energy[number]


def test_arrays_give_some_states(run):
    assert (run[[0, 2]].q == run.q[[0, 2]]).all()
    assert (run[run.t > 0.5].p == run.p[run.t > 0.5]).all()
    assert len(run[::2]) == 3


@pytest.mark.parametrize("number", [6, -7, np.int64(100)])
def test_numbers_of_no_state(run, many, number):
    with pytest.raises(IndexError, match="the run has 6 states"):
        run[number]
    with pytest.raises(IndexError, match=r"member -?\d+ does not exist"):
        many[number]


def test_several_members_or_quantities_at_once(run, many):
    for ask in (lambda: many[1:2], lambda: many[[0, 1]], lambda: run["q1", "energy"]):
        with pytest.raises(ss.UnknownNameError, match=r"one name at a time.*\.q\[3:5\]"):
            ask()


@pytest.mark.parametrize("key", ["nothing", 1.5, True, None])
def test_names_of_nothing(run, many, key):
    for found in (run, many):
        with pytest.raises(KeyError, match="The quantities are theta, phi, p_theta"):
            found[key]
    with pytest.raises(KeyError, match="highest"):
        many["nothing"]


def test_members_have_what_runs_have(run, many):
    for name in ("theta", "p_phi", "v_theta", "energy", *run.invariants):
        assert many[name].shape == (3, 6)
        assert (many[name][0] == run[name]).all()
    assert many.v.shape == many.q.shape
    assert (many.v[0] == run.v).all()
    assert (many["t"] == run.t).all()
    assert many["highest"].shape == (3,)
    assert (many["g"] == [9.81, 9.81, 4.0]).all()


def test_each_member_has_parameters_of_its_own(stepper, many):
    member = many[2]
    assert isinstance(member, ss.States)
    assert member.parameters["g"] == 4.0
    alone = stepper.energy(many.q[2], many.p[2], parameters={"g": 4.0})
    assert (many.energy[2] == alone).all()
    assert (member.energy == alone).all()
    assert many.energy[2, 0] != many.energy[0, 0]


def test_last_states_alone(stepper):
    q0, v0 = (SYSTEM.reference_state[name] for name in ("q0", "v0"))
    found = stepper.ensemble([q0, q0], v0=v0, h=0.02, steps=50)
    assert found["theta"].shape == found.energy.shape == (2,)
    assert found[1].q.shape == (1, 2)
    assert (found[1].q[0] == found.q[1]).all()
    assert found[-1].t[0] == 1.0


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_units_are_saved_with_a_run(tmp_path, ending):
    (x,) = ss.coordinates("x")
    given = {"coordinates": (x,), "kinetic": x.diff() ** 2 / 2, "potential": x**2 / 2}
    system = ss.MechanicalSystem("spring", **given, units={x: "m", "t": "s", "energy": "J"})
    run = ss.compile(system).integrate([1.0], [0.0], h=0.1, steps=5)
    run.save(tmp_path / f"run.{ending}")
    again = ss.open_trajectory(tmp_path / f"run.{ending}")
    assert again.program.units == run.program.units
    assert again.to_xarray()["time"].attrs["units"] == "s"
    again.save(tmp_path / f"again.{ending}")
    assert ss.open_trajectory(tmp_path / f"again.{ending}").program.units["x"] == "m"
