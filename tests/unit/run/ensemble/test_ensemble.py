"""Ensembles: each member is the run that it would be alone, whatever surrounds it."""

import hashlib
import signal
import threading
import time

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.run.ensemble import lanes as module
from symsimpson.run.ensemble import members

PENDULUM = ss.systems.double_pendulum()
RNG = np.random.default_rng(7)
ANGLES = RNG.uniform(-2.5, 2.5, (37, 2))
GIVEN = {"p0": [0.0, 0.0], "h": 0.02, "steps": 60}


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(PENDULUM)


def digest(found):
    parts = (found.q, found.p, found.status, found.steps, *found.reduced.values())
    return hashlib.sha256(b"".join(np.ascontiguousarray(x).tobytes() for x in parts)).hexdigest()


@pytest.mark.parametrize("h", [0.02, -0.1])
def test_times_are_those_of_single_runs(stepper, h):
    given = {**GIVEN, "h": h, "t0": 0.3, "every": 7}
    found, run = (take(ANGLES[0], **given) for take in (stepper.ensemble, stepper.integrate))
    assert (found.t == run.t).all()


def test_members_are_single_runs(stepper):
    found = stepper.ensemble(ANGLES, **GIVEN)
    assert found.q.shape == found.p.shape == (37, 2)
    assert (found.status == 0).all()
    assert (found.steps == 60).all()
    assert found.t.tolist() == [1.2]
    for member in (0, 7, 8, 36):
        run = stepper.integrate(ANGLES[member], **GIVEN, every=None)
        np.testing.assert_allclose(found.q[member], run.q[0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.p[member], run.p[0], rtol=0, atol=1e-12)


def test_columns_of_a_table_are_found_by_their_names(stepper):
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"q2": [1.0, 0.9], "q1": [0.8, 0.7]})
    found = stepper.ensemble(table, p0=[0, 0], h=0.02, steps=0)
    assert found.q.tolist() == [[0.8, 1.0], [0.7, 0.9]]


@pytest.mark.slow
def test_same_bits_for_threads_blocks_and_order(monkeypatch):
    stepper = ss.compile(ss.systems.pendulum())
    angles = ANGLES[:, :1]
    given = {"v0": [0.1], "h": 0.05, "steps": 200}
    watch = {"highest": ("max", "theta"), "average": ("mean", "p_theta * theta")}
    whole = stepper.ensemble(angles, **given, threads=1, reduce=watch)
    digests = {
        digest(stepper.ensemble(angles, **given, threads=n, reduce=watch)) for n in (1, 2, 4)
    }
    for lanes in (4, 8, 16):
        monkeypatch.setattr(members, "lanes_for", lambda rows, members, lanes=lanes: lanes)
        digests.add(digest(stepper.ensemble(angles, **given, reduce=watch)))
    assert digests == {digest(whole)}
    order = RNG.permutation(len(angles))
    shuffled = stepper.ensemble(angles[order], **given)
    assert (shuffled.q == whole.q[order]).all()
    assert (shuffled.p == whole.p[order]).all()


@pytest.mark.slow
def test_same_bits_however_often_compiled_code_is_left(stepper, monkeypatch):
    digests = set()
    for patience, first in ((0.02, 2000), (1e-9, 1), (1e-9, 333)):
        monkeypatch.setattr(module, "PATIENCE", patience)
        monkeypatch.setattr(module, "FIRST_BUDGET", first)
        digests.add(digest(stepper.ensemble(ANGLES, **GIVEN, every=7)))
    assert len(digests) == 1


