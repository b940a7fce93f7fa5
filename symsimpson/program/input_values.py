"""Numbers and arrays as users give them, read and checked."""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.names import Named, is_masked, read_mapping, shortened

if TYPE_CHECKING:
    from symsimpson.program.numbers import Numbers


#: More steps than this cannot be counted exactly in a float.
MOST_STEPS = 2**53


def read_vector(name: str, value: Any, coordinates: Named, numbers: Numbers) -> Reals:
    """Read one finite number for each coordinate: in their order, or a mapping by name."""
    vector = read_array(name, coordinates.in_order(name, value), numbers)
    n = len(coordinates)
    if vector.shape != (n,):
        reject(
            f"{name} has shape {vector.shape}, expected ({n},): one number for each of "
            f"{', '.join(coordinates.shown)}.",
            remedy="The order is that of the coordinates in the "
            f"declaration; or name them: {{{coordinates.shown[0]!r}: ...}}.",
        )
    if not numbers.all_finite(vector):
        where = coordinates.shown[int(np.argmin(numbers.finite(vector)))]
        reject(
            f"{name} is not finite for {where}: {value!r}.",
            remedy="A run must begin at a finite state. Look where the number comes from.",
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
            remedy="Fill them, or leave these members out: x.compressed(), x[~x.mask.any(axis=1)].",
        )
    try:
        return numbers.read(value)
    except (TypeError, ValueError, OverflowError):
        reject(
            f"{name} is {shortened(value)}, not real numbers.",
            remedy="Pass a list or an array of floats.",
        )


def read_count(name: str, value: Any, least: int) -> int:
    """Read a whole number, which may be written as 1e6."""
    whole = isinstance(value, float) and value.is_integer()
    number = int(value) if whole else whole_number(value)
    if number is None:
        reject(f"{name} is {value!r}, not a whole number.", remedy="Pass an int.")
    if not least <= number <= MOST_STEPS:
        reject(f"{name} is {number}.", remedy=f"Pass a whole number from {least} to 2**53.")
    return number


def whole_number(value: Any) -> int | None:
    """Return an int, None for what is no whole number; truth values are none."""
    if type(value) is int:
        return value
    try:
        return None if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        return None


def read_parameters(
    names: Named,
    signs: tuple[str, ...],
    defaults: Reals,
    given: Mapping[Any, Any] | None,
    numbers: Numbers,
) -> Reals:
    """Merge run-time values, by symbol or by name, into the defaults."""
    values = defaults.copy()
    for slot, value in names.by_place(read_mapping("parameters", given, "m")).items():
        name = names.shown[slot]
        number = read_number(f"parameter {name}", value, numbers)
        if (signs[slot] == "positive" and number <= 0) or (
            signs[slot] == "negative" and number >= 0
        ):
            reject(
                f"parameter {name} is declared {signs[slot]} and given as {float(number):g}.",
                remedy="The equations were simplified with that sign. "
                "Change the value or the declaration.",
            )
        values[slot] = number
    return values


def read_reals(what: str, given: Any, how: str) -> Floats:
    """Read real numbers in an array of any shape.

    Raises InputError if they are none: text, nothing, rows of unequal lengths, complex numbers, of
    which NumPy would drop a part; ``how`` says what to do.
    """
    try:
        array = np.asarray(given)
        # NumPy makes numbers of texts, and NaN of None
        real = array.dtype.kind in "biuf" or (
            array.dtype.kind == "O" and not any(isinstance(x, str) or x is None for x in array.flat)
        )
        if real:
            return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):  # of rows, and of objects that are no numbers
        array = None
    kind = "complex" if array is not None and array.dtype.kind == "c" else "not real"
    reject(f"{what} is {shortened(given)}: {kind}, where real numbers belong.", remedy=f"{how}")


def values_at(what: str, function: Callable[[Any], Any], times: Reals) -> Reals:
    """Evaluate a function at times of any shape, which it gets in one row.

    A function that takes single numbers alone is called at each time. Its errors get a note.
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
                f"{what}: its function gives shape {shape} where one number for each time belongs.",
                remedy="Return a number for a time, or an array in the shape of the times.",
            )
    return np.array(each).reshape(times.shape)
