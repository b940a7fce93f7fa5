"""Every mistake in a declaration has its own message, with a line that says what to do."""

import pickle
from decimal import Decimal

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

x, y = ss.coordinates("x y")
m, k, g = sp.symbols("m k g", positive=True)
t, OWN_T = sp.Symbol("t"), sp.Symbol("t", real=True)
(P_X,) = ss.momenta(x)
T = m * x.diff() ** 2 / 2
V = k * x**2 / 2


def declare(**changes):
    given = {"coordinates": (x,), "kinetic": T, "potential": V, "parameters": {m: 1.0, k: 2.0}}
    name = changes.pop("name", "spring")
    return ss.MechanicalSystem(name, **(given | changes))


f, c = sp.Function("f"), sp.Symbol("c")
T2 = m * (x.diff() + y.diff()) ** 2 / 2
V_MISSING = k * x**2 / 2 + g * x
WRONG = {
    "unknown symbol": ({"potential": V_MISSING}, "unknown symbol g"),
    "close name": ({"potential": sp.Symbol("kk") * x}, "unknown symbol kk.*Did you mean k"),
    "a coordinate's name": (
        {"potential": k * sp.Symbol("x")},
        r"not the coordinate of that name.*function of time, x\(t\).*Write the coordinate",
    ),
    "velocity as a symbol": ({"kinetic": m * sp.Symbol("v") ** 2}, r"symbol v.*derivative.*q.diff"),
    "no velocity in T": ({"kinetic": m * x**2}, r"contains no velocity.*Write x\(t\).diff\(\)"),
    "a set": ({"coordinates": {x, y}}, "are a set, not a sequence"),
    "a mapping": ({"coordinates": {x: 1.0}}, "are a dict, not a sequence"),
    "momentum's name": (
        {"coordinates": ss.coordinates("p_z z")},
        "p_z has the name of the momentum of z",
    ),
    "energy's name": ({"coordinates": ss.coordinates("energy")}, "has the name of the energy"),
    "time's name": ({"coordinates": ss.coordinates("t")}, "t has the name of the time.*'t'"),
    "invariant energy": ({"invariants": {"energy": x}}, "'energy' has the name of the energy"),
    "invariant x": ({"invariants": {"x": x.diff()}}, "'x' has the name of the coordinate x"),
    "invariant p_x": ({"invariants": {"p_x": 2 * x.diff()}}, "of the momentum of x"),
    "a power that is not real": ({"potential": (-2) ** x}, "which is not real"),
    "overflow": ({"potential": sp.exp(1000) * x}, "number exp.1000. = 1.97E.434, larger"),
    "power of pi": ({"potential": sp.pi**700 * x**2}, "larger than doubles"),
    "a number of gamma": ({"potential": sp.gamma(sp.Rational(1, 3)) * x}, "Evaluate.*2.678938"),
    "cases of parameters": (
        {"potential": sp.Piecewise((k, m > 1), (2 * k, True)) * x**2},
        "of parameters only.*Evaluate it first",
    ),
    "modulus of parameters": ({"potential": sp.Abs(k - m) * x**2}, "parameters only.*Evaluate"),
    "gamma": (
        {"potential": sp.gamma(x)},
        "mathematics library, which lacks gamma or its derivatives",
    ),
    "Bessel": ({"potential": sp.besselj(0, x)}, r"C's mathematics library[^|]*\n *Approximate it"),
    "first order": ({"kinetic": 0, "gyroscopic": x * x.diff()}, "Lagrangian is degenerate"),
    "no function of time": ({"coordinates": (sp.Symbol("x"),)}, "x is not a function of time"),
    "function of space": ({"coordinates": (f(c),)}, "is not a function of time"),
    "coordinates as text": ({"coordinates": "x"}, "not a tuple of functions"),
    "no coordinates": ({"coordinates": ()}, "there are no coordinates"),
    "duplicate": ({"coordinates": (x, x)}, "coordinate x is declared 2 times"),
    "velocity in V": ({"potential": V + x.diff()}, "potential depends on the velocity x'"),
    "time as a parameter": (
        {"potential": t * x, "parameters": {m: 1.0, t: 2.0}},
        "the parameter 't' is the time.*may contain symsimpson.time",
    ),
    "linear in T": ({"kinetic": T + x * x.diff()}, "not a quadratic form.*x.*x'"),
    "constant in T": ({"kinetic": T + x**2}, r"not a quadratic form.*\nMove terms"),
    "a velocity forgotten": (
        {"coordinates": (x, y), "kinetic": T + y**2},
        r"not a quadratic form.*\nDid you mean y.diff\(\)\? Move terms",
    ),
    "missing mass": ({"coordinates": (x, y)}, "does not depend on y'.*zero row"),
    "singular mass": ({"coordinates": (x, y), "kinetic": T2}, "singular for every configuration"),
    "no value": ({"parameters": {m: 1.0, k: None}}, "parameter k has no value"),
    "nan": ({"parameters": {m: 1.0, k: float("nan")}}, "k has the value nan"),
    "infinity": ({"parameters": {m: 1.0, k: float("inf")}}, "k has the value inf"),
    "complex value": ({"parameters": {m: 1.0, k: 1j}}, "not a finite real number"),
    "text value": ({"parameters": {m: 1.0, k: "2"}}, "the value '2', which is not a finite"),
    "boolean value": ({"parameters": {m: 1.0, k: True}}, "not a finite real number"),
    "sign": ({"parameters": {m: -1.0, k: 2.0}}, "m is declared positive and has the value -1"),
    "parameters as list": ({"parameters": [m, k]}, "not a mapping"),
    "parameter no symbol": (
        {"parameters": {m: 1.0, "k": 2.0}},
        r"'k' is not a SymPy symbol.*without quotes: \{m: 1.0\}",
    ),
    "coordinate as a parameter": (
        {"parameters": {m: 1.0, k: 2.0, x: 1.0}},
        "'x' is a coordinate.*Remove it.*each run",
    ),
    "coordinate of another t": (
        {"potential": k * sp.Function("x")(OWN_T) ** 2},
        r"x\(t\), which is not the coordinate x\(t\)\. Its time .* other assumptions.*Write the",
    ),
    "velocity in another t": (
        {"kinetic": m * sp.Function("x")(OWN_T).diff(OWN_T) ** 2},
        r"x\(t\), which is not the coordinate x\(t\)\. Its time .* other assumptions.*Write the",
    ),
    "delayed coordinate": (
        {"potential": k * x * sp.Function("x")(t - 1)},
        r"x\(t - 1\), which is not the coordinate x\(t\)\. Its argument is not the time",
    ),
    "parameter that is a momentum": (
        {"parameters": {m: 1.0, k: 2.0, P_X: 3.0}, "invariants": {"J": x * P_X}},
        "the parameter p_x is also the symbol of a momentum.*ambiguous",
    ),
    "symbol as a momentum": (
        {"invariants": {"J": x * sp.Symbol("p_x")}},
        r"symbol p_x, which is not the momentum .*\(p,\) = symsimpson.momenta\(x\)",
    ),
    "two symbols": ({"potential": sp.Symbol("k") * x**2}, "two symbols have the name 'k'"),
    "two parameters": (
        {"parameters": {m: 1.0, k: 2.0, sp.Symbol("k"): 1.0}},
        "two symbols have the name 'k'",
    ),
    "parameter and coordinate": (
        {"parameters": {m: 1.0, k: 2.0, sp.Symbol("x"): 1.0}},
        "'x': a parameter and a coordinate",
    ),
    "imaginary symbol": (
        {"parameters": {m: 1.0, k: 2.0, sp.Symbol("z", imaginary=True): 1.0}},
        "not real",
    ),
    "text": ({"potential": "k*x**2/2"}, "the potential is the string"),
    "matrix": ({"kinetic": sp.Matrix([T])}, "not a scalar expression"),
    "imaginary unit": ({"potential": sp.I * x}, "which is not real"),
    "root of a negative": ({"potential": sp.sqrt(-m) * x}, "which is not real"),
    "acceleration": ({"kinetic": T + m * x.diff(t, 2)}, "derivative of order 2"),
    "other velocity": ({"kinetic": T + y.diff() ** 2}, "an unknown velocity"),
    "derivative": ({"potential": sp.Derivative(x**2, x)}, "unevaluated Derivative"),
    "integral": ({"potential": sp.Integral(c * x, (c, 0, 1))}, "unevaluated Integral"),
    "undefined function": ({"potential": f(x)}, r"f\(x\), an undefined function.*subs\(f\(x\)"),
    "its derivative": ({"kinetic": T + f(x).diff(t) ** 2}, r"f\(x\), an undefined function"),
    "undefined function of time": ({"potential": f(t)}, "f, which is neither"),
    "undeclared coordinate": ({"potential": V + y}, "y, which is neither"),
    "absolute value": ({"potential": sp.Abs(x)}, "function Abs cannot be differentiated twice"),
    "floor": ({"potential": sp.floor(x)}, "function floor cannot"),
    "cases": ({"potential": sp.Piecewise((x, x > 0), (0, True))}, "Piecewise|defined by cases"),
    "infinite": ({"potential": V + sp.zoo}, "not a finite number|not real"),
    "name": ({"name": "../spring"}, "cannot be the name of a file"),
    "empty name": ({"name": ""}, "cannot be the name of a file"),
    "name no text": ({"name": 3}, "cannot be the name of a file"),
    "position": (
        {"positions": {"bob": (x.diff(),)}},
        "velocity x'.\nIt may depend on positions only.*Remove x'",
    ),
    "invariant": ({"invariants": {"J": g * x}}, "invariant 'J' contains the unknown symbol g"),
    "invariants in an array": ({"invariants": np.zeros(2)}, "a ndarray, not a mapping from names"),
    "gyroscopic": ({"gyroscopic": x.diff() ** 2}, "not linear in the velocities"),
}


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_message(changes, message):
    with pytest.raises(ss.ModelError, match=f"(?s){message}") as caught:
        declare(**changes)
    what, _, remedy = str(caught.value).partition("\n")
    assert len(what) > 20
    assert len(remedy) > 20


