"""Loops, branches, variables, tables, arrays and function calls in LLVM."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

from symsimpson.targets.llvm.memory import BYTE, Array, Rows
from symsimpson.targets.llvm.values import (
    BIT,
    DOUBLE,
    FLAGS,
    INT,
    LaneNumber,
    UnsupportedConstruct,
    is_known,
)

#: The largest number of results of a function that is not inlined.
MOST_RESULTS = 8


@dataclass(frozen=True)
class Slot:
    """A variable in memory that loops or branches change; LLVM turns it into a register.

    ``mask`` has the lanes that were active at its definition; None means all lanes.
    """

    place: Any
    mask: Any = None


@dataclass(frozen=True)
class Loop:
    """The targets of ``continue`` and ``break`` in a loop, and its active lanes."""

    following: Any
    after: Any
    mask: Any = None


class Calls(Rows):
    """Values with control flow, variables, tables, arrays, and functions that are not inlined."""

    def __init__(self, builder: ir.IRBuilder, flags: tuple[str, ...] = FLAGS) -> None:
        super().__init__(builder, flags)
        self._tables: dict[int, tuple[Any, Any]] = {}

    # -- tables

    def entry(self, table: Any, places: list[Any]) -> Any:
        """Return an entry of a constant table, which is an array or a tuple of numbers."""
        if all(is_known(place) for place in places):
            for place in places:
                table = table[int(place)]
            return table.item() if hasattr(table, "item") else table
        if any(isinstance(place, LaneNumber) for place in places):
            raise UnsupportedConstruct("an entry of a table for each lane")
        variable, shape = self._table(table)
        if len(shape) != len(places):
            raise UnsupportedConstruct("a part of a table")
        flat: Any = 0
        for size, place in zip(shape, places, strict=True):
            flat = self.add(self.multiply(flat, size), place)
        return self.builder.load(
            self.builder.gep(variable, [INT(0), self.whole(flat)], inbounds=True)
        )

    def _table(self, table: Any) -> tuple[Any, tuple[int, ...]]:
        key = id(table)
        if key not in self._tables:
            array = np.asarray(table)
            kind = INT if array.dtype.kind in "iu" else DOUBLE
            numbers = [kind(x) for x in array.ravel().tolist()]
            module = self.builder.module
            name = module.get_unique_name(".table")
            variable = ir.GlobalVariable(module, ir.ArrayType(kind, len(numbers)), name)
            variable.initializer = ir.Constant(variable.value_type, numbers)
            variable.global_constant = True
            variable.linkage = "internal"
            variable.unnamed_addr = True
            self._tables[key] = variable, array.shape
        return self._tables[key]

    # -- variables

    def slot(self, value: Any, width: int, mask: Any = None) -> Slot:
        """Return a new variable with this value."""
        if isinstance(value, (LaneNumber, tuple, list)):
            raise UnsupportedConstruct("a variable of this kind, that a loop or a branch changes")
        if is_known(value):
            value = self.as_typed(value, value)
        if width and value.type == DOUBLE:
            value = self.broadcast(value, width)
        with self.builder.goto_entry_block():
            place = self.builder.alloca(value.type)
        self.builder.store(value, place)
        return Slot(place, mask)

    def read(self, slot: Slot) -> Any:
        """Return the value of a variable."""
        return self.builder.load(slot.place)

    def write(self, slot: Slot, value: Any) -> None:
        """Assign a value to a variable, converted to the type of the variable."""
        kind = slot.place.type.pointee
        if kind == INT:
            value = self.whole(value)
        elif kind == BIT:
            value = self.bit(value)
        else:
            value = self.real(value)
            if isinstance(kind, ir.VectorType):
                value = self.broadcast(value, kind.count)
        if value.type != kind:
            raise UnsupportedConstruct("a variable that changes its kind")
        self.builder.store(value, slot.place)

    # -- control flow

    def branch(self, truth: Any, yes: Callable[[], bool], other: Callable[[], bool]) -> bool:
        """Emit a branch with two bodies; return True if both leave the block."""
        if isinstance(truth.type, ir.VectorType):
            raise UnsupportedConstruct("a branch that lanes take differently")
        builder = self.builder
        blocks = [builder.append_basic_block(name) for name in ("yes", "no", "then")]
        builder.cbranch(truth, *blocks[:2])
        left = []
        for block, way in zip(blocks, (yes, other), strict=False):
            builder.position_at_end(block)
            left.append(way())
            if not left[-1]:
                builder.branch(blocks[2])
        builder.position_at_end(blocks[2])
        if all(left):
            builder.unreachable()
        return all(left)

    def select_lazily(self, truth: Any, yes: Callable[[], Any], other: Callable[[], Any]) -> Any:
        """Return one of two values; the branch computes only this one."""
        builder, incoming, ends = self.builder, [], []
        blocks = [builder.append_basic_block(name) for name in ("yes", "no", "then")]
        builder.cbranch(truth, *blocks[:2])
        for block, way in zip(blocks, (yes, other), strict=False):
            builder.position_at_end(block)
            incoming.append(way())
            ends.append(builder.block)
        if isinstance(incoming[0], Array):
            for end in ends:
                builder.position_at_end(end)
                builder.branch(blocks[2])
            builder.position_at_end(blocks[2])
            return self._phi_array(incoming, ends)
        if all(is_known(x) for x in incoming):
            incoming = [self.as_typed(x, y) for x, y in zip(incoming, incoming[::-1], strict=True)]
        kinds = {x.type for x in incoming if not is_known(x)}
        for k, end in enumerate(ends):
            builder.position_at_end(end)
            if DOUBLE in kinds:
                incoming[k] = self.real(incoming[k])
            elif is_known(incoming[k]):
                incoming[k] = self.bit(incoming[k]) if kinds == {BIT} else self.whole(incoming[k])
            builder.branch(blocks[2])
        builder.position_at_end(blocks[2])
        return self._phi(incoming, ends)

    def _phi(self, values: list[Any], ends: list[Any]) -> Any:
        """Return a phi node: the value that belongs to the preceding block."""
        result = self.builder.phi(values[0].type)
        for value, end in zip(values, ends, strict=True):
            result.add_incoming(value, end)
        return result

    def _phi_array(self, arrays: list[Array], ends: list[Any]) -> Array:
        """Return the array that belongs to the preceding block."""

        def join(parts: list[Any]) -> Any:
            if all(is_known(x) and x == parts[0] for x in parts):
                return parts[0]
            return self._phi([self.whole(x) if is_known(x) else x for x in parts], ends)

        shape, strides = (
            tuple(join(list(x)) for x in zip(*parts, strict=True))
            for parts in ([a.shape for a in arrays], [a.strides for a in arrays])
        )
        return Array(join([a.pointer for a in arrays]), shape, strides)

    def loop(self, ends: tuple[Any, Any, int], body: Callable[[Any, Loop], bool]) -> None:
        """Emit a loop over a range; ``body`` emits one turn, and returns True if it jumps away."""
        builder, (first, end, step) = self.builder, ends
        first, end, certain = self.whole(first), self.whole(end), is_known(first) and is_known(end)
        inside, following, after = map(builder.append_basic_block, ("loop", "next", "after"))
        sign = "<" if step > 0 else ">"
        before = builder.block
        if certain:
            builder.branch(inside)
        else:
            builder.cbranch(builder.icmp_signed(sign, first, end), inside, after)
        builder.position_at_end(inside)
        number = builder.phi(INT)
        number.add_incoming(first, before)
        if not body(number, Loop(following, after)):
            builder.branch(following)
        builder.position_at_end(following)
        later = builder.add(number, INT(step), flags=("nsw",))
        number.add_incoming(later, following)
        builder.cbranch(builder.icmp_signed(sign, later, end), inside, after)
        builder.position_at_end(after)

    def repeat(self, truth: Callable[[], Any], body: Callable[[Loop], bool]) -> None:
        """Emit a while loop; ``body`` emits one turn, and returns True if it jumps away."""
        builder = self.builder
        test, inside, after = map(builder.append_basic_block, ("while", "loop", "after"))
        builder.branch(test)
        builder.position_at_end(test)
        builder.cbranch(self.bit(truth()), inside, after)
        builder.position_at_end(inside)
        if not body(Loop(test, after)):
            builder.branch(test)
        builder.position_at_end(after)

    def call_at(self, address: Any, arguments: list[Any]) -> None:
        """Emit a call of a kernel by its address."""
        kind = ir.FunctionType(ir.VoidType(), [argument.type for argument in arguments])
        self.builder.call(self.builder.inttoptr(address, kind.as_pointer()), arguments)

    # -- memory

    def allocate_array(self, kind: Any, shape: list[Any], value: Any, freed: list[Any]) -> Array:
        """Allocate an array on the heap, filled with ``value`` unless that is None.

        The method appends the variable with its address to ``freed``, whose first entry is the
        function ``free``. The function that allocates frees the array when it returns.
        """
        builder = self.builder
        size: Any = 1
        for extent in shape:
            size = self.multiply(size, extent)
        raw = BYTE.as_pointer()
        malloc = self._external("malloc", raw, [INT])
        free = self._external("free", ir.VoidType(), [raw])
        with builder.goto_entry_block():
            place = builder.alloca(raw)
            builder.store(ir.Constant(raw, None), place)
        if not freed:
            freed.append(free)
        freed.append(place)
        # an empty array needs an address, too
        least = self.multiply(max(size, 1) if is_known(size) else self.add(size, 1), 8)
        address = builder.call(malloc, [self.whole(least)])
        # in a loop, the new array replaces the previous one
        builder.call(free, [builder.load(place)])
        builder.store(address, place)
        array = self.contiguous(builder.bitcast(address, kind.as_pointer()), shape)
        if value is not None:
            flat = Array(array.pointer, (size,), (1,))
            self.for_each(size, lambda k: self.store(flat, [k], value, 0))
        return array

    def for_each(self, count: Any, act: Callable[[Any], None]) -> None:
        """Emit a loop that calls ``act`` for each number below ``count``."""

        def body(number: Any, loop: Loop) -> bool:
            act(number)
            return False

        if not (is_known(count) and count == 0):
            self.loop((0, count, 1), body)

    def release(self, freed: list[Any]) -> None:
        """Free the arrays that a function allocated."""
        for place in freed[1:]:
            self.builder.call(freed[0], [self.builder.load(place)])

    # -- functions

    def pack_arguments(self, name: str, arguments: list[Any]) -> tuple[Any, list[Any]]:
        """Return a key for the types of the arguments, and the values to pass.

        Known numbers are part of the key. An array is a pointer and the unknown numbers of its
        shape and strides. A tuple is the sequence of its entries.
        """
        given: list[Any] = []

        def take(value: Any) -> Any:
            if isinstance(value, Array):
                return "array", tuple(map(take, (value.pointer, *value.shape, *value.strides)))
            if isinstance(value, list):
                return "several", tuple(map(take, value))
            if is_known(value):
                return type(value).__name__, value
            given.append(value)
            return str(value.type)

        return (name, tuple(map(take, arguments))), given

    def unpack_arguments(self, key: Any, values: list[Any]) -> list[Any]:
        """Return the arguments that :meth:`pack_arguments` packed, from a key and values."""
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

    def define_function(
        self,
        name: str,
        given: list[Any],
        walk: Callable[[list[Any]], Any],
        attributes: Sequence[str] = (),
    ) -> tuple[Any, Any]:
        """Emit a function of its own; return it, and the types of its results."""
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
        typed = [self.as_typed(x, x) if is_known(x) else x for x in results]
        for k, value in enumerate(typed):
            self.builder.store(value, self._result(function.args[0], k, value.type))
        self.builder.ret_void()
        self.builder = builder
        types = [value.type for value in typed]
        return function, types if isinstance(result, list) else types[0] if types else None

    def call_function(self, function: Any, given: list[Any], results: Any) -> Any:
        """Emit a call of a function from :meth:`define_function`, and return its results."""
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
