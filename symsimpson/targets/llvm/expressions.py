"""Expressions of a text: the walker evaluates them to values and instructions."""

from __future__ import annotations

import ast
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from symsimpson.targets.llvm.control_flow import Calls, Loop, Slot
from symsimpson.targets.llvm.memory import BYTE, Array, Range
from symsimpson.targets.llvm.trees import Text, needs_short_circuit, used_once
from symsimpson.targets.llvm.values import (
    DOUBLE,
    INT,
    KNOWN,
    PrivateRow,
    UnsupportedConstruct,
    is_known,
)
from symsimpson.targets.llvm.vectors import Item

#: Values of the local names of a function.
Env = dict[str, Any]
#: Loops over constants with at most this many operations in all turns are unrolled.
FEW = 400
#: Types of the numbers of arrays that a function allocates.
KINDS = {"np.float64": DOUBLE, "np.int64": INT, "np.bool_": BYTE}
COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


@dataclass(frozen=True)
class Product:
    """A named product that is used once, so that it can be fused with a sum."""

    a: Any
    b: Any


@dataclass(frozen=True)
class ScratchUse:
    """Names of the scratch blocks that a statement and the statements after it use."""

    after: frozenset[str]  #: Used by the following statements of the block.
    here: frozenset[str]  #: Used by the remaining part of the statement itself.


class Frame:
    """The state of a function while it is emitted: its exit, result and loops."""

    def __init__(self, function: ast.FunctionDef, mask: Any = None) -> None:
        self.name, self.once, self.mask = function.name, used_once(function), mask
        self.exit: Any = None
        self.depth = 0
        self.result: Any = None
        self.slots: Any = None
        self.loops: list[Loop] = []
        self.freed: list[Any] = []


