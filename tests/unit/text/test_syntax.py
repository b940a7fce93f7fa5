"""Files that are made to look generated: nothing in them runs."""

import ast
import contextlib
import subprocess
import sys

import pytest
from support.cases import sweep
from support.places import GENERATED

import symsimpson as ss
from symsimpson.text.header import SIGNED, digest
from symsimpson.text.syntax import check_structure

FILES = sorted(GENERATED.glob("*.py"))
TEXT = min((path.read_text() for path in FILES), key=len)
TOUCH = "open('CANARY', 'w')"
QUOTES = '"' * 3
#: A decorator that is text in the file, and code where a line of it is replaced.
HIDDEN = """
def X(x):
    y = QUOTES
LANES = 1 # QUOTES; z = '''
# QUOTES
@open("CANARY", "w") or (QUOTES # '''
LANES = 1
# QUOTES)
def Y(x):
    return x
""".replace("QUOTES", QUOTES)

#: Lines that are put into a generated module; each would touch the canary, or prepare to.
TOP = [
    TOUCH,
    "import os",
    "import os as range",
    "from os import system",
    "from math import *",
    "from numba import jit",
    "from numpy import load",
    "from . import math",
    "import math",
    "from numpy import array as real",
    f"X = {TOUCH}",
    "X = [open('CANARY', 'w') for _ in range(1)]",
    f"X = (lambda: {TOUCH})()",
    "X = __import__('os').system('touch CANARY')",
    "X = __builtins__",
    "X = ().__class__.__base__.__subclasses__()",
    "X = real.__globals__",
    "X = eval('1')",
    "X = exec('1')",
    "X = compile('1', '', 'eval')",
    "X = getattr(real, 'x')",
    "X = globals()",
    "X = vars()",
    "X = f'{TOUCH}'",
    "X = array.__module__",
    "X = njit.__wrapped__",
    "X = carray.__code__",
    "X = (y := 1)",
    "X = breakpoint()",
    "X = input()",
    "X = print",
    "X = type('X', (), {})",
    "X = super",
    "X = object()",
    "X = setattr",
    "X = memoryview(b'')",
    "X = b'bytes'",
    "X = 1j",
    "X = ...",
    "X: int = 1",
    "del real",
    "assert open('CANARY', 'w')",
    f"if 1: {TOUCH}",
    f"for X in (1,): {TOUCH}",
    f"while 1: {TOUCH}",
    f"with {TOUCH}: pass",
    f"try: {TOUCH}\nexcept: pass",
    "class X: pass",
    "async def X(): pass",
    "global X",
    "pass",
    "raise ValueError",
    "X = yield_",
    "@open\ndef X(): pass",
    f"@({TOUCH})\ndef X(): pass",
    "@njit(forceobj=True)\ndef X(): pass",
    "def X(a=open('CANARY', 'w')): pass",
    f"def X():\n    {TOUCH}\nY = X()",
    "def X():\n    import os",
    "def range(a): return a",
    "def X():\n    yield 1",
    "def X():\n    global real",
    "def X():\n    nonlocal_.x = 1",
    "OPTIONS = {'forceobj': True}",
    "OPTIONS = {}",
    "SIGNATURE = 'void()'",
    "X = [1].pop()",
    "X = 'CANARY'.join(())",
    "X = '{}'.format(1)",
    "X = (1).real",
    "X = sum.__call__(1)",
    "X = [range.append(1)]; print(X)",
    "X = print(1)",
    "X = max(1, key=print)",
]


def signed(text):
    banner = SIGNED.search(text)
    return text.replace(banner[1], digest(text[banner.end() :]), 1)


@pytest.mark.parametrize("path", sweep(FILES, 4), ids=lambda path: path.stem)
def test_generated_modules_pass(path):
    check_structure(path.read_text(), path.name)


def test_compositions_that_constraints_hold_pass(tmp_path):
    path = ss.generate(ss.systems.cartesian_pendulum(), "kahan_li8", tmp_path)
    assert ss.load(path).scheme == "kahan_li8"


