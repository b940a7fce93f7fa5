"""Constraints as they are declared, and states that satisfy them."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from sympy.physics.mechanics import LagrangesMethod

import symsimpson as ss

x, y, z = ss.coordinates("x y z")
l, m, g = sp.symbols("l m g", positive=True)
ROD = (x**2 + y**2 + z**2 - l**2) / 2


def pendulum(constraints=(ROD,), **changes):
    given = {
        "coordinates": (x, y, z),
        "potential": m * g * z,
        "kinetic": m * (x.diff() ** 2 + y.diff() ** 2 + z.diff() ** 2) / 2,
        "parameters": {m: 1.3, l: 1.0, g: 9.81},
        "constraints": constraints,
    }
    return ss.MechanicalSystem("held", **given | changes)


def test_names_and_forms():
    assert list(pendulum().constraints) == ["1"]
    assert list(pendulum({"rod": ROD}).constraints) == ["rod"]
    assert pendulum(sp.Eq(x**2 + y**2, l**2)).constraints["1"] == x**2 + y**2 - l**2
    assert pendulum(sp.Matrix([ROD])).degrees_of_freedom == 2
    assert pendulum(None).degrees_of_freedom == 3
    assert pendulum().digest != pendulum(None).digest
    assert pendulum().digest != pendulum([2 * ROD]).digest


@pytest.mark.parametrize(
    ("constraints", "told"),
    [
        ([x.diff() * y], "contains the velocity x'.*\n.*velocity_constraints="),
        ([l - l * (sp.sin(x) ** 2 + sp.cos(x) ** 2)], "is true everywhere"),
        ([l - 2], "depends on no coordinate"),
        ([x + sp.Symbol("other")], "other"),
        ([ROD, 3 * ROD], "'1', '2' depend on each other"),
        ({"a": x + y, "b": y + z, "c": x - z}, "3 constraints on 3"),
        ("x", "neither a list nor a mapping"),
        ({3: x}, "is not a printable string"),
        (["x"], "is the string"),
        ([sp.Abs(x) - 1], "Abs"),
    ],
)
def test_what_is_refused(constraints, told):
    with pytest.raises(ss.ModelError, match=told):
        pendulum(constraints)


def test_one_of_three_that_follows_from_others_is_named():
    q = ss.coordinates("a b c d e")
    kinetic = sum(s.diff() ** 2 for s in q) / 2
    held = {"first": q[0] - q[1], "second": q[2] * q[3], "third": q[1] - q[4], "last": q[4] - q[0]}
    with pytest.raises(ss.ModelError, match=r"constraints 'first', 'third', 'last' depend"):
        ss.MechanicalSystem("loop", coordinates=q, kinetic=kinetic, potential=0, constraints=held)


def test_masses_are_asked_for_only_where_constraints_leave_motion():
    kinetic = x.diff() ** 2 / 2
    ss.MechanicalSystem(
        "lever", coordinates=(x, y), kinetic=kinetic, potential=y, constraints=[y - sp.sin(x)]
    )
    with pytest.raises(ss.ModelError, match="y, z have no mass"):
        ss.MechanicalSystem(
            "loose", coordinates=(x, y, z), kinetic=kinetic, potential=0, constraints=[x - y]
        )


def test_coordinates_may_be_called_as_multipliers_of_a_list_are():
    q = ss.coordinates("lambda_0 lambda_1")
    system = ss.MechanicalSystem(
        "numbers",
        coordinates=q,
        kinetic=sum(x.diff() ** 2 for x in q) / 2,
        potential=q[0],
        constraints=[q[0] ** 2 + q[1] ** 2 - 1],
    )
    run = ss.compile(system).integrate([0.6, 0.8], [0.0, 0.0], h=0.01, steps=5)
    assert (run["lambda_1"] == run.q[:, 1]).all()
    assert run.multipliers.shape == (6, 1)


def test_names_that_two_quantities_would_share():
    (q,) = ss.coordinates("lambda_rod")
    with pytest.raises(ss.ModelError, match="lambda_rod"):
        ss.MechanicalSystem(
            "twice",
            coordinates=(q, x),
            kinetic=q.diff() ** 2 + x.diff() ** 2,
            potential=0,
            constraints={"rod": q - x},
        )


def test_constraints_stand_in_the_structure():
    found = pendulum({"rod": x**2 + y**2 - 1}).structure
    assert [s.coordinates for s in found.subsystems] == [(0, 1), (2,)]
    assert found.cyclic == ()
    assert pendulum({"rod": x**2 + y**2 - 1}, potential=0).structure.cyclic == ("z",)
    assert "phi(q) = 0; degrees of freedom: 2" in " ".join(str(found).split())


def test_other_constructors_take_them():
    L = (x.diff() ** 2 + y.diff() ** 2) / 2 - g * y
    direct = ss.MechanicalSystem.from_lagrangian(
        "swing", L, (x, y), {g: 9.81}, constraints=[x**2 + y**2 - 1]
    )
    method = LagrangesMethod(L, [x, y], hol_coneqs=[x**2 + y**2 - 1])
    read = ss.MechanicalSystem.from_lagranges_method("swing", method, {g: 9.81})
    assert read == direct
    assert read.constraints == direct.constraints


def test_the_nearest_state():
    system = pendulum()
    q, v = system.consistent([0.7, 0.1, -0.8], [0.4, 1.7, 0.4])
    assert abs(q @ q - 1) < 3e-16
    assert abs(q @ v) < 1e-15
    # of a sphere and one mass it is that on the ray
    ray = np.array([0.7, 0.1, -0.8])
    assert np.abs(q - ray / np.linalg.norm(ray)).max() < 1e-9
    held, _ = system.consistent([0.7, 0.1, -0.8], [0, 0, 0], fixed=[x, "y"])
    assert held[:2].tolist() == [0.7, 0.1]
    assert abs(held @ held - 1) < 3e-16
    large, _ = system.consistent([0.7, 0.1, -0.8], [0, 0, 0], parameters={l: 2.0})
    assert abs(large @ large - 4) < 2e-15
    free = pendulum(None)
    assert free.consistent([1, 2, 3], [4, 5, 6])[1].tolist() == [4, 5, 6]
    for one in (system, free):
        with pytest.raises(ss.InputError, match="parameter l is given twice"):
            one.consistent([0.7, 0.1, -0.8], [0, 0, 0], parameters={l: 2.0, "l": 2.0})


@pytest.mark.parametrize("place", sweep([[1.2, 0.2, -1.2], [0.5, 0.9, -1.9], [1.7, -0.3, -1.4]]))
def test_no_state_along_the_constraints_is_nearer(place):
    """Of a linkage whose bars go their ways: looked at all along these."""
    bars, way = ss.systems.four_bar(), np.linspace(-0.7, 0.7, 401)
    q, _ = bars.consistent(place, [0, 0, 0])
    values = dict(zip(bars.coordinates, place, strict=True)) | dict(bars.parameters)
    mass = np.array(bars.mass_matrix.subs(values), dtype=float)

    def away(q):
        return (q - place) @ mass @ (q - place)

    near = [
        bars.consistent([q[0] + turn, *q[1:]], [0, 0, 0], fixed=["t1"])[0] for turn in 0.05 * way
    ]
    assert away(q) <= min(map(away, near)) * (1 + 1e-6)
    assert min(away(near[0]), away(near[-1])) > away(q) + 1e-5


def test_a_state_where_the_nearest_is_not_found():
    """A loop of three bars in angles between them: the way to the nearest goes to and fro."""
    angles = ss.coordinates("a b c")
    turned = [sp.Add(*angles[: k + 1]) for k in range(3)]
    sides = list(zip((1.0, 2.2, 1.6), turned, strict=True))
    loop = ss.MechanicalSystem(
        "loop",
        coordinates=angles,
        kinetic=sum(angle.diff() ** 2 for angle in turned),
        potential=0,
        constraints=[
            sum(l * sp.cos(angle) for l, angle in sides) - 2.5,
            sum(l * sp.sin(angle) for l, angle in sides),
        ],
    )
    q, v = loop.consistent([1.2, -0.9, -1.6], [0.5, 0.0, 0.0])
    ends = np.cumsum([l * np.exp(1j * s) for l, s in zip((1.0, 2.2, 1.6), np.cumsum(q))])  # noqa: B905
    assert abs(ends[-1] - 2.5) < 1e-15
    assert np.abs(q - [1.2, -0.9, -1.6]).max() < 0.3
    assert np.linalg.norm(v) > 0.1


def test_states_that_there_are_not():
    system = pendulum()
    with pytest.raises(ss.InputError, match="no state near"):
        system.consistent([2.0, 2.0, 0.0], [0, 0, 0], fixed=("x", "y"))
    with pytest.raises(ss.InputError, match="fixed contains w"):
        system.consistent([1, 0, 0], [0, 0, 0], fixed=("w",))
    with pytest.raises(ss.InputError, match="no parameter 'k'"):
        system.consistent([1, 0, 0], [0, 0, 0], parameters={"k": 1})
    with pytest.raises(ss.InputError, match="q0 is"):
        system.consistent([1, 0], [0, 0, 0])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"fixed": 3}, "fixed is 3, not a list of coordinates"),
        ({"t": 10**400}, "t is not a finite number"),
        ({"parameters": 2.0}, "is 2.0, not a mapping"),
        ({"parameters": {"l": "a"}}, "the parameter l is 'a', not a finite number"),
        ({"parameters": {"l": [1.0, 2.0]}}, "not a finite number"),
        ({"parameters": {"l": float("nan")}}, "the parameter l is nan, not a finite number"),
    ],
)
def test_absurd_questions_about_states(given, told):
    system = ss.systems.cartesian_pendulum()
    with pytest.raises(ss.InputError, match=told):
        system.consistent([0.0, 0.1, -1.0], [0, 0, 0], **given)
    if "parameters" in given:
        with pytest.raises(ss.InputError, match=told):
            system.linearise([0.0, 0.0, -1.0], **given)


def test_one_coordinate_is_fixed_by_its_name_alone():
    bars = ss.systems.four_bar()
    start = [1.0, 0.3, 1.4], [1.3, 0.0, 0.0]
    for fixed in ("t1", bars.coordinates[0]):
        found = bars.consistent(*start, fixed=fixed)
        assert np.array_equal(found, bars.consistent(*start, fixed=["t1"]))