class Expressions(ABC):
    """Evaluates the expressions of a text, including calls.

    ``call(builder, function, values)`` emits a call of a function of ``math`` with scalar values.
    Loops with at most ``few`` operations in all turns are unrolled. Functions in ``apart`` are not
    inlined: they are emitted once for each combination of argument types.
    """

    def __init__(
        self,
        text: Text,
        values: Calls,
        call: Callable[[Any, Any, list[Any]], Any],
        few: int = FEW,
        apart: Mapping[str, Sequence[str]] = MappingProxyType({}),
    ) -> None:
        self._text, self._values, self._call, self._few = text, values, call, few
        #: Functions that are not inlined, with their LLVM attributes.
        self._outlined, self._defined_functions = apart, dict[Any, Any]()
        self._width = 0
        #: Functions that are emitted for one lane after another.
        self._scalar_functions: frozenset[str] = frozenset()
        #: True if all loops are unrolled.
        self._unrolls_all = False
        #: The active lanes of the present branch; None if all lanes are active.
        self._mask: Any = None
        #: Scratch blocks of which each lane has private rows.
        self._private_rows: dict[str, PrivateRow] = {}
        self._frames: list[Frame] = []
        #: The scratch use of the enclosing statements, from the outermost to the innermost.
        self._ahead: list[ScratchUse] = []
        self._names: dict[ast.AST, frozenset[str]] = {}
        #: The scratch that each statement of a block and its successors use, by first statement.
        self._scratch_from: dict[ast.AST, list[frozenset[str]]] = {}
        #: The statements of each block, ordered so that similar calls are adjacent.
        self._orders: dict[ast.AST, list[Item]] = {}

    @abstractmethod
    def _inline(
        self, function: ast.FunctionDef, arguments: list[Any], *, last: bool = False
    ) -> Any:
        """Emit a function at its call; ``last`` says that the call ends a statement."""

    def _places(self, target: ast.expr, env: Env) -> Any:
        """Return the array and the indices of a target; None for a name."""
        match target:
            case ast.Name():
                return None
            case ast.Subscript(value=value, slice=ast.Tuple(elts=places)):
                return self._value(value, env), [self._place(x, env) for x in places]
            case ast.Subscript(value=value, slice=place):
                return self._value(value, env), [self._place(place, env)]
        raise UnsupportedConstruct("an assignment to something else")

    def _place(self, node: ast.expr, env: Env) -> Any:
        match node:
            case ast.Slice(lower=lower, upper=upper, step=None):
                first = 0 if lower is None else self._value(lower, env)
                return Range(first, None if upper is None else self._value(upper, env))
        return self._value(node, env)

    def _read(self, place: Any) -> Any:
        """Return an entry of an array, a table or a list."""
        source, places = place
        if isinstance(source, Array):
            return self._values.load(source, places, self._width)
        if isinstance(source, list):
            return source[places[0]]
        return self._values.entry(source, places)

    def _look_up(self, name: str, env: Env) -> Any:
        if name in env:
            value = env[name]
            if isinstance(value, Product):
                return self._values.multiply(value.a, value.b)
            return self._values.read(value) if isinstance(value, Slot) else value
        if name in self._private_rows:
            return self._private_rows[name]
        try:
            return self._text.constants[name]
        except KeyError:
            raise UnsupportedConstruct(f"{name}, which has no value here") from None

    def _value(self, node: ast.expr, env: Env) -> Any:
        values = self._values
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                return self._look_up(name, env)
            case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
                return self._sum(left, op, right, env)
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(op, self._value(left, env), self._value(right, env))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return values.negative(self._value(operand, env))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return values.logical_not(self._value(operand, env))
            case ast.Subscript():
                return self._read(self._places(node, env))
            case ast.Attribute(value=ast.Name(id="np"), attr=name):
                return getattr(np, name)
            case ast.Attribute(value=value, attr="shape"):
                return list(self._array(value, env).shape)
            case ast.Attribute(value=value, attr="size"):
                return self._array(value, env).size
            case ast.Compare(left=left, ops=[ast.In()], comparators=[ast.Tuple(elts=parts)]):
                a, truth = self._value(left, env), False
                for part in parts:
                    truth = values.logical_or(
                        truth, values.compare("==", a, self._value(part, env))
                    )
                return truth
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                a, b = self._value(left, env), self._value(right, env)
                return values.compare(COMPARED[type(op)], a, b)
            case ast.BoolOp(op=op, values=parts):
                return self._evaluate_bool_op(parts, env, settles=isinstance(op, ast.Or))
            case ast.IfExp(test=test, body=body, orelse=other):
                return self._evaluate_choice(self._value(test, env), body, other, env)
            case ast.Tuple(elts=parts):
                return [self._value(part, env) for part in parts]
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return self._evaluate_call(name, [self._value(x, env) for x in arguments])
            case ast.Call(func=ast.Attribute(value=ast.Name(id="np"), attr=name), args=arguments):
                kind = next((ast.unparse(word.value) for word in node.keywords), "np.float64")
                return self._numpy(name, kind, [self._value(x, env) for x in arguments])
            case ast.Call(func=ast.Attribute(value=value, attr=name), args=arguments):
                given = [self._value(x, env) for x in arguments]
                return self._method(self._array(value, env), name, given)
        raise UnsupportedConstruct(f"an expression of type {type(node).__name__}")

    def _sum(self, left: ast.expr, op: ast.operator, right: ast.expr, env: Env) -> Any:
        """Return a sum or a difference; a product in it is fused, so that it rounds only once."""
        values, minus = self._values, isinstance(op, ast.Sub)
        if (product := self._factors(right, env)) is not None:
            return self._with_product(self._value(left, env), product, minus=minus)
        if (product := self._factors(left, env)) is None:
            return self._binary(op, self._value(left, env), self._value(right, env))
        c = self._value(right, env)
        return values.multiply_add(*product, values.negative(c) if minus else c)

    def _with_product(self, c: Any, product: tuple[Any, Any], *, minus: bool) -> Any:
        """Return c + a b or c - a b."""
        a, b = product
        return self._values.multiply_add(self._values.negative(a) if minus else a, b, c)

    def _factors(self, node: ast.expr, env: Env) -> tuple[Any, Any] | None:
        """Return the factors of a product or a square that is used once; None for others."""
        match node:
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return self._value(left, env), self._value(right, env)
            case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=2)):
                base = self._value(left, env)
                return base, base
            case ast.Name(id=name) if isinstance(env.get(name), Product):
                return env[name].a, env[name].b
        return None

    def _binary(self, op: ast.operator, a: Any, b: Any) -> Any:
        values = self._values
        match op:
            case ast.Add():
                return values.add(a, b)
            case ast.Sub():
                return values.subtract(a, b)
            case ast.Mult():
                return values.multiply(a, b)
            case ast.Div():
                return values.divide(a, b)
            case ast.Pow() if isinstance(b, int):
                return values.power(a, b)
            case ast.Pow():
                return self._library(math.pow, [a, b])
            case ast.BitAnd():
                return values.logical_and(a, b)
            case ast.BitOr():
                return values.logical_or(a, b)
            case ast.FloorDiv():
                return values.quotient(a, b)
            case ast.Mod():
                return values.remainder(a, b)
        raise UnsupportedConstruct(f"an operation of type {type(op).__name__}")

    def _evaluate_bool_op(self, parts: list[ast.expr], env: Env, *, settles: bool) -> Any:
        """Evaluate ``and`` or ``or``; a part that equals ``settles`` ends the evaluation."""
        truth = self._value(parts[0], env)
        for part in parts[1:]:
            if is_known(truth):
                if bool(truth) is settles:
                    return truth
                truth = self._value(part, env)
                continue

            rest = partial(self._value, part, env)
            if self._width or not needs_short_circuit(part, self._text):
                join = self._values.logical_or if settles else self._values.logical_and
                truth = join(truth, rest())
            elif settles:
                truth = self._values.select_lazily(truth, lambda: True, rest)
            else:
                truth = self._values.select_lazily(truth, rest, lambda: False)
        return truth

    def _evaluate_choice(self, truth: Any, body: ast.expr, other: ast.expr, env: Env) -> Any:
        if is_known(truth):
            return self._value(body if truth else other, env)

        first, second = partial(self._value, body, env), partial(self._value, other, env)
        if not self._width and (
            needs_short_circuit(body, self._text) or needs_short_circuit(other, self._text)
        ):
            return self._values.select_lazily(truth, first, second)
        return self._values.choose(truth, first(), second())

    def _array(self, node: ast.expr, env: Env) -> Array:
        value = self._value(node, env)
        if not isinstance(value, Array):
            raise UnsupportedConstruct("a value that is not an array")
        return value

    def _evaluate_call(self, name: str, arguments: list[Any]) -> Any:
        values = self._values
        if name in self._text.functions:
            walk = self._call_outlined if name in self._outlined else self._inline
            return walk(self._text.functions[name], arguments)
        match name, arguments:
            case (("real" | "float"), [value]):
                return float(value) if isinstance(value, (str, *KNOWN)) else values.real(value)
            case "int", [value]:
                return values.truncate(value)
            case "abs", [value]:
                return values.absolute(value)
            case (("min" | "max"), _):
                sign, extreme = "<" if name == "min" else ">", arguments[0]
                for value in arguments[1:]:
                    extreme = values.choose(values.compare(sign, value, extreme), value, extreme)
                return extreme
            case "len", [table]:
                return table.size if isinstance(table, Array) else len(table)
            case "call", [address, h, t, Array(pointer=workspace)]:
                return values.call_at(address, [values.real(h), values.real(t), workspace])
        function = self._text.constants.get(name)
        original = getattr(getattr(function, "py_func", None), "__name__", None)
        if original in self._text.functions:  # an alias of a function
            return self._evaluate_call(str(original), arguments)
        if function is None or not callable(function):
            raise UnsupportedConstruct(f"a call of {name}")
        if all(is_known(x) for x in arguments):
            return function(*arguments)
        return values.root(arguments[0]) if name == "sqrt" else self._library(function, arguments)

    def _library(self, function: Any, arguments: list[Any]) -> Any:
        """Call a function of ``math``, separately for each lane."""
        values = self._values
        if not self._width:
            return self._call(self._values.builder, function, [values.real(x) for x in arguments])
        spread = [values.broadcast(values.real(x), self._width) for x in arguments]
        lanes = ([values.element(x, lane) for x in spread] for lane in range(self._width))
        return values.build_vector([self._call(self._values.builder, function, x) for x in lanes])

    def _numpy(self, name: str, kind: str, arguments: list[Any]) -> Any:
        """Call one of the NumPy functions that generated code uses."""
        values = self._values
        match name, arguments:
            case (("zeros" | "empty" | "full"), [shape, *rest]):
                sizes = shape if isinstance(shape, list) else [shape]
                value = rest[0] if rest else None if name == "empty" else 0
                return values.allocate_array(KINDS[kind], sizes, value, self._frames[-1].freed)
            case "sqrt", [value]:
                return values.root(value)
            case "isnan", [value]:
                return values.compare("!=", value, value)
            case "log", [value]:
                return self._library(math.log, [value])
            case "int64", [value]:
                return values.truncate(value)
        raise UnsupportedConstruct(f"a call of np.{name}")

    def _method(self, array: Array, name: str, arguments: list[Any]) -> Any:
        """Call a method of a one-dimensional array."""
        values = self._values
        match name, arguments:
            case "copy", []:
                freed = self._frames[-1].freed
                copy = values.allocate_array(array.pointer.type.pointee, [array.size], None, freed)
                values.for_each(
                    array.size, lambda k: values.store(copy, [k], values.load(array, [k], 0), 0)
                )
                return copy
            case "reshape", [1, -1]:
                return Array(array.pointer, (1, array.size), (array.size, *array.strides))
        raise UnsupportedConstruct(f"a call of .{name}")

    def _call_outlined(self, function: ast.FunctionDef, arguments: list[Any]) -> Any:
        """Call a function that is not inlined; emit it once for each combination of types."""
        values = self._values
        key, given = values.pack_arguments(function.name, arguments)
        if key not in self._defined_functions:
            self._defined_functions[key] = values.define_function(
                function.name,
                given,
                lambda parameters: self._inline(function, values.unpack_arguments(key, parameters)),
                self._outlined[function.name],
            )
        callee, results = self._defined_functions[key]
        return values.call_function(callee, given, results)
