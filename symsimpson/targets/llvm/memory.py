"""Arrays and rows of the workspace, with rows cached as values within a basic block."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from symsimpson.targets.llvm.values import (
    BIT,
    DOUBLE,
    INT,
    LaneNumber,
    PrivateRow,
    UnsupportedConstruct,
    Values,
    is_known,
)

#: Type of truth values in memory.
BYTE = ir.IntType(8)


@dataclass(frozen=True)
class Array:
    """An array of numbers of one type in memory."""

    pointer: Any  #: A value of llvmlite.
    shape: tuple[Any, ...]
    strides: tuple[Any, ...]  #: In numbers.
    #: True if its rows are cached as values, and stored at the end of a basic block.
    values: bool = False

    @property
    def size(self) -> Any:
        """Length of a one-dimensional array."""
        if len(self.shape) != 1:
            raise UnsupportedConstruct("the size of an array of several axes")
        return self.shape[0]


@dataclass(frozen=True)
class Range:
    """A slice of an axis; the end None means the end of the axis."""

    first: Any
    end: Any


class Arrays(Values):
    """Values, and arrays in memory."""

    def load(self, array: Array, places: list[Any], width: int) -> Any:
        """Load a number or a vector, or return a part of an array.

        The result is a part if there are fewer ``places`` than axes, or one of them is a range. It
        is a vector if a place is a lane number.
        """
        if len(places) < len(array.shape) or any(isinstance(x, Range) for x in places):
            return self._part(array, places)
        pointer, _ = self._pointer(array, places, width)
        value = self.builder.load(pointer)
        if value.type == BYTE:
            return self.builder.trunc(value, BIT)
        if value.type != INT:
            value.align = 8
        return value

    def store(self, array: Array, places: list[Any], value: Any, width: int) -> None:
        """Store a number, or a vector along the axis whose place is a lane number."""
        pointer, along = self._pointer(array, places, width)
        kind = pointer.type.pointee
        if kind == BYTE:
            value = self.builder.zext(self.bit(value), BYTE)
        elif kind == INT:
            value = self.whole(value)
        else:
            value = self.real(value)
            if along:
                value = self.broadcast(value, width)
            elif isinstance(value.type, ir.VectorType):
                raise UnsupportedConstruct("numbers of all lanes in one place")
        instruction = self.builder.store(value, pointer)
        if kind not in (BYTE, INT):
            instruction.align = 8

    def contiguous(self, pointer: Any, shape: Sequence[Any]) -> Array:
        """Return a contiguous array in row-major order."""
        strides: list[Any] = [1]
        for size in reversed(shape[1:]):
            strides.insert(0, self.multiply(strides[0], size))
        return Array(pointer, tuple(shape), tuple(strides))

    def _pointer(self, array: Array, places: list[Any], width: int) -> tuple[Any, bool]:
        number: Any = 0
        for place, size, stride in zip(places, array.shape, array.strides, strict=True):
            if is_known(place) and place < 0:
                place = self.add(size, place)
            number = self.add(number, self.multiply(place, stride))
        along = isinstance(number, LaneNumber)
        first = number.first if isinstance(number, LaneNumber) else number
        pointer = self.builder.gep(array.pointer, [self.whole(first)], inbounds=True)
        if along:
            vector = ir.VectorType(DOUBLE, width)
            pointer = self.builder.bitcast(pointer, vector.as_pointer())
        return pointer, along

    def _part(self, array: Array, places: list[Any]) -> Array:
        """Return a view of a part of an array."""
        number: Any = 0
        shape, strides = [], []
        whole = [Range(0, None)] * (len(array.shape) - len(places))
        for place, size, stride in zip([*places, *whole], array.shape, array.strides, strict=True):
            first = place
            if isinstance(place, Range):
                first = place.first
                shape.append(self.subtract(size if place.end is None else place.end, first))
                strides.append(stride)
            number = self.add(number, self.multiply(first, stride))
        pointer = self.builder.gep(array.pointer, [self.whole(number)], inbounds=True)
        return Array(pointer, tuple(shape), tuple(strides))


#: The largest number of lanes of a vector.
MOST_ROWS = 16


class BlockBuilder(ir.IRBuilder):
    """A builder that calls ``before_end`` before it ends a basic block."""

    def __init__(self, block: Any) -> None:
        super().__init__(block)
        self.before_end: Callable[[], None] = lambda: None

    def branch(self, target: Any) -> Any:
        """Emit a jump to another block."""
        self.before_end()
        return super().branch(target)

    def cbranch(self, cond: Any, truebr: Any, falsebr: Any) -> Any:
        """Emit a conditional jump to one of two blocks."""
        self.before_end()
        return super().cbranch(cond, truebr, falsebr)

    def ret_void(self) -> Any:
        """Emit a return from the function."""
        self.before_end()
        return super().ret_void()


@dataclass(frozen=True)
class _Row:
    """The cached value of a row, or of adjacent rows as a vector, and its pending store."""

    value: Any
    rows: int
    pending_store: Callable[[], None] | None = None


class Rows(Arrays):
    """Arrays with a cache for the rows of the workspace."""

    def __init__(self, builder: ir.IRBuilder, flags: tuple[str, ...]) -> None:
        super().__init__(builder, flags)
        self._rows: dict[int, _Row] = {}
        self._block: Any = None
        #: Returns True for a place if a later statement may read it.
        self.is_live: Callable[[int], bool] = lambda place: True
        if isinstance(builder, BlockBuilder):
            builder.before_end = self._flush_block

    def load(self, array: Array, places: list[Any], width: int) -> Any:
        """Load like :meth:`Arrays.load`, from the cache if possible."""
        if isinstance(places[0], PrivateRow):
            return self.builder.load(self._place_of(places[0]))
        first, rows = self._range(array, places, width)
        if first is None:
            if array.values:
                self._flush()
            return super().load(array, places, width)
        value = self._cached_value(first, rows)
        if value is None:
            self._flush(self._overlapping(first, rows))
            value = super().load(array, places, width)
            self._rows[first] = _Row(value, rows)
        return value

    def _cached_value(self, first: int, rows: int) -> Any:
        """Return cached rows: an equal range, an element of a vector, or single rows; or None."""
        near = self._overlapping(first, rows)
        match near:
            case [(place, row)] if row.rows == rows and place == first:
                return row.value
            case [(place, row)] if rows == 1:
                return row.value if is_known(row.value) else self.element(row.value, first - place)
        if len(near) == rows and all(row.rows == 1 for _, row in near):
            return self.build_vector([self.real(row.value) for _, row in near])
        return None

    def store(self, array: Array, places: list[Any], value: Any, width: int) -> None:
        """Store like :meth:`Arrays.store`; doubles stay in the cache until the block ends."""
        if isinstance(places[0], PrivateRow):
            self.builder.store(self.broadcast(self.real(value), width), self._place_of(places[0]))
            return
        first, rows = self._range(array, places, width)
        store = super().store
        if first is None:
            if array.values:
                self._flush()
                self._rows.clear()
            store(array, places, value, width)
            return
        value = float(value) if is_known(value) else self.real(value)
        for place, row in self._overlapping(first, rows):
            if row.pending_store and not (first <= place and place + row.rows <= first + rows):
                row.pending_store()
            del self._rows[place]
        if rows > 1 or is_known(value) or value.type == DOUBLE:
            self._rows[first] = _Row(value, rows, lambda: store(array, places, value, width))
        else:
            store(array, places, value, width)

    def private_rows(self, rows: int, width: int) -> PrivateRow:
        """Allocate private rows for each lane on the stack, and return the first of them."""
        with self.builder.goto_entry_block():
            return PrivateRow(self.builder.alloca(ir.VectorType(DOUBLE, width), INT(rows)), rows, 0)

    def _place_of(self, row: PrivateRow) -> Any:
        if is_known(row.place) and not 0 <= row.place < row.rows:
            raise UnsupportedConstruct("a row outside its block")
        return self.builder.gep(row.memory, [self.whole(row.place)], inbounds=True)

    def _range(self, array: Array, places: list[Any], width: int) -> tuple[int | None, int]:
        """Return the first number and the count of an access; the first is None if unknown."""
        if not array.values or len(places) != len(array.strides):
            return None, 0
        if self.builder.block is not self._block:
            assert not any(row.pending_store for row in self._rows.values())
            self._rows.clear()
            self._block = self.builder.block
        number: Any = 0
        for place, stride in zip(places, array.strides, strict=True):
            if isinstance(place, LaneNumber):
                place = place.first if stride == 1 else None
            if not is_known(place):
                return None, 0
            number += place * stride
        return int(number), width if any(isinstance(x, LaneNumber) for x in places) else 1

    def _flush_block(self) -> None:
        """Store the cached rows that later statements may read, and clear the cache."""
        self._flush([(place, row) for place, row in self._rows.items() if self.is_live(place)])
        self._rows.clear()

    def _overlapping(self, first: int, rows: int) -> list[tuple[int, _Row]]:
        """List the cached rows that overlap with ``rows`` numbers from ``first``."""
        near = range(first - MOST_ROWS + 1, first + rows)
        candidates = [(place, self._rows[place]) for place in near if place in self._rows]
        return [(place, row) for place, row in candidates if place + row.rows > first]

    def _flush(self, rows: list[tuple[int, _Row]] | None = None) -> None:
        """Execute the pending stores of some rows, or of all."""
        for place, row in list(self._rows.items()) if rows is None else rows:
            if row.pending_store:
                row.pending_store()
                self._rows[place] = _Row(row.value, row.rows)
