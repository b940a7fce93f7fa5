"""Nonsense at every public function: a typed error that says what and what to do, at once."""

import numpy as np
import pytest
import sympy as sp
from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

import symsimpson as ss

PENDULUM = ss.systems.double_pendulum()
x, y = ss.coordinates("x y")
m = sp.Symbol("m", positive=True)
FREE = x.diff() ** 2 / 2


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(PENDULUM, "midpoint")


RUN = {"q0": [0.5, 0.2], "p0": [0.0, 0.1], "h": 0.1, "steps": 3}
INTEGRATE = {
    "empty": {"q0": []},
    "too many": {"q0": [1, 2, 3]},
    "nested": {"q0": [[[0.5]], [[0.2]]]},
    "set": {"q0": {0.5, 0.2}},
    "dict": {"q0": {"q1": 0.5}},
    "string": {"q0": "0.5 0.2"},
    "bytes": {"q0": b"01"},
    "function": {"q0": len},
    "object": {"q0": object()},
    "symbol": {"q0": [m, 0.2]},
    "huge integer": {"q0": [10**400, 0.2]},
    "none inside": {"q0": [None, 0.2]},
    "minus infinity": {"q0": [-np.inf, 0.2]},
    "velocities": {"v0": [1.0], "p0": None},
    "nan velocity": {"v0": [np.nan, 0], "p0": None},
    "times": {"q0": np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[D]")},
    "list of steps": {"h": [0.1]},
    "complex step": {"h": 0.1j},
    "no step": {"h": None},
    "infinite step": {"h": np.inf},
    "symbolic step": {"h": m},
    "huge step": {"h": 10**400},
    "text count": {"steps": "3"},
    "infinite count": {"steps": np.inf},
    "nan end": {"steps": None, "t_end": np.nan},
    "text end": {"steps": None, "t_end": "now"},
    "infinite end": {"steps": None, "t_end": np.inf},
    "nan start": {"t0": np.nan},
    "text start": {"t0": "0"},
    "negative stride": {"every": -1},
    "real stride": {"every": 1.5},
    "text stride": {"every": "all"},
    "huge stride": {"every": 2**60},
    "parameter of text": {"parameters": {"m1": "heavy"}},
    "parameter of a list": {"parameters": {"m1": [1.0, 2.0]}},
    "zero parameter": {"parameters": {"m1": 0.0}},
    "infinite": {"parameters": {"m1": np.inf}},
    "complex parameter": {"parameters": {"m1": 1j}},
    "parameters": {"parameters": "m1=2"},
    "parameter twice": {"parameters": {"m1": 2.0, sp.Symbol("m1"): 3.0}},
    "number as name": {"parameters": {1: 2.0}},
    "symbol of another": {"parameters": {m: 2.0}},
    "every checkpoint": {"checkpoint": "never", "checkpoint_every": 0},
    "part of a checkpoint": {"checkpoint": "never", "checkpoint_every": 2.5},
    "outcome": {"on_failure": None},
    "outcomes": {"on_failure": np.array(["raise", "return"])},
    "bar": {"progress": "no"},
    "bars": {"progress": np.zeros(2)},
    "end far away": {"steps": None, "t_end": 1e308, "h": 1e-3},
    "a time far away": {"steps": None, "t_eval": [1e308], "h": 1e-3},
    "recorded": {"record": True},
    "recorded rows": {"record": [["work"]]},
    "recorded symbol": {"record": m},
}


@pytest.mark.parametrize("changes", INTEGRATE.values(), ids=INTEGRATE)
def test_integrate(stepper, changes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ss.InputError) as caught:
        stepper.integrate(**(RUN | changes))
    said = str(caught.value)
    name = "q0" if "q0" in changes else next(iter(changes))
    said_of = {"steps": "t_end"}.get(name, name) if changes.get("steps", 0) is None else name
    assert said_of.split("_")[0].rstrip("s") in said or "step" in said
    assert "\n" in said
    assert "numba" not in said.lower()
    assert not list(tmp_path.iterdir())


MANY = {"q0": [[0.5, 0.2], [0.1, 0.3]], "p0": [0.0, 0.1], "h": 0.1, "steps": 3}
ENSEMBLE = {
    "shape": {"q0": [[0.5], [0.2]]},
    "members": {"p0": np.zeros((3, 2))},
    "nan": {"q0": [[0.5, np.nan], [0.1, 0.2]]},
    "empty": {"q0": np.zeros((0, 2))},
    "cube": {"q0": np.zeros((2, 2, 2))},
    "text": {"q0": [["a", "b"]]},
    "parameters": {"parameters": {"m1": [1.0, 2.0, 3.0]}},
    "sign": {"parameters": {"m1": [1.0, -1.0]}},
    "unknown": {"parameters": {"z": 1.0}},
    "step": {"h": 0.0},
    "count": {"steps": -1},
    "both": {"t_end": 1.0},
    "stride": {"every": 0},
    "threads": {"threads": 0},
    "part of a thread": {"threads": 1.5},
    "kind": {"reduce": {"a": ("median", "q1")}},
    "expression": {"reduce": {"a": ("min", "q9")}},
    "pair": {"reduce": {"a": "min"}},
    "syntax": {"reduce": {"a": ("min", "q1 +")}},
    "call": {"reduce": {"a": ("min", "__import__('os')")}},
    "outcome": {"on_failure": 1},
    "recorded": {"record": 1.5},
    "bar": {"progress": np.zeros(3)},
}


@pytest.mark.parametrize("changes", ENSEMBLE.values(), ids=ENSEMBLE)
def test_ensemble(stepper, changes):
    with pytest.raises(ss.InputError) as caught:
        stepper.ensemble(**(MANY | changes))
    assert "\n" in str(caught.value)
    assert "numba" not in str(caught.value).lower()


def test_numbers_of_states_of_any_kind(stepper):
    run = stepper.integrate(**RUN)
    assert (run[np.array([0, 2], dtype=np.uint8)].q == run.q[[0, 2]]).all()
    assert (run[np.array(1)].q == run.q[[1]]).all()
    assert len(run[[]]) == len(run[np.array([], dtype=int)]) == 0


def test_what_else_is_of_another_kind(stepper):
    state = {"q0": RUN["q0"], "p0": RUN["p0"], "h": 0.1}
    run = stepper.integrate(**RUN)
    for call, message in (
        (lambda: stepper.gradient(**state, steps=3, samples=[1.0], wrt="q"), "samples is a list"),
        (lambda: stepper.gradient(**state, steps=3, running=["q1"], wrt="q"), "running is a list"),
        (
            lambda: stepper.tangent([0.5, 0.2], p=[0, 0], h=0.1, wrt=sp.Symbol("zz")),
            "no parameter or input 'zz'",
        ),
        (
            lambda: stepper.tangent([0.5, 0.2], p=[0, 0], h=0.1, wrt=None),
            "no parameter or input 'None'",
        ),
        (lambda: stepper.start(**state).step([[0.1], [0.2, 0.3]]), "has no inputs"),
        (lambda: run[["q1", "q2"]], "does not select states"),
        (lambda: run[[1, [2]]], "does not select states"),
        (lambda: run[np.array([])], "does not select states"),
        (lambda: run[np.array(1.0)], "does not select states"),
        (lambda: run.events("q1", direction=np.zeros(2)), "direction is"),
        (lambda: ss.Impact(10**400), "restitution is"),
        (lambda: PENDULUM.consistent([10**400, 0], [0, 0]), "q0 is"),
    ):
        with pytest.raises(ss.InputError, match=message):
            call()
    for call in (lambda: ss.galerkin(["lobatto"], 3, 2), lambda: ss.composition(["kahan_li8"])):
        with pytest.raises(ss.SchemeError, match="there is no"):
            call()
    by_symbol = stepper.tangent([0.5, 0.2], p=[0, 0], h=0.1, wrt=sp.Symbol("m1", positive=True))
    by_name = stepper.tangent([0.5, 0.2], p=[0, 0], h=0.1, wrt="m1")
    assert (by_symbol[2] == by_name[2]).all()


def declare(**changes):
    given = {"coordinates": [x], "kinetic": FREE, "potential": x**2, "parameters": {}} | changes
    return ss.MechanicalSystem("wrong", **given)


DECLARED = {
    "positions in a row": {"positions": [(x, 0)]},
    "invariants in a row": {"invariants": [x]},
    "no coordinates": {"coordinates": []},
    "twice": {"coordinates": [x, x]},
    "a symbol": {"coordinates": [m]},
    "a string": {"coordinates": "x"},
    "no mass": {"coordinates": [x, y]},
    "negative mass": {"kinetic": -FREE},
    "undeclared": {"potential": m * x},
    "accelerations": {"potential": x.diff(ss.coordinates("z")[0].args[0], 2)},
    "velocity in V": {"potential": x.diff() * x},
    "complex": {"potential": sp.I * x},
    "another coordinate": {"potential": y**2},
    "infinite": {"potential": sp.oo},
    "nan": {"potential": sp.nan},
    "no value": {"parameters": {m: None}},
    "text value": {"parameters": {m: "1"}},
    "nan value": {"parameters": {m: np.nan}},
    "wrong sign": {"parameters": {m: -1.0}},
    "parameter of text": {"parameters": {"m": 1.0}},
    "a list": {"parameters": [m]},
    "no expression": {"potential": "x**2"},
    "a matrix": {"potential": sp.eye(2)},
    "a relation": {"potential": x > 0},
    "cases": {"potential": sp.Max(x, 0) ** 3},
    "least": {"potential": sp.Min(m, 2) * x**2, "parameters": {m: 1.0}},
    "huge number": {"potential": sp.Integer(10) ** 400 * x},
    "huge float": {"potential": sp.Float("1e400") * x},
    "an integer": {"parameters": {sp.Symbol("n", even=True): 2}},
    "one sign": {"coordinates": [dynamicsymbols("r", positive=True)]},
}


@pytest.mark.parametrize("changes", DECLARED.values(), ids=DECLARED)
def test_declarations(changes):
    with pytest.raises(ss.ModelError) as caught:
        declare(**changes)
    assert "\n" in str(caught.value)


START = PENDULUM.reference_state
MASKED = np.ma.array([0.1, 0.2], mask=[False, True])


def swing(q0=(0.1, 0.2), **more):
    return ss.compile(PENDULUM).integrate(q0, p0=[0, 0], h=0.01, steps=2, **more)


def swarm(**more):
    given = {"q0": [[0.1, 0.2]] * 3, "p0": [0, 0], "h": 0.01, "steps": 2} | more
    return ss.compile(PENDULUM).ensemble(given.pop("q0"), **given)


FALL = declare(potential=-1 / x)
OTHERS = {
    "scheme": (lambda: ss.compile(PENDULUM, "rk4"), ss.SchemeError, "no scheme 'rk4'"),
    "no scheme": (lambda: ss.compile(PENDULUM, None), ss.SchemeError, "no scheme None"),
    "odd order": (lambda: ss.compile(PENDULUM, "gauss5"), ss.SchemeError, "no scheme"),
    "no order": (lambda: ss.compile(PENDULUM, "gauss0"), ss.SchemeError, "no scheme"),
    "explicit": (lambda: ss.compile(PENDULUM, "kahan_li8"), ss.SchemeError, "explicit"),
    "no system": (lambda: ss.compile("my_arm"), ss.GenerationError, "not a MechanicalSystem"),
    "None": (lambda: ss.compile(None), ss.GenerationError, "NoneType is not a MechanicalSystem"),
    "a name": (lambda: ss.compile("pendulum"), ss.GenerationError, r"systems.pendulum\(\)"),
    "a method of SymPy": (
        lambda: ss.compile(LagrangesMethod(x.diff() ** 2 - x**2, [x])),
        ss.GenerationError,
        "from_lagranges_method",
    ),
    "exploit": (lambda: ss.compile(PENDULUM, exploit="luck"), ss.GenerationError, "luck"),
    "digits": (lambda: ss.compile(PENDULUM, precision=3), ss.InputError, "precision is 3"),
    "part of digits": (lambda: ss.compile(PENDULUM, precision=30.5), ss.InputError, "30.5"),
    "arithmetic": (
        lambda: ss.compile(PENDULUM, precision=30, arithmetic="exact"),
        ss.InputError,
        "arithmetic is 'exact'",
    ),
    "nodes": (lambda: ss.galerkin("gauss", 0, 1), ss.SchemeError, "at least 1"),
    "many nodes": (lambda: ss.galerkin("gauss", 40, 2), ss.SchemeError, "at most 16"),
    "degree": (lambda: ss.galerkin("gauss", 2, 3), ss.SchemeError, "cannot determine"),
    "no degree": (lambda: ss.galerkin("gauss", 2, 0), ss.SchemeError, "at least 1"),
    "quadrature": (lambda: ss.galerkin("gander", 2, 2), ss.SchemeError, "no quadrature .gander."),
    "composition": (lambda: ss.composition("yoshida4"), ss.SchemeError, "no composition"),
    "file": (lambda: ss.load("/missing.py"), ss.GenerationError, "cannot be read"),
    "folder": (lambda: ss.load("/"), ss.GenerationError, "read.*\n.*\n?.*open_trajectory"),
    "place": (
        lambda: ss.generate(PENDULUM, "midpoint", "/proc/nowhere"),
        ss.GenerationError,
        "cannot be written",
    ),
    "checkpoint": (lambda: ss.resume("/missing"), ss.StorageError, "no intact checkpoint"),
    "no checkpoint": (lambda: ss.resume(3), ss.InputError, "the checkpoint is int, not the name"),
    "empty checkpoint": (lambda: swing(checkpoint=""), ss.InputError, "checkpoint is empty"),
    "checkpoint nowhere": (lambda: swing(checkpoint="/no/run"), ss.StorageError, "no folder /no"),
    "no file": (lambda: ss.load(None), ss.InputError, "generated file is NoneType"),
    "no directory": (lambda: ss.generate(PENDULUM, directory=None), ss.InputError, "is NoneType"),
    "no trajectory": (lambda: ss.open_trajectory(3), ss.InputError, "file is int"),
    "saved to a number": (lambda: swing().save(3), ss.InputError, "file is int"),
    "store nowhere": (lambda: swarm(store="/no/such/store"), ss.StorageError, "no folder /no/such"),
    "store without a name": (lambda: swarm(store=""), ss.InputError, "store is empty"),
    "momenta of a text": (lambda: ss.momenta("q1"), ss.ModelError, "not to 'q1'"),
    "momenta of a pair": (lambda: ss.momenta((x, y)), ss.ModelError, "momenta.q1, q2."),
    "masked state": (lambda: swing(MASKED), ss.InputError, "q0 has masked entries"),
    "masked members": (lambda: swarm(q0=MASKED[None]), ss.InputError, "q0 has masked entries"),
    "axes": (lambda: swing().plot(ax=3), ss.InputError, "ax is int, not matplotlib axes"),
    "axes of the energy": (lambda: swing().plot_energy(ax="x"), ss.InputError, "ax is str"),
    "axes of paths": (lambda: swing().plot_path(ax=[]), ss.InputError, "ax is list"),
    "wanted error": (
        lambda: ss.choose(PENDULUM, **START, t_end=1, error=0),
        ss.InputError,
        "error is 0",
    ),
    "no system to a wanted error": (
        lambda: ss.integrate("double_pendulum", **START, t_end=1),
        ss.GenerationError,
        r"systems.double_pendulum\(\)",
    ),
    "no system to choose for": (
        lambda: ss.choose(None, **START, t_end=1, error=1e-3),
        ss.GenerationError,
        "NoneType is not",
    ),
    "no system that costs": (lambda: ss.step_costs(3), ss.GenerationError, "int is not"),
    "no scheme that costs": (lambda: ss.step_costs(PENDULUM, 3), ss.SchemeError, "no scheme 3"),
    "values in a row": (
        lambda: ss.integrate(PENDULUM, **START, t_end=1, parameters=[1, 2]),
        ss.InputError,
        r"parameters is \[1, 2\], not a mapping",
    ),
    "values in an array": (
        lambda: [swing(parameters=x) for x in (None, np.ones(3))],
        ss.InputError,
        "parameters is array.*, not a mapping",
    ),
    "values of linear equations": (
        lambda: PENDULUM.linearise([0, 0], parameters=[1, 2]),
        ss.InputError,
        "not a mapping",
    ),
    "inputs of a certificate": (
        lambda: ss.compile(PENDULUM).certify(inputs=[1]),
        ss.InputError,
        r"inputs is \[1\], not a mapping",
    ),
    "a ragged state": (
        lambda: ss.integrate(PENDULUM, [[1], [2, 3]], p0=[0, 0], t_end=1),
        ss.InputError,
        "q0 is .*not real numbers",
    ),
    "no schemes": (
        lambda: ss.choose(PENDULUM, **START, t_end=1, error=1e-3, schemes=[]),
        ss.InputError,
        "schemes is empty",
    ),
    "a number for schemes": (
        lambda: ss.integrate(PENDULUM, **START, t_end=1, schemes=4),
        ss.SchemeError,
        "no scheme 4",
    ),
    "no pair to reduce": (
        lambda: swing(reduce={"a": ()}, events=[ss.Event("q1")]),
        ss.InputError,
        r"reduce\['a'\] is \(\)",
    ),
    "nothing without a name": (
        lambda: ss.Switch("x"),
        ss.InputError,
        "got 1 positional argument, and takes none",
    ),
    "time": (
        lambda: ss.choose(PENDULUM, **START, t_end=np.inf, error=1e-3),
        ss.InputError,
        "t_end is inf",
    ),
    "on": (
        lambda: ss.choose(PENDULUM, **START, t_end=1, error=1e-3, on="phase"),
        ss.InputError,
        "on is 'phase'",
    ),
    "singular": (
        lambda: ss.choose(FALL, [1.0], [0.0], t_end=10, error=1e-6, schemes=["midpoint"]),
        ss.InputError,
        "small steps failed: .*step .* failed",
    ),
    "no names": (lambda: ss.coordinates(""), ss.ModelError, "with all names, not ''"),
    "None for names": (lambda: ss.coordinates(None), ss.ModelError, "with all names, not None"),
    "certified step": (lambda: ss.compile(PENDULUM).certify(h=0), ss.InputError, "h is 0"),
    "certified digits": (
        lambda: ss.compile(PENDULUM, precision=30).certify(),
        ss.InputError,
        "a multiprecision stepper has no certificate",
    ),
    "levels": (lambda: ss.work_precision(PENDULUM, errors=[]), ss.InputError, "errors are"),
    "peer": (
        lambda: ss.work_precision(PENDULUM, peers=["matlab"], t_end=0.1),
        ss.InputError,
        "peers contains 'matlab'",
    ),
}


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        pytest.param(*case, id=name, marks=pytest.mark.slow if name == "singular" else ())
        for name, case in OTHERS.items()
    ],
)
def test_other_functions(call, kind, message):
    with pytest.raises(kind, match=message) as caught:
        call()
    assert "\n" in str(caught.value)


@pytest.mark.slow
def test_arrays_of_any_layout_are_taken(stepper):
    """Read-only, strided and reversed ones, and a large ensemble of no steps."""
    q0 = np.array([0.2, 0.5])[::-1]
    q0.flags.writeable = False
    big = np.asfortranarray(np.random.default_rng(1).uniform(-1, 1, (20_000, 2)))
    found = stepper.ensemble(big, p0=[0, 0], h=0.1, steps=1, progress=False)
    assert found.q.shape == (20_000, 2)
    assert stepper.integrate(q0, p0=np.zeros(4)[::2], h=0.1, steps=1).status == 0
