"""A part's share of a step: what all parts have in common, and the general one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.linear_solve import solve_in_pairs, solve_symmetric
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.codegen.weighted import Increments, WeightedRows, bend, unit_row, weighted_residual
from symsimpson.discrete.reductions import Coupled

__all__ = [
    "Closing",
    "CoupledSolver",
    "Explicit",
    "Increment",
    "Path",
    "Solver",
    "constant_mass_velocity",
    "correction_names",
    "end_of",
    "end_point",
    "end_slope",
    "impulses",
    "newton_correction",
    "newton_rows",
    "node_point",
]


@dataclass(frozen=True)
class Path:
    """Increments of a step, and a suffix for the names of what is made of them."""

    increments: Increments
    suffix: str = ""


#: Control point and coordinate of an increment.
Increment = tuple[int, int]


@dataclass(frozen=True)
class Closing:
    """The end of a step, as the solution of a part tells it.

    Attributes
    ----------
    dq : mapping
        q1 - q0 of each coordinate, cyclic ones among them.
    dp : mapping
        p1 - p0 where it is not zero.
    checks : mapping
        Sizes by which a solution is accepted or not, by the block that holds the sum over parts.
    passed : Expression, optional
        The user's time that the step takes, if that is another one.
    """

    dq: Mapping[int, Expression]
    dp: Mapping[int, Expression]
    checks: Mapping[str, Expression] = field(default_factory=dict)
    passed: Expression | None = None


class Solver(Protocol):
    """A part's share of a step: how its increments are improved, and what they come to."""

    @property
    def coordinates(self) -> Sequence[int]:
        """The part's coordinates, without cyclic ones."""
        ...

    @property
    def cyclic(self) -> Sequence[int]:
        """Cyclic coordinates, whose increments follow from those of the others."""
        ...

    @property
    def increments(self) -> Sequence[Increment]:
        """The increments that an iteration changes; none if the step is explicit."""
        ...

    @property
    def multipliers(self) -> Sequence[Increment]:
        """The unknowns behind the control points that it changes, too."""
        ...

    def corrections(self) -> Mapping[Increment, Expression]:
        """Return what one Newton iteration adds to each of these increments."""
        ...

    def close(self) -> Closing:
        """Return the end of the step, from increments that solve it."""
        ...


class Explicit:
    """A part whose steps need no equations to be solved."""

    cyclic: tuple[int, ...] = ()
    increments: tuple[Increment, ...] = ()
    multipliers: tuple[Increment, ...] = ()

    def corrections(self) -> Mapping[Increment, Expression]:
        """Return nothing to correct."""
        return {}


def end_point(low: Lowering, dq: Mapping[int, Expression]) -> Point:
    """Return the point q1, where coordinates move by ``dq``; others must not be asked for."""
    return end_of(
        low, [low.moved_on(a, dq[a])[0] if a in dq else low.nothing for a in range(low.n)]
    )


def end_of(low: Lowering, q: Sequence[Expression]) -> Point:
    """Return the point q1, of its coordinates."""
    last = low.equations.scheme.stages - 1
    return Point("end", tuple(q), t=low.time(1, "end"), u=low.inputs(last))


def end_slope(low: Lowering, a: int) -> Expression:
    """Return the velocity at the end of a coordinate's path, times h."""
    slope = low.scheme.end_slope
    return low.graph.total(c * X[a] for c, X in zip(slope, low.increments, strict=True))


def correction_names(low: Lowering, increments: Iterable[Increment]) -> list[str]:
    """Return names for the corrections of increments."""
    return [f"d_{low.names.coordinates[a]}_X{m}" for m, a in increments]


def constant_mass_velocity(
    low: Lowering, group: Sequence[int], momentum: Sequence[Expression], hint: str, section: str
) -> list[Expression]:
    """Solve M v = p for coordinates whose M is constant; velocities are named after the hint."""
    start = low.start_point()
    mass = [[low.template.entry(start, "mass", "M", a, b) for b in group] for a in group]
    hints = [f"{hint}_{low.names.coordinates[a]}" for a in group]
    return solve_symmetric(low.graph, mass, momentum, hints, section)[0]


