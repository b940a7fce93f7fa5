"""Where the points and bodies of a system are, as numbers."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import sympy as sp

from symsimpson.mechanics.coordinates import time
from symsimpson.mechanics.declared import Declared
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.literals import float_literals

__all__ = ["points_of"]


def points_of(system: Declared, t: Reals, q: Reals, values: Reals) -> dict[str, Floats]:
    """Evaluate the positions that were declared with a system, at t of shape (...), q (..., n).

    They are of shape (..., 2) or (..., 3) for a point, (..., corners, 2 or 3) for a body; there are
    none if no positions were declared.
    """
    positions = system.positions or {}
    columns = [np.asarray(x, dtype=np.float64) for x in (t, q, values)]
    numbers = [columns[0], *(x[..., k] for x in columns[1:] for k in range(x.shape[-1]))]
    shape = columns[1].shape[:-1]
    points = {}
    # by what is computed: systems are equal whatever points they declare
    arguments = (time, *system.coordinates, *system.parameters)
    places = _function(arguments, tuple(positions.values()))(*numbers) if positions else []
    for (name, given), corners in zip(positions.items(), places, strict=True):
        rows = [
            np.stack([np.broadcast_to(axis, shape) for axis in corner], axis=-1)
            for corner in corners
        ]
        single = not isinstance(given[0], tuple)
        points[name] = np.asarray(rows[0] if single else np.stack(rows, axis=-2), dtype=np.float64)
    return points


@lru_cache(maxsize=64)
def _function(arguments: tuple[sp.Basic, ...], positions: tuple[Any, ...]) -> Callable[..., Any]:
    """Return a function of t, positions and parameters that gives all axes of all corners.

    It is one for all points, of symbols that are names in Python: others would be replaced one by
    one, in all expressions.
    """
    plain = {x: sp.Symbol(f"x_{k}") for k, x in enumerate(arguments)}
    corners = [
        [
            [x.xreplace(plain) for x in corner]
            for corner in (given if isinstance(given[0], tuple) else [given])
        ]
        for given in positions
    ]
    function: Callable[..., Any] = sp.lambdify([*plain.values()], float_literals(corners), "numpy")
    return function
