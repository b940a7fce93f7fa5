"""Runs with events that act: steps are split where one is, and the grid of times is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.program.status import Status
from symsimpson.results.acted import Record
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.actions import Actor
from symsimpson.run.integrate import begin_run, look_at_step, new_run, raise_failure, trajectory_of
from symsimpson.run.verdict import verdict
from symsimpson.stepping.acting import Acting, Impact, read_events
from symsimpson.stepping.inputs import read_failure
from symsimpson.stepping.parts import Parts
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, read_run

if TYPE_CHECKING:
    from symsimpson.program.program import Program

__all__ = ["acting_run"]

Floats = NDArray[np.float64]
Sides = NDArray[np.int64]
#: When events have acted within a step, by their numbers.
Times = dict[int, list[float]]
#: So many steps are looked at together, at first and behind an event, and at most.
FEW, MOST = 16, 4096
#: A rest of a step below this part of it is none; events that are so near act together.
NOTHING, TOGETHER = 4 * 2.0**-52, 16 * 2.0**-52
#: Impacts whose times add up to less than this part of a step from the last one on accumulate; so
#: do more actions than these within one step.
ACCUMULATED, MOST_ACTIONS = 1e-6, 500
#: A start may be so far behind a wall, relative to its size.
BEHIND = 1e-9
#: Times from one to the next have one ratio then, but for this part of it.
STEADY = 0.1
#: Where an expression is zero behind an action, its sign is that after so much of a step.
AHEAD = 1e-6


def acting_run(
    program: Program, request: Request, progress: bool | None, on_failure: str
) -> Trajectory:
    """Run with events that act.

    Raises
    ------
    InputError, ConvergenceError, Interrupted
    """
    read_failure(on_failure)
    _refuse(program, request)
    acting = read_events(program, request.events)
    spec = read_run(program, request)
    with program.numbers.working():
        under_way = _Run(program, spec, acting)
        with under_way.run.watched(spec.steps, progress):
            under_way.advance()
        trajectory = under_way.trajectory()
    if not trajectory.success and on_failure == "raise":
        raise_failure(under_way.run, trajectory, trajectory)
    return trajectory


def _refuse(program: Program, request: Request) -> None:
    """Refuse what does not go with events that act, so far."""
    why = ""
    if program.numbers.epsilon != np.finfo(float).eps:
        why = "many digits"
    elif program.header.retimed:
        why = "a rate: the energy of a retimed run stays as it is"
    for name in ("t_eval", "save", "tangents", "sensitivities", "checkpoint", "record", "reduce"):
        if getattr(request, name) is not None:
            why = f"{name}="
    if why:
        raise InputError(
            f"{program.system}: events that act do not go with {why}.\nLeave one of them out; "
            "events without an action are found behind a run, by run.events(expression)."
        )


@dataclass
class _Run:
    """A run with events under way.

    Attributes
    ----------
    side : ndarray of int
        On which side of zero each expression is; 0 where that is not known.
    size : ndarray
        The largest value of each so far.
    """

    program: Program
    spec: RunSpec
    acting: Acting
    run: Run = field(init=False)
    actor: Actor = field(init=False)
    records: list[Record] = field(default_factory=list)
    ended_by: str | None = None

    def __post_init__(self) -> None:
        program, spec, acting = self.program, self.spec, self.acting
        self.run = new_run(program, spec, 1, min(MOST, spec.steps) + 1)
        begin_run(program, self.run, spec)
        if spec.steps:
            look_at_step(program, self.run, spec)
        self.actor = Actor(program, spec, acting)
        self._parts = Parts(program, spec.parameters, float(spec.h), spec.inputs)
        self.size = np.zeros(len(acting.events))
        self.side: Sides = np.zeros(len(acting.events), dtype=np.int64)
        self._signs = np.array([event.sign for event in acting.events])
        self.left = [int(event.terminal) or -1 for event in acting.events]
        self._kept: list[tuple[Floats, Floats, NDArray[np.int64]]] = []
        self._status: Status | None = None
        self._message = ""
        self._end: tuple[float, Floats, Floats] | None = None
        self._keep(slice(0, 1))
        self._begin()

    def _begin(self) -> None:
        """Look at the start: impacts that touch act there, none may be behind its wall."""
        q, p = (x[0].copy() for x in self.run.end())
        t = float(self.spec.t0)
        row = self.actor.row(t, (q, p))
        values = row[: len(self.side)]
        self.size = np.maximum(np.abs(values), self.actor.sizes(row, q))
        self.side = self._sides(values, np.zeros_like(self.side))  # a zero there is no event
        for k, event in enumerate(self.acting.events):
            off = BEHIND * max(1.0, self.size[k])
            if not (isinstance(event.action, Impact) and self.actor.allowed(row, k)):
                continue
            if values[k] < -off:
                raise InputError(
                    f"{self.program.system}: the start is behind the wall {event.key!r}: the gap "
                    f"is {values[k]:g}.\nBegin where it is positive, or turn its sign."
                )
            self.side[k] = 1
        if self.actor.touching(values, self._small).any():
            state = self._act(t, 0, (q, p), [], {})
            if state is not None:
                self.run.go_on_from(state, 0)
                self._kept.clear()
                self._keep(slice(0, 1))

    @property
    def _small(self) -> Floats:
        """Values below these are zeros: rounding."""
        return 64 * 2.0**-52 * self.size

    def _sides(self, values: Floats, before: Sides) -> Sides:
        """Return on which sides of zero values are; near it they stay where they were."""
        side = np.sign(np.nan_to_num(values)).astype(np.int64)
        return np.where(np.abs(values) <= self._small, before, side)

    def advance(self) -> None:
        """Take all steps, or as many as there are until the run ends."""
        run, steps, piece = self.run, self.spec.steps, FEW
        while run.step < steps and run.alive and self._status is None:
            run.advance(min(run.step + piece, steps))
            k = self._first_event()
            if k is None:
                self._keep(slice(1, run.step - run.first + 1))
                run.forget()
                piece = min(2 * piece, MOST)
                if run.status is Status.INTERRUPTED:
                    return
                continue
            piece = FEW
            self._keep(slice(1, k + 1))
            first, start = run.first, (run.q[k, :, 0].copy(), run.p[k, :, 0].copy())
            state = self._split(first + k, start)
            if state is None:
                run.go_on_from(start, first + k)
                return
            run.go_on_from(state, first + k + 1)
            self._keep(slice(0, 1))
        if run.step == steps and run.alive and self._status is None and steps:
            self._finish()

    def _finish(self) -> None:
        """Let events act whose zero is the last state."""
        q, p = (x[0].copy() for x in self.run.end())
        t, values = float(self.run.t0 + self.run.h * self.run.step), self.actor.values
        here = np.abs(values(t, (q, p))) <= self._small
        events = np.flatnonzero(here & self._acts(self.side, -self.side)).tolist()
        if events:
            state = self._act(t, self.run.step, (q, p), events, {})
            if state is not None:
                self._kept[-1][0][-1], self._kept[-1][1][-1] = state
                self.run.go_on_from(state, self.run.step)

    def _keep(self, some: slice) -> None:
        """Keep states of the grid."""
        run = self.run
        q, p = (x[some, :, 0].copy() for x in (run.q, run.p))
        self._kept.append((q, p, run.iterations[some, 0].copy()))

    def _first_event(self) -> int | None:
        """Return the first of the steps just taken in which an expression changes its sign."""
        run, kept = self.run, self.run.step - self.run.first
        q, p = run.q[: kept + 1, :, 0], run.p[: kept + 1, :, 0]
        t = run.t0 + run.h * (run.first + np.arange(kept + 1))
        values = np.ascontiguousarray(self.actor.looks(t, q, p).T)  # a row for each event
        self.size = np.fmax(self.size, np.fmax.reduce(np.abs(values), axis=1))
        sides = self._sides(values.T, np.zeros_like(self.side)).T
        sides[:, 0] = self.side
        if (sides == 0).any():  # near zero they stay where they were
            place = np.where(sides == 0, 0, np.arange(kept + 1))
            sides = np.take_along_axis(sides, np.maximum.accumulate(place, axis=1), axis=1)
        met = self._acts(sides[:, :-1].T, sides[:, 1:].T)
        met |= self.actor.dips(t, q, p, values, self._small)
        sides = sides.T
        here = np.flatnonzero(met.any(axis=1))
        self.side = sides[here[0]] if here.size else sides[-1]
        return int(here[0]) if here.size else None

    def _acts(self, before: Sides, behind: Sides) -> NDArray[np.bool_]:
        """Return which events act between two sides."""
        return (before * behind < 0) & ((self._signs == 0) | (behind == self._signs))

    def _split(self, step: int, start: Any) -> Any:
        """Take a step with events in it; None where the run ends within it."""
        h, t0 = float(self.spec.h), float(self.spec.t0 + self.spec.h * step)
        state, done = start, 0.0
        times: Times = {}
        for action in count():
            if action > MOST_ACTIONS:
                why = f"More than {MOST_ACTIONS} events act within one step, or one acts for ever. "
                return self._fail(
                    Status.EVENTS_ACCUMULATE, why + "Take a smaller h if they do not. "
                )
            rest = h - done
            if abs(rest) <= NOTHING * abs(h):
                return state
            end, status = self._parts(state, t0 + done, rest, step, done / h)
            if status is not Status.SUCCESS:
                return self._fail(status)
            found = self._located(step, t0, done, rest, state, end)
            if found is None:
                values = self.actor.values(t0 + h, end)
                self.side = self._sides(values, self.side)
                return end
            part, state, events = found
            done += part
            if not events:  # a look between the ends of the step, at which nothing acts
                continue
            state = self._act(t0 + done, step, state, events, times)
            if state is None:
                return None

    def _located(
        self, step: int, t0: float, done: float, rest: float, start: Any, end: Any
    ) -> tuple[float, Any, list[int]] | None:
        """Find the first events of the rest of a step: when, where, and which."""
        h = float(self.spec.h)

        def after(part: float) -> Any:
            state, status = self._parts(start, t0 + done, part, step, done / h)
            return state if status is Status.SUCCESS else (np.nan * start[0], np.nan * start[1])

        def row(part: float) -> Floats:
            return self.actor.row(t0 + done + part, after(part))

        first, last = self.actor.row(t0 + done, start), self.actor.row(t0 + h, end)
        sides = self._sides(last[: len(self.side)], self.side)
        met = np.flatnonzero(self._acts(self.side, sides)).tolist()
        ends = dict.fromkeys(met, rest)
        for k in self.actor.dipping(first, last, self._small, rest):
            if k not in met:
                lowest = self.actor.root(row, self.actor.rate(k), 0.0, rest)
                if row(lowest)[k] < -self._small[k]:
                    ends[k] = lowest
        roots = {
            k: self.actor.root(row, k, 0.0, until, float(self.side[k])) for k, until in ends.items()
        }
        if not roots:
            return None
        part = min(roots.values(), key=lambda x: abs(x))
        near = TOGETHER * max(abs(t0 + done + part), abs(h))
        return part, after(part), [k for k, x in roots.items() if abs(x - part) <= near]

    def _act(self, t: float, step: int, state: Any, events: Sequence[int], times: Times) -> Any:
        """Let events act on a state, and keep records; None where the run ends with them."""
        row, small, given = self.actor.row(t, state), self._small, state
        allowed = [k for k in events if self.actor.allowed(row, k)]
        for k in events:  # an impact leads back to its side, unless it is not allowed
            if not (k in allowed and self.actor.is_impact(k)):
                self.side[k] = -self.side[k]
        done = list(self.actor.acted(t, state, allowed, small))
        several = len({k for k, *_, impulse in done if impulse}) > 1
        for k, before, behind, impulse in done:
            state = behind
            direction = -1 if self.actor.is_impact(k) else int(self.side[k])
            together = several and self.actor.is_impact(k)
            self.records.append(Record(k, t, step, *before, *behind, direction, impulse, together))
            if self.actor.loses(k, before, behind, t):
                times.setdefault(k, []).append(t)
            self.left[k] -= 1
            if self.left[k] == 0:
                self.ended_by = self.acting.names[k]
        if self.actor.failed:
            return self._fail(Status.BAD_INPUT, self.actor.failed)
        if not all(np.isfinite(x).all() for x in state):
            return self._fail(Status.NOT_FINITE)
        if self.ended_by is not None:
            self._end, self._status = (t, *state), Status.SUCCESS
            return None
        if state is not given:
            self._look_ahead(t, step, state)
        return None if self._accumulates(times) else state

    def _look_ahead(self, t: float, step: int, state: Any) -> None:
        """Find on which sides expressions are behind an action, of zeros by a look ahead."""
        values = self.actor.values(t, state)
        begin = float(self.spec.t0 + self.spec.h * step)
        size, share = AHEAD * float(self.spec.h), (t - begin) / float(self.spec.h)
        soon, status = self._parts(state, t, size, step, share)
        ahead = self.actor.values(t + size, soon) if status is Status.SUCCESS else 0 * values
        fresh = self._sides(values, np.sign(ahead).astype(np.int64))
        self.side = np.where(self.actor.impacts, self.side, fresh)

    def _accumulates(self, times: Times) -> bool:
        """Return whether impacts that lose energy follow each other ever faster: the run ends."""
        h = abs(float(self.spec.h))
        for k, hits in times.items():
            if len(hits) < 4:
                continue
            first, late, later = np.diff(hits[-4:])
            before, ratio = (late / first, later / late) if first and late else (1.0, 1.0)
            steady = abs(ratio - before) <= STEADY * abs(before)
            left = ratio / (1 - ratio) * later if 0 <= ratio < 1 else np.inf
            if steady and abs(left) < ACCUMULATED * h:
                name, about = self.acting.names[k], float(hits[-1] + left)
                why = f"{name!r} acts ever faster up to t={about!r}. "
                self._fail(Status.EVENTS_ACCUMULATE, why)
                return True
        return False

    def _fail(self, status: Status, why: str = "") -> None:
        self._status, self._message = status, why

    def trajectory(self) -> Trajectory:
        """Return what the run has come to."""
        run, spec, program = self.run, self.spec, self.program
        q, p, iterations = (np.concatenate(x) for x in zip(*self._kept, strict=True))
        if run.status is Status.INTERRUPTED:  # wherever that was heard
            run.go_on_from((q[-1], p[-1]), len(q) - 1)
            self.records = [one for one in self.records if one.step < len(q) - 1]
        status = run.status if self._status is None else self._status
        every = spec.every
        some = slice(None, None, every or 1)
        stored = q[some], p[some], iterations[some], np.zeros((len(q[some]), 0))
        trajectory = trajectory_of(program, run, spec.steps, status, spec, stored, every)
        about = trajectory.__getstate__()
        about |= {"records": tuple(self.records), "actors": self.acting.names}
        if self._message:
            before, taken, _ = about["message"].partition(" was not taken. ")
            general = status.message if status is Status.EVENTS_ACCUMULATE else ""
            about["message"] = f"{before}{taken}{self._message}{general}".strip()
        if self._end is not None:
            t, q_end, p_end = self._end
            about["ended_by"] = self.ended_by
            keep = slice(None) if every else slice(0, 0)
            about["t"] = np.append(trajectory.t[keep], t)
            about["q"] = np.vstack([trajectory.q[keep], q_end])
            about["p"] = np.vstack([trajectory.p[keep], p_end])
            about["newton_iterations"] = np.append(trajectory.newton_iterations[keep], 0)
            about["message"] = f"{self.ended_by!r} ended the run at t={t:g}."
        found = Trajectory(**about)
        if status is Status.SUCCESS and not self.records and spec.steps and every:
            run.every = every
            with np.errstate(invalid="ignore"):  # of states that do not move
                return verdict(program, run, found, stored)
        return found
