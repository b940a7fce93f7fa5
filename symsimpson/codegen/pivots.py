"""Pivots of M: whether it is definite where a run begins, and how they change along it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Row, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering

__all__ = ["begun_pivots", "least_pivot"]


def begun_pivots(
    low: Lowering, pivots: Sequence[Expression], section: str, first: int = 0
) -> list[Store]:
    """Store what tells whether M is positive definite where a run begins, and scales of pivots."""
    define, signed = low.graph.define, [d for d in pivots if not low.graph.is_positive(d)]
    deficits = [define("deficit", d - low.graph.applied("abs", d), section) for d in signed]
    deficit = define("deficit", low.graph.total(deficits), section)
    scales = [define("scale", 1 / d, section) for d in _moving(low, pivots)]
    rows = [Store(Row("PIVOT_SCALE", i), scale) for i, scale in enumerate(scales, first)]
    return [Store(Row("MASS_PIVOT", 0), deficit), *rows]


def least_pivot(
    low: Lowering, pivots: Sequence[Expression], row: Row, section: str, first: int = 0
) -> list[Store]:
    """Store the smallest pivot of M, each in units of that at the start; nothing if M is constant.

    The sign of a pivot in these units tells whether it is another one than at the start.
    """
    moving = _moving(low, pivots)
    ratios = [d * low.pivot_scale(i) for i, d in enumerate(moving, first)]
    if not ratios:
        return []
    least = reduce(lambda x, y: low.graph.applied("min", x, y), ratios)
    return [Store(row, low.graph.define("least_pivot", least, section))]


def _moving(low: Lowering, pivots: Sequence[Expression]) -> list[Expression]:
    """Return the pivots that change along a motion."""
    return [d for d in pivots if low.graph.level(d) > Level.RUN]
