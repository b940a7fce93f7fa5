"""Small texts of kernels, run in Python and walked."""

import ctypes

import numpy as np

from support.workspace import walked

HEAD = """\
from math import exp, sqrt
SIGNATURE = "void(float64, float64, CPointer(float64))"
OPTIONS = {"fastmath": {"contract", "nsz"}, "error_model": "numpy"}
real = float
ROWS = 64
LANES = 1
TABLE = (3, 1, 2, 0)
"""


def text_of(body, functions="", lanes=1):
    lines = "".join(f"        {line}\n" for line in body.strip().splitlines())
    kernel = (
        "def kernel(h, t, workspace):\n    W = carray(workspace, (ROWS, LANES))\n"
        f"    for lane in range(LANES):\n{lines}"
    )
    return HEAD.replace("LANES = 1", f"LANES = {lanes}") + functions + kernel


def run(body, functions="", lanes=1):
    """Run a kernel on rows 0, 1, 2, ...; in Python, and walked."""
    text = text_of(body, functions, lanes)
    start = np.arange(64.0)[:, None] + np.arange(lanes) / 8
    names = {"carray": lambda W, shape: W, "compiled": lambda f: f}
    exec(text, names)
    wanted, found = start.copy(), start.copy()
    names["kernel"](0.5, 2.0, wanted)
    address = walked(text, ["kernel"], lanes)["kernel"].address
    ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_double, ctypes.c_void_p)(address)(
        0.5, 2.0, found.ctypes.data
    )
    return found, wanted
