"""Values as lines of a program: what is shared has a line, powers are products, numbers are few."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from symsimpson.graph.nodes import UNIT, Exact, Graph, Value, arguments, exact, magnitude, scaled

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


#: So many quotients are cheaper than an inverse and products with it.
FEW_QUOTIENTS = 3


def write_powers(program: Program) -> None:
    """Write powers as products of one inverse or root of their base."""
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
            if parts != [(n, 1)]:  # the line is that unit or power itself
                line.parts = parts
    program.resolve()


class _Powers:
    """Writes the powers of one base that a program asks for."""

    def __init__(self, program: Program, base: int, uses: dict[Exact, int]) -> None:
        self._program, self._base = program, base
        level = program.lines[base].level
        self._level = level
        self._unit, self._number = Fraction(1), base
        self._plain: set[Exact] = set()
        roots = [e for e in uses if e.denominator != 1]
        index = max((e.denominator for e in roots), default=1)
        if any(index % e.denominator for e in roots):
            self._plain = set(uses)  # roots of different kinds
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
        """Return how often the unit stands in a power; 0 if the base itself serves better."""
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
        """Return a power: one product of two that are there, if there are."""
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


class Fold:
    """Puts numbers where they cost least.

    The constant of a product takes the number that all who use the product multiply by; so does
    a sum, if its terms are there with that number; and a multiple that is used again gets a line.
    """

    def __init__(self, program: Program) -> None:
        self._program = program
        self._uses: dict[int, dict[Exact, int]] = {}
        self._multiples: dict[tuple[Exact, int], int] = {}

    def run(self) -> None:
        """Change the program."""
        program, order = self._program, self._program.order()
        for n in order:
            line = program.lines[n]
            for c, m in _multiplied(line):
                self._count(c, m, 1)
            for m, _ in line.parts if line.kind == "product" else ():
                self._count(0, m, 1)  # as a factor, which takes no number
        for c, m in program.outputs.values():
            self._count(c, m, 1)
        for n in reversed(order):  # users first: they change what is asked of the others
            self._into_sum(n)
        for m in order:
            if program.lines[m].level:
                for k, count in self._uses.get(m, {}).items():
                    self._multiple(k, m, count)
        for n in order:
            line = program.lines[n]
            if line.level and line.kind in ("sum", "function"):
                values = [self._value(c, m) for c, m in _multiplied(line)]
                line.parts = values if line.kind == "sum" else [line.parts[0], *values]
        program.outputs = {key: self._value(*value) for key, value in program.outputs.items()}

    def _count(self, c: Exact, m: int, more: int) -> None:
        counts = self._uses.setdefault(m, {})
        counts[magnitude(c)] = counts.get(magnitude(c), 0) + more

    def _into_sum(self, n: int) -> None:
        """Multiply the terms of a sum, if all who use it multiply it by the same number."""
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

    def _multiple(self, k: Exact, m: int, count: int) -> None:
        """Make a line for a multiple where that is worth it."""
        program, line = self._program, self._program.lines[m]
        if k in (0, 1) or not count:
            return
        alone = sum(map(bool, self._uses[m].values())) == 1
        constant = (
            next((item for item in line.parts if not program.lines[item[0]].level), None)
            if line.kind == "product"
            else None
        )
        if constant is not None and alone:
            number = constant[0] if constant[1] == 1 else program.line("product", [constant], 0)
            scaled = program.line("sum", [(k, number)], 0)
            parts = [(scaled, 1) if item == constant else item for item in line.parts]
            self._multiples[k, m] = program.line("product", parts, line.level)
        elif count > 1:
            program.lines.setdefault(UNIT, Line("unit", [], 0))
            number = program.line("sum", [(k, UNIT)], 0)
            parts = [*line.parts] if alone and line.kind == "product" else [(m, 1)]
            self._multiples[k, m] = program.line("product", [(number, 1), *parts], line.level)

    def _value(self, c: Exact, m: int) -> Any:
        line = self._multiples.get((magnitude(c), m))
        return (c, m) if line is None else (1 if c > 0 else -1, line)


def _multiplied(line: Line) -> list[Any]:
    """List the values of which a line takes multiples."""
    return {"sum": line.parts, "function": line.parts[1:]}.get(line.kind, [])
