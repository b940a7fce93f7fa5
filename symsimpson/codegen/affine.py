"""Equations that are linear in the increments: solved with factors that are made once a run."""

from __future__ import annotations

from symsimpson.codegen.coupled import (
    Closing,
    Explicit,
    Path,
    end_point,
    impulses,
    newton_correction,
    node_point,
)
from symsimpson.codegen.expression import Expression
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.discrete.reductions import Affine

__all__ = ["AffineSolver"]


class AffineSolver(Explicit):
    """Increments by one Newton step from a path at rest, and by a second one their last digits.

    The second step takes away what rounding does to the factors, which would be the same in all
    steps and add up.
    """

    def __init__(self, low: Lowering, part: Affine) -> None:
        self._low, self._part, self.coordinates = low, part, part.coordinates
        self._solved = [(m, a) for m in part.solved for a in part.coordinates]

    def close(self) -> Closing:
        """Return q1 - q0 = X_d, and p1 - p0 of h sum_i b_i L_q(q_i, v_i) and of damping."""
        low, group = self._low, self.coordinates
        nodes = range(low.equations.scheme.stages)
        rest = [self._at_rest(i) for i in nodes]
        first = self._improved(None, rest, "first")
        points = [node_point(low, i, group, moving=True, path=first) for i in nodes]
        path = self._improved(first, points, "last")
        dq = {a: path.increments[-1][a] for a in group}
        impulse = impulses(low, group, end_point(low, dq), moving=True, path=path)
        return Closing(dq, {a: low.decayed(low.p[a], dp) for a, dp in impulse.items()})

    def _at_rest(self, i: int) -> Point:
        """Return node i of a path that stays at q0."""
        low = self._low
        t = low.time(low.scheme.nodes[i], str(i))
        return Point(f"{i}_rest", low.q, (low.graph.of(0),) * low.n, t, low.inputs(i))

    def _improved(self, path: Path | None, points: list[Point], name: str) -> Path:
        """Return a path behind a Newton step; points are its nodes, None is the path at rest."""
        low, part, names = self._low, self._part, self._low.names.coordinates
        change = newton_correction(low, points, part.rows, self._solved, part.coordinates)
        degree = range(1, low.equations.scheme.degree + 1)
        increments: list[dict[int, Expression]] = [{} for _ in degree]
        for (m, a), value in change.items():
            old = path.increments[m - 1][a] if path else 0
            hint = f"{names[a]}_X{m}_{name}"
            increments[m - 1][a] = low.graph.define(hint, old + value, "increments")
        return Path(increments, f"_{name}")
