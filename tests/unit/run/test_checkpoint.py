"""Runs that end and go on: the same bits, whatever ended them, and no damage unseen."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.stepping.run import Run

SYSTEMS = {
    name: ss.systems.CATALOGUE[name]()
    for name in ("double_pendulum", "lagrange_top", "henon_heiles", "harmonic_oscillator")
}
SYSTEMS |= {"duffing": ss.systems.duffing(), "cartesian": ss.systems.cartesian_pendulum()}
STEPS, H = 120, 0.0078125


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.ckpt"


class Killed(BaseException):
    """Ends a run as abruptly as a process can be ended from within."""


def same(a, b):
    return (
        (a.q == b.q).all()
        and (a.p == b.p).all()
        and (a.t == b.t).all()
        and (a.newton_iterations == b.newton_iterations).all()
        and a.status == b.status
    )


@pytest.fixture
def ended(monkeypatch):
    """Have a run end after so many steps: by Ctrl-C, or without a chance to save."""
    advance = Run.advance

    def end_after(steps, how):
        def limited(self, stop):
            advance(self, min(stop, steps))
            if self.step >= steps:
                raise how

        monkeypatch.setattr(Run, "advance", limited)

    yield end_after
    monkeypatch.undo()


@pytest.mark.parametrize("name", sweep(SYSTEMS))
@pytest.mark.parametrize(
    "scheme", sweep(["simpson", "gauss8", "midpoint", "lobatto6", "blanes_moan6", "lobatto2"])
)
@pytest.mark.parametrize("how", sweep([KeyboardInterrupt, Killed]))
def test_resumed_runs_have_the_same_bits(name, scheme, how, path, ended, monkeypatch):
    """Strides, places of checkpoints, and ends in all combinations."""
    system = SYSTEMS[name]
    try:
        stepper = ss.compile(system, scheme)
    except ss.SchemeError:
        pytest.skip("not explicit")
    given = {**system.reference_state, "h": H, "steps": STEPS}
    for every in (1, 7, None):
        whole = stepper.integrate(**given, every=every)
        for checkpoint_every, stop in ((16, 40), (39, 39), (400, 85), (5, 119)):
            ended(stop, how)
            with pytest.raises((ss.Interrupted, Killed)):
                stepper.integrate(
                    **given, every=every, checkpoint=path, checkpoint_every=checkpoint_every
                )
            monkeypatch.undo()
            assert same(ss.resume(path), whole), (every, checkpoint_every, stop)
            for file in path.parent.iterdir():
                file.unlink()


def test_the_same_call_goes_on(path, ended, monkeypatch):
    system = SYSTEMS["double_pendulum"]
    stepper = ss.compile(system)
    given = {**system.reference_state, "h": H, "steps": STEPS}
    ended(60, KeyboardInterrupt)
    part = stepper.integrate(**given, checkpoint=path, on_failure="return")
    assert part.status is ss.Status.INTERRUPTED
    assert part.steps == 60 == len(part) - 1
    assert "Continue the run with symsimpson.resume" in part.message
    monkeypatch.undo()
    run = stepper.integrate(**given, checkpoint=path)
    assert same(run, stepper.integrate(**given))
    with pytest.raises(ss.InputError, match="contains another run"):
        stepper.integrate(**given | {"steps": STEPS + 1}, checkpoint=path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*turns by 15 rad in a step:symsimpson.StabilityWarning")
def test_after_newton_took_over(path, ended, monkeypatch):
    """Which fallback is in use is kept."""
    system, given = ss.systems.elastic_pendulum(), {"k": 2e5}
    stepper = ss.compile(system, "gauss6")
    start = {
        "q0": [1.0, 0.3],
        "v0": [0.0, 0.0],
        "h": 15 / 2e5**0.5,
        "steps": 200,
        "parameters": given,
    }
    whole = stepper.integrate(**start)
    for stop in (1, 30, 64, 65, 150):
        ended(stop, KeyboardInterrupt)
        stepper.integrate(**start, checkpoint=path, on_failure="return")
        monkeypatch.undo()
        assert same(ss.resume(path), whole)
        for file in path.parent.iterdir():
            file.unlink()


CHILD = """
import json, sys
import symsimpson as ss
module, checkpoint, given = sys.argv[1:]
ss.load(module).integrate(
    **json.loads(given), checkpoint=checkpoint, checkpoint_every=2000, progress=False)
