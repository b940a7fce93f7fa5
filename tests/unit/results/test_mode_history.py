"""Modes, normal forces and friction in results, tables and files."""

import numpy as np
import pytest
import sympy as sp
from support.friction import brake, x, y

import symsimpson as ss


@pytest.fixture(scope="module")
def run():
    return ss.compile(brake(), "simpson").integrate(
        [2.0], v0=[0.0], h=0.1, t_end=10.0, record="work"
    )


def test_forces_have_names(run):
    assert "friction_pad" in run.to_pandas().columns
    assert run[3:9]["friction_pad"] == pytest.approx(run["friction_pad"][3:9])
    assert "friction_pad" in run._ipython_key_completions_()
    with pytest.raises(ss.UnknownNameError, match="friction_pad"):
        run["normal_pad"]


def test_files_keep_modes_and_kinds(run, tmp_path):
    run.save(tmp_path / "run.nc")
    again = ss.open_trajectory(tmp_path / "run.nc")
    assert again.events("pad").kind == run.events("pad").kind
    assert again.modes.states == run.modes.states
    assert np.array_equal(again.work["pad"], run.work["pad"])
    for call in (lambda: again.at(0.5), lambda: again["friction_pad"]):
        with pytest.raises(ss.InputError, match="Repeat the run"):
            call()


def test_a_run_without_contacts_has_no_modes():
    plain = ss.compile(ss.systems.pendulum(), "simpson").integrate([1.0], v0=[0.0], h=0.1, steps=3)
    with pytest.raises(ss.InputError, match="neither contacts nor friction"):
        _ = plain.modes
    with pytest.raises(ss.InputError, match="before the run"):
        ss.compile(brake()).integrate([2.0], v0=[0.0], h=0.1, steps=3).modes.at(-1.0)


def test_multipliers_know_the_mode():
    """A bead on a wire of 45 degrees that sticks needs no force along the wire."""
    bead = ss.MechanicalSystem(
        "bead",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=10 * y,
        constraints={"wire": (y - x) / sp.sqrt(2)},
        friction={"ring": ss.Friction((x.diff() + y.diff()) / sp.sqrt(2), limit=8)},
    )
    run = ss.compile(bead, "simpson").integrate([0, 0], v0=[0, 0], h=0.1, steps=5)
    assert run["friction_ring"] == pytest.approx(-10 / np.sqrt(2) * np.ones(6))
    assert run["lambda_wire"] == pytest.approx(-10 / np.sqrt(2) * np.ones(6))
    assert run.constraint_forces == pytest.approx(np.tile([-5.0, 5.0], (6, 1)))
