"""Templates of jets: their programs become definitions at every node."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count

from symsimpson.discrete.jet import Jet, Key
from symsimpson.graph.lines import Line, StraightLineCode
from symsimpson.graph.nodes import UNIT, Value
from symsimpson.lower.expression import Expression
from symsimpson.lower.levels import Definitions, Level

#: What a point has in place of plain symbols, by the first letter of these.
_AT_POINT = {"q": "q", "v": "v", "u": "u", "l": "multipliers", "s": "step", "w": "weights"}


@dataclass(frozen=True)
class Point:
    """A point at which a jet is evaluated: its arguments, and a suffix for names of its values.

    ``v`` is None if the values depend on t, u and q only, and ``t`` is None for an autonomous
    system. ``u`` are the inputs, ``multipliers`` belong to constraints, and ``weights`` to second
    derivatives. ``step`` has h, the place of the point in the step, and 1 if v scales with 1/h.
    """

    suffix: str
    q: tuple[Expression, ...]
    v: tuple[Expression, ...] | None = None
    t: Expression | None = None
    u: tuple[Expression, ...] = ()
    multipliers: tuple[Expression, ...] = ()
    weights: tuple[Expression, ...] = ()
    step: tuple[Expression, ...] = ()


class JetTemplate:
    """Writes the outputs of a jet at any point; outputs share common lines.

    The lines that an output needs become definitions of the ``graph``, with names of their own at
    each point. A line that is used once is substituted. ``names`` has the names of coordinates in
    names of entries. ``parameters`` maps names of plain symbols to expressions.
    """

    def __init__(
        self,
        jet: Jet,
        graph: Definitions,
        names: Sequence[str],
        parameters: Mapping[str, Expression],
        momenta: Sequence[Expression],
    ) -> None:
        self._jet, self._graph, self._names = jet, graph, names
        self._program: StraightLineCode = jet.program
        self._parameters = parameters
        self._momenta = momenta
        self._expressions: dict[tuple[str, int], Expression] = {}
        self._points: dict[str, Point] = {}
        self._users = self._program.users()
        self._angles: dict[Value, int] = {}
        for n in self._program.order():
            line = self._program.lines[n]
            if _is_angle(line):
                if line.parts[1] in self._angles:
                    self._users[line.parts[1][1]] -= 1  # sine and cosine are made at once
                self._angles.setdefault(line.parts[1], len(self._angles))

    def at(self, point: Point) -> Point:
        """Return a point with a suffix that no other point has.

        Points without velocities are the same as those with any.
        """
        for number in count():
            suffix = f"{point.suffix}_{number}" if number else point.suffix
            other = self._points.get(suffix, point)
            if replace(other, v=point.v, suffix=point.suffix) != point:
                continue
            if other.v is None or point.v is None or other.v == point.v:
                break
        self._points[suffix] = replace(point, suffix=suffix, v=point.v or other.v)
        return self._points[suffix]

    @property
    def forced_coordinates(self) -> tuple[int, ...]:
        """The coordinates on which a force acts."""
        return self._jet.forced

    def places(self, what: str) -> list[tuple[int, int]]:
        """List the indices of entries of a matrix that do not vanish."""
        keys = [key for key in self._program.outputs if key[0] == what]  # type: ignore[index]
        return sorted((key[1], key[2]) for key in keys)  # type: ignore[index]

    def vanishes(self, what: str, *index: int | str) -> bool:
        """Return whether an entry is zero at all points."""
        return not self._jet[what, *index][0]

    def entry(self, point: Point, section: str, what: str, *index: int | str) -> Expression:
        """Return one entry of the jet at a point, and add the definitions that it needs."""
        key: Key = (what, *index)
        value = self._value(self._jet[key], point, section)
        suffix = (point.suffix,) if self._graph.level(value) > Level.RUN else ()
        indices = [self._spell_index(i) for i in index]
        hint = "_".join((what.replace("_", ""), *indices, *suffix))
        return self._graph.define(re.sub(r"[^A-Za-z0-9_]", "_", hint), value, section)

    def _spell_index(self, i: int | str) -> str:
        """Return an index for the name of an entry: the name of a coordinate, or a number."""
        return str(self._names[i] if isinstance(i, int) and i < len(self._names) else i)

    def _value(self, value: Value, point: Point, section: str) -> Expression:
        """Write a multiple of a line."""
        coefficient, n = value
        return coefficient * self._line(n, point, section)

    def _line(self, n: int, point: Point, section: str) -> Expression:
        """Return the expression of a line at a point."""
        if n == UNIT:
            return self._graph.of(1)
        line = self._program.lines[n]
        if line.kind == "symbol":
            return self._symbol(line.parts[0], point)
        key = (point.suffix, n)
        if key in self._expressions:
            return self._expressions[key]
        if _is_angle(line):
            return self._angle(n, line, point, section)
        written = self._write_line(line, point, section)
        if self._users[n] > 1 and written.node != UNIT:
            return self._name_line(n, written, point, section)
        return written

    def _write_line(self, line: Line, point: Point, section: str) -> Expression:
        """Write a line as an expression of other lines."""
        graph, parts = self._graph, line.parts
        match line.kind:
            case "sum":
                return graph.total(self._value(value, point, section) for value in parts)
            case "product":
                return graph.product(self._line(m, point, section) ** e for m, e in parts)
            case "constant":
                return Expression(graph, graph.constant(*parts))
        name, *values = parts
        return graph.apply(name, *(self._value(value, point, section) for value in values))

    def _name_line(self, n: int, written: Expression, point: Point, section: str) -> Expression:
        graph = self._graph
        hint = "c" if graph.level(written) <= Level.RUN else f"x_{point.suffix}"
        self._expressions[point.suffix, n] = graph.define(hint, written, section)
        return self._expressions[point.suffix, n]

    def _symbol(self, name: str, point: Point) -> Expression:
        if name in self._parameters:
            return self._parameters[name]
        kind, place = name[0], int(name[2:])
        if kind == "p":
            return self._momenta[place]
        if kind == "t":
            assert point.t is not None
            return point.t
        values: tuple[Expression, ...] | None = getattr(point, _AT_POINT[kind])
        assert values is not None
        return values[place]

    def _angle(self, n: int, line: Line, point: Point, section: str) -> Expression:
        """Return the sine or the cosine of an angle; both are defined at once."""
        angle = self._value(line.parts[1], point, section)
        if self._graph.level(angle) == Level.CONSTANT:
            return self._graph.define("C", self._graph.apply(line.parts[0], angle), section)
        number = self._angles[line.parts[1]]
        hint = angle.name if angle.is_symbol else f"angle{number}_{point.suffix}"
        sine, cosine = self._graph.define_sincos(hint, angle, section)
        self._expressions[point.suffix, n] = sine if line.parts[0] == "sin" else cosine
        return self._expressions[point.suffix, n]


def _is_angle(line: Line) -> bool:
    return line.kind == "function" and line.parts[0] in ("sin", "cos")
