"""What a key means, and what was probably meant."""

import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.support.names import NameTable, as_mapping, did_you_mean, spelled

THETA = sp.Function(r"\theta_1")(ss.time)
Q0 = sp.Function("q0")(ss.time)
COORDINATES = NameTable("coordinate", ("q0", "q0_2"), (r"\theta_1", "q0"))


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("x", "x"),
        ("x(t)", "x"),
        (THETA, r"\theta_1"),
        (THETA.diff(), r"v_\theta_1"),
        (sp.Symbol("x'", positive=True), "x'"),
        (sp.Dummy("m"), "m"),
        (3, "3"),
        (None, "None"),
    ],
)
def test_what_a_key_means(key, name):
    assert spelled(key) == name


def test_a_users_own_names_come_first():
    assert COORDINATES.place(THETA) == COORDINATES.place(r"\theta_1") == 0
    assert COORDINATES.place("q0") == 1  # which is the module's name of the other one
    assert COORDINATES.place("q0_2") == 1
    assert COORDINATES.place(THETA.diff()) is None


def test_values_by_name():
    assert COORDINATES.in_order("q0", {"q0": 2, THETA: 1}) == [1, 2]
    assert COORDINATES.in_order("q0", (1, 2)) == (1, 2)
    for given in ({THETA.diff(): 1, "q0": 2}, {r"v_\theta_1": 1, "v_q0": 2}, {THETA: 1, "v_q0": 2}):
        assert COORDINATES.in_order("v0", given) == [1, 2]
    assert NameTable("coordinate", ("x", "v_x")).in_order("v0", {"v_x": 2, "x": 1}) == [1, 2]
    assert COORDINATES.in_order("p0", {r"p_\theta_1": 1, "p_q0": 2}) == [1, 2]
    with pytest.raises(ss.InputError, match=r"q0: there is no coordinate 'p_q0'"):
        COORDINATES.in_order("q0", {"p_q0": 1, THETA: 2})
    with pytest.raises(ss.InputError, match=r"p0: there is no coordinate 'v_"):
        COORDINATES.in_order("p0", {THETA.diff(): 1, "q0": 2})
    with pytest.raises(ss.InputError, match=r"v0: there is no coordinate 'v_y'"):
        COORDINATES.in_order("v0", {"v_y": 1, "q0": 2})
    for given, message in (
        ({"q0": 1}, r"q0 has no number for \\theta_1"),
        ({THETA: 1, r"\theta_1": 1, "q0": 2}, "twice, by name and by symbol"),
        ({"theta_1": 1, "q0": 2}, r"no coordinate 'theta_1'. Did you mean \\theta_1\?"),
    ):
        with pytest.raises(ss.InputError, match=message):
            COORDINATES.in_order("q0", given)


def test_rows_of_tables_give_values_by_their_labels():
    pandas = pytest.importorskip("pandas")
    row = pandas.Series({"q0": 2.0, r"\theta_1": 1.0})
    assert COORDINATES.in_order("q0", row) == [1, 2]
    assert COORDINATES.in_order("p0", row.add_prefix("p_")) == [1, 2]
    assert COORDINATES.in_order("q0", pandas.Series([2.0, 1.0], [Q0, THETA])) == [1, 2]
    columns = COORDINATES.in_order("q0", pandas.DataFrame({"q0": [2, 4], r"\theta_1": [1, 3]}))
    assert [list(column) for column in columns] == [[1, 3], [2, 4]]
    with pytest.raises(ss.InputError, match="there is no coordinate 'a'"):
        COORDINATES.in_order("q0", pandas.Series({"a": 1.0, "b": 2.0}))
    numbered = pandas.Series([1.0, 2.0], index=[7, 5])
    assert as_mapping(numbered) is numbered
    assert as_mapping(dict) is dict


@pytest.mark.parametrize(
    ("name", "meant"), [("th", "theta"), ("simspon", "simpson"), ("zzz", ""), (7, "")]
)
def test_what_was_probably_meant(name, meant):
    found = did_you_mean(name, ["theta", "simpson", "x"])
    assert found == (f" Did you mean {meant}?" if meant else "")


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        (lambda: ss.compile(ss.systems.pendulum(), "simspon"), ss.SchemeError, "mean simpson?"),
        (lambda: ss.composition("kahan_li7"), ss.SchemeError, "mean kahan_li[68]?"),
        (lambda: ss.systems.double_pendulums, AttributeError, "mean double_pendulum?"),
        (
            lambda: ss.compile(ss.systems.pendulum, "midpoint"),
            ss.GenerationError,
            r"Call it: symsimpson\.systems\.pendulum\(\)",
        ),
        (
            lambda: ss.compile(ss.systems.pendulum(), exploit="ciclic"),
            ss.GenerationError,
            "mean cyclic?",
        ),
    ],
)
def test_names_of_the_package(call, kind, message):
    with pytest.raises(kind, match=message):
        call()


def test_what_is_given_by_name_and_by_symbol_is_refused_by_all_readers():
    (x,) = ss.coordinates("x")
    k, u = sp.symbols("k u", positive=True)
    about = {"coordinates": (x,), "kinetic": x.diff() ** 2 / 2, "potential": k * x**2 / 2}
    about |= {"parameters": {k: 1.0}, "forces": {x: u}, "inputs": (u,)}
    system = ss.MechanicalSystem("twice", **about)
    stepper, given = ss.compile(system), {"v0": [0.0], "h": 0.1, "steps": 3}
    values, inputs = {k: 2.0, "k": 3.0}, {u: 1.0, "u": 2.0}
    leap = ss.Event(x, name="leap", action=ss.Change(velocities={x: 1.0, "x": 2.0}))
    asked = (
        lambda: stepper.integrate([1.0], parameters=values, **given),
        lambda: stepper.integrate([1.0], inputs=inputs, **given),
        lambda: stepper.integrate([1.0], inputs={"u": 1.0}, events=leap, **given),
        lambda: stepper.ensemble([[1.0]], parameters=values, **given),
        lambda: stepper.ensemble([[1.0]], inputs=inputs, **given),
        lambda: stepper.energy([[1.0]], [[0.0]], parameters=values),
        lambda: stepper.certify(inputs=inputs),
        lambda: system.linearise([1.0], parameters=values),
        lambda: ss.MechanicalSystem("twice", **about, units={x: "m", "x": "mm"}),
    )
    for ask in asked:
        with pytest.raises((ss.InputError, ss.ModelError), match=r"twice.*\nGive it once"):
            ask()
