"""Ensembles on disk and on a cluster: the same bits, whatever breaks off or dies on the way."""

import itertools
import os
import pickle
import shutil
import signal
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss
from symsimpson.run.ensemble import dispatch
from symsimpson.run.ensemble import store as module
from symsimpson.run.ensemble.members import read_ensemble_spec
from symsimpson.stepping.request import Request

xarray = pytest.importorskip("xarray")
zarr = pytest.importorskip("zarr")

ANGLES = np.random.default_rng(3).uniform(-2, 2, (40, 2))
LENGTHS = np.linspace(0.2, 0.4, 40)
WATCH = {"highest": ("max", "q1"), "../outside": ("mean", "energy"), "q": ("first", "q2 - 1")}
GIVEN = {
    "p0": [0.0, 0.0],
    "h": 0.02,
    "steps": 9,
    "every": 3,
    "reduce": WATCH,
    "parameters": {"l1": LENGTHS},
}


@cache
def stepper_and_whole(slow):
    """Return a stepper, and the ensemble that it computes; of slow tests both are compiled."""
    stepper = ss.compile(ss.systems.double_pendulum())
    return stepper, stepper.ensemble(ANGLES, **GIVEN)


@pytest.fixture
def stepper(request):
    return stepper_and_whole(request.node.get_closest_marker("slow") is not None)[0]


@pytest.fixture
def whole(request):
    return stepper_and_whole(request.node.get_closest_marker("slow") is not None)[1]


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    monkeypatch.setattr(module, "_choose_chunk_size", lambda stepper, task: 8)


@pytest.fixture
def counted(monkeypatch):
    """The sizes of the parts that are computed."""
    sizes = []
    plain = module.run_blocks

    def run_blocks(stepper, task, count):
        sizes.append(task.members)
        return plain(stepper, task, count)

    monkeypatch.setattr(module, "run_blocks", run_blocks)
    return sizes


def assert_same(found, expected):
    for name in ("t", "q", "p", "status", "steps", "newton_iterations"):
        assert np.array_equal(getattr(found, name)[:], getattr(expected, name), equal_nan=True)
    for name, values in expected.reduced.items():
        assert np.array_equal(found.reduced[name], values, equal_nan=True)
    assert repr(found) == repr(expected)


def test_members_that_take_no_step_go_to_a_store(stepper, tmp_path, monkeypatch):
    monkeypatch.undo()  # chunks are as large as the time of a step says
    kept = stepper.ensemble(ANGLES, p0=[0.0, 0.0], h=0.1, steps=0, store=tmp_path / "s")
    assert (kept.q[:] == ANGLES).all()


def test_a_system_without_constraints_has_no_forces_of_them_in_a_store(stepper, tmp_path):
    kept = stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")
    assert kept.constraint_forces.shape == kept.q.shape
    assert not kept.constraint_forces.any()


def test_a_store_holds_the_same_bits(stepper, whole, tmp_path):
    found = stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "new")
    assert_same(found, whole)
    assert found.q.chunks == (8, 4, 2)
    data, expected = found.to_xarray(), whole.to_xarray()
    assert set(data.variables) == set(expected.variables)
    assert set(data.coords) == set(expected.coords)
    assert {"highest", "reduced_1", "reduced_q", "l1", "p0"} < set(data.variables)
    for name, variable in expected.variables.items():
        assert data[name].dims == variable.dims
        np.testing.assert_array_equal(data[name].values.astype(variable.dtype), variable.values)
    assert data.attrs["digest"] == expected.attrs["digest"]
    assert [x.name for x in tmp_path.iterdir()] == ["new"]  # names are no paths


