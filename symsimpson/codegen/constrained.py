"""Constraints written out: multipliers as unknowns, momenta projected, velocities that are held."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

from symsimpson.codegen.coupled import (
    Closing,
    Increment,
    correction_names,
    end_point,
    impulses,
    newton_rows,
    node_point,
)
from symsimpson.codegen.expression import Expression
from symsimpson.codegen.levels import Level
from symsimpson.codegen.linear_solve import solve_in_pairs, solve_symmetric
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.discrete.reductions import Constrained

__all__ = ["ConstrainedSolver", "held_velocities"]


class ConstrainedSolver:
    """D_k L_d = Phi^T mu_k and phi = 0 at the control points, for increments and h mu_k.

    All rows are divided by h where they are not of its size: the matrix is as well conditioned for
    small h as for large ones.
    """

    cyclic: tuple[int, ...] = ()

    def __init__(self, low: Lowering, part: Constrained) -> None:
        self._low, self._part, self.coordinates = low, part, part.coordinates
        self._held = range(len(low.equations.plain.constraints))
        self.increments = [(m, a) for m in part.columns for a in part.coordinates]
        behind = low.equations.scheme.degree + 1
        self.multipliers: list[Increment] = [(behind + k, c) for k in part.rows for c in self._held]

    @cached_property
    def _points(self) -> Mapping[int, Point]:
        """The control points, with the multipliers at them; there are none at the last one."""
        low, names = self._low, self._low.names.coordinates
        points = {}
        for k in range(low.equations.scheme.degree + 1):
            q = [low.q[a] for a in self.coordinates]
            if k > 0:
                q = [
                    low.graph.define(f"{names[a]}_c{k}", q[a] + low.increments[k - 1][a], "path")
                    for a in self.coordinates
                ]
            multipliers = low.impulses[k] if k < len(low.impulses) else ()
            points[k] = Point(f"c{k}", tuple(q), multipliers=multipliers)
        return points

    def _entry(self, k: int, what: str, *index: int) -> Expression:
        return self._low.held.entry(self._points[k], f"control point {k}", what, *index)

    def corrections(self) -> Mapping[Increment, Expression]:
        """Return what one Newton iteration adds to each increment and each multiplier."""
        low, part, group, held = self._low, self._part, self.coordinates, self._held
        h, entry, total = low.h, self._entry, low.graph.total
        stages = range(low.equations.scheme.stages)
        nodes = [node_point(low, i, group, moving=True) for i in stages]
        matrix, right = newton_rows(low, nodes, part.rows, self.increments, group)
        places = [(k, a) for k in part.rows for a in group]
        stiff = self._stiffness()
        for row, (k, a) in enumerate(places):
            pulls = [entry(k, "Phi", c, a) * low.impulses[k][c] for c in held]
            right[row] += total(pulls) / h
            pivot = part.columns[part.rows.index(k)]
            push = [stiff[k, c] * entry(k, "Phi", c, a) for c in held] if stiff else []
            right[row] -= total(x * entry(pivot, "phi", c) for c, x in enumerate(push)) / h
            for column, (m, b) in enumerate(self.increments):
                if m == k:
                    matrix[row][column] -= entry(k, "pull", a, b) / h
                if m == pivot:
                    more = (x * entry(m, "Phi", c, b) for c, x in enumerate(push))
                    matrix[row][column] += total(more) / h
            for j, c in ((j, c) for j in part.rows for c in held):
                matrix[row].append(-entry(k, "Phi", c, a) / h if j == k else low.graph.of(0))
        for m in part.columns:
            for c in held:
                slopes = [
                    entry(m, "Phi", c, b) / h if j == m else low.graph.of(0)
                    for j, b in self.increments
                ]
                matrix.append(slopes + [low.graph.of(0)] * len(self.multipliers))
                right.append(-entry(m, "phi", c) / h)
        hints = correction_names(low, self.increments)
        hints += [f"d_mu_{k}_{c}" for k, c in self.multipliers]
        corrections = solve_in_pairs(low.graph, matrix, right, hints, "elimination")
        return dict(zip([*self.increments, *self.multipliers], corrections, strict=True))

    def _stiffness(self) -> Mapping[tuple[int, int], Expression]:
        """Return how much of phi = 0 is added to each row: pivots are regular where M is not.

        It is w Phi^T Phi in each block that elimination begins with, as large as M there.
        """
        low, part, section = self._low, self._part, "stiffness"
        if not low.stiffened:
            return {}
        start, S = low.start_point(), low.scheme.stiffness
        weights = _weights(low, start, section, self.coordinates, "start")
        return {
            (k, c): low.graph.define(f"w_{k}_{c}", S[k][m] * weights[c], section)
            for k, m in zip(part.rows, part.columns, strict=True)
            for c in self._held
        }

    def close(self) -> Closing:
        """Return the end of the step: momenta without what the constraints there would take."""
        low, group, define = self._low, self.coordinates, self._low.graph.define
        names = low.names.coordinates
        dq = {a: low.increments[-1][a] for a in group}
        end = end_point(low, dq)
        change = dict(impulses(low, group, end, moving=True))
        for a in group:
            pulls = [
                self._entry(k, "Phi", c, a) * low.impulses[k][c]
                for k in range(low.equations.scheme.degree)
                for c in self._held
            ]
            change[a] -= low.graph.total(pulls) / low.h
        moved = {
            a: define(f"p_{names[a]}_step", change[a] + low.p_low[a], "projection") for a in group
        }
        p = [define(f"p_{names[a]}_far", low.p[a] + moved[a], "projection") for a in group]
        _, _, taken = held_velocities(low, end, p, "projection", group, "far")
        slopes = [
            [low.held.entry(end, "projection", "Phi", c, a) for a in group] for c in self._held
        ]
        for a in group:
            change[a] -= low.graph.total(slopes[c][a] * taken[c] for c in self._held)
        return Closing(dq, change)


def held_velocities(
    low: Lowering,
    point: Point,
    p: Sequence[Expression],
    section: str,
    group: Sequence[int],
    suffix: str,
) -> tuple[list[Expression], list[Expression], list[Expression]]:
    """Solve M v + Phi^T nu = p - a, Phi v = 0, for v, pivots of M where Phi v = 0, and nu.

    Where M needs it, w Phi^T Phi is added, which such velocities do not see: it is positive
    definite then, and its pivots are positive, if M is for them.
    """
    graph, entry, define = low.graph, low.template.entry, low.graph.define
    held, names = range(len(low.equations.plain.constraints)), low.names.coordinates
    total = graph.total
    mass = [[entry(point, section, "M", a, b) for b in group] for a in group]
    slopes = [[low.held.entry(point, section, "Phi", c, a) for a in group] for c in held]
    if low.stiffened:
        weights = _weights(low, point, section, group, suffix)
        mass = [
            [
                mass[a][b] + total(weights[c] * slopes[c][a] * slopes[c][b] for c in held)
                for b in group
            ]
            for a in group
        ]
        mass = [
            [
                define(f"M_{max(a, b)}_{min(a, b)}_{suffix}", mass[max(a, b)][min(a, b)], section)
                for b in group
            ]
            for a in group
        ]
    right = [p[a] - entry(point, section, "a", a) for a in group]
    hints = [f"u_{names[a]}_{suffix}" for a in group]
    free, pivots = solve_symmetric(graph, mass, right, hints, section)
    moving = any(graph.level(x) > Level.RUN for row in mass for x in row)
    if moving and not low.stiffened:  # what constraints take may have any sign
        weights = _weights(low, point, section, group, suffix)
        stiff = [
            [
                mass[a][b] + total(10 * weights[c] * slopes[c][a] * slopes[c][b] for c in held)
                for b in group
            ]
            for a in group
        ]
        pivots = solve_symmetric(graph, stiff, right, [f"{x}_stiff" for x in hints], section)[1]
    columns = [
        solve_symmetric(
            graph, mass, slopes[c], [f"y_{names[a]}_{c}_{suffix}" for a in group], section
        )[0]
        for c in held
    ]
    matrix = [
        [
            define(
                f"S_{c}_{e}_{suffix}",
                total(x * y for x, y in zip(slopes[max(c, e)], columns[min(c, e)], strict=True)),
                section,
            )
            for e in held
        ]
        for c in held
    ]
    rates = [total(x * u for x, u in zip(slopes[c], free, strict=True)) for c in held]
    hints = [f"nu_{c}_{suffix}" for c in held]
    taken, _ = solve_symmetric(graph, matrix, rates, hints, section)
    v = []
    for i, a in enumerate(group):
        lost = total(columns[c][i] * taken[c] for c in held)
        v.append(define(f"v_{names[a]}_{suffix}", free[i] - lost, section))
    return v, pivots, taken


def _weights(
    low: Lowering, point: Point, section: str, group: Sequence[int], suffix: str
) -> list[Expression]:
    """Return the trace of M in units of each row of Phi, squared."""
    trace = low.graph.total(low.template.entry(point, section, "M", a, a) for a in group)
    whole = low.graph.define(f"trace_{suffix}", trace, section)
    weights = []
    for c in range(len(low.equations.plain.constraints)):
        square = low.graph.total(low.held.entry(point, section, "Phi", c, a) ** 2 for a in group)
        weights.append(low.graph.define(f"weight_{c}_{suffix}", whole / square, section))
    return weights
