"""Run generated kernels by hand, in any binding."""

from __future__ import annotations

from types import ModuleType

import mpmath as mp
import numpy as np
from numba import cfunc

from symsimpson.graph.evaluate import evaluate_line
from symsimpson.program.configuration import vector_bits
from symsimpson.targets.llvm.intrinsics import kernel_intrinsic, stubs

TABLES = {
    "simpson": ("lobatto", 3, 2),
    "midpoint": ("gauss", 1, 1),
    "gauss4": ("gauss", 2, 2),
    "lobatto6": ("lobatto", 4, 3),
}


def jet_values(jet, q, v, parameters):
    """The outputs of a jet at a point, line by line in the digits that mpmath is set to."""
    given = {
        f"{kind}_{i}": x
        for kind, values in zip("qva", (q, v, parameters), strict=True)
        for i, x in enumerate(values)
    }
    found = {}
    for n in jet.program.order():
        line = jet.program.lines[n]
        if line.kind == "symbol":
            found[n] = mp.mpf(given[line.parts[0]])
        else:
            found[n] = evaluate_line(line.kind, line.parts, found, mp.mp)
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


def newton_gaps(module, W, h, t, n):
    """Gaps of corrections, in fixed order and pivoted, to that of residual and Jacobian."""
    pivoted, equations = W.copy(), W.copy()
    module.newton(h, t, W)
    module.newton_pivoted(h, t, pivoted)
    module.equations(h, t, equations)
    size = module.UNKNOWNS
    rows = block(module, "INCREMENT", size)
    residual = equations[block(module, "RESIDUAL", size), 0]
    jacobian = equations[block(module, "JACOBIAN", size**2), 0].reshape(size, size)
    change = -np.linalg.solve(jacobian, residual).reshape(module.DEGREE, n)
    new = equations[rows, 0].reshape(module.DEGREE, n)
    for column, k in enumerate(module.COLUMN_ORDER):
        new[k - 1] += change[column]
    whole = np.abs(new).max()
    return [np.abs(x[rows, 0] - new.ravel()).max() / whole for x in (W, pivoted)]


def state(module, W, lane=0):
    n = module.DIMENSION
    return [*W[block(module, "POSITION", n), lane], *W[block(module, "MOMENTUM", n), lane]]


def walked(text, names, lanes=1, bits=None):
    """Kernels of a text as they are compiled for runs, by name."""
    module = ModuleType("walked")
    exec(stubs(text, list(names)), vars(module))
    for name in names:
        setattr(module, f"walk_{name}", kernel_intrinsic(text, name, lanes, bits or vector_bits()))
    return {
        name: cfunc(module.SIGNATURE, **module.OPTIONS)(getattr(module, name)) for name in names
    }
