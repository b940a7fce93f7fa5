"""Comparisons: every peer solves the right problem, records are read as they were written."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.cli import main
from symsimpson.reference.first_order import second_order
from symsimpson.study.bench import work_precision
from symsimpson.study.bench.contenders import (
    PROGRAMS,
    Contender,
    FinalState,
    make_peer_contenders,
    make_problem,
    make_scheme_contender,
    to_heyoka,
)
from symsimpson.study.bench.work_precision import WorkPrecision


@pytest.fixture(
    scope="module", params=sweep(["double_pendulum", "lagrange_top", "fermi_pasta_ulam"])
)
def problem(request):
    return make_problem(ss.systems.CATALOGUE[request.param](), None, 1.0)


@pytest.mark.slow
def test_the_solution_knows_its_error(problem):
    assert problem.solution_error < 1e-12
    stepper = ss.compile(problem.system, "gauss8")
    run = stepper.integrate(problem.q0, p0=problem.p0, h=1 / 500, steps=500, every=None)
    assert problem.error(run.q[0], run.p[0]) < 1e-12
    assert problem.error(run.q[0] + np.nan, run.p[0]) == np.inf
    assert np.isnan(problem.momentum(stepper, problem.q0, problem.v0 + np.nan)).all()
    again = problem.momentum(stepper, problem.q0, problem.v0)
    np.testing.assert_allclose(again, problem.p0, rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_errors_are_relative_to_the_motion_in_any_units():
    """Two atoms of argon, in SI units and in those of Lennard and Jones."""
    (r,) = ss.coordinates("r")
    m, e, s = sp.symbols("m e s", positive=True)
    problems = []
    for mass, depth, size in ((1.0, 1.0, 1.0), (6.6335e-26, 1.654e-21, 3.4e-10)):
        dimer = ss.MechanicalSystem(
            "dimer",
            coordinates=(r,),
            kinetic=m * r.diff() ** 2 / 4,
            potential=4 * e * ((s / r) ** 12 - (s / r) ** 6),
            parameters={m: mass, e: depth, s: size},
        )
        state = {"q0": [1.5 * size], "v0": [0.0]}
        problems.append(make_problem(dimer, state, 5 * size * np.sqrt(mass / depth)))
    reduced, atoms = problems
    assert max(reduced.solution_error, atoms.solution_error) < 1e-12
    # both are divided by the largest values, so an error of 1 % is one of 1 % in both
    assert atoms.scale[0] == pytest.approx(1.5 * 3.4e-10)
    ends = [x.solution / x.scale for x in problems]
    np.testing.assert_allclose(*ends, rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(PROGRAMS))
def test_a_peer_solves_the_problem(problem, name):
    if name != "runge-kutta":
        pytest.importorskip(name)
    for contender in make_peer_contenders(problem, name):
        choices = [c for c in contender.choices if contender.what == "tolerance" or c < 20_000]
        errors = []
        for choice in (choices[len(choices) // 2], choices[-1]):
            run, read = contender.make(choice)
            outcome = read(run())
            outcome = read(run())  # the second run starts where the first did
            errors.append(problem.error(outcome.q, outcome.p))
            assert outcome.evaluations > 0
        assert errors[1] < max(1e-9, errors[0] / 4), (contender.name, errors)
        assert errors[1] < 1e-4, (contender.name, errors)


@pytest.mark.slow
def test_our_schemes_take_part(problem):
    contender = make_scheme_contender(problem, "simpson")
    run, read = contender.make(400)
    outcome = read(run())
    assert problem.error(outcome.q, outcome.p) < 1e-5
    assert outcome.evaluations >= 400


@pytest.fixture(scope="module")
def record():
    return ss.work_precision(
        ss.systems.pendulum(),
        ["midpoint", "simpson"],
        ["runge-kutta"],
        errors=[1e-3, 1e-7],
        t_end=2.0,
        repeats=2,
    )


@pytest.mark.slow
def test_a_record(record, tmp_path):
    assert record.names == ("midpoint", "simpson", "rk4", "dop853")
    for name in record.names:
        coarse = record.fastest(name, 1e-3)
        assert coarse.error <= 1e-3
        assert 0 < coarse.best <= coarse.median
        work = [
            min(
                (p.evaluations for p in record.points if p.name == name and p.error <= level),
                default=np.inf,
            )
            for level in (1e-3, 1e-7)
        ]
        assert work[0] < work[1]
    assert record.fastest("simpson", 1e-7).evaluations > 0
    assert record.fastest("simpson", 1e-300) is None
    assert tuple(record.call_seconds) == record.names
    assert min(record.call_seconds.values()) > 0
    text = repr(record)
    assert "simpson" in text
    assert record.machine["processor"] in text
    path = record.save(tmp_path / "record.json")
    again = WorkPrecision.load(path)
    assert again == record
    lines = again.compare(record).splitlines()
    assert len(lines) == 5
    assert lines[2].split() == ["simpson", "1.00", "1.00"]


@pytest.mark.slow
def test_files_that_are_no_records(record, tmp_path):
    other = tmp_path / "other.json"
    for content in ("", "{}", "[]", '{"format": 1}', json.dumps({"format": 2})):
        other.write_text(content)
        with pytest.raises(ss.StorageError, match="not a record of run times"):
            WorkPrecision.load(other)
    with pytest.raises(ss.StorageError, match=r"cannot be read: .*\n.*symsimpson bench"):
        WorkPrecision.load(tmp_path / "missing.json")
    with pytest.raises(ss.StorageError, match="cannot be written"):
        record.save(tmp_path / "no" / "folder.json")
    long = json.loads(record.save(tmp_path / "a.json").read_text()) | {"t_end": 3.0}
    other.write_text(json.dumps(long))
    with pytest.raises(ss.InputError, match="different problems"):
        record.compare(WorkPrecision.load(other))


WRONG = {
    "peer": ({"peers": ["matlab"]}, "peers contains 'matlab'"),
    "errors": ({"errors": []}, "errors are"),
    "level": ({"errors": [2.0]}, "errors are"),
    "no level": ({"errors": "fine"}, "errors is 'fine', not real numbers"),
    "time": ({"t_end": -1.0}, r"t_end is -1.0"),
    "endless": ({"t_end": np.inf}, "t_end is inf, not a finite"),
    "no time": ({"t_end": None}, "t_end is None, not a finite"),
    "repeats": ({"repeats": 0}, "repeats is 0"),
    "part of a repeat": ({"repeats": 1.5}, "repeats is 1.5, not a whole number"),
    "no peer": ({"peers": None}, r"peers contains None.*\n.*\(\) for no other"),
    "a pair": ({"state": ([1.0], [0.0])}, "state is .*, not a mapping"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input(case):
    given, message = WRONG[case]
    with pytest.raises(ss.InputError, match=message):
        ss.work_precision(ss.systems.pendulum(), **{"peers": (), "t_end": 0.1} | given)


def test_the_time_of_a_compiler_is_no_time_of_a_run(monkeypatch):
    """Fallback kernels are compiled in the sweep, where a coarse step needs them."""
    clock, compiled = SimpleNamespace(now=0.0), set()
    monkeypatch.setattr(work_precision, "time", SimpleNamespace(perf_counter=lambda: clock.now))

    def make(steps):
        def run():
            clock.now += 1e-4 * steps if steps != 8 or steps in compiled else 0.7
            compiled.add(steps)
            return steps

        return run, lambda steps: FinalState(np.array([steps**-4]), np.zeros(1), steps)

    problem = SimpleNamespace(error=lambda q, p: q[0])
    entries = work_precision._run_choices(Contender("a", "steps", (4, 8, 16), make), problem, 1e-9)
    assert [entry.times[0] for entry in entries] == pytest.approx([4e-4, 8e-4, 16e-4])


def test_one_level_is_a_table_of_one():
    found = ss.work_precision(ss.systems.pendulum(), "midpoint", (), 1e-2, t_end=0.5, repeats=1)
    assert found.levels == (1e-2,)


@pytest.mark.slow
def test_a_peer_that_is_not_installed(problem, monkeypatch):
    for module in ("heyoka", "scipy", "scipy.integrate", "numbalsoda", "diffrax"):
        monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(ss.InputError, match="not installed"):
        list(make_peer_contenders(problem, "heyoka"))
    assert {one.name for one in make_peer_contenders(problem)} <= {"rk4", "dop853"}


@pytest.mark.slow
def test_the_figure(record):
    pytest.importorskip("matplotlib").use("Agg")
    ax = record.plot()
    assert len(ax.get_lines()) == 4
    assert ax.xaxis_inverted()
    assert record.plot(ax=ax) is ax


@pytest.mark.slow
def test_the_command(tmp_path, capsys):
    out, figure = str(tmp_path / "r.json"), str(tmp_path / "r.png")
    given = [
        "bench",
        "pendulum",
        "--schemes",
        "simpson",
        "--peers",
        "runge-kutta",
        "--t-end",
        "1",
        "--errors",
        "1e-5",
        "--repeats",
        "1",
    ]
    assert main([*given, "--out", out, "--plot", figure]) == 0
    assert main([*given, "--against", out]) == 0
    text = capsys.readouterr().out
    assert "run time now, in units of that before" in text
    assert main([*given, "--against", figure]) == 1


def test_heyoka_reads_fractions_that_are_not_binary():
    heyoka = pytest.importorskip("heyoka")
    equations = second_order(ss.systems.puma560(2))
    written = to_heyoka(heyoka, equations)
    unknowns, rates = zip(*written, strict=True)
    at = [0.3, -0.7, 0.2, 0.5]
    found = heyoka.cfunc(list(rates), vars=list(unknowns))(np.array(at))
    known = dict(zip(equations.unknowns, at, strict=True)) | dict(equations.parameters)
    for symbol, value in equations.definitions:
        known[symbol] = float(value.xreplace(known))
    expected = [float(rate.xreplace(known)) for rate in equations.rates]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.slow
def test_time_is_an_unknown_where_something_depends_on_it():
    """Programs that solve y' = f(y) take the time as the last component."""
    system = ss.systems.duffing()
    problem = make_problem(system, None, 2.0)
    assert len(problem.equations.unknowns) == 3
    run = ss.compile(system, "gauss16").integrate(**system.reference_state, h=0.1, steps=20)
    assert problem.error(run.q[-1], run.p[-1]) < 1e-13
    for contender in make_peer_contenders(problem, ("runge-kutta", "scipy")):
        run, read = contender.make(1e-10 if contender.what == "tolerance" else 2000)
        outcome = read(run())
        assert problem.error(outcome.q, outcome.p) < 1e-6


@pytest.mark.parametrize("scheme", sweep(["simpson", ss.SIMPSON]))
def test_a_single_scheme_is_taken_as_one(scheme):
    given = {"peers": (), "errors": [1e-3], "t_end": 0.5, "repeats": 1}
    assert ss.work_precision(ss.systems.pendulum(), scheme, **given).names == ("simpson",)
