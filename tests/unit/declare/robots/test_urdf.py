"""Robots from URDF files: coordinates, inputs, joints of every kind, and what is rejected."""

import pickle

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.declare.coordinates import time

BAR = (
    '<inertial><origin xyz="0 0 -1"/><mass value="2"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.02"/></inertial>'
)


def link(name, inside=BAR):
    return f'<link name="{name}">{inside}</link>'


def joint(name, parent, child, kind="continuous", inside='<axis xyz="0 1 0"/>'):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


def robot(*elements):
    return "<robot name='r'>\n" + "\n".join(elements) + "\n</robot>"


CHAIN = [link("a", ""), link("b"), link("c"), joint("j", "a", "b")]
DROP = '<origin xyz="0 0 -2"/><axis xyz="0 1 0"/>'


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ([*CHAIN, joint("k", "b", "d")], r"line 6, <joint name='k'>: the child 'd' .* is no link"),
        ([*CHAIN, joint("k", "x", "c")], r"line 6, .*the parent 'x' .* is no link"),
        ([*CHAIN, joint("k", "a", "b")], r"line 6, .*'b' has two parents, by the joints 'j' and"),
        (CHAIN, r"line 4, <link name='c'>: it has several bases: 'a', 'c'"),
        ([link("a"), link("b"), joint("j", "a", "b"), joint("k", "b", "a")], "a loop without a"),
        (
            [*CHAIN, link("d"), joint("k", "c", "d"), joint("l", "d", "c")],
            r"line 7, <joint name='k'>: .* belongs to a loop",
        ),
        ([*CHAIN, link("b")], r"line 6, <link name='b'>: two links have the name 'b'"),
        ([*CHAIN, joint("j", "b", "c")], r"line 6, <joint name='j'>: two joints have the name"),
        ([*CHAIN, joint("k", "b", "c", "hinge")], r"line 6, .*unknown type 'hinge'"),
        (
            [*CHAIN, joint("k", "b", "c", inside='<mimic joint="k"/>')],
            r"line 6, .*'k' mimics itself",
        ),
        (
            [*CHAIN, joint("k", "b", "c", inside='<mimic joint="i"/>')],
            r"line 6, .*'k' mimics 'i', which is no joint",
        ),
        ([link("a", BAR.replace('"2"', '"-2"'))], r"line 2, .* has the mass -2"),
        ([link("a", BAR.replace('ixx="0.1"', 'ixx="-0.1"'))], r"line 2, .*moment of inertia -0.1"),
        (
            [*CHAIN, joint("k", "b", "c", inside='<axis xyz="0 0 0"/>')],
            r"line 6, <axis>: the axis is zero",
        ),
        ([link("a", BAR.replace('"2"', '"nan"'))], r"line 2, <mass>: value is 'nan', not a finite"),
        ([link("a", BAR.replace("0 0 -1", "0 -1"))], r"line 2, <origin>: xyz is '0 -1', not 3"),
        (['<link name=""/>'], r"line 2, <link name=''>: it has no attribute 'name'"),
        (['<joint name="j" type="fixed"/>', link("a")], r"line 2, .* the joint has no <parent>"),
        ([], "line 1, <robot name='r'>: it has no link"),
        (["<xacro:macro/>", link("a")], r"line 2, .*<xacro:macro> is a macro"),
        ([link("a")], "no joint moves"),
        (["<link"], "line 3: it is not XML"),
        (["</link>"], "line 2: it is not XML: mismatched tag"),
        (
            [link("a"), link("b", ""), joint("j", "a", "b")],
            r"line 3, .*'j' moves the link 'b', which has no mass",
        ),
        ([*CHAIN, joint("k", "b", "c", inside='<dynamics damping="-1"/>')], "the damping is -1"),
        ([*CHAIN, joint("k", "b", "c", inside='<dynamics friction="-1"/>')], "the friction is -1"),
        (
            [*CHAIN, joint("k", "b", "c", "revolute", '<limit lower="1" upper="0"/>')],
            "lower is 1, above upper, 0",
        ),
        (["<x/>"] * 10_001, "it has more than 10000 elements"),
    ],
)
def test_bad_files(elements, message):
    with pytest.raises(ss.ModelError, match=message):
        ss.from_urdf(robot(*elements))


