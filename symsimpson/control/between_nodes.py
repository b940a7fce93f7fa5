"""Whether the motion and the cost of a solution are those of its inputs between nodes, too.

Equations of steps see forces at nodes alone. Where inputs chatter from node to node, or steps are
far too long, a motion that satisfies them need not be one of the system; and what is dear for less
than a step may lie between nodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from symsimpson.control.point_functions import PointFunctions, lagrange, lagrange_slopes
from symsimpson.graph.nodes import ZERO
from symsimpson.support.array_types import Floats

__all__ = ["balanced"]

#: With so many more nodes of Gauss, sums over nodes in the equations of steps may change by this
#: part of what forces do. Measured: motions that no finer step has come to 0.06 to 0.9, ten steps
#: of a swing-up to 0.01 to 0.03, a single switch in three steps to 0.04.
MORE, OFF = 4, 0.05
#: The cost may change by as much. Costs below LEAST are rounding, and forces below this part of
#: momenta: none act where the best inputs are none.
NOTHING, LEAST = 1e-10, 1e-15


def balanced(layout: Any, x: Floats) -> bool:
    """Return whether equations of steps hold with more nodes, and the cost is what it is.

    Paths and inputs are the same polynomials. Signals are known at nodes alone.
    """
    read, u = layout.read, x[layout.inputs]
    known = read.graph.nodes[read.running[1]].symbols.isdisjoint(read.signals)
    running = read.running if known else ZERO
    functions = PointFunctions(read.graph, [], [*read.forces, *read.momenta, running])
    rows, done, cost, size = _sums(layout, functions, x, layout.c, layout.b, u)
    places, weights = np.polynomial.legendre.leggauss(layout.nodes + MORE)
    places = (places + 1) / 2
    inputs = np.einsum("ij,kjm->kim", lagrange(layout.c, places), u)
    finer, _, finer_cost, finer_size = _sums(layout, functions, x, places, weights / 2, inputs)
    # by the ways of coordinates all are of one unit: by those of steps, in which inputs do work,
    # and by those of whole motions, as a push where bodies hardly move tells where they go
    off, ways = np.abs(finer - rows).max(axis=1), np.abs(np.diff(x[layout.points], axis=1))
    moves = not any(
        (off * way).sum() > OFF * (done * way).sum() for way in (ways.sum(axis=1), ways.sum((0, 1)))
    )
    return moves and not abs(finer_cost - cost) > OFF * max(size, finer_size) + LEAST


def _sums(
    layout: Any,
    functions: PointFunctions,
    x: Floats,
    places: Floats,
    weights: Floats,
    inputs: Floats,
) -> tuple[Floats, Floats, float, float]:
    """Return sums over nodes in the equations of steps, (N, d + 1, n), and the sizes of forces.

    Forces that are rounding of momenta have the size of that. Then come the running cost, and what
    it is without signs.
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
    *both, cost = functions.values(point, N * s).reshape(-1, N, s)
    F, P = np.reshape(both, (2, n, N, s))
    F, cost = F * h[:, None], (cost * h[:, None]) @ weights
    rows = np.einsum("i,ij,aki->kja", weights, values, F)
    rows += np.einsum("i,ij,aki->kja", weights, slopes, P)
    done = np.einsum("i,aki->ka", weights, np.abs(F) + NOTHING * np.abs(P))
    return rows, done, float(cost.sum()), float(np.abs(cost).sum())
