"""The text of a module: what it defines, whether it is built as generated ones are."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import pairwise, zip_longest
from types import MappingProxyType

from symsimpson.errors import StaleKernelError
from symsimpson.text.interface import MATH, OPTIONS, SIGNATURE


@lru_cache(maxsize=1)  # trees are large, and asked for by one reader after the other
def syntax(text: str) -> ast.Module:
    """Return the syntax tree of a text, which is not to be changed."""
    return ast.parse(text)


@lru_cache(maxsize=8)  # small trees
def outline(text: str) -> ast.Module:
    """Return the syntax tree of a text without the bodies of its functions, in a tenth of the time.

    Lines keep their numbers. A body is what is indented behind a function's arguments: a string
    in it must not go on at the left margin.
    """
    kept: list[str] = []
    last = depth = 0  # the last line of a body; how many brackets of arguments are open
    inside = False
    for line in text.splitlines():
        if inside and not depth and (not line or line[0].isspace()):
            if line.strip():
                last = len(kept)
            kept.append("")
            continue
        if inside and not depth and last:
            kept[last], last = "    ...", 0
        inside = (inside and depth > 0) or line.startswith("def ")
        if inside:
            depth += line.count("(") - line.count(")")
        kept.append(line)
    if last:
        kept[last] = "    ..."
    return ast.parse("\n".join(kept))


def first_line(node: ast.stmt) -> int:
    """Return the line in which a statement begins, counted from 1; decorators belong to it."""
    return min([node.lineno, *(mark.lineno for mark in getattr(node, "decorator_list", ()))])


@lru_cache(maxsize=64)  # each ensemble and each search for events asks again
def definitions(text: str) -> Mapping[str, tuple[int, int]]:
    """Return the first line, and the line behind the last, of each constant and function.

    Decorators belong to functions. Lines are counted from 0. Raises SyntaxError, ValueError,
    RecursionError or MemoryError if the text is no Python.
    """
    spans = {}
    for node in outline(text).body:
        match node:
            case ast.FunctionDef(name=name) | ast.Assign(targets=[ast.Name(id=name)]):
                first = first_line(node)
                spans[name] = first - 1, node.end_lineno or first
    return MappingProxyType(spans)


def redefined(text: str, changes: Mapping[str, str]) -> str:
    """Return a text in which constants and functions have other definitions.

    ``changes`` has the definition of each name as it is to stand there; empty to leave it out.
    """
    lines = text.splitlines(keepends=True)
    spans = definitions(text)
    for name in sorted(changes, key=lambda name: spans[name], reverse=True):
        first, end = spans[name]
        lines[first:end] = [f"{changes[name]}\n"] if changes[name] else []
    return "".join(lines)


_MATH = frozenset([*MATH, "atan2", "pi"])
#: Names that may be imported, and from where.
IMPORTS = {"math": _MATH, "numba": frozenset(["carray", "njit"]), "numpy": frozenset(["array"])}
#: Functions of Python that may be called.
BUILTINS = frozenset(
    ["abs", "enumerate", "float", "int", "len", "max", "min", "range", "sum", "tuple", "zip"]
)
#: Options of the compiler, which are fixed: with others Python might run the kernels.
SETTINGS = {"SIGNATURE": SIGNATURE, "OPTIONS": ast.literal_eval(OPTIONS)}
NODES = (
    ast.Module,
    ast.ImportFrom,
    ast.alias,
    ast.FunctionDef,
    ast.arguments,
    ast.arg,
    ast.Return,
    ast.Pass,
    ast.Assign,
    ast.AugAssign,
    ast.Expr,
    ast.For,
    ast.While,
    ast.Break,
    ast.If,
    ast.IfExp,
    ast.Lambda,
    ast.Call,
    ast.keyword,
    ast.Starred,
    ast.Subscript,
    ast.Slice,
    ast.Name,
    ast.Constant,
    ast.Tuple,
    ast.List,
    ast.Set,
    ast.Dict,
    ast.ListComp,
    ast.GeneratorExp,
    ast.comprehension,
    ast.BinOp,
    ast.UnaryOp,
    ast.BoolOp,
    ast.Compare,
    ast.operator,
    ast.unaryop,
    ast.boolop,
    ast.cmpop,
    ast.expr_context,
)
#: Statements outside of functions.
TOP = (ast.ImportFrom, ast.Assign, ast.FunctionDef)


def check_structure(text: str, where: str) -> None:
    """Refuse a module that holds anything but what generated modules are made of.

    Its text is not executed; ``where`` names it in the message. Raises StaleKernelError with the
    line and what stands there.
    """
    try:
        tree = syntax(text)
        violation = next(_strange(tree), None) or next(_hidden(tree, outline(text)), None)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise StaleKernelError(
            f"{where}: this is no module that symsimpson generated: {type(error).__name__}.\n"
            "It was not executed. Generate one with symsimpson.generate(system, scheme)."
        ) from None
    if violation is not None:
        node, what = violation
        raise StaleKernelError(
            f"{where}, line {getattr(node, 'lineno', 1)}: {what}, which no generated module has.\n"
            "It was not executed. Find out where the file comes from, and generate it anew."
        )


def _hidden(tree: ast.Module, read: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """Find what reads otherwise where functions are left out, or shares a line with another.

    Constants are read in a text without functions, and are replaced by whole lines.
    """

    def fixed_part(node: ast.stmt | None) -> object:
        """Return all of a statement, and where it stands, but what a function does."""
        if not isinstance(node, ast.FunctionDef):
            return node and ast.dump(node, include_attributes=True)
        parts = (*node.decorator_list, node.args)
        return node.name, node.lineno, [ast.dump(x, include_attributes=True) for x in parts]

    for mine, other in zip_longest(tree.body, read.body):
        if fixed_part(mine) != fixed_part(other):
            yield mine or tree, "text at the left margin"
    for before, behind in pairwise(tree.body):
        if first_line(behind) <= (before.end_lineno or 0):
            yield behind, "two statements in a line"


def _strange(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """Find what does not belong into a generated module."""
    body = tree.body[1:] if ast.get_docstring(tree, clean=False) is not None else tree.body
    for statement in body:
        if not isinstance(statement, TOP):
            yield statement, f"a statement of type {type(statement).__name__}"
    nodes = list(ast.walk(tree))  # a module has tens of thousands
    functions = {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
    arguments = {node.arg for node in nodes if isinstance(node, ast.arg)}
    called = BUILTINS | {"carray", "njit", "array", "real", "compiled"} | _MATH
    called = called | functions | arguments
    named = called | set(_bound(nodes))
    settings = dict(SETTINGS)
    for node in nodes:
        match node:
            case ast.ImportFrom(module=module, names=names, level=level):
                allowed = IMPORTS.get(module or "", frozenset())
                if level or not all(n.name in allowed and n.asname is None for n in names):
                    yield node, f"an import of {module}"
            case ast.Call(func=ast.Attribute(value=ast.Name(), attr="append")):
                continue  # to a list of its own
            case ast.Attribute(attr="append", value=ast.Name()):
                continue
            case ast.Call(func=ast.Name(id=name)):
                if name not in called:
                    yield node, f"a call of {name[:40]}"
            case ast.Call():
                yield node, "a call of an expression"
            case ast.Name(id=name):
                if (name.startswith("_") and name != "_") or name not in named:
                    yield node, f"the name {name[:40]}"
            case ast.FunctionDef(decorator_list=decorators, name=name):
                plain = all(isinstance(d, ast.Name) and d.id == "compiled" for d in decorators)
                if not plain or name in BUILTINS | {"carray", "njit", "array"}:
                    yield node, f"a function {name[:40]} of another kind"
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name in SETTINGS:
                if name not in settings or _literal(value) != settings.pop(name):
                    yield node, f"another {name}"
            case ast.Constant(value=value):
                if not isinstance(value, (int, float, str, type(None))):
                    yield node, f"a constant of type {type(value).__name__}"
            case _ if not isinstance(node, NODES):
                yield node, f"a syntax of type {type(node).__name__}"
    for name in settings:
        yield tree, f"no {name}"


def _literal(node: ast.expr) -> object:
    try:
        return ast.literal_eval(node)
    except (ValueError, TypeError):
        return None


def _bound(nodes: list[ast.AST]) -> Iterator[str]:
    """Return all names that a module binds."""
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.alias):
            yield node.name
