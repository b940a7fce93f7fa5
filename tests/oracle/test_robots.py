"""Robots of others: energies, mass matrices and forward dynamics, against Pinocchio itself."""

import sysconfig
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from support.robot_cases import Dynamics, turned

import symsimpson as ss

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::symsimpson.errors.ModelWarning"),
]
FOLDER = "cmeel.prefix/share/example-robot-data/robots"
ROBOTS = {
    "Panda": ("panda_description/urdf/panda.urdf", "fixed"),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "fixed"),
    "Talos arm": ("talos_data/robots/talos_left_arm.urdf", "fixed"),
    "Z1": ("z1_description/urdf/z1.urdf", "fixed"),
    "ANYmal": ("anymal_b_simple_description/robots/anymal.urdf", "floating"),
    "A1": ("a1_description/urdf/a1.urdf", "floating"),
    "iCub": ("icub_description/robots/icub.urdf", "fixed"),
}


@pytest.fixture(scope="module")
def pinocchio():
    module = pytest.importorskip("pinocchio")
    return module


def robot_file(name):
    file = Path(sysconfig.get_path("purelib")) / FOLDER / name
    if not file.exists():
        pytest.skip("example-robot-data is not installed")
    return file


class Peer:
    """A robot of Pinocchio at random states, with joints that mimic others."""

    def __init__(self, pinocchio, file, system, floating):
        free = [pinocchio.JointModelFreeFlyer()] if floating else []
        self.pin, self.floating = pinocchio, floating
        self.model = pinocchio.buildModelFromUrdf(str(file), *free)
        self.data = self.model.createData()
        self.system = system
        leaders = {x.name: x for x in system.tree.joints}
        names = [*self.model.names][1 + floating :]
        self.own = [x for x in names if leaders[x].mimic is None]
        # velocities of all joints from those of the independent ones
        skip = 6 * floating
        self.turn = np.zeros((self.model.nv, skip + len(self.own)))
        self.turn[:skip, :skip] = np.eye(skip)
        self.shift = np.zeros(self.model.nv)
        for row, name in enumerate(names, skip):
            factor, shift = 1.0, 0.0
            while leaders[name].mimic is not None:
                name, times, offset = leaders[name].mimic
                shift += factor * offset
                factor *= times
            self.turn[row, skip + self.own.index(name)] = factor
            self.shift[row] = shift

    def at(self, rng):
        """Draw a state; return what the system is given, and T, V, M of joints, accelerations."""
        pin, model, data, base = self.pin, self.model, self.data, 6 * self.floating
        own = rng.uniform(-1, 1, (3, len(self.own)))
        place = np.concatenate([rng.uniform(-1, 1, 3), rng.normal(size=4)])
        place[3:] /= np.linalg.norm(place[3:])
        e, rotation = place[3:], pin.Quaternion(*place[3:]).matrix()
        moving = rng.uniform(-1, 1, 6)[:base]
        v = self.turn @ [*moving, *own[1]]
        angles = (self.turn @ [*np.zeros(base), *own[0]] + self.shift)[base:]
        q = [*place[:3], *e[[1, 2, 3, 0]]] if self.floating else []
        for joint, angle in zip([*model.joints][1 + self.floating :], angles, strict=True):
            q += [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        q = np.array(q)
        M = pin.crba(model, data, q)
        M = self.turn.T @ (np.triu(M) + np.triu(M, 1).T) @ self.turn
        push = np.concatenate([np.zeros(base), own[2]]) - self.turn.T @ pin.nle(model, data, q, v)
        a = np.linalg.solve(M, push)
        T = pin.computeKineticEnergy(model, data, q, v)
        V = pin.computePotentialEnergy(model, data, q)
        names = zip(self.own, *own, strict=True)
        joints = {name: numbers for name, *numbers in names}
        positions, rates = ({k: x[i] for k, x in joints.items()} for i in (0, 1))
        expected = dict(zip(self.own, a[base:], strict=True))
        if self.floating:
            w = moving[3:]
            positions["base"] = place
            rates["base"] = [*rotation @ moving[:3], *w]
            expected["base"] = np.concatenate(
                [
                    rotation @ (a[:3] + np.cross(w, moving[:3])),
                    turned(e, [0, *a[3:6]]) - e * (w @ w) / 4,
                ]
            )
        state = self.system.state(positions, rates)
        inputs = [joints[str(u).removeprefix("tau_")][2] for u in self.system.inputs]
        return state, inputs, (T, V, M[base:, base:], expected)


@pytest.mark.parametrize("name", ROBOTS)
def test_public_robots(pinocchio, name):
    """A hundred random states, to 1e-11 of the largest entry, or what rounding leaves of it."""
    file, base = ROBOTS[name]
    file, floating = robot_file(file), base == "floating"
    system = ss.from_urdf(file, base=base)
    dynamics, peer = Dynamics(system), Peer(pinocchio, file, system, floating)
    rng, damping = np.random.default_rng(3), [0.0] * len(system.parameters)
    names = [x.func.__name__ for x in system.coordinates]
    order = [names.index(x) for x in peer.own]
    for _ in range(100):
        (q, v), inputs, (T, V, M, a) = peer.at(rng)
        found_T, found_V, found_M, found_a = dynamics.at(q, v, inputs, damping)
        assert found_T == pytest.approx(T, rel=1e-11)
        assert found_V == pytest.approx(V, rel=1e-11, abs=1e-10)
        size = abs(M).max()
        np.testing.assert_allclose(found_M[np.ix_(order, order)], M, rtol=0, atol=1e-11 * size)
        expected = [*a.get("base", ()), *(a[x] for x in names[7 * floating :])]
        bound = max(1e-11, np.linalg.cond(M) * 2.0**-53)  # some links of iCub are nearly massless
        np.testing.assert_allclose(found_a, expected, rtol=0, atol=bound * np.abs(expected).max())


def test_a_body_with_a_quaternion_lands_on_its_feet():
    body = ss.from_urdf(
        """<robot name="box"><link name="world"/><link name="box"><inertial><mass value="8"/>
        <inertia ixx="0.07" iyy="0.22" izz="0.27" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="base" type="floating"><parent link="world"/><child link="box"/></joint>
        </robot>"""
    )
    place, turn = body.frame("box")
    corners = [(x, y) for x in (-0.25, 0.2) for y in (-0.12, 0.1)]
    feet = {f"{x} {y}": (place + turn * sp.Matrix([x, y, -0.3]))[2] for x, y in corners}
    robot = body.with_contacts({k: ss.Contact(x, restitution=0.2) for k, x in feet.items()})
    tilt = [np.cos(0.1), 0.6 * np.sin(0.1), 0.8 * np.sin(0.1), 0.0]
    q0, v0 = robot.state({"base": [0, 0, 0.4, *tilt]}, {"base": [0.3, 0, 0, 0, 0.5, 0]})
    run = ss.compile(robot, "gauss4").integrate(q0, v0=v0, h=0.005, t_end=1.2)
    forces = sum(run[f"normal_{name}"] for name in feet)
    assert abs(forces[-1] / (8 * 9.81) - 1) < 1e-9
    assert np.abs(run.constraint_error).max() < 1e-14
    height = sp.lambdify([robot.coordinates], list(feet.values()))
    assert np.min(height(run.q.T)) > -1e-9
    assert np.abs(np.array(height(run.q[-1]))).max() < 1e-9
