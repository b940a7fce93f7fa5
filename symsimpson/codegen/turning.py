"""Sines and cosines at nodes, turned from those of an earlier iteration by what angles change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Assign, Call, Load, Row, Section, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering

__all__ = ["Turning"]

_BLOCKS = ("STAGE_ANGLE", "STAGE_SINE", "STAGE_COSINE")


class Turning:
    """Rewrites statements of a node, and counts the pairs of sine and cosine that it finds there.

    ``row`` gives the row of a value of a node, from a block and the number of the value in it.
    """

    def __init__(self, low: Lowering, row: Callable[[str, int], Row]) -> None:
        self._low, self._row = low, row
        self.count = 0

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
            match statement:
                case Call("sincos", (Expression() as angle,), pair):
                    for block, value in zip(_BLOCKS, (angle, *pair), strict=True):
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
            match statement:
                case Call("sincos", (Expression() as angle,), pair):
                    yield from self._turn(angle, pair, changes)
                case _:
                    yield statement

    def _turn(
        self, angle: Expression, pair: tuple[Expression, ...], changes: list[Expression]
    ) -> Iterator[Statement]:
        """Turn the sine and the cosine of an angle from those that it had before."""
        hints = ("angle_before", "sine_before", "cosine_before", "turn")
        *before, change = (self._low.graph.fresh(hint, Level.ITERATION) for hint in hints)
        for block, symbol in zip(_BLOCKS, before, strict=True):
            yield Load(symbol, self._row(block, len(changes)))
        yield Assign(change, angle - before[0])
        yield Call("turned", (*before[1:], change), pair)
        changes.append(change)
