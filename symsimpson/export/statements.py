"""Functions of Python as C writes them, with their comments."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

from symsimpson.errors import InputError
from symsimpson.export.c_expressions import CALLED, Expressions
from symsimpson.export.kinds import INT, constant_of
from symsimpson.export.scopes import Scopes, used, with_lengths
from symsimpson.export.single import Function

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
                yield from self._array(target, func, shape, indent)
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
                raise InputError(
                    f"a line of {name} has no counterpart in C: {ast.unparse(statement)}."
                )

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

    def _array(
        self, target: ast.expr, func: ast.expr, shape: ast.expr, indent: str
    ) -> Iterator[str]:
        """Write an array of a function's own, of a length that the compiler knows."""
        size = self._text(shape)
        name = self._name(ast.unparse(target))
        yield f"{indent}double {name}[{size}]{' = {0}' if 'zeros' in ast.unparse(func) else ''};"

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
