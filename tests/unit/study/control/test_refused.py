"""Parts of a problem of optimal control, of a guess and of gains that are refused in words."""

import sys
import warnings

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

pytest.importorskip("casadi")

x, y = ss.coordinates("x y")
u, w, s = (sp.Symbol(name, real=True) for name in "uws")
k = sp.Symbol("k", positive=True)
v_x = x.diff()
CART = ss.MechanicalSystem(
    "cart",
    coordinates=(x,),
    kinetic=v_x**2 / 2,
    potential=k * x**2 / 2,
    parameters={k: 2.0},
    forces={x: u},
    inputs=(u,),
)
REST = {"start": {x: 0, v_x: 0}, "end": {x: 1, v_x: 0}}


def cart(**more):
    return ss.OptimalControl(CART, **{"cost": u**2, "duration": 1, **REST, **more})


@pytest.mark.parametrize(
    ("more", "name"),
    [
        ({"bounds": {u: (-4.5, 4.5), "u": (-30, 30)}}, "bounds gives u"),
        ({"bounds": {x: (-4, 4), "x": (-3, 3)}}, "bounds gives x"),
        ({"bounds": {v_x: (-4, 4), "v_x": (-3, 3)}}, "bounds gives v_x"),
        ({"start": {x: 0, "x": 1}}, "start gives x"),
        ({"end": {v_x: 0, "v_x": 1}}, "end gives v_x"),
        ({"unknowns": {k: (1, 2), "k": (1, 3)}}, "unknowns gives k"),
        ({"phases": [{}, {u: 1, "u": -1}]}, r"phases\[1\] gives u"),
        ({"conditions": {x: x, "x": x + 1}}, "conditions gives x"),
        ({"signals": {s: 1.0, sp.Symbol("s"): 2.0}}, "signals gives s"),
    ],
)
def test_what_is_given_twice(more, name):
    with pytest.raises(ss.InputError, match=f"{name} twice.*\nGive it once"):
        cart(**more)


@pytest.mark.parametrize("what", ["cost", "final_cost"])
@pytest.mark.parametrize("given", [10**400, np.nan, -np.inf])
def test_costs_that_are_no_finite_numbers(what, given):
    with pytest.raises(ss.InputError, match=f"the {what} is .*\nPass a finite number"):
        cart(**{what: given})


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("steps", 10**400),
        ("steps", [10**12]),
        ("steps", np.array("x")),
        ("steps", np.ma.masked),
        ("error", np.zeros(0)),
        ("error", np.ones(2)),
        ("error", np.array([None])),
        ("tolerance", np.ones(2)),
        ("most_iterations", 10**400),
        ("most_iterations", 2**31),
        ("most_iterations", np.ones(2)),
    ],
)
def test_numbers_of_the_search_that_are_none(name, given):
    with pytest.raises(ss.InputError, match=rf"(?s){name} is .*\nPass a (whole )?number"):
        cart().solve(**{"steps": 2} | {name: given})


def test_the_condensed_form_is_deprecated():
    with pytest.warns(DeprecationWarning, match=r"no effect.*\nLeave condensed out"):
        found = cart().solve(steps=4, condensed=True)
    assert found.cost == cart().solve(steps=4).cost


def test_guesses_that_are_given_twice():
    with pytest.raises(ss.InputError, match="guess gives x twice"):
        cart().solve(steps=2, guess={x: 0.0, "x": 1.0})


@pytest.mark.parametrize(
    "given", [[u**2], sp.Matrix([u**2]), np.array([u, u]), {}, sp.sin, None, True]
)
@pytest.mark.parametrize("what", ["cost", "final_cost", "path"])
def test_what_is_no_expression(what, given):
    with pytest.raises(ss.ModelError, match=rf"the {what} is .*not a scalar expression.*\n"):
        cart(**{what: [(0, given, 1)] if what == "path" else given})


@pytest.mark.parametrize(
    "given", [[u], sp.Matrix([1, 2]), (1, [2]), "3", ("0", 1), 1j, (1, 2, 3), True]
)
@pytest.mark.parametrize("what", ["bounds", "unknowns"])
def test_bounds_that_are_no_numbers(what, given):
    with pytest.raises(ss.InputError, match=rf"(?s){what}\[.\] is .*\nPass a number, or a pair"):
        cart(**{what: {(u if what == "bounds" else k): given}})


def test_arguments_are_explained():
    with pytest.raises(ss.InputError, match=r"duration is missing.*\nPass a positive number"):
        ss.OptimalControl(CART, cost=1)
    with pytest.raises(ss.InputError, match=r"no argument durration=\. Did you mean duration=\?"):
        ss.OptimalControl(CART, cost=1, durration=2)
    with pytest.raises(ss.InputError, match=r"got 2 positional arguments, and takes at most 1"):
        ss.OptimalControl(CART, u**2, duration=2)


