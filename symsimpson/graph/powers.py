"""Powers of one base as products of one inverse or root of it."""

from __future__ import annotations

from fractions import Fraction

from symsimpson.graph.nodes import Exact, exact
from symsimpson.graph.shared_lines import Item, Program, add_factor

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
