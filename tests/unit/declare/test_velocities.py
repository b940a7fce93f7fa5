"""Velocity constraints as they are declared, and states that satisfy them."""

import warnings

import numpy as np
import pytest
import sympy as sp
from sympy.physics.mechanics import LagrangesMethod

import symsimpson as ss

x, y, th, w = ss.coordinates("x y th w")
m, k = sp.symbols("m k", positive=True)
u = sp.Symbol("u")
BLADE = -sp.sin(th) * x.diff() + sp.cos(th) * y.diff()


def skate(rows=(BLADE,), **changes):
    given = {
        "coordinates": (x, y, th),
        "potential": 0 * x,
        "kinetic": m * (x.diff() ** 2 + y.diff() ** 2 + th.diff() ** 2) / 2,
        "parameters": {m: 1.3, k: 0.5},
        "velocity_constraints": rows,
    }
    return ss.MechanicalSystem("skate", **given | changes)


def test_names_and_forms():
    assert list(skate().velocity_constraints) == ["1"]
    assert list(skate({"blade": BLADE}).velocity_constraints) == ["blade"]
    assert skate(sp.Eq(x.diff(), y * th.diff())).velocity_constraints["1"] == (
        x.diff() - y * th.diff()
    )
    with pytest.warns(ss.ModelWarning, match="'2' follows"):  # one way is left
        both = skate([BLADE], constraints=[x - y])
    assert list(both.constraints) == ["1"]
    assert list(both.velocity_constraints) == ["2"]
    assert (both.degrees_of_freedom, both.velocity_degrees_of_freedom) == (2, 1)
    assert skate().digest != skate([2 * BLADE]).digest != skate(()).digest


def test_rows_and_what_moves_them():
    """A is read off by differentiation, b by what is left at rest."""
    plain = skate([BLADE - k * sp.cos(ss.time) - x]).plain
    *row, b = map(plain.to_sympy, plain.velocity_constraints["1"])
    q, t, a = plain.q, plain.t, plain.parameters[1]
    assert row == [-sp.sin(q[2]), sp.cos(q[2]), 0]
    assert sp.expand(b - a * sp.cos(t) - q[0]) == 0
    assert plain.carried
    assert not plain.autonomous
    assert not plain.conservative
    assert skate().plain.conservative


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ([x - 1], "contains no velocity.\n.*Declare it as constraints"),
        ([0 * x], "is true everywhere"),
        (
            [x.diff() ** 2 - 1],
            "is not linear in the velocities. .*does not determine its constraint force",
        ),
        ([sp.sqrt(x.diff() ** 2 + y.diff() ** 2) - 1], "is not linear"),
        ([sp.Abs(x.diff()) - 1], "Abs"),
        ([x.diff(ss.time, 2)], "a derivative of order 2"),
        ([sp.Symbol("c") * x.diff()], "unknown symbol c"),
        (
            [(x.diff() + 1) ** 2 - x.diff() ** 2 - 2 * x.diff() - 3],
            "cannot be satisfied, because its velocities cancel",
        ),
        ([(x.diff() + 1) ** 2 - x.diff() ** 2 - 2 * x.diff() - 1], "is true everywhere"),
        ({"a": BLADE, "b": k * BLADE}, "'a', 'b' depend on each other"),
        ([BLADE, x.diff(), th.diff()], "3 constraints on 3"),
        ("x", "neither a list nor a mapping"),
        ({3: BLADE}, "is not a printable string"),
    ],
)
def test_what_is_refused(rows, told):
    with pytest.raises(ss.ModelError, match=told):
        skate(rows)


def test_what_does_not_go_together():
    with pytest.raises(ss.ModelError, match="two constraints are called 'a'"):
        skate({"a": BLADE}, constraints={"a": x - y})
    with pytest.raises(ss.ModelError, match="'a', 'b' depend on each other"):
        skate({"b": x.diff() - y.diff()}, constraints={"a": x - y})
    with pytest.raises(ss.ModelError, match=r"velocity [xy]'.*\n.*velocity_constraints"):
        skate((), constraints=[BLADE])
    with pytest.raises(ss.ModelError, match=r"input u\. .*\n.*function of time"):
        skate([BLADE - u], inputs=(u,), forces={x: u})
    with pytest.raises(ss.ModelError, match="'constraints'"):
        skate([BLADE - 1], forces={"constraints": {x: -x}})
    with pytest.raises(ss.ModelError, match="velocity constraints"):
        skate().retimed(1 + x**2)
    for scheme in ("kahan_li8", "blanes_moan4"):
        with pytest.raises(ss.SchemeError, match="violate the velocity constraints '1'"):
            ss.compile(skate(), scheme)
    with pytest.raises(ss.SchemeError, match="Second derivatives of their steps are not"):
        ss.compile(skate()).hessian([0.0] * 3, np.zeros((2, 3)), 0.1, np.ones(6))


