"""Units as labels."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

x, theta = ss.coordinates("x theta")
m = sp.Symbol("m", positive=True)
UNITS = {x: "m", "theta": "rad", "t": "s", "energy": "J", m: "kg", "p_x": "kg m/s"}


def cart(units):
    return ss.MechanicalSystem(
        "cart",
        coordinates=(x, theta),
        kinetic=m * (x.diff() ** 2 + theta.diff() ** 2) / 2,
        potential=x**2 / 2 + theta**2,
        parameters={m: 1.0},
        units=units,
    )


@pytest.fixture(scope="module")
def run():
    return ss.compile(cart(UNITS)).integrate([0.1, 0.2], v0=[0.0, 0.0], h=0.1, steps=10)


def test_velocities_have_units_that_follow():
    assert cart(UNITS).units["v_theta"] == "rad/s"
    assert cart(UNITS | {"v_x": "m s^-1"}).units["v_x"] == "m s^-1"
    assert "v_x" not in cart({"x": "m"}).units


def test_units_change_nothing_else():
    assert cart(UNITS).digest == cart({}).digest
    assert ss.compile(cart({})).units == {}


def test_units_are_handed_on():
    lagrangian = x.diff() ** 2 / 2 - x**2
    of_l = ss.MechanicalSystem.from_lagrangian("l", lagrangian, (x,), units={"x": "m"})
    assert of_l.units == {"x": "m"}
    assert cart(UNITS).retimed("kinetic").units["x"] == "m"


def test_figures_have_axes_for_each_unit(run):
    pytest.importorskip("matplotlib")
    first = run.plot()
    assert [ax.get_ylabel() for ax in first.figure.axes] == ["x [m]", "theta [rad]"]
    assert first.figure.axes[-1].get_xlabel() == "t [s]"
    assert len(run.plot(ax=first).figure.axes) == 2  # all in the axes that are given
    assert run.plot_phase("x").get_ylabel() == "p_x [kg m/s]"
    assert run.plot("v_x").get_ylabel() == "v_x [m/s]"


def test_datasets_and_tables_have_units(run, tmp_path):
    pytest.importorskip("xarray")
    data = run.to_xarray()
    assert data["energy"].attrs["units"] == "J"
    assert data["time"].attrs["units"] == "s"
    assert data["units_q"].values.tolist() == ["m", "rad"]
    assert data["units_p"].values.tolist() == ["kg m/s", ""]
    assert run.to_pandas().attrs["units"]["v_x"] == "m/s"


def test_ensembles_without_a_row_of_times_have_units():
    pytest.importorskip("xarray")
    pushed = ss.compile(cart(UNITS))
    last = pushed.ensemble([[0.1, 0.2]] * 2, v0=[0.0, 0.0], h=0.1, steps=3).to_xarray()
    assert last["units_q"].values.tolist() == ["m", "rad"]
    free = ss.compile(cart(UNITS).retimed("kinetic"))
    own = free.ensemble([[0.1, 0.2]] * 2, v0=[0.3, 0.0], h=0.1, steps=3, every=1).to_xarray()
    assert own["t"].attrs["units"] == "s"


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_ensembles_with_seconds_go_to_files(tmp_path, ending):
    pytest.importorskip("netCDF4" if ending == "nc" else "zarr")
    start = {"v0": [0.0, 0.0], "h": 0.1, "steps": 3}
    many = ss.compile(cart(UNITS)).ensemble([[0.1, 0.2]] * 2, **start)
    many.save(tmp_path / f"many.{ending}")
    if ending == "zarr":
        place = tmp_path / "store.zarr"
        kept = ss.compile(cart(UNITS)).ensemble([[0.1, 0.2]] * 2, **start, store=place)
        assert (np.asarray(kept.q[:]) == many.q).all()


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_seconds_are_not_read_as_dates(tmp_path, ending):
    pytest.importorskip("netCDF4" if ending == "nc" else "zarr")
    stepper = ss.compile(cart(UNITS | {"t": "seconds"}))
    run = stepper.integrate([0.1, 0.2], v0=[0.0, 0.0], h=0.1, steps=10)
    run.save(tmp_path / f"run.{ending}")
    assert (ss.open_trajectory(tmp_path / f"run.{ending}").t == run.t).all()


@pytest.mark.parametrize(
    ("units", "message"),
    [
        ({"thta": "rad"}, "Did you mean theta"),
        ({"x": 3}, "not a string"),
        ({"w": "m"}, "does not have"),
    ],
)
def test_bad_units(units, message):
    with pytest.raises(ss.ModelError, match=message):
        cart(units)
