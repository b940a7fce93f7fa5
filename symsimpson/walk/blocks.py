"""Loops, branches, variables, tables and the workspace in LLVM."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir

from symsimpson.walk.values import BIT, DOUBLE, INT, Along, Refused, Values, known

__all__ = ["Blocks", "Slot"]


class Slot:
    """A variable that loops or branches change; the compiler turns it into a register."""

    def __init__(self, place: Any) -> None:
        self.place = place


class Blocks(Values):
    """Values with control flow, tables, and the workspace.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
    workspace : llvmlite value
        A pointer to doubles.
    lanes : int
        Numbers in a row of the workspace.
    """

    def __init__(self, builder: ir.IRBuilder, workspace: Any, lanes: int) -> None:
        super().__init__(builder)
        self._workspace, self.lanes = workspace, lanes
        self._tables: dict[int, tuple[Any, Any]] = {}

    # -- the workspace

    def load(self, place: tuple[Any, Any], width: int) -> Any:
        """Return what stands in a row, as a vector where the place counts its lanes."""
        number, along = self._place(*place)
        pointer = self._pointer(number, width if along else 0)
        found = self.builder.load(pointer)
        found.align = 8
        return found

    def store(self, place: tuple[Any, Any], value: Any, width: int) -> None:
        """Put a value into a row."""
        number, along = self._place(*place)
        value = self.real(value)
        if along:
            value = self.spread(value, width)
        elif isinstance(value.type, ir.VectorType):
            raise Refused("numbers of all lanes in one place")
        self.builder.store(value, self._pointer(number, width if along else 0)).align = 8

    def _place(self, row: Any, lane: Any) -> tuple[Any, bool]:
        if isinstance(row, Along):
            if self.lanes != 1:
                raise Refused("rows as lanes of a vector, where they have lanes of their own")
            return row.first, True
        if isinstance(lane, Along):
            return self.add(self.multiply(row, self.lanes), lane.first), True
        return self.add(self.multiply(row, self.lanes), lane), False

    def _pointer(self, place: Any, width: int) -> Any:
        pointer = self.builder.gep(self._workspace, [self.whole(place)], inbounds=True)
        if width:
            return self.builder.bitcast(pointer, ir.VectorType(DOUBLE, width).as_pointer())
        return pointer

    # -- tables

    def entry(self, table: Any, places: list[Any]) -> Any:
        """Return an entry of a table, an array or a tuple of numbers."""
        if all(known(place) for place in places):
            for place in places:
                table = table[int(place)]
            return table.item() if hasattr(table, "item") else table
        if any(isinstance(place, Along) for place in places):
            raise Refused("an entry of a table for each lane")
        made, shape = self._table(table)
        if len(shape) != len(places):
            raise Refused("a part of a table")
        flat: Any = 0
        for size, place in zip(shape, places, strict=True):
            flat = self.add(self.multiply(flat, size), place)
        return self.builder.load(self.builder.gep(made, [INT(0), self.whole(flat)], inbounds=True))

    def _table(self, table: Any) -> tuple[Any, tuple[int, ...]]:
        key = id(table)
        if key not in self._tables:
            array = np.asarray(table)
            kind = INT if array.dtype.kind in "iu" else DOUBLE
            numbers = [kind(x) for x in array.ravel().tolist()]
            module = self.builder.module
            name = module.get_unique_name(".table")
            made = ir.GlobalVariable(module, ir.ArrayType(kind, len(numbers)), name)
            made.initializer = ir.Constant(made.value_type, numbers)
            made.global_constant, made.linkage, made.unnamed_addr = True, "internal", True
            self._tables[key] = made, array.shape
        return self._tables[key]

    # -- variables

    def slot(self, value: Any, width: int) -> Slot:
        """Return a variable with this value."""
        if isinstance(value, (Along, tuple, list)):
            raise Refused("a variable of this kind, that a loop or a branch changes")
        if isinstance(value, bool):
            value = self.bit(value)
        elif known(value):
            value = self.whole(value) if isinstance(value, int) else self.real(value)
        if width and value.type == DOUBLE:
            value = self.spread(value, width)
        with self.builder.goto_entry_block():
            place = self.builder.alloca(value.type)
        self.builder.store(value, place)
        return Slot(place)

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
        builder, found, ends = self.builder, [], []
        blocks = [builder.append_basic_block(name) for name in ("yes", "no", "then")]
        builder.cbranch(truth, *blocks[:2])
        for block, way in zip(blocks, (yes, other), strict=False):
            builder.position_at_end(block)
            found.append(way())
            ends.append(builder.block)
        if all(known(x) for x in found):
            same = all(isinstance(x, int) for x in found)
            found = [self.whole(x) if same else self.real(x) for x in found]
        kinds = {x.type for x in found if not known(x)}
        for k, end in enumerate(ends):
            builder.position_at_end(end)
            if DOUBLE in kinds:
                found[k] = self.real(found[k])
            elif known(found[k]):
                found[k] = self.bit(found[k]) if kinds == {BIT} else self.whole(found[k])
            builder.branch(blocks[2])
        builder.position_at_end(blocks[2])
        result = builder.phi(found[0].type)
        for value, end in zip(found, ends, strict=True):
            result.add_incoming(value, end)
        return result

    def loop(self, ends: tuple[Any, Any, int], body: Callable[[Any], None]) -> None:
        """Walk a body that stays a loop."""
        builder, (first, end, step) = self.builder, ends
        first, end, certain = self.whole(first), self.whole(end), known(first) and known(end)
        inside = builder.append_basic_block("loop")
        after = builder.append_basic_block("after")
        sign = "<" if step > 0 else ">"
        before = builder.block
        if certain:
            builder.branch(inside)
        else:
            builder.cbranch(builder.icmp_signed(sign, first, end), inside, after)
        builder.position_at_end(inside)
        number = builder.phi(INT)
        number.add_incoming(first, before)
        body(number)
        following = builder.add(number, INT(step), flags=("nsw",))
        number.add_incoming(following, builder.block)
        builder.cbranch(builder.icmp_signed(sign, following, end), inside, after)
        builder.position_at_end(after)

    def exit_block(self) -> Any:
        """Return a block to which a function leaves."""
        return self.builder.append_basic_block("left")
