"""Whether all that moves along a solution has a mass: else no motion follows from forces."""

from __future__ import annotations

from typing import Any

import numpy as np

from symsimpson.control.constraint_rows import held_rates
from symsimpson.control.point_functions import PointFunctions
from symsimpson.support.array_types import Floats

__all__ = ["massive"]

#: With diagonals of 1, the mass matrix is singular where an eigenvalue is below this part.
NOTHING = 1e-9
#: So much what constraints forbid weighs beside masses.
HEAVY = 1e6


def massive(layout: Any, x: Floats) -> bool:
    """Return whether M is positive definite on what constraints allow, at the ends of steps.

    It may be singular at some of them, as at a pole of spherical angles, but nowhere negative.
    """
    read, n = layout.read, layout.n
    points = layout.points
    q = x[np.concatenate([points[:, 0], points[-1:, -1]])]
    count, v = len(q), np.zeros_like(q)
    at = {**layout.parameter_values(x), read.t: layout.grid.times(layout.sizes(x))}
    at |= dict(zip([*read.q, *read.v], [*q.T, *v.T], strict=True))
    rows = [*read.momenta, *held_rates(read)]
    slopes = PointFunctions(read.graph, read.v, rows).jacobian(at, count)
    slopes = slopes[np.isfinite(slopes).all(axis=(1, 2))]
    masses = np.abs(np.einsum("kii->ki", slopes[:, :n]))
    sizes = np.sqrt(np.where(masses > 0, masses, 1.0))
    slopes = slopes / sizes[:, None]
    mass, held = slopes[:, :n] / sizes[:, :, None], slopes[:, n:]
    lengths = np.linalg.norm(held, axis=2, keepdims=True)
    held = held / np.where(lengths > 0, lengths, 1.0)
    least = np.linalg.eigvalsh(mass + HEAVY * held.swapaxes(1, 2) @ held)[:, 0]
    return bool((least > -NOTHING).all() and (least > NOTHING).any())
