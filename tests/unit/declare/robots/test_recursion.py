"""Energies and accelerations of random trees, against values of Pinocchio."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.robot_cases import Dynamics, turned

import symsimpson as ss

ROBOTS = json.loads((Path(__file__).parents[3] / "data" / "robots.json").read_text())["robots"]
QUICK = "arm with six hinges"


def state_of(robot, system, state):
    """Return q, v, the inputs and the accelerations of a state in the order of the system."""
    q, v, a = [], [], []
    if robot["floating"]:
        base = state["base"]
        e = np.array(base["quaternion_wxyz"])
        w = np.array([0, *base["angular_velocity_in_body"]])
        q += [*base["position"], *e]
        v += [*base["velocity_in_world"], *turned(e, w)]
    names = [x.func.__name__ for x in system.coordinates[len(q) :]]
    joints = [state["joints"][x] for x in names]
    q += [x["q"] for x in joints]
    v += [x["v"] for x in joints]
    a += [x["a"] for x in joints]
    return q, v, [x["tau"] for x in joints], a


def depth_first(tree):
    """Return the joints that move in the order of Pinocchio: each branch to its end."""
    below = {}
    for joint in tree.joints:
        below.setdefault(joint.parent, []).append(joint)

    def walk(link):
        for joint in below.get(link, []):
            yield from [joint.name] if joint.kind != "fixed" else []
            yield from walk(joint.child)

    return [*walk(tree.root)]


@pytest.mark.parametrize(
    "robot",
    [
        pytest.param(x, id=x["name"], marks=() if x["name"] == QUICK else pytest.mark.slow)
        for x in ROBOTS
    ],
)
def test_against_pinocchio(robot):
    base = "floating" if robot["floating"] else "fixed"
    system = ss.from_urdf(robot["urdf"], base=base, gravity=robot["gravity"])
    dynamics = Dynamics(system)
    for state in robot["states"]:
        q, v, tau, a = state_of(robot, system, state)
        T, V, M, found = dynamics.at(q, v, tau, [0.0] * len(system.parameters))
        n, size = len(a), max(abs(x) for x in a)
        assert pytest.approx(state["kinetic"], rel=1e-11) == T
        assert pytest.approx(state["potential"], rel=1e-11, abs=1e-10) == V
        names = [x.func.__name__ for x in system.coordinates]
        order = [names.index(x) for x in depth_first(system.tree)]
        expected = state["mass_matrix_of_joints"]
        np.testing.assert_allclose(M[np.ix_(order, order)], expected, rtol=0, atol=1e-11)
        np.testing.assert_allclose(found[-n:], a, rtol=0, atol=1e-11 * max(size, 1))
