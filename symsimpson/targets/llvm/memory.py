"""Arrays, and rows of a workspace, as values of the walker."""

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
    Refused,
    Values,
    known,
)

#: Truths fill a byte each.
BYTE = ir.IntType(8)


@dataclass(frozen=True)
class Array:
    """Numbers of one kind in memory."""

    pointer: Any  #: A value of llvmlite.
    shape: tuple[Any, ...]
    strides: tuple[Any, ...]  #: In numbers.
    #: Whether what stands in it is kept as values, as long as nobody else looks at it.
    values: bool = False

    @property
    def size(self) -> Any:
        """Length of the only axis."""
        if len(self.shape) != 1:
            raise Refused("the size of an array of several axes")
        return self.shape[0]


@dataclass(frozen=True)
class Range:
    """A range of places; to the end where that is None."""

    first: Any
    end: Any


class Arrays(Values):
    """Values, and arrays of them."""

    def load(self, array: Array, places: list[Any], width: int) -> Any:
        """Return a number, or part of an array where there are fewer places, or ranges.

        Where a place counts the lanes of a vector, all lanes are loaded.
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
        """Put a number into an array, or a vector along it."""
        pointer, along = self._pointer(array, places, width)
        kind = pointer.type.pointee
        if kind == BYTE:
            value = self.builder.zext(self.bit(value), BYTE)
        elif kind == INT:
            value = self.whole(value)
        else:
            value = self.real(value)
            if along:
                value = self.spread(value, width)
            elif isinstance(value.type, ir.VectorType):
                raise Refused("numbers of all lanes in one place")
        instruction = self.builder.store(value, pointer)
        if kind not in (BYTE, INT):
            instruction.align = 8

    def contiguous(self, pointer: Any, shape: Sequence[Any]) -> Array:
        """Return an array whose numbers stand one behind another, row by row."""
        strides: list[Any] = [1]
        for size in reversed(shape[1:]):
            strides.insert(0, self.multiply(strides[0], size))
        return Array(pointer, tuple(shape), tuple(strides))

    def _pointer(self, array: Array, places: list[Any], width: int) -> tuple[Any, bool]:
        number: Any = 0
        for place, size, stride in zip(places, array.shape, array.strides, strict=True):
            if known(place) and place < 0:
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
        """Return a part of an array."""
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


#: Vectors have no more lanes.
MOST_ROWS = 16


class BlockBuilder(ir.IRBuilder):
    """A builder that lets somebody act before a block ends."""

    def __init__(self, block: Any) -> None:
        super().__init__(block)
        self.before_end: Callable[[], None] = lambda: None

    def branch(self, target: Any) -> Any:
        """Go to another block."""
        self.before_end()
        return super().branch(target)

    def cbranch(self, cond: Any, truebr: Any, falsebr: Any) -> Any:
        """Go to one of two blocks."""
        self.before_end()
        return super().cbranch(cond, truebr, falsebr)

    def ret_void(self) -> Any:
        """Leave the function."""
        self.before_end()
        return super().ret_void()


@dataclass(frozen=True)
class _Row:
    """The value of a row, or of as many as a vector has lanes; what stores it, if that is due."""

    value: Any
    rows: int
    due: Callable[[], None] | None = None


class Rows(Arrays):
    """Arrays, of which the rows of some are values."""

    def __init__(self, builder: ir.IRBuilder, flags: tuple[str, ...]) -> None:
        super().__init__(builder, flags)
        self._rows: dict[int, _Row] = {}
        self._block: Any = None
        #: Tells of a place whether what was put there may still be asked for.
        self.wanted: Callable[[int], bool] = lambda place: True
        if isinstance(builder, BlockBuilder):
            builder.before_end = self._end

    def load(self, array: Array, places: list[Any], width: int) -> Any:
        """Return a number, or part of an array where there are fewer places, or ranges."""
        if isinstance(places[0], PrivateRow):
            return self.builder.load(self._place_of(places[0]))
        first, rows = self._range(array, places, width)
        if first is None:
            if array.values:
                self._settle()
            return super().load(array, places, width)
        value = self._from_others(first, rows)
        if value is None:
            self._settle(self._overlapping(first, rows))
            value = super().load(array, places, width)
            self._rows[first] = _Row(value, rows)
        return value

    def _from_others(self, first: int, rows: int) -> Any:
        """Return rows that are values: by themselves, of a vector, or each for itself; or None."""
        near = self._overlapping(first, rows)
        match near:
            case [(place, row)] if row.rows == rows and place == first:
                return row.value
            case [(place, row)] if rows == 1:
                return row.value if known(row.value) else self.element(row.value, first - place)
        if len(near) == rows and all(row.rows == 1 for _, row in near):
            return self.joined([self.real(row.value) for _, row in near])
        return None

    def store(self, array: Array, places: list[Any], value: Any, width: int) -> None:
        """Put a number into an array, or a vector along it."""
        if isinstance(places[0], PrivateRow):
            self.builder.store(self.spread(self.real(value), width), self._place_of(places[0]))
            return
        first, rows = self._range(array, places, width)
        store = super().store
        if first is None:
            if array.values:
                self._settle()
                self._rows.clear()
            store(array, places, value, width)
            return
        value = float(value) if known(value) else self.real(value)
        for place, row in self._overlapping(first, rows):
            if row.due and not (first <= place and place + row.rows <= first + rows):
                row.due()
            del self._rows[place]
        if rows > 1 or known(value) or value.type == DOUBLE:
            self._rows[first] = _Row(value, rows, lambda: store(array, places, value, width))
        else:
            store(array, places, value, width)

    def own_rows(self, rows: int, width: int) -> PrivateRow:
        """Return the first of so many rows of each lane."""
        with self.builder.goto_entry_block():
            return PrivateRow(self.builder.alloca(ir.VectorType(DOUBLE, width), INT(rows)), rows, 0)

    def _place_of(self, row: PrivateRow) -> Any:
        if known(row.place) and not 0 <= row.place < row.rows:
            raise Refused("a row outside of its block")
        return self.builder.gep(row.memory, [self.whole(row.place)], inbounds=True)

    def _range(self, array: Array, places: list[Any], width: int) -> tuple[int | None, int]:
        """Return the first number that is meant, and how many; None if it is not known."""
        if not array.values or len(places) != len(array.strides):
            return None, 0
        if self.builder.block is not self._block:
            assert not any(row.due for row in self._rows.values())
            self._rows.clear()
            self._block = self.builder.block
        number: Any = 0
        for place, stride in zip(places, array.strides, strict=True):
            if isinstance(place, LaneNumber):
                place = place.first if stride == 1 else None
            if not known(place):
                return None, 0
            number += place * stride
        return int(number), width if any(isinstance(x, LaneNumber) for x in places) else 1

    def _end(self) -> None:
        """Store, where a block ends, what may still be asked for."""
        self._settle([(place, row) for place, row in self._rows.items() if self.wanted(place)])
        self._rows.clear()

    def _overlapping(self, first: int, rows: int) -> list[tuple[int, _Row]]:
        """List the rows that share numbers with so many from a first one on."""
        near = range(first - MOST_ROWS + 1, first + rows)
        candidates = [(place, self._rows[place]) for place in near if place in self._rows]
        return [(place, row) for place, row in candidates if place + row.rows > first]

    def _settle(self, rows: list[tuple[int, _Row]] | None = None) -> None:
        """Store what is not stored yet, of all rows or of some."""
        for place, row in list(self._rows.items()) if rows is None else rows:
            if row.due:
                row.due()
                self._rows[place] = _Row(row.value, row.rows)
