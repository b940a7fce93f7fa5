"""Functions of Python as C writes them, with their comments."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.targets.c.kinds import (
    INT,
    REAL,
    Function,
    Kinds,
    Scopes,
    constant_of,
    used,
    with_lengths,
)

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
        reject(f"a line of {name} has no counterpart in C: {ast.unparse(node)}.")

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


#: How a line that declares numbers begins.
DECLARED = re.compile(r"\s+(const (?:double|int)) ")
#: Where lines are broken: at spaces, but not behind an operator.
BREAK = re.compile(r"(?<![-+*/?:<>=&|]) ")
#: No line of the file is longer.
WIDTH = 96
#: Words that are no names in C, or not everywhere; those of the texts may be.
WORDS = frozenset(
    re.findall(
        r"\w+",
        "auto break case char const continue default do double else enum extern float for goto if "
        "inline int long register restrict return short signed sizeof static struct switch typedef "
        "union unsigned void volatile while asm typeof linux unix bool true false nullptr complex "
        "imaginary constexpr static_assert alignas alignof thread_local typeof_unqual "
        "math_errhandling",
    )
)
#: Names that are macros of <math.h>, or may be.
MACRO = re.compile("[A-Z][A-Z0-9_]+")


def comment(text: str, indent: str = "") -> list[str]:
    """Write a comment of C over as many lines as it takes; indented lines stay lines."""
    text = text.replace("*/", "* /").replace("/*", "/ *")
    lines: list[str] = []
    for right, group in groupby(text.split("\n"), key=lambda x: x.startswith(" ") or not x):
        some, width = list(group), WIDTH - len(indent) - 6
        for line in some if right else [" ".join(some)]:
            further = line[: len(line) - len(line.lstrip())]
            lines += textwrap.wrap(line, width, subsequent_indent=further) or [""]
    if len(lines) == 1:
        return [f"{indent}/* {lines[0]} */"]
    rest = [f"{indent} * {x}".rstrip() for x in lines[1:]]
    return [f"{indent}/* {lines[0]}", *rest, f"{indent} */"]


def written_function(function: Function, expressions: Expressions) -> list[str]:
    """Write a function; the kinds of its arguments are known."""
    return _Body(function, expressions).written()


@dataclass
class _Body:
    """Writes the statements of a function."""

    function: Function
    expressions: Expressions
    pairs: int = 0

    def written(self) -> list[str]:
        """Return the lines of the function, and an empty one behind it."""
        name, write = self.function.name, self.expressions
        signature, kinds = write.kinds.signatures[name], write.kinds.names[name]
        body = used(with_lengths(self.function.body))
        write.renamed = {
            x: f"{x}_" for x in kinds if x in WORDS or x in CALLED or MACRO.fullmatch(x)
        }
        self.scopes = Scopes(body, set(self.function.arguments))
        read = {x.id for statement in body for x in ast.walk(statement) if isinstance(x, ast.Name)}
        arguments = [_declared(kinds[x], self._name(x)) for x in self.function.arguments]
        arguments += ["double *result"] if signature.several else []
        head = f"{signature.returned or 'void'} {write.called[name]}({', '.join(arguments)})"
        lines = comment(self.function.doc) if self.function.doc else []
        lines += [*_broken(f"static {head}", ""), "{"]
        unused = [f"(void){x};" for x in self.function.arguments if x not in read]
        lines += [f"    {' '.join(unused)}"] if unused else []
        for variable in sorted(self.scopes.ahead & self.scopes.stored):
            value = "0" if kinds[variable] == INT else "0.0"
            lines.append(f"    {_declared(kinds[variable], self._name(variable))} = {value};")
        return [*lines, *self._block(body, "    "), "}", ""]

    def _block(self, body: list[ast.stmt], indent: str) -> list[str]:
        lines: list[str] = []
        line, joined = -1, ""
        for statement in body:
            beside = statement.lineno == line  # values that one line of the text gives
            if not beside:
                lines += self._comments(statement, indent)
            texts = list(self._statement(statement, indent))
            declares = DECLARED.match(texts[0]) if len(texts) == 1 else None
            if declares and beside and declares[1] == joined and len(lines[-1] + texts[0]) < WIDTH:
                lines[-1] = f"{lines[-1][:-1]}, {texts[0][declares.end() :]}"
            else:
                lines += texts
            line, joined = statement.lineno, declares[1] if declares else ""
        return lines

    def _comments(self, statement: ast.stmt, indent: str) -> list[str]:
        """Return the comments above a statement."""
        lines, at, comments = self.function.source.lines, statement.lineno - 2, []
        while at >= 0 and lines[at].lstrip().startswith("# "):
            comments.append(lines[at].strip("# \n"))
            at -= 1
        return comment(" ".join(reversed(comments)), indent) if comments else []

    def _statement(self, statement: ast.stmt, indent: str) -> Iterator[str]:
        write, name = self.expressions.write, self.function.name
        inner = indent + "    "
        match statement:
            case ast.For(target=ast.Name(id=index), iter=ast.Call(args=bounds), body=body):
                index = self._name("turn" if index == "_" else index)
                first, last, by = _bounds(bounds)
                back = isinstance(by, ast.UnaryOp)
                on = f"{index} += {self._text(by)}" if ast.unparse(by) != "1" else f"{index}++"
                head = (
                    f"{index} = {self._text(first)}; {index} {'<>'[back]} {self._text(last)}; {on}"
                )
                yield from _broken(f"for (int {head}) {{", indent)
                yield from self._block(body, inner)
                yield f"{indent}}}"
            case ast.For(target=ast.Name(id=index), iter=ast.Name() as table, body=body):
                place, size = f"{index}_place", len(constant_of(table.id, self.function))
                head = f"int {place} = 0; {place} < {size}; {place}++"
                yield f"{indent}for ({head}) {{"
                yield f"{inner}const int {self._name(index)} = {self._text(table)}[{place}];"
                yield from self._block(body, inner)
                yield f"{indent}}}"
            case ast.If(test=test, body=body, orelse=orelse):
                yield from _broken(f"if ({write(test, name)}) {{", indent)
                yield from self._block(body, inner)
                if orelse:
                    yield f"{indent}}} else {{"
                    yield from self._block(orelse, inner)
                yield f"{indent}}}"
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Call() as call):
                yield from self._several(statement, targets, call, indent)
            case ast.Assign(targets=[target], value=ast.Call(func=func, args=[shape])) if (
                ast.unparse(func) in ("np.empty", "np.zeros")
            ):
                zeros = " = {0}" if "zeros" in ast.unparse(func) else ""
                yield f"{indent}double {self._text(target)}[{self._text(shape)}]{zeros};"
            case ast.Assign(targets=[target], value=value):
                yield from self._assigned(statement, target, write(value, name), indent)
            case ast.AugAssign(target=target, op=op, value=value):
                sign = {ast.Add: "+=", ast.Sub: "-=", ast.Mult: "*=", ast.Div: "/="}[type(op)]
                text = f"{write(target, name)} {sign} {write(value, name)};"
                yield from _broken(text, indent)
            case ast.Return(value=None):
                yield f"{indent}return;"
            case ast.Return(value=ast.Tuple(elts=values)):
                for k, value in enumerate(values):
                    yield from _broken(f"result[{k}] = {write(value, name)};", indent)
            case ast.Return(value=ast.expr() as value):
                yield from _broken(f"return {write(value, name)};", indent)
            case ast.Pass():
                yield f"{indent};"
            case ast.Break():
                yield f"{indent}break;"
            case ast.Expr(value=ast.Call() as call):
                yield from _broken(f"{write(call, name)};", indent)
            case _:
                reject(f"a line of {name} has no counterpart in C: {ast.unparse(statement)}.")

    def _several(
        self, statement: ast.stmt, targets: list[ast.expr], call: ast.Call, indent: str
    ) -> Iterator[str]:
        """Write a call that gives several numbers; sine and cosine are those of the C library."""
        write, name = self.expressions.write, self.function.name
        called, given = ast.unparse(call.func), [write(x, name) for x in call.args]
        if called == "sincos":
            for target, what in zip(targets, ("sin", "cos"), strict=True):
                yield from self._assigned(statement, target, f"{what}({given[0]})", indent)
            return
        self.pairs += 1
        place = f"{called}_{self.pairs}"
        yield f"{indent}double {place}[{len(targets)}];"
        called = self.expressions.called[called]
        yield from _broken(f"{called}({', '.join([*given, place])});", indent)
        for k, target in enumerate(targets):
            yield from self._assigned(statement, target, f"{place}[{k}]", indent)

    def _assigned(
        self, statement: ast.stmt, target: ast.expr, value: str, indent: str
    ) -> Iterator[str]:
        """Write an assignment, and declare what first gets a value by it."""
        to = self.expressions.write(target, self.function.name)
        if isinstance(target, ast.Name):
            if (target.id, id(statement)) in self.scopes.unread:
                return
            fixed = self.scopes.begins.get((target.id, id(statement)))
            if fixed is not None:
                kind = self.expressions.kinds.names[self.function.name][target.id]
                to = _declared(kind, to, fixed=fixed)
        yield from _broken(f"{to} = {value};", indent)

    def _name(self, name: str) -> str:
        return self.expressions.renamed.get(name, name)

    def _text(self, node: ast.expr) -> str:
        return self.expressions.write(node, self.function.name)


def _bounds(bounds: list[ast.expr]) -> list[ast.expr]:
    """Return the first number of a range, that behind its end, and the distance of two."""
    return [*([ast.Constant(0)] if len(bounds) == 1 else []), *bounds, ast.Constant(1)][:3]


def _declared(kind: str, name: str, *, fixed: bool = False) -> str:
    """Write the declaration of a name."""
    if kind.endswith("*"):
        return f"{kind}{'const ' if fixed else ''}{name}"
    return f"{'const ' if fixed else ''}{kind} {name}"


def _broken(text: str, indent: str) -> list[str]:
    """Break a line before an operator, or behind a comma."""
    lines, parts = [], BREAK.split(text)
    line = indent + parts[0]
    for part in parts[1:]:
        if len(line) + len(part) + 1 > WIDTH:
            lines.append(line)
            line = f"{indent}        {part}"
        else:
            line += f" {part}"
    return [*lines, line]
