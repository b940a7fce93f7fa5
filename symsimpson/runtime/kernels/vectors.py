"""How wide the vectors of compiled code are: as wide as the machine has them.

Compilers prefer 256 bits on Intel servers that have 512. Those lowered the clock once; for code
that is all arithmetic they are faster now, where they are there.
"""

from __future__ import annotations

import os
from functools import cache

import llvmlite.binding as llvm

from symsimpson.errors import InputError

__all__ = ["VARIABLE", "vector_bits"]

VARIABLE = "SYMSIMPSON_VECTOR_BITS"
#: The widths that machines have, by the feature that tells of them.
_WIDTHS = {"avx512f": 512, "avx": 256}
_NARROW = 128


def vector_bits() -> int:
    """Return the bits of a vector: the most that this machine has, or fewer if that is wanted.

    Raises
    ------
    InputError
        If the environment asks for what no machine has.
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
