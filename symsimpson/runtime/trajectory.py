"""The result of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.runtime.status import Status

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["Trajectory"]


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Trajectory:
    """States of a run, and how it ended.

    Numbers are float64, or numbers of mpmath in arrays of objects where the stepper was compiled
    with a ``precision``.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        Times of the stored states.
    q, p : ndarray, shape (N + 1, n)
        Positions and conjugate momenta.
    newton_iterations : ndarray of int, shape (N + 1,)
        Iterations since the state stored before; 0 for the first.
    h : number
        The step.
    steps : int
        Steps done.
    status : Status
        0 is success.
    message : str
        The outcome in words.
    """

    t: NDArray[Any]
    q: NDArray[Any]
    p: NDArray[Any]
    newton_iterations: NDArray[np.int64]
    h: Any
    steps: int
    status: Status
    message: str
    _stepper: Stepper = field(repr=False)
    _values: NDArray[Any] = field(repr=False)

    def __init__(self, **fields: Any) -> None:
        self.__dict__.update(fields)  # a quarter of the time that setting each takes

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters that the run used, by name."""
        return dict(zip(self._stepper.parameters, self._values.tolist(), strict=True))

    @cached_property
    def energy(self) -> NDArray[Any]:
        """H at the stored states, shape (N + 1,); computed when first asked for."""
        return self._evaluated("energy", "ENERGY", 1)[:, 0]

    @cached_property
    def energy_error(self) -> NDArray[Any]:
        """(H - H0)/|H0|, or H - H0 where H0 = 0; shape (N + 1,)."""
        change = self.energy - self.energy[0]
        start = abs(self.energy[0])
        return change / start if start > 0 else change

    @cached_property
    def invariants(self) -> dict[str, NDArray[Any]]:
        """The system's named invariants at the stored states, each of shape (N + 1,)."""
        names = self._stepper.invariants
        if not names:
            return {}
        found = self._evaluated("invariants", "INVARIANT", len(names))
        return {name: found[:, i] for i, name in enumerate(names)}

    def _evaluated(self, kernel: str, block: str, count: int) -> NDArray[Any]:
        from symsimpson.runtime.evaluate import evaluate

        return evaluate(self._stepper, kernel, block, count, self.q, self.p, self._values)

    def __len__(self) -> int:
        return self.t.size

    def __repr__(self) -> str:
        stepper = self._stepper
        return (
            f"Trajectory({stepper.system}, {stepper.scheme}: {self.steps} steps of "
            f"h={float(self.h):g}, {self.t.size} states stored, {self.status.name})"
        )
