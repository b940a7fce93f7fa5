"""A piece of a run with contacts or dry friction: smooth motion in one mode."""

from __future__ import annotations

import numpy as np

from symsimpson.run.event_run import EventRun
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Floats, State
from symsimpson.support.progress import Watcher


class PieceRun(EventRun):
    """A piece of a run, in one mode: it pauses at the event that ends the mode."""

    pauses = True
    taken: int = 0  #: Number of records that the whole run has taken.

    def begin_piece(self, state: State, first: int, step: int, done: float) -> None:
        """Begin at a state in a step, at a duration ``done`` in it; ``first`` is stored first."""
        self.first, self._progress[0], self.begin_at = first, step - first, (step, done)
        self.rows("POSITION", len(state[0]))[:] = state[0]
        self.rows("MOMENTUM", len(state[1]))[:] = state[1]
        if not done:
            self._continue_from(state)
            if self._saltation is not None and self.time_changes is not None:
                salt, t = self._saltation, float(self.t0 + self.h * step)
                salt.begin(self._variations)
                salt.time_changes, self.time_changes = self.time_changes, None
                salt.fix_time(t, state, step)
                salt.write_to(self._variations)
        self.observe_start()

    def take(self, stop: int) -> None:
        """Take steps; first complete the step in which the piece begins."""
        step, done = self.begin_at
        if done and self.step == step and self.alive:
            self.begin_at = step, 0.0
            self._split_step(completed=False, done=done)
        if self.alive and self.step < stop:
            super().take(stop)

    def follow(self, first: int, step: int, signals: list[int], watcher: Watcher | None) -> None:
        """Continue at a step of the whole run, with its signals of Ctrl-C and its progress bar."""
        self.first, self._progress[0] = first, step - first
        self._signals, self._watcher = signals, watcher

    def carry(self, columns: Floats, moved: Floats) -> None:
        """Begin with variations of the state, and of the time of the event before."""
        self.rows("TANGENTS", 1)[:] = columns.shape[1]
        self.rows("TANGENT", columns.size)[:] = columns.T.ravel()
        self.time_changes = moved

    def share_arrays(self, run: Run) -> None:
        """Store states in the arrays of another run."""
        self.q, self.p, self.iterations = run.q, run.p, run.iterations
        self.recorded = np.zeros((len(run.q), *self.recorded.shape[1:]))
        self._stores = self.q, self.p, self.recorded, self.iterations
