"""The walker on small texts: each construct, and what it refuses."""

import ctypes
import random

import numpy as np
import pytest
from numba import njit, types
from support.cases import sweep
from support.small_texts import HEAD, run, text_of
from support.workspace import walked

from symsimpson.errors import GenerationError
from symsimpson.targets.llvm.intrinsics import function_intrinsic, read_functions, stub

LEAVE = """\
@compiled
def leave(W, lane):
    if W[1, lane] > 0.5:
        W[2, lane] = 7.0
        return
    W[2, lane] = 8.0
    W[3, lane] = 9.0
"""


@pytest.mark.parametrize(
    "body",
    [
        "W[0, lane] = h*W[1, lane] + t - W[2, lane]/W[3, lane]",
        "W[0, lane] = W[1, lane]**2 + W[2, lane]**3 + W[3, lane]**-2 + W[4, lane]**0",
        "W[0, lane] = W[1, lane] if W[2, lane] > 1 else -W[3, lane]",
        "W[0, lane] = min(W[1, lane], W[2, lane], 1.5) + max(abs(-W[3, lane]), 2)",
        "W[0, lane] = sqrt(W[4, lane]) + exp(-W[1, lane])",
        "a, b = W[1, lane], 2\nW[0, lane] = a*b\nW[1, lane] += W[0, lane]",
        "x = real(0)\nfor k in range(1, 4):\n    x += W[TABLE[k], lane]\nW[9, lane] = x",
        "for k in range(4):\n    if TABLE[k] == 0 or W[1, lane] > 9:\n        W[k, lane] = 5.0",
        "W[0, lane] = 1.0 if (W[1, lane] > 0) & (not W[2, lane] < 0) | (W[3, lane] == 9) else 0.0",
    ],
)
@pytest.mark.parametrize("lanes", [1, 4])
def test_statements_and_expressions(body, lanes):
    found, wanted = run(body, lanes=lanes)
    np.testing.assert_allclose(found, wanted, rtol=1e-15)


def test_loops_that_stay_loops():
    """With entries of tables, variables and branches inside; ends that are not known."""
    body = """\
largest, place = W[0, lane], 0
for i in range(60):
    if W[i, lane]*(40 - i) > largest:
        largest = W[i, lane]*(40 - i)
        place = i
for i in range(int(W[3, lane])):
    for j in range(i, 4):
        W[10 + j, lane] += W[TABLE[j], lane]*TABLE[i]
W[0, lane] = largest
W[1, lane] = place
"""
    found, wanted = run(body)
    assert (found == wanted).all()
    assert found[1, 0] == 20


def test_a_branch_in_which_a_function_is_left():
    found, wanted = run("leave(W, lane)\nW[5, lane] = W[2, lane]", LEAVE)
    assert (found == wanted).all()
    assert found[5, 0] == 7


def test_a_function_with_a_value_of_its_own_name():
    twice = "@compiled\ndef twice(x):\n    twice = 2*x\n    return twice\n\n\n"
    found, wanted = run("W[5, lane] = twice(W[2, lane])", twice)
    assert (found == wanted).all()
    assert found[5, 0] == 4


@pytest.mark.parametrize(
    "body",
    [  # rows beside each other are vectors, unless one turn needs what another wrote
        "for k in range(8):\n    W[16 + k, lane] = W[8 + k, lane]*W[1, lane] + W[24 + k, lane]",
        "for k in range(8):\n    W[16 + k, lane] = W[15 + k, lane] + 1",
        "for k in range(8):\n    W[16 + k, lane] = W[20, lane] + W[16 + k, lane]",
        "for k in range(8):\n    W[16 + k, lane] += W[32 + k, lane]",
        "for k in range(4):\n    W[2*k, lane] = W[8 + k, lane]",
        "x = 0.0\nfor k in range(8):\n    x = x + W[8 + k, lane]\n    W[16 + k, lane] = x",
    ],
)
def test_turns_that_depend_on_each_other_are_taken_one_by_one(body):
    found, wanted = run(body)
    assert (found == wanted).all()


