"""Models of MuJoCo: accelerations against MuJoCo, and what is rejected."""

import numpy as np
import pytest
import sympy as sp
from support.robot_cases import Dynamics, turned

import symsimpson as ss

mujoco = pytest.importorskip("mujoco")
pytestmark = pytest.mark.slow

TREE = """<mujoco><option gravity="0 0.5 -9.81"><flag contact="disable"/></option><worldbody>
<body name="a" pos="0 0 1"><joint name="j1" type="hinge" axis="0 1 0" pos="0 0 .1" ref="20"
  armature=".1" damping=".2" stiffness="3" springref="5"/><geom type="box" size=".1 .2 .3"/>
 <body name="b" pos="0 0 -.5" euler="10 20 30"><joint name="j2" type="hinge" axis="0 1 1"/>
  <joint name="j3" type="slide" axis="1 0 0" pos=".1 .2 .3"/><geom type="capsule" size=".05 .2"/>
 </body></body>
<body name="f" pos="1 1 1" euler="0 30 0"><freejoint name="free"/><geom size=".1"/>
 <body name="d" pos=".2 0 0"><joint name="j4" type="ball"/><geom type="box" size=".1 .2 .3"
  pos=".1 .2 .3"/></body></body>
<body name="c" pos="2 0 0" euler="0 0 40"><joint name="ball" type="ball" pos=".1 0 0"/>
 <geom type="cylinder" size=".1 .3" pos="0 .2 0"/></body></worldbody>{}</mujoco>"""


def states(model, seed):
    """Return random qpos and qvel with unit quaternions, and q and v by joint."""
    rng = np.random.default_rng(seed)
    qpos, qvel = rng.uniform(-1, 1, model.nq), rng.uniform(-1, 1, model.nv)
    mujoco.mj_normalizeQuat(model, qpos)
    positions, velocities = {}, {}
    for k in range(model.njnt):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, k)
        size = (7, 4, 1, 1)[model.jnt_type[k]], (6, 3, 1, 1)[model.jnt_type[k]]
        q, v = model.jnt_qposadr[k], model.jnt_dofadr[k]
        positions[name], velocities[name] = qpos[q : q + size[0]], qvel[v : v + size[1]]
    return qpos, qvel, positions, velocities


def expected_accelerations(model, qacc, positions, velocities):
    """Return the accelerations of the coordinates; those of quaternions from angular ones."""
    found = []
    for k in range(model.njnt):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, k)
        a = qacc[model.jnt_dofadr[k] :]
        if model.jnt_type[k] > 1:
            found.append(a[:1])
            continue
        free = model.jnt_type[k] == 0
        w, rate = velocities[name][-3:], a[3:6] if free else a[:3]
        e = positions[name][-4:]
        turning = turned(e, [0, *rate]) - e * (w @ w) / 4
        found += [a[:3], turning] if free else [turning]
    return np.concatenate(found)


def test_against_mujoco():
    text = TREE.format("<actuator><motor joint='j2'/></actuator>")
    model, system = mujoco.MjModel.from_xml_string(text), ss.from_mjcf(text)
    dynamics, data = Dynamics(system), mujoco.MjData(model)
    assert [*system.joints] == ["j1", "j2", "j3", "free", "j4", "ball"]
    for seed in range(3):
        data.qpos[:], data.qvel[:], positions, velocities = states(model, seed)
        data.ctrl[:] = 0.7
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        q, v = system.state(positions, velocities)
        inputs = [0.7 if str(u) == "tau_j2" else 0.0 for u in system.inputs]
        T, V, _, a = dynamics.at(q, v, inputs, [*system.parameters.values()])
        assert pytest.approx(data.energy[1], rel=1e-11) == T
        assert pytest.approx(data.energy[0], rel=1e-11) == V
        expected = expected_accelerations(model, data.qacc, positions, velocities)
        np.testing.assert_allclose(a, expected, rtol=0, atol=1e-11 * abs(expected).max())
        position, rotation = system.frame("b")
        at = dict(zip(system.coordinates, q, strict=True))
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "b")
        np.testing.assert_allclose(
            np.ravel(position.subs(at)).astype(float), data.xpos[body], atol=1e-13
        )
        np.testing.assert_allclose(
            np.array(rotation.subs(at), float).ravel(), data.xmat[body], atol=1e-13
        )


FOUR_BAR = """<mujoco><option><flag contact="disable"/></option><worldbody>
<body name="crank"><joint name="q1" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .3"
  size=".02"/><body name="rod" pos="0 0 .3"><joint name="q2" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 1 0 .2" size=".02"/></body></body>
<body name="rocker" pos="1 0 0"><joint name="q3" axis="0 1 0"/><geom type="capsule"
  fromto="0 0 0 0 0 .5" size=".02"/></body></worldbody><equality>
<{} name="pin" body1="rod" body2="rocker" {}/></equality></mujoco>"""


