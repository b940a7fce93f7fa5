"""Calls of functions of Python, math or numpy, as instructions of LLVM."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir

from symsimpson.targets.llvm.control_flow import Blocks
from symsimpson.targets.llvm.memory import Array
from symsimpson.targets.llvm.values import BIT, DOUBLE, INT, known

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