@pytest.mark.parametrize("every", [1, 15, 16])
def test_stored_states(stepper, every):
    found = stepper.ensemble(ANGLES[:10], **GIVEN, every=every)
    run = stepper.integrate(ANGLES[3], **GIVEN, every=every)
    assert found.q.shape == (10, len(run.t), 2)
    np.testing.assert_allclose(found.q[3], run.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.p[3], run.p, rtol=0, atol=1e-12)
    assert found.t == pytest.approx(run.t)
    counted = run.newton_iterations.sum()
    if 60 % every == 0:
        assert found.newton_iterations[3] == pytest.approx(counted, abs=20)
    else:  # those behind the last stored state count, too
        assert found.newton_iterations[3] > counted


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    sweep(
        [
            ss.systems.lagrange_top,
            ss.systems.harmonic_oscillator,
            ss.systems.kepler,
            lambda: ss.systems.fermi_pasta_ulam(8),
            ss.systems.n_pendulum,
        ]
    ),
)
@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint"]))
def test_every_form_of_code(make, scheme):
    system = make()
    given = system.reference_state
    q0 = np.array(given["q0"]) + RNG.uniform(-0.01, 0.01, (11, system.n))
    other = {key: given[key] for key in ("v0", "p0") if key in given}
    stepper = ss.compile(system, scheme)
    found = stepper.ensemble(q0, **other, h=0.005, steps=40)
    assert (found.status == 0).all()
    for member in (0, 10):
        run = stepper.integrate(q0[member], **other, h=0.005, steps=40, every=None)
        for a, b in ((found.q[member], run.q[0]), (found.p[member], run.p[0])):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * max(1, np.abs(b).max()))


def test_parameters_of_each_member(stepper):
    lengths = np.linspace(0.2, 0.4, 9)
    found = stepper.ensemble([0.5, 1.0], **GIVEN, parameters={"l1": lengths, "g": 9.0})
    assert (found.parameters["l1"] == lengths).all()
    assert (found.parameters["g"] == 9.0).all()
    run = stepper.integrate([0.5, 1.0], **GIVEN, parameters={"l1": lengths[4], "g": 9.0})
    np.testing.assert_allclose(found.q[4], run.q[-1], rtol=0, atol=1e-12)


