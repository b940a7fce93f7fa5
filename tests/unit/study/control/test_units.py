"""Problems in any unit."""

import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss

pytest.importorskip("casadi")

x, theta = ss.coordinates("x theta")
u = sp.Symbol("u", real=True)
m, M, l, g = sp.symbols("m M l g", positive=True)


def crane(kg=1.0, metre=1.0, second=1.0):
    """A load on a trolley that goes by one metre, in any units."""
    ahead, up = x.diff() + l * sp.cos(theta) * theta.diff(), l * sp.sin(theta) * theta.diff()
    system = ss.MechanicalSystem(
        "crane",
        coordinates=(x, theta),
        kinetic=(M * x.diff() ** 2 + m * (ahead**2 + up**2)) / 2,
        potential=-m * g * l * sp.cos(theta),
        forces={x: u},
        inputs=(u,),
        parameters={m: 0.3 * kg, M: kg, l: metre / 2, g: 9.81 * metre / second**2},
    )
    rest = {theta: 0, x.diff(): 0, theta.diff(): 0}
    given = {"cost": u**2, "start": {x: 0, **rest}, "end": {x: metre, **rest}}
    return ss.OptimalControl(system, **given, duration=2 * second)


#: Trolleys of a kilogram, an attogram and a planet; and all units at once.
UNITS = {
    "attograms": (1e-18, 1, 1),
    "planets": (1e24, 1, 1),
    "nanometres": (1, 1e-9, 1),
    "microseconds": (1, 1, 1e-6),
    "atoms": (1e-26, 1e-10, 1e-12),
}


@pytest.mark.parametrize("units", sweep(UNITS))
def test_an_optimum_does_not_depend_on_units(units):
    kg, metre, second = UNITS[units]
    limits = kg * metre / second**2
    found = crane(kg, metre, second).solve(steps=12)
    same = crane().solve(steps=12)
    assert found.success
    assert found.cost / (limits**2 * second) == pytest.approx(same.cost, rel=1e-9)
    assert found.violation < 1e-8
    assert found.iterations == same.iterations  # the way there is the same, too
    assert found.input_values / limits == pytest.approx(same.input_values, abs=1e-6)


@pytest.mark.parametrize("units", sweep(UNITS))
def test_a_file_of_another_problem_is_refused_in_any_units(units, tmp_path):
    kg, metre, second = UNITS[units]
    crane(kg, metre, second).solve(steps=4).save(tmp_path / "one.npz")
    assert crane(kg, metre, second).open(tmp_path / "one.npz").success
    other = crane(kg, 2 * metre, second)
    with pytest.raises(ss.InputError, match="the solution of another problem"):
        other.open(tmp_path / "one.npz")
