"""One run of the driver: its workspace, the states that it stores, why a step failed."""

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
from symsimpson.support.interpreter import listening
from symsimpson.support.progress import Watcher
from symsimpson.text.interface import ARRIVED, RATE_NOT_POSITIVE


class KeptStates(NamedTuple):
    """States of a run at equal strides; the last one may stand behind a part of a stride."""

    #: Both of shape (N, n).
    q: Reals
    p: Reals
    #: Since the state before, shape (N,); or, of a run of which none is asked for, all of them,
    #: shape (1,).
    iterations: Ints
    recorded: Reals  #: What recorders left beside them, shape (N, k).
    every: int  #: Steps from one to the next; 0 where none were kept.


LOG = logging.getLogger(__name__)
#: The compiled loop is left after about so many seconds, so that Ctrl-C is heard.
PATIENCE = 0.02
#: After so many steps in which it does not change at all, the time of a retimed run stands still.
STANDSTILL = 1024
#: Failures that no other kernels would help.
HOPELESS = Status.COORDINATE_SINGULARITY, Status.SINGULAR_LEGENDRE, Status.RATE_NOT_POSITIVE
#: After a step that only slower and more robust kernels could take, they take so many more.
FALLBACK_STRETCH = 64
#: What stops a run behind a step that is not taken then.
BEHIND_A_STEP = (ARRIVED, RATE_NOT_POSITIVE)


