"""Numbers and constants put where they cost least."""

from __future__ import annotations

from typing import Any

from symsimpson.graph.nodes import UNIT, Exact, exact, magnitude
from symsimpson.graph.shared_lines import Line, Program


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
