"""Steps in C: the states of a run, without a warning, without anything but mathematics."""

import ast
import shutil
import subprocess
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.in_c import COMPILER, STRICT, InC, build
from support.plain import plain

import symsimpson as ss
from symsimpson.lower.emitted_names import reserved_names
from symsimpson.program.driver import driver_text
from symsimpson.systems import EVERY
from symsimpson.targets.c.source import identifiers

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no compiler of C")

PAIRS = [
    ("pendulum", "simpson"),
    ("double_pendulum", "gauss8"),
    ("double_pendulum", "simpson"),
    ("lagrange_top", "gauss4"),
    ("heavy_top", "gauss6"),
    ("cart_pole", "lobatto6"),
    ("henon_heiles", "kahan_li8"),
    ("hanging_chain", "suzuki4"),
    ("hanging_chain", "simpson"),
    ("cartesian_pendulum", "simpson"),
    ("n_pendulum", "simpson"),
    ("fermi_pasta_ulam", "midpoint"),
    ("water", "gauss10"),
    ("kepler", "radau3"),
    ("outer_solar_system", "simpson"),
    ("rolling_disc", "simpson"),
    ("relativistic_charge", "gauss8"),
    ("kerr_geodesic", "simpson"),
    ("restricted_three_bodies", "gauss8"),
    ("point_vortices", "lobatto_3_3"),
    ("lotka_volterra", "kahan_li8"),
]


def test_functions_of_modules_and_of_the_driver_have_different_names():
    """They stand in one file of C."""
    driver = {x.name for x in ast.parse(driver_text()).body if isinstance(x, ast.FunctionDef)}
    assert not driver & reserved_names() - {"record"}  # a kernel that is not exported


def begun(stepper, system, tmp_path, h):
    found = InC(stepper, tmp_path)
    given = {k[0]: x for k, x in system.reference_state.items()}
    assert found.begin(h, **given) == 0
    return found


def apart(run, q, p):
    """The largest difference of other states from those of a run."""
    sizes = (np.maximum(1.0, np.abs(x).max(axis=0)) for x in (run.q, run.p))
    pairs = zip((run.q, run.p), (q, p), sizes, strict=True)
    return max((np.abs(x - y) / size).max() for x, y, size in pairs)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scheme"), sweep(PAIRS, 0))
def test_ten_thousand_steps_are_those_of_a_run(name, scheme, tmp_path):
    """Products are fused here and not there: the difference grows as roundings of the start do."""
    system = EVERY[name]()
    stepper, start = ss.compile(system, scheme), system.reference_state
    how = {"h": 0.001, "steps": 10_000}
    states = begun(stepper, system, tmp_path, how["h"]).run(how["h"], how["steps"])
    run, allowed = stepper.integrate(**start, **how), 1e-13
    if apart(run, *states) >= allowed and not system.constraints:
        for few in (-8, 8):
            nudged = np.multiply(start["q0"], 1 + few * np.finfo(float).eps)
            moved = stepper.integrate(**{**start, "q0": nudged}, **how)
            allowed = max(allowed, apart(run, moved.q, moved.p))
    assert apart(run, *states) < allowed


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8", "kahan_li8", "midpoint"]))
def test_without_sines_bits_are_those_of_python(scheme, tmp_path):
    """Without those, C makes of each line what Python makes of it."""
    system = ss.systems.henon_heiles()
    with pytest.MonkeyPatch.context() as patch, plain(patch):
        stepper = ss.compile(system, scheme)
        q, p = begun(stepper, system, tmp_path, 0.1).run(0.1, 40)
        run = stepper.integrate(**system.reference_state, h=0.1, steps=40)
    assert np.array_equal(q, run.q)
    assert np.array_equal(p, run.p)


def test_energies_and_velocities(tmp_path):
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system)
    made = begun(stepper, system, tmp_path, 0.01)
    made.run(0.01, 20)
    run = stepper.integrate(**system.reference_state, h=0.01, steps=20)
    energy, v = made.energy()
    assert energy == pytest.approx(run.energy[-1], abs=1e-15)
    assert v == pytest.approx(run.v[-1], abs=1e-14)


