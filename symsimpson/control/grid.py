"""The grid of a motion: phases, whose durations may be found, in equal steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.program.input_values import whole_number
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.names import shortened

__all__ = ["Grid", "read_grid"]

#: With more the solver, which counts entries in 32 bits, or the memory comes to its end.
MOST_STEPS = 1_000_000


@dataclass(frozen=True)
class Grid:
    """Phases one after the other, each in equal steps."""

    steps: tuple[int, ...]  #: The number of steps of each phase.

    @property
    def count(self) -> int:
        """Number of steps."""
        return sum(self.steps)

    @cached_property
    def phase(self) -> Ints:
        """The phase of each step, shape (N,)."""
        return np.repeat(np.arange(len(self.steps)), self.steps)

    @property
    def slices(self) -> list[slice]:
        """The steps of each phase."""
        ends = np.cumsum(self.steps).tolist()
        return [slice(end - n, end) for end, n in zip(ends, self.steps, strict=True)]

    @property
    def halved(self) -> Grid:
        """The same phases in steps of half the size."""
        return Grid(tuple(2 * n for n in self.steps))

    def before(self, k: Ints, place: Floats) -> Floats:
        """Return how many steps of each phase lie before places in steps, shape (..., phases).

        The time at a place is that times the sizes of steps.
        """
        offset = k[..., None] - [steps.start for steps in self.slices]
        within = (offset >= 0) & (offset < self.steps)
        return np.asarray(np.clip(offset, 0, self.steps) + within * place[..., None])

    def times(self, sizes: Floats) -> Floats:
        """Return the times of the ends of steps, shape (N + 1,), for the size of each phase's."""
        return np.asarray(self.before(np.arange(self.count + 1), np.zeros(self.count + 1)) @ sizes)


def read_grid(steps: Any, phases: int, most: int = MOST_STEPS) -> Grid:
    """Read a number of steps, ``most`` in all, or one for each phase.

    Raises InputError if it is neither.
    """
    several = isinstance(steps, (tuple, list)) or (isinstance(steps, np.ndarray) and steps.ndim > 0)
    given = [whole_number(n) or 0 for n in (steps if several else [steps])]
    if not given or min(given) < 1 or sum(given) > most:
        raise InputError(
            f"steps is {shortened(steps)}.\nPass a whole number of steps, at least 1 and at most "
            f"{most}; or one for each phase."
        )
    if len(given) == 1:
        size, more = divmod(given[0], phases)
        given = [size + (k < more) for k in range(phases)]
    if len(given) != phases or min(given) < 1:
        raise InputError(
            f"steps is {steps!r}, and the number of phases is {phases}.\n"
            "Pass one number of steps for all of it, or one for each of phases=."
        )
    return Grid(tuple(given))