"""


def written(path):
    """When a checkpoint was written; between two names of a file there is none."""
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return None


@pytest.mark.slow
def test_kill_at_any_moment(path, tmp_path_factory):
    """Six times, by a signal that nothing can catch."""
    system = SYSTEMS["double_pendulum"]
    given = {**system.reference_state, "h": 0.0078125, "steps": 400_000, "every": 1000}
    module = ss.generate(system, "simpson", tmp_path_factory.mktemp("module"))
    command = [sys.executable, "-c", CHILD, str(module), str(path), json.dumps(given)]
    random = np.random.default_rng(3)
    killed = 0
    for _ in range(6):
        before = written(path)
        child = subprocess.Popen(command, stderr=subprocess.PIPE)
        while written(path) == before and child.poll() is None:  # until it writes one of its own
            time.sleep(0.002)
        time.sleep(random.uniform(0.0, 0.05))
        child.send_signal(signal.SIGKILL)
        _, said = child.communicate()
        killed += child.returncode == -signal.SIGKILL
        assert b"Error" not in said, said
    assert killed > 3  # the others had come to the end
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # killed between two names of a file
        run = ss.resume(path)
    assert same(run, ss.load(module).integrate(**given))


@pytest.fixture
def kept(path):
    """Files of a finished run, and the run."""
    system = SYSTEMS["double_pendulum"]
    stepper = ss.compile(system)
    run = stepper.integrate(
        **system.reference_state, h=H, steps=STEPS, checkpoint=path, checkpoint_every=100
    )
    return path, {file: file.read_bytes() for file in path.parent.iterdir()}, run


@pytest.mark.slow
def test_damage_is_seen(kept):
    """200 bits flipped and files cut short: the run before, or an error; never something else."""
    path, files, whole = kept
    random = np.random.default_rng(5)
    outcomes = {"same": 0, "before": 0, "refused": 0}
    names = [path, path.with_name("run.ckpt.states")]
    for trial in range(200):
        for file, content in files.items():
            file.write_bytes(content)
        victims = [names[trial % 2]] if trial % 3 else list(files)
        for victim in victims:
            content = bytearray(files[victim])
            where = int(random.integers(len(content)))
            if trial % 5 == 0:
                content = content[:where]
            else:
                content[where] ^= 1 << int(random.integers(8))
            victim.write_bytes(content)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                found = ss.resume(path)
            except ss.StorageError:
                outcomes["refused"] += 1
                continue
        assert same(found, whole)
        assert any("damaged" in str(one.message) for one in said), trial
        outcomes["before"] += 1
    assert outcomes["before"] > 50
    assert outcomes["refused"] > 20


def test_a_file_of_another_version(kept):
    path, _, _ = kept
    for file in (path, path.with_name("run.ckpt.previous")):
        file.write_text(file.read_text().replace("checkpoint 2", "checkpoint 3", 1))
    with pytest.raises(ss.StorageError, match="another version"):
        ss.resume(path)


def test_what_is_no_checkpoint(tmp_path):
    for name, content in (
        ("missing", None),
        ("empty", b""),
        ("text", b"hello"),
        ("bytes", b"\xff"),
    ):
        file = tmp_path / name
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(ss.StorageError, match="no intact checkpoint"):
            ss.resume(file)


def test_a_folder_that_cannot_be_written(tmp_path):
    system = SYSTEMS["double_pendulum"]
    with pytest.raises(ss.StorageError, match="cannot be written"):
        ss.compile(system).integrate(
            **system.reference_state, h=H, steps=10, checkpoint=tmp_path / "missing" / "run.ckpt"
        )


def test_a_full_disk_loses_nothing(path, monkeypatch):
    """The states that could not be written are in the error; the checkpoint before is good."""
    system, count = SYSTEMS["double_pendulum"], []
    stepper = ss.compile(system)
    given = {**system.reference_state, "h": H, "steps": STEPS}
    whole = stepper.integrate(**given)
    fsync = os.fsync

    def full(handle):
        count.append(handle)
        if len(count) > 8:
            raise OSError(28, "No space left on device")
        fsync(handle)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ss.StorageError, match="No space left") as caught:
        stepper.integrate(**given, checkpoint=path, checkpoint_every=50)
    part = caught.value.trajectory
    assert part.status is ss.Status.FILE_ERROR
    assert 50 < part.steps < STEPS
    assert (part.q == whole.q[: part.steps + 1]).all()
    monkeypatch.undo()
    assert same(ss.resume(path), whole)


@pytest.mark.slow
def test_memory_does_not_grow(path, monkeypatch):
    """States beyond the buffer are on disk: the arrays of the run stay small."""
    monkeypatch.setattr("symsimpson.run.checkpoint.BUFFER", 4000)
    sizes = []
    begin = Run.begin
    monkeypatch.setattr(
        Run, "begin", lambda self, *a, **k: (sizes.append(self.q.nbytes), begin(self, *a, **k))
    )
    system = SYSTEMS["double_pendulum"]
    run = ss.compile(system).integrate(**system.reference_state, h=H, steps=5000, checkpoint=path)
    monkeypatch.undo()
    assert max(sizes) <= 4000
    assert isinstance(run.q.base, np.memmap) or isinstance(run.q, np.memmap)
    assert same(run, ss.compile(system).integrate(**system.reference_state, h=H, steps=5000))


@pytest.mark.parametrize(("steps", "every"), [(9, 10), (10, 10), (35, 10), (3, 1000), (1, 1)])
def test_runs_of_which_few_states_are_stored(path, steps, every):
    """Between two states that are stored there is room for steps."""
    system = SYSTEMS["double_pendulum"]
    given = {**system.reference_state, "h": H, "steps": steps, "every": every}
    run = ss.compile(system).integrate(**given, checkpoint=path, checkpoint_every=4)
    assert same(run, ss.compile(system).integrate(**given))
    assert same(ss.resume(path), run)


@pytest.mark.parametrize("name", ["lambda", r"\xi", "x'"])
def test_names_of_the_user_are_resumed(path, name):
    q, k = ss.coordinates("W")[0], sp.Symbol(name, positive=True)
    system = ss.MechanicalSystem(
        "named",
        coordinates=(q,),
        kinetic=q.diff() ** 2 / 2,
        potential=k * q**2 / 2,
        parameters={k: 2.0},
    )
    run = ss.compile(system).integrate([1.0], v0=[0.0], h=H, steps=20, checkpoint=path)
    again = ss.resume(path)
    assert dict(again.parameters) == dict(run.parameters) == {name: 2.0}
    assert same(again, run)
    assert (again["W"] == run["W"]).all()


def test_many_digits_are_refused(path):
    system = SYSTEMS["double_pendulum"]
    with pytest.raises(ss.InputError, match="multiprecision"):
        ss.compile(system, precision=20).integrate(
            **system.reference_state, h="0.01", steps=3, checkpoint=path
        )
    assert not path.exists()


@pytest.mark.slow
@pytest.mark.parametrize("place", ["fsync", "advance"])
def test_interrupts_in_between(path, monkeypatch, place):
    """Ctrl-C while a checkpoint is written, or between; the run goes on each time."""
    system = SYSTEMS["double_pendulum"]
    stepper = ss.compile(system)
    given = {**system.reference_state, "h": H, "steps": 40_000, "every": 100}
    whole = stepper.integrate(**given)
    owner = os if place == "fsync" else Run
    plain = getattr(owner, place)
    for moment in range(10, 22):
        calls = itertools.count(1)

        def signalled(*given, calls=calls, moment=moment):
            plain(*given)
            if next(calls) == moment:
                signal.raise_signal(signal.SIGINT)

        monkeypatch.setattr(owner, place, signalled)
        with pytest.raises(ss.Interrupted):
            stepper.integrate(**given, checkpoint=path, checkpoint_every=100)
        monkeypatch.undo()
    assert same(ss.resume(path), whole)


@pytest.mark.slow
def test_a_stepper_that_is_no_file_is_not_needed(kept):
    """All that a run needs is in its file, which a new process can go on with."""
    path, files, _ = kept
    path.write_bytes(files[path.with_name("run.ckpt.previous")])
    code = "import sys, symsimpson as ss; print(ss.resume(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    assert f"{STEPS} steps" in done.stdout
    assert Path(path).exists()
