"""Quantities of the orbits of a family, by name."""

from __future__ import annotations

from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.study.orbits.boundary_path import ENERGY, PERIOD
from symsimpson.support.array_types import Floats
from symsimpson.support.names import did_you_mean


def quantity(family: Any, key: str) -> Floats:
    """Return a quantity of all orbits of a family; see :meth:`Family.__getitem__`."""
    names, parameters = family.search.stepper.coordinates, family.search.stepper.parameters
    if key in names:
        return np.array([x.q0[names.index(key)] for x in family])
    if key.removeprefix("p_") in names:
        return np.array([x.p0[names.index(key.removeprefix("p_"))] for x in family])
    if key in parameters:
        return np.array([x.values[parameters.index(key)] for x in family])
    if key == "stability":
        return np.array([abs(x.multipliers).max(initial=1.0) for x in family])
    if key in (PERIOD, ENERGY):
        return np.array([getattr(x, key) for x in family])
    known = [PERIOD, ENERGY, "stability", *parameters, *names, *(f"p_{x}" for x in names)]
    reject(
        f"a family has no quantity {key!r}.{did_you_mean(key, known)}",
        remedy=f"Choose from {', '.join(known)}.",
    )
