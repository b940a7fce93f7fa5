"""Units in which a solver sees a programme: masses of 1e-15 kg are as good as others.

Solvers compare with 1. Unknowns and rows are divided by their sizes. The size of a coordinate is
how far it moves, by the guess, by given velocities, or else by bounds. The size of the time is the
duration. Masses, and with them momenta, inputs, multipliers and the cost, follow from the
equations at the guess. So neither the way to a solution nor the solution depends on units.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from symsimpson.control.ipopt import Outcome, Solvable
from symsimpson.control.layout import Layout
from symsimpson.support.array_types import Floats

__all__ = ["Scaled", "cost_size", "scaled", "sizes_at", "violations"]

#: A coordinate that moves by less than this part of what others do, at equal energies, is small
#: beside them. Motions by less than FINE of the positions are lost in rounding.
NEGLIGIBLE, FINE = 1e-4, 1e-6
#: Units of the cost, and of momenta, beside what follows from lengths, times and masses. Measured
#: on golden problems and swing-ups: 6 to 16 iterations, from half to twice of this.
COST, MOMENTUM = 2.0**-7, 2.0**-3
#: Costs are nothing below this part of that of the largest motions and inputs.
NOTHING = 1e-9


class Scaled:
    """A programme in units of the sizes of its unknowns, rows and cost."""

    def __init__(
        self, programme: Solvable, of_unknowns: Floats, of_rows: Floats, of_cost: float = 1.0
    ) -> None:
        self.programme, self.shape = programme, programme.shape
        self.of_unknowns, self.of_rows, self.of_cost = of_unknowns, of_rows, of_cost
        self.jacobian_places = programme.jacobian_places
        self.hessian_places = programme.hessian_places

    def values(self, x: Floats) -> tuple[float, Floats]:
        """Return the cost and the rows."""
        cost, rows = self.programme.values(x * self.of_unknowns)
        return cost / self.of_cost, rows / self.of_rows

    def slopes(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the gradient of the cost, and the entries of the Jacobian."""
        gradient, entries = self.programme.slopes(x * self.of_unknowns)
        rows, columns = self.jacobian_places
        sizes = self.of_unknowns[columns] / self.of_rows[rows]
        return gradient * self.of_unknowns / self.of_cost, entries * sizes

    def curvatures(self, x: Floats, cost: float, multipliers: Floats) -> Floats:
        """Return entries of the Hessian of cost times the cost, and multipliers times the rows."""
        entries = self.programme.curvatures(
            x * self.of_unknowns, cost / self.of_cost, multipliers / self.of_rows
        )
        rows, columns = self.hessian_places
        return entries * self.of_unknowns[rows] * self.of_unknowns[columns]

    def inside(self, x: Floats) -> Floats:
        """Return unknowns in these units."""
        return x / self.of_unknowns

    def outside(self, x: Floats) -> Floats:
        """Return unknowns in the units of the programme."""
        return x * self.of_unknowns

    def outcome(self, outcome: Outcome) -> Outcome:
        """Return what a solver came to in the units of the programme."""
        costs = [x * self.of_cost for x in outcome.history.get("obj", [])]
        return replace(
            outcome,
            x=outcome.x * self.of_unknowns,
            multipliers=outcome.multipliers * self.of_cost / self.of_rows,
            history={**outcome.history, "obj": costs} if costs else outcome.history,
        )


def scaled(programme: Solvable, layout: Layout, x: Floats) -> Scaled:
    """Return the programme of a layout in units of its sizes at a guess."""
    columns, lines = _sizes(programme, layout, x)
    # a cost that is square in inputs has no slope where they are 0
    curved = Scaled(programme, columns, lines).curvatures(x / columns, 1.0, np.zeros(len(lines)))
    parts = np.concatenate([programme.slopes(x)[0] * columns, curved])
    whole = np.abs(parts[np.isfinite(parts)]).sum()
    return Scaled(programme, columns, lines, float(_rounded(whole) * COST))


def cost_size(layout: Layout, x: Floats) -> float:
    """Return the size of costs at a guess: the cost there, or at least more than nothing."""
    programme, *_ = layout.programme
    cost, unit = abs(programme.values(x)[0]), scaled(programme, layout, x).of_cost / COST
    return max(cost if cost < np.inf else 0.0, NOTHING * unit)


def sizes_at(layout: Layout, x: Floats) -> tuple[Floats, Floats]:
    """Return the sizes of unknowns, and the sizes of rows in their scales."""
    of_unknowns, of_rows = _sizes(layout.programme[0], layout, x)
    scales = layout.scales.copy()
    scales[layout.step_rows - 1] /= _rounded(layout.scale * layout.steps)  # which are times
    return of_unknowns, scales * of_rows


