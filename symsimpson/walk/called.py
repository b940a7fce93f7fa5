"""Calls in a text: of Python's functions, of those of math and numpy, and of its own."""

from __future__ import annotations

import ast
import math
from abc import abstractmethod
from typing import Any

from symsimpson.walk.arrays import BYTE, Array
from symsimpson.walk.expressions import Expressions
from symsimpson.walk.values import DOUBLE, INT, KNOWN, Refused, known

__all__ = ["Functions"]

#: Numbers of arrays that a function makes for itself.
KINDS = {"np.float64": DOUBLE, "np.int64": INT, "np.bool_": BYTE}


class Functions(Expressions):
    """Walks calls."""

    @abstractmethod
    def _inside(
        self, function: ast.FunctionDef, arguments: list[Any], *, last: bool = False
    ) -> Any:
        """Walk a function where it is called; it may be the last of a statement."""

    def _called(self, name: str, arguments: list[Any]) -> Any:
        values = self._values
        if name in self._text.functions:
            walk = self._outside if name in self._apart else self._inside
            return walk(self._text.functions[name], arguments)
        match name, arguments:
            case (("real" | "float"), [value]):
                return float(value) if isinstance(value, (str, *KNOWN)) else values.real(value)
            case "int", [value]:
                return values.truncate(value)
            case "abs", [value]:
                return values.absolute(value)
            case (("min" | "max"), _):
                return self._extreme("<" if name == "min" else ">", arguments)
            case "len", [table]:
                return table.size if isinstance(table, Array) else len(table)
            case "call", [address, h, t, Array(pointer=workspace)]:
                return values.call_at(address, [values.real(h), values.real(t), workspace])
        function = self._text.constants.get(name)
        original = getattr(getattr(function, "py_func", None), "__name__", None)
        if original in self._text.functions:  # another name of a function
            return self._called(str(original), arguments)
        if function is None or not callable(function):
            raise Refused(f"a call of {name}")
        if all(known(x) for x in arguments):
            return function(*arguments)
        return values.root(arguments[0]) if name == "sqrt" else self._library(function, arguments)

    def _library(self, function: Any, arguments: list[Any]) -> Any:
        """Call a function of ``math``, lane by lane."""
        values = self._values
        if not self._width:
            return self._call(self._values.builder, function, [values.real(x) for x in arguments])
        spread = [values.spread(values.real(x), self._width) for x in arguments]
        lanes = ([values.element(x, lane) for x in spread] for lane in range(self._width))
        return values.joined([self._call(self._values.builder, function, x) for x in lanes])

    def _numpy(self, name: str, kind: str, arguments: list[Any]) -> Any:
        """Call a function of numpy."""
        values = self._values
        match name, arguments:
            case (("zeros" | "empty" | "full"), [shape, *rest]):
                sizes = shape if isinstance(shape, list) else [shape]
                value = rest[0] if rest else None if name == "empty" else 0
                return values.room(KINDS[kind], sizes, value, self._frames[-1].freed)
            case "sqrt", [value]:
                return values.root(value)
            case "isnan", [value]:
                return values.compare("!=", value, value)
            case "log", [value]:
                return self._library(math.log, [value])
            case "int64", [value]:
                return values.truncate(value)
        raise Refused(f"a call of np.{name}")

    def _method(self, array: Array, name: str, arguments: list[Any]) -> Any:
        """Call a method of an array of one axis."""
        values = self._values
        match name, arguments:
            case "copy", []:
                freed = self._frames[-1].freed
                copy = values.room(array.pointer.type.pointee, [array.size], None, freed)
                values.each(
                    array.size, lambda k: values.store(copy, [k], values.load(array, [k], 0), 0)
                )
                return copy
            case "reshape", [1, -1]:
                return Array(array.pointer, (1, array.size), (array.size, *array.strides))
        raise Refused(f"a call of .{name}")

    def _extreme(self, sign: str, arguments: list[Any]) -> Any:
        extreme = arguments[0]
        for value in arguments[1:]:
            extreme = self._values.choose(
                self._values.compare(sign, value, extreme), value, extreme
            )
        return extreme

    def _outside(self, function: ast.FunctionDef, arguments: list[Any]) -> Any:
        """Walk a function by itself, once for each kind of its arguments, and call it."""
        values = self._values
        key, given = values.packed(function.name, arguments)
        if key not in self._made:
            self._made[key] = values.apart(
                function.name,
                given,
                lambda parameters: self._inside(function, values.unpacked(key, parameters)),
                self._apart[function.name],
            )
        callee, results = self._made[key]
        return values.call_apart(callee, given, results)
