"""Turns of a loop that have rows of their own, and those that are taken one by one."""

import numpy as np
import pytest
from support.small_texts import run, text_of
from support.workspace import walked

from symsimpson.errors import GenerationError

#: Rows of each turn, and rows that all turns use.
NODES = """\
POSITION, NODE_POSITION, NODE_VELOCITY, NODE_L_Q = 0, 10, 12, 13
STAGE_V, STAGE_Q, STAGE_P, STRIDE, DIMENSION, ONE, NONE = 32, 48, 60, 8, 2, 1, 0


@compiled
def enter(W, k, lane):
    for i in range(DIMENSION):
        W[NODE_POSITION + i, lane] = W[STAGE_V + i * STRIDE + k, lane] + W[POSITION + i, lane]


@compiled
def force(W, lane):
    for i in range(ONE):
        W[NODE_VELOCITY + i, lane] = real(0)
    for term in range(4):
        W[NODE_VELOCITY + TABLE[term] // 4, lane] += exp(-W[NODE_POSITION + term // 2, lane])


@compiled
def nodes(W, lane):
    for k in range(STRIDE):
        enter(W, k, lane)
        W[STAGE_Q + k, lane] = W[NODE_POSITION + 1, lane]


"""
TURNS = """\
for k in range(STRIDE):
    enter(W, k, lane)
    force(W, lane)
    W[STAGE_Q + k, lane] = W[NODE_VELOCITY, lane] / W[STAGE_V + k, lane]
W[POSITION + 5, lane] = W[NODE_POSITION + 1, lane]
"""
ALONE = """\
for k in range(STRIDE):
    W[STAGE_Q + k, lane] = W[NODE_VELOCITY, lane]
    W[NODE_VELOCITY, lane] = W[STAGE_V + k, lane]
"""
PARTS = """\
W[NODE_POSITION + 1, lane] = 5.0
for k in range(STRIDE):
    W[NODE_POSITION, lane] = W[STAGE_V + k, lane]
    W[STAGE_Q + k, lane] = W[NODE_POSITION, lane] + W[NODE_POSITION + 1, lane]
"""
NEVER = """\
W[NODE_VELOCITY, lane] = 5.0
for k in range(STRIDE):
    for i in range(NONE):
        W[NODE_VELOCITY + i, lane] = 0.0
    W[NODE_VELOCITY, lane] += W[STAGE_V + k, lane]
    W[STAGE_Q + k, lane] = W[NODE_VELOCITY, lane]
"""
CARRY = """\
for k in range(STRIDE):
    row = STAGE_Q + 1
    for i in range(DIMENSION):
        W[NODE_POSITION + i, lane] = W[row, lane]
        row = STAGE_V - 1 + k
    W[STAGE_V + k, lane] = W[NODE_POSITION + 1, lane] + 2.0
"""
AROUND = """\
for turn in range(int(W[2, lane])):
    W[6 + turn, lane] = W[NODE_POSITION, lane] if turn > 0 else 1.0
    nodes(W, lane)
"""
OUTSIDE = TURNS.replace("W[NODE_VELOCITY, lane]", "W[NODE_POSITION + 2, lane]")


@pytest.mark.parametrize(
    ("body", "vector"),
    [
        (TURNS, True),
        (TURNS.replace("range(STRIDE)", "range(1, 8)"), False),
        (TURNS.replace("enter(W, k, lane)", "enter(W, (k + 1) % 8, lane)"), False),
        (TURNS.replace("W[STAGE_V + k", "W[STAGE_Q + 8 + k"), False),
        (TURNS.replace("W[STAGE_V + k", "W[STAGE_Q + 1"), False),
        (ALONE, False),  # what one turn leaves is read by the next
        (PARTS, False),  # or what stood there before
        (NEVER, False),
        (CARRY, False),
        ("x = 1.0\n" + ALONE.replace("STRIDE):", "STRIDE):\n    x = 2.0 * x"), False),
        # rows are left as the last turn leaves them, wherever they are asked for
        ("nodes(W, lane)\nW[5, lane] = W[NODE_POSITION, lane]", True),
        ("if W[0, lane] < 1:\n    nodes(W, lane)\nW[5, lane] = W[NODE_POSITION, lane]", True),
        (AROUND, True),
    ],
)
def test_turns_may_have_rows_of_their_own(body, vector):
    found, wanted = run(body, NODES)
    kept = [*range(10), *range(32, 64)]  # scratch is not stored
    np.testing.assert_allclose(found[kept], wanted[kept], rtol=1e-15)
    made = walked(text_of(body, NODES), ["kernel"])["kernel"].inspect_llvm()
    assert ("<8 x double>" in made) is vector


@pytest.mark.parametrize("body", [OUTSIDE, OUTSIDE.replace("POSITION + 2", "POSITION * 2")])
def test_rows_outside_of_their_block_are_taken_one_by_one(body):
    found, wanted = run(body, NODES)
    np.testing.assert_allclose(found[48:56], wanted[48:56], rtol=1e-15)


def test_what_a_vector_sets_has_no_one_value_behind_it():
    body = "x = 1.0\nfor k in range(8):\n    x = W[32 + k, lane]\n    W[48 + k, lane] = x\n"
    with pytest.raises(GenerationError, match="x, which has no value here"):
        run(body + "W[5, lane] = x", NODES)
