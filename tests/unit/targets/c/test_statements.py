"""Lines of Python in C: the same numbers, whatever operators and blocks they are made of."""

import ast
import ctypes

import pytest
from support.in_c import COMPILER, build

from symsimpson.targets.c.kinds import REAL, Functions, Kinds, Source
from symsimpson.targets.c.statements import HELPERS, Expressions, write_function

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no compiler of C")

TEXT = """
def operators(a, b, c):
    x = a - (b - c) - (a - b - c)
    x += a / (b / c) / b * (a * (b + c))
    x -= -(a + b) * -c
    x *= 2 - -a
    return x + a**2 - (a - b)**2 + b**3 * c**-1.5


def conditions(a, b, c):
    x = 1.0 if a < b < c else 2.0 if not (a < b) & (b > c) else 3.0
    if a > b or (b > c and a != c):
        x += 10.0
    elif (a < b) | (b == c):
        x += 20.0
    return x * min(a, b, c) + max(a, b) - abs(a - c) + max(2, 3) + min(4, int(b))


def whole(a, b, c):
    x = 0.0
    for i in range(7, 0, -2):
        j = i // 2
        for k in ORDER:
            x += a * i / 3 - b * j / (i + 1) + TABLE[j % 2, k] * c
            if k == 1:
                break
    for i in range(1, 9, 3):
        x += i * i * b
    return x


def blocks(a, b, c):
    last = a
    for i in range(3):
        now = last + b
        if now > c:
            step = now - c
            kept = step
        else:
            kept = c
        last = now * kept
    swap = a
    if b > a:
        for i in range(2):
            swap = b + i
        swap = swap * 2.0
    unused = a * b
    return last + swap + part(a, b)


def part(a, b):
    if a > b:
        return a - b
    return 0.5
"""
CONSTANTS = {"ORDER": (2, 0, 1), "TABLE": ((0.5, 1.5, -2.0), (3.0, 0.25, 7.0))}
NUMBERS = [(0.3, 1.7, 2.9), (2.9, 1.7, 0.3), (1.7, 0.3, 2.9), (1.0, 1.0, 1.0), (5.5, 4.25, 4.5)]


@pytest.mark.parametrize("name", ["operators", "conditions", "whole", "blocks"])
def test_numbers_are_those_of_python(name, tmp_path):
    functions = {node.name: node for node in ast.parse(TEXT).body}
    kinds = Kinds(Functions([Source(functions, CONSTANTS, {}, TEXT.splitlines())]))
    kinds.follow(name, [REAL] * 3)
    write = Expressions(kinds, {x: x for x in functions})
    lines = [
        x for one in reversed(kinds.signatures) for x in write_function(kinds.functions[one], write)
    ]
    head = """#include <math.h>
static const int ORDER[3] = {2, 0, 1};
static const double TABLE[2][3] = {{0.5, 1.5, -2.0}, {3.0, 0.25, 7.0}};
"""
    source = tmp_path / "lines.c"
    call = f"double call(double a, double b, double c) {{ return {name}(a, b, c); }}"
    source.write_text("\n".join([head, *map(HELPERS.get, write.helpers), *lines, call, ""]))
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-Wno-unused-const-variable"]
    found = ctypes.CDLL(str(build(source, flags=flags))).call
    found.restype, found.argtypes = ctypes.c_double, [ctypes.c_double] * 3
    table = dict(
        CONSTANTS,
        TABLE={(i, k): x for i, row in enumerate(CONSTANTS["TABLE"]) for k, x in enumerate(row)},
    )
    exec(TEXT, table)
    for numbers in NUMBERS:
        assert found(*numbers) == pytest.approx(table[name](*numbers), rel=1e-15, abs=1e-15)