def test_entities_and_large_texts_are_rejected(tmp_path):
    for entity in ('"' + "a" * 9 + '"', 'SYSTEM "file:///etc/passwd"'):
        text = f"<!DOCTYPE robot [<!ENTITY e {entity}>]>\n{robot(link('&e;'))}"
        with pytest.raises(ss.ModelError, match="line 1: it declares the entity 'e'"):
            ss.from_urdf(text)
    with pytest.raises(ss.ModelError, match="the closing tag </robot> is missing"):
        ss.from_urdf(f"<robot>{link('a')}")
    with pytest.raises(ss.ModelError, match="more than 10 MB"):
        ss.from_urdf("<robot>" + " " * 10 * 2**20)
    with pytest.raises(ss.StorageError, match="cannot be read"):
        ss.from_urdf(tmp_path / "none.urdf")
    with pytest.raises(ss.ModelError, match=r"<mujoco>, not <robot>.*\n.*from_mjcf"):
        ss.from_urdf("<mujoco/>")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"base": "free"}, "base is 'free'"),
        ({"form": "links"}, "form is 'links'"),
        ({"base": "floating"}, "line 2, .*the base 'a' has no mass"),
        ({"joints": ["jj"]}, "there is no joint 'jj'"),
        ({"locked": {"jj": 1}}, "there is no joint 'jj'"),
        ({"joints": ["j"], "locked": {"j": 1}}, "both in joints and in locked"),
        ({"joints": []}, "no joint moves"),
        ({"gravity": (0, 0)}, "gravity"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ss.SymsimpsonError, match=message):
        ss.from_urdf(robot(*CHAIN, joint("k", "b", "c")), **arguments)


@pytest.mark.parametrize(
    ("inside", "told"),
    [
        ('<dynamics dampin="0.3"/>', "line 4, <dynamics>: the attribute 'dampin' .* damping"),
        ('<dynamic damping="0.3"/>', "the element 'dynamic' is ignored. Did you mean dynamics"),
    ],
)
def test_misspelled_names_warn(inside, told):
    with pytest.warns(ss.ModelWarning, match=told):
        ss.from_urdf(robot(link("a", ""), link("b"), joint("j", "a", "b", inside=inside)))


def test_inertias_that_no_body_has_warn():
    flat = BAR.replace('izz="0.02"', 'izz="0.5"')
    with pytest.warns(ss.ModelWarning, match="no body has the moments of inertia of b"):
        ss.from_urdf(robot(link("a", ""), link("b", flat), joint("j", "a", "b")))


def test_coordinates_inputs_and_limits():
    limit = '<axis xyz="0 0 2"/><limit lower="0.5" upper="1" effort="10" velocity="3"/>'
    text = robot(
        *CHAIN,
        joint("slide", "b", "c", "prismatic", limit),
        link("d"),
        joint("plane", "c", "d", "planar", '<axis xyz="0 0 1"/>'),
    )
    system = ss.from_urdf(text)
    names = [x.func.__name__ for x in system.coordinates]
    assert names == ["j", "slide", "plane_x", "plane_y", "plane_theta"]
    assert [str(x) for x in system.inputs] == [f"tau_{x}" for x in names]
    slide = system.joints["slide"]
    assert system.joints["plane"] == system.coordinates[2:]
    tau = next(x for x in system.inputs if str(x) == "tau_slide")
    assert system.limits == {slide: (0.5, 1.0), slide.diff(time): (-3, 3), tau: (-10, 10)}
    q0, v0 = system.state(velocities={"j": 1})
    np.testing.assert_array_equal([q0, v0], [[0, 0.5, 0, 0, 0], [1, 0, 0, 0, 0]])
    with pytest.raises(ss.InputError, match="the position of 'plane' is 1"):
        system.state({"plane": 1})
    with pytest.raises(ss.InputError, match="no joint 'base' moves"):
        system.state({"base": 1})
    with pytest.raises(ss.ModelError, match=r"there is no link 'e'"):
        system.frame("e")


