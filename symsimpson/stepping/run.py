"""A run in progress: its workspace, its stored states, and the reason if a step fails."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from symsimpson.program.numbers import NO_INPUTS, NOTHING, workspace
from symsimpson.program.observed import Reduction
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, driver_layout, split, with_clock
from symsimpson.program.status import Status
from symsimpson.support.array_types import Floats, Ints, Reals
from symsimpson.support.interpreter import catch_interrupts
from symsimpson.support.progress import Watcher
from symsimpson.text.interface import ARRIVED, RATE_NOT_POSITIVE


class StoredStates(NamedTuple):
    """Stored states of a run, a fixed number of steps apart; the last interval may be shorter."""

    #: Positions and momenta, both of shape (N, n).
    q: Reals
    p: Reals
    #: Iterations since the state before, shape (N,). If the run stores only the final state: the
    #: total over all steps, shape (1,).
    iterations: Ints
    recorded: Reals  #: Rows that recorders stored with each state, shape (N, k).
    every: int  #: Number of steps between stored states; 0 if the run stored none.


LOG = logging.getLogger(__name__)
#: Duration of one call of the compiled loop in seconds, so that the run notices Ctrl-C.
PATIENCE = 0.02
#: The time of a retimed run has stopped if it does not change at all during this many steps.
STANDSTILL = 1024
#: Failures that no fallback kernels can avoid.
HOPELESS = Status.COORDINATE_SINGULARITY, Status.SINGULAR_LEGENDRE, Status.RATE_NOT_POSITIVE
#: Number of steps that fallback kernels take after a step at which the usual ones failed.
FALLBACK_STRETCH = 64
#: Status values that are found only after a step; the run then undoes this step.
FOUND_AFTER_STEP = (ARRIVED, RATE_NOT_POSITIVE)


class Run:
    """A run in progress: its workspace, and the arrays of its stored states.

    ``storage`` has the number of steps between stored states (0: store none), and the number of
    states in the arrays. ``advance(a)`` followed by ``advance(b)`` is bitwise identical to
    ``advance(b)``.
    """

    def __init__(
        self,
        program: Program,
        parameters: Reals,
        h: Any,
        t0: Any,
        storage: tuple[int, int] = (0, 1),
        fallbacks: Sequence[str] | None = None,
        inputs: Reals = NO_INPUTS,
        recorders: Sequence[Recorder] = (),
    ) -> None:
        header, kernels, numbers = program.header, program.kernels, program.numbers
        self.header, self.kernels, self.h, self.t0 = header, kernels, h, t0
        self.every, stored = storage
        self._declared, self._tools = program.declared, program.tools
        self._parameters, self._inputs = parameters, inputs
        self._driver = numbers.driver
        self._recorders = with_clock(header, recorders)
        self.driver_layout = driver_layout(header, self._recorders)
        if any(recorder.renewed for recorder in recorders):
            self._driver = partial(numbers.driver, renewing=True)
        room = sum(recorder.room for recorder in recorders)
        self.W = workspace(header, numbers, parameters, room)
        self._column, self._status = self.W[:, 0], header.layout["STATUS"]
        self._watcher: Watcher | None = None
        self._fallbacks = kernels.fallbacks if fallbacks is None else fallbacks
        self._batch = self._longest_batch = numbers.stretch
        self.q, self.p = numbers.zeros((2, stored, header.n, 1))
        #: Rows of all recorders for each stored state, one recorder after another.
        width = sum(recorder.rows for recorder in self._recorders)
        self.recorded = numbers.zeros((stored, width, 1))
        self.iterations = np.zeros((stored, 1), dtype=np.int64)
        self._stores = self.q, self.p, self.recorded, self.iterations
        #: Number of the step at the first stored state.
        self.first = 0
        #: Counters that the compiled loop updates; the first counts steps since ``first``.
        self._progress = np.zeros(4, dtype=np.int64)
        #: Signals of Ctrl-C, and whether one has ended the run.
        self._signals, self._interrupted = list[int](), False
        #: Records of events, in the order of time.
        self.records: list[Any] = []
        #: Message of a failure; if empty, the message follows from the status.
        self.reason = ""
        #: Name of the terminal event that ended the run; time, q and p at the event.
        self.ended_by: str | None = None
        self.end_within: tuple[Any, Any, Any] | None = None
        #: Index of the fallback kernels in use, the step up to which they are used, and the number
        #: of steps during which the time has not changed.
        self._fallback, self._fallback_until, self._steps_at_rest = 0, -1, 0
        #: Initial time, and initial q and p, shape (2, n).
        self.begun: tuple[Any, Reals] = t0, numbers.zeros((2, header.n))

    def begin(
        self,
        q: Reals,
        other: Reals,
        *,
        velocity: bool,
        any_angle: bool = False,
        t_end: Any = None,
        onward: bool = False,
    ) -> None:
        """Set the initial state (q, p), or (q, v) with ``velocity``.

        ``any_angle`` selects kernels for angles of any size. A retimed run ends before ``t_end``.
        With ``onward``, a retimed run continues another one and uses its E0 and its first rate.
        """
        if any_angle:
            self._fallback, self._fallback_until = len(self._fallbacks) - 1, FALLBACK_STRETCH
        legendre = self.kernels.address("legendre", any_angle=any_angle) if velocity else 0
        begin_anew, start = self._driver("begin_anew"), (self._parameters, q, other)
        begin_anew(self._kernels(), legendre, self._driver_arguments, start)
        if self.header.retimed:
            if not onward:
                self.apply("retime")
                self._driver("begin")(self._kernels(), 0, *self._driver_arguments)
            self.rows("TIME", 1)[:] = self.t0
            self.rows("TIME_END", 2)[:] = (0, 0) if t_end is None else (1, t_end)
        self.store(0)

    @property
    def _driver_arguments(self) -> tuple[Any, ...]:
        return self.h, self.t0, self.W, self.driver_layout

    @cached_property
    def _take_steps(self) -> Any:
        explicit = self.header.newton_unknowns == 0
        return self._driver("take_explicit_steps" if explicit else "take_steps")

    def observe_start(self) -> None:
        """Call the recorders of states at the initial state."""
        for candidate in self._recorders:
            if candidate.kernel == "observe":
                rows = self._column[candidate.first : candidate.first + candidate.room]
                rows[:-1], rows[-1] = np.nan, 0.0
        number = sum(recorder.of_states for recorder in self._recorders)
        for kernel in self._kernels()[len(self._kernels()) - number :]:
            self._driver("apply")(kernel, self.h, self.t0, self.W)

    def reduction_values(self, reductions: Sequence[Reduction]) -> tuple[tuple[str, float], ...]:
        """Return the names of the reductions and their current values."""
        first = next((x.first for x in self._recorders if x.kernel == "observe"), None)
        if first is None:
            return ()
        rows = self._column[first : first + 2 * len(reductions) : 2].tolist()
        return tuple(
            (reduction.name, value) for reduction, value in zip(reductions, rows, strict=True)
        )

    def apply(self, kernel: str) -> None:
        """Call a kernel at the current state."""
        address = self.kernels.address(kernel)
        self._driver("apply")(address, self.h, self._grid_time(), self.W)

    def begin_growth(self, columns: Reals) -> None:
        """Set the initial variations, orthonormal columns; the last column has the weights."""
        self._driver("begin_growth")(self.W, self.driver_layout, 0, columns)

    def store(self, place: int) -> None:
        """Store the current state and the rows of recorders at index ``place``."""
        n = self.header.n
        self.q[place, :, 0] = self.rows("POSITION", n)
        self.p[place, :, 0] = self.rows("MOMENTUM", n)
        self.recorded[place, :, 0] = self.recorder_rows()

    @property
    def history(self) -> Any:
        """The modes of contacts and friction; None without either."""
        return None

    @property
    def recorders(self) -> tuple[Recorder, ...]:
        """The recorders of the run."""
        return self._recorders

    def recorder_rows(self) -> Reals:
        """Return the current rows of all recorders, shape (k,)."""
        rows = [self._column[x.first : x.first + x.rows] for x in self._recorders]
        return np.concatenate([self._column[:0], *rows])

    def recorded_fields(self, recorded: Reals, result: Callable[[Any], Any]) -> dict[str, Any]:
        """Split recorded rows into the fields of a trajectory; ``result`` converts the numbers."""
        variations, named = split(self._recorders, result(recorded), self.header.n)
        return {"variations": variations, "recorded_values": tuple(named.items())}

    @contextmanager
    def watched(self, steps: int, progress: bool | None) -> Iterator[None]:
        """Show the steps inside this context on a progress bar; Ctrl-C ends the run.

        After Ctrl-C, the status is INTERRUPTED.
        """
        bar = NOTHING if progress is False else closing(Watcher(steps, progress))
        try:
            with bar as self._watcher, catch_interrupts() as self._signals:
                yield
        except KeyboardInterrupt:
            self._interrupted = True
        self._interrupted |= bool(self._signals)
        self._watcher = None

    def rows(self, block: str, count: int) -> Reals:
        """Return the first ``count`` rows of a block of the workspace, as a view."""
        first = self.header.layout[block]
        return self._column[first : first + count]

    def value(self, block: str) -> Any:
        """Return the number in the first row of a block."""
        return self._column[self.header.layout[block]]

    def end(self) -> tuple[Reals, Reals]:
        """Return a copy of the current q and p, each of shape (1, n)."""
        n = self.header.n
        return self.rows("POSITION", n)[None].copy(), self.rows("MOMENTUM", n)[None].copy()

    def stored_states(self) -> StoredStates:
        """Return the stored states in the arrays, as views."""
        count = self._progress.item(0) // self.every + 1 if self.every else 0
        q, p, rows, iterations = (x[:count] for x in self._stores)
        return StoredStates(q[..., 0], p[..., 0], iterations[:, 0], rows[..., 0], self.every)

    @property
    def room(self) -> int:
        """Number of the last step that the run can take before the arrays are full."""
        return self.first + len(self.q) * self.every - 1 if self.every else sys.maxsize

    @property
    def step(self) -> int:
        """Number of completed steps."""
        return self.first + self._progress.item(0)

    @property
    def current_time(self) -> Any:
        """Current physical time; a retimed run reads it from the workspace."""
        return self.value("TIME") if self.header.retimed else self._grid_time()

    @property
    def status(self) -> Status:
        """Status of the run: SUCCESS, or the reason for its failure."""
        if self._interrupted:
            return Status.INTERRUPTED
        if self.alive or self.has_arrived:
            return Status.SUCCESS
        status = Status(int(self._column[self._status]))
        if status is Status.NOT_CONVERGED and self._diverged():
            return Status.DIVERGED
        if status is Status.NOT_FINITE and self._meets_zero_pivot():
            return Status.SINGULAR_JACOBIAN
        lost = status is Status.SINGULAR_LEGENDRE and self.header.retimed
        return Status.RATE_NOT_POSITIVE if lost and self._loses_rate() else status

    def _diverged(self) -> bool:
        """Return whether increments exceed ten times the predicted ones and all before."""
        n, d = self.header.n, self.header.degree
        predicted = self.rows("PREDICTED", d * n).reshape(d, n)
        expected = (self.rows("MASS_DIAGONAL", n) * predicted**2).sum()
        expected = max(expected, self.value("LARGEST_SQUARED"))
        return bool(self.value("INCREMENT_SQUARED") > 100 * expected)

    def _meets_zero_pivot(self) -> bool:
        """Return whether the elimination with pivoting met a zero pivot."""
        at = self.header.layout
        if self._fallbacks[self._fallback] != "robust":
            return False
        places = np.arange(at["SOLVE_UNKNOWNS"]) * (at["SOLVE_STRIDE"] + 1)
        return bool((self._column[at["JACOBIAN"] + at["SOLVE_OFFSET"] + places] == 0).any())

    def _loses_rate(self) -> bool:
        """Return whether the rate dt/dtau, a divisor of M, ceases to be positive in two steps."""
        W, at, n = self.W.copy(), self.header.layout, self.header.n
        energy, q = self.kernels.address("energy", any_angle=True), W[at["POSITION"] :][:n].copy()
        for ahead in range(3):
            self._driver("apply")(energy, self.h, self._grid_time(), W)
            rate, v = W[at["RATE"], 0], W[at["VELOCITY"] :][:n]
            if not rate > 0:
                return True
            W[at["POSITION"] :][:n] = q + (ahead + 1) * self.h * rate * v
        return False

    @property
    def last_correction(self) -> float:
        """Size of the last Newton correction relative to the increment of the step."""
        return float(self.value("RELATIVE")) ** 0.5

    @property
    def last_iterations(self) -> int:
        """Newton iterations since the last stored state."""
        return int(self.value("ITERATIONS"))

    @property
    def alive(self) -> bool:
        """True if no step has failed."""
        return bool(self._column[self._status] == 0)

    @property
    def has_arrived(self) -> bool:
        """True if the next step of a retimed run would pass ``t_end``."""
        return bool(self._column[self._status] == ARRIVED)

    @property
    def can_recover(self) -> bool:
        """True if fallback kernels may succeed at the failed step."""
        return not (self.alive or self.has_arrived) and self.status not in HOPELESS

    @property
    def parameters(self) -> Reals:
        """Values of the parameters, including those that follow from the initial state."""
        return self.rows("PARAMETER", self._parameters.size).copy()

    def advance(self, stop: int) -> None:
        """Take steps until ``stop`` or failure; check for Ctrl-C every ``PATIENCE`` seconds."""
        while self.step < stop and self.alive:
            self._take_batch(stop)
            if self._signals:  # not earlier: a step would be incomplete
                raise KeyboardInterrupt

    def _take_batch(self, stop: int) -> None:
        """Take steps for about ``PATIENCE`` seconds; change to fallback kernels on failure."""
        until = min(stop, self.step + self._batch)
        if self._fallback:
            until = min(until, self._fallback_until)
        before, start, now = self.step, time.perf_counter(), self.current_time
        self.take(until)
        spent, done = time.perf_counter() - start, self.step - before
        self._steps_at_rest = self._steps_at_rest + done if now == self.current_time else 0
        if self._steps_at_rest >= STANDSTILL:
            self._column[self._status] = RATE_NOT_POSITIVE
        if self._watcher is not None:
            self._watcher(done)
        if done and spent > PATIENCE / 8:
            self._batch = max(1, int(PATIENCE / spent * done))
        else:
            self._batch = min(2 * self._batch, self._longest_batch)
        if self.can_recover and self._expect_rounding():
            self._change_to(self._fallback)
        elif self.can_recover and self._fallback + 1 < len(self._fallbacks):
            self._fallback_until = self.step + FALLBACK_STRETCH
            self._change_to(self._fallback + 1)
        elif self._fallback and self.step == self._fallback_until:
            self._change_to(0)

    def _expect_rounding(self) -> bool:
        """Raise the tolerance of corrections to the round-off of cancelling terms of forces.

        Return whether the tolerance has grown; then it is worth repeating the failed step.
        """
        if self._tools is None or self._declared is None:
            return False
        n, number = self.header.n, self.step
        inputs = self._inputs[0, min(number, self._inputs.shape[1] - 1)]
        parameters, t = [*map(float, self._parameters)], float(self._grid_time())
        q = [*map(float, self.rows("POSITION", n))]
        # at both ends of the step: forces may begin at zero
        terms = np.max(
            [
                self._tools.force_terms(self._declared, q, [*parameters, *map(float, u)], time)
                for u in inputs
                for time in (t, t + float(self.h))
            ],
            axis=0,
        )
        masses = self.rows("MASS_DIAGONAL", n).astype(np.float64)
        with np.errstate(over="ignore"):
            size = float(sum(terms[masses > 0] ** 2 / masses[masses > 0]))
        larger = 4 * float(self._column[-1]) < size < np.inf
        if larger:
            self._column[-1:] = size
        return larger

    def _kernels(self) -> Any:
        return self.kernels.set(self._fallbacks[self._fallback], self._recorders)

    def _change_to(self, number: int) -> None:
        """Continue with other kernels; stage iterations and Newton's method exchange no values."""
        before, after = self._fallbacks[self._fallback], self._fallbacks[number]
        where = self.header.system, self.step
        if before != after:
            LOG.info("%s: step %d: kernels %r replace kernels %r", *where, after, before)
        self._fallback, fresh = number, "stages" in (before, after)
        here = self.h, self._grid_time(), self.W, self.driver_layout
        self._driver("change_to")(self._kernels(), fresh, *here)

    def _grid_time(self) -> Any:
        return self.t0 + self.h * self.step

    def take(self, stop: int) -> None:
        """Take steps up to ``stop`` with the current kernels; recover rejected steps."""
        kernels, setting, stop = self._kernels(), self._driver_arguments, stop - self.first
        self._progress[2:] = self.first
        while True:
            self._take_steps(
                kernels, setting, self._progress, stop, self.every, self._stores, self._inputs
            )
            event = self._progress.item(1)
            if event == 0:
                if self.header.retimed and self._column[self._status] in FOUND_AFTER_STEP:
                    self._step_back()
                return
            LOG.info("%s: step %d is repeated or checked", self.header.system, self.step)
            here = self.h, self._grid_time(), self.W, self.driver_layout
            self._driver("recover")(kernels, *here, event)
            if not self.alive:
                self._progress[1] = 0
                return

    def _step_back(self) -> None:
        """Undo the last step, including its time."""
        size = 4 * self.header.n
        self.rows("POSITION", size)[:] = self.rows("PREVIOUS", size)
        self.rows("TIME", 2)[:] = self.rows("TIME", 4)[2:]
        self._progress[0] -= 1

    def discard_stored(self) -> int:
        """Discard all stored states but the last; return how many were discarded."""
        count = self._progress.item(0) // self.every if self.every else 0
        if count:
            self.first += count * self.every
            self._progress[0] -= count * self.every
            for stored in self._stores:
                stored[0] = stored[count]
        return count

    def position(self) -> list[Any]:
        """Return the counters that, with the workspace, restore the run."""
        return [self.first, self._progress.item(0), self._fallback, self._fallback_until]

    def restore(self, position: Sequence[Any], workspace: Floats) -> None:
        """Restore the counters and the workspace of another run."""
        self.first, self._progress[0], self._fallback, self._fallback_until = position
        later = len(self._column) - len(workspace)  # rows that older modules do not have
        self._column[:] = np.insert(workspace, [self.header.rows - later] * later, 0.0)
