"""Units of quantities, as labels: nothing is converted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from symsimpson.errors import ModelError
from symsimpson.module.quantity import SCALARS
from symsimpson.support.names import did_you_mean, spelled

__all__ = ["NO_UNITS", "read_units"]

NO_UNITS: Mapping[Any, str] = MappingProxyType({})


def read_units(
    name: str, given: Mapping[Any, Any] | None, coordinates: Iterable[Any], others: Iterable[Any]
) -> dict[str, str]:
    """Read units by name, and add those of velocities.

    ``given`` are units by names or symbols, ``others`` further quantities that a system has:
    parameters, inputs, invariants, points. Raises ModelError if a name is none of these, or a unit
    is no text.
    """
    names = [spelled(q) for q in coordinates]
    known = [*names, *(f"{x}_{q}" for x in "vp" for q in names), *map(spelled, others), "t"]
    known += [x.name for x in SCALARS]
    units: dict[str, str] = {}
    if given is not None and not isinstance(given, Mapping):
        raise ModelError(
            f"system '{name}': units is {type(given).__name__}, no mapping.\n"
            "Units are labels: units={'x': 'm', 't': 's'}."
        )
    for key, unit in (given or {}).items():
        quantity = spelled(key)
        if quantity not in known:
            raise ModelError(
                f"system '{name}': units names {quantity!r}, which the system does not have."
                f"{did_you_mean(quantity, known)}\n"
                "Name coordinates, momenta and velocities (p_ and v_ before a coordinate), "
                f"parameters, invariants, points, 't', {', '.join(x.name for x in SCALARS)}."
            )
        if quantity in units:
            raise ModelError(
                f"system '{name}': units gives {quantity} twice, by name and by symbol.\n"
                "Give it once."
            )
        if not isinstance(unit, str):
            raise ModelError(
                f"system '{name}': the unit of {quantity} is {unit!r}, no text.\n"
                "Units are labels: units={'x': 'm', 't': 's'}."
            )
        units[quantity] = unit
    if "t" in units:
        for q in names:
            if q in units:
                units.setdefault(f"v_{q}", f"{units[q]}/{units['t']}")
    for scalar in SCALARS:
        if scalar.like in units:
            units.setdefault(scalar.name, units[scalar.like])
    return units
