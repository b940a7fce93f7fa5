"""The machine: how many threads and lanes it runs at once, and how wide its vectors are.

Compilers prefer 256 bits on Intel servers that have 512. Those lowered the clock once; for code
that is all arithmetic they are faster now, where they are there.
"""

from __future__ import annotations

import os
from functools import cache

import llvmlite.binding as llvm

from symsimpson.errors import InputError

VARIABLE = "SYMSIMPSON_VECTOR_BITS"
#: The widths that machines have, by the feature that tells of them.
_WIDTHS = {"avx512f": 512, "avx": 256}
_NARROW = 128
#: Of so many members, whose workspaces have so few rows that the nearest cache has room for them,
#: two registers full stand side by side: what one waits for is hidden by the other, a sixth to a
#: fourth of the time. For others that is nothing, and costs a second of compilation.
MANY, FEW_ROWS = 1024, 256


def vector_bits() -> int:
    """Return the bits of a vector: the most that this machine has, or fewer if that is wanted.

    Raises InputError if the environment asks for what no machine has.
    """
    wanted = os.environ.get(VARIABLE)
    if wanted is None:
        return _widest()
    widths = sorted([_NARROW, *_WIDTHS.values()])
    if wanted not in map(str, widths):
        raise InputError(
            f"${VARIABLE} is {wanted!r}, and vectors have {', '.join(map(str, widths))} bits.\n"
            "Set it to one of them, or take it away for the widest that the machine has."
        )
    return min(int(wanted), _widest())


@cache
def _widest() -> int:
    features = llvm.get_host_cpu_features()
    return next((bits for name, bits in _WIDTHS.items() if features.get(name)), _NARROW)


@cache
def lanes_of_machine() -> int:
    """Return the number of lanes of a block: two vector registers where they are short."""
    return 8 if llvm.get_host_cpu_features().get("avx") else 4


def lanes_for(rows: int, members: int) -> int:
    """Return the number of lanes of a block of an ensemble, with so many rows in a workspace."""
    two_registers = 2 * vector_bits() // 64
    small = members >= MANY and rows <= FEW_ROWS
    return max(lanes_of_machine(), two_registers) if small else lanes_of_machine()


def available_threads() -> int:
    """Count the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