NAMES = ["m", "M", "m_1", "m 1", "λ", "lamda", "Ω", "é", "*/", "2", "double", "m-1", "m_1_2", "中"]
WRITTEN = [
    *("m", "M", "m_1", "m_1_3", "lamda_2", "lamda", "OMEGA", "e", "_", "2", "double", "m_1_4"),
    *("m_1_2", "IDEOGRAPH_4E2D"),
]


def test_names_become_parts_of_identifiers():
    assert identifiers(NAMES) == WRITTEN


def test_values_are_set_by_name(tmp_path):
    place = ss.coordinates("q")[0]
    symbols = [sp.Symbol(name, positive=True) for name in NAMES]
    system = ss.MechanicalSystem(
        "Named",
        coordinates=(place,),
        kinetic=place.diff() ** 2 / 2,
        potential=sum(symbols) * place**2 / 2,
        parameters=dict.fromkeys(symbols, 1.0),
        inputs=(sp.Symbol("π push"),),
        forces={place: sp.Symbol("π push")},
    )
    with pytest.MonkeyPatch.context() as patch, plain(patch):
        _, source = ss.compile(system, "midpoint").export_c(tmp_path / "named")
    places = [f"NAMED_PARAMETER_{name} == {k}" for k, name in enumerate(WRITTEN)]
    places += ["NAMED_COORDINATE_q == 0", "NAMED_INPUT_pi_push == 0"]
    main = tmp_path / "main.c"
    main.write_text(
        f'#include "named.h"\nint main(void) {{ return {" && ".join(places)} ? 0 : 1; }}\n'
    )
    assert subprocess.run([build(main, source, to="")], check=False).returncode == 0


x, u, w = ss.coordinates("x")[0], sp.Symbol("u"), sp.Symbol("w", positive=True)
DRIVEN = ss.MechanicalSystem(
    "driven",
    coordinates=(x,),
    kinetic=x.diff() ** 2 / 2,
    potential=w**2 * x**2 / 2 + x**4 / 4 - x * sp.sin(ss.time) / 3,
    parameters={w: 1.5},
    inputs=(u,),
    forces={"push": {x: u}, "drag": {x: -x.diff() / 10}},
)


def test_inputs_parameters_and_steps_change_on_the_way(tmp_path):
    stepper = ss.compile(DRIVEN, "gauss4")
    made = InC(stepper, tmp_path)
    assert made.begin(0.05, [0.3], v=[0.1]) == 0
    pushes = np.sin(np.arange(12.0))
    for k in range(6):
        assert made.step(0.05, 0.05 * k, [pushes[k]]) == 0
    run = stepper.integrate([0.3], v0=[0.1], h=0.05, steps=6, inputs={"u": pushes[:6]})
    assert made.get()[0] == pytest.approx(run.q[-1], abs=1e-15)
    for k in range(6):  # another step, with another parameter
        assert made.step(0.02, 0.3 + 0.02 * k, [pushes[k]], [2.0]) == 0
    on = {"h": 0.02, "steps": 6, "t0": 0.3, "inputs": {"u": pushes[:6]}, "parameters": {"w": 2.0}}
    run = stepper.integrate(run.q[-1], p0=run.p[-1], **on)
    q, p = made.get()
    assert q == pytest.approx(run.q[-1], abs=1e-14)
    assert p == pytest.approx(run.p[-1], abs=1e-14)


def test_a_step_that_is_not_taken_says_why_and_moves_nothing(tmp_path):
    system = ss.systems.double_pendulum()
    made = begun(ss.compile(system), system, tmp_path, 0.01)
    made.run(0.01, 3)
    before = made.get()
    assert made.step(5.0, 0.03) in (ss.Status.NOT_CONVERGED, ss.Status.STEP_TOO_LARGE)
    assert np.array_equal(made.get(), before)
    assert made.step(float("nan"), 0.03) != 0
    assert np.array_equal(made.get(), before)
    assert made.step(0.01, 0.03) == 0