@pytest.mark.parametrize("names", ["lambda: 3", "a:", "\0"])
def test_names_that_no_coordinates_can_have(names):
    with pytest.raises(ss.ModelError, match="coordinates cannot have the names"):
        ss.coordinates(names)


def test_messages_name_the_system():
    with pytest.raises(ss.ModelError, match=r"^system 'my_cart'"):
        declare(name="my_cart", potential=V_MISSING)


def test_plain_numbers_are_expressions():
    assert declare(potential=0).potential == 0
    assert declare(parameters={m: sp.Rational(1, 2), k: sp.pi}).parameters[k] == float(sp.pi)
    for one in (np.array(2.0), np.array(2), np.float32(2), Decimal(2)):
        assert declare(parameters={m: 1.0, k: one}).parameters[k] == 2.0
    for none in (np.array([2.0]), np.array(True), np.array(2j), np.bool_(True), sp.Array(2)):
        with pytest.raises(ss.ModelError, match=r"k has the value .* not a finite"):
            declare(parameters={m: 1.0, k: none})


def test_a_system_is_frozen_and_known_by_its_equations():
    system = declare()
    with pytest.raises(AttributeError):
        system.name = "other"
    with pytest.raises(TypeError):
        system.parameters[m] = 3.0
    heavier = declare(parameters={m: 5.0, k: 2.0})
    assert system == declare()
    assert hash(system) == hash(declare())
    assert system != heavier
    assert system.digest == heavier.digest
    assert system.digest != declare(potential=V**2).digest
    assert (system.n, system.mass_matrix[0, 0]) == (1, m)
    assert sp.simplify(system.lagrangian - (T - V)) == 0


