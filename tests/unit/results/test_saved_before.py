"""Files that 0.3.0.dev0 of 28 November 2026 wrote open as they did then."""

import shutil

import numpy as np
import pytest
import sympy as sp
from support.places import DATA

import symsimpson as ss

SAVED = DATA / "saved"


@pytest.fixture(scope="module")
def expected():
    with np.load(SAVED / "expected.npz") as file:
        return dict(file)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_a_trajectory_opens(ending, expected):
    run = ss.open_trajectory(SAVED / f"double_pendulum.{ending}")
    assert np.array_equal(run.q, expected["q"])
    assert np.array_equal(run.p, expected["p"])
    assert abs(run.energy - expected["energy"]).max() < 1e-14
    assert abs(run.at(0.1).q - expected["q"][10]).max() < 1e-12


@pytest.mark.slow
def test_a_checkpoint_resumes(tmp_path, expected):
    for name in ("pendulum.ckpt", "pendulum.ckpt.states"):
        shutil.copy(SAVED / name, tmp_path)
    run = ss.resume(tmp_path / "pendulum.ckpt")
    assert run.success
    assert np.array_equal(run.q, expected["ckpt_q"])


@pytest.mark.slow
def test_a_solution_of_optimal_control_opens(expected):
    pytest.importorskip("casadi")
    (x,), u = ss.coordinates("x"), sp.Symbol("u")
    cart = ss.MechanicalSystem(
        "cart",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=0 * x,
        forces={x: u},
        inputs=(u,),
    )
    rest = {x.diff(): 0}
    problem = ss.OptimalControl(
        cart, cost=u**2, start={x: 0, **rest}, end={x: 1, **rest}, duration=1
    )
    solution = problem.open(SAVED / "cart_control.npz")
    assert solution.success
    assert solution.cost == pytest.approx(float(expected["cost"]), rel=1e-12)


def test_a_generated_file_of_an_earlier_interface_is_stale():
    """A run that was saved needs it; a file can be written again."""
    with pytest.raises(ss.StaleKernelError, match=r"interface 12.*\n.*symsimpson generate"):
        ss.load(SAVED / "pendulum__midpoint.py")
