"""Branches that the lanes of a vector take differently, and functions that lanes take in turn."""

import re

import numpy as np
import pytest
from support.cases import sweep
from support.small_texts import run, text_of
from support.workspace import walked

import symsimpson as ss
from symsimpson.targets.llvm import intrinsics
from symsimpson.text.syntax import redefined

LOOPED = ["chaplygin_sleigh", "hanging_chain 6", "fermi_pasta_ulam 12", "puma560", "jointed_bodies"]
#: In the first row lanes have 0, 1/8, 2/8 and 3/8.
SOME = "W[0, lane] > 0.2"
BODIES = {
    "some": f"if {SOME}:\n    W[5, lane] = W[1, lane] * 2.0\n    W[6, lane] += 3.0",
    "both": f"if {SOME}:\n    W[5, lane] = -1.0\nelse:\n    W[6, lane] = -W[7, lane]",
    "none": "if W[0, lane] > 9.0:\n    W[5, lane] = 1.0 / (W[1, lane] - W[1, lane])",
    "nested": f"""
if W[0, lane] > 0.1:
    W[5, lane] = 1.0
    if {SOME}:
        W[6, lane] = 2.0
    else:
        W[6, lane] = 3.0
    W[7, lane] = W[5, lane] + W[6, lane]""",
    "variables": f"""
x = 1.0
y = W[1, lane]
if {SOME}:
    x = y + 2.0
    z = 2.0 * x
    W[8, lane] = z
W[5, lane] = x""",
    "a loop inside": f"""
if {SOME}:
    total = 0.0
    for i in range(int(W[40, 0])):
        total += W[10 + i % 30, lane]
        if total > 20.0:
            total -= W[1, lane]
    W[5, lane] = total""",
    "a swap": """
for i in range(11, 14):
    if abs(W[i, lane] - 12.0) < abs(W[10, lane] - 12.0) - 0.2 * W[0, lane]:
        for j in range(0, 40, 20):
            swap = W[10 + j, lane]
            W[10 + j, lane] = W[i + j, lane]
            W[i + j, lane] = swap""",
    "scratch in a branch of a branch": f"""
if W[0, lane] < 9.0:
    for k in range(4):
        W[NODE_POSITION + k, lane] = W[k, lane] + 1.0
    if {SOME}:
        for k in range(4):
            W[NODE_POSITION + k, lane] = 7.0
    for k in range(4):
        W[30 + k, lane] = 2.0 * W[NODE_POSITION + k, lane]""",
    "scratch": f"""
if {SOME}:
    for k in range(4):
        W[NODE_POSITION + k, lane] = W[k, lane] + 1.0
    for k in range(4):
        W[30 + k, lane] = 2.0 * W[NODE_POSITION + k, lane]""",
}
SCRATCH = "NODE_POSITION = 10\nNODE_VELOCITY = 14\nNODE_L_Q = 18\n"
LEFT = """\
@compiled
def inner(W, first, lane):
    if W[0, lane] > 0.2:
        W[first, lane] = 1.0
        return
    pivot = 3
    if W[1, lane] > 1.1:
        pivot = 4
    W[first + 1, lane] = W[pivot, lane]


"""


@pytest.mark.parametrize("name", BODIES)
def test_what_a_lane_does_not_take_stays(name):
    functions = SCRATCH if "scratch" in name else ""
    found, wanted = run(BODIES[name], functions, lanes=4)
    kept = [k for k in range(64) if not functions or k not in range(10, 14)]
    assert np.array_equal(found[kept], wanted[kept])
    assert not np.array_equal(wanted, np.arange(64.0)[:, None] + np.arange(4) / 8) or name == "none"
    made = walked(text_of(BODIES[name], functions, 4), ["kernel"], 4)["kernel"].inspect_llvm()
    assert "<4 x double>" in made
    assert not re.search(r"store double", made)  # no lane is taken by itself


@pytest.mark.parametrize("around", ["{}", "if W[0, lane] > 0.1:\n    {}"])
def test_a_function_that_some_lanes_leave_is_taken_lane_by_lane(around):
    body = "W[5, lane] = 2.0 * W[6, lane]\n" + around.format("inner(W, 20, lane)")
    found, wanted = run(body, LEFT, lanes=4)
    assert np.array_equal(found, wanted)
    made = walked(text_of(body, LEFT, 4), ["kernel"], 4)["kernel"].inspect_llvm()
    assert "<4 x double>" in made
    assert re.search(r"store double", made)


@pytest.mark.parametrize("make", sweep(LOOPED, 1), ids=str)
def test_kernels_by_loops_have_lanes_as_vectors(make, monkeypatch):
    """No kernel of a step is walked once more, or for one lane after another."""
    name, *size = make.split()
    text = ss.compile(getattr(ss.systems, name)(*map(int, size))).source
    text, taken, real = redefined(text, {"LANES": "LANES = 4"}), [], intrinsics._walk_kernel

    def walk(*given, **how):
        taken.append((given[3], how["at_once"], how["alone"]))
        return real(*given, **how)

    monkeypatch.setattr(intrinsics, "_walk_kernel", walk)
    steps = [kernel for kernel in ("start", "newton", "advance") if f"def {kernel}(" in text]
    walked(text, steps, 4)
    assert taken == [(kernel, True, frozenset()) for kernel in steps]


def test_lanes_in_a_loop_over_steps_are_vectors():
    text = ss.compile(ss.systems.n_body(4), "blanes_moan4").source
    text = redefined(text, {"LANES": "LANES = 4"})
    made = walked(text, ["advance"], 4)["advance"].inspect_llvm()
    assert "@llvm.sqrt.v4f64" in made
    assert "@llvm.sqrt.f64" not in made
