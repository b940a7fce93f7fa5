"""Expressions of Python as C writes them."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.export.kinds import INT, REAL, Kinds, constant_of

#: How tightly operators bind: what is looser stands in parentheses.
CHOICE, OR, AND, EQUAL, LESS, SUM, PRODUCT, SIGN, WHOLE = range(9)
OPERATORS: dict[type, tuple[str, int]] = {
    ast.Add: (" + ", SUM),
    ast.Sub: (" - ", SUM),
    ast.Mult: (" * ", PRODUCT),
    ast.Div: (" / ", PRODUCT),
    ast.FloorDiv: (" / ", PRODUCT),
    ast.Mod: (" % ", PRODUCT),
    ast.BitAnd: (" && ", AND),
    ast.BitOr: (" || ", OR),
    ast.And: (" && ", AND),
    ast.Or: (" || ", OR),
    ast.Eq: (" == ", EQUAL),
    ast.NotEq: (" != ", EQUAL),
    ast.Lt: (" < ", LESS),
    ast.LtE: (" <= ", LESS),
    ast.Gt: (" > ", LESS),
    ast.GtE: (" >= ", LESS),
}
#: Powers that are written as products, where a name is raised.
SHORT = 4

#: Functions of our own, written where they are called.
HELPERS = {
    "smaller": "static double smaller(double a, double b)\n{\n    return b < a ? b : a;\n}\n",
    "larger": "static double larger(double a, double b)\n{\n    return b > a ? b : a;\n}\n",
    "smaller_int": "static int smaller_int(int a, int b)\n{\n    return b < a ? b : a;\n}\n",
    "larger_int": "static int larger_int(int a, int b)\n{\n    return b > a ? b : a;\n}\n",
    "abs_int": "static int abs_int(int a)\n{\n    return a < 0 ? -a : a;\n}\n",
    "square": "static double square(double a)\n{\n    return a * a;\n}\n",
}
#: Functions that are called by these names: no variable of a text may hide one.
CALLED = frozenset([*HELPERS, "fabs", "pow"])


def number(value: Any) -> str:
    """Write a number with all its digits."""
    if isinstance(value, (bool, int, np.integer)):
        return str(int(value))
    value = float(value)
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(value)


@dataclass
class Expressions:
    """Writes expressions of functions, and keeps in mind what they need."""

    kinds: Kinds
    called: dict[str, str]  #: Names in C of the functions of the texts.
    #: Names in C of local names, where these are taken.
    renamed: dict[str, str] = field(default_factory=dict)
    #: Values of the constants that are named, by their names in C.
    constants: dict[str, Any] = field(default_factory=dict)
    #: Functions of this package's own that are called.
    helpers: set[str] = field(default_factory=set)

    def write(self, node: ast.expr, name: str, around: int = CHOICE) -> str:
        """Write an expression in a function, as an operand of something that binds so tightly."""
        text, tight = self._written(node, name)
        return f"({text})" if tight < around else text

    def _written(self, node: ast.expr, name: str) -> tuple[str, int]:
        match node:
            case ast.Constant(value=value):
                return number(value), WHOLE
            case ast.Name(id=identifier):
                return self._named(identifier, name), WHOLE
            case ast.Attribute(attr="inf"):
                return "INFINITY", WHOLE
            case ast.Subscript(value=ast.Name(id="kernels"), slice=index):
                what = self.write(index, name)
                return ("kernels->mode" if what == "MODE" else f"kernels->call[{what}]"), WHOLE
            case ast.Subscript(value=value, slice=ast.Tuple(elts=indices)):
                places = "".join(f"[{self.write(x, name)}]" for x in indices)
                return f"{self.write(value, name, WHOLE)}{places}", WHOLE
            case ast.Subscript(value=value, slice=index):
                place = self.write(index, name)
                if self.kinds.of(index, name) == REAL:
                    place = f"(int)({place})"
                return f"{self.write(value, name, WHOLE)}[{place}]", WHOLE
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(left, right, name)
            case ast.BinOp(left=left, op=op, right=right):
                return self._operation(left, op, right, name)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return f"!{self.write(operand, name, SIGN)}", SIGN
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return f"-{self.write(operand, name, WHOLE)}", SIGN
            case ast.BoolOp(op=op, values=values):
                sign, tight = OPERATORS[type(op)]
                return sign.join(self.write(x, name, EQUAL) for x in values), tight
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._compared([left, *others], ops, name)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                parts = (self.write(x, name, OR) for x in (test, body, orelse))
                return "{} ? {} : {}".format(*parts), CHOICE
            case ast.Call(func=func, args=given):
                return self._call(ast.unparse(func), given, name)
        raise InputError(f"a line of {name} has no counterpart in C: {ast.unparse(node)}.")

    def _named(self, identifier: str, name: str) -> str:
        if identifier in self.kinds.names[name]:
            return self.renamed.get(identifier, identifier)
        if identifier in self.called:
            return self.called[identifier]
        value = constant_of(identifier, self.kinds.functions[name])
        if isinstance(value, float) and not np.isfinite(value):
            return number(value)
        here = identifier.removeprefix("at.")
        if self.constants.setdefault(here, value) is not value and not np.array_equal(
            self.constants[here], value
        ):
            return number(value)  # the driver has another one of this name
        return here

    def _operation(
        self, left: ast.expr, op: ast.operator, right: ast.expr, name: str
    ) -> tuple[str, int]:
        sign, tight = OPERATORS[type(op)]
        if tight in (AND, OR):
            return sign.join(self.write(x, name, EQUAL) for x in (left, right)), tight
        first = self.write(left, name, tight)
        second = self.write(right, name, tight + 1)  # sums are added up in the same order
        if isinstance(op, ast.Div) and {self.kinds.of(x, name) for x in (left, right)} == {INT}:
            first = f"(double){self.write(left, name, WHOLE)}"
        return f"{first}{sign}{second}", tight

    def _compared(self, values: list[ast.expr], ops: list[ast.cmpop], name: str) -> tuple[str, int]:
        parts = []
        for left, op, right in zip(values, ops, values[1:], strict=False):
            sign, _ = OPERATORS[type(op)]
            parts.append(
                f"{self.write(left, name, LESS + 1)}{sign}{self.write(right, name, LESS + 1)}"
            )
        return (" && ".join(parts), AND) if len(parts) > 1 else (parts[0], EQUAL)

    def _power(self, base: ast.expr, to: ast.expr, name: str) -> tuple[str, int]:
        exponent = getattr(to, "value", None)
        if isinstance(exponent, int) and 2 <= exponent <= SHORT:
            if isinstance(base, (ast.Name, ast.Subscript)):
                factor = self.write(base, name, PRODUCT + 1)
                return " * ".join([factor] * exponent), PRODUCT
            if exponent == 2:
                self.helpers.add("square")
                return f"square({self.write(base, name)})", WHOLE
        return f"pow({self.write(base, name)}, {self.write(to, name)})", WHOLE

    def _call(self, called: str, given: list[ast.expr], name: str) -> tuple[str, int]:
        written = [self.write(x, name) for x in given]
        if called == "call":
            first, *others = written
            return f"{first}({', '.join(others)})", WHOLE
        if called in self.called:
            return f"{self.called[called]}({', '.join(written)})", WHOLE
        whole = all(self.kinds.of(x, name) == INT for x in given)
        match called:
            case "real" if whole and written[0].lstrip("-").isdigit():
                return f"{written[0]}.0", WHOLE
            case "real":
                return f"(double)({written[0]})", SIGN
            case "float":
                return number(float(ast.literal_eval(given[0]))), WHOLE
            case "int":
                return f"(int){self.write(given[0], name, WHOLE)}", SIGN
            case "abs" if not whole:
                called = "fabs"
            case "min" | "max" | "abs":
                called = {"min": "smaller", "max": "larger", "abs": "abs"}[called]
                called += "_int" if whole else ""
                self.helpers.add(called)
                while len(written) > 2:
                    written = [f"{called}({written[0]}, {written[1]})", *written[2:]]
                return f"{called}({', '.join(written)})", WHOLE
        return f"{called}({', '.join(written)})", WHOLE
