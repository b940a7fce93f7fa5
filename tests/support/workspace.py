"""Run generated kernels by hand, in any binding."""

from __future__ import annotations

from types import ModuleType

import mpmath as mp
import numpy as np
import pytest
from numba import cfunc

from symsimpson.graph.evaluate import line_value
from symsimpson.runtime.kernels.vectors import vector_bits
from symsimpson.walk.kernels import stubs, walking

TABLES = {"simpson": ("lobatto", 3, 2), "midpoint": ("gauss", 1, 1),
          "gauss4": ("gauss", 2, 2), "lobatto6": ("lobatto", 4, 3)}  # fmt: skip


def sweep(values, fast=1):
    """Parameters of a test: the first ones for the fast line, all others for the slow part."""
    values = list(values)
    return [*values[:fast], *(
        pytest.param(*(x if isinstance(x, tuple) else (x,)), marks=pytest.mark.slow)
        for x in values[fast:]
    )]  # fmt: skip


def jet_values(jet, q, v, parameters):
    """The outputs of a jet at a point, line by line in the digits that mpmath is set to."""
    given = {f"{kind}_{i}": x for kind, values in zip("qva", (q, v, parameters), strict=True)
             for i, x in enumerate(values)}  # fmt: skip
    found = {}
    for n in jet.program.order():
        line = jet.program.lines[n]
        if line.kind == "symbol":
            found[n] = mp.mpf(given[line.parts[0]])
        else:
            found[n] = line_value(line.kind, line.parts, found, mp.mp)
    return {
        key: mp.mpf(c.numerator) / c.denominator * found[n] if c else mp.mpf(0)
        for key, (c, n) in jet.program.outputs.items()
    }


def block(module, name, size):
    first = getattr(module, name)
    return slice(first, first + size)


def new_workspace(module, q, p, parameters, dtype=float):
    """A workspace with one state in every lane."""
    W = np.zeros((module.ROWS, module.LANES), dtype=dtype)
    n = module.DIMENSION
    for name, values in (("POSITION", q), ("MOMENTUM", p), ("PARAMETER", parameters)):
        for i, value in enumerate(values):
            W[getattr(module, name) + i, :] = value
    assert len(q) == len(p) == n
    W[module.ACTIVE, :] = 1
    W[module.COUNT, :] = 1
    return W


def begin(module, q, p, parameters, h, dtype=float):
    W = new_workspace(module, q, p, parameters, dtype)
    module.prepare(h, 0.0, W)
    module.start(h, 0.0, W)
    return W


def take_step(module, W, h, iterations=8, newton=None):
    for _ in range(iterations):
        (newton or module.newton)(h, 0.0, W)
    module.advance(h, 0.0, W)


def state(module, W, lane=0):
    n = module.DIMENSION
    return [*W[block(module, "POSITION", n), lane], *W[block(module, "MOMENTUM", n), lane]]


def walked(text, names, lanes=1, bits=None):
    """Kernels of a text as they are compiled for runs, by name."""
    module = ModuleType("walked")
    exec(stubs(text, list(names)), vars(module))
    for name in names:
        setattr(module, f"walk_{name}", walking(text, name, lanes, bits or vector_bits()))
    return {
        name: cfunc(module.SIGNATURE, **module.OPTIONS)(getattr(module, name)) for name in names
    }