@pytest.mark.parametrize("scheme", sweep(["lobatto_5_5", "gauss16", "lobatto10", "gauss_4_3"], 0))
def test_other_schemes_pass(scheme, tmp_path):
    path = ss.generate(ss.systems.lagrange_top(), scheme, tmp_path)
    assert ss.load(path).scheme == scheme


@pytest.mark.parametrize("name", sweep(["blanes_moan6", "gauss4"], 0))
def test_large_systems_pass(name, tmp_path):
    system = ss.systems.fermi_pasta_ulam()
    ss.load(ss.generate(system, name, tmp_path))
    ss.load(ss.generate(ss.systems.n_pendulum(8), "gauss4", tmp_path))


@pytest.mark.parametrize("line", TOP)
@pytest.mark.parametrize("place", ["constants", "end"])
def test_nothing_else_is_executed(line, place, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    at = TEXT.index("compiled = njit") if place == "constants" else len(TEXT)
    path = tmp_path / "hostile.py"
    path.write_text(signed(f"{TEXT[:at]}\n{line}\n{TEXT[at:]}"))
    with pytest.raises(ss.StaleKernelError, match=r"not executed|no module that symsimpson"):
        ss.load(path)
    assert not (tmp_path / "CANARY").exists()


@pytest.mark.parametrize(
    "lines",
    [
        'def X():\n    """\nROWS = 1000\n    """\n',
        "def X(a=(\n1,\n)):\n    return max(\n1,\n    2)\n",
        'def X():\n    """\ndef Y():\n    """\nROWS = 1000\n',
        'LANES = 1; X = """\nROWS = 1000\n"""\n',
        HIDDEN,
    ],
)
def test_bodies_at_the_left_margin_are_refused(lines, tmp_path):
    """Constants are read where functions have no bodies: none may stand in a body."""
    path = tmp_path / "hostile.py"
    path.write_text(signed(TEXT + lines))
    told = r"left margin|in a line|not executed|no module that symsimpson"
    with pytest.raises(ss.StaleKernelError, match=told):
        ss.load(path)


def test_comments_before_the_module_are_no_part_of_it(tmp_path, monkeypatch):
    """Quotes in them do not turn its description into code, which runs with the module."""
    monkeypatch.chdir(tmp_path)
    first = TEXT.index(QUOTES)
    second = TEXT.index(QUOTES, first + 3)
    evil = f"{QUOTES}\n{TOUCH}\n#{QUOTES}"
    path = tmp_path / "hostile.py"
    text = signed(TEXT[:first] + evil + TEXT[second + 3 :])
    path.write_text(f"# {QUOTES}\n{text}")
    with contextlib.suppress(ss.SymsimpsonError):
        stepper = ss.load(path)
        text = stepper.program.kernels._text
        assert text.startswith(QUOTES)
        ast.parse(text)
        assert TOUCH not in ast.unparse(ast.parse(text).body[1:])
    assert not (tmp_path / "CANARY").exists()


def test_the_canary_would_sing(tmp_path):
    """The negative control: the same lines do touch it where they are executed."""
    subprocess.run([sys.executable, "-c", TOUCH], cwd=tmp_path, check=True)
    assert (tmp_path / "CANARY").exists()


def test_a_checkpoint_is_looked_at_too(tmp_path, monkeypatch):
    import json

    monkeypatch.chdir(tmp_path)
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system)
    stepper.integrate(**system.reference_state, h=0.01, steps=3, checkpoint="run.ckpt")
    path = tmp_path / "run.ckpt"
    head, _, body = path.read_text().partition("\n")
    said = json.loads(body)
    said["asked"]["source"] = signed(said["asked"]["source"] + f"\nX = {TOUCH}\n")
    body = json.dumps(said)
    path.write_text(f"{head.rpartition(' ')[0]} {digest(body)}\n{body}")
    with pytest.raises(ss.StaleKernelError, match="not executed"):
        ss.resume("run.ckpt")
    assert not (tmp_path / "CANARY").exists()


def test_what_python_cannot_parse(tmp_path):
    for text in ("(" * 3000, "x = (", "\x00", "x = " + "-" * 100_000 + "1"):
        with pytest.raises(ss.StaleKernelError):
            check_structure(text, "file")
