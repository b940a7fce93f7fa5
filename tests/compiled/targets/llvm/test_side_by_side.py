"""Calls of one function that need nothing of each other, walked as one vector."""

import ast
import ctypes

import numpy as np
import pytest
from support.bindings import bind_float
from support.small_texts import run, text_of
from support.workspace import new_workspace, walked

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.targets.llvm import vectors
from symsimpson.targets.llvm.trees import read_text
from symsimpson.targets.llvm.vectors import order_statements

WAVES = """\
@compiled
def waves(x):
    y = x*0.01
    z = y*y
    first = y - z*y*(0.16 - z*(0.008 - z*(0.0002 - z*(0.000003 - z*0.00000002))))
    second = 1.0 - z*(0.5 - z*(0.04 - z*(0.001 - z*(0.00002 - z*0.0000003))))
    odd = abs(x - 3.0) < 2.5
    return second if odd else first, -first if odd else second


@compiled
def wave(x, shift):
    a, b = waves(x + shift)
    return a*1.5 - b


@compiled
def half(x):
    return 0.5*x


@compiled
def beside_a_number(x):
    a, b = waves(x)
    return a + b, 2.5


@compiled
def counted(n, x):
    a, b = waves(x)
    return a + n // 2*b


@compiled
def upwards(x):
    return int(wave(x, 1.0)*10.0)


@compiled
def limited(x):
    if x > 0.5:
        return 0.5
    return x


@compiled
def limited_wave(x):
    return limited(wave(x, 2.0))
"""
#: Bodies, and how many calls are done at once, in the order of the text that is walked.
BODIES = {
    "two beside each other": ("a, b = waves(W[1, lane])\nx, y = W[2, lane], W[3, lane]", []),
    "arguments made in between": (
        """
x, y = W[1, lane], W[2, lane]
a, b = waves(x)
s = 2.0*x + y
u = s - 1.0
c, d = waves(u)
W[5, lane], W[6, lane] = a + c, b - d""",
        [2],
    ),
    "six, of which three wait for one of the others": (
        """
x, y = W[1, lane], W[2, lane]
a, b = waves(x)
c, d = waves(x + a)
e, f = waves(y)
g, i = waves(x - y)
j, k = waves(c + 1.0)
l, m = waves(e - 1.0)
W[5, lane] = a + b + c + d + e
W[6, lane] = f + g + i + j*k - l*m""",
        [3, 2],
    ),
    "more than a vector has": (
        "x = W[1, lane]\n"
        + "\n".join(f"a{n}, b{n} = waves(x + {n})" for n in range(7))
        + "\nW[5, lane] = "
        + " + ".join(f"a{n} - {n}*b{n}" for n in range(7)),
        [4, 3],
    ),
    "one result, two arguments": (
        "x = W[1, lane]\na = wave(x, 2.0*x)\nb = wave(x + 4.0, x)\nW[5, lane] = a - b",
        [2],
    ),
    "a light function on the way": (
        """
x, y = W[1, lane], W[2, lane]
a, b = waves(x)
u = half(y)
c, d = waves(u - 1.0)
W[5, lane], W[6, lane] = a + c, b - d""",
        [2],
    ),
    "a name that is set twice": (
        """
x = W[1, lane]
a, b = waves(x)
x = x + 5.0
c, d = waves(x)
W[5, lane] = a + c
W[6, lane] = b + d""",
        [],
    ),
    "a name that is read before": (
        """
x, y = W[1, lane], W[2, lane]
u = 3.0
for n in range(int(W[3, lane])):
    a, b = waves(x)
    W[10 + n, lane] = u + a
    u = y + n
    c, d = waves(u)
    W[20 + n, lane] = b + c*d""",
        [],
    ),
    "rows that are set in between": (
        """
x = W[1, lane]
a, b = waves(x)
W[2, lane] = a
y = W[2, lane] + x
c, d = waves(y)
W[5, lane] = b + c*d""",
        [],
    ),
    "a branch in between": (
        """
x, y, y2 = W[1, lane], W[2, lane], 6.0
a, b = waves(x)
if a > 0.5:
    W[3, lane] = a
    y2 = 7.0
else:
    y2 = 8.0
c, d = waves(y)
e, f = waves(y2)
W[5, lane], W[6, lane], W[7, lane] = a + c, b - d, e*f""",
        [2],
    ),
    "a known number among them": (
        "x = W[1, lane]\na, b = waves(x)\nc, d = waves(2.5)\nW[5, lane] = a*b + c*d",
        [2],
    ),
    "a result that is known": (
        """
x, y = W[1, lane], W[2, lane]
a, b = beside_a_number(x)
c, d = beside_a_number(y)
W[5, lane] = a*b + c*d""",
        [2],
    ),
    "whole numbers given": (
        """
x = W[1, lane]
n, m = int(W[7, 0]), int(W[9, 0])
a = counted(n, x)
b = counted(m, x)
W[5, lane] = a - 2.0*b""",
        [2],
    ),
    "whole numbers taken": (
        """
x, y = W[1, 0], W[2, 0]
n = upwards(x)
m = upwards(y)
W[5, lane] = n // 3 + m // 4""",
        [],
    ),
    "a function in it that is left early": (
        """
x, y = W[1, lane], W[2, lane]
a = limited_wave(x)
b = limited_wave(y)
W[5, lane] = a - 2.0*b""",
        [],
    ),
    "a turn that ends in between": (
        """
u = 0.0
for n in range(int(W[9, 0])):
    a, b = waves(n*1.0)
    W[10 + n, lane] = a
    if n > 4:
        continue
    u = n*2.0
    c, d = waves(u)
    W[30 + n, lane] = c*d
W[5, lane] = u""",
        [],
    ),
    "what costs little": ("x = W[1, lane]\na = half(x)\nb = half(x + 1.0)\nW[5, lane] = a*b", []),
}


