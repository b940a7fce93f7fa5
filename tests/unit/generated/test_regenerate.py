"""The committed modules are what the generator writes today, and stand on their own."""

import difflib
import json
import os
import subprocess
import sys
import textwrap

import pytest
import sympy
from support.bindings import bind_float
from support.cases import sweep
from support.places import GENERATED
from support.workspace import begin, state, take_step

import symsimpson as ss
from symsimpson.cli.commands import SCHEMES
from symsimpson.lower.pipeline import source

SYSTEMS = {make().name: make for make in ss.systems.CATALOGUE.values()}
PINNED = "1.14.0"


def test_there_are_no_other_files():
    expected = {f"{name}__{scheme}.py" for name in SYSTEMS for scheme in SCHEMES}
    assert {path.name for path in GENERATED.glob("*.py")} == expected


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", sweep(SYSTEMS, 2))
def test_bytes_are_fresh(name, scheme):
    """On one SymPy the bytes are compared, on others what the file states of its model."""
    committed = (GENERATED / f"{name}__{scheme}.py").read_text("utf-8")
    fresh = source(SYSTEMS[name](), scheme)
    if sympy.__version__ != PINNED:
        ends = [end_of_five_steps(SYSTEMS[name](), text) for text in (committed, fresh)]
        assert ends[0] == pytest.approx(ends[1], rel=1e-11, abs=1e-12)
        return
    lines = difflib.unified_diff(committed.splitlines(), fresh.splitlines(), "committed", "fresh")
    assert committed == fresh, "\n".join([*list(lines)[:40], "Run: symsimpson generate"])


def end_of_five_steps(system, text):
    module = bind_float(text)
    q, p = system.reference_state["q0"], [0.01] * system.n
    W = begin(module, q, p, system.parameters.values(), 0.01)
    for _ in range(5):
        take_step(module, W, 0.01)
    return state(module, W)


def test_numbers_are_compared_where_bytes_are_not():
    system = SYSTEMS["kepler"]()
    text = source(system, "midpoint")
    end = end_of_five_steps(system, text)
    assert end == end_of_five_steps(system, text)
    assert end != end_of_five_steps(system, text.replace("_X1/2", "_X1/3"))


@pytest.mark.slow
def test_same_bytes_for_every_hash_seed():
    """Of systems that are not among the committed ones, which have another seed each time."""
    code = textwrap.dedent("""
        import hashlib, symsimpson as ss
        from symsimpson.lower.pipeline import source
        made = [source(ss.systems.fermi_pasta_ulam(8)), source(ss.systems.puma560(3), "midpoint"),
                source(ss.systems.water(), "midpoint"), source(ss.systems.argon(), "gauss4"),
                source(ss.systems.n_body(4), "kahan_li6")]
        print(hashlib.sha256("".join(made).encode()).hexdigest())
    """)
    running = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONHASHSEED": str(seed)},
        )
        for seed in range(3)
    ]
    digests = {process.communicate()[0] for process in running}
    assert all(process.returncode == 0 for process in running)
    assert len(digests) == 1


ALONE = """
import json, sys
sys.modules["sympy"] = sys.modules["symsimpson"] = None      # importing them fails
import importlib.util, numpy as np
from numba import cfunc
spec = importlib.util.spec_from_file_location("alone", sys.argv[1])
m = importlib.util.module_from_spec(spec)
sys.modules["alone"] = m
spec.loader.exec_module(m)
kernel = {k: cfunc(m.SIGNATURE, **m.OPTIONS)(getattr(m, k)).ctypes
          for k in ("prepare", "start", "newton", "advance")}
W = np.zeros((m.ROWS, m.LANES))
def call(name):
    import ctypes
    kernel[name](H, 0.0, W.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))
q, p, H, steps = json.loads(sys.argv[2])
n = m.DIMENSION
W[m.POSITION : m.POSITION + n, 0], W[m.MOMENTUM : m.MOMENTUM + n, 0] = q, p
W[m.PARAMETER : m.PARAMETER + len(m.FACTS["defaults"]), 0] = m.FACTS["defaults"]
W[m.CONTRACTION] = W[m.ACTIVE] = 1
call("prepare"); call("start")
for _ in range(steps):
    W[m.RELATIVE], W[m.ACTIVE] = np.inf, 1
    while W[m.ACTIVE, 0] > 0:
        call("newton")
    W[m.ACTIVE] = 1
    call("advance")
print(json.dumps([*W[m.POSITION : m.POSITION + n, 0], *W[m.MOMENTUM : m.MOMENTUM + n, 0]]))
"""


@pytest.mark.slow
def test_a_module_runs_without_sympy_and_symsimpson():
    path = GENERATED / "double_pendulum__simpson.py"
    arguments = json.dumps([[0.7, -0.4], [0.0, 0.1], 0.02, 100])
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", ALONE, str(path), arguments],
        capture_output=True,
        check=True,
    )
    run = ss.load(path).integrate([0.7, -0.4], p0=[0.0, 0.1], h=0.02, steps=100)
    assert json.loads(done.stdout) == pytest.approx([*run.q[-1], *run.p[-1]], abs=1e-14)


def test_an_edited_file_is_refused(tmp_path):
    text = (GENERATED / "pendulum__midpoint.py").read_text("utf-8")
    for name, edited, message in (
        ("edited", text.replace("_X1/2", "_X1/3", 1), "does not match the digest"),
        ("foreign", "import os\n", "no module that symsimpson generated"),
    ):
        path = tmp_path / f"{name}.py"
        path.write_text(edited)
        with pytest.raises(ss.StaleKernelError, match=message):
            ss.load(path)
    with pytest.raises(ss.GenerationError, match="cannot be read"):
        ss.load(tmp_path / "missing.py")


def test_generate_load_and_compile_agree(tmp_path):
    system = ss.systems.elastic_pendulum()
    path = ss.generate(system, "midpoint", tmp_path)
    assert path.name == "elastic_pendulum__midpoint.py"
    before = path.stat().st_mtime_ns
    assert ss.generate(system, "midpoint", tmp_path).stat().st_mtime_ns == before
    runs = [
        stepper.integrate(**system.reference_state, h=0.01, steps=100)
        for stepper in (ss.load(path), ss.compile(system, "midpoint"))
    ]
    assert (runs[0].q == runs[1].q).all()
    kepler = ss.systems.kepler()
    general = ss.generate(kepler, "midpoint", tmp_path, exploit=()).read_text()
    assert general == ss.compile(kepler, "midpoint", exploit=()).source
    assert general != ss.compile(kepler, "midpoint").source