@pytest.mark.parametrize("what", ["bounds", "unknowns", "start"])
@pytest.mark.parametrize(
    ("given", "told"),
    [
        ((np.inf, np.inf), "contains no finite number"),
        ((-np.inf, -np.inf), "contains no finite number"),
        ((None, -np.inf), "contains no finite number"),
        ((np.nan, 1), "contains NaN"),
        ((0, np.nan), "contains NaN"),
        ((10**400, None), "Pass a number, or a pair"),
    ],
)
def test_bounds_between_which_nothing_lies(what, given, told):
    key = {"bounds": u, "unknowns": k, "start": x}[what]
    with pytest.raises(ss.InputError, match=rf"(?s){what}\[{key.name}\] is .*{told}"):
        cart(**{what: {key: given}})


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"bounds": {v_x: (1, 2)}}, r"start has v_x = 0, outside of its bounds \(1, 2\)"),
        ({"bounds": {"v_x": (None, -1)}}, "start has v_x = 0, outside"),
        ({"bounds": {x + 2 * v_x: (0, 1)}, "end": {x + 2 * v_x: 3}}, "end has .* = 3, outside"),
        (
            {"path": [v_x], "end": {v_x: (1, 2)}},
            r"end has v_x = \(1, 2\).*\n.*or choose values of end inside them",
        ),
    ],
)
def test_ends_outside_of_bounds(more, told):
    with pytest.raises(ss.InputError, match=told):
        cart(**more)


def test_an_end_that_an_equation_gives_is_no_number():
    """Twice the parameter that is found, 2 ... 6, is no 0: not for bounds, nor for a guess."""
    problem = cart(end={x: 2 * k, v_x: 0}, bounds={x: (-0.5, 7)}, unknowns={k: (1, 3)}, start={})
    assert problem.solve("gauss4", steps=4).success
    near = cart(start={x: k}, bounds={x: (1, 3)}, end={}).solve("gauss4", steps=4)
    assert near.success
    assert abs(near.q[0, 0] - 2) < 1e-9
    twice = cart(end={2 * x: 1}, start={x: 0}).solve("gauss4", steps=4, most_iterations=0)
    assert abs(twice.q[-1, 0] - 0.5) < 1e-12


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ((0, 3), "low must be above 0"),
        ((None, 3), "low must be above 0"),
        ((1, None), "high must be finite"),
        ((1, np.inf), "high must be finite"),
        (-1, "it must be above 0"),
        (np.nan, "contains NaN"),
        ("2", "duration is '2'"),
        (True, "duration is True"),
        ([1, 2, 3], r"duration is \[1, 2, 3\]"),
    ],
)
def test_durations(given, told):
    with pytest.raises(ss.InputError, match=rf"{told}.*\nPass a positive number, duration="):
        cart(duration=given)


