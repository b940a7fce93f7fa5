"""States that a run has stored, and what its steps were."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.results.outcome import Outcome
from symsimpson.results.states import States

__all__ = ["Stored"]


class Stored(Outcome, States):
    """Arrays and settings of a finished run, from which other quantities are computed.

    Attributes
    ----------
    newton_iterations : ndarray of int, shape (N + 1,)
    every : int or None
        Steps from one stored state to the next.
    input_values : ndarray, shape (1, steps, s, m)
        Inputs by step, node and number, of one run; an axis of one entry stands for all.
    variations : ndarray, shape (N + 1, 2 n, k), or None
    varied_by : tuple of str or None
        Names that ``variations`` are derivatives by; None for those of the program.
    recorded_values : tuple of pairs
        Names of what was recorded beside states, and arrays of shape (N + 1, k).
    reduced_values : tuple of pairs
        Names of observed quantities, and what they came to.
    tau_values : ndarray or None
        The variable in which steps are fixed, where it is not the time.
    begun : tuple of number and ndarray, shape (2, n), or None
        The time at the start, and q and p there, where the last state alone is stored.
    """

    newton_iterations: NDArray[np.int64]
    every: int | None
    input_values: NDArray[Any]
    variations: NDArray[Any] | None
    varied_by: tuple[str, ...] | None
    recorded_values: tuple[tuple[str, NDArray[Any]], ...]
    tau_values: NDArray[Any] | None
    begun: tuple[Any, NDArray[Any]] | None
    records: tuple[Any, ...]
    event_names: tuple[str, ...]
    ended_by: str | None

    @property
    def recorded(self) -> dict[str, NDArray[Any]]:
        """The sums requested by ``record``, by name, shape (N + 1, k) each."""
        return dict(self.recorded_values)