def test_lanes_may_go_different_ways():
    """Then they are walked one after the other."""
    body = "if W[1, lane] > 1.2:\n    W[0, lane] = exp(-W[1, lane])\nelse:\n    W[2, lane] = 3.0"
    found, wanted = run(body, lanes=4)
    np.testing.assert_allclose(found, wanted, rtol=1e-15)


def test_what_is_refused_is_named_with_its_line():
    with pytest.raises(
        GenerationError, match=r"line 11: the kernel has an expression of type List"
    ):
        walked(text_of("W[0, lane] = [1][0]"), ["kernel"])
    with pytest.raises(GenerationError, match="which has no value here"):
        walked(text_of("W[0, lane] = unheard_of"), ["kernel"])


TEXT = """\
import numpy as np
from numba import njit

@njit(inline="INLINE")
def inner(x, k):
    if k < 0:
        return -1.0
    return x[k]

@njit()
def pair(x, k):
    if k == 2:
        return 5, 0.5
    return k, x[k]

@njit()
def function(x, y, n, flag):
    own = np.zeros((n, 2))
    row, count = own[n - 1], 0
    k = -1
    while True:
        k += 1
        if k == 1:
            continue
        if k >= n or x[k] > 50.0:
            break
        number, value = pair(x, k)
        row[0] += value * number
        count += number % 3 + (number // 2 if flag else 0)
    part = x[1:n].copy()
    for i in range(part.size):
        if part[i] > 30.0:
            return -i
        y[i, 1] = part[i] + own[n - 1, 0] + inner(x, i - 1)
    return count + y.shape[1]
"""


def test_functions_of_arrays():
    """Rooms of their own, rows and parts of arrays, loops that are left, results of two numbers."""
    signature = types.int64(types.float64[::1], types.float64[:, :], types.int64, types.boolean)
    names = {}
    exec(stub("function", 4), names)
    names["walk_function"] = function_intrinsic(
        lambda: read_functions(TEXT), "function", signature, 128
    )
    made = njit(signature)(names["function"])
    plain = {}
    exec(TEXT.replace("@njit()", "").replace('@njit(inline="INLINE")', ""), plain)
    for length, flag in ((6, True), (6, False), (40, True), (2, False)):
        x = np.arange(float(length)) * 1.5
        y, z = np.zeros((60, 4))[:, ::2], np.zeros((60, 2))
        assert made(x, y, length, flag) == plain["function"](x, z, length, flag)
        assert (y == z).all()


TUPLES = """\
import numpy as np
from numba import njit

@njit()
def share(number, k, parts):
    x, y = parts
    return number // k + np.int64(x[0]) + y.shape[0]

@njit()
def function(setting, parts, k):
    (h, count), (x, y) = setting, parts
    both = x, y
    if k > 0 and share(count, k, both) > 4:
        x[0] = h
        return share(count, k, (y, x))
    return -1
"""


def test_tuples_of_numbers_and_arrays_and_calls_that_are_not_made():
    """Nothing is divided by zero: a call behind ``and`` waits for what stands before it."""
    some = types.Tuple((types.float64, types.int64))
    signature = types.int64(some, types.UniTuple(types.float64[::1], 2), types.int64)
    names = {}
    exec(stub("function", 3), names)
    names["walk_function"] = function_intrinsic(
        lambda: read_functions(TUPLES), "function", signature, 128
    )
    made = njit(signature)(names["function"])
    plain = {}
    exec(TUPLES.replace("@njit()", ""), plain)
    for k in (0, 1, 2, 50):
        first, second = ([np.arange(1.0, 4.0), np.full(2, 7.0)] for _ in "12")
        given = 2.5, 12
        assert made(given, tuple(first), k) == plain["function"](given, tuple(second), k)
        assert all((a == b).all() for a, b in zip(first, second, strict=True))


ESCAPING = """\
import numpy as np
from numba import njit

@njit(inline="INLINE")
def room(n):
    return n, np.zeros(n)

@njit()
def function(n):
    count, own = room(n)
    return own[count - 1]
"""


