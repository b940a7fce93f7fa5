"""Checks and conversion of numbers and arrays of the user. Invalid values raise InputError."""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.names import NameTable, is_masked, read_mapping, shortened

if TYPE_CHECKING:
    from symsimpson.program.numbers import Numbers


#: The largest number of steps: a float cannot count further exactly.
MOST_STEPS = 2**53


def read_vector(name: str, value: Any, coordinates: NameTable, numbers: Numbers) -> Reals:
    """Read one finite number for each coordinate, as a sequence in order or a mapping by name."""
    vector = read_array(name, coordinates.in_order(name, value), numbers)
    n = len(coordinates)
    if vector.shape != (n,):
        reject(
            f"{name} has shape {vector.shape}, expected ({n},): one number for each of "
            f"{', '.join(coordinates.shown)}.",
            remedy="Pass the numbers in the order of the declared coordinates, or by name: "
            f"{{{coordinates.shown[0]!r}: ...}}.",
        )
    if not numbers.all_finite(vector):
        where = coordinates.shown[int(np.argmin(numbers.finite(vector)))]
        reject(
            f"{name} is not finite for {where}: {value!r}.",
            remedy="A run must begin at a finite state. Check where this number comes from.",
        )
    return vector


def read_number(name: str, value: Any, numbers: Numbers) -> Any:
    """Read one finite real number."""
    if numbers.is_one(value):
        return value
    try:
        array = None if is_masked(value) else numbers.read(value)
    except (TypeError, ValueError, OverflowError):
        array = None
    if array is None or array.shape != () or not numbers.all_finite(array):
        reject(f"{name} is {shortened(value)}, not a finite real number.", remedy="Pass a number.")
    return array.item()


def read_array(name: str, value: Any, numbers: Numbers) -> Reals:
    """Read an array of real numbers of any shape."""
    if is_masked(value):
        reject(
            f"{name} has masked entries, which have no value.",
            remedy="Fill them, or remove these members with x.compressed() or "
            "x[~x.mask.any(axis=1)].",
        )
    try:
        return numbers.read(value)
    except (TypeError, ValueError, OverflowError):
        reject(
            f"{name} is {shortened(value)}, not real numbers.",
            remedy="Pass a list or an array of floats.",
        )


def read_count(name: str, value: Any, least: int) -> int:
    """Read a whole number of at least ``least``. Floats such as 1e6 are allowed."""
    whole = isinstance(value, float) and value.is_integer()
    number = int(value) if whole else whole_number(value)
    if number is None:
        reject(f"{name} is {value!r}, not a whole number.", remedy="Pass an int.")
    if not least <= number <= MOST_STEPS:
        reject(
            f"{name} is {number}, which is too {'small' if number < least else 'large'}.",
            remedy=f"Pass a whole number from {least} to 2**53.",
        )
    return number


def whole_number(value: Any) -> int | None:
    """Return a value as an int; None if it is a truth value or no whole number."""
    if type(value) is int:
        return value
    try:
        return None if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        return None


def read_parameters(
    names: NameTable,
    signs: tuple[str, ...],
    defaults: Reals,
    given: Mapping[Any, Any] | None,
    numbers: Numbers,
) -> Reals:
    """Return the values of all parameters, shape (m,): the defaults with the given values.

    ``signs`` has "positive", "negative" or another text for each parameter. Raises InputError for
    a value of the wrong sign.
    """
    values = defaults.copy()
    for slot, value in names.values_by_place(read_mapping("parameters", given, "m")).items():
        name = names.shown[slot]
        number = read_number(f"parameter {name}", value, numbers)
        if (signs[slot] == "positive" and number <= 0) or (
            signs[slot] == "negative" and number >= 0
        ):
            reject(
                f"parameter {name} is declared {signs[slot]}, but its value is {float(number):g}.",
                why="The equations were simplified with that sign.",
                remedy="Change the value or the declaration.",
            )
        values[slot] = number
    return values


def read_reals(what: str, given: Any, how: str) -> Floats:
    """Read real numbers in an array of any shape; ``how`` is the remedy of the message.

    Raises InputError for text, None, rows of unequal lengths and complex numbers. NumPy would
    discard the imaginary part.
    """
    try:
        array = np.asarray(given)
        # NumPy would convert texts to numbers, and None to NaN
        real = array.dtype.kind in "biuf" or (
            array.dtype.kind == "O" and not any(isinstance(x, str) or x is None for x in array.flat)
        )
        if real:
            return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):  # unequal rows, or objects that are no numbers
        array = None
    kind = "complex" if array is not None and array.dtype.kind == "c" else "not real"
    reject(f"{what} is {shortened(given)}: {kind}, where real numbers belong.", remedy=how)


def values_at(what: str, function: Callable[[Any], Any], times: Reals) -> Reals:
    """Evaluate a function of the user at times of any shape.

    The function gets all times in a single row. If that fails, it is called for each time. An
    exception of the function gets a note with the argument ``what`` and the time.
    """
    row, shape = times.ravel(), ()
    with contextlib.suppress(Exception):
        values = np.asarray(function(row))
        if (shape := values.shape) == row.shape:
            return values.reshape(times.shape)
    each = []
    for t in row:
        try:
            each.append(function(t))
        except Exception as error:
            if not shape:
                error.add_note(f"The function that is passed as {what} raised this at t={t}.")
                raise
        else:
            shape = np.shape(each[-1])
        if shape:
            reject(
                f"its function returns shape {shape}, not one number for each time.",
                where=what,
                remedy="Return a number for a time, or an array in the shape of the times.",
            )
    return np.array(each).reshape(times.shape)