def violations(layout: Layout, x: Floats) -> Floats:
    """Return how far rows are outside of their bounds, in units of their sizes."""
    programme, low, high = layout.programme
    rows = programme.values(x)[1]
    outside = np.maximum(np.maximum(low - rows, rows - high), 0.0)
    return np.asarray(outside / sizes_at(layout, x)[1])


@np.errstate(all="ignore")  # a search may end far away
def _sizes(programme: Solvable, layout: Layout, x: Floats) -> tuple[Floats, Floats]:
    """Return the sizes of unknowns and of rows."""
    entries = programme.slopes(x)[1]
    entries = np.where(np.isfinite(entries), np.abs(entries), 0.0)
    matrix = sparse.csc_matrix((entries, programme.jacobian_places), shape=programme.shape)
    columns = _unknowns(layout, matrix, x)
    rows = _largest(matrix @ sparse.diags(columns), 1)
    names, kinds = np.unique(layout.names, return_inverse=True)
    of_kinds = np.zeros(len(names))
    np.maximum.at(of_kinds, kinds, rows)
    # rows of a bound or a constraint have one unit, and some may be without a slope
    mixed = np.array([name == "step" or name.startswith("momentum at") for name in names])
    return columns, _rounded(np.where(mixed[kinds], rows, of_kinds[kinds]))


def _lengths(layout: Layout, masses: Floats, x: Floats, pushed: Floats) -> Floats:
    """Return how far coordinates move: on the path, at velocities that are given, else in bounds.

    Bounds count only if nothing else is known: bounds of coordinates, or else ``pushed``, how far
    the largest inputs push.
    """
    q, (given, rates, bounds) = x[layout.points].reshape(-1, layout.n), layout.read.extents
    places = np.abs(q).max(axis=0)
    lengths = np.maximum(np.ptp(q, axis=0), rates)
    lengths = np.where(lengths > 0, np.maximum(lengths, FINE * places), places)
    for further in (given, bounds, pushed):
        lengths = lengths if lengths.any() else further
    at_equal_energies = (lengths * np.sqrt(masses)).max() / np.sqrt(masses)
    return np.where(lengths > NEGLIGIBLE * at_equal_energies, lengths, at_equal_energies)


def _unknowns(layout: Layout, matrix: Any, x: Floats) -> Floats:
    """Return the sizes of unknowns: those of lengths, times and masses, and what follows."""
    sizes, steps, whole = np.ones(layout.size), layout.step_rows - 1, layout.scale * layout.steps
    time, inputs = _rounded(whole), np.moveaxis(layout.inputs, -1, 0)
    blocks = [(steps[..., a].ravel(), layout.points[..., a].ravel()) for a in range(layout.n)]
    masses = _rounded([matrix[rows][:, points].max() for rows, points in blocks])
    # how far an input moves coordinates that is 1 for the whole time, times their masses
    effects = [np.asarray(matrix[:, np.unique(u)].sum(axis=1)).ravel() for u in inputs]
    done = [x[steps[:, -1]].sum(axis=0) * whole / layout.end_scale for x in effects]
    of_inputs = layout.read.of_inputs
    most = [max(map(abs, of_inputs.get(j, (np.inf,)))) for j in range(len(done))]
    pushed = [x * bound / masses for x, bound in zip(done, most, strict=True) if bound < np.inf]
    lengths = _rounded(_lengths(layout, masses, x, np.max([0 * masses, *pushed], axis=0)))
    sizes[layout.points], sizes[layout.velocities] = lengths, lengths / time
    moved = masses * lengths
    sizes[layout.momenta] = MOMENTUM * moved / time
    widest = [np.abs(pair).max() for pair in layout.read.found_bounds]
    values = np.abs(x[layout.parameters])
    sizes[layout.parameters] = _rounded(np.where(values > 0, values, widest))
    sizes[layout.h] = time
    for places, effect, bound in zip(inputs, done, most, strict=True):
        enough = (moved[effect > 0] / effect[effect > 0]).min(initial=np.inf)
        sizes[places] = _rounded(min(bound, enough))
    held = (*np.moveaxis(layout.multipliers, -1, 0), *layout.at_end[:, None])
    if held:
        sizes[np.concatenate([*map(np.ravel, held)])] = 0.0
        of_rows = _rounded(_largest(matrix @ sparse.diags(sizes), 1))
        turned = _largest(sparse.diags(1 / of_rows) @ matrix, 0)
    for places in held:
        sizes[places] = 1 / _rounded(turned[places].max(initial=0.0))
    return sizes


def _largest(matrix: Any, axis: int) -> Floats:
    """Return the largest entry of each row (axis 1) or column (0)."""
    return np.asarray(matrix.max(axis=axis).todense()).ravel()


def _rounded(sizes: Any) -> Any:
    """Return the nearest powers of 2; 1 of what has no size."""
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.round(np.log2(sizes))
    return 2.0 ** np.where(np.isfinite(power), power, 0.0)
