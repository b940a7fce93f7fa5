"""States and values of parameters that the functions of a system are given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.mechanics.declared import Declared
from symsimpson.support.array_types import Floats
from symsimpson.support.names import Named, is_masked, read_mapping, spelled

__all__ = ["read_values", "read_vector"]


def read_vector(system: Declared, name: str, given: Any) -> Floats:
    """Read a number for each coordinate, in order or by name; raises InputError."""
    table = Named("coordinate", [spelled(q) for q in system.coordinates])
    try:
        ordered = table.in_order(name, given)
        vector = np.array(None if is_masked(ordered) else ordered, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        vector = np.empty(0)
    if vector.shape != (system.n,) or not np.isfinite(vector).all():
        raise InputError(
            f"{name} is {given!r}, not {system.n} finite numbers, one for each of "
            f"{', '.join(table.shown)}."
        )
    return vector


def read_values(
    name: str, what: str, defaults: Mapping[Any, Any], given: Mapping[Any, Any] | None
) -> list[float]:
    """Read values by symbol or by name, in place of defaults, in their order; raises InputError."""
    table = Named(what, [spelled(key) for key in defaults])
    values = [float(x) for x in defaults.values()]
    for place, value in table.by_place(read_mapping(name, given, what[0]), name).items():
        try:
            values[place] = np.nan if is_masked(value) else float(value)
        except (TypeError, ValueError, OverflowError):
            values[place] = np.nan
        if not np.isfinite(values[place]):
            raise InputError(
                f"{name}: the {what} {table.shown[place]} is {value!r}, not a finite number.\n"
                "Pass a number."
            )
    return values