@pytest.mark.parametrize("form", ["joints", "bodies"])
def test_a_closed_loop_with_constraints_that_follow_from_others(form):
    """In the plane, two of three equations remain; the motion keeps all of them."""
    text = FOUR_BAR.format("connect", 'anchor="1 0 .2"')
    with pytest.warns(ss.ModelWarning, match="pin_2.* follow"):
        system = ss.from_mjcf(text, form=form)
    assert system.degrees_of_freedom == 1
    q0, v0 = system.state()
    q0, v0 = system.consistent(q0, v0 + 0.1)
    run = ss.compile(system, "gauss4").integrate(q0, v0=v0, h=0.0025, steps=400)
    assert run.success
    assert abs(run.energy_balance).max() < 1e-6
    ends = []
    for link, place in (("rod", (1, 0, 0.2)), ("rocker", (0, 0, 0.5))):
        position, rotation = system.frame(link)
        at = dict(zip(system.coordinates, run.q[-1], strict=True))
        ends.append(np.array((position + rotation @ sp.Matrix(place)).subs(at), float))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)


def test_welds_and_polynomials_hold_at_the_start():
    """What MuJoCo calls satisfied is satisfied."""
    equalities = """<equality><weld body1="d" body2="c"/>
      <joint joint1="j1" joint2="j2" polycoef=".3 1 .5 0 0"/></equality>"""
    model = mujoco.MjModel.from_xml_string(TREE.format(equalities))
    system = ss.from_mjcf(TREE.format(equalities))
    assert system.degrees_of_freedom == system.n - 3 - 7
    positions = states(model, 0)[2]
    for k in range(model.njnt):  # the positions at which MuJoCo assembles the weld
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, k)
        q = model.jnt_qposadr[k]
        positions[name] = model.qpos0[q : q + len(positions[name])]
    q, _ = system.state(positions)
    at = dict(zip(system.coordinates, q, strict=True))
    values = {name: float(phi.subs(at)) for name, phi in system.constraints.items()}
    assert values.pop("equality_1") == pytest.approx(-0.3)
    assert max(map(abs, values.values())) < 1e-12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "<mujoco><worldbody><body><joint type='foo'/></body></worldbody></mujoco>",
            "MuJoCo rejects it: .*foo.* line 1",
        ),
        (TREE.replace("disable", "enable").format(""), "contacts between geoms"),
        (TREE.format("<actuator><position joint='j2' kp='3'/></actuator>"), "actuators other"),
        (TREE.format("").replace('name="j2"', 'name="j2" range="-1 1" limited="true"'), "limits"),
        (TREE.format("").replace('name="j4"', 'name="j4" frictionloss="1"'), "friction of balls"),
        (TREE.format("").replace("<option", '<option density="1"'), "fluid"),
        (TREE.format("<tendon><fixed><joint joint='j2' coef='1'/></fixed></tendon>"), "tendons"),
        ("<robot/>", "not a model of MuJoCo.*\n.*from_urdf"),
    ],
)
def test_what_is_rejected(text, message):
    with pytest.raises(ss.ModelError, match=message):
        ss.from_mjcf(text)


def test_what_may_be_ignored():
    text = TREE.replace("disable", "enable").format("").replace('"j2"', '"j2" range="-1 1"')
    system = ss.from_mjcf(text, ignore=("contacts", "limits"))
    q2 = system.joints["j2"]
    assert system.limits[q2] == pytest.approx((-np.pi / 180, np.pi / 180))
    with pytest.raises(ss.ModelError, match="ignore contains 'all'"):
        ss.from_mjcf(text, ignore="all")


@pytest.mark.parametrize("given", ["joint", "default", "disabled", "ignored", "left out"])
def test_friction(given):
    """A joint or a default has it; the flag of MuJoCo and arguments leave it out."""
    text, rough = TREE.format(""), 'frictionloss="0.3"'
    if given == "default":
        text = text.replace("<worldbody>", f"<default><joint {rough}/></default><worldbody>")
        text = text.replace('type="ball"', 'type="ball" frictionloss="0"')
    else:
        text = text.replace('name="j2"', f'name="j2" {rough}')
    if given == "disabled":
        text = text.replace("<flag", '<flag frictionloss="disable"')
    ignore = ["friction"] if given == "ignored" else []
    system = ss.from_mjcf(text, ignore=iter(ignore), friction=given != "left out")
    rough = {"joint": ["j2"], "default": ["j1", "j2", "j3"]}.get(given, [])
    assert [*system.friction] == [f"{x}.slip" for x in rough]
    values = {str(k): v for k, v in system.parameters.items() if str(k).startswith("friction")}
    assert values == {f"friction_{x}": 0.3 for x in rough}