JUMPS = {
    "step": sp.Heaviside(ss.time - 1),
    "stairs": sp.floor(ss.time),
    "corner": sp.Abs(sp.sin(ss.time)),
    "larger": sp.Max(ss.time, 1),
    "sign": sp.sign(sp.cos(ss.time)),
    "saw": sp.Mod(ss.time, 2),
    "cases": sp.Piecewise((1, ss.time > 1), (0, True)),
    "cases of the time": sp.Piecewise((y, ss.time > m), (x, True)),
}


@pytest.mark.parametrize("name", JUMPS)
def test_functions_of_time_with_jumps(name):
    """Neither is made of parameters alone; an input has such values."""
    for changes in ({"forces": {x: JUMPS[name]}}, {"potential": V + x * JUMPS[name]}):
        with pytest.raises(
            ss.ModelError, match=r"a function of time with jumps.*\n.*inputs=\(u,\)"
        ):
            declare(coordinates=(x, y), kinetic=T2 + T, **changes)
    smooth = (1 + sp.tanh((ss.time - 1) / sp.Rational(1, 100))) / 2
    assert declare(forces={x: smooth}).plain.forces


def test_functions_that_compiled_code_does_not_have():
    with pytest.raises(ss.ModelError, match="of time that compiled code does not have: besselj"):
        declare(forces={x: sp.besselj(0, ss.time)})


