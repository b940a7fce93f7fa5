"""The jet of L as definitions: common subexpressions found once, instantiated at every node."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import sympy as sp

from symsimpson.codegen.levels import Graph, Level
from symsimpson.discrete.jet import Jet
from symsimpson.mechanics.plain import Plain

__all__ = ["JetTemplate", "Point"]

_TRIGONOMETRIC = (sp.tan, sp.cot, sp.sec, sp.csc)


@dataclass(frozen=True)
class Point:
    """Where a jet is evaluated: names of q and v there, and a suffix for everything made of them.

    ``v`` is None where only functions of q are asked for.
    """

    suffix: str
    q: tuple[sp.Symbol, ...]
    v: tuple[sp.Expr, ...] | None = None


@dataclass(frozen=True)
class _Step:
    """One definition of the template; ``cosine`` is set for a sine and cosine of an angle."""

    symbol: sp.Symbol
    value: sp.Expr
    wish: str = ""
    cosine: sp.Symbol | None = None


class JetTemplate:
    """Writes the entries of a jet at any point, sharing what they have in common.

    The expressions are searched for common subexpressions once; at a point the definitions that
    an entry needs, and no others, are made with the point's own names. ``more`` entries come with
    those of the jet, and in all of them ``rewrite`` is put in place first.
    """

    def __init__(
        self,
        jet: Jet | None,
        plain: Plain,
        graph: Graph,
        names: Sequence[str],
        parameters: Mapping[sp.Symbol, sp.Symbol],
        momenta: Sequence[sp.Symbol],
        more: Mapping[tuple[str, ...], sp.Expr] = MappingProxyType({}),
        rewrite: Mapping[sp.Expr, sp.Expr] = MappingProxyType({}),
    ) -> None:
        self._graph = graph
        self._plain = plain
        self._made: dict[tuple[str, sp.Symbol], sp.Expr] = {}
        self._parameters = parameters
        self._momenta = dict(zip(plain.p, momenta, strict=True))
        entries: dict[tuple[str, ...], sp.Expr] = {}
        if jet is not None:
            entries = self._entries(jet, plain, names)
        for name, value in plain.invariants.items():
            entries["invariant", name] = value
        entries |= more
        self._steps, outputs = _search(
            {key: value.xreplace(rewrite) for key, value in entries.items()} if rewrite else entries
        )
        self._outputs = outputs
        self._names = names

    @staticmethod
    def _entries(jet: Jet, plain: Plain, names: Sequence[str]) -> dict[tuple[str, ...], sp.Expr]:
        entries: dict[tuple[str, ...], sp.Expr] = {}
        for i, a in enumerate(names):
            entries["L_q", a] = jet.L_q[i]
            entries["a", a] = plain.gyroscopic[i]
            for j, b in enumerate(names):
                entries["L_qv", a, b] = jet.L_qv[i, j]
                if j <= i:
                    entries["L_qq", a, b] = jet.L_qq[i, j]
                    entries["M", a, b] = jet.L_vv[i, j]
        entries["V",] = plain.potential
        return entries

    def entry(self, point: Point, section: str, what: str, *index: int) -> sp.Expr:
        """Give one entry of the jet at a point, making the definitions it needs."""
        what = "M" if what == "L_vv" else what
        names = tuple(self._names[i] for i in index)
        if what in ("M", "L_qq") and index[0] < index[1]:
            names = names[::-1]
        return self.output(point, section, (what, *names))

    def momentum(
        self, point: Point, section: str, i: int, group: Iterable[int] | None = None
    ) -> sp.Expr:
        """Give L_v = M v + a, component i; ``group`` holds all that M couples it to."""
        assert point.v is not None
        others = range(len(point.v)) if group is None else group
        terms = [self.entry(point, section, "M", i, j) * point.v[j] for j in sorted(others)]
        return sp.Add(self.entry(point, section, "a", i), *terms)

    def output(self, point: Point, section: str, key: tuple[str, ...]) -> sp.Expr:
        """Give a named output at a point."""
        value = self._instantiate(self._outputs[key], point, section)
        suffix = (point.suffix,) if self._graph.level(value) > Level.RUN else ()
        wish = "_".join((key[0].replace("_", ""), *key[1:], *suffix))
        return self._graph.define(wish.replace(" ", "_"), value, section)

    def _instantiate(self, expression: sp.Expr, point: Point, section: str) -> sp.Expr:
        replaced: dict[sp.Basic, sp.Expr] = {}
        for symbol in sorted(expression.free_symbols, key=str):
            replaced[symbol] = self._value(symbol, point, section)
        return expression.xreplace(replaced)

    def _wish(self, value: sp.Expr, point: Point) -> str:
        return "c" if self._graph.level(value) <= Level.RUN else f"x_{point.suffix}"

    def _value(self, symbol: sp.Symbol, point: Point, section: str) -> sp.Expr:
        if symbol in self._parameters:
            return self._parameters[symbol]
        if symbol in self._plain.q:
            return point.q[self._plain.q.index(symbol)]
        if symbol in self._plain.v:
            assert point.v is not None
            return point.v[self._plain.v.index(symbol)]
        if symbol in self._momenta:
            return self._momenta[symbol]
        key = (point.suffix, symbol)
        if key not in self._made:
            step = self._steps[symbol]
            value = self._instantiate(step.value, point, section)
            if step.cosine is None:
                wish = f"{step.wish}_{point.suffix}" if step.wish else self._wish(value, point)
                self._made[key] = self._graph.define(wish, value, section)
            else:
                wish = value.name if value.is_Symbol else f"{step.wish}_{point.suffix}"
                sine, cosine = self._graph.define_sincos(wish, value, section)
                self._made[point.suffix, step.symbol] = sine
                self._made[point.suffix, step.cosine] = cosine
        return self._made[key]


def _search(
    entries: Mapping[tuple[str, ...], sp.Expr],
) -> tuple[dict[sp.Symbol, _Step], dict[tuple[str, ...], sp.Expr]]:
    """Pull out sines and cosines, then common subexpressions."""
    steps: dict[sp.Symbol, _Step] = {}
    pairs: dict[sp.Expr, tuple[sp.Symbol, sp.Symbol]] = {}
    expressions = [_pull_trigonometry(value, steps, pairs) for value in entries.values()]
    _add_angles(steps, pairs, expressions)
    replacements, reduced = sp.cse(expressions, symbols=_temporaries(), order="none")
    for symbol, value in replacements:
        steps[symbol] = _Step(symbol, value)
    return steps, dict(zip(entries, reduced, strict=True))


def _add_angles(
    steps: dict[sp.Symbol, _Step],
    pairs: Mapping[sp.Expr, tuple[sp.Symbol, sp.Symbol]],
    expressions: Iterable[sp.Expr],
) -> None:
    """Make sine and cosine of a sum from those of its two terms, where both are there already.

    Four products in place of some thirty operations. The error is that of numbers of size one, as
    if the angle had been rounded; a sine that something is divided by needs its own digits.
    """
    delicate: set[sp.Basic] = set()
    for expression in expressions:
        for power in expression.atoms(sp.Pow):
            if not (power.exp.is_Integer and power.exp > 0):
                delicate |= power.free_symbols
    for angle, (sine, cosine) in pairs.items():
        if not angle.is_Add or len(angle.args) != 2 or {sine, cosine} & delicate:
            continue
        found = []
        for term in angle.args:
            known, sign = (term, 1) if term in pairs else (-term, -1)
            if known in pairs:
                found.append((sign * pairs[known][0], pairs[known][1]))
        if len(found) == 2:
            (s_a, c_a), (s_b, c_b) = found
            name = steps[sine].wish
            steps[sine] = _Step(sine, s_a * c_b + c_a * s_b, f"sin_{name}")
            steps[cosine] = _Step(cosine, c_a * c_b - s_a * s_b, f"cos_{name}")


def _temporaries() -> Iterator[sp.Symbol]:
    return sp.numbered_symbols("temporary_", real=True)


def _pull_trigonometry(
    expression: sp.Expr,
    steps: dict[sp.Symbol, _Step],
    pairs: dict[sp.Expr, tuple[sp.Symbol, sp.Symbol]],
) -> sp.Expr:
    """Replace sin(x) and cos(x) by symbols of one pair for each angle x, innermost first."""
    if not expression.args:
        return expression
    arguments = [_pull_trigonometry(a, steps, pairs) for a in expression.args]
    if isinstance(expression, (sp.sin, sp.cos, *_TRIGONOMETRIC)):
        angle, sign = arguments[0], 1
        if angle.could_extract_minus_sign():
            angle, sign = -angle, -1
        if angle not in pairs:
            number = len(pairs)
            sine, cosine = sp.symbols(f"sine_{number} cosine_{number}", real=True)
            pairs[angle] = (sine, cosine)
            for symbol in (sine, cosine):
                steps[symbol] = _Step(sine, angle, f"angle{number}", cosine)
        sine, cosine = pairs[angle]
        return {
            sp.sin: sign * sine, sp.cos: cosine, sp.tan: sign * sine / cosine,
            sp.cot: sign * cosine / sine, sp.sec: 1 / cosine, sp.csc: sign / sine,
        }[expression.func]  # fmt: skip
    return expression.func(*arguments)
