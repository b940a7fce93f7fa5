"""Sinks that take the states of a run piece by piece: all of them, or some to judge it by."""

from __future__ import annotations

from typing import Any

import numpy as np

from symsimpson.errors import StorageError
from symsimpson.run.resolution import MOST_LOOKED_AT
from symsimpson.stepping.kept import KeptStates
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Reals

#: After so many times that states were put away, memory is asked for so many times their size: they
#: are copied when they are joined, and a lack of memory is better met before.
LOOKS, JOINING = 16, 3


class Sink:
    """A place to which the states of each piece of a run go, before the run forgets them."""

    def due(self, stop: int) -> int:
        """Return the step at which the piece is to end, ``stop`` or an earlier one."""
        return stop

    def take(self) -> None:
        """Take what was stored since the last call, which may be nothing."""


class Keeper(Sink):
    """Keeps states of a run; all of them, in its own arrays, unless a subclass does otherwise."""

    def __init__(self, run: Run) -> None:
        self._run = run

    def states(self) -> KeptStates:
        """Return the states that the run is judged by."""
        return self._run.stored()


class Collected(Keeper):
    """All states of a run, of which nobody knows how many there will be."""

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self._parts, self._taken = list[tuple[Reals, ...]](), 0

    def take(self) -> None:
        """Put the states away, but for the last one, with which the run goes on.

        Raises StorageError if there is no memory for more states; those so far are kept.
        """
        try:
            self._parts.append(tuple(x[:-1].copy() for x in self._left()))
            self._taken += len(self._parts[-1][0])
            if len(self._parts) % LOOKS == 0:  # is there room to join them?
                np.empty(JOINING * sum(x.nbytes for part in self._parts for x in part), np.uint8)
        except MemoryError:
            run = self._run
            raise StorageError(
                f"the states of a run of {run.header.system} do not fit into memory: "
                f"{run.step} steps were taken, and those are kept.\nStore fewer: every=1000, or "
                "every=None for the last state alone; or take a larger h."
            ) from None

    def states(self) -> KeptStates:
        """Return all stored states."""
        q, p, iterations, recorded = map(
            np.concatenate, zip(*self._parts, self._left(), strict=True)
        )
        return KeptStates(q, p, iterations, recorded, self._run.every)

    def _left(self) -> tuple[Any, ...]:
        """Return columns of the states that were not put away."""
        run = self._run
        first = self._taken - run.first // run.every
        return tuple(x[first:] for x in run.stored()[:-1])


class Samples(Keeper):
    """Some states of a run that nobody wants all states of.

    They are ``every`` steps apart; where there are too many, each second one is left out.
    """

    def __init__(self, run: Run, every: int) -> None:
        super().__init__(run)
        self._every, self._iterations = every, 0
        self._parts, self._number, self._seen = list[tuple[Reals, ...]](), 0, 0

    def take(self) -> None:
        """Keep some of the states."""
        run = self._run
        q, p, iterations, recorded, stride = run.stored()
        self._iterations += int(iterations[(self._seen - run.first) // stride + 1 :].sum())
        self._seen = run.first + (len(q) - 1) * stride
        first = (self._number * self._every - run.first) // stride
        some = slice(first, None, self._every // stride)
        self._parts.append(tuple(x[some].copy() for x in (q, p, recorded)))
        self._number += len(self._parts[-1][0])
        while self._number > MOST_LOOKED_AT:
            self._parts = [tuple(x[::2] for x in self._joined())]
            self._number, self._every = len(self._parts[0][0]), 2 * self._every

    def states(self) -> KeptStates:
        """Return those that were kept; iterations have shape (1,), the sum of all."""
        q, p, recorded = self._joined()
        return KeptStates(q, p, np.array([self._iterations]), recorded, self._every)

    def _joined(self) -> tuple[Reals, ...]:
        return tuple(map(np.concatenate, zip(*self._parts, strict=True)))
