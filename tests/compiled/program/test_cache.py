"""Compiled code on disk: found by content, guarded against damage, private."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss
from symsimpson.errors import GenerationError
from symsimpson.program import cache
from symsimpson.program.cache import _intact, cache_folder
from symsimpson.program.driver import driver

CODE = """
import json, sys, time
import symsimpson as ss
(x,) = ss.coordinates("x")
import sympy as sp
k = sp.Symbol("k", positive=True)
factor, default = json.loads(sys.argv[1])
system = ss.MechanicalSystem("cached", coordinates=(x,), kinetic=x.diff()**2/2,
                             potential=factor*k*x**4, parameters={k: default})
from numba.core import compiler
compiled = []
original = compiler.CompilerBase._compile_core
def counted(self):
    compiled.append(self.state.func_id.func_name)
    return original(self)
compiler.CompilerBase._compile_core = counted
run = ss.compile(system, "midpoint").integrate([1.0], p0=[0.0], h=0.1, steps=20)
print(json.dumps([run.q[-1, 0], compiled]))
"""


def start(folder, factor=1, default=1.0):
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", CODE, json.dumps([factor, default])],
        stdout=subprocess.PIPE,
        env=os.environ | {"SYMSIMPSON_CACHE_DIR": str(folder)},
    )


def finish(process):
    out, _ = process.communicate()
    assert process.returncode == 0
    return json.loads(out)


def run(folder, **changes):
    return finish(start(folder, **changes))


@pytest.fixture(scope="module")
def warm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cache") / "symsimpson"
    value, compiled = run(folder)
    assert "newton" in compiled
    return folder, value


def entries(folder):
    """Names of what is compiled; texts are kept where deriving them took a while."""
    return sorted(path.name for path in folder.iterdir() if path.name != "texts")


@pytest.mark.slow
def test_a_second_process_compiles_nothing(warm):
    folder, value = warm
    before = entries(folder)
    again, compiled = run(folder)
    assert (again, compiled) == (value, [])
    assert entries(folder) == before
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.slow
def test_new_values_compile_nothing_and_new_equations_do(warm):
    folder, value = warm
    other, compiled = run(folder, default=2.0)
    assert compiled == []
    assert other != value
    edited, compiled = run(folder, factor=2)
    assert "newton" in compiled
    assert edited == pytest.approx(other, abs=1e-13)  # 2 k x^4 both


def damage(path, how):
    data = path.read_bytes()
    if how == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "flip":
        path.write_bytes(data[:-20] + bytes([data[-20] ^ 1]) + data[-19:])
    else:
        path.unlink()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "how"),
    sweep(
        [
            ("*/**/*.nbc", "cut"),
            ("*/**/*.nbi", "flip"),
            ("*/digests.json", "empty"),
            ("*/*.py", "remove"),
            ("*/**/*.nbc", "flip"),
        ]
    ),
)
def test_damage_is_mended(warm, pattern, how):
    folder, value = warm
    step = [path for path in folder.glob(pattern) if "newton_" in str(path)]
    assert step
    for path in step:
        damage(path, how)
    again, compiled = run(folder)
    assert again == value
    assert "newton" in compiled
    assert run(folder) == [value, []]


@pytest.mark.slow
def test_processes_may_start_at_once(tmp_path):
    folder = tmp_path / "cache"
    results = [finish(process) for process in [start(folder) for _ in range(3)]]
    assert len({value for value, _ in results}) == 1
    assert not [name for name in entries(folder) if name.startswith(".building")]
    assert run(folder)[1] == []


def test_a_folder_open_to_others_is_refused(tmp_path, monkeypatch):
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(0o775)  # whatever the umask
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(folder))
    with pytest.raises(GenerationError, match=r"mode 0775[\s\S]*chmod 700"):
        cache_folder()
    for mode in (0o755, 0o700):  # others may read, as mkdir makes it
        folder.chmod(mode)
        assert cache_folder() == folder
    link = tmp_path / "link"
    link.symlink_to(folder)
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(link))
    with pytest.raises(GenerationError, match="not private to you: it is a link"):
        cache_folder()
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(folder))
    owner = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)
    with pytest.raises(GenerationError, match="not private to you: it belongs to another user"):
        cache_folder()


def test_a_home_that_is_not_known(tmp_path, monkeypatch):
    def unknown(path):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(tmp_path / "own"))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    with monkeypatch.context() as without:
        without.delenv("HOME")
        without.setattr("pwd.getpwuid", unknown)  # as of a user without an entry, in a container
        without.setattr("os.path.expanduser", lambda path: path)
        assert cache_folder() == tmp_path / "own"
        without.delenv("SYMSIMPSON_CACHE_DIR")
        with pytest.warns(RuntimeWarning, match=r"home directory\), so each process") as said:
            assert cache_folder().is_dir()
        assert said[0].filename == __file__
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", "~/mine")
    assert cache_folder() == tmp_path / "mine"


@pytest.mark.parametrize("times", [1, 2])
def test_an_interrupt_waits_for_what_is_compiled_unless_it_is_given_again(
    times, tmp_path, monkeypatch
):
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(tmp_path / "own"))
    done = []

    def use(module, keep):
        for _ in range(times):
            signal.raise_signal(signal.SIGINT)
        done.append(keep)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        cache.load_or_compile("value = 1\n", f"interrupted_{times}", use)
    assert done == [True][: 2 - times]
    assert signal.getsignal(signal.SIGINT) is before


def test_numba_that_compiles_nothing(monkeypatch):
    monkeypatch.setattr("numba.config.DISABLE_JIT", True)
    with pytest.raises(GenerationError, match=r"NUMBA_DISABLE_JIT[\s\S]*precision=20"):
        cache.load_or_compile("", "nothing", lambda module, keep: None)


@pytest.mark.slow
def test_every_damage_is_seen(warm):
    """200 bits flipped and files cut short, anywhere in the cache."""
    folder, _ = warm
    random = np.random.default_rng(11)
    whole = [entry for entry in sorted(folder.iterdir()) if _intact(entry)]
    files = [
        path
        for entry in whole
        for path in sorted(entry.rglob("*"))
        if path.is_file() and path.suffix != ".pyc"
    ]
    for trial in range(200):
        path = files[int(random.integers(len(files)))]
        entry, data = folder / path.relative_to(folder).parts[0], path.read_bytes()
        where = int(random.integers(len(data)))
        damaged = bytearray(data)
        damaged[where] ^= 1 << int(random.integers(8))
        path.write_bytes(data[:where] if trial % 4 == 0 else damaged)
        assert not _intact(entry), path
        path.write_bytes(data)
        assert _intact(entry)


@pytest.fixture
def asked_for(monkeypatch):
    """Labels of all that is compiled or loaded, as in a new process."""
    labels, original = [], cache._load_or_build

    def counted(text, key, use):
        labels.append(key.rsplit("_", 1)[0])
        return original(text, key, use)

    monkeypatch.setattr(cache, "_load_or_build", counted)
    monkeypatch.delenv("SYMSIMPSON_COMPILE")
    monkeypatch.setattr(cache, "_results", {})
    driver.cache_clear()
    return labels


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8"]))
def test_what_one_run_has_compiled_is_all_that_later_ones_need(asked_for, scheme):
    stepper = ss.compile(ss.systems.henon_heiles(), scheme)

    def go(steps, **more):
        stepper.integrate([0.0, 0.1], v0=[0.4, 0.0], h=0.5, steps=steps, **more)

    go(4)
    assert {"newton", "energy"} <= set(asked_for)
    assert sum(label.startswith("driver-") for label in asked_for) == 2  # groups of functions
    del asked_for[:]
    go(4)
    go(1000)
    go(1000, every=None)
    go(20_000)  # no short run
    assert not asked_for


START = {"v0": [0.4, 0.0], "h": 0.1, "steps": 200}
#: Ways to use a stepper, by states that begin at a place.
USES = {
    "ensembles": lambda s, y: s.ensemble([[0.0, y], [0.1, y]], **START),
    "ensembles with reductions": lambda s, y: s.ensemble(
        [[0.0, y]], **START, reduce={"far": ("max", "x**2 + y**2")}
    ),
    "variations": lambda s, y: s.integrate([0.0, y], **START, tangents=4),
    "sections": lambda s, y: s.poincare("x", [0.0, y], **START),
    "events": lambda s, y: s.integrate([0.0, y], **START).events("x - y"),
    "states between steps": lambda s, y: s.integrate([0.0, y], **START).at([0.55]),
    "steps in doubt": lambda s, y: s.integrate(
        [0.0, y], v0=[0.4, 0.0], h=2.5, steps=40, on_failure="return"
    ),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.StabilityWarning")
@pytest.mark.filterwarnings("ignore::symsimpson.ResolutionWarning")
@pytest.mark.parametrize("use", USES)
def test_a_second_use_of_each_kind_compiles_nothing(asked_for, use):
    stepper = ss.compile(ss.systems.henon_heiles(), "gauss8")
    USES[use](stepper, 0.1)
    assert asked_for
    del asked_for[:]
    USES[use](stepper, 0.12)
    assert not asked_for


@pytest.mark.slow
def test_processes_that_need_the_same_code_make_it_once(tmp_path):
    folder = tmp_path / "cache"
    processes = [start(folder, factor=3) for _ in range(2)]
    results = [finish(one) for one in processes]
    assert results[0][0] == results[1][0]
    made = [name for _, names in results for name in names]
    assert made.count("newton") == 1
    assert len(made) == len(set(made))


@pytest.mark.slow
def test_the_lock_of_a_process_that_died_is_free(tmp_path):
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    hold = (
        "import sys, time; from filelock import FileLock\n"
        f"locks = [FileLock(f'{folder}/.lock-{{k}}') for k in range(64)]\n"
        "[lock.acquire() for lock in locks]; print('held', flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", hold], stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == b"held\n"
        holder.kill()
        holder.wait()
    assert "newton" in run(folder)[1]


def test_what_numba_is_told_is_part_of_the_key(monkeypatch):
    keys = []
    for name, value in (("NUMBA_OPT", "3"), ("NUMBA_OPT", "0"), ("NUMBA_NUM_THREADS", "1")):
        with monkeypatch.context() as changed:
            changed.setenv(name, value)
            cache._machine.cache_clear()
            keys.append(cache._machine())
    cache._machine.cache_clear()
    assert len(set(keys)) == 3
    assert keys[2] == cache._machine()


def test_where_code_is_follows_what_was_compiled():
    stepper = ss.compile(ss.systems.pendulum(), "midpoint")
    stepper.integrate([1.0], v0=[0.0], h=0.1, steps=2)
    assert stepper.program.kernels.location == "loaded"