def test_only_what_is_missing_is_computed(stepper, whole, tmp_path, counted):
    found = stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")
    assert counted == [8] * 5
    counted.clear()
    assert_same(stepper.ensemble(ANGLES, **GIVEN, store=str(tmp_path / "s")), whole)
    assert counted == []
    shutil.rmtree(tmp_path / "s" / "status" / "c" / "1", ignore_errors=True)
    (tmp_path / "s" / "status" / "c" / "1").unlink(missing_ok=True)
    damaged = tmp_path / "s" / "status" / "c" / "3"
    damaged.write_bytes(damaged.read_bytes()[:-3])
    found.q[8:16] = 0.0
    assert_same(stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s"), whole)
    assert counted == [8, 8]


def test_damage_is_said_and_not_read(stepper, tmp_path):
    found = stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")
    path = tmp_path / "s" / "q" / "c" / "2" / "0" / "0"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(bytes(content))
    with pytest.raises(ss.StorageError, match=r"chunk q/c/2/0/0 .*checksum"):
        found.q[20]
    (tmp_path / "s" / "zarr.json").write_text("{")
    with pytest.raises(ss.StorageError, match="cannot be opened"):
        stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")


@pytest.fixture
def after(monkeypatch):
    """Do something when a function has been called so many times, in the thread that called it."""

    def arrange(owner, name, count, action):
        plain, calls = getattr(owner, name), itertools.count(1)

        def counted(*given):
            found = plain(*given)
            if next(calls) == count:
                action()
            return found

        monkeypatch.setattr(owner, name, counted)

    return arrange


@pytest.mark.slow
def test_interrupted_and_gone_on_with(stepper, tmp_path, counted, after):
    many = np.tile(ANGLES, (10, 1))
    given = {"p0": [0.0, 0.0], "h": 0.02, "steps": 2000}
    expected = stepper.ensemble(many, **given)
    after(module, "write_chunk", 3, lambda: signal.raise_signal(signal.SIGINT))
    with pytest.raises(ss.Interrupted) as caught:
        stepper.ensemble(many, **given, store=tmp_path / "s")
    partial = caught.value.trajectory
    done = int((partial.status == 0).sum())
    assert 0 < done < len(many)
    assert (partial.status != 0).sum() == (partial.status == ss.Status.INTERRUPTED).sum()
    counted.clear()
    assert_same(stepper.ensemble(many, **given, store=tmp_path / "s"), expected)
    assert sum(counted) == len(many) - done


def test_a_store_broken_off_while_it_was_made(stepper, whole, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(zarr.Group, "create_array", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")
    assert_same(stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s"), whole)


CHANGES = {
    "h": {"h": 0.01},
    "steps": {"steps": 101},
    "every": {"every": 10},
    "reduce": {"reduce": {}},
    "given": {"p0": None, "v0": [0.0, 0.0]},
    "initial states": {"p0": [0.0, 1e-9]},
    "parameters": {"parameters": {"l1": LENGTHS * (1 + 1e-15)}},
}


@pytest.mark.parametrize("what", sweep(CHANGES, 3))
def test_another_question_is_refused(stepper, tmp_path, what):
    stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")
    with pytest.raises(ss.InputError, match=rf"another ensemble: .*{what}.* differ"):
        stepper.ensemble(ANGLES, **GIVEN | CHANGES[what], store=tmp_path / "s")


def test_another_module_is_refused(stepper, tmp_path):
    stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")
    other = ss.compile(ss.systems.double_pendulum(), "midpoint")
    with pytest.raises(ss.InputError, match="another ensemble: module differ"):
        other.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")


def test_what_is_there_is_not_touched(stepper, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").write_text("years of work")
    (tmp_path / "file").write_text("more")
    zarr.create_group(tmp_path / "other", attributes={"by": "somebody"})
    for name, message in (("folder", "no ensemble"), ("file", "no ensemble"), ("other", "dataset")):
        with pytest.raises(ss.InputError, match=message):
            stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / name)
    assert (tmp_path / "folder" / "thesis.tex").read_text() == "years of work"
    assert (tmp_path / "file").read_text() == "more"
    with pytest.raises(ss.StorageError, match="cannot be opened"):
        stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "file" / "below")
    with pytest.raises(ss.InputError, match="store is int"):
        stepper.ensemble(ANGLES, **GIVEN, store=3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(__import__("sys").modules, "zarr", None)
        with pytest.raises(ss.InputError, match=r"symsimpson\[data\]"):
            stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")


def test_chunks_are_worth_their_trouble(stepper, monkeypatch):
    """A chunk is half a second of work, whatever a step costs here, and fits into 64 MiB."""
    monkeypatch.undo()
    program, states = stepper.program, np.zeros((3 * 10**6, 2))
    asked = Request(states, p0=[0, 0], h=0.02, steps=500)
    task = read_ensemble_spec(program, asked, 1, False, on_disk=True)
    assert module.measure_member_time(program, task) > 0
    monkeypatch.setattr(module, "measure_member_time", lambda *_: 0.1)
    assert module._choose_chunk_size(program, task) == task.lanes
    assert module._choose_chunk_size(program, replace(task, threads=16)) == 80
    monkeypatch.setattr(module, "measure_member_time", lambda *_: 1e-9)
    assert module._choose_chunk_size(program, task) == 2**26 // 32
    assert module._choose_chunk_size(program, task.part(slice(10))) == 10
    large = replace(task, every=1, steps=10**5)
    assert module._choose_chunk_size(program, large) == 2**26 // (16 * 2 * 100_001)


def test_what_does_not_fit_into_memory_may_go_to_disk(stepper):
    states = np.zeros((10**6, 2))
    steps = 5 * 10**6  # 160 TB: more than there are addresses
    asked = Request(states, p0=[0, 0], h=0.1, steps=steps, every=1)
    given = stepper.program, asked, 1, False
    with pytest.raises(ss.InputError, match=r"store='folder'"):
        read_ensemble_spec(*given, on_disk=False)
    assert read_ensemble_spec(*given, on_disk=True).stored == steps + 1


@pytest.fixture(scope="module")
def client():
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
        ) as local,
        distributed.Client(local) as client,
    ):
        yield client


@pytest.fixture
def sent(client, monkeypatch):
    """What is sent to the workers."""
    arguments = []
    plain = client.submit

    def submit(function, *given, **options):
        arguments.append((function, given))
        return plain(function, *given, **options)

    monkeypatch.setattr(client, "submit", submit)
    return arguments


@pytest.mark.slow
def test_a_worker_is_killed(stepper, client, sent, tmp_path, after):
    many = np.tile(ANGLES, (10, 1))
    given = {"p0": [0.0, 0.0], "h": 0.02, "steps": 2000, "reduce": WATCH}
    expected = stepper.ensemble(many, **given)
    victim = next(iter(client.run(os.getpid).values()))
    after(dispatch, "_task_result", 5, lambda: os.kill(victim, signal.SIGKILL))
    found = stepper.ensemble(many, **given, store=tmp_path / "s", client=client)
    assert victim not in client.run(os.getpid).values()
    assert_same(found, expected)
    assert {function for function, _ in sent} == {dispatch.compute_chunk}
    assert {tuple(map(type, given)) for _, given in sent} == {(str, str, int)}
    sent.clear()
    assert_same(stepper.ensemble(many, **given, store=tmp_path / "s", client=client), expected)
    assert sent == []


@pytest.mark.slow
def test_a_module_changed_in_the_store_is_not_executed(stepper, client, tmp_path, monkeypatch):
    canary = tmp_path / "canary"
    plain = dispatch.run_on_cluster

    def tampered(store, client):
        source = store.group.attrs["source"]
        store.group.attrs["source"] = source + f"\nopen({str(canary)!r}, 'w')\n"
        return plain(store, client)

    monkeypatch.setattr(dispatch, "run_on_cluster", tampered)
    with pytest.raises(ss.StorageError, match="has another digest than the requested one"):
        stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s", client=client)
    assert not canary.exists()


@pytest.mark.slow
def test_interrupt_on_a_cluster(stepper, client, tmp_path, after):
    many = np.tile(ANGLES, (10, 1))
    given = {"p0": [0.0, 0.0], "h": 0.02, "steps": 2000, "store": tmp_path / "s"}
    after(dispatch, "_task_result", 3, lambda: signal.raise_signal(signal.SIGINT))
    found = stepper.ensemble(many, **given, client=client, on_failure="return")
    assert (found.status == ss.Status.INTERRUPTED).any()
    assert (found.status == ss.Status.SUCCESS).any()


@pytest.mark.slow
def test_clients_that_make_no_sense(stepper, client, tmp_path):
    with pytest.raises(ss.InputError, match="client is str, not a synchronous client"):
        stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s", client="tcp://here")
    with pytest.raises(ss.InputError, match="client= needs store="):
        stepper.ensemble(ANGLES, **GIVEN, client=client)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(__import__("sys").modules, "distributed", None)
        with pytest.raises(ss.InputError, match=r"symsimpson\[cluster\]"):
            stepper.ensemble(ANGLES, **GIVEN, client=client)


def chunks_of(store, name):
    return sorted(path for path in (store / name / "c").rglob("*") if path.is_file())


def spoil(chunk, damage):
    if damage == "gone":
        return chunk.unlink()
    content = {"junk": b"junk", "cut": chunk.read_bytes()[:-2], "empty": b""}[damage]
    return chunk.write_bytes(content)


#: Arrays that are computed, reductions among them, and those that are given.
COMPUTED = ["q", "newton_iterations", "p", "steps", "status", "highest", "reduced_1", "reduced_q"]
GIVEN_ARRAYS = ["q0", "p0", "l1", "m1", "member", "time", "coord"]


@pytest.mark.parametrize("damage", sweep(["junk", "gone", "cut", "empty"], 2))
@pytest.mark.parametrize("name", sweep([*COMPUTED, *GIVEN_ARRAYS], 2))
def test_chunks_that_are_damaged_or_gone_are_computed_again(
    stepper, whole, counted, tmp_path, name, damage
):
    check_spoilt(stepper, whole, counted, tmp_path, name, damage)


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("q", "status", "l1")]


@pytest.mark.parametrize("name", ["highest", *SLOW])
def test_a_chunk_that_is_gone_is_computed_again(stepper, whole, counted, tmp_path, name):
    check_spoilt(stepper, whole, counted, tmp_path, name, "gone")


def check_spoilt(stepper, whole, counted, tmp_path, name, damage):
    before = stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s").to_xarray()
    spoil(chunks_of(tmp_path / "s", name)[-1], damage)
    if name not in ("member", "time", "coord"):  # indices were read at once
        with pytest.raises(ss.StorageError, match=rf"the chunk {name}/c/.* (missing|damaged)"):
            before[name].load()
    counted.clear()
    found = stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")
    assert_same(found, whole)
    assert counted == ([8] if name in COMPUTED else [])
    expected = whole.to_xarray()
    for key, variable in found.to_xarray().variables.items():
        np.testing.assert_array_equal(variable.values, expected[key].values)


@pytest.mark.parametrize("damage", ["gone", pytest.param("cut", marks=pytest.mark.slow)])
def test_what_is_lost_later_is_not_read_as_nan(stepper, tmp_path, damage):
    found = stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s")
    for name in ("q", "p", "status", "highest", "l1"):
        spoil(chunks_of(tmp_path / "s", name)[3], damage)
    lost = r"the chunk [qp]/c/3/.* is (missing|damaged)(.|\n)*Repeat the call"
    reads = (lambda: found.q[:], lambda: found[25], lambda: found.energy, found.to_pandas)
    for read in (*reads, lambda: pickle.loads(pickle.dumps(found)).p[24:32]):
        with pytest.raises(ss.StorageError, match=lost):
            read()
    data = found.to_xarray()
    for name in ("p", "status", "highest", "l1"):
        with pytest.raises(ss.StorageError, match=f"the chunk {name}/c/3"):
            data.variables[name].load()
    assert np.isfinite(found.q[:24]).all()


def test_reductions_without_a_value_are_not_missing(stepper, tmp_path, counted):
    """A time that never comes is NaN in all members of a chunk."""
    given = GIVEN | {"reduce": {"never": ("first", "q1 - 100")}}
    for _ in range(2):
        found = stepper.ensemble(ANGLES, **given, store=tmp_path / "s")
        assert np.isnan(found.reduced["never"]).all()
        assert np.isnan(found.to_xarray()["never"]).all()
    assert len(counted) == 5


@pytest.mark.slow
def test_members_that_are_not_computed_read_as_interrupted(stepper, tmp_path, after, monkeypatch):
    def stop():
        raise KeyboardInterrupt

    after(module, "write_chunk", 3, stop)
    found = stepper.ensemble(ANGLES, **GIVEN, store=tmp_path / "s", on_failure="return")
    assert (found.status == [0] * 24 + [ss.Status.INTERRUPTED] * 16).all()
    assert (np.isnan(found.q[:]).any(axis=(1, 2)) == (found.status != 0)).all()
    assert np.isnan(found.to_xarray()["highest"][24:]).all()


def test_a_store_is_read_like_a_file(tmp_path):
    """xarray warns of nothing, parameters are coordinates, and units are there."""
    pendulum = ss.systems.pendulum()
    units = {"theta": "rad", "p_theta": "kg m^2/s", "t": "s", "m": "kg", "l": "m"}
    stepper = ss.compile(replace(pendulum, units=units), "midpoint")
    given = {"v0": [0.0], "h": 0.1, "steps": 2, "every": 1, "parameters": {"l": [1.0, 2.0]}}
    kept = stepper.ensemble([[1.0], [2.0]], **given, store=tmp_path / "s")
    for save in (kept.save, stepper.ensemble([[1.0], [2.0]], **given).save):
        save(tmp_path / "s.nc")
        with (
            xarray.open_dataset(tmp_path / "s.nc") as file,
            xarray.open_zarr(tmp_path / "s") as data,
        ):
            assert set(data.coords) == set(file.coords) >= {"m", "l", "g", "units_q"}
            assert set(data.variables) == set(file.variables)
            for name, variable in file.variables.items():
                assert data[name].attrs.get("units") == variable.attrs.get("units"), name
            assert data["l"].attrs["units"] == "m"
            assert data["time"].attrs["units"] == "s"
