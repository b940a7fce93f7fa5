"""Kinds of numbers that functions compute with: what C declares, Python finds out as it runs."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.export.single import Function

#: Whole numbers and conditions, real numbers, rows of the workspace, a kernel, and a set of them.
INT, REAL, POINTER, KERNEL, SET = "int", "double", "double *", "kernel *", "const kernels *"
#: Functions of whole numbers, if these are.
LIKE_ITS_ARGUMENTS = ("min", "max", "abs")


@dataclass
class Signature:
    """Kinds of the arguments of a function and of what it returns: several numbers are a tuple."""

    arguments: list[str]
    returned: str | None = None
    several: int = 0


@dataclass
class Kinds:
    """Kinds of the names of functions, found by following calls."""

    functions: Mapping[str, Function]
    #: By function; ``names[function][name]`` is the kind of a local name.
    signatures: dict[str, Signature] = field(default_factory=dict)
    names: dict[str, dict[str, str]] = field(default_factory=dict)

    def follow(self, name: str, given: list[str]) -> Signature:
        """Find the kinds in a function that is called with arguments of these kinds."""
        function = self.functions[name]
        signature = self.signatures.get(name)
        if signature is not None:
            joined = [_joined(a, b) for a, b in zip(signature.arguments, given, strict=True)]
            if joined == signature.arguments:
                return signature
            given = joined
        self.signatures[name] = Signature(given)
        local = dict(zip(function.arguments, given, strict=True))
        self.names[name] = local
        while True:
            before = dict(local)
            for statement in function.body:
                self._look(statement, name, local)
            if local == before:
                return self.signatures[name]

    def _look(self, node: ast.stmt, name: str, local: dict[str, str]) -> None:
        match node:
            case ast.For(target=ast.Name(id=index), iter=over, body=body):
                local[index] = INT
                for argument in getattr(over, "args", ()):  # of a range; a table has none
                    self.of(argument, name)
                for statement in body:
                    self._look(statement, name, local)
            case ast.If(test=test, body=body, orelse=orelse):
                self.of(test, name)
                for statement in [*body, *orelse]:
                    self._look(statement, name, local)
            case ast.Assign(targets=[ast.Name(id=target)], value=value):
                kind = self.of(value, name)
                local[target] = _joined(local.get(target, kind), kind)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=value):
                self.of(value, name)
                local.update({ast.unparse(element): REAL for element in targets})
            case ast.AugAssign(target=ast.Name(id=target), value=value):
                local[target] = _joined(local[target], self.of(value, name))
            case (
                ast.Assign(targets=[place], value=value) | ast.AugAssign(target=place, value=value)
            ):
                self.of(place, name)
                self.of(value, name)
            case ast.Return(value=ast.Tuple(elts=values)):
                self.signatures[name].several = len(values)
            case ast.Return(value=ast.expr() as value):
                before, kind = self.signatures[name].returned, self.of(value, name)
                self.signatures[name].returned = _joined(before or kind, kind)
            case ast.Expr(value=value):
                self.of(value, name)

    def of(self, node: ast.expr, name: str) -> str:
        """Return the kind of an expression in a function."""
        function = self.functions[name]
        match node:
            case ast.Constant(value=value):
                return REAL if isinstance(value, float) else INT
            case ast.Name(id=identifier) if identifier in self.names[name]:
                return self.names[name][identifier]
            case ast.Name(id=identifier):
                value = constant_of(identifier, function)
                return REAL if isinstance(value, float) else INT
            case ast.Subscript(value=ast.Name(id="kernels"), slice=ast.Name(id=what)):
                return INT if what == "MODE" else KERNEL
            case ast.Subscript(value=value, slice=index):
                self.of(index, name)
                base = _base(value)
                if base in self.names[name]:
                    return REAL
                table = np.asarray(constant_of(base, function))
                return INT if table.dtype.kind == "i" else REAL
            case ast.BinOp(left=left, right=right, op=op):
                kinds = self.of(left, name), self.of(right, name)
                return REAL if isinstance(op, ast.Div) else _joined(*kinds)
            case ast.UnaryOp(operand=operand, op=op):
                kind = self.of(operand, name)
                return INT if isinstance(op, ast.Not) else kind
            case ast.IfExp(test=test, body=body, orelse=orelse):
                self.of(test, name)
                return _joined(self.of(body, name), self.of(orelse, name))
            case ast.Compare(left=left, comparators=others):
                for operand in (left, *others):
                    self.of(operand, name)
                return INT
            case ast.BoolOp(values=values) | ast.Tuple(elts=values):
                for element in values:
                    self.of(element, name)
                return INT
            case ast.Attribute(attr="inf"):
                return REAL
            case ast.Call():
                return self._called(node, name)
        raise InputError(f"a line of {name} has no counterpart in C: {ast.unparse(node)}.")

    def _called(self, node: ast.Call, name: str) -> str:
        given = [self.of(argument, name) for argument in node.args]
        called = ast.unparse(node.func)
        if called in self.functions and called != "sincos":
            return self.follow(called, given).returned or "void"
        if called in ("np.empty", "np.zeros"):
            return POINTER
        if called in LIKE_ITS_ARGUMENTS:
            return INT if set(given) == {INT} else REAL
        return INT if called == "int" else REAL


def constant_of(name: str, function: Function) -> Any:
    """Return the value of a constant that a function names."""
    source = function.source
    if name.startswith("at."):
        return source.driver_layout[name[3:]]
    return source.constants[name]


def _base(node: ast.expr) -> str:
    """Return the name of an array or a table, whatever indices follow it."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return ast.unparse(node)


def _joined(a: str, b: str) -> str:
    return REAL if {a, b} == {INT, REAL} else a