def node_point(
    low: Lowering,
    i: int,
    coordinates: Sequence[int],
    *,
    moving: bool,
    end: Point | None = None,
    path: Path | None = None,
) -> Point:
    """Return the point of node i in terms of the increments; ``end`` stands for a node at q1.

    Velocities are there if it is ``moving``.
    """
    scheme, define, h = low.scheme, low.graph.define, low.h
    A, B, d = scheme.A[i], scheme.B[i], low.equations.scheme.degree
    section, names = f"node {i}", low.names.coordinates
    path = path or Path(low.increments)
    X, suffix = path.increments, f"{i}{path.suffix}"

    def combined(row: tuple[Expression, ...], a: int) -> Expression:
        return low.graph.total(row[k] * bend(low, k, a, X) for k in range(1, d) if row[k] != 0)

    v = [low.nothing] * low.n
    if moving:
        for a in coordinates:
            slope = X[-1][a] + combined(B, a)
            v[a] = define(f"v_{names[a]}_{suffix}", slope / h, section)
    if low.equations.at_start(i):
        return Point(suffix, low.q, tuple(v), low.start_point().t, low.inputs(i))
    if end is not None and A[d] == 1 and all(value == 0 for value in A[:d]):
        return Point(end.suffix, end.q, tuple(v), end.t, end.u)
    q = [low.nothing] * low.n
    place = unit_row(A)
    for a in coordinates:
        bent = scheme.nodes[i] * X[-1][a] + combined(A, a)
        shift = bent if place is None else X[place - 1][a]
        q[a] = define(f"{names[a]}_{suffix}", low.q[a] + shift, section)
    t = low.time(scheme.nodes[i], str(i))
    return Point(suffix, tuple(q), tuple(v), t, low.inputs(i))


class CoupledSolver:
    """All increments are unknowns: D_k L_d = 0 for 0 < k < d and p0 + D_0 L_d = 0."""

    cyclic: tuple[int, ...] = ()
    multipliers: tuple[Increment, ...] = ()

    def __init__(self, low: Lowering, part: Coupled) -> None:
        self._low, self._part = low, part
        self.coordinates = part.coordinates
        self.increments = [(m, a) for m in part.columns for a in part.coordinates]

    def corrections(self) -> Mapping[Increment, Expression]:
        """Return what one Newton iteration adds to each increment."""
        low, part, eqs = self._low, self._part, self._low.equations
        group = part.coordinates
        points = [node_point(low, i, group, moving=True) for i in range(eqs.scheme.stages)]
        return newton_correction(low, points, part.rows, self.increments, group)

    def close(self) -> Closing:
        """Return q1 - q0 = X_d and p1 - p0 = h sum_i b_i L_q(q_i, v_i), less what is damped."""
        low = self._low
        dq = {a: low.increments[-1][a] for a in self.coordinates}
        impulse = impulses(low, self.coordinates, end_point(low, dq), moving=True)
        return Closing(dq, {a: low.decayed(low.p[a], dp) for a, dp in impulse.items()})


def newton_correction(
    low: Lowering,
    points: Sequence[Point],
    rows: Sequence[int],
    increments: Sequence[Increment],
    group: Sequence[int],
) -> dict[Increment, Expression]:
    """Return what Newton's method adds to increments, from the points of a path at its nodes."""
    matrix, right = newton_rows(low, points, rows, increments, group)
    hints = correction_names(low, increments)
    corrections = solve_in_pairs(low.graph, matrix, right, hints, "elimination")
    return dict(zip(increments, corrections, strict=True))


def newton_rows(
    low: Lowering,
    points: Sequence[Point],
    rows: Sequence[int],
    increments: Sequence[Increment],
    group: Sequence[int],
) -> tuple[list[list[Expression]], list[Expression]]:
    """Return the matrix and the right-hand side of an iteration, a row for each of D_k L_d."""
    eqs, define, names = low.equations, low.graph.define, low.names.coordinates

    def entry(i: int, what: str, *index: int) -> Expression:
        return low.template.entry(points[i], f"node {i}", what, *index)

    def grown(i: int, what: str, *index: int) -> Expression:
        return low.growth(low.scheme.nodes[i]) * entry(i, what, *index)

    weighted = WeightedRows(low, lambda i, a: entry(i, "F", a), lambda i, a: entry(i, "P", a))
    right = weighted_residual(low, weighted, rows, group)
    matrix = [
        [
            define(
                f"J_{k}_{names[a]}_{m}_{names[b]}",
                low.graph.total(eqs.second_derivative(k, a, m, b, grown)),
                "Jacobian D_m D_k L_d",
            )
            for m, b in increments
        ]
        for k in rows
        for a in group
    ]
    return matrix, right


def impulses(
    low: Lowering, coordinates: Sequence[int], end: Point, *, moving: bool, path: Path | None = None
) -> Mapping[int, Expression]:
    """Return h sum_i b_i L_q at the nodes of the path that ends at ``end``."""
    points = [
        node_point(low, i, coordinates, moving=moving, end=end, path=path)
        for i in range(low.equations.scheme.stages)
    ]
    weighted = WeightedRows(low, lambda i, a: low.template.entry(points[i], f"node {i}", "F", a))
    return {a: weighted.impulse(a) for a in coordinates}
