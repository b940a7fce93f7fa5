"""What may be retimed, by which rates."""

import pickle

import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.declare.retimed import level

x, y = ss.coordinates("x y")
m, k = sp.symbols("m k", positive=True)


ATTRACTS = -k / sp.sqrt(x**2 + y**2)


def system(potential=ATTRACTS, **more):
    return ss.MechanicalSystem(
        "plane",
        coordinates=(x, y),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=potential,
        parameters={m: 2.0, k: 3.0},
        **more,
    )


def test_the_lagrangian_in_tau():
    r = 1 + x**2
    found = system(gyroscopic=x * y.diff()).retimed(r)
    first = next(a for a in found.parameters if str(a) == "g_start")
    assert sp.simplify(found.kinetic - found.original.kinetic * first / r) == 0
    assert sp.simplify(found.potential - r / first * (found.original.potential - ss.energy)) == 0
    assert found.gyroscopic == found.original.gyroscopic
    assert isinstance(found, ss.RetimedSystem)
    assert found.digest != system(gyroscopic=x * y.diff()).retimed(r**2).digest
    assert pickle.loads(pickle.dumps(found)) == found


def test_rates_by_name():
    assert system().retimed("encounters").rate == (k / sp.sqrt(x**2 + y**2)) ** sp.Rational(-3, 2)
    assert system().retimed("encounters").of_level == (-level) ** sp.Rational(-3, 2)
    kinetic = system(potential=k * x**2 / 2 + y**4).retimed("kinetic")
    assert {str(a) for a in kinetic.parameters} == {"m", "k", "c_rest", "E0", "g_start"}


@pytest.mark.parametrize("potential", [0, x**2 / 2 + y**3, 1 - sp.cos(x)])
def test_the_kinetic_rate_of_potentials_without_parameters(potential):
    assert "c_rest" in map(str, system(potential=potential).retimed("kinetic").parameters)


def test_the_kinetic_rate_does_not_depend_on_the_origin_of_the_potential():
    b = sp.Symbol("b", real=True)
    softened = -k / sp.sqrt(x**2 + y**2 + b**2)  # SymPy writes -k/Abs(b) at the origin
    for potential in (softened, k * x**2 / 2, ATTRACTS):
        plain, moved = (
            ss.MechanicalSystem(
                "plane",
                coordinates=(x, y),
                kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2,
                potential=potential + constant,
                parameters={m: 2.0, k: 3.0, b: 0.5},
            ).retimed("kinetic")
            for constant in (0, 7)
        )
        assert sp.simplify(moved.rate.subs(ss.energy, ss.energy + 7) - plain.rate) == 0


def test_functions_of_the_potential_are_known():
    r = sp.sqrt(x**2 + y**2)
    for rate, power in ((r, -1), (5 * r ** sp.Rational(3, 2), sp.Rational(-3, 2)), (k / r, 1)):
        found = system().retimed(rate)
        assert found.of_level == (-level) ** power
        assert sp.simplify(found.rate / rate).free_symbols <= {k}
    own = system(potential=-k * sp.exp(-(x**2)) - y**2)
    assert own.retimed(1 / (2 - own.potential)).of_level == 1 / (2 - level)
    for rate in (1 + x**2, x**2, r + r**2):
        assert system().retimed(rate).of_level is None


WRONG = [
    ("close", "no rate named 'close'"),
    (-(x**2), "nowhere positive"),
    (sp.S.Zero, "nowhere positive"),
    (x.diff(), "velocity"),
    (ss.time, "symbol t"),
    (sp.Symbol("b"), "unknown symbol b"),
]


@pytest.mark.parametrize(("rate", "told"), WRONG)
def test_rates_that_make_no_sense(rate, told):
    with pytest.raises(ss.ModelError, match=told):
        system().retimed(rate)


def test_systems_whose_energy_is_not_constant():
    for other, told in (
        (system(forces={x: -x.diff()}), "forces act on it"),
        (system(potential=x * sp.cos(ss.time)), "depends on the time"),
        (system(constraints={"rod": x**2 + y**2 - 1}), "because it has constraints"),
        (system().retimed("encounters"), "already retimed"),
    ):
        with pytest.raises(ss.ModelError, match=told):
            other.retimed(1 + x**2)


@pytest.mark.parametrize("potential", [k * x**2, k / sp.sqrt(x**2 + y**2), -k / (x**2 + y**2)])
def test_encounters_are_those_of_inverse_distances(potential):
    with pytest.raises(ss.ModelError, match="not a sum of"):
        system(potential=potential).retimed("encounters")


def test_terms_without_a_pole_do_not_matter_to_encounters():
    """The restricted problem of three bodies, and Hill's, turn with their primaries."""
    near = -k / sp.sqrt((x + 1) ** 2 + y**2) - m / sp.sqrt(x**2 + y**2)
    for rest in (-(x**2 + y**2) / 2, 3 * x**2 * sp.cos(y) - 5, k * (x - sp.sqrt(1 + y**2)), m):
        found = system(potential=near + rest).retimed("encounters")
        assert sp.simplify(found.rate - (-near) ** sp.Rational(-3, 2)) == 0
        assert found.of_level is None
    held = system(potential=-k * (1 / sp.sqrt(x**2 + y**2) + x**2)).retimed("encounters")
    assert sp.simplify(held.rate - (-ATTRACTS) ** sp.Rational(-3, 2)) == 0


@pytest.mark.parametrize("other", [1 / x**2, k / sp.sqrt(x**2 + 1), sp.log(x**2 + y**2), sp.tan(x)])
def test_the_term_that_is_no_encounter_is_told_in_full(other):
    with pytest.raises(ss.ModelError, match=r"without a pole.* is neither") as told:
        system(potential=ATTRACTS - x**2 + other).retimed("encounters")
    assert "..." not in str(told.value)
    assert str(other).replace("(t)", "") in str(told.value)


def test_names_that_retiming_takes():
    own = sp.Symbol("E0", positive=True)
    other = ss.MechanicalSystem(
        "plane",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=own * x**2,
        parameters={own: 1.0},
    )
    with pytest.raises(ss.ModelError, match="name of a parameter that retiming adds"):
        other.retimed(1 + x**2)


def test_quarter_powers_are_square_roots():
    text = ss.compile(system().retimed("encounters"), "simpson").source
    body = text[text.index("def newton(") :]
    assert "sqrt(sqrt(" in text
    assert "**(" not in body


def test_equations_of_one_energy_are_not_linearised():
    """E0 stands in them, which belongs to the state: at a default of 0 they are other ones."""
    with pytest.raises(ss.InputError, match=r"system\.original\.linearise"):
        system().retimed("encounters").linearise([1.0, 0.0], [0.0, 1.0])
    A, _ = system().retimed("encounters").original.linearise([1.0, 0.0], [0.0, 1.0])
    assert A.shape == (4, 4)