def test_functions_of_time_that_are_not_declared():
    length = sp.Function("ell")(ss.time)
    for given, message in (
        (length, r"inputs=\(ell,\).*\.subs\(ell, \.\.\.\)\.doit\(\)"),
        (length.diff(), r"ell', an unknown velocity.*given function of time.*L\.subs\(ell"),
        (sp.Function(r"\dot{q}")(ss.time).diff(), r"\\dot\{q\}', an unknown velocity"),
    ):
        with pytest.raises(ss.ModelError, match=f"(?s){message}"):
            ss.MechanicalSystem.from_lagrangian("crane", T - V + x * given, (x,), {m: 1.0, k: 2.0})
    taken = (T - V + x * length.diff()).subs(length, sp.cos(ss.time)).doit()
    assert ss.MechanicalSystem.from_lagrangian("crane", taken, (x,), {m: 1.0, k: 2.0}).n == 1


def test_a_time_with_assumptions():
    own = sp.Symbol("t", positive=True)
    q = sp.Function("theta")(own)
    with pytest.raises(ss.ModelError, match=r"theta is a function of a symbol t with assumptions"):
        ss.MechanicalSystem.from_lagrangian("own", q.diff(own) ** 2 / 2, (q,))
    other = sp.Function("theta")(sp.Symbol("s"))
    with pytest.raises(ss.ModelError, match="is not a function of time"):
        ss.MechanicalSystem.from_lagrangian("own", other.diff() ** 2 / 2, (other,))


def test_points_may_move_with_the_time():
    assert declare(positions={"bob": (x + sp.cos(ss.time), 0)}).positions["bob"][1] == 0


def test_a_name_that_ends_with_the_time_is_refused():
    """Names are told apart without it, so that its run could not be opened again."""
    x = sp.Function("x(t)")(ss.time)
    with pytest.raises(ss.ModelError, match=r"contains the time(.|\n)*Function\('x'\)\(t\)"):
        ss.MechanicalSystem("odd", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=x**2)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda theta, m: m * theta.diff() ** 2 / 2,
        lambda theta, m: m * theta,
        lambda theta, m: 2.0 * theta,
        lambda theta, m: theta + m,
        lambda theta, m: m - theta,
        lambda theta, m: theta**2,
        lambda theta, m: -theta / 2,
    ],
)
def test_the_tuple_of_one_coordinate_is_not_the_coordinate(wrong):
    theta, m = ss.coordinates("theta"), sp.Symbol("m", positive=True)
    with pytest.raises(ss.ModelError, match=r"Write \(theta,\) = symsimpson"):
        wrong(theta, m)
    (angle,) = theta
    assert theta == (angle,)
    assert theta + theta == 2 * theta == (angle, angle)
    assert sp.Matrix(theta) == sp.Matrix([angle])
    assert pickle.loads(pickle.dumps(theta)) == theta
