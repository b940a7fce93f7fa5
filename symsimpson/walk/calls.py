"""Calls in a text: of Python's functions, of those of math or numpy, of its own."""

from __future__ import annotations

import ast
import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir

from symsimpson.walk.control_flow import Blocks
from symsimpson.walk.expressions import Expressions
from symsimpson.walk.memory import BYTE, Array
from symsimpson.walk.values import BIT, DOUBLE, INT, KNOWN, Refused, known

#: Results stand behind each other in so much memory.
MOST_RESULTS = 8


class Calls(Blocks):
    """Blocks, with functions beside the one that is walked."""

    def packed(self, name: str, arguments: list[Any]) -> tuple[Any, list[Any]]:
        """Return what a function is made for, and the values to call it with.

        Numbers that are known are part of the function. An array is a pointer, and what is not
        known of its shape and strides; a tuple is what stands in it.
        """
        given: list[Any] = []

        def take(value: Any) -> Any:
            if isinstance(value, Array):
                return "array", tuple(map(take, (value.pointer, *value.shape, *value.strides)))
            if isinstance(value, list):
                return "several", tuple(map(take, value))
            if known(value):
                return type(value).__name__, value
            given.append(value)
            return str(value.type)

        return (name, tuple(map(take, arguments))), given

    def unpacked(self, key: Any, values: list[Any]) -> list[Any]:
        """Return the arguments of a function, made of the values that it was called with."""
        rest = iter(values)

        def back(kind: Any) -> Any:
            match kind:
                case "array", parts:
                    pointer, *numbers = map(back, parts)
                    axes = len(numbers) // 2
                    return Array(pointer, tuple(numbers[:axes]), tuple(numbers[axes:]))
                case "several", parts:
                    return list(map(back, parts))
                case _, value:
                    return value
            return next(rest)

        return list(map(back, key[1]))

    def apart(
        self,
        name: str,
        given: list[Any],
        walk: Callable[[list[Any]], Any],
        attributes: Sequence[str] = (),
    ) -> tuple[Any, Any]:
        """Walk a function by itself; returns it, and the types of its results."""
        module, builder = self.builder.module, self.builder
        kind = ir.FunctionType(ir.VoidType(), [INT.as_pointer(), *(x.type for x in given)])
        function = ir.Function(module, kind, module.get_unique_name(f"walked_{name}"))
        function.linkage = "internal"
        machine = (text for text in builder.function.attributes if text.startswith('"'))
        for attribute in (*machine, *attributes):
            set.add(function.attributes, attribute)
        self.builder = ir.IRBuilder(function.append_basic_block("entry"))
        result = walk(list(function.args[1:]))
        results = result if isinstance(result, list) else [] if result is None else [result]
        typed = [self.typed(x, x) if known(x) else x for x in results]
        for k, value in enumerate(typed):
            self.builder.store(value, self._result(function.args[0], k, value.type))
        self.builder.ret_void()
        self.builder = builder
        types = [value.type for value in typed]
        return function, types if isinstance(result, list) else types[0] if types else None

    def call_apart(self, function: Any, given: list[Any], results: Any) -> Any:
        """Call such a function."""
        with self.builder.goto_entry_block():
            place = self.builder.alloca(INT, MOST_RESULTS)
        self.builder.call(function, [place, *given])
        if results is None:
            return None
        if not isinstance(results, list):
            return self.builder.load(self._result(place, 0, results))
        return [self.builder.load(self._result(place, k, x)) for k, x in enumerate(results)]

    def _result(self, place: Any, number: int, kind: Any) -> Any:
        assert kind in (BIT, DOUBLE, INT)
        pointer = self.builder.gep(place, [INT(number)], inbounds=True)
        return self.builder.bitcast(pointer, kind.as_pointer())


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
