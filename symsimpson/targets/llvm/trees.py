"""Syntax trees of texts, and their properties that the walker needs."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from symsimpson.text.syntax import syntax
from symsimpson.text.workspace_layout import rows_of_blocks, scratch

#: Assumed number of turns of a loop of unknown length.
TURNS = 4


def assigned(body: Iterable[ast.stmt]) -> frozenset[str]:
    """Return the names that statements assign."""
    return frozenset(name for statement in body for name in _names_assigned(statement))


@lru_cache(maxsize=4096)
def _names_assigned(statement: ast.stmt) -> frozenset[str]:
    stored = (
        node.id
        for node in ast.walk(statement)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    )
    return frozenset(stored)


@lru_cache(maxsize=1024)
def used_once(function: ast.FunctionDef) -> frozenset[str]:
    """Return the names that a function assigns once and reads once."""
    uses = Counter(
        (part.id, isinstance(part.ctx, ast.Store))
        for part in ast.walk(function)
        if isinstance(part, ast.Name)
    )
    return frozenset(
        name for name, stored in uses if stored and uses[name, True] == 1 and uses[name, False] == 1
    )


@lru_cache(maxsize=4096)
def leaves(node: ast.For) -> bool:
    """Return True if a loop has a break or continue."""
    return any(isinstance(part, (ast.Break, ast.Continue)) for part in ast.walk(node))


@lru_cache(maxsize=65536)
def needs_short_circuit(node: ast.expr, text: Text) -> bool:
    """Return True if an expression must be evaluated only when its value is needed."""
    risky = (ast.Subscript, ast.FloorDiv, ast.Mod)  # out-of-range reads, divisions by zero
    called = (text.functions[name] for name in _calls(node) if name in text.functions)
    return any(isinstance(x, risky) for x in ast.walk(node)) or not all(
        map(_is_pure_arithmetic, called)
    )


@lru_cache(maxsize=16384)
def _calls(node: ast.AST) -> frozenset[str]:
    """Return the names of the functions that a tree calls."""
    calls = (part.func for part in ast.walk(node) if isinstance(part, ast.Call))
    return frozenset(name.id for name in calls if isinstance(name, ast.Name))


def _parts(node: ast.AST) -> Iterator[ast.AST]:
    """Iterate over the nodes of a tree, without the bodies of its loops."""
    yield node
    if isinstance(node, ast.For):
        return
    for child in ast.iter_child_nodes(node):
        yield from _parts(child)


@lru_cache(maxsize=65536)
def weight(node: ast.AST, text: Text) -> int:
    """Estimate the number of operations of a statement, including the functions that it calls."""
    operations = 0
    for part in _parts(node):
        match part:
            case ast.For(iter=source, body=body):
                operations += _turns(source, text) * sum(
                    weight(statement, text) for statement in body
                )
            case ast.BinOp() | ast.Compare() | ast.IfExp() | ast.Subscript():
                operations += 1
            case ast.Call(func=ast.Name(id=name)) if name in text.functions:
                operations += sum(
                    weight(statement, text) for statement in text.functions[name].body
                )
    return operations


def _turns(source: ast.expr, text: Text) -> int:
    """Return the number of turns of a loop, or ``TURNS`` if its ends are not constants."""
    match source:
        case ast.Call(func=ast.Name(id="range"), args=[end]):
            return _number(end, text, {}) or TURNS
        case ast.Name(id=name) if isinstance(text.constants.get(name), (tuple, list)):
            return len(text.constants[name])
    return TURNS


#: First row, end of the rows, and the text of the index if the rows are somewhere in a block.
_Rows = tuple[int, int, str]


def can_vectorise(
    node: ast.For, name: str, turns: range, text: Text, known: Mapping[str, int]
) -> bool:
    """Return True if the turns of a loop can run at once, as vectors.

    Three conditions are necessary. The statements only compute, read and write. If the index of a
    row contains the number of the turn, this is its last summand. No turn writes a row that another
    turn uses.
    """
    set_here: set[str] = set()
    written: list[_Rows] = []
    read: list[_Rows] = []

    def rows(place: ast.expr, into: list[_Rows]) -> bool:
        base = _base(place, name)
        free = base is place
        if free and _names(place) & {name}:
            return False
        first = 0 if base is None else _number(base, text, known)
        if first is not None:
            last = first + 1 if free else first + turns.stop
            into.append((first if free else first + turns.start, last, ""))
            return True
        block = (
            _block(base, text, known) if turns == range(text.constants.get("STRIDE", 0)) else None
        )
        if block is None or free:
            return False
        into.append((block.start, block.stop, ast.dump(place)))
        return True

    def fine(expression: ast.AST) -> bool:
        match expression:
            case ast.Subscript(value=ast.Name(id="W"), slice=ast.Tuple(elts=[row, _])):
                return rows(row, read)
            case ast.Subscript():
                return not _names(expression) & {name}
            case ast.Name(id=used):
                return used != name and (used in set_here or used not in inside)
            case ast.Call(func=ast.Name(id=called), args=arguments):
                function = text.functions.get(called)
                if function is not None and not _is_pure_arithmetic(function):
                    return False
                return all(fine(argument) for argument in arguments)
        return all(fine(child) for child in ast.iter_child_nodes(expression))

    inside = assigned(node.body)
    for statement in node.body:
        match statement:
            case ast.Assign(targets=[target], value=value) if fine(value):
                targets = target.elts if isinstance(target, ast.Tuple) else [target]
            case ast.AugAssign(target=ast.Subscript() as target, value=value) if fine(value):
                if not fine(target):
                    return False
                targets = [target]
            case _:
                return False
        for destination in targets:
            match destination:
                case ast.Name(id=new):
                    set_here.add(new)
                case ast.Subscript(value=ast.Name(id="W"), slice=ast.Tuple(elts=[row, _])):
                    if _base(row, name) is row or not rows(row, written):
                        return False
                case _:
                    return False
    return bool(written) and all(
        span == other or span[1] <= other[0] or other[1] <= span[0]
        for span in written
        for other in [*written, *read]
    )


@lru_cache(maxsize=256)
def _is_pure_arithmetic(function: ast.FunctionDef) -> bool:
    """Return True if a function has only assignments of numbers, without rows and branches."""
    allowed = (ast.Assign, ast.Return, ast.Expr)
    plain = all(isinstance(statement, allowed) for statement in function.body)
    return plain and not any(
        isinstance(node, ast.Subscript) or (isinstance(node, ast.Name) and node.id == "W")
        for node in ast.walk(function)
    )


@lru_cache(maxsize=256)
def is_real_arithmetic(function: ast.FunctionDef, text: Text) -> bool:
    """Return True if a function and its callees compute only with real numbers."""
    inside = [text.functions[name] for name in _calls(function) if name in text.functions]
    counts = "int" in _calls(function) or any(
        isinstance(x, ast.Attribute) for x in ast.walk(function)
    )
    return (
        _is_pure_arithmetic(function)
        and not counts
        and all(is_real_arithmetic(x, text) for x in inside)
    )


def _base(place: ast.expr, name: str) -> ast.expr | None:
    """Return a row index without its last summand ``name``.

    The result is the index itself if it has no such summand, and None if it is ``name`` alone.
    """
    match place:
        case ast.Name(id=identifier) if identifier == name:
            return None
        case ast.BinOp(left=left, op=ast.Add(), right=ast.Name(id=identifier)) if (
            identifier == name
        ):
            return left
    return place


@lru_cache(maxsize=65536)
def _names(node: ast.AST) -> frozenset[str]:
    return frozenset(part.id for part in ast.walk(node) if isinstance(part, ast.Name))


def _block(place: ast.expr | None, text: Text, known: Mapping[str, int]) -> range | None:
    """Return the rows of the block of an index of the form first + k * STRIDE, else None."""
    match place:
        case ast.BinOp(
            left=left, op=ast.Add(), right=ast.BinOp(op=ast.Mult(), right=ast.Name(id="STRIDE"))
        ):
            first = _number(left, text, known)
            return next((rows for rows in text.blocks.values() if rows and first == rows[0]), None)
    return None


def _number(node: ast.expr, text: Text, known: Mapping[str, int]) -> int | None:
    """Return the value of an index of constants and known names; None for others."""
    match node:
        case ast.Constant(value=int(value)):
            return value
        case ast.Name(id=name):
            number: Any = known.get(name, text.constants.get(name))
            return number if isinstance(number, int) else None
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() as op, right=right):
            a, b = _number(left, text, known), _number(right, text, known)
            if a is None or b is None:
                return None
            return a + b if isinstance(op, ast.Add) else a - b if isinstance(op, ast.Sub) else a * b
    return None


#: Names of the arguments of a kernel.
ARGUMENTS = ["h", "t", "workspace"]
#: Modules whose imports are ignored, because they belong to the compiler.
_COMPILER = ("numba", "numba.extending")


@dataclass(frozen=True, eq=False)
class Text:
    """The functions and constants of a module, as the walker reads them."""

    functions: Mapping[str, ast.FunctionDef]  #: Kernels, and the functions that they call.
    #: All other names of the module, including functions of ``math``.
    constants: Mapping[str, Any]
    #: Rows of the blocks of the workspace.
    blocks: Mapping[str, range] = field(default_factory=dict)
    #: Rows of scratch blocks, whose values no kernel passes to another.
    scratch: Mapping[str, range] = field(default_factory=dict)


@lru_cache(maxsize=4)  # the kernels of a module are compiled one after the other
def read_text(text: str) -> Text:
    """Read a trusted module; the statements that define its constants are executed."""
    functions, others = {}, []
    for node in syntax(text).body:
        match node:
            case ast.FunctionDef(name=name) if _is_walked(node):
                functions[name] = node
            case ast.ImportFrom(module=module) if module in _COMPILER:
                continue
            case ast.Import() | ast.Assign(targets=[ast.Name(id="compiled")]):
                continue
            case _:
                others.append(node)
    constants: dict[str, Any] = {}
    exec(compile(ast.Module(others, []), "<constants of a module>", "exec"), constants)
    tables = {k: np.asarray(v) for k, v in constants.items() if isinstance(v, list)}
    return Text(functions, constants | tables, rows_of_blocks(constants), scratch(constants))


def _is_walked(node: ast.FunctionDef) -> bool:
    marks = [mark.id for mark in node.decorator_list if isinstance(mark, ast.Name)]
    return "compiled" in marks or [argument.arg for argument in node.args.args] == ARGUMENTS
