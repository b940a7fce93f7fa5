"""Arithmetic with expressions of a module: each node is made once, numbers are exact."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import TypeAlias

import sympy as sp

from symsimpson.graph.nodes import UNIT, Exact, Graph, Value, exact
from symsimpson.graph.read import SympyConverter
from symsimpson.graph.rebuild import rebuild


class Expression:
    """A coefficient and a node of a graph, as a number to compute with.

    The graph simplifies sums and products: it collects equal terms and merges nested products.
    It never expands products of sums.
    """

    __slots__ = ("coefficient", "graph", "node")

    def __init__(self, graph: Expressions, value: Value) -> None:
        self.graph = graph
        self.coefficient, self.node = value

    # -- what it is

    @property
    def value(self) -> Value:
        """The coefficient and the node."""
        return self.coefficient, self.node

    @property
    def kind(self) -> str:
        """The kind of its node."""
        return self.graph.nodes[self.node].kind

    @property
    def is_symbol(self) -> bool:
        """True for a symbol with the coefficient one."""
        return self.coefficient == 1 and self.kind == "symbol"

    @property
    def is_number(self) -> bool:
        """True for an expression without symbols."""
        return not self.graph.nodes[self.node].symbols

    @property
    def name(self) -> str:
        """The name of a symbol."""
        (name,) = self.graph.nodes[self.node].parts
        return str(name)

    @property
    def symbols(self) -> list[Expression]:
        """The symbols in it, in the order in which they were made."""
        return [Expression(self.graph, (1, n)) for n in sorted(self.graph.nodes[self.node].symbols)]

    @property
    def terms(self) -> list[Expression]:
        """Its terms if it is a sum, else itself."""
        kind, parts, _ = self.graph.nodes[self.node]
        if kind != "sum":
            return [self]
        return [Expression(self.graph, (self.coefficient * c, n)) for c, n in parts]

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Expression):
            return self.value == other.value
        return self.node == UNIT and self.coefficient == other

    def __hash__(self) -> int:
        return hash(self.coefficient if self.node == UNIT else (self.coefficient, self.node))

    def __repr__(self) -> str:
        return f"Expression({self.coefficient}, {self.graph.nodes[self.node]})"

    # -- arithmetic

    def __neg__(self) -> Expression:
        return Expression(self.graph, (-self.coefficient, self.node))

    def __add__(self, other: Number) -> Expression:
        return self.graph.total([self, other])

    def __radd__(self, other: Number) -> Expression:
        return self.graph.total([other, self])

    def __sub__(self, other: Number) -> Expression:
        return self.graph.total([self, -self.graph.of(other)])

    def __rsub__(self, other: Number) -> Expression:
        return self.graph.total([other, -self])

    def __mul__(self, other: Number) -> Expression:
        return self.graph.product([self, other])

    __rmul__ = __mul__

    def __pow__(self, exponent: Exact) -> Expression:
        return Expression(self.graph, self.graph.power(self.value, exponent))

    def __truediv__(self, other: Number) -> Expression:
        return self * self.graph.of(other) ** -1

    def __rtruediv__(self, other: Number) -> Expression:
        return self**-1 * other


#: Operands of expressions; tables of a scheme have numbers of SymPy.
Number: TypeAlias = Expression | Exact | sp.Expr


class Expressions(Graph):
    """The nodes of expressions.

    Sums keep the numbers of their terms, and their parts that are sums are terms of their own.
    """

    def __init__(self) -> None:
        super().__init__()
        self._reader = SympyConverter(self, {})

    def add(self, values: Iterable[Value]) -> Value:
        """Add values; equal nodes are collected, and the first term has no minus."""
        terms: dict[int, Exact] = {}
        for c, n in values:
            terms[n] = terms.get(n, 0) + c
        while inner := [n for n, c in terms.items() if self._is_opened(c, n)]:
            for n in inner:
                c = terms.pop(n)
                for d, m in self.nodes[n].parts:
                    terms[m] = terms.get(m, 0) + c * d
        items = [(exact(c), n) for n, c in sorted(terms.items()) if c]
        if not items:
            return 0, UNIT
        if len(items) == 1:
            return items[0]
        sign = 1 if items[0][0] > 0 else -1
        parts = tuple((sign * c, n) for c, n in items)
        return sign, self._make("sum", parts, self._united(n for _, n in items))

    def _is_opened(self, c: Exact, n: int) -> bool:
        """Return whether a sum merges the terms of this multiple of another sum."""
        kind, parts, _ = self.nodes[n]
        return kind == "sum" and (c in (1, -1) or len(parts) == 1)

    def of(self, number: Number) -> Expression:
        """Return a number as an expression."""
        if isinstance(number, Expression):
            return number
        if isinstance(number, (int, Fraction)):
            return Expression(self, (exact(number), UNIT))
        return self.read(getattr(number, "value", number))

    def read(
        self, expression: sp.Expr, known: Mapping[sp.Expr, Expression] | None = None
    ) -> Expression:
        """Read an expression of SymPy, with expressions for its symbols."""
        reader = self._reader
        if known is not None:
            reader = SympyConverter(
                self, {symbol: replacement.value for symbol, replacement in known.items()}
            )
        return Expression(self, reader(expression))

    def bind(self, symbol: sp.Symbol, expression: Expression) -> None:
        """Let an expression stand wherever a symbol of SymPy does."""
        self._reader.done[symbol] = expression.value

    def import_value(
        self, graph: Graph, value: Value, known: Mapping[int, Expression]
    ) -> Expression:
        """Return a value of another graph, with expressions for its symbols."""
        replaced = {n: replacement.value for n, replacement in known.items()}
        (result,) = rebuild(graph, [value], replaced, self)
        return Expression(self, result)

    def make_symbol(self, name: str) -> Expression:
        """Return the symbol of a name."""
        return Expression(self, self.symbol(name))

    def total(self, values: Iterable[Number]) -> Expression:
        """Return the sum of some expressions."""
        return Expression(self, self.add(self.of(x).value for x in values))

    def product(self, values: Iterable[Number]) -> Expression:
        """Return the product of some expressions."""
        return Expression(self, self.multiply([self.of(x).value for x in values]))

    def apply(self, function: str, *arguments: Number) -> Expression:
        """Return a function of some expressions."""
        return Expression(self, self.function(function, *(self.of(x).value for x in arguments)))

    def known_at(self, node: int) -> int:
        """Return the level of a node, by which terms of a sum are ordered: here always 0."""
        return 0

    def substitute(self, expression: Expression, by: Mapping[Expression, Expression]) -> Expression:
        """Return an expression with others in place of symbols."""
        numbers = {symbol.node: replacement.value for symbol, replacement in by.items()}
        (result,) = rebuild(self, [expression.value], numbers)
        return Expression(self, result)