class Run:
    """A trajectory under way: its workspace, and the arrays in which states are stored.

    ``advance(a)`` and then ``advance(b)`` leave the same bits as ``advance(b)`` alone.
    """

    def __init__(
        self,
        program: Program,
        parameters: Reals,
        h: Any,
        t0: Any,
        every: int,
        stored: int,
        fallbacks: Sequence[str] | None = None,
        inputs: Reals = NO_INPUTS,
        recorders: Sequence[Recorder] = (),
    ) -> None:
        header, kernels, numbers = program.header, program.kernels, program.numbers
        self.header, self.kernels, self.h, self.t0, self.every = header, kernels, h, t0, every
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
        self._stretch = self._longest = numbers.stretch
        self.q, self.p = numbers.zeros((2, stored, header.n, 1))
        #: What recorders left beside them, of one after the other.
        width = sum(recorder.rows for recorder in self._recorders)
        self.recorded = numbers.zeros((stored, width, 1))
        self.iterations = np.zeros((stored, 1), dtype=np.int64)
        self._stores = self.q, self.p, self.recorded, self.iterations
        #: Steps before those whose states stand in the arrays; and what was done since.
        self.first, self._progress = 0, np.zeros(4, dtype=np.int64)
        #: Ctrl-C, as it is pressed; and whether it has ended the run.
        self._heard, self._interrupted = list[int](), False
        #: What events did, in the order of time.
        self.records: list[Any] = []
        #: What the message says in place of its status; the event that ended it, time and state.
        self.reason = ""
        self.ended_by: str | None = None
        self.end_within: tuple[Any, Any, Any] | None = None
        self._set, self._set_until, self._still = 0, -1, 0
        #: The time at the start, and q and p there, shape (2, n).
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
        """Begin at (q, p), or at (q, v); with kernels that take any angle, if that is needed.

        A retimed run ends before ``t_end``; where it is ``onward`` from another, it has the E0 and
        the first rate of that one.
        """
        if any_angle:
            self._set, self._set_until = len(self._fallbacks) - 1, FALLBACK_STRETCH
        legendre = self.kernels.address("legendre", any_angle=any_angle) if velocity else 0
        begin_anew, start = self._driver("begin_anew"), (self._parameters, q, other)
        begin_anew(self._kernels(), legendre, self._setting, start)
        if self.header.retimed:
            if not onward:
                self.apply("retime")
                self._driver("begin")(self._kernels(), 0, *self._setting)
            self.rows("TIME", 1)[:] = self.t0
            self.rows("TIME_END", 2)[:] = (0, 0) if t_end is None else (1, t_end)
        self.store(0)

    @property
    def _setting(self) -> tuple[Any, ...]:
        return self.h, self.t0, self.W, self.driver_layout

    @cached_property
    def _take_steps(self) -> Any:
        explicit = self.header.newton_unknowns == 0
        return self._driver("take_explicit_steps" if explicit else "take_steps")

    def look(self) -> None:
        """Let recorders of states look at that where the run begins."""
        for candidate in self._recorders:
            if candidate.kernel == "observe":
                rows = self._column[candidate.first : candidate.first + candidate.room]
                rows[:-1], rows[-1] = np.nan, 0.0
        number = sum(recorder.of_states for recorder in self._recorders)
        for kernel in self._kernels()[len(self._kernels()) - number :]:
            self._driver("apply")(kernel, self.h, self.t0, self.W)

    def reduced(self, reductions: Sequence[Reduction]) -> tuple[tuple[str, float], ...]:
        """Return names of observed values, and what they came to by now."""
        first = next((x.first for x in self._recorders if x.kernel == "observe"), None)
        if first is None:
            return ()
        rows = self._column[first : first + 2 * len(reductions) : 2].tolist()
        return tuple(
            (reduction.name, value) for reduction, value in zip(reductions, rows, strict=True)
        )

    def apply(self, kernel: str) -> None:
        """Call a kernel of the state where the run is."""
        address = self.kernels.address(kernel)
        self._driver("apply")(address, self.h, self._time(), self.W)

    def begin_growth(self, columns: Reals) -> None:
        """Begin variations of the state, orthonormal columns; the last column has the weights."""
        self._driver("begin_growth")(self.W, self.driver_layout, 0, columns)

    def store(self, place: int) -> None:
        """Store the present state, and what recorders have left."""
        n = self.header.n
        self.q[place, :, 0] = self.rows("POSITION", n)
        self.p[place, :, 0] = self.rows("MOMENTUM", n)
        self.recorded[place, :, 0] = self.left()

    def left(self) -> Reals:
        """Return what recorders have left beside the present state."""
        rows = [self._column[x.first : x.first + x.rows] for x in self._recorders]
        return np.concatenate([self._column[:0], *rows])

    def beside(self, recorded: Reals, result: Callable[[Any], Any]) -> dict[str, Any]:
        """Return what was recorded at states, numbers as results, as trajectories have it."""
        variations, named = split(self._recorders, result(recorded), self.header.n)
        return {"variations": variations, "recorded_values": tuple(named.items())}

    @contextmanager
    def watched(self, steps: int, progress: bool | None) -> Iterator[None]:
        """Count the steps that are taken inside on a bar; Ctrl-C ends them, as the status tells."""
        bar = NOTHING if progress is False else closing(Watcher(steps, progress))
        try:
            with bar as self._watcher, listening() as self._heard:
                yield
        except KeyboardInterrupt:
            self._interrupted = True
        self._interrupted |= bool(self._heard)
        self._watcher = None

    def rows(self, block: str, count: int) -> Reals:
        """Return rows of the workspace."""
        first = self.header.layout[block]
        return self._column[first : first + count]

    def value(self, block: str) -> Any:
        """Return the number in a block of one row."""
        return self._column[self.header.layout[block]]

    def end(self) -> tuple[Reals, Reals]:
        """Return q and p where the run is, shape (1, n)."""
        n = self.header.n
        return self.rows("POSITION", n)[None].copy(), self.rows("MOMENTUM", n)[None].copy()

    def stored(self) -> KeptStates:
        """Return the states that stand in the arrays."""
        kept = self._progress.item(0) // self.every + 1 if self.every else 0
        q, p, rows, iterations = (x[:kept] for x in self._stores)
        return KeptStates(q[..., 0], p[..., 0], iterations[:, 0], rows[..., 0], self.every)

    @property
    def room(self) -> int:
        """The last step of which there is room for the state, if it is to be stored."""
        return self.first + len(self.q) * self.every - 1 if self.every else sys.maxsize

    @property
    def step(self) -> int:
        """Number of steps done."""
        return self.first + self._progress.item(0)

    @property
    def now(self) -> Any:
        """The time that has come, which is not that of the steps if the system is retimed."""
        return self.value("TIME") if self.header.retimed else self._time()

    @property
    def status(self) -> Status:
        """The state of the run."""
        if self._interrupted:
            return Status.INTERRUPTED
        if self.alive or self.arrived:
            return Status.SUCCESS
        status = Status(int(self._column[self._status]))
        if status is Status.NOT_CONVERGED and self._diverged():
            return Status.DIVERGED
        if status is Status.NOT_FINITE and self._meets_zero_pivot():
            return Status.SINGULAR_JACOBIAN
        lost = status is Status.SINGULAR_LEGENDRE and self.header.retimed
        return Status.RATE_NOT_POSITIVE if lost and self._loses_rate() else status

    def _diverged(self) -> bool:
        """Return whether the increments became ten times those predicted and those before."""
        n, d = self.header.n, self.header.degree
        predicted = self.rows("PREDICTED", d * n).reshape(d, n)
        expected = (self.rows("MASS_DIAGONAL", n) * predicted**2).sum()
        expected = max(expected, self.value("LARGEST_SQUARED"))
        return bool(self.value("INCREMENT_SQUARED") > 100 * expected)

    def _meets_zero_pivot(self) -> bool:
        """Return whether the kernels that eliminate with pivoting met a pivot of zero."""
        at = self.header.layout
        if self._fallbacks[self._set] != "robust":
            return False
        places = np.arange(at["SOLVE_UNKNOWNS"]) * (at["SOLVE_STRIDE"] + 1)
        return bool((self._column[at["JACOBIAN"] + at["SOLVE_OFFSET"] + places] == 0).any())

    def _loses_rate(self) -> bool:
        """Return whether dt/dtau, by which M is divided, is not positive within two steps."""
        W, at, n = self.W.copy(), self.header.layout, self.header.n
        energy, q = self.kernels.address("energy", any_angle=True), W[at["POSITION"] :][:n].copy()
        for ahead in range(3):
            self._driver("apply")(energy, self.h, self._time(), W)
            rate, v = W[at["RATE"], 0], W[at["VELOCITY"] :][:n]
            if not rate > 0:
                return True
            W[at["POSITION"] :][:n] = q + (ahead + 1) * self.h * rate * v
        return False

    @property
    def last_correction(self) -> float:
        """Size of the last Newton correction relative to the increment."""
        return float(self.value("RELATIVE")) ** 0.5

    @property
    def last_iterations(self) -> int:
        """Newton iterations since the last stored state."""
        return int(self.value("ITERATIONS"))

    @property
    def alive(self) -> bool:
        """Whether no step has failed."""
        return bool(self._column[self._status] == 0)

    @property
    def arrived(self) -> bool:
        """Whether the next step would go beyond the end."""
        return bool(self._column[self._status] == ARRIVED)

    @property
    def hopeful(self) -> bool:
        """Whether other kernels may take a step that failed."""
        return not (self.alive or self.arrived) and self.status not in HOPELESS

    @property
    def parameters(self) -> Reals:
        """Values of the parameters, with those that follow from the start."""
        return self.rows("PARAMETER", self._parameters.size).copy()

    def advance(self, stop: int) -> None:
        """Take steps until ``stop`` or failure; leaves the compiled loop now and then."""
        while self.step < stop and self.alive:
            self._take_some(stop)
            if self._heard:  # before, it would have left a step half done
                raise KeyboardInterrupt

    def _take_some(self, stop: int) -> None:
        """Take so many steps as are over soon; change to other kernels if one failed."""
        until = min(stop, self.step + self._stretch)
        if self._set:
            until = min(until, self._set_until)
        before, start, now = self.step, time.perf_counter(), self.now
        self.take(until)
        spent, done = time.perf_counter() - start, self.step - before
        self._still = self._still + done if now == self.now else 0
        if self._still >= STANDSTILL:
            self._column[self._status] = RATE_NOT_POSITIVE
        if self._watcher is not None:
            self._watcher(done)
        if done and spent > PATIENCE / 8:
            self._stretch = max(1, int(PATIENCE / spent * done))
        else:
            self._stretch = min(2 * self._stretch, self._longest)
        if self.hopeful and self._expect_rounding():
            self._change_to(self._set)
        elif self.hopeful and self._set + 1 < len(self._fallbacks):
            self._set_until = self.step + FALLBACK_STRETCH
            self._change_to(self._set + 1)
        elif self._set and self.step == self._set_until:
            self._change_to(0)

    def _expect_rounding(self) -> bool:
        """Let corrections be as large as rounding makes them where the terms of forces cancel.

        Tells whether they are larger than any before; then a step that failed may be taken.
        """
        if self._tools is None or self._declared is None:
            return False
        n, number = self.header.n, self.step
        inputs = self._inputs[0, min(number, self._inputs.shape[1] - 1), 0]
        values = [*map(float, self._parameters), *map(float, inputs)]
        q, t = map(float, self.rows("POSITION", n)), float(self._time())
        terms = self._tools.force_terms(self._declared, q, values, t)
        masses = self.rows("MASS_DIAGONAL", n).astype(np.float64)
        with np.errstate(over="ignore"):
            size = float(sum(terms[masses > 0] ** 2 / masses[masses > 0]))
        larger = 4 * float(self._column[-1]) < size < np.inf
        if larger:
            self._column[-1:] = size
        return larger

    def _kernels(self) -> Any:
        return self.kernels.set(self._fallbacks[self._set], self._recorders)

    def _change_to(self, number: int) -> None:
        """Go on with other kernels; between stages and Newton's method nothing is handed over."""
        before, after = self._fallbacks[self._set], self._fallbacks[number]
        where = self.header.system, self.step
        if before != after:
            LOG.info("%s: from step %d on with kernels %r, before with %r", *where, after, before)
        self._set, anew = number, "stages" in (before, after)
        here = self.h, self._time(), self.W, self.driver_layout
        self._driver("change_to")(self._kernels(), anew, *here)

    def _time(self) -> Any:
        return self.t0 + self.h * self.step

    def take(self, stop: int) -> None:
        """Take steps in one go, with the same kernels, recovering those at which the loop stops."""
        kernels, setting, stop = self._kernels(), self._setting, stop - self.first
        self._progress[2:] = self.first
        rest = stop, self.every, self._stores, self._inputs
        while True:
            self._take_steps(kernels, setting, self._progress, *rest)
            event = self._progress.item(1)
            if event == 0:
                if self.header.retimed and self._column[self._status] in BEHIND_A_STEP:
                    self._step_back()
                return
            LOG.info("%s: step %d is solved again, or checked", self.header.system, self.step)
            here = self.h, self._time(), self.W, self.driver_layout
            self._driver("recover")(kernels, *here, event)
            if not self.alive:
                self._progress[1] = 0
                return

    def _step_back(self) -> None:
        """Return to before the last step, the time too."""
        size = 4 * self.header.n
        self.rows("POSITION", size)[:] = self.rows("PREVIOUS", size)
        self.rows("TIME", 2)[:] = self.rows("TIME", 4)[2:]
        self._progress[0] -= 1

    def forget(self) -> int:
        """Keep only the last stored state in the arrays; returns the number of those forgotten."""
        kept = self._progress.item(0) // self.every if self.every else 0
        if kept:
            self.first += kept * self.every
            self._progress[0] -= kept * self.every
            for stored in self._stores:
                stored[0] = stored[kept]
        return kept

    def position(self) -> list[Any]:
        """Return what tells, beside the workspace, where the run is."""
        return [self.first, self._progress.item(0), self._set, self._set_until]

    def put_back(self, position: Sequence[Any], workspace: Floats) -> None:
        """Go on where another run was."""
        self.first, self._progress[0], self._set, self._set_until = position
        later = len(self._column) - len(workspace)  # rows that an older module had not
        self._column[:] = np.insert(workspace, [self.header.rows - later] * later, 0.0)