def test_another_solution_of_a_step_is_not_taken(tmp_path):
    """What is in doubt is followed from smaller steps, and refused where it is not their end."""
    stepper, start, h = ss.compile(ss.systems.double_pendulum(), "midpoint"), [2.8, 2.9], 0.1
    made = InC(stepper, tmp_path)
    assert made.begin(h, start, p=[0.0, 0.0]) == 0
    found = [made.step(h, h * k) for k in range(6)]
    run = stepper.integrate(start, p0=[0.0, 0.0], h=h, steps=6, on_failure="return")
    assert (run.steps, run.status) == (5, ss.Status.STEP_TOO_LARGE)
    assert found == [0] * 5 + [ss.Status.STEP_TOO_LARGE]
    assert np.abs(made.get()[0] - run.q[-1]).max() < 1e-13


def test_parameters_change_at_the_same_step(tmp_path):
    stepper = ss.compile(DRIVEN, "gauss4")
    made = InC(stepper, tmp_path)
    assert made.begin(0.05, [0.3], v=[0.1]) == 0
    assert made.step(0.05, 0.0, None, [2.0]) == 0
    run = stepper.integrate([0.3], v0=[0.1], h=0.05, steps=1, inputs=0.0, parameters={"w": 2.0})
    assert made.get()[0] == pytest.approx(run.q[-1], abs=1e-15)


def test_a_start_that_is_none_is_refused(tmp_path):
    made = InC(ss.compile(DRIVEN, "gauss4"), tmp_path)
    assert made.begin(0.1, [0.1], v=[0.0]) == 0
    start = {"h": 0.1, "q": [0.1], "v": [0.0], "parameters": [1.5]}
    for what, value in (("h", 0.0), ("h", np.nan), ("q", [np.nan]), ("q", [np.inf])):
        assert made.begin(**start | {what: value}) == ss.Status.BAD_INPUT
    assert made.begin(**start | {"parameters": [np.nan]}) == ss.Status.BAD_INPUT
    assert made.begin(0.1, [0.1], p=[np.inf]) == ss.Status.BAD_INPUT


def test_explicit_steps_that_leave_the_numbers(tmp_path):
    made = InC(ss.compile(ss.systems.henon_heiles(), "suzuki4"), tmp_path)
    assert made.begin(0.1, [0.0, 50.0], p=[0.0, 0.0]) == 0
    found = [made.step(0.1, 0.1 * k) for k in range(200)]
    assert found[-1] == ss.Status.NOT_FINITE
    assert np.isfinite(made.get()).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.StabilityWarning")
def test_other_kernels_where_stages_fail(tmp_path):
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system, "gauss8")
    made = InC(stepper, tmp_path)
    start, h = {"q": [0.5, 0.5], "p": [0.0, 0.0]}, 0.32
    assert made.begin(h, **start) == 0
    q, _ = made.run(h, 12)
    assert made.set[0] > 0
    run = stepper.integrate(start["q"], p0=start["p"], h=h, steps=12)
    assert np.abs(q - run.q).max() < 1e-10


@pytest.mark.slow
def test_words_of_c_and_whatever_symbols_hold(tmp_path):
    names = ["math_errhandling", "register", "*/ #error", "y1", "INFINITY"]
    q = [sp.Function(name)(ss.time) for name in names]
    k = sp.Symbol("main", positive=True)
    system = ss.MechanicalSystem(
        "words",
        coordinates=q,
        kinetic=sum(x.diff() ** 2 for x in q) / 2,
        potential=k * sum(sp.cos(a - b) for a, b in pairwise(q)),
        parameters={k: 1.0},
    )
    stepper = ss.compile(system)
    made = InC(stepper, tmp_path)
    assert made.begin(0.1, [0.1] * 5, v=[0.0, 0.1, 0.2, 0.3, 0.4]) == 0
    found, _ = made.run(0.1, 5)
    run = stepper.integrate([0.1] * 5, v0=[0.0, 0.1, 0.2, 0.3, 0.4], h=0.1, steps=5)
    assert np.abs(found - run.q).max() < 1e-14


