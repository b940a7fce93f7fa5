"""Arrays: a pointer, a shape and strides, of which some are known while a text is walked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from symsimpson.walk.values import BIT, DOUBLE, INT, LaneNumber, Refused, Values, known

__all__ = ["BYTE", "Array", "Arrays", "Range"]

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
