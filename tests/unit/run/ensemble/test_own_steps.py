"""Ensembles whose members have step sizes and initial times of their own."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

(x,) = ss.coordinates("x")
Q0, H, T0 = [[0.1], [0.2], [0.3], [0.4]], [0.1, 0.05, 0.1, 0.05], [0.0, 0.0, 1.0, 1.0]


@pytest.fixture(scope="module")
def stepper():
    system = ss.MechanicalSystem(
        "driven",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=x**2 / 2 - x * sp.cos(ss.time),
    )
    return ss.compile(system, "gauss6")


@pytest.mark.parametrize("every", [None, 2])
def test_members_are_single_runs(stepper, every):
    options = {"v0": [0.0], "steps": 10, "every": every, "tangents": 2}
    many = stepper.ensemble(Q0, h=H, t0=T0, **options)
    assert many.t.shape == many.energy.shape == ((4,) if every is None else (4, 6))
    for k in range(4):
        one = stepper.integrate(Q0[k], h=H[k], t0=T0[k], **options)
        np.testing.assert_array_equal(np.ravel(many[k].q), np.ravel(one.q))
        np.testing.assert_array_equal(np.ravel(many[k].t), one.t)
        np.testing.assert_allclose(
            np.ravel(many.tangent[k]), np.ravel(one.tangent), rtol=0, atol=1e-15
        )
    table = many.to_pandas()
    assert len(table) == (4 if every is None else 24)


def test_one_state_with_several_steps(stepper):
    many = stepper.ensemble([0.1], v0=[0.0], h=[0.1, 0.2], steps=10)
    assert many.t.tolist() == [1.0, 2.0]


WRONG = {
    "number": ({"h": [0.1, 0.2, 0.3]}, "3 members, but another argument has 4"),
    "matrix": ({"h": [[0.1]]}, "h has shape"),
    "t_end": ({"h": H, "t_end": 1.0, "steps": None}, "t_end cannot be combined"),
    "nothing": ({"h": []}, "h has shape"),
}


@pytest.mark.parametrize("case", WRONG.values(), ids=WRONG)
def test_rejected(stepper, case):
    given, message = case
    with pytest.raises(ss.InputError, match=message):
        stepper.ensemble(Q0, v0=[0.0], **{"steps": 10} | given)


def test_a_store_needs_common_steps(stepper, tmp_path):
    with pytest.raises(ss.InputError, match="common step size"):
        stepper.ensemble(Q0, v0=[0.0], h=H, steps=10, store=tmp_path / "x.zarr")
