"""Sines and cosines at nodes, turned from those of an earlier iteration by what angles change."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Assign, Load, Row, Section, SinCos, Statement, Store, Turn
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering

__all__ = ["Turning"]

_BLOCKS = ("STAGE_ANGLE", "STAGE_SINE", "STAGE_COSINE")


class Turning:
    """Rewrites statements of a node.

    Parameters
    ----------
    low : Lowering
        Gives names.
    stride : int
        Rows of a value that all nodes have.

    Attributes
    ----------
    count : int
        Pairs of sine and cosine that were found.
    """

    def __init__(self, low: Lowering, stride: int) -> None:
        self._low, self._stride = low, stride
        self.count = 0

    def _row(self, block: str, k: int) -> Row:
        return Row(block, f"{k * self._stride} + node" if k else "node")

    def kept(self, body: Iterable[Statement]) -> list[Statement]:
        """Return statements that keep their angles, sines and cosines."""
        self.count = 0
        return list(self._keeping(body))

    def _keeping(self, body: Iterable[Statement]) -> Iterator[Statement]:
        for statement in body:
            if isinstance(statement, Section):
                yield replace(statement, body=tuple(self._keeping(statement.body)))
                continue
            yield statement
            if isinstance(statement, SinCos):
                values = statement.angle, statement.sin, statement.cos
                for block, value in zip(_BLOCKS, values, strict=True):
                    yield Store(self._row(block, self.count), value)
                self.count += 1

    def turned(self, body: Iterable[Statement]) -> list[Statement]:
        """Return statements that turn those that were kept, and tell how far."""
        changes: list[Expression] = []
        statements = list(self._turning(body, changes))
        if changes:
            squares = self._low.graph.total(change**2 for change in changes)
            statements.append(Store(Row("STAGE_TURN", "node"), squares))
        return statements

    def _turning(self, body: Iterable[Statement], changes: list[Expression]) -> Iterator[Statement]:
        for statement in body:
            if isinstance(statement, Section):
                yield replace(statement, body=tuple(self._turning(statement.body, changes)))
                continue
            if not isinstance(statement, SinCos):
                yield statement
                continue
            hints = ("angle_before", "sine_before", "cosine_before", "turn")
            angle, sine, cosine, change = (self._low.graph.fresh(x, Level.ITERATION) for x in hints)
            for block, symbol in zip(_BLOCKS, (angle, sine, cosine), strict=True):
                yield Load(symbol, self._row(block, len(changes)))
            yield Assign(change, statement.angle - angle)
            yield Turn(statement.sin, statement.cos, sine, cosine, change)
            changes.append(change)