def test_locked_joints_mimics_and_what_mimics_them():
    follow = joint("k", "b", "c", inside=DROP + '<mimic joint="j" multiplier="2" offset="0.1"/>')
    text = robot(*CHAIN, follow)
    system = ss.from_urdf(text)
    assert [*system.joints] == ["j"]
    assert [str(x) for x in system.inputs] == ["tau_j"]
    j = system.joints["j"]
    position, rotation = system.frame("c")
    expected = sp.Matrix([-2 * sp.sin(j), 0, -2 * sp.cos(j)])
    numbers = {j: 0.3}
    np.testing.assert_allclose(np.array((position - expected).subs(numbers), float), 0, atol=1e-15)
    assert float(rotation[0, 0].subs(numbers)) == pytest.approx(np.cos(0.3 + 2 * 0.3 + 0.1))
    free = robot(*CHAIN, joint("k", "b", "c", inside=DROP))
    locked = ss.from_urdf(free, locked={"j": 0.3})
    assert [*locked.joints] == ["k"]
    only = ss.from_urdf(free, joints="k")
    np.testing.assert_allclose(
        np.ravel(locked.frame("c")[0]).astype(float), [-2 * np.sin(0.3), 0, -2 * np.cos(0.3)]
    )
    np.testing.assert_allclose(np.ravel(only.frame("c")[0]).astype(float), [0, 0, -2])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "damping"), [("continuous", 0.2), ("prismatic", 0.2), ("planar", 0.0)]
)
def test_both_forms_move_alike(kind, damping):
    """A chain with inputs and damping: joints as coordinates, and joints as constraints."""
    inside = f'{DROP}<dynamics damping="{damping}"/>'
    text = robot(
        *CHAIN[:3], joint("j", "a", "b", inside=inside), joint("k", "b", "c", kind, inside)
    )
    ends = []
    for form in ("joints", "bodies"):
        system = ss.from_urdf(text, form=form)
        inputs = {str(x): 0.3 for x in system.inputs}
        q0, v0 = system.state({"j": 0.4}, {"j": 0.1})
        run = ss.compile(system, "gauss8").integrate(q0, v0=v0, h=0.02, steps=20, inputs=inputs)
        assert run.success
        at = dict(zip(system.coordinates, run.q[-1], strict=True))
        ends.append([np.array(x.subs(at), float) for x in system.frame("c")])
    for x, y in zip(*ends, strict=True):
        np.testing.assert_allclose(x, y, atol=1e-12)


def test_copies_and_strange_names():
    """Robots are sent to other processes; names of joints need not be identifiers."""
    text = robot(*CHAIN[:3], joint("a-b", "a", "b"), joint("é 1", "b", "c"))
    system = ss.from_urdf(text)
    copy = pickle.loads(pickle.dumps(system))
    assert copy == system
    assert copy.table() == system.table()
    assert copy.state({"a-b": 1.0, "é 1": 2.0})[0].tolist() == [1.0, 2.0]


@pytest.mark.slow
def test_periodic_orbits_have_the_torques_zero():
    system = ss.from_urdf(robot(*CHAIN, joint("k", "b", "c", inside=DROP)))
    j, k = system.coordinates
    free = {"coordinates": (j, k), "kinetic": system.kinetic, "potential": system.potential}
    periods = [
        ss.compile(x, "gauss8").periodic(mode=([0.0, 0.0], 0), size=0.05, steps=16).period
        for x in (system, ss.MechanicalSystem("free", **free))
    ]
    assert periods[0] == pytest.approx(periods[1], rel=1e-9)  # the amplitudes differ a little


def test_bodies_need_a_mass_and_joints_of_their_own():
    light = robot(
        link("a", ""), link("b", ""), link("c"), joint("j", "a", "b"), joint("k", "b", "c")
    )
    with pytest.raises(ss.ModelError, match=r"'b' has no mass.*\nUse form='joints'"):
        ss.from_urdf(light, form="bodies")
    mimic = robot(*CHAIN, joint("k", "b", "c", inside=DROP + '<mimic joint="j"/>'))
    with pytest.raises(ss.ModelError, match="'k' mimics another one"):
        ss.from_urdf(mimic, form="bodies")


def test_shapes_are_drawn():
    """Corners of a box, two points of a cylinder and of a sphere, and origins of joints."""
    shapes = "".join(
        f'<visual><origin xyz="0 0 1"/><geometry>{x}</geometry></visual>'
        for x in (
            '<box size="1 2 3"/>',
            '<cylinder radius="1" length="2"/>',
            '<sphere radius="1"/>',
            '<mesh filename="none.stl"/>',
        )
    )
    system = ss.from_urdf(robot(link("a", ""), link("b", BAR + shapes), joint("j", "a", "b")))
    assert {"j origin", "b box", "b cylinder 2", "b sphere 3"} == set(map(str, system.positions))
    corners = np.array(
        [[x.subs({system.joints["j"]: 0}) for x in p] for p in system.positions["b box"]]
    )
    assert sorted(set(map(abs, corners[:, 1].astype(float)))) == [1.0]
    assert {-0.5, 2.5} == set(corners[:, 2].astype(float))
