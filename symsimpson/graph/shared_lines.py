"""Values as lines of a program, in which what is shared has a line of its own.

In a graph, products of products are one product; here they need not be, so that parts which many
products have in common can be named.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from symsimpson.graph.nodes import Exact, Graph, Value, arguments, exact, scaled

#: A factor and its exponent, or a coefficient and a term.
Item = tuple[Any, Any]


@dataclass
class Line:
    """A line: kind and parts are those of a node, and ``level`` tells when it is known."""

    kind: str
    parts: list[Any]
    level: int


@dataclass
class Program:
    """Lines by number, and the values that are asked for."""

    lines: dict[int, Line]  #: Lines that outputs need, and possibly others.
    outputs: dict[Hashable, Value]
    known: dict[tuple[str, tuple[Any, ...]], int] = field(default_factory=dict)

    @classmethod
    def of(cls, graph: Graph, outputs: Mapping[Any, Value], level: Callable[[int], int]) -> Program:
        """Write down what outputs are made of."""
        lines = {}
        for n in graph.reached(value[1] for value in outputs.values()):
            node = graph.nodes[n]
            lines[n] = Line(node.kind, list(node.parts), level(n))
        program = cls(lines, dict(outputs))
        program.known = {(line.kind, tuple(line.parts)): n for n, line in lines.items()}
        return program

    def line(self, kind: str, parts: Sequence[Any], level: int) -> int:
        """Return the number of a line, a new one if there is none with these parts."""
        key = (kind, tuple(parts))
        number = self.known.get(key)
        if number is None or (self.lines[number].kind, tuple(self.lines[number].parts)) != key:
            number = self.known[key] = max(self.lines, default=0) + 1
            self.lines[number] = Line(kind, list(parts), level)
        return number

    def level(self, numbers: Sequence[int]) -> int:
        """Return when all lines of some numbers are known."""
        return max((self.lines[n].level for n in numbers), default=0)

    def arguments(self, n: int) -> list[int]:
        """List the lines that a line is made of."""
        return arguments(self.lines[n].kind, self.lines[n].parts)

    def order(self, values: Iterable[Value] | None = None) -> list[int]:
        """List the lines that outputs need, each behind those that it is made of."""
        placed: dict[int, None] = {}
        for _, root in self.outputs.values() if values is None else values:
            work = [root]
            while work:
                n = work[-1]
                missing = (
                    [m for m in self.arguments(n) if m not in placed] if n not in placed else []
                )
                if missing:
                    work += reversed(missing)
                else:
                    placed[work.pop()] = None
        return list(placed)

    def resolve(self) -> None:
        """Leave out lines that are no more than another one, or a multiple of it."""
        done: dict[int, Value] = {}
        for n in self.order():
            line = self.lines[n]
            if line.kind == "sum":
                line.parts = [scaled(c, done[m]) for c, m in line.parts]
            elif line.kind == "function":
                line.parts = [line.parts[0], *(scaled(c, done[m]) for c, m in line.parts[1:])]
            elif line.kind == "product":
                line.parts = [(done[m][1] if done[m][0] == 1 else m, e) for m, e in line.parts]
            done[n] = (1, n)
            if len(line.parts) == 1 and line.kind in ("sum", "product"):
                ((a, b),) = line.parts
                if line.kind == "sum":
                    done[n] = (a, b)
                elif b == 1:
                    done[n] = (1, a)
        self.outputs = {key: scaled(c, done[n]) for key, (c, n) in self.outputs.items()}

    def users(self) -> dict[int, int]:
        """Count how often lines are used in others and asked for."""
        count: dict[int, int] = {}
        for n in self.order():
            for m in self.arguments(n):
                count[m] = count.get(m, 0) + 1
        for _, n in self.outputs.values():
            count[n] = count.get(n, 0) + 1
        return count

    def operations(self, values: Sequence[Value] | None = None) -> int:
        """Count the operations on what is not known before, for all outputs or for some values.

        Sine and cosine of an angle are one.
        """
        values = list(self.outputs.values()) if values is None else values
        total = 0
        angles: set[Any] = set()
        for n in self.order(values):
            line = self.lines[n]
            if not line.level:
                continue
            if line.kind == "function" and line.parts[0] in ("sin", "cos"):
                angles.add(line.parts[1])
                total += self._multiples(line.parts[1:])
            elif line.kind == "function":
                total += 1 + self._multiples(line.parts[1:])
            elif line.kind == "sum":
                early = [m for _, m in line.parts if not self.lines[m].level]
                late = [value for value in line.parts if self.lines[value[1]].level]
                total += len(late) - 1 + bool(early) + self._multiples(late)
            elif line.kind == "product":
                total += self._product(line)
        return total + len(angles) + self._multiples(values)

    def _multiples(self, values: Sequence[Value]) -> int:
        """Count products with numbers other than one and minus one."""
        return sum(abs(c) != 1 and self.lines[m].level > 0 for c, m in values)

    def _product(self, line: Line) -> int:
        total = 0
        late: list[tuple[int, Exact]] = [(m, e) for m, e in line.parts if self.lines[m].level]
        for _, e in late:
            steps = abs(e.numerator)
            total += (e.denominator != 1) + steps.bit_length() + steps.bit_count() - 2
        early = len(late) < len(line.parts)
        above = any(e > 0 for _, e in late) or early
        return total + len(late) - 1 + early + (not above)


def add_factor(parts: list[Item], m: int, e: Exact) -> None:
    """Add a factor to a list; two powers of one line are one."""
    held = next((f for base, f in parts if base == m), None)
    if held is not None:
        parts.remove((m, held))
        e = exact(e + held)
    parts.append((m, e))
