"""Straight-line code: values as a list of lines, with few powers and few coefficients."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from symsimpson.graph.nodes import UNIT, Exact, Graph, Value, arguments, exact, magnitude, scale

#: A pair (factor, exponent) of a product, or (coefficient, term) of a sum.
Item = tuple[Any, Any]


@dataclass
class Line:
    """A line of straight-line code. ``kind`` and ``parts`` are as in a node of a graph.

    ``level`` tells when the line is known; level 0 depends on parameters only.
    """

    kind: str
    parts: list[Any]
    level: int


@dataclass
class StraightLineCode:
    """Straight-line code: lines by number, and outputs, which are values of lines."""

    lines: dict[int, Line]  #: All lines that outputs need, and possibly other lines.
    outputs: dict[Hashable, Value]
    known: dict[tuple[str, tuple[Any, ...]], int] = field(default_factory=dict)

    @classmethod
    def of(
        cls, graph: Graph, outputs: Mapping[Any, Value], level: Callable[[int], int]
    ) -> StraightLineCode:
        """Return the code for values of a graph. ``level`` gives the level of a node."""
        lines = {}
        for n in graph.descendants(value[1] for value in outputs.values()):
            node = graph.nodes[n]
            lines[n] = Line(node.kind, list(node.parts), level(n))
        program = cls(lines, dict(outputs))
        program.known = {(line.kind, tuple(line.parts)): n for n, line in lines.items()}
        return program

    def line(self, kind: str, parts: Sequence[Any], level: int) -> int:
        """Return the number of the line with these parts; add the line if necessary."""
        key = (kind, tuple(parts))
        number = self.known.get(key)
        if number is None or (self.lines[number].kind, tuple(self.lines[number].parts)) != key:
            number = self.known[key] = max(self.lines, default=0) + 1
            self.lines[number] = Line(kind, list(parts), level)
        return number

    def level(self, numbers: Sequence[int]) -> int:
        """Return the largest level of some lines."""
        return max((self.lines[n].level for n in numbers), default=0)

    def arguments(self, n: int) -> list[int]:
        """List the lines that a line uses."""
        return arguments(self.lines[n].kind, self.lines[n].parts)

    def order(self, values: Iterable[Value] | None = None) -> list[int]:
        """List the lines for some values (by default all outputs), each after its arguments."""
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
        """Replace lines that equal another line, or a multiple of another line."""
        done: dict[int, Value] = {}
        for n in self.order():
            line = self.lines[n]
            if line.kind == "sum":
                line.parts = [scale(c, done[m]) for c, m in line.parts]
            elif line.kind == "function":
                line.parts = [line.parts[0], *(scale(c, done[m]) for c, m in line.parts[1:])]
            elif line.kind == "product":
                line.parts = [(done[m][1] if done[m][0] == 1 else m, e) for m, e in line.parts]
            done[n] = (1, n)
            if len(line.parts) == 1 and line.kind in ("sum", "product"):
                ((a, b),) = line.parts
                if line.kind == "sum":
                    done[n] = (a, b)
                elif b == 1:
                    done[n] = (1, a)
        self.outputs = {key: scale(c, done[n]) for key, (c, n) in self.outputs.items()}

    def users(self) -> dict[int, int]:
        """Count the uses of each line, in other lines and as an output."""
        count: dict[int, int] = {}
        for n in self.order():
            for m in self.arguments(n):
                count[m] = count.get(m, 0) + 1
        for _, n in self.outputs.values():
            count[n] = count.get(n, 0) + 1
        return count

    def operations(self, values: Sequence[Value] | None = None) -> int:
        """Count the operations above level 0, for some values (by default all outputs).

        The sine and the cosine of an angle count as one operation.
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
        """Count the coefficients other than 1 and -1."""
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
    """Add a factor to the parts of a product, and combine two powers of a line."""
    power = next((f for base, f in parts if base == m), None)
    if power is not None:
        parts.remove((m, power))
        e = exact(e + power)
    parts.append((m, e))


