"""What people expect of a result: names, SciPy's y, tables."""

from dataclasses import replace

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss
from symsimpson.text.quantity import SCALARS

TOP, PENDULUM = ss.systems.lagrange_top(), ss.systems.double_pendulum()


@pytest.fixture(scope="module")
def run():
    return ss.compile(PENDULUM).integrate([0.7, 1.0], v0=[1.0, -2.0], h=0.01, steps=50, every=5)


def test_names(run):
    assert (run["q1"] == run.q[:, 0]).all()
    assert (run["p_q2"] == run.p[:, 1]).all()
    assert (run["t"] == run.t).all()
    assert (run["energy"] == run.energy).all()
    assert run["v_q2"][0] == pytest.approx(-2.0)
    assert all((run[name] == getattr(run, name)).all() for name in "qpv")
    with pytest.raises(KeyError, match=r"no quantity 'q3'\. The quantities are q1, q2, p_q1"):
        run["q3"]


@pytest.mark.slow
def test_invariants_have_names():
    top = ss.systems.heavy_top()
    run = ss.compile(top).integrate(**top.reference_state, h=0.01, steps=5)
    assert list(run.invariants) == ["angular momentum z"]
    for name in run.invariants:
        assert (run[name] == run.invariants[name]).all()


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8", "kahan_li8"]))
@pytest.mark.parametrize("system", sweep([PENDULUM, TOP, ss.systems.fermi_pasta_ulam()]))
def test_velocities(system, scheme):
    """They are those whose momenta are the run's, by the mass matrix."""
    try:
        stepper = ss.compile(system, scheme)
    except ss.SchemeError:
        pytest.skip("not explicit")
    run = stepper.integrate(**system.reference_state, h=0.001, steps=20)
    values = dict(zip(system.plain.parameters, run.parameters.values(), strict=True))
    for k in (0, 10, 20):
        at = dict(zip(system.plain.q, run.q[k], strict=True)) | values
        mass = np.array(system.plain.mass.xreplace(at).tolist(), dtype=float)
        np.testing.assert_allclose(mass @ run.v[k], run.p[k], rtol=1e-12, atol=1e-15)


def test_as_scipy_gives_it(run):
    assert run.y.shape == (4, 11)
    assert (run.q == run.y[:2].T).all()
    assert run.success
    assert run.status == 0


def test_many_digits_have_velocities():
    run = ss.compile(PENDULUM, precision=30).integrate([1, 2], v0=["0.5", 0], h="0.01", steps=1)
    assert abs(run.v[0, 0] - 0.5) < 1e-28


def test_tables(run):
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    frame = run.to_pandas()
    names = [f"{x}{q}" for x in ("", "p_", "v_") for q in ("q1", "q2")]
    points = [f"{x}_{axis}" for x in PENDULUM.positions for axis in "xy"]
    assert list(frame.columns) == [*names, *(one.name for one in SCALARS), *points]
    assert frame.index.name == "t"
    assert (frame["q2"].to_numpy() == run.q[:, 1]).all()
    data = run.to_xarray()
    assert (data.sizes["time"], data.sizes["coord"]) == (11, 2)
    assert (data.sel(coord="q1").v.to_numpy() == run.v[:, 0]).all()
    assert data.attrs["system"] == "double_pendulum"
    assert data.attrs["parameter g"] == 9.81


def test_a_missing_library_is_named(run, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(ss.InputError, match=r"pip install 'symsimpson\[data\]'"):
        run.to_pandas()


def agree(last, run, *names):
    """Compare quantities of a last state alone with those of a run that stored all."""
    for name in names:
        assert np.ravel(getattr(last, name))[-1] == np.ravel(getattr(run, name))[-1], name


@pytest.mark.parametrize("start", [{"v0": [1.0, -2.0]}, {"p0": [0.3, 0.1]}])
@pytest.mark.parametrize("steps", [0, 50, pytest.param(50_000, marks=pytest.mark.slow)])
def test_a_last_state_alone_has_its_energy_error_against_the_start(start, steps):
    stepper = ss.compile(PENDULUM)
    given = {"q0": [0.7, 1.0], **start, "h": 0.001, "t0": 1.5, "steps": steps}
    run = stepper.integrate(**given)
    for _ in range(2):  # the second one is a single call, if it is short
        last = stepper.integrate(**given, every=None)
        agree(last, run, "energy_error", "E0", "energy")
    assert last.tau == 0.001 * steps
    assert "energy error at the end" in last._repr_html_()


def test_a_last_state_alone_has_its_energy_balance_against_the_start():
    damped = ss.compile(ss.systems.damped_pendulum())
    given = {"q0": [1.0], "v0": [0.0], "h": 0.05, "t0": 1.5, "steps": 50, "record": "work"}
    last, run = (damped.integrate(**given, every=every) for every in (None, 1))
    agree(last, run, "energy_balance")
    assert abs(last.work["total"][0]) > 0.01


def test_a_last_state_alone_tells_when_it_began_wherever_an_event_ended_it():
    stepper = ss.compile(ss.systems.pendulum())
    first = ss.Event("theta", name="down", terminal=True)  # within the first step
    given = {"q0": [0.01], "v0": [-1.0], "h": 0.05, "t0": 1.5, "steps": 50, "events": [first]}
    last, run = (stepper.integrate(**given, every=every) for every in (None, 1))
    assert last.steps == 0
    agree(last, run, "t", "tau", "energy_error")


def test_a_file_without_the_start_does_not_tell_the_energy_there():
    last = ss.compile(PENDULUM).integrate([0.7, 1.0], p0=[0, 0], h=0.01, steps=5, every=None)
    with pytest.raises(ss.InputError, match="but not the initial state"):
        _ = replace(last, begun=None).energy_error
    assert "energy error" not in replace(last, begun=None)._repr_html_()


def test_a_last_state_alone_of_a_retimed_run_tells_its_error():
    stepper = ss.compile(ss.systems.kepler_plane().retimed("encounters"), "simpson")
    given = {"q0": [1.6, 0.0], "v0": [0.0, 0.5], "h": 0.1, "steps": 40}
    run, end = (stepper.integrate(**given, every=every) for every in (1, None))
    assert end.E0 == run.E0
    assert (end.energy - end.E0)[0] == pytest.approx(run.energy[-1] - run.energy[0], abs=1e-15)
    assert end.energy_error[0] != 0
    briefly = {"q0": [1.6, 0.0], "v0": [0.0, 0.5], "h": 0.1, "t0": 1.0, "t_end": 3.0}
    for _ in range(2):  # the second one is a single call
        again = stepper.integrate(**briefly, every=None)
        (t, states) = again.begun
        assert (t, states.tolist()) == (1.0, [[1.6, 0.0], [0.0, 0.5]])