@pytest.mark.parametrize(
    ("guess", "told"),
    [
        ({"duration": np.nan}, r"guess\['duration'\] is nan, which is not a finite number"),
        ({"duration": None}, r"guess\['duration'\] is None"),
        ({"duration": "2"}, r"guess\['duration'\] is '2'"),
        ({"duration": [1.0]}, r"guess\['duration'\] is \[1.0\]"),
        ({"duration": -1}, r"guess\['duration'\] is -1: not positive.\nPass a positive"),
        ({"k": np.inf}, r"guess\['k'\] is inf"),
        ({x: None}, r"guess\['x'\] is None"),
        ({x: [None, 1.0]}, r"guess\['x'\] is \[None, 1.0\]"),
        ({x: "1"}, r"guess\['x'\] is '1'"),
        ({x: np.array([1j, 2])}, r"guess\['x'\] is array.*complex, where real"),
        ({x: lambda t: np.exp(1j * t)}, r"the value of guess\['x'\] is array.*\n?.*complex"),
        ({x: sp.I * ss.time}, "complex, where real"),
        ({x: k * ss.time}, r"guess\['x'\] is .*contains k\.\n"),
        ({x: x * ss.time}, "contains x"),
        ({x: sp.Symbol("t", real=True)}, "This symbol t is not symsimpson.time"),
        ({x: sp.Function("f")(ss.time)}, "contains f"),
    ],
)
def test_guesses(guess, told):
    problem = cart(unknowns={k: (1, 3)}, duration=(0.5, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ss.InputError, match=told):
            problem.solve(steps=2, guess=guess)


def test_expressions_of_the_time_are_functions():
    found = cart(start={}, end={}).solve(
        steps=3, most_iterations=0, guess={x: sp.sin(ss.time) + sp.erf(ss.time), u: sp.Integer(2)}
    )
    ends = np.array([0, 1, 2, 3]) / 3
    expected = [float(sp.sin(t) + sp.erf(t)) for t in ends]
    assert np.abs(found.q[:, 0] - expected).max() < 1e-12
    assert (found.input_values == 2).all()
    by_function = {s: np.sin}, {s: sp.sin(ss.time)}
    costs = [
        cart(cost=u**2 + (x - s) ** 2, signals=given).solve("gauss4", steps=4).cost
        for given in by_function
    ]
    assert costs[0] == costs[1]
    with pytest.raises(ss.InputError, match=r"signals\[s\] is .*contains w"):
        cart(cost=u**2 + s, signals={s: w * ss.time}).solve("gauss4", steps=2)


def test_solutions_are_written_to_files_of_one_kind(tmp_path):
    found = cart().solve("gauss4", steps=3)
    with pytest.raises(ss.InputError, match=r"Use the extension \.npz\. The save method"):
        found.save(tmp_path / "cart.csv")
    assert not [*tmp_path.iterdir()]


def test_functions_of_guesses_and_signals_get_a_row_of_times():
    """As the dense output of SciPy's solve_ivp takes it."""
    from scipy.integrate import solve_ivp

    run = solve_ivp(lambda t, z: [z[1], -z[0]], (0, 1), [0, 1], dense_output=True).sol
    found = cart(start={}, end={}).solve(
        "gauss4", steps=3, most_iterations=0, guess={x: lambda t: run(t)[0], u: lambda t: run(t)[1]}
    )
    assert np.abs(found.q[:, 0] - run(np.arange(4) / 3)[0]).max() < 1e-12
    assert found.inputs(0.5)["u"] == pytest.approx(run(0.5)[1], abs=1e-2)
    followed = cart(cost=(x - s) ** 2 + u**2, signals={s: lambda t: run(t)[0]})
    assert followed.solve("gauss4", steps=3).success
    with pytest.raises(ss.InputError, match=r"signals\[s\]: its function returns shape \(2,\)"):
        cart(cost=s**2 + u**2, signals={s: run}).solve("gauss4", steps=3)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"bounds": {"vx": (0, 1)}}, r"bounds contains 'vx'.*Did you mean v_x\?\n.*x, v_x, u\. "),
        ({"conditions": {"xx": x}}, r"conditions contains 'xx'.* velocity\..*\n.*x, v_x\. "),
        ({"conditions": {x: "vx"}}, "conditions contains 'vx'"),
        ({"path": ["vx"]}, r"path contains 'vx'.*Did you mean v_x\?"),
        ({"start": {"xx": 0}}, r"start contains 'xx', which is not a coordinate or velocity"),
        ({"start": {x: "vx"}}, r"start contains 'vx'.*Did you mean v_x\?"),
        ({"cost": "u**2"}, r"cost contains 'u\*\*2'.*\n.*Strings are never evaluated"),
    ],
)
def test_names_that_are_not_there(more, told):
    with pytest.raises(ss.InputError, match=told):
        cart(**more)


def test_results_of_other_systems_are_no_guesses():
    found = cart().solve("gauss4", steps=3)
    other = ss.MechanicalSystem(
        "other",
        coordinates=(y,),
        kinetic=y.diff() ** 2 / 2,
        potential=0,
        forces={y: w},
        inputs=(w,),
    )
    problem = ss.OptimalControl(
        other, cost=w**2 + y**4, start={y: 0, y.diff(): 0}, end={y: 1, y.diff(): 0}, duration=1
    )
    with pytest.raises(
        ss.InputError, match=r"a result of cart, which has x, u\. other has y, w\.\n"
    ):
        problem.solve("gauss4", steps=3, guess=found)
    both = ss.MechanicalSystem(
        "both",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=0,
        forces={x: u, y: w},
        inputs=(u, w),
    )
    more = ss.OptimalControl(both, cost=u**2 + w**2, duration=1, end={x: 1, y: 1})
    held = more.solve("gauss4", steps=3, guess=found, most_iterations=0)  # as a mapping of its part
    assert np.abs(held.q[:, 0] - found.q[:, 0]).max() < 1e-12
    functions = {"y": found.functions["x"], "w": found.functions["u"]}
    assert problem.solve("gauss4", steps=3, guess=functions).success


def test_times_of_a_motion():
    from symsimpson.study.control.problem_parts import read_times

    assert read_times([0, 1, 2 + 1e-13], 2.0).shape == (3,)
    for given, told in (
        ("a", "t is 'a': not real"),
        ([-1, 5], "t = -1 lies outside of the motion, 0 <= t <= 2"),
        (2.5, "t = 2.5 lies outside"),
        (np.nan, "t = nan lies outside"),
        (1j, "complex"),
    ):
        with pytest.raises(ss.InputError, match=told):
            read_times(given, 2.0)