def test_a_function_does_not_give_back_what_it_frees():
    names, signature = {}, types.float64(types.int64)
    exec(stub("function", 1), names)
    names["walk_function"] = function_intrinsic(
        lambda: read_functions(ESCAPING), "function", signature, 128
    )
    with pytest.raises(GenerationError, match="room returns an array"):
        njit(signature)(names["function"])


def statements(pick, depth=0):
    """Statements that read and write rows in all ways that there are, at random."""
    row, other = pick.randrange(20), pick.randrange(20)
    value = pick.choice(["0.0", "1.0", f"W[{other}, lane]", f"0.5 * W[{other}, lane] + h", "t"])
    width, at = pick.choice([4, 8]), pick.randrange(0, 16, 4)
    some = [
        [f"W[{row}, lane] = {value}"],
        [f"W[{row}, lane] += {value}"],
        [
            f"for k in range({width}):",
            f"    W[{at} + k, lane] = W[{pick.choice([0, 48])} + k, lane]",
        ],
        [
            f"for k in range({width}):",
            f"    W[{48 if at < 48 else 0} + k, lane] = 0.25 * W[{at} + k, lane]",
        ],
        [f"W[int(W[63, lane]) - {pick.randrange(20, 60)}, lane] = W[{other}, lane]"],
        [f"W[{row}, lane] = W[int(W[63, lane]) - {pick.randrange(20, 60)}, lane] - 1.0"],
    ]
    if depth < 2:
        body = [line for _ in range(3) for line in statements(pick, depth + 1)]
        other_body = statements(pick, depth + 1)
        inner = [f"    {line}" for line in body]
        some += [
            [f"if W[{row}, lane] < {other}.5:", *inner, "else:", *(f"    {x}" for x in other_body)],
            [f"for i in range(int(W[63, lane]) - {pick.choice([61, 62])}):", *inner],
            [f"for j in range({pick.choice([2, 3])}):", *inner],
        ]
    return pick.choice(some)


@pytest.mark.parametrize("seed", sweep(range(12), 4))
def test_rows_are_values_wherever_they_are_looked_at(seed):
    pick = random.Random(seed)
    body = "\n".join(line for _ in range(14) for line in statements(pick))
    found, wanted = run(body)
    assert found == pytest.approx(wanted, rel=1e-14), body


SCRATCH = "NODE_POSITION = 10\nNODE_VELOCITY = 14\nNODE_L_Q = 18\n"
USE = """\
for k in range(4):
    W[NODE_POSITION + k, lane] = W[k, lane] + 1.0
    W[NODE_VELOCITY + k, lane] = W[k, lane] + 2.0
if W[0, lane] < 1:
    for i in range(int(W[2, lane])):
        W[30 + i, lane] = W[NODE_POSITION + i, lane]
"""


def test_scratch_is_stored_where_it_is_asked_for_and_nowhere_else():
    found, wanted = run(USE, SCRATCH)
    assert (found[30:32] == wanted[30:32]).all()
    assert (found[10:14] == wanted[10:14]).all()  # it is named in what follows
    assert (found[14:18] == np.arange(14.0, 18)[:, None]).all()  # nobody asks for it


CARRIED = """\
def kernel(h, t, workspace):
    W = carray(workspace, (ROWS, LANES))
    for step in range(int(W[3, 0])):
        for lane in range(LANES):
            W[30, lane] += W[NODE_POSITION, lane]
            W[NODE_POSITION, lane] = W[1, lane] + 1.0
"""


def test_scratch_is_carried_from_turn_to_turn_of_a_loop():
    text = HEAD + SCRATCH + CARRIED
    start = np.arange(64.0)[:, None]
    address = walked(text, ["kernel"], 1)["kernel"].address
    call = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_double, ctypes.c_void_p)(address)
    call(0.5, 2.0, start.ctypes.data)
    assert start[30, 0] == 30 + 10 + 2 * (1 + 1.0)


def test_rows_behind_a_module_are_no_scratch():
    # what expressions of users come to stands there, and ROWS is another number then
    found, wanted = run("W[40, lane] = W[1, lane] + 1.0", "NODE_POSITION = 10\nJACOBIAN = 20\n")
    assert found[40, 0] == wanted[40, 0] == 2
