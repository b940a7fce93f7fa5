"""Whether the motion of a solution is that of its inputs between nodes, too.

Equations of steps see forces at nodes alone. Where inputs chatter from node to node, or steps are
far too long, a motion that satisfies them need not be one of the system.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.control.points import PointFunctions, lagrange, lagrange_slopes

__all__ = ["balanced"]

Floats = NDArray[np.float64]
#: With so many more nodes of Gauss, sums over nodes in the equations of steps may change by this
#: part of what forces do. Measured: motions that no finer step has come to 0.06 to 0.4, ten steps
#: of a swing-up to 0.01 to 0.03, a single switch in three steps to 0.03.
MORE, OFF = 4, 0.05
#: Forces below this part of momenta are rounding: none act where the best inputs are none.
NOTHING = 1e-10


def balanced(layout: Any, x: Floats) -> bool:
    """Return whether equations of steps are satisfied with more nodes, for the same polynomials."""
    read, u = layout.read, x[layout.inputs]
    functions = PointFunctions(read.graph, [], [*read.forces, *read.momenta])
    rows, done = _rows(layout, functions, x, layout.c, layout.b, u)
    places, weights = np.polynomial.legendre.leggauss(layout.nodes + MORE)
    places = (places + 1) / 2
    inputs = np.einsum("ij,kjm->kim", lagrange(layout.c, places), u)
    finer, _ = _rows(layout, functions, x, places, weights / 2, inputs)
    # by the speeds of coordinates all are of one unit
    speeds = np.abs(np.diff(x[layout.points], axis=1)).sum(axis=1)
    off = (np.abs(finer - rows).max(axis=1) * speeds).sum()
    return not off > OFF * (done * speeds).sum()


def _rows(
    layout: Any,
    functions: PointFunctions,
    x: Floats,
    places: Floats,
    weights: Floats,
    inputs: Floats,
) -> tuple[Floats, Floats]:
    """Return sums over nodes in the equations of steps, (N, d + 1, n), and the sizes of forces.

    Forces that are rounding of momenta have the size of that.
    """
    read, q = layout.read, x[layout.points]
    sizes, (N, s, n) = layout.sizes(x), (layout.steps, len(places), layout.n)
    h = sizes[layout.grid.phase]
    k, i = (index.ravel() for index in np.mgrid[:N, :s])
    values, slopes = lagrange(layout.places, places), lagrange_slopes(layout.places, places)
    positions = np.einsum("ij,kja->aki", values, q)
    velocities = np.einsum("ij,kja->aki", slopes, q) / h[:, None]
    known = [*read.q, *read.v, *read.u]
    at = [*positions, *velocities, *np.moveaxis(inputs, -1, 0)]
    times = layout.grid.before(k, places[i]) @ sizes
    point = {node: value.ravel() for node, value in zip(known, at, strict=True)}
    point |= {**layout.parameter_values(x), read.t: times}
    F, P = functions.values(point, N * s).reshape(2, n, N, s)
    F = F * h[:, None]
    rows = np.einsum("i,ij,aki->kja", weights, values, F)
    rows += np.einsum("i,ij,aki->kja", weights, slopes, P)
    return rows, np.einsum("i,aki->ka", weights, np.abs(F) + NOTHING * np.abs(P))