@pytest.mark.parametrize(
    ("rows", "constraints", "names"),
    [
        ([x.diff() - k * th.diff()], (), "'1' follows from an equation"),
        ({"a": y * x.diff() + x * y.diff()}, (), "'a' follows"),
        ({"a": BLADE, "b": x.diff() * sp.cos(x) - th.diff()}, (), "'a', 'b' follow from equations"),
        # on a circle of one radius, every blade leaves but one way
        ({"a": th.diff() * x - y.diff()}, [x - y], "'a' follows"),
    ],
)
def test_rows_that_follow_from_positions_are_told(rows, constraints, names):
    """Two rows of three coordinates are always integrable."""
    with pytest.warns(ss.ModelWarning, match=names) as found:
        skate(rows, constraints=constraints)
    assert found[0].filename == __file__


def test_rows_that_do_not_are_left_alone():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # positions that satisfy an equation with the time in it cannot be asked for otherwise
        length = (x**2 + y**2 - (1 + sp.sin(ss.time) / 10) ** 2).diff(ss.time)
        for row in (length, x.diff() - 1):
            skate([row])
        for make in ss.systems.ROLLING.values():
            make()


def test_consistent_velocities():
    system = skate({"blade": BLADE - k * sp.cos(ss.time)})
    q, v = system.consistent([0.1, 0.2, 0.3], [1.0, -1.0, 0.4], t=2.0)
    assert q.tolist() == [0.1, 0.2, 0.3]
    asked = 0.5 * np.cos(2.0)
    assert abs(-np.sin(0.3) * v[0] + np.cos(0.3) * v[1] - asked) < 1e-15
    assert abs(v[2] - 0.4) < 1e-15
    held = system.consistent([0.1, 0.2, 0.3], [1.0, -1.0, 0.4], fixed=("x",), t=2.0)[1]
    assert held[0] == 1.0
    stepper = ss.compile(system)
    with pytest.raises(ss.InputError, match="v0 violates the constraint 'blade'"):
        stepper.integrate(q, v0=[1.0, -1.0, 0.4], h=0.1, steps=1, t0=2.0)
    with pytest.raises(ss.InputError, match="p0 has a component along the constraint"):
        stepper.integrate(q, p0=[1.0, -1.0, 0.4], h=0.1, steps=1, t0=2.0)


def test_equations_have_the_pull():
    *_, turning, row = skate({"blade": BLADE}).equations
    pull = sp.Symbol("lambda_blade")
    assert skate({"blade": BLADE}).equations[1].rhs == -pull * sp.cos(th)
    assert turning.rhs == 0
    assert row == sp.Eq(BLADE, 0)
    assert "velocity constraints" in repr(skate().structure)
    assert r"\lambda" in skate()._repr_latex_()


def test_a_lagranges_method_brings_its_rows():
    method = LagrangesMethod(
        (x.diff() ** 2 + y.diff() ** 2 + th.diff() ** 2 + w.diff() ** 2) / 2,
        [x, y, th, w],
        hol_coneqs=[w - y**3],
        nonhol_coneqs=[BLADE],
    )
    system = ss.MechanicalSystem.from_lagranges_method("skate", method)
    assert list(system.constraints) == ["1"]
    assert list(system.velocity_constraints) == ["2"]
    assert system.velocity_constraints["2"] == BLADE


def test_consistent_velocities_of_any_scale():
    """Of a ship in SI units, and of rows in small ones: the least change there is, in M."""
    keel = sp.cos(th) * y.diff() - sp.sin(th) * x.diff()
    ship = skate([keel], kinetic=(x.diff() ** 2 + y.diff() ** 2) * 5e7 + th.diff() ** 2 * 5e9)
    q, v = ship.consistent([0, 0, 0.5], [1, 0, 0.1])
    assert abs(np.cos(0.5) * v[1] - np.sin(0.5) * v[0]) < 1e-15
    assert v[2] == pytest.approx(0.1, abs=1e-15)
    small = skate([1e-9 * keel])
    assert np.allclose(small.consistent(q, [1, 0, 0.1])[1], v, atol=1e-14)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # which is no less a blade
        skate([1e-10 * keel])


