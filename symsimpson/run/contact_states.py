"""States at the events of contacts: what touches and slides there, impacts, and projections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from symsimpson.program.evaluation import evaluate
from symsimpson.run.decide import TOLERANCE, StateOfContacts
from symsimpson.run.event_actions import EventActions
from symsimpson.run.saltation import EventDerivatives
from symsimpson.stepping.driving import interpolate_inputs
from symsimpson.stepping.run_events import RunEvents
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, Reals, State
from symsimpson.support.contact_values import Mode, weighted_mass
from symsimpson.text.interface import ZERO

if TYPE_CHECKING:
    from symsimpson.program.program import Program

#: Impacts that follow each other within this part of a step end in rest.
NEGLIGIBLE = 1e-7
EPSILON = 2.0**-52
#: Imaginary part for derivatives, far below round-off.
IMAGINARY = 1e-40


class ContactStates:
    """Evaluates contacts and friction at states of a run, and lets impacts act there.

    ``failure`` has the reason if an action is impossible.
    """

    def __init__(self, program: Program, spec: RunSpec, actions: RunEvents, inputs: Reals) -> None:
        self._program, self._spec, self._events = program, spec, actions
        self._modes, self._h = program.modes, float(spec.h)
        self._actions = EventActions(program, spec, actions)
        self._inputs, self._derivatives = inputs, cast("EventDerivatives | None", None)

    @property
    def failure(self) -> str:
        """Why an action is impossible; empty if all were possible."""
        return self._actions.failure

    def look(
        self, t: float, state: State, step: int, left: frozenset[tuple[bool, int]] = frozenset()
    ) -> StateOfContacts:
        """Evaluate contacts and friction at a state (q, p), with the inputs of a step."""
        (q, p), program, values = state, self._program, self._spec.parameters
        there = np.array([t]), q[None], p[None]
        v = evaluate(program, "energy", "VELOCITY", program.n, there, values)[0]
        at = self._at(t, q, v, step, left)
        if program.tools is None:
            return at
        given = [*values.tolist(), *self._inputs_at(t, step).tolist()]
        terms = program.tools.force_terms(program.declared, q.tolist(), given, t)
        return replace(at, terms=np.fmax(terms, np.abs(at.at.push)))

    def _inputs_at(self, t: float, step: int) -> Floats:
        """Return the inputs at a time in a step."""
        if not self._inputs.size:
            return np.asarray(self._inputs[0, 0, 0])
        share = np.array([[(t - float(self._spec.t0)) / self._h - step]])
        given = self._program, self._inputs, np.array([step])
        return np.asarray(interpolate_inputs(*given, share)[0, 0, 0])

    def _at(
        self,
        t: Any,
        q: Floats,
        v: Floats,
        step: int,
        left: frozenset[tuple[bool, int]],
        values: Reals | None = None,
    ) -> StateOfContacts:
        """Evaluate contacts and friction at a state (q, v)."""
        values = self._spec.parameters if values is None else values
        modes, inputs = self._modes, self._inputs_at(float(np.real(t)), step)
        at = modes.index_one(t, q, v, values, inputs)
        counts = modes.index_one.counts
        return StateOfContacts(at, counts, modes.contact_of, q, v, self._h, left)

    def act(
        self, t: float, state: State, acting: list[int]
    ) -> list[tuple[int, State, State, float]]:
        """Let impacts and changes act on a state; return each with the states around it."""
        actions = self._actions
        row = actions.row(t, state)
        values = row[: len(self._events.events)]
        moved = self._h * actions.rates(row)
        sizes = np.max([abs(values), abs(moved), actions.sizes(row, state[0])], axis=0)
        return list(actions.apply(t, state, acting, ZERO * sizes))

    def vary_actions(
        self,
        t: float,
        done: Sequence[tuple[int, State, State, float]],
        columns: Floats,
        moved: Floats,
    ) -> Floats:
        """Apply the derivatives of impacts and changes to variations of the state.

        ``moved`` are the variations of the time.
        """
        if self._derivatives is None:
            given = self._program, self._events, self._spec.parameters
            self._derivatives = EventDerivatives(*given)
        derivatives, varied = self._derivatives, self._program.header.varied_by or ()
        for k, before, _, _ in done:
            variations = derivatives.point_variations(moved, columns, varied)
            act = partial(derivatives.act, k)
            slopes = derivatives.slopes(act, derivatives.point(t, *before), variations)
            columns = np.array(slopes, dtype=np.float64).T.reshape(columns.shape)
        return columns

    def vary_projection(
        self, t: float, state: State, mode: Mode, step: int, columns: Floats, moved: Floats
    ) -> Floats:
        """Apply the derivative of a projection, at a state that satisfies the rows of the mode."""
        program, n = self._program, self._program.n
        names, varied = program.header.parameters, program.header.varied_by or ()
        changed = columns.copy()
        for j, (column, later) in enumerate(zip(columns.T, moved, strict=True)):
            small = 1j * IMAGINARY
            place = j - (columns.shape[1] - len(varied))
            values = self._spec.parameters + 0j
            if place >= 0 and varied[place] in names:
                values[names.index(varied[place])] += small
            q, p = state[0] + small * column[:n], state[1] + small * column[n:]
            at = self._at(t + small * later, q, 0 * q, step, frozenset(), values)
            M, weight = weighted_mass(at.at, at.counts)
            slopes = at.at.W[: at.counts.constraints]
            held = weight * slopes.T @ at.at.rates[: at.counts.constraints]
            v = np.linalg.solve(M, p - at.at.momenta - held)
            for moves in (True, False):  # first the positions
                at = self._at(t + small * later, q, v, step, frozenset(), values)
                dq, dv = at.nearest(mode)
                q, v = (q + dq, v) if moves else (q, v + dv)
            at = self._at(t + small * later, q, v, step, frozenset(), values)
            end = np.concatenate([q, at.at.M @ v + at.at.momenta])
            changed[:, j] = end.imag / IMAGINARY
        return changed

    def accumulated(self, at: StateOfContacts, mode: Mode) -> dict[int, float]:
        """Return the contacts that will rest, and the duration until all impacts are over.

        A gap that leaves with the rate r and returns with the acceleration a has infinitely many
        impacts in the duration 2 r / (-a (1 - e)).
        """
        motion = at.motion(mode)
        if motion is None:
            return {}
        resting, h = dict[int, float](), self._h
        rows, sign = at.counts.contact_rows, np.sign(h)
        for c, r in enumerate(rows):
            rate = sign * at.at.rates[r]
            a = at.at.W[r] @ motion.acceleration + at.at.curve[r]
            moves = not mode.contacts[c] and at.touching[c]
            if not (moves and a < 0 and rate > TOLERANCE * EPSILON * at.rate_sizes[r]):
                continue
            e = self._actions.restitution(c, float(rate)) or 0.0
            if e == 1.0:
                continue
            delta = 2 * rate / (-a * (1 - e))
            rounding = (EPSILON * at.gap_sizes[c] * abs(h) / -a) ** (1 / 3)
            if delta < max(NEGLIGIBLE * abs(h), rounding):
                resting[c] = float(sign * delta)
        return resting

    def project(
        self,
        t: float,
        state: State,
        at: StateOfContacts,
        mode: Mode,
        step: int,
        left: frozenset[tuple[bool, int]],
    ) -> tuple[State, StateOfContacts]:
        """Return the nearest state at which the rows of a mode hold, and its contacts."""
        for _ in range(2):  # the second time removes round-off
            if not at.rows_of(mode):
                break
            dq, dv = at.nearest(mode)
            at = replace(self._at(t, at.q + dq, at.v + dv, step, left), terms=at.terms)
            state = at.q, at.at.M @ at.v + at.at.momenta
        return state, at
