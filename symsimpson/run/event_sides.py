"""On which sides of zero the expressions of events are, and what of their values is rounding."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from symsimpson.module.interface import ZERO
from symsimpson.program.observed import FADED
from symsimpson.run.event_actions import EventActions
from symsimpson.support.array_types import Floats, State

__all__ = ["Sides"]


class Sides:
    """Sides of zero, and the sizes by which rounding is told, in rows of a workspace.

    ``side`` has the one on which each expression is, ``size`` its size of late.
    """

    def __init__(
        self, side: Floats, size: Floats, actions: EventActions, signs: Sequence[int]
    ) -> None:
        self.side, self.size = side, size
        self._actions, self._signs = actions, np.array(signs)

    @property
    def small(self) -> Floats:
        """Values below these are zeros: rounding."""
        return ZERO * self.size

    def small_at(self, t: float, state: State) -> Floats:
        """Return below what a value is a zero, where time and state are rounded."""
        return np.maximum(self.small, self._actions.rounding(t, state))

    def faded(self, row: Floats, q: Floats) -> Floats:
        """Return sizes behind a step: those of terms, or what is left of those before."""
        left = np.where(self._actions.impacts, 1.0, FADED) * self.size
        return np.fmax(left, self._actions.sizes(row, q))

    def of(self, values: Floats, small: Floats, before: Floats | None = None) -> Floats:
        """Return on which sides of zero values are; near it they stay where they were."""
        before = self.side if before is None else before
        return np.where(values > small, 1.0, np.where(values < -small, -1.0, before))

    def acts(self, behind: Floats) -> NDArray[np.bool_]:
        """Return which events act as sides change to others."""
        changed = self.side * behind < 0
        return np.asarray(changed & ((self._signs == 0) | (behind == self._signs)))
