"""Optimal controls against closed forms and shooting, of more digits than doubles have.

``tests/data/golden_control.json``: least costs, inputs at the start and costates of linear and of
nonlinear problems; of the latter the optimum to which the straight line from start to end leads.
"""

import json

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.places import DATA

import symsimpson as ss

pytest.importorskip("casadi")
PROBLEMS = {
    case["name"]: case
    for case in json.loads((DATA / "golden_control.json").read_text())["problems"]
}
#: Steps of a scheme, and the relative error of the cost with these: that of the scheme.
MESHES = {"simpson": (80, 2e-5), "lobatto6": (80, 2e-7), "gauss6": (80, 2e-7)}


def problem_of(case):
    """Declare a problem of the file."""
    q = ss.coordinates(" ".join(case["coordinates"]))
    u = tuple(sp.Symbol(name, real=True) for name in case["inputs"])
    parameters = {sp.Symbol(a, real=True): float(x) for a, x in case["parameters"].items()}
    names = dict(zip(case["coordinates"], q, strict=True))
    names |= dict(zip(case["velocities"], (x.diff() for x in q), strict=True))
    names |= {str(x): x for x in (*u, *parameters)}

    def read(text):
        return sp.sympify(text, locals=names)

    def end(given):
        values = [*zip(q, given["q"], strict=True)]
        values += [(x.diff(), v) for x, v in zip(q, given["v"], strict=True)]
        return {key: read(value) for key, value in values if value is not None}

    system = ss.MechanicalSystem(
        case["name"],
        coordinates=q,
        kinetic=read(case["kinetic"]),
        potential=read(case["potential"]),
        forces={names[x]: read(force) for x, force in case["forces"].items()},
        inputs=u,
        parameters=parameters,
    )
    whole = case["T"]
    return ss.OptimalControl(
        system,
        cost=read(case["cost"]),
        final_cost=read(case.get("final_cost", "0")),
        start=end(case["start"]),
        end=end(case["end"]),
        duration=tuple(map(float, whole)) if isinstance(whole, list) else float(whole),
        bounds={names[x]: tuple(map(float, pair)) for x, pair in case["bounds"].items()},
    )


@pytest.mark.parametrize("scheme", MESHES)
@pytest.mark.parametrize("name", sweep(PROBLEMS, 4))
def test_least_costs_inputs_and_costates(name, scheme):
    case, (steps, near) = PROBLEMS[name], MESHES[scheme]
    found = problem_of(case).solve(scheme, steps=steps)
    assert found.status is ss.ControlStatus.SOLVED
    value = float(case["value"])
    assert abs(found.cost - value) < near * max(1, value)
    for costate, key in zip(found.costates, "qp", strict=True):
        right = np.array(case["costate0"][key], dtype=float)
        assert np.abs(costate[0] - right).max() < 20 * near * max(1, np.abs(right).max())
    if scheme != "gauss6":  # whose nodes are not at the start
        for name, right in zip(case["inputs"], case["u0"], strict=True):
            assert abs(found.inputs(0.0)[name] - float(right)) < 50 * near * max(1, value)
    if "T_optimal" in case:
        assert abs(found.duration - float(case["T_optimal"])) < near


@pytest.mark.parametrize(
    ("scheme", "order", "steps"),
    sweep([("midpoint", 2, 10), ("simpson", 4, 10), ("gauss4", 4, 10), ("lobatto6", 6, 6)]),
)
def test_costs_and_costates_have_the_order_of_the_scheme(scheme, order, steps):
    """With friction as without it; inputs at the nodes of Lobatto have one less or all."""
    case = PROBLEMS["oscillator_damped"]
    problem = problem_of(case)
    errors = []
    for count in (steps, 2 * steps):
        found = problem.solve(scheme, steps=count, tolerance=1e-11)
        costates = [
            x[0] - float(case["costate0"][k][0]) for x, k in zip(found.costates, "qp", strict=True)
        ]
        errors.append([abs(found.cost - float(case["value"])), *np.abs(costates).ravel()])
    observed = np.log2(np.divide(*errors))
    assert np.abs(observed - order).max() < 0.4


def test_a_linear_problem_of_quadratic_cost_takes_one_iteration():
    assert problem_of(PROBLEMS["two_masses_one_input"]).solve(steps=30).iterations == 1