@pytest.mark.parametrize(
    ("Q", "R", "told"),
    [
        ([[1, 2], [3]], [[1]], r"Q is .*not real.*\nPass a symmetric matrix of shape \(2, 2\)"),
        (np.eye(3), [[1]], r"Q has shape \(3, 3\), not \(2, 2\)"),
        ([[np.nan, 0], [0, 1]], [[1]], "Q has an entry that is not finite"),
        (np.eye(2), [[np.inf]], "R has an entry that is not finite"),
        (np.eye(2), [[-1]], "R is .*not positive definite"),
        (np.eye(2), [[0]], "R is .*not positive definite"),
        (np.eye(2) * 1j, [[1]], "Q is .*\n?.*complex"),
        (np.eye(2), [["1"]], "R is .*not real"),
        (-1e6 * np.eye(2), [[1e-6]], "Q has negative eigenvalues, and from step"),
    ],
)
def test_weights_of_gains(Q, R, told):
    found = cart().solve("gauss4", steps=3)
    with pytest.raises(ss.InputError, match=told):
        found.lqr(Q, R)


def test_of_weights_the_symmetric_part_counts():
    found = cart().solve("gauss4", steps=3)
    skew = found.lqr([[2, 1], [0, 1]], [[1]])
    assert (skew == found.lqr([[2, 0.5], [0.5, 1]], [[1]])).all()


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"duration": 0}, "duration is 0"),
        ({"duration": (2, 1)}, "low is above high"),
        ({"cost": abs(u)}, "has a kink"),
        ({"cost": sp.Max(u, 0)}, "has a kink"),
        ({"start": {"z": 0}}, "start contains 'z'"),
        ({"start": [0, 0]}, "start is list"),
        ({"bounds": {x: (-0.5, 0.5)}}, "end has x = 1, outside of its bounds"),
        ({"bounds": {x: (1, 0)}}, "low is above high"),
        ({"bounds": {u: "wide"}}, "Pass a number, or a pair"),
        ({"unknowns": {"M": (0, 1)}}, "unknowns contains 'M'"),
        ({"unknowns": ["M"]}, "unknowns is .*not a mapping"),
        ({"bounds": None}, "bounds is None, not a mapping"),
        ({"path": x - 2}, "path is .*, which is not a list"),
        ({"path": [(x, 2)]}, "Pass .low, expression, high"),
        ({"start": {x: [0, 1]}}, "Pass a number, an expression, or"),
        ({"end": {x: 1, x.diff(): 0, x**2: 1}}, "3 conditions for 2 quantities"),
        ({"start": {1: 2}}, "start has a condition on 1, which is constant"),
        ({"start": {k: 2}}, "start has a condition on k, which is constant"),
        ({"end": {ss.time: 2}}, "end has a condition on t, which is constant"),
        ({"conditions": {k: 3}}, "conditions has a condition on k, which is constant"),
        ({"path": [sp.Integer(1)]}, "path has a condition on 1, which is constant"),
        ({"bounds": {k**2: (0, 1)}}, r"path has a condition on k\*\*2, which is constant"),
    ],
)
def test_what_no_problem_can_be(more, told):
    with pytest.raises(ss.InputError, match=told):
        cart(**more)


def test_a_library_that_is_missing_is_told_with_the_extra(monkeypatch):
    problem = cart()
    monkeypatch.setitem(sys.modules, "scipy", None)
    for ask in (problem.solve, lambda: problem.open("cart.npz")):
        with pytest.raises(ss.InputError, match=r"needs scipy.*\n.*symsimpson\[control\]"):
            ask()


def test_fixed_inputs_are_no_lines_of_the_solver(capfd):
    """Of which the rows that they leave are too many, as one that follows from others."""
    resting = cart(start={x: 0, v_x: 0}, end={x: 0}, bounds={u: 0})
    assert resting.solve("gauss4", steps=2).success
    assert capfd.readouterr() == ("", "")


def test_a_parameter_that_is_given_as_one_to_be_found_is_no_unknown():
    free = ss.MechanicalSystem(
        "free", coordinates=(x,), kinetic=v_x**2 / 2, potential=k * x**2 / 2, parameters={k: 2.0}
    )
    problem = ss.OptimalControl(free, duration=1, **{**REST, "end": {x: 1}}, unknowns={k: 1})
    with pytest.raises(ss.InputError, match="more conditions than inputs can satisfy"):
        problem.solve("gauss4", steps=2)


def test_numbers_of_every_precision():
    given = {x: np.float32(0), x.diff(): np.float16(0)}
    assert cart(start=given, end={x: np.float32(0.5)}).solve(steps=2).success
