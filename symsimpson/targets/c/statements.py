"""Write Python functions as C functions, with their comments."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from symsimpson.targets.c.kinds import (
    INT,
    REAL,
    Function,
    Kinds,
    Scopes,
    constant_of,
    fix_array_lengths,
    reject_line,
    remove_unread,
)

#: Precedence of operators, from the loosest; looser operands need parentheses.
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
#: The largest power of a name that is written as a product.
SHORT = 4

#: Definitions of C helper functions; a file has those that it calls.
HELPERS = {
    "smaller": "static double smaller(double a, double b)\n{\n    return b < a ? b : a;\n}\n",
    "larger": "static double larger(double a, double b)\n{\n    return b > a ? b : a;\n}\n",
    "smaller_int": "static int smaller_int(int a, int b)\n{\n    return b < a ? b : a;\n}\n",
    "larger_int": "static int larger_int(int a, int b)\n{\n    return b > a ? b : a;\n}\n",
    "abs_int": "static int abs_int(int a)\n{\n    return a < 0 ? -a : a;\n}\n",
    "square": "static double square(double a)\n{\n    return a * a;\n}\n",
}
#: Names of functions that no variable may hide.
CALLED = frozenset([*HELPERS, "fabs", "pow"])


def number(value: Any) -> str:
    """Write a number in C with all its digits."""
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
    """Writes expressions in C, and collects the constants and helpers that they need."""

    kinds: Kinds
    called: dict[str, str]  #: C names of the functions of the texts.
    #: C names of local names that C or a helper already uses.
    renamed: dict[str, str] = field(default_factory=dict)
    #: Values of the constants that expressions name, by their C names.
    constants: dict[str, Any] = field(default_factory=dict)
    #: Names of the helper functions that expressions call.
    helpers: set[str] = field(default_factory=set)

    def write(self, node: ast.expr, name: str, around: int = CHOICE) -> str:
        """Write an expression of the function ``name`` as an operand of precedence ``around``."""
        text, tight = self._write_node(node, name)
        return f"({text})" if tight < around else text

    def _write_node(self, node: ast.expr, name: str) -> tuple[str, int]:
        match node:
            case ast.Constant(value=value):
                return number(value), WHOLE
            case ast.Name(id=identifier):
                return self._write_name(identifier, name), WHOLE
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
                return self._write_power(left, right, name)
            case ast.BinOp(left=left, op=op, right=right):
                return self._write_operation(left, op, right, name)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return f"!{self.write(operand, name, SIGN)}", SIGN
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return f"-{self.write(operand, name, WHOLE)}", SIGN
            case ast.BoolOp(op=op, values=values):
                sign, tight = OPERATORS[type(op)]
                return sign.join(self.write(x, name, EQUAL) for x in values), tight
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._write_comparison([left, *others], ops, name)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                parts = (self.write(x, name, OR) for x in (test, body, orelse))
                return "{} ? {} : {}".format(*parts), CHOICE
            case ast.Call(func=func, args=given):
                return self._write_function_call(ast.unparse(func), given, name)
        reject_line(node, name)

    def _write_name(self, identifier: str, name: str) -> str:
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
            return number(value)  # module and driver have different constants of this name
        return here

    def _write_operation(
        self, left: ast.expr, op: ast.operator, right: ast.expr, name: str
    ) -> tuple[str, int]:
        sign, tight = OPERATORS[type(op)]
        if tight in (AND, OR):
            return sign.join(self.write(x, name, EQUAL) for x in (left, right)), tight
        first = self.write(left, name, tight)
        second = self.write(right, name, tight + 1)  # C adds in the same order
        if isinstance(op, ast.Div) and {self.kinds.of(x, name) for x in (left, right)} == {INT}:
            first = f"(double){self.write(left, name, WHOLE)}"
        return f"{first}{sign}{second}", tight

    def _write_comparison(
        self, values: list[ast.expr], ops: list[ast.cmpop], name: str
    ) -> tuple[str, int]:
        parts = []
        for left, op, right in zip(values, ops, values[1:], strict=False):
            sign, _ = OPERATORS[type(op)]
            parts.append(
                f"{self.write(left, name, LESS + 1)}{sign}{self.write(right, name, LESS + 1)}"
            )
        return (" && ".join(parts), AND) if len(parts) > 1 else (parts[0], EQUAL)

    def _write_power(self, base: ast.expr, to: ast.expr, name: str) -> tuple[str, int]:
        exponent = getattr(to, "value", None)
        if isinstance(exponent, int) and 2 <= exponent <= SHORT:
            if isinstance(base, (ast.Name, ast.Subscript)):
                factor = self.write(base, name, PRODUCT + 1)
                return " * ".join([factor] * exponent), PRODUCT
            if exponent == 2:
                self.helpers.add("square")
                return f"square({self.write(base, name)})", WHOLE
        return f"pow({self.write(base, name)}, {self.write(to, name)})", WHOLE

    def _write_function_call(
        self, called: str, given: list[ast.expr], name: str
    ) -> tuple[str, int]:
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


#: Beginning of a line that declares numbers.
DECLARED = re.compile(r"\s+(const (?:double|int)) ")
#: Places where a line may break: spaces that do not follow an operator.
BREAK = re.compile(r"(?<![-+*/?:<>=&|]) ")
#: The largest length of a line.
WIDTH = 96
#: Reserved words of C and C++, which names of the texts may equal.
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
#: Names that may be macros of <math.h>.
MACRO = re.compile("[A-Z][A-Z0-9_]+")


def comment(text: str, indent: str = "") -> list[str]:
    """Return the lines of a C comment, wrapped; indented lines of the text stay lines."""
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


def write_function(function: Function, expressions: Expressions) -> list[str]:
    """Return the lines of a C function, and an empty line; its signature must be known."""
    return _FunctionWriter(function, expressions).write()


@dataclass
class _FunctionWriter:
    """Writes the statements of one function in C."""

    function: Function
    expressions: Expressions
    pairs: int = 0

    def write(self) -> list[str]:
        """Return the lines of the function, and an empty line."""
        name, write = self.function.name, self.expressions
        signature, kinds = write.kinds.signatures[name], write.kinds.names[name]
        body = remove_unread(fix_array_lengths(self.function.body))
        write.renamed = {
            x: f"{x}_" for x in kinds if x in WORDS or x in CALLED or MACRO.fullmatch(x)
        }
        self.scopes = Scopes(body, set(self.function.arguments))
        read = {x.id for statement in body for x in ast.walk(statement) if isinstance(x, ast.Name)}
        arguments = [_declaration(kinds[x], self._name(x)) for x in self.function.arguments]
        arguments += ["double *result"] if signature.several else []
        head = f"{signature.returned or 'void'} {write.called[name]}({', '.join(arguments)})"
        lines = comment(self.function.doc) if self.function.doc else []
        lines += [*_break_line(f"static {head}", ""), "{"]
        unused = [f"(void){x};" for x in self.function.arguments if x not in read]
        lines += [f"    {' '.join(unused)}"] if unused else []
        for variable in sorted(self.scopes.ahead & self.scopes.stored):
            value = "0" if kinds[variable] == INT else "0.0"
            lines.append(f"    {_declaration(kinds[variable], self._name(variable))} = {value};")
        return [*lines, *self._block(body, "    "), "}", ""]

    def _block(self, body: list[ast.stmt], indent: str) -> list[str]:
        lines: list[str] = []
        line, joined = -1, ""
        for statement in body:
            beside = statement.lineno == line  # one line of the text may assign several values
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
        """Return the comment above a statement, as C."""
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
                yield from _break_line(f"for (int {head}) {{", indent)
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
                yield from _break_line(f"if ({write(test, name)}) {{", indent)
                yield from self._block(body, inner)
                if orelse:
                    yield f"{indent}}} else {{"
                    yield from self._block(orelse, inner)
                yield f"{indent}}}"
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Call() as call):
                yield from self._write_call(statement, targets, call, indent)
            case ast.Assign(targets=[target], value=ast.Call(func=func, args=[shape])) if (
                ast.unparse(func) in ("np.empty", "np.zeros")
            ):
                zeros = " = {0}" if "zeros" in ast.unparse(func) else ""
                yield f"{indent}double {self._text(target)}[{self._text(shape)}]{zeros};"
            case ast.Assign(targets=[target], value=value):
                yield from self._write_assignment(statement, target, write(value, name), indent)
            case ast.AugAssign(target=target, op=op, value=value):
                sign = {ast.Add: "+=", ast.Sub: "-=", ast.Mult: "*=", ast.Div: "/="}[type(op)]
                text = f"{write(target, name)} {sign} {write(value, name)};"
                yield from _break_line(text, indent)
            case ast.Return(value=None):
                yield f"{indent}return;"
            case ast.Return(value=ast.Tuple(elts=values)):
                for k, value in enumerate(values):
                    yield from _break_line(f"result[{k}] = {write(value, name)};", indent)
            case ast.Return(value=ast.expr() as value):
                yield from _break_line(f"return {write(value, name)};", indent)
            case ast.Pass():
                yield f"{indent};"
            case ast.Break():
                yield f"{indent}break;"
            case ast.Expr(value=ast.Call() as call):
                yield from _break_line(f"{write(call, name)};", indent)
            case _:
                reject_line(statement, name)

    def _write_call(
        self, statement: ast.stmt, targets: list[ast.expr], call: ast.Call, indent: str
    ) -> Iterator[str]:
        """Write a call with several results; sine and cosine call the C library."""
        write, name = self.expressions.write, self.function.name
        called, given = ast.unparse(call.func), [write(x, name) for x in call.args]
        if called == "sincos":
            for target, what in zip(targets, ("sin", "cos"), strict=True):
                yield from self._write_assignment(statement, target, f"{what}({given[0]})", indent)
            return
        self.pairs += 1
        place = f"{called}_{self.pairs}"
        yield f"{indent}double {place}[{len(targets)}];"
        called = self.expressions.called[called]
        yield from _break_line(f"{called}({', '.join([*given, place])});", indent)
        for k, target in enumerate(targets):
            yield from self._write_assignment(statement, target, f"{place}[{k}]", indent)

    def _write_assignment(
        self, statement: ast.stmt, target: ast.expr, value: str, indent: str
    ) -> Iterator[str]:
        """Write an assignment, and declare its target if this is the first assignment."""
        to = self.expressions.write(target, self.function.name)
        if isinstance(target, ast.Name):
            if (target.id, id(statement)) in self.scopes.unread:
                return
            fixed = self.scopes.begins.get((target.id, id(statement)))
            if fixed is not None:
                kind = self.expressions.kinds.names[self.function.name][target.id]
                to = _declaration(kind, to, fixed=fixed)
        yield from _break_line(f"{to} = {value};", indent)

    def _name(self, name: str) -> str:
        return self.expressions.renamed.get(name, name)

    def _text(self, node: ast.expr) -> str:
        return self.expressions.write(node, self.function.name)


def _bounds(bounds: list[ast.expr]) -> list[ast.expr]:
    """Return the start, the stop and the step of a range."""
    return [*([ast.Constant(0)] if len(bounds) == 1 else []), *bounds, ast.Constant(1)][:3]


def _declaration(kind: str, name: str, *, fixed: bool = False) -> str:
    """Write the declaration of a name."""
    if kind.endswith("*"):
        return f"{kind}{'const ' if fixed else ''}{name}"
    return f"{'const ' if fixed else ''}{kind} {name}"


def _break_line(text: str, indent: str) -> list[str]:
    """Break a long line before an operator, or after a comma."""
    lines, parts = [], BREAK.split(text)
    line = indent + parts[0]
    for part in parts[1:]:
        if len(line) + len(part) + 1 > WIDTH:
            lines.append(line)
            line = f"{indent}        {part}"
        else:
            line += f" {part}"
    return [*lines, line]