def test_functions_of_the_file_are_not_hidden_by_symbols(tmp_path):
    square, fabs, power = sp.symbols("square fabs pow", positive=True)
    x, y = ss.coordinates("x y")
    system = ss.MechanicalSystem(
        "functions",
        coordinates=(x, y),
        kinetic=(square * x.diff() ** 2 + fabs * (1 + x**2) ** 2 * y.diff() ** 2) / 2,
        potential=power * sp.cos(x - y) + (1 + x**2 + y**2) ** sp.Rational(7, 3),
        parameters={square: 1.0, fabs: 2.0, power: 3.0},
    )
    stepper = ss.compile(system)
    made = InC(stepper, tmp_path)
    assert made.begin(0.1, [0.1, 0.2], v=[0.0, 0.1]) == 0
    run = stepper.integrate([0.1, 0.2], v0=[0.0, 0.1], h=0.1, steps=5)
    assert np.abs(made.run(0.1, 5)[0] - run.q).max() < 1e-14


@pytest.mark.slow
def test_nothing_is_asked_for_but_mathematics(tmp_path):
    tool = shutil.which("nm") or pytest.skip("there is no nm")
    _, source = ss.compile(ss.systems.lagrange_top()).export_c(tmp_path / "top")
    built = build(
        source, flags=[*STRICT, "-ffreestanding", "-fno-tree-loop-distribute-patterns"], to="-c"
    )
    said = subprocess.run([tool, "-u", str(built)], capture_output=True, text=True, check=True)
    asked = {line.split()[-1] for line in said.stdout.splitlines()} - {"_GLOBAL_OFFSET_TABLE_"}
    assert asked <= {"sin", "cos", "sqrt", "fabs", "memcpy", "memset"}


@pytest.mark.parametrize("flags", [["-std=gnu11"], ["-x", "c++", "-std=c++17"]])
def test_other_compilers_take_the_files(flags, tmp_path):
    header, source = ss.compile(ss.systems.henon_heiles(), "kahan_li8").export_c(tmp_path / "stars")
    if "c++" in flags:
        if shutil.which("g++") is None:
            pytest.skip("there is no compiler of C++")
        source = tmp_path / "use.cpp"
        source.write_text(f'#include "{header.name}"\nint main() {{ stars_state s; (void)s; }}\n')
    build(source, flags=[*flags, "-Wall", "-Werror"], to="-c")


@pytest.mark.parametrize("name", ["3x", "a b", "int", "math", "ϕ", ".h"])
def test_names_that_are_none_of_c(name, tmp_path):
    with pytest.raises(ss.InputError, match="cannot be a prefix of C names"):
        ss.compile(ss.systems.pendulum()).export_c(f"{tmp_path}/{name}")


def test_what_has_no_counterpart_is_refused(tmp_path):
    with pytest.raises(ss.InputError, match="many digits"):
        ss.compile(ss.systems.pendulum(), precision=30).export_c(tmp_path / "a")
    with pytest.raises(ss.InputError, match="a time transformation"):
        ss.compile(ss.systems.kepler().retimed("encounters")).export_c(tmp_path / "a")
    with pytest.raises(ss.StorageError, match="no folder"):
        ss.compile(ss.systems.pendulum()).export_c(tmp_path / "no" / "a")


@pytest.mark.slow
def test_prefixes_that_functions_of_the_file_have(tmp_path):
    system = ss.systems.double_pendulum()
    made = InC(ss.compile(system), tmp_path, "keep")  # keep_step is one of the module's own
    assert made.begin(0.01, [0.5, 0.2], p=[0.0, 0.0]) == 0
    assert made.step(0.01) == 0


@pytest.mark.slow
def test_what_would_not_fit_on_the_stack_is_refused(tmp_path):
    with pytest.raises(ss.InputError, match="MB of stack"):
        ss.compile(ss.systems.cloth(), "simpson").export_c(tmp_path / "cloth")
