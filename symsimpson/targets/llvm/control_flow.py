"""Loops, branches, calls, variables or tables in LLVM."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

from symsimpson.targets.llvm.memory import BYTE, Array, Rows
from symsimpson.targets.llvm.values import BIT, DOUBLE, FLAGS, INT, LaneNumber, Refused, known

#: Results stand behind each other in so much memory.
MOST_RESULTS = 8


@dataclass(frozen=True)
class Slot:
    """A variable that loops or branches change; the compiler turns it into a register.

    It was made where the lanes of a mask counted; None if all did.
    """

    place: Any
    mask: Any = None


@dataclass(frozen=True)
class Loop:
    """Blocks that a loop goes on with, and that stand behind it; lanes for which it turns."""

    following: Any
    after: Any
    mask: Any = None


class Calls(Rows):
    """Values with control flow, variables, tables and functions beside the one that is walked."""

    def __init__(self, builder: ir.IRBuilder, flags: tuple[str, ...] = FLAGS) -> None:
        super().__init__(builder, flags)
        self._tables: dict[int, tuple[Any, Any]] = {}

    # -- tables

    def entry(self, table: Any, places: list[Any]) -> Any:
        """Return an entry of a table, an array or a tuple of numbers."""
        if all(known(place) for place in places):
            for place in places:
                table = table[int(place)]
            return table.item() if hasattr(table, "item") else table
        if any(isinstance(place, LaneNumber) for place in places):
            raise Refused("an entry of a table for each lane")
        variable, shape = self._table(table)
        if len(shape) != len(places):
            raise Refused("a part of a table")
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
        """Return a variable with this value."""
        if isinstance(value, (LaneNumber, tuple, list)):
            raise Refused("a variable of this kind, that a loop or a branch changes")
        if known(value):
            value = self.typed(value, value)
        if width and value.type == DOUBLE:
            value = self.spread(value, width)
        with self.builder.goto_entry_block():
            place = self.builder.alloca(value.type)
        self.builder.store(value, place)
        return Slot(place, mask)

    def read(self, slot: Slot) -> Any:
        """Return the value of a variable."""
        return self.builder.load(slot.place)

    def write(self, slot: Slot, value: Any) -> None:
        """Change a variable."""
        kind = slot.place.type.pointee
        if kind == INT:
            value = self.whole(value)
        elif kind == BIT:
            value = self.bit(value)
        else:
            value = self.real(value)
            if isinstance(kind, ir.VectorType):
                value = self.spread(value, kind.count)
        if value.type != kind:
            raise Refused("a variable that changes its kind")
        self.builder.store(value, slot.place)

    # -- control flow

    def branch(self, truth: Any, yes: Callable[[], bool], other: Callable[[], bool]) -> bool:
        """Walk one of two ways, as something turns out; returns whether both of them left."""
        if isinstance(truth.type, ir.VectorType):
            raise Refused("a branch that lanes take differently")
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

    def picked(self, truth: Any, yes: Callable[[], Any], other: Callable[[], Any]) -> Any:
        """Return one of two values, of which the other is not computed."""
        builder, incoming, ends = self.builder, [], []
        blocks = [builder.append_basic_block(name) for name in ("yes", "no", "then")]
        builder.cbranch(truth, *blocks[:2])
        for block, way in zip(blocks, (yes, other), strict=False):
            builder.position_at_end(block)
            incoming.append(way())
            ends.append(builder.block)
        if isinstance(incoming[0], Array):  # a part of an array is computed without reading it
            for end in ends:
                builder.position_at_end(end)
                builder.branch(blocks[2])
            builder.position_at_end(blocks[2])
            return self._joined(incoming, ends)
        if all(known(x) for x in incoming):
            incoming = [self.typed(x, y) for x, y in zip(incoming, incoming[::-1], strict=True)]
        kinds = {x.type for x in incoming if not known(x)}
        for k, end in enumerate(ends):
            builder.position_at_end(end)
            if DOUBLE in kinds:
                incoming[k] = self.real(incoming[k])
            elif known(incoming[k]):
                incoming[k] = self.bit(incoming[k]) if kinds == {BIT} else self.whole(incoming[k])
            builder.branch(blocks[2])
        builder.position_at_end(blocks[2])
        return self._either_of(incoming, ends)

    def _either_of(self, values: list[Any], ends: list[Any]) -> Any:
        """Return the value of the block that came before."""
        result = self.builder.phi(values[0].type)
        for value, end in zip(values, ends, strict=True):
            result.add_incoming(value, end)
        return result

    def _joined(self, arrays: list[Array], ends: list[Any]) -> Array:
        """Return the array of the way that was taken."""

        def join(parts: list[Any]) -> Any:
            if all(known(x) and x == parts[0] for x in parts):
                return parts[0]
            return self._either_of([self.whole(x) if known(x) else x for x in parts], ends)

        shape, strides = (
            tuple(join(list(x)) for x in zip(*parts, strict=True))
            for parts in ([a.shape for a in arrays], [a.strides for a in arrays])
        )
        return Array(join([a.pointer for a in arrays]), shape, strides)

    def loop(self, ends: tuple[Any, Any, int], body: Callable[[Any, Loop], bool]) -> None:
        """Walk a body that stays a loop; it is told where to go on and where to break."""
        builder, (first, end, step) = self.builder, ends
        first, end, certain = self.whole(first), self.whole(end), known(first) and known(end)
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
        """Walk a body while something is true."""
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
        """Call a kernel by its address."""
        kind = ir.FunctionType(ir.VoidType(), [argument.type for argument in arguments])
        self.builder.call(self.builder.inttoptr(address, kind.as_pointer()), arguments)

    # -- memory

    def room(self, kind: Any, shape: list[Any], value: Any, freed: list[Any]) -> Array:
        """Return an array of a function's own, all of one value unless that is None.

        What is to be freed when the function is left goes to a list, as a place of its address.
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
        # a size of 0 has an address, too
        least = self.multiply(max(size, 1) if known(size) else self.add(size, 1), 8)
        address = builder.call(malloc, [self.whole(least)])
        # an array that is made again in a loop takes the place of the one before
        builder.call(free, [builder.load(place)])
        builder.store(address, place)
        array = self.contiguous(builder.bitcast(address, kind.as_pointer()), shape)
        if value is not None:
            flat = Array(array.pointer, (size,), (1,))
            self.each(size, lambda k: self.store(flat, [k], value, 0))
        return array

    def each(self, count: Any, act: Callable[[Any], None]) -> None:
        """Act for each number below a count."""

        def body(number: Any, loop: Loop) -> bool:
            act(number)
            return False

        if not (known(count) and count == 0):
            self.loop((0, count, 1), body)

    def release(self, freed: list[Any]) -> None:
        """Free what a function had."""
        for place in freed[1:]:
            self.builder.call(freed[0], [self.builder.load(place)])

    # -- functions

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