@pytest.mark.parametrize(
    ("rows", "given", "told"),
    [
        ([x.diff() - th * y.diff()], {"fixed": ["x", "y"]}, "with the velocities of x, y fixed"),
        ([x * x.diff() - th * y.diff() - 1], {}, "no velocities at"),
        ([x.diff() - th * y.diff() - ss.time], {"t": np.nan}, "t is not a finite number"),
        ([x.diff() - th * y.diff() - ss.time], {"t": "a"}, "t is not a finite number"),
        ([x.diff() - sp.sqrt(x - 1) * y.diff()], {}, "are not finite at q0"),
    ],
)
def test_velocities_that_there_are_not(rows, given, told):
    with pytest.raises(ss.InputError, match=told):
        skate(rows).consistent([0, 0, 0], [1, 1, 1], **given)


def test_names_that_are_told_apart():
    both = skate([BLADE], coordinates=(x, y, th, w), constraints={"2": w - y}, kinetic=_free())
    assert list(both.velocity_constraints) == ["3"]
    assert list(skate(np.array([BLADE])).velocity_constraints) == ["1"]
    for name in ("", "a\nb"):
        with pytest.raises(ss.ModelError, match="is not a printable string"):
            skate({name: BLADE})
    with pytest.raises(ss.ModelError, match=r"velocity_constraints is '5'.*\n.*x.diff\(\)"):
        skate(5)
    (other,) = ss.coordinates("lambda_b")
    with pytest.raises(ss.ModelError, match="multiplier of a constraint has the name 'lambda_b'"):
        skate({"b": BLADE}, coordinates=(x, y, th, other), kinetic=_free(other))


def test_a_mechanism_that_is_driven_fully():
    """A bead on a circle, whose angle a motor turns by t + sin(t)/2: nothing is left to be free."""
    rate = 1 + sp.cos(ss.time) / 2
    bead = ss.MechanicalSystem(
        "bead",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y,
        constraints={"rod": x**2 + y**2 - 1},
        velocity_constraints={"motor": x * y.diff() - y * x.diff() - rate},
    )
    run = ss.compile(bead).integrate([1, 0], v0=[0, 1.5], h=0.05, steps=8)
    angle, speed = run.t + np.sin(run.t) / 2, 1 + np.cos(run.t) / 2
    assert np.abs(run.q.T - [np.cos(angle), np.sin(angle)]).max() < 1e-7
    force = (speed**2 - 9.81 * np.sin(angle)) / 2
    assert np.abs(run["lambda_rod"] - force).max() < 1e-5
    torque = np.sin(run.t) / 2 - 9.81 * np.cos(angle)
    assert np.abs(run["lambda_motor"] - torque).max() < 1e-5


def test_what_a_driven_mechanism_is_warned_of():
    """Each row follows from the others and the time, but alone the blade holds no position."""
    with pytest.warns(ss.ModelWarning, match="'wall' follows from an equation"):
        skate({"blade": BLADE, "wall": x.diff(), "motor": th.diff() - 1})


def test_a_mechanism_that_cannot_move():
    for given in (
        {"velocity_constraints": [x.diff()]},
        {"constraints": [x - 1]},
        {"velocity_constraints": [x.diff() - 1, x.diff() - sp.cos(ss.time)]},
    ):
        with pytest.raises(
            ss.ModelError, match=r"so nothing can move(.|\n)*fewer constraints than coordinates"
        ):
            skate(**({"rows": None, "coordinates": (x,), "kinetic": m * x.diff() ** 2 / 2} | given))


def _free(*others):
    return sum(q.diff() ** 2 / 2 for q in (x, y, th, *(others or (w,))))


def test_a_row_of_zeros_is_told():
    c = sp.Symbol("c", real=True)
    stepper = ss.compile(skate([c * BLADE], parameters={m: 1.3, c: 0.5}))
    with pytest.raises(
        ss.ModelError, match=r"coefficients of .* are zero at .*(\n.*)*parameters in the constraint"
    ):
        stepper.integrate([0, 0, 0], v0=[1, 0, 1], h=0.1, steps=2, parameters={"c": 0.0})