def test_reductions(stepper):
    q1, q2 = PENDULUM.coordinates
    found = stepper.ensemble(
        ANGLES[:9],
        **GIVEN,
        every=1,
        reduce={
            "highest": ("max", "q1"),
            "lowest": ("min", q2),
            "mean": ("mean", sp.cos(q1) * q2**2),
            "drift": ("max", "abs(energy)"),
            "fast": ("max", "abs(p_q1)/(m1*l1**2) + t*0 + pi - pi"),
            "crossing": ("first", "q1 - 0.3"),
            "never": ("first", "-1"),
            "at once": ("first", "1"),
        },
    )
    seen = found.reduced
    x, y = found.q[:, :, 0], found.q[:, :, 1]
    assert (seen["highest"] == x.max(axis=1)).all()
    assert (seen["lowest"] == y.min(axis=1)).all()
    np.testing.assert_allclose(seen["mean"], (np.cos(x) * y**2).mean(axis=1), atol=1e-12)
    for member in range(9):
        run = stepper.integrate(ANGLES[member], **GIVEN)
        assert seen["drift"][member] == pytest.approx(np.abs(run.energy).max(), rel=1e-12)
        above = np.flatnonzero(run.q[:, 0] > 0.3)
        if above.size and above[0] > 0:
            k = above[0]
            assert run.t[k - 1] < seen["crossing"][member] <= run.t[k]
            share = (0.3 - run.q[k - 1, 0]) / (run.q[k, 0] - run.q[k - 1, 0])
            expected = run.t[k - 1] + 0.02 * share
            assert seen["crossing"][member] == pytest.approx(expected, abs=1e-9)
    assert np.isnan(seen["never"]).all()
    assert (seen["at once"] == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
def test_interrupt_keeps_what_is_done(stepper, threads, monkeypatch):
    """Ctrl-C when the main thread asks for more blocks, and again in another call."""
    given = {"p0": [0.0, 0.0], "h": 0.02, "steps": 200, "threads": threads}
    many, plain, asked = np.tile(ANGLES, (20, 1)), module._BlockQueue.next, []
    main = threading.main_thread().ident

    def next_one(queue):
        asked.append((queue, threading.get_ident()))
        mine = asked.count((queue, threading.get_ident()))
        if threading.get_ident() == main and mine == 2:
            signal.raise_signal(signal.SIGINT)
        elif threading.get_ident() != main and mine == 2:
            while asked.count((queue, main)) < 2:  # else one thread might do all
                time.sleep(1e-3)
        return plain(queue)

    monkeypatch.setattr(module._BlockQueue, "next", next_one)
    with pytest.raises(ss.Interrupted) as caught:
        stepper.ensemble(many, **given)
    partial = caught.value.trajectory
    assert isinstance(partial, ss.Ensemble)
    assert {ss.Status.SUCCESS, ss.Status.INTERRUPTED} == set(partial.status)
    partial = stepper.ensemble(many, **given, on_failure="return")
    assert "INTERRUPTED" in partial.message


WRONG = {
    "shape": ({"q0": [[1.0, 2.0, 3.0]]}, "q0 has shape"),
    "one column": ({"q0": [1.0]}, "q0 has shape"),
    "empty": ({"q0": np.zeros((0, 2))}, "q0 has shape"),
    "nan": ({"q0": [[1.0, 2.0], [np.nan, 0.0]]}, "not finite for member 1"),
    "text": ({"q0": "abc"}, "not real numbers"),
    "both": ({"v0": [0, 0]}, "exactly one of v0 and p0"),
    "neither": ({"p0": None}, "exactly one of v0 and p0"),
    "rows": ({"p0": np.zeros((3, 2))}, "p0 has 3 members, but another argument has 37"),
    "parameter rows": ({"parameters": {"l1": np.ones(5)}}, "l1 has 5 members"),
    "parameter sign": ({"parameters": {"l1": np.linspace(-1, 1, 37)}}, "l1 is declared positive"),
    "parameter name": ({"parameters": {"x": 1.0}}, "no parameter 'x'"),
    "parameter shape": ({"parameters": {"l1": np.ones((37, 1))}}, "but must have"),
    "parameters": ({"parameters": [1.0]}, "not a mapping"),
    "h": ({"h": 0}, "the step size h is 0"),
    "every": ({"every": 0}, "every is 0"),
    "threads": ({"threads": 0}, "threads is 0"),
    "threads text": ({"threads": "2"}, "threads is '2'"),
    "on_failure": ({"on_failure": "ignore"}, "on_failure"),
    "memory": ({"every": 1, "steps": 10**12}, "do not fit into memory"),
    "reduce": ({"reduce": ["max"]}, "not a mapping"),
    "kind": ({"reduce": {"x": ("median", "q1")}}, "median"),
    "reduce by a tuple": ({"reduce": ("max", "q1")}, "not a mapping"),
    "pair": ({"reduce": {"x": "q1"}}, "Pass a pair"),
    "name": ({"reduce": {"x": ("max", "q3")}}, "it contains the unknown name 'q3'"),
    "import": ({"reduce": {"x": ("max", "__import__('os').system('id')")}}, "it contains"),
    "attribute": ({"reduce": {"x": ("max", "q1.real")}}, "it contains"),
    "subscript": ({"reduce": {"x": ("max", "q1[0]")}}, "it contains"),
    "lambda": ({"reduce": {"x": ("max", "lambda: 1")}}, "it contains"),
    "text constant": ({"reduce": {"x": ("max", "'a'")}}, "it contains"),
    "truth": ({"reduce": {"x": ("max", "True")}}, "truth value"),
    "syntax": ({"reduce": {"x": ("max", "q1 +")}}, "no expression"),
    "statement": ({"reduce": {"x": ("max", "q1 = 3")}}, "no expression"),
    "long": ({"reduce": {"x": ("max", "q1 + " * 1000 + "1")}}, "more than 2000"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input(stepper, case):
    changes, message = WRONG[case]
    given = {"q0": ANGLES, "p0": [0.0, 0.0], "h": 0.02, "steps": 5} | changes
    with pytest.raises(ss.InputError, match=message):
        stepper.ensemble(**given)


def test_to_xarray(stepper, monkeypatch):
    pytest.importorskip("xarray")
    lengths = np.linspace(0.2, 0.4, 9)
    reduce = {"highest": ("max", "q1"), "q": ("min", "q2")}
    found = stepper.ensemble(
        [0.5, 1.0], **GIVEN, every=15, parameters={"l1": lengths}, reduce=reduce
    )
    data = found.to_xarray()
    assert dict(data.sizes) == {"member": 9, "time": 5, "coord": 2}
    assert data.q.dims == ("member", "time", "coord")
    assert (data.q.sel(coord="q2", member=3) == found.q[3, :, 1]).all()
    assert (data.l1 == lengths).all()
    assert (data.highest == found.reduced["highest"]).all()
    assert (data.reduced_q == found.reduced["q"]).all()
    assert data.attrs["system"] == "double_pendulum"
    last = stepper.ensemble(ANGLES[:3], **GIVEN).to_xarray()
    assert last.q.dims == ("member", "coord")
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(ss.InputError, match=r"symsimpson\[data\]"):
        found.to_xarray()


def test_data_of_members_that_run_backwards_tell_their_end(stepper):
    pytest.importorskip("pandas")
    backwards = GIVEN | {"h": -0.02, "t0": 0.5}
    for every in (15, None):
        back = stepper.ensemble(ANGLES[:3], **backwards, every=every)
        assert back.to_pandas().attrs["t_end"] == back.t[-1] == 0.5 - 0.02 * 60
    end = ss.Event("q1", name="down", terminal=True)
    members = stepper.ensemble([[0.1, 0.1], [1.0, 1.0]], **backwards, events=[end])
    assert members.to_pandas().attrs["t_end"] == members.ended_at.min()


def test_many_digits_are_refused():
    precise = ss.compile(PENDULUM, precision=30)
    with pytest.raises(ss.InputError, match="double precision"):
        precise.ensemble(ANGLES, **GIVEN)


@pytest.mark.slow
def test_progress(stepper, capsys, monkeypatch):
    pytest.importorskip("tqdm")
    stepper.ensemble(ANGLES, **GIVEN, progress=False)  # compiled
    monkeypatch.setattr("symsimpson.support.progress.DELAY", 1e9)
    stepper.ensemble(ANGLES, **GIVEN)
    assert capsys.readouterr().err == ""
    stepper.ensemble(ANGLES, **GIVEN, progress=True)
    assert "37/37" in capsys.readouterr().err
    stepper.ensemble(ANGLES, **GIVEN, progress=False)
    assert capsys.readouterr().err == ""
    for name in ("tqdm", "tqdm.auto"):
        monkeypatch.setitem(__import__("sys").modules, name, None)
    stepper.ensemble(ANGLES, **GIVEN)
    with pytest.raises(ss.InputError, match=r"symsimpson\[progress\]"):
        stepper.ensemble(ANGLES, **GIVEN, progress=True)


@pytest.mark.parametrize(
    ("name", "scheme", "same"),
    sweep(
        [
            ("double_pendulum", "gauss8", True),  # both iterate over nodes
            ("double_pendulum", "gauss12", True),
            ("double_pendulum", "lobatto8", True),  # both by Newton's method
            ("lagrange_top", "gauss8", False),  # members by Newton's method: it has few unknowns
        ],
        0,
    ),
)
def test_members_come_to_what_single_runs_do(name, scheme, same):
    system = getattr(ss.systems, name)()
    stepper = ss.compile(system, scheme)
    start = {key: np.array(value) for key, value in system.reference_state.items()}
    q0 = start.pop("q0") + np.linspace(0, 0.3, 11)[:, None]
    h = 0.001 if name == "lagrange_top" else 0.02
    found = stepper.ensemble(q0, **start, h=h, steps=50)
    for member in (0, 5, 10):
        run = stepper.integrate(q0[member], **start, h=h, steps=50, every=None)
        most = 0 if same else 1e-12
        assert np.abs(found.q[member] - run.q[0]).max() <= most
        assert np.abs(found.p[member] - run.p[0]).max() <= most
