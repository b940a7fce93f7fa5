"""Large angles: a start many turns away is the same start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper

__all__ = ["Turned", "turned"]


@dataclass(frozen=True)
class Turned:
    """A run from an angle that is some million radians away.

    Attributes
    ----------
    angle : float
        By how much the start is turned.
    difference : float
        Largest difference of the states, less the turn, to the run from the plain start.
    resolution : float
        Spacing of floating-point numbers at that angle.
    energy : float
        Difference of the largest relative energy errors.
    """

    angle: float
    difference: float
    resolution: float
    energy: float


def turned(
    stepper: Stepper, coordinate: int, turns: int, *, h: float, steps: int, state: Mapping[str, Any]
) -> Turned:
    """Integrate from a start and from the same start many turns away."""
    plain = stepper.integrate(**state, h=h, steps=steps)
    moved: dict[str, Any] = {key: np.array(value, dtype=np.float64) for key, value in state.items()}
    angle = 2 * np.pi * turns
    moved["q0"][coordinate] += angle
    far = stepper.integrate(**moved, h=h, steps=steps)
    turn = np.zeros(stepper.n)
    turn[coordinate] = far.q[0, coordinate] - plain.q[0, coordinate]
    energy = abs(np.abs(far.energy_error).max() - np.abs(plain.energy_error).max())
    difference = float(np.abs(far.q - turn - plain.q).max())
    resolution = float(np.spacing(abs(angle) + np.abs(plain.q).max()))
    return Turned(angle, difference, resolution, float(energy))