def batches(statements, text):
    """List how many calls are done at once, in a block and in those below it."""
    sizes = [len(some) for _, some in order_statements(statements, text) if len(some) > 1]
    for statement in statements:
        for inner in (getattr(statement, "body", []), getattr(statement, "orelse", [])):
            sizes += batches(inner, text) if inner else []
    return sizes


@pytest.mark.parametrize("lanes", [1, 4])
@pytest.mark.parametrize("name", BODIES)
def test_values_are_those_of_single_calls(name, lanes):
    body, sizes = BODIES[name]
    found, wanted = run(body, WAVES, lanes)
    np.testing.assert_allclose(found, wanted, rtol=1e-15, atol=1e-15)
    text = read_text(text_of(body, WAVES))
    assert batches(text.functions["kernel"].body, text) == sizes


def test_every_statement_is_walked_once_behind_what_it_needs():
    text = read_text(source(ss.systems.n_pendulum(3), "simpson"))
    for kernel in ("newton", "advance", "start"):
        (loop,) = (node for node in text.functions[kernel].body if isinstance(node, ast.For))
        walked = [node for _, some in order_statements(loop.body, text) for node in some]
        assert sorted(map(id, walked)) == sorted(map(id, loop.body))
        known = {"W", "lane", "h", "t", "abs", "min", *text.functions, *text.constants}
        for node in walked:
            names = [x for x in ast.walk(node) if isinstance(x, ast.Name)]
            assert {x.id for x in names if isinstance(x.ctx, ast.Load)} <= known
            known |= {x.id for x in names if isinstance(x.ctx, ast.Store)}


@pytest.mark.parametrize(("links", "sizes"), [(2, [4]), (3, [4, 2])])
def test_angles_of_all_nodes_are_one_vector(links, sizes):
    text = read_text(source(ss.systems.n_pendulum(links), "simpson"))
    assert batches(text.functions["step_equations"].body, text) == sizes


def test_kernels_have_the_same_bits_as_with_single_calls(monkeypatch):
    text, ends = source(ss.systems.n_pendulum(3), "simpson"), []
    module = bind_float(text)
    for most in (4, 1):
        monkeypatch.setattr(vectors, "MOST", most)
        kernels = walked(text, ["prepare", "start", "newton", "advance"], 1)
        W = new_workspace(module, [0.5, -0.7, 1.1], [0.1, 0.2, -0.3], module.FACTS["defaults"])
        for name in ("prepare", "start", "newton", "newton", "advance"):
            W[module.ACTIVE] = 1
            call = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_double, ctypes.c_void_p)
            call(kernels[name].address)(0.05, 0.0, W.ctypes.data)
        ends.append(W)
    assert np.array_equal(*ends, equal_nan=True)
    assert np.abs(ends[0][module.INCREMENT]) > 0
