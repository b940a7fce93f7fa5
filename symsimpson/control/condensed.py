"""The condensed form of a programme: states follow from inputs, step by step.

Of the full form the states are eliminated: for inputs that are given, a stepper finds the motion;
its slopes are those of the equations, and multipliers of the steps their adjoint. What is
left is small and dense: inputs, what is free of the start, durations and parameters.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from symsimpson.control.forward import motions
from symsimpson.control.ipopt import Outcome
from symsimpson.control.layout import Layout
from symsimpson.control.optimality import hessian
from symsimpson.control.point_functions import PointFunctions
from symsimpson.control.scaling import Scaled
from symsimpson.errors import InputError, SymsimpsonError
from symsimpson.run.ended import uninterrupted
from symsimpson.support.array_types import Floats, Ints

__all__ = ["Condensed", "at_start", "moved"]

#: Equations of steps hold when they are off by no more than this; or not by less any longer.
CLOSE = 1e-14
HOW = "Take the full form, condensed=False, in which states are unknowns."


class Condensed:
    """A programme without its states; ``unknowns`` are the remaining unknowns of the full form.

    The ``layout`` has their places in x, the vector of all unknowns at a guess. Bounds of states
    become rows.
    """

    def __init__(self, programme: Scaled, layout: Layout, x: Floats, bounds: Any) -> None:
        rows, size = programme.shape
        self._full, self._layout, self._x = programme, layout, x.copy()
        self._states = np.unique([*layout.points[:, 1:].ravel(), *layout.momenta[1:].ravel()])
        self._steps = layout.step_rows.ravel() - 1
        self._rest = np.setdiff1d(np.arange(rows), self._steps)
        self.unknowns: Ints = np.setdiff1d(np.arange(size), self._states)
        finite = np.isfinite(bounds[0]) | np.isfinite(bounds[1])
        self._bounded = np.flatnonzero(finite[self._states])
        left, kept = len(self._rest) + len(self._bounded), len(self.unknowns)
        self.shape: tuple[int, int] = left, kept
        column, row = (k.ravel() for k in np.mgrid[:kept, :left])
        self.jacobian_places: tuple[Ints, Ints] = row, column
        self._upper = np.tril_indices(kept)  # by columns: rows and columns changed places
        self.hessian_places: tuple[Ints, Ints] = self._upper[1], self._upper[0]
        self._last: dict[str, Any] = {}

    def inside(self, x: Floats) -> Floats:
        """Return the unknowns that are left."""
        return x[self.unknowns]

    def bounds(self, of_unknowns: Any, of_rows: Any) -> tuple[Any, Any]:
        """Return bounds of unknowns and of rows, of those of the full form."""
        states = self._states[self._bounded]
        pairs = zip(of_unknowns, of_rows, strict=True)
        rows = tuple(np.concatenate([y[self._rest], x[states]]) for x, y in pairs)
        return tuple(x[self.unknowns] for x in of_unknowns), rows

    def values(self, w: Floats) -> tuple[float, Floats]:
        """Return the cost and the rows; NaN where no motion was found."""
        at = self._at(w)
        if "x" not in at:
            return np.nan, np.full(self.shape[0], np.nan)
        cost, rows = self._full.values(at["x"])
        return cost, np.concatenate([rows[self._rest], at["x"][self._states[self._bounded]]])

    def slopes(self, w: Floats) -> tuple[Floats, Floats]:
        """Return the gradient of the cost, and the entries of the Jacobian."""
        at = self._at(w)
        if "x" not in at:
            return np.full(len(w), np.nan), np.full(self.shape[0] * len(w), np.nan)
        (gradient, jacobian), Z = at["slopes"], self._moved(at)
        rest = jacobian[self._rest]
        reduced = rest[:, self.unknowns].toarray() + rest[:, self._states] @ Z
        entries = np.concatenate([reduced, Z[self._bounded]])
        return gradient[self.unknowns] + gradient[self._states] @ Z, entries.ravel(order="F")

    def curvatures(self, w: Floats, cost: float, multipliers: Floats) -> Floats:
        """Return entries of the Hessian of cost times the cost, and multipliers times the rows."""
        at = self._at(w)
        if "x" not in at:
            return np.full(len(self._upper[0]), np.nan)
        all_rows = self._multipliers(at, cost, multipliers)
        H = hessian(self._full, at["x"], cost, all_rows).tocsr()
        Z, u, y = self._moved(at), self.unknowns, self._states
        crossed = H[u][:, y] @ Z
        reduced = H[u][:, u].toarray() + crossed + crossed.T + Z.T @ (H[y][:, y] @ Z)
        return np.asarray(reduced[self._upper])

    def outcome(self, outcome: Outcome) -> Outcome:
        """Return what a solver came to, with all unknowns and multipliers of the full form."""
        at = self._at(outcome.x)
        if "x" not in at:  # the last motion that was found
            at = self._at(self._x[self.unknowns])
        return replace(
            outcome, x=at["x"], multipliers=self._multipliers(at, 1.0, outcome.multipliers)
        )

    def _at(self, w: Floats) -> dict[str, Any]:
        """Return the motion of unknowns; none if it ends early."""
        if self._last and np.array_equal(self._last["w"], w):
            return self._last
        self._last, x = {"w": w.copy()}, self._x.copy()
        x[self.unknowns] = w
        try:
            path = moved(self._layout, self._full.outside(x))
            x[self._states] = self._full.inside(path)[self._states]
            # between ends of steps it is not their own polynomial, but near it
            off, before, at = self._off(x), np.inf, self._factorised(x)
            while CLOSE < (size := np.abs(off).max()) < before / 2:
                x[self._states] -= at["factors"].solve(off)
                off, before, at = self._off(x), size, self._factorised(x)
        except (SymsimpsonError, RuntimeError):  # of a stepper, of a matrix without an inverse
            return self._last
        self._x = x
        self._last |= {"x": x, **at}
        return self._last

    def _off(self, x: Floats) -> Floats:
        """Return by how much equations of steps are off."""
        return self._full.values(x)[1][self._steps]

    def _factorised(self, x: Floats) -> dict[str, Any]:
        """Return all slopes, and the factors of those of the steps by the states."""
        full = self._full
        gradient, entries = full.slopes(x)
        jacobian = sparse.csr_matrix((entries, full.jacobian_places), shape=full.shape)
        factors = splu(jacobian[self._steps][:, self._states].tocsc())
        return {"slopes": (gradient, jacobian), "factors": factors}

    def _moved(self, at: dict[str, Any]) -> Floats:
        """Return how states move with the unknowns."""
        if "moved" not in at:
            jacobian = at["slopes"][1]
            at["moved"] = -at["factors"].solve(jacobian[self._steps][:, self.unknowns].toarray())
        moved: Floats = at["moved"]
        return moved

    def _multipliers(self, at: dict[str, Any], cost: float, multipliers: Floats) -> Floats:
        """Return the multipliers of all rows: those of steps follow from the others."""
        gradient, jacobian = at["slopes"]
        rest, of_bounds = np.split(multipliers, [len(self._rest)])
        by_states = cost * gradient[self._states] + rest @ jacobian[self._rest][:, self._states]
        by_states[self._bounded] += of_bounds
        full = np.zeros(self._full.shape[0])
        full[self._rest] = rest
        full[self._steps] = -at["factors"].solve(by_states, trans="T")
        return full


def at_start(layout: Layout, x: Floats) -> Floats:
    """Return the unknowns of a guess, with a start that has what is given of it by numbers.

    Raises InputError if the system has constraints.
    """
    read, x = layout.read, x.copy()
    if read.constraints:
        raise InputError(
            f"{read.system.name} has constraints, and their multipliers are unknowns.\n{HOW}"
        )
    places = np.concatenate([layout.points[0, 0], layout.velocities[0]])
    state = dict(zip([*read.q, *read.v], x[places], strict=True)) | read.fixed(0)
    x[places] = [*state.values()]
    momenta = PointFunctions(read.graph, [], read.momenta)
    at = {**layout.parameter_values(x), **state, read.t: 0.0}
    x[layout.momenta[0]] = momenta.values(at, 1)[:, 0]
    return x


def moved(layout: Layout, x: Floats) -> Floats:
    """Return unknowns with states that move from the start as the inputs say.

    Raises InputError if the motion ends early.
    """
    x = x.copy()
    start = x[layout.points[0, 0]], x[layout.momenta[0]]
    with warnings.catch_warnings():  # this is the way to a solution, which is judged
        warnings.simplefilter("ignore")
        given = layout, x, start, x[layout.inputs]
        runs = [*map(uninterrupted, motions(*given, on_failure="return"))]
    for phase, run in zip(layout.grid.slices, runs, strict=True):
        if not run.success:
            raise InputError(
                f"the motion of the guess ends early, at t = {run.t[-1]:.6g}: {run.message}\n{HOW}"
            )
        within = run.t[:-1, None] + run.h * layout.places
        states = run.at(np.minimum(within, run.t[-1]).ravel())
        x[layout.points[phase]] = states.q.reshape(*within.shape, layout.n)
        x[layout.momenta[phase.start : phase.stop + 1]] = run.p
        x[layout.velocities[1]] = run.v[-1]
    return x
