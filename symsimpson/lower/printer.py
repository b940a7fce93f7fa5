"""Expressions as Python text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

from symsimpson.graph.nodes import TINY, UNIT, Exact, Graph, Value, exact, magnitude
from symsimpson.graph.read import fit_to_double, is_float
from symsimpson.lower.expression import Expression, Expressions

#: Named numbers without a formula, and their values in double precision. Bindings of more digits
#: have their own values.
NAMED_CONSTANTS = {"EULER_GAMMA": 0.5772156649015329, "CATALAN": 0.915965594177219, "TINY": TINY}
_CONSTANT = {"pi": "pi", "EulerGamma": "EULER_GAMMA", "Catalan": "CATALAN", "Tiny": "TINY"}
#: Integers from here on are no exact doubles, and soon none that fit into 64 bits.
LARGE = 2**53
#: How strongly the parts of a text hold together.
SUM, PRODUCT, POWER, ATOM = range(4)
#: Operations that a root takes.
_ROOTS = {0: 0, Fraction(1, 2): 1, Fraction(1, 4): 2, Fraction(3, 4): 3}
#: A text and how strongly its parts hold together.
Text = tuple[str, int]


class Printer:
    """Writes expressions with operators and functions that every binding defines.

    ``used`` collects the functions in them, ``constants`` the named numbers. With ``exact`` set,
    integers in quotients become ``real(...)``, so that a constant has the precision of the binding.
    """

    def __init__(self, *, exact: bool = False) -> None:
        self.used: set[str] = set()
        self.constants: set[str] = set()
        self._exact = exact

    def text(self, expression: Expression) -> str:
        """Write an expression.

        Raises GenerationError if a number in it is larger than doubles can be.
        """
        return self._value(expression.graph, expression.coefficient, expression.node)[0]

    def _value(self, graph: Expressions, c: Exact, n: int) -> Text:
        kind, parts, _ = graph.nodes[n]
        if n == UNIT:
            return self._number(c)
        if kind == "sum" and c in (1, -1):
            return self._sum(graph, [(c * d, m) for d, m in parts])
        if kind == "product" or c != 1:
            return self._product(graph, c, parts if kind == "product" else [(n, 1)])
        return self._named(graph, n)

    def _sum(self, graph: Expressions, terms: Sequence[tuple[Exact, int]]) -> Text:
        """Write a sum.

        Products come last: the compiler fuses each with the terms before it.
        """
        terms = sorted(terms, key=lambda x: (not _is_simple(graph, *x), graph.known_at(x[1])))
        first = next((k for k, (c, n) in enumerate(terms) if c > 0 and _is_simple(graph, c, n)), 0)
        terms = [terms[first], *terms[:first], *terms[first + 1 :]]
        if len(terms) == 1:
            return self._value(graph, *terms[0])
        text = self._within(self._value(graph, *terms[0]), SUM)
        for c, n in terms[1:]:
            text += " - " if c < 0 else " + "
            text += self._within(self._value(graph, magnitude(c), n), PRODUCT)
        return text, SUM

    def _product(self, graph: Expressions, c: Exact, factors: Sequence[tuple[int, Exact]]) -> Text:
        c = fit_to_double(c)
        factors = sorted(factors, key=lambda factor: _sort_key(graph, factor[0]))
        above = [self._power(graph, n, e) for n, e in factors if e > 0]
        below = [self._power(graph, n, -e) for n, e in factors if e < 0]
        if is_float(c):
            if abs(c) != 1:
                above.insert(0, self._number(magnitude(c)))
        else:
            p, q = abs(c.numerator), c.denominator
            above = [self._number(p), *above] if p != 1 else above
            below = [self._number(q), *below] if q != 1 else below
        sign = "-" if c < 0 else ""
        if len(above) == 1 and not below:
            text, strength = above[0]
            return (f"-{self._within(above[0], PRODUCT)}", SUM) if sign else (text, strength)
        numerator = "*".join(self._within(x, PRODUCT) for x in above) or "1"
        text = f"{sign}{numerator}"
        if len(below) == 1:
            text += f"/{self._within(below[0], POWER)}"
        elif below:
            text += f"/({'*'.join(self._within(x, PRODUCT) for x in below)})"
        return text, SUM if sign else PRODUCT

    def _power(self, graph: Expressions, n: int, exponent: Exact) -> Text:
        """Write a positive power; roots become square roots where possible.

        Compilers vectorise square roots, but not powers.
        """
        base = self._value(graph, 1, n)
        if graph.nodes[n].kind == "sum" and len(graph.nodes[n].parts) == 1:
            ((c, m),) = graph.nodes[n].parts
            base = self._value(graph, c, m)
        if exponent == 1:
            return base
        whole, rest = divmod(exponent, 1)
        if rest and rest.denominator not in (2, 4):
            power = self._number(exact(Fraction(exponent)))[0]
            return f"{self._within(base, ATOM)}**({power})", POWER
        roots = []
        if rest:
            self.used.add("sqrt")
            plain = n == UNIT or not base[0].strip("0123456789")
            root = f"sqrt(real({base[0]}))" if plain else f"sqrt({base[0]})"
            roots = {2: [root], 1: [f"sqrt({root})"], 3: [root, f"sqrt({root})"]}[int(4 * rest)]
        factor = self._within(base, PRODUCT if whole == 1 else ATOM)
        factor = factor if whole == 1 else f"{factor}**{whole}"
        if not roots:
            return factor, POWER
        if not whole and len(roots) == 1:
            return roots[0], ATOM
        return "*".join([*([factor] if whole else []), *roots]), PRODUCT

    def _number(self, c: Exact) -> Text:
        """Write a number."""
        c = fit_to_double(c)
        p, q = c.numerator, c.denominator
        if is_float(c):
            return repr(float(c)), SUM if c < 0 else ATOM
        if q == 1:
            large = self._exact and abs(p) >= LARGE
            return f"real({p})" if large else str(p), SUM if c < 0 else ATOM
        return (f"real({p})/{q}" if self._exact else f"{p}/{q}"), SUM if c < 0 else PRODUCT

    def _named(self, graph: Expressions, n: int) -> Text:
        """Write a symbol, a constant or a function."""
        kind, parts, _ = graph.nodes[n]
        name = str(parts[0])
        if kind == "symbol":
            return name, ATOM
        if kind == "constant":
            name = _CONSTANT[name]
            (self.used if name == "pi" else self.constants).add(name)
            return name, ATOM
        arguments = [self._value(graph, *value) for value in parts[1:]]
        if name == "pow":
            base, exponent = arguments
            return f"{self._within(base, ATOM)}**{self._within(exponent, ATOM)}", POWER
        if name not in ("abs", "min"):
            self.used.add(name)
        if name == "exp" and parts[1] == (1, UNIT):
            return "exp(real(1))", ATOM
        return f"{name}({', '.join(text for text, _ in arguments)})", ATOM

    @staticmethod
    def _within(text: Text, least: int) -> str:
        """Put parentheses around a text of lower precedence."""
        return text[0] if text[1] >= least else f"({text[0]})"


def _is_simple(graph: Expressions, c: Exact, n: int) -> bool:
    """Return whether a term is not a product."""
    return n == UNIT or (c in (1, -1) and graph.nodes[n].kind != "product")


def _sort_key(graph: Expressions, n: int) -> tuple[bool, str, int]:
    """Return the sort key of a factor: symbols by name, then all others."""
    kind, parts, _ = graph.nodes[n]
    return kind != "symbol", str(parts[0]) if kind == "symbol" else "", n


def count_operations(expression: Expression) -> int:
    """Count additions, multiplications, divisions, roots and function calls."""
    graph, total = expression.graph, 0
    open_ = [expression.value]
    while open_:
        c, n = open_.pop()
        kind, parts, _ = graph.nodes[n]
        if kind == "sum" and c in (1, -1):
            total += len(parts) - 1
            open_ += parts
            continue
        factors = parts if kind == "product" else [(n, 1)]
        total += _operations(c, [e for _, e in factors]) if n != UNIT else 0
        if kind == "product" or c != 1:
            open_ += [(1, m) for m, _ in factors]
        elif kind == "function":
            total += 1
            open_ += parts[1:]
    return total


def _operations(c: Exact, exponents: Sequence[Exact]) -> int:
    """Count the operations of a product with a number."""
    single = is_float(c)
    above = sum(e > 0 for e in exponents) + (single or c.numerator not in (1, -1))
    below = sum(e < 0 for e in exponents) + (not single and c.denominator != 1)
    powers = 0
    for exponent in map(magnitude, exponents):
        whole, rest = divmod(exponent, 1)
        powers += whole.bit_length() + whole.bit_count() - 2 if whole else 0
        powers += _ROOTS.get(rest, 1) + (1 if whole and rest else 0)
    return powers + max(above - 1, 0) + max(below - 1, 0) + (below > 0)


def formula(graph: Graph, value: Value, names: Mapping[str, str]) -> str:
    """Write a value of a graph for people to read, with other names for its symbols."""
    shown = Expressions()
    symbols = {n: graph.nodes[n].parts[0] for n in graph.nodes[value[1]].symbols}
    known = {n: shown.make_symbol(names.get(name, name)) for n, name in symbols.items()}
    return Printer().text(shown.import_value(graph, value, known))