#: Up to this number, quotients are cheaper than an inverse with products.
FEW_QUOTIENTS = 3


def write_powers(program: StraightLineCode) -> None:
    """Replace the powers of each base by products of one inverse or root of the base."""
    wanted: dict[int, dict[Exact, int]] = {}
    order = program.order()
    for n in order:
        line = program.lines[n]
        if line.kind == "product" and line.level:
            for m, e in line.parts:
                if program.lines[m].level:
                    uses = wanted.setdefault(m, {})
                    uses[e] = uses.get(e, 0) + 1
    written = {m: _Powers(program, m, uses) for m, uses in wanted.items()}
    for n in order:
        line = program.lines[n]
        if line.kind == "product" and line.level:
            parts: list[Item] = []
            for m, e in line.parts:
                for item in written[m](e) if m in written else [(m, e)]:
                    add_factor(parts, *item)
            if parts != [(n, 1)]:  # otherwise the line is this inverse, root or power itself
                line.parts = parts
    program.resolve()


class _Powers:
    """The powers of one base, as products of a unit: the base, an inverse, or a root of it."""

    def __init__(self, program: StraightLineCode, base: int, uses: dict[Exact, int]) -> None:
        self._program, self._base = program, base
        level = program.lines[base].level
        self._level = level
        self._unit, self._number = Fraction(1), base
        self._plain: set[Exact] = set()
        roots = [e for e in uses if e.denominator != 1]
        index = max((e.denominator for e in roots), default=1)
        if any(index % e.denominator for e in roots):
            self._plain = set(uses)  # square and cube roots have no common unit
            return
        below = [e for e in uses if e < 0]
        if roots:
            self._unit = Fraction(-1 if below else 1, index)
        elif sum(uses[e] for e in below) > FEW_QUOTIENTS:
            self._unit = Fraction(-1)
        if self._unit != 1:
            if len(uses) == 1 and list(uses) == [self._unit] and uses[self._unit] == 1:
                self._plain = set(uses)
                return
            self._number = program.line("product", [(base, exact(self._unit))], level)
        self._chain = {1: self._number}
        self._of_base = {1: base}
        needed = {abs(self._steps(e)) for e in uses if e not in self._plain}
        for k in sorted(k for k in needed if k):
            self._in_chain(self._chain, k)

    def _steps(self, e: Exact) -> int:
        """Return the exponent of the unit in a power; 0 if the base itself is better."""
        if self._unit < 0 < e or (self._unit > 0 and e.denominator == 1 and self._unit != 1):
            return 0
        return int(e / self._unit)

    def __call__(self, e: Exact) -> list[Item]:
        """Return the factors of a power."""
        if e in self._plain:
            return [(self._base, e)]
        steps = self._steps(e)
        if steps:
            return [(self._in_chain(self._chain, abs(steps)), 1 if steps > 0 else -1)]
        if e.denominator == 1:
            return [(self._whole(int(e)), 1)]
        if self._unit < 0 < e:  # sqrt(x) = x/sqrt(x)
            whole = -int(-e // 1)
            rest = int((e - whole) / self._unit)
            return [(self._whole(whole), 1), (self._in_chain(self._chain, rest), 1)]
        return [(self._base, e)]

    def _whole(self, k: int) -> int:
        """Return a line with a whole power of the base."""
        return self._in_chain(self._chain if self._unit == 1 else self._of_base, k)

    def _in_chain(self, chain: dict[int, int], k: int) -> int:
        """Return the line of a power, as a product of two known powers where possible."""
        if k not in chain:
            have = sorted(chain, reverse=True)
            pair = next(((j, k - j) for j in have if k - j in chain), None)
            if pair is None:
                pair = (k - k // 2, k // 2)
                self._in_chain(chain, pair[1])
            a, b = sorted(self._in_chain(chain, j) for j in pair)
            parts = [(a, 2)] if a == b else [(a, 1), (b, 1)]
            chain[k] = self._program.line("product", parts, self._level)
        return chain[k]


class CoefficientFolding:
    """A transformation that removes multiplications by numbers.

    If all uses of a product have the same coefficient, the constant factor of the product absorbs
    it. A sum absorbs it if its terms exist with that coefficient. Other multiples with several uses
    get a line.
    """

    def __init__(self, program: StraightLineCode) -> None:
        self._program = program
        self._uses: dict[int, dict[Exact, int]] = {}
        self._multiples: dict[tuple[Exact, int], int] = {}

    def run(self) -> None:
        """Transform the program in place."""
        program, order = self._program, self._program.order()
        for n in order:
            line = program.lines[n]
            for c, m in _multiplied(line):
                self._count(c, m, 1)
            for m, _ in line.parts if line.kind == "product" else ():
                self._count(0, m, 1)  # a factor has no coefficient
        for c, m in program.outputs.values():
            self._count(c, m, 1)
        for n in reversed(order):  # uses before definitions, because a sum changes its terms' uses
            self._fold_into_sum(n)
        for m in order:
            if program.lines[m].level:
                for k, count in self._uses.get(m, {}).items():
                    self._add_multiple(k, m, count)
        for n in order:
            line = program.lines[n]
            if line.level and line.kind in ("sum", "function"):
                values = [self._value(c, m) for c, m in _multiplied(line)]
                line.parts = values if line.kind == "sum" else [line.parts[0], *values]
        program.outputs = {key: self._value(*value) for key, value in program.outputs.items()}

    def _count(self, c: Exact, m: int, more: int) -> None:
        counts = self._uses.setdefault(m, {})
        counts[magnitude(c)] = counts.get(magnitude(c), 0) + more

    def _fold_into_sum(self, n: int) -> None:
        """Multiply the terms of a sum by the coefficient that all its uses share."""
        line, counts = self._program.lines[n], self._uses.get(n, {})
        if line.kind != "sum" or not line.level or len(counts) != 1 or len(line.parts) < 2:
            return
        (k,) = counts
        if k in (0, 1):
            return
        missing = sum(
            (scaled := magnitude(exact(k * c))) != 1 and scaled not in self._uses[m]
            for c, m in line.parts
        )
        if missing > sum(magnitude(c) != 1 for c, _ in line.parts):
            return
        for c, m in line.parts:
            self._count(c, m, -1)
            self._count(exact(k * c), m, 1)
        line.parts = [(exact(k * c), m) for c, m in line.parts]
        self._multiples[k, n] = n
        self._uses[n] = {}

    def _add_multiple(self, k: Exact, m: int, count: int) -> None:
        """Add a line for the multiple k of a line, if this saves operations."""
        program, line = self._program, self._program.lines[m]
        if k in (0, 1) or not count:
            return
        only_multiple = sum(map(bool, self._uses[m].values())) == 1
        constant = (
            next((item for item in line.parts if not program.lines[item[0]].level), None)
            if line.kind == "product"
            else None
        )
        if constant is not None and only_multiple:
            number = constant[0] if constant[1] == 1 else program.line("product", [constant], 0)
            scaled = program.line("sum", [(k, number)], 0)
            parts = [(scaled, 1) if item == constant else item for item in line.parts]
            self._multiples[k, m] = program.line("product", parts, line.level)
        elif count > 1:
            program.lines.setdefault(UNIT, Line("unit", [], 0))
            number = program.line("sum", [(k, UNIT)], 0)
            parts = [*line.parts] if only_multiple and line.kind == "product" else [(m, 1)]
            self._multiples[k, m] = program.line("product", [(number, 1), *parts], line.level)

    def _value(self, c: Exact, m: int) -> Any:
        line = self._multiples.get((magnitude(c), m))
        return (c, m) if line is None else (1 if c > 0 else -1, line)


def _multiplied(line: Line) -> list[Any]:
    """List the values in a line that may have a coefficient."""
    return {"sum": line.parts, "function": line.parts[1:]}.get(line.kind, [])
