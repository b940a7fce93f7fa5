"""Runs of systems with contacts and dry friction: pieces of smooth motion, one for each mode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.errors import ModelWarning, reject
from symsimpson.program.status import Status
from symsimpson.results.event_record import EventRecord
from symsimpson.results.mode_history import ModeHistory, Piece
from symsimpson.run.contact_states import ContactStates
from symsimpson.run.decide import MOST_TRIED, StateOfContacts
from symsimpson.run.event_run import MOST_ACTIONS
from symsimpson.run.mode_piece import PieceRun
from symsimpson.run.mode_programs import (
    GAP,
    LIFT,
    MARGIN,
    SLIP,
    USER,
    Cause,
    ModeProgram,
    ModePrograms,
)
from symsimpson.run.work_columns import WorkColumns
from symsimpson.stepping.event import Change, Impact
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, make_recorders
from symsimpson.support.array_types import Floats, Reals, State
from symsimpson.support.calling import warn
from symsimpson.support.contact_values import Mode
from symsimpson.text.driver.impacts import TOGETHER
from symsimpson.text.interface import ARRIVED

if TYPE_CHECKING:
    from symsimpson.program.program import Program

#: Changes of the mode at one time, beside one for each contact and element.
MOST_AT_ONE_TIME = 10


class ModeRun(Run):
    """A run through the modes of a system with contacts and dry friction.

    Its states belong to the system without contacts, whose momenta are the same in all modes.
    """

    def __init__(
        self, program: Program, spec: RunSpec, storage: tuple[int, int], inputs: Reals
    ) -> None:
        header, self._varied = program.header, 0
        if spec.tangents is not None:
            self._varied = spec.tangents.shape[1] + len(header.varied_by or ())
        carried = make_recorders(header, self._varied or None, (), ())
        first = header.rows + sum(recorder.room for recorder in carried)
        self._columns = WorkColumns(program, first, works="work" in spec.record)
        given = spec.parameters, spec.h, spec.t0, storage
        recorders = [*carried, *self._columns.recorders()]
        super().__init__(program, *given, inputs=inputs, recorders=recorders)
        self._program, self._spec, self._modes = program, spec, program.modes
        events = () if spec.run_events is None else spec.run_events.events
        self._programs = ModePrograms(program, events, spec.reductions)
        self._contacts = ContactStates(program, spec, self._programs.actions, inputs)
        self._user, self._mode = events, Mode((), ())
        self._piece: PieceRun | None = None
        #: Number of changes at the last time, and that time; the last step, and changes in it.
        self._acted_at, self._acted_in = [0, 0.0], [-1, 0]
        self._history = list[Piece]()
        self._choices, self._warned = 0, False
        #: Variations of the state, one column each, and of the time of the last event.
        self._variations, self._moved = np.zeros((2 * header.n, 0)), np.zeros(self._varied)

    # the start

    def observe_start(self) -> None:
        """Find the mode of the initial state, and begin its piece."""
        t, state = float(self.t0), self._state()
        if self._spec.h < 0:
            self._reject_backward()
        rows = self._tangent_rows(self)
        self._variations = rows.reshape(self._varied, 2 * self.header.n).T.copy()
        at = self._contacts.look(t, state, 0)
        for c, name in enumerate(self._modes.contacts):
            if at.at.gaps[c] < 0 and not at.touching[c]:
                reject(
                    f"the initial state violates the gap {name!r}, whose value is "
                    f"{at.at.gaps[c]:g}.",
                    where=self._program.system,
                    remedy="Start where the gap is positive, or change the sign of the gap.",
                )
        still = at.still(at.counts.contact_rows)
        contacts = tuple(bool(x) for x in at.touching & still)
        self._mode = at.with_directions(Mode(contacts, (0,) * at.counts.elements))
        near = at.touching & ~still & (at.contact_rates < 0)
        hits = [Cause(GAP, int(c)) for c in np.flatnonzero(near)]
        self._go_on(t, state, 0, hits)
        self.store(0)

    def _tangent_rows(self, run: Run) -> Any:
        """Return the rows of a run that have the variations, one after another."""
        size = 2 * self.header.n * self._varied
        return run.rows("TANGENT", size) if size else run.W[:0, 0]

    def _reject_backward(self) -> None:
        if self._modes.elements or any(x != 1 for x in self._modes.restitutions):
            reject(
                "h is negative, but the system has dry friction or impacts that lose energy.",
                where=self._program.system,
                why="Such a motion cannot be undone.",
                remedy="Pass a positive h.",
            )

    # the steps

    def _state(self) -> State:
        return self.end()[0][0], self.end()[1][0]

    def advance(self, stop: int) -> None:
        """Take steps until ``stop`` or failure, piece by piece."""
        while self.step < stop and self.alive:
            piece = self._piece
            assert piece is not None
            if self._signals:
                raise KeyboardInterrupt
            piece.follow(self.first, self.step, self._signals, self._watcher)
            before = self.step
            try:
                piece.advance(stop)
            finally:
                self._copy(piece, before)
            if piece.has_arrived:
                self._end_piece(piece)
            elif not piece.alive:
                self.reason = piece.reason
                self._column[self._status] = int(piece.status)

    def _copy(self, piece: PieceRun, before: int) -> None:
        """Copy the state, and sums over steps, of a piece."""
        self._progress[0] = piece.step - self.first
        rows = 4 * self.header.n
        self.rows("POSITION", rows)[:] = piece.rows("POSITION", rows)
        self.rows("ITERATIONS", 1)[:] = piece.rows("ITERATIONS", 1)
        program, causes = self._history[-1].program, self._history[-1].causes
        assert program is not None
        for record in piece.records[piece.taken :]:
            if causes[record.event].kind == USER and record.event not in piece.ending:
                number = len(self._modes.names) + causes[record.event].number
                self.records.append(record.of_event(number))
        piece.taken = len(piece.records)
        width, every = len(self._tangent_rows(self)), self.every
        if width and every:
            some = slice((before - self.first) // every + 1, (self.step - self.first) // every + 1)
            self.recorded[some, :width] = piece.recorded[some, :width]
        self._tangent_rows(self)[:] = self._tangent_rows(piece)
        self._columns.copy(piece, program, self.recorded, self.every, (before, self.step))
        self._column[self._columns.rows] = self._columns.now(piece, program)

    def discard_stored(self) -> int:
        """Discard all stored states but the last; return how many were discarded."""
        count = super().discard_stored()
        if self._piece is not None and count:
            self._piece.recorded[0] = self._piece.recorded[count]
        return count

    # the end of a mode

    def _end_piece(self, piece: PieceRun) -> None:
        """Let the events at the end of a piece act, and go on in the next mode."""
        assert piece.end_within is not None
        t, step = float(piece.end_within[0]), piece.step
        near = TOGETHER * max(abs(t), abs(float(self.h)))
        if self._varied:
            salt = piece.saltation
            assert salt is not None
            self._variations, self._moved = salt.columns.copy(), salt.time_changes.copy()
        causes, state = list[Cause](), (piece.end_within[1], piece.end_within[2])
        for record in piece.records:
            cause = self._history[-1].causes[record.event]
            if abs(record.t - t) <= near:
                if not causes:
                    state = record.q, record.p
                causes.append(cause)
        if self._check_terminal():
            return
        self._go_on(t, state, step, causes)

    def _acts(self, event: int) -> bool:
        return isinstance(self._user[event].action, (Impact, Change))

    def _check_terminal(self) -> bool:
        """Check whether a terminal event of the user has ended the run."""
        for j, event in enumerate(self._user):
            number = len(self._modes.names) + j
            acted = [x for x in self.records if x.event == number] if event.terminal else []
            if event.terminal and len(acted) >= int(event.terminal):
                self.ended_by, last = event.key, acted[-1]
                self.end_within = last.t, last.q_after, last.p_after
                self.reason = f"{event.key!r} ended the run at t={last.t:g}."
                self._column[self._status] = ARRIVED
                return True
        return False

    def _go_on(self, t: float, state: State, step: int, causes: Sequence[Cause]) -> None:
        """Let causes act on a state, choose the next mode, and begin its piece."""
        if any(cause.kind == MARGIN for cause in causes):
            return self._fail(Status.CONTACT_PARADOX, t)
        if self._is_endless(t, step):
            return
        mode, left = self._mode, set[tuple[bool, int]]()
        for kind, number, sign in causes:
            if kind == LIFT:
                mode = mode.with_contact(number, False)
                left.add((True, number))
            elif kind == SLIP:
                mode = mode.with_element(number, sign)
                left.add((False, number))
            elif kind == GAP:  # it rests, if it touches and does not move
                mode = mode.with_contact(number, True)
            elif kind != USER:
                mode = mode.with_element(number, 0)
        acting = [
            cause.number + (len(self._modes.contacts) if cause.kind == USER else 0)
            for cause in causes
            if cause.kind == GAP or (cause.kind == USER and self._acts(cause.number))
        ]
        if acting:
            after = self._act(t, state, step, acting)
            if after is None:
                return
            state = after
        self._choose(t, state, step, mode, frozenset(left))

    def _is_endless(self, t: float, step: int) -> bool:
        """Check whether modes change without end; the run then fails."""
        near = TOGETHER * max(abs(t), abs(float(self.h)))
        same = abs(t - self._acted_at[1]) <= near
        self._acted_at = [self._acted_at[0] + 1 if same else 0, self._acted_at[1] if same else t]
        within = self._acted_in[0] == step
        self._acted_in = [step, self._acted_in[1] + 1 if within else 0]
        if self._acted_at[0] > 2 * len(self._modes.names) + MOST_AT_ONE_TIME:
            self._fail(Status.CONTACT_UNDECIDED, t)
        elif self._acted_in[1] > MOST_ACTIONS:
            self._fail(Status.EVENTS_ACCUMULATE, t)
        return not self.alive

    def _act(self, t: float, state: State, step: int, acting: list[int]) -> State | None:
        """Let impacts and changes act on a state, and record them."""
        contacts, names = len(self._modes.contacts), len(self._modes.names)
        if not self._warned:
            hit = self._contacts.look(t, state, step).sliding_contacts(acting)
            self._warned = bool(hit)
            if hit:
                name = self._modes.contacts[hit[0]]
                warn(
                    f"{self._program.system}: the contact {name!r} collides while it slides. "
                    "Impulses have no friction here, so sliding does not change at the impact.",
                    ModelWarning,
                )
        done = self._contacts.act(t, state, acting)
        if self._varied:
            moved = self._variations, self._moved
            self._variations = self._contacts.vary_actions(t, done, *moved)
        impacts = {k for k, *_, impulse in done if impulse}
        for k, before, after, impulse in done:
            number, impact = (k if k < contacts else names + k - contacts), k < contacts
            kind = "impact" if impact else ""
            several = len(impacts) > 1 and bool(impulse)
            direction = -1 if impact else 0
            self.records.append(
                EventRecord(number, t, step, *before, *after, direction, impulse, several, kind)
            )
            state = after
        if self._contacts.failure:
            self._fail(Status.BAD_INPUT, t, self._contacts.failure)
            return None
        return None if self._check_terminal() else state

    def _choose(
        self, t: float, state: State, step: int, mode: Mode, left: frozenset[tuple[bool, int]]
    ) -> None:
        """Choose the mode after an event; contacts whose impacts accumulate rest."""
        given, at = state, self._contacts.look(t, state, step, left)
        settled: dict[int, float] = {}
        for _ in range(2 + len(self._modes.contacts)):
            if (bad := at.bad_limit()) is not None:
                name = self._modes.elements[bad]
                why = (
                    f"The limit of {name!r} is negative or not finite, or its static limit is "
                    f"smaller, at t={t:g}. "
                )
                return self._fail(Status.BAD_INPUT, t, why)
            chosen, more = at.decide(at.with_directions(mode))
            if chosen is None or at.paradox(chosen):
                return self._fail_undecided(t, at)
            self._choices += more
            resting = self._contacts.accumulated(at, chosen)
            if not resting:
                break
            settled |= {c: t + delta for c, delta in resting.items()}
            mode = chosen
            for c in settled:
                mode = mode.with_contact(c, True)
            mode = at.with_directions(mode)
            state, at = self._project(t, state, at, mode, step, left)
        else:
            return self._fail_undecided(t, at)
        state, at = self._project(t, state, at, chosen, step, left)
        for number, kind in self._kinds(chosen):
            when = settled.get(number, t)
            sign = {"slip+": 1, "slip-": -1}.get(kind, 0)
            change = *given, *state
            self.records.append(EventRecord(number, when, step, *change, sign, 0.0, False, kind))
            given = state  # the energy of a projection counts once
        self._mode = chosen
        self._begin(t, state, step, at.implied(chosen))

    def _project(
        self,
        t: float,
        state: State,
        at: StateOfContacts,
        mode: Mode,
        step: int,
        left: frozenset[tuple[bool, int]],
    ) -> tuple[State, StateOfContacts]:
        """Project a state, and its variations, to the rows of a mode."""
        state, at = self._contacts.project(t, state, at, mode, step, left)
        if self._varied and at.rows_of(mode):
            given = t, state, mode, step, self._variations, self._moved
            self._variations = self._contacts.vary_projection(*given)
        return state, at

    def _kinds(self, new: Mode) -> list[tuple[int, str]]:
        """Return the numbers of contacts and elements that change, and what they begin."""
        if not self._history:
            return []
        names = {"rest": "rest", "open": "lift", 0: "stick", 1: "slip+", -1: "slip-"}
        pairs = zip(self._shown(), new.states(self._modes.contact_of), strict=True)
        changed = enumerate(pairs)
        return [(k, names[x]) for k, (was, x) in changed if was != x and x is not None]

    def _begin(self, t: float, state: State, step: int, implied: frozenset[int]) -> None:
        """Begin a piece in the present mode."""
        use = self._programs(self._mode, self._counts(), implied)
        piece, previous = self._make_piece(state, use), self._piece
        piece.continues = previous is not None
        if previous is not None:
            program = self._history[-1].program
            assert program is not None
            self._columns.end(previous, program)
            _carry_reductions(previous, piece)
        piece.rows("ITERATIONS", 1)[:] = self.rows("ITERATIONS", 1)
        done = t - float(self._grid_time_of(step))
        if abs(done) <= TOGETHER * max(abs(t), abs(float(self.h))):
            done = 0.0
        values = use.values(self._spec.parameters)
        about = self._mode, self._shown(), use.program, values, use.causes
        self._history.append(Piece(t, state, step, *about))
        self._piece = piece
        if self._varied:
            piece.carry(self._variations, self._moved)
        piece.begin_piece(state, self.first, step, done)
        self.rows("POSITION", 2 * self.header.n)[:] = np.concatenate(state)

    def _shown(self) -> tuple[str | int | None, ...]:
        return self._mode.states(self._modes.contact_of)

    def _counts(self) -> list[int]:
        """Return how often each terminal event of the user has acted."""
        names = len(self._modes.names)
        return [
            sum(x.event == names + j for x in self.records) if event.terminal else 0
            for j, event in enumerate(self._user)
        ]

    def _make_piece(self, state: State, use: ModeProgram) -> PieceRun:
        """Return a piece in a mode, at a state."""
        spec, header = self._spec, use.program.header
        values = use.values(spec.parameters)
        of_mode = RunSpec(
            *(*state, "p0", values, spec.h, spec.t0, spec.steps, self.every, self._inputs),
            record=spec.record,
            reductions=use.reductions,
            run_events=use.events,
            tangents=spec.tangents,
        )
        carried = self._varied or None
        recorders = make_recorders(header, carried, spec.record, use.reductions)
        storage = self.every, 1
        piece = PieceRun(use.program, of_mode, use.events, storage, self._inputs, recorders)
        piece.ending = frozenset(
            k
            for k, cause in enumerate(use.causes)
            if cause.kind != USER or self._acts(cause.number)
        )
        piece.begin(*state, velocity=False)
        piece.share_arrays(self)
        return piece

    def _grid_time_of(self, step: int) -> Any:
        return self.t0 + self.h * step

    # files

    def position(self) -> list[Any]:
        """Return counters, records and modes that, with the workspace, restore the run."""
        pieces = [[x.t, *map(list, x.state), x.step, *map(list, x.mode)] for x in self._history]
        piece = self._piece
        assert piece is not None
        records = [record.as_json for record in self.records]
        inside = [piece.position(), piece.W[:, 0].tolist(), list(piece.begin_at)]
        counters = [self._acted_at, self._acted_in, self._columns.before.tolist(), self._choices]
        return [*super().position(), self.reason, records, pieces, inside, counters]

    def restore(self, position: Sequence[Any], workspace: Floats) -> None:
        """Restore the counters, records, modes and workspace of another run."""
        *rest, self.reason, records, pieces, inside, counters = position
        super().restore(rest, workspace)
        self.records[:] = [EventRecord.read(entry) for entry in records]
        self._history = list[Piece]()
        for t, q, p, step, contacts, elements in pieces:
            self._mode, state = Mode(tuple(contacts), tuple(elements)), (np.array(q), np.array(p))
            use = self._programs(self._mode, self._counts())
            values = use.values(self._spec.parameters)
            about = self._mode, self._shown(), use.program, values, use.causes
            self._history.append(Piece(t, state, step, *about))
        self._piece = piece = self._make_piece(state, use)
        where, column, begin_at = inside
        piece.restore(where, np.array(column))
        piece.begin_at = int(begin_at[0]), float(begin_at[1])
        self._acted_at, self._acted_in, before, self._choices = counters
        self._columns.before = np.array(before)
        self.ended_by = self.end_within = None
        if piece.has_arrived:
            self._check_terminal()

    # the outcome

    def _fail_undecided(self, t: float, at: StateOfContacts) -> None:
        if at.number_of_choices() > MOST_TRIED:
            return self._fail(Status.CONTACT_UNDECIDED, t)
        if all(at.motion(mode) is None for mode in at.choices()):
            return self._fail(Status.SINGULAR_CONSTRAINTS, t)
        if any(contact is not None for contact in self._modes.contact_of):
            return self._fail(Status.CONTACT_PARADOX, t)
        return self._fail(Status.CONTACT_UNDECIDED, t)

    def _fail(self, status: Status, t: float, why: str = "") -> None:
        pairs = zip(self._modes.contacts, self._mode.contacts, strict=True)
        touching = [name for name, rests in pairs if rests] or self._modes.names
        what = f"At t={t:g}, with {', '.join(map(repr, touching))}: "
        self.reason = why.strip() or f"{what}{status.message}"
        self._column[self._status] = int(status)

    def reduction_values(self, reductions: Sequence[Any]) -> tuple[tuple[str, float], ...]:
        """Return the names and current values of reductions, including counts of events."""
        known = {} if self._piece is None else dict(self._piece.reduction_values(reductions))
        names = [self._programs.names[record.event] for record in self.records]
        for candidate in reductions:
            if candidate.kind == "count":
                known[candidate.name] = float(names.count(candidate.expression))
        return tuple((reduction.name, known[reduction.name]) for reduction in reductions)

    @property
    def history(self) -> ModeHistory:
        """The modes so far."""
        modes = self._modes
        about = self._choices, len(modes.contacts), modes.works
        return ModeHistory(modes.names, tuple(self._history), *about)

    def recorded_fields(self, recorded: Reals, result: Any) -> dict[str, Any]:
        """Split recorded rows into fields of a trajectory; add records and modes."""
        acted = {"records": tuple(self.records), "event_names": self._programs.names}
        more = {"ended_by": self.ended_by, "history": self.history}
        return {**super().recorded_fields(recorded, result), **acted, **more}


def _carry_reductions(previous: PieceRun, piece: PieceRun) -> None:
    """Copy the rows of reductions from one piece to the next one."""
    rows = [
        run.W[recorder.first : recorder.first + recorder.room]
        for run in (previous, piece)
        for recorder in run.recorders
        if recorder.kernel == "observe"
    ]
    if rows:
        rows[1][:] = rows[0]
