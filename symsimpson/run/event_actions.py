"""Actions of events on a state: impacts by Newton's law, one after the other, and changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.driver.impacts import (
    EXACT,
    MOST_NEWTON,
    NEAR,
    STILL,
    lowest_of_cubic,
    zero_of_cubic,
)
from symsimpson.errors import InputError, ModelError
from symsimpson.program.evaluating import evaluate, watching
from symsimpson.program.program import Program
from symsimpson.results.events import BESIDE, JUMP
from symsimpson.run.zeros import ridders
from symsimpson.stepping.constrained_start import project_start
from symsimpson.stepping.event import Event, Impact
from symsimpson.stepping.run import Run
from symsimpson.stepping.run_events import RunEvents
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, State
from symsimpson.support.names import speed_of_approach

__all__ = ["EventActions", "constant_restitution"]

#: So many impacts at one time are taken one after the other.
MOST_MAPS = 500
#: States at an event are known to so much of themselves.
ROUNDINGS = 16 * 2.0**-52
#: Where a gap is lowest is known to this part of the span.
LOWEST = 1e-9
#: Of so many states it is known what is asked for there, beside the last one.
KNOWN = 4


class EventActions:
    """Evaluates what events ask for, and does what they say; ``failed`` says why it could not."""

    def __init__(self, program: Program, spec: RunSpec, run_events: RunEvents) -> None:
        self._program, self._events, self._values = program, run_events, spec.parameters
        #: Returns all that is asked for at states.
        self.rows = watching(program, run_events.watched, spec.parameters)
        self._sign = 1.0 if spec.h > 0 else -1.0
        self.failed, self._known = "", list[tuple[float, State, Floats]]()
        self.beyond: State | None = None  #: Where the motion goes on beyond a kink.
        #: Impacts whose gap, and its rate, are zero behind the last actions.
        self.touched = set[int]()
        #: Which events are impacts.
        self.impacts = np.array([place is not None for place in run_events.rate])
        self._restitution = [
            _restitution(program, event.action.restitution, spec.parameters)
            if isinstance(event.action, Impact)
            else None
            for event in run_events.events
        ]

    def row(self, t: float, state: State) -> Floats:
        """Return all that is asked for at one state; of the last ones it is known."""
        for when, where, known in self._known:
            if where is state and when == t:
                return known
        row: Floats = self.rows(np.array([t]), state[0][None], state[1][None])[0]
        self._known = [(t, state, row), *self._known[:KNOWN]]
        return row

    def values(self, t: float, state: State) -> Floats:
        """Return the expressions of events at a state."""
        return self.row(t, state)[: len(self._events.events)]

    def loses(self, k: int, before: State, behind: State, t: float) -> bool:
        """Return whether an event is an impact that left a slower rate, or a change."""
        if not self.impacts[k]:
            return bool(self._events.changes[k])
        rates = [abs(self.row(t, state)[self.rate(k)]) for state in (before, behind)]
        return bool(rates[1] < (1 - 1e-9) * rates[0])

    def rate(self, k: int) -> int:
        """Return where the rate of a gap stands."""
        place = self._events.rate[k]
        assert place is not None
        return place

    def allowed(self, row: Floats, k: int) -> bool:
        """Return whether the condition of an event holds."""
        place = self._events.when[k]
        return place is None or bool(row[place] > 0)

    def may_all_hit(self, t: float, state: State, events: Sequence[int]) -> bool:
        """Return whether all of some events are impacts that may act on a state."""
        row = self.row(t, state)
        return all(self.impacts[k] and self.allowed(row, k) for k in events)

    def sizes(self, row: Floats, q: Floats) -> Floats:
        """Return the sizes of terms of which expressions are made, to tell what rounding is."""
        sizes = row[[*self._events.sizes]]
        for k, first in enumerate(self._events.slopes):
            if first is not None:
                sizes[k] = max(sizes[k], np.abs(row[first : first + len(q)] * q).sum())
        return sizes

    def rounding(self, t: float, state: State) -> Floats:
        """Return by how much expressions change where time and state do by some roundings."""
        n, place = len(state[0]), np.concatenate([[t], *state])
        places = np.tile(place, (len(place) + 1, 1))
        places[1:] += np.diag(ROUNDINGS * place)
        rows = self.rows(places[:, 0], places[:, 1 : n + 1], places[:, n + 1 :])
        with np.errstate(all="ignore"):  # where there is no value, nothing is known
            changes = np.abs(rows[1:, : len(self.impacts)] - rows[0, : len(self.impacts)])
        return np.asarray(changes.sum(axis=0, where=np.isfinite(changes)))

    def touching(self, values: Floats, small: Floats) -> NDArray[np.bool_]:
        """Return which impacts have a gap of zero."""
        return self.impacts & (np.abs(values) <= small)

    def pressed(
        self, t: float, state: State, part: float, events: Sequence[int], small: Floats
    ) -> bool:
        """Return whether what touched has not gone away by more than rounding, a part before."""
        moved = np.abs(part * self.rates(self.row(t, state)))
        near = self.touched.issuperset(events) and not (moved > small)[[*events]].any()
        return near and self.may_all_hit(t, state, events)

    def rates(self, row: Floats) -> Floats:
        """Return the rates of gaps, and 0 for other expressions."""
        return np.array([0.0 if place is None else row[place] for place in self._events.rate])

    def dips(
        self,
        row: Callable[[float], Floats],
        span: float,
        first: Floats,
        last: Floats,
        small: Floats,
    ) -> dict[int, tuple[float, Floats]]:
        """Return where gaps pass through zero and come back between two states, by their rates.

        It is where they are lowest, with all that is asked for there.
        """
        lowest: dict[int, tuple[float, Floats]] = {}
        for k, place in enumerate(self._events.rate):
            if place is None or min(first[k], last[k]) <= small[k]:
                continue
            ends, rates = (first[k], last[k]), (float(first[place]), float(last[place]))
            down, up = span * rates[0], span * rates[1]
            low = lowest_of_cubic.py_func(*ends, down, up) if down < 0 < up else np.inf
            if low < NEAR * min(ends):
                x = self._still(row, place, span, rates)
                if x == x and (there := row(x))[k] < -small[k]:
                    lowest[k] = x, there
        return lowest

    @staticmethod
    def _still(
        row: Callable[[float], Floats], place: int, span: float, rates: tuple[float, float]
    ) -> float:
        """Return where from 0 to a span a rate is zero, between ends of both signs."""
        return ridders(lambda x: float(row(x)[place]), 0.0, span, rates, LOWEST * abs(span))

    def root(
        self,
        row: Callable[[float], Floats],
        k: int,
        span: float,
        ends: tuple[Floats, Floats],
        side: float,
    ) -> float:
        """Return where from 0 to a span an expression is zero, to rounding; NaN where it jumps.

        ``ends`` is all that is asked for there; it begins on a side of zero. Where there is a rate,
        of a gap, Newton's method begins at the zero of a cubic, and bisects where it leaves the
        bracket; Ridders' method needs none.
        """
        (first, last), place = (float(x[k]) for x in ends), self._events.rate[k]
        if first * side <= 0:  # rounding has left it behind
            first = side * np.finfo(float).tiny
        if place is None:
            low = 0.0
            if abs(first) < BESIDE[0] * abs(last):  # rounding: it begins a little later
                there = float(row(BESIDE[0] * span)[k])
                low, first = (BESIDE[0] * span, there) if there * side > first else (low, first)
            x = ridders(lambda x: float(row(x)[k]), low, span, (first, last), EXACT * abs(span))
            jumped = abs(float(row(x)[k])) > JUMP * (abs(first) + abs(last))
            return float("nan") if jumped else x
        low, high, before = 0.0, span, 0.0
        a, b = (span * float(end[place]) for end in ends)
        x = span * zero_of_cubic.py_func(first, last, a, b, side)
        for _ in range(MOST_NEWTON):
            values = row(x)
            value, rate = float(values[k]), float(values[place])
            if not math.isfinite(value):
                return math.nan
            low, high = (x, high) if value * side > 0 else (low, x)
            step = -value / rate if rate else np.inf
            # behind this step; slopes of the scheme differ from the rate: convergence is linear
            left = abs(step) * abs(step) / before if before else np.inf
            fine = rate * span * side <= 0 and min(left, abs(step)) <= EXACT * abs(span)
            inside = low <= x + step <= high or high <= x + step <= low
            if fine or abs(high - low) <= EXACT * abs(span):
                x = x + step if inside else x
                return x if abs(x) > 4 * EXACT * abs(span) else 0.0
            before, x = (abs(step), x + step) if inside else (0.0, (low + high) / 2)
        return x

    def acted(
        self, t: float, state: State, events: Sequence[int], small: Floats
    ) -> Iterator[tuple[int, State, State, float]]:
        """Let events act: changes first, then impacts, the fastest approach before others.

        Yields the number of each, the states before and behind it, and its impulse.
        """
        for k in events:
            if not self.impacts[k]:
                before, state = state, self._changed(t, state, k)
                yield k, before, state, 0.0
                if self.failed:
                    return
        forced = {k for k in events if self.impacts[k]}
        for _ in range(MOST_MAPS):
            row = self.row(t, state)
            touch = self.touching(row[: len(small)], small)
            near = [k for k in range(len(small)) if k in forced or touch[k]]
            rates = {k: row[self.rate(k)] for k in near if self.allowed(row, k)}
            velocities = self._velocities(t, state[0], state[1][None])[0]
            still = {k: STILL * self._terms_of_rate(row, velocities, k) for k in rates}
            nearing = {k: -self._sign * rate for k, rate in rates.items()}
            closing = {k: speed for k, speed in nearing.items() if speed > still[k]}
            forced.clear()
            if not closing:
                self.touched = {k for k, speed in nearing.items() if speed >= -still[k]}
                return
            k = max(closing, key=lambda k: closing[k])
            before = state
            state, impulse = self._hit(t, state, row, k)
            yield k, before, state, impulse
            if self.failed:
                return

    def _terms_of_rate(self, row: Floats, v: Floats, k: int) -> float:
        """Return the sizes of the terms of which the rate of a gap is made."""
        first = self._events.slopes[k]
        assert first is not None
        terms = row[first : first + len(v)] * v
        moved = float(row[self.rate(k)] - terms.sum())
        return max(float(np.abs(terms).sum()) + abs(moved), 1e-300)

    def _velocities(self, t: float, q: Floats, p: Floats) -> Floats:
        """Return velocities at one position, of several momenta."""
        times, places = np.full(len(p), t), np.repeat(q[None], len(p), axis=0)
        n = self._program.n
        return evaluate(self._program, "energy", "VELOCITY", n, (times, places, p), self._values)

    def _momenta(self, t: float, q: Floats, v: Floats) -> Floats:
        """Return the momenta of velocities at a position."""
        run = Run(self._program, self._values, self._sign, t, 0, 1)
        run.begin(q, v, velocity=True)
        return run.end()[1][0]

    def _hit(self, t: float, state: State, row: Floats, k: int) -> tuple[State, float]:
        """Return the state after an impact, and its impulse: v jumps along M^-1 dg/dq."""
        q, p = state
        first = self._events.slopes[k]
        assert first is not None
        n = row[first : first + len(q)]
        v, there, origin = self._velocities(t, q, np.stack([p, n, 0 * p]))
        w, rate = there - origin, float(row[self.rate(k)])
        weight = float(n @ w)
        if not weight > 0:
            self.failed = (
                f"The gap {self._events.names[k]!r} closes, but moves nothing that is free to. "
            )
            return state, 0.0
        restitution = self._restitution[k]
        assert restitution is not None
        approach = -self._sign * rate
        try:
            e = restitution(approach)
        except InputError as error:
            self.failed = f"The event {self._events.names[k]!r} cannot act: {error} "
            return state, 0.0
        if self._sign < 0 and e != 1.0:
            self.failed = (
                f"The impact {self._events.names[k]!r} loses energy, which a run backwards would "
                "have to give. Take restitution 1, or run forwards. "
            )
            return state, 0.0
        impulse = (1 + e) * -rate / weight
        if self._program.header.constraints:
            return (q, self._momenta(t, q, v + impulse * w)), impulse
        return (q, p + impulse * n), impulse

    def _changed(self, t: float, state: State, k: int) -> State:
        """Return the state after an event that is no impact."""
        changes = self._events.changes[k]
        if not changes:
            return self.beyond or state
        row, (q, p) = self.row(t, state), state
        q, p = q.copy(), p.copy()
        v = self._velocities(t, state[0], state[1][None])[0].copy()
        for block, place, number in changes:
            {"q": q, "v": v, "p": p}[block][place] = row[number]
        blocks = {block for block, _, _ in changes}
        # velocities are kept where positions change, unless momenta are given
        if "v" in blocks or "p" not in blocks:
            given = sorted({place for block, place, _ in changes if block == "p"})
            p = self._momenta(t, q, self._with_momenta(t, q, v, p, given))
        self._check_allowed(t, (q, p), v if "v" in blocks else None, k)
        return q, p

    def _with_momenta(self, t: float, q: Floats, v: Floats, p: Floats, given: list[int]) -> Floats:
        """Return velocities of which some are those of given momenta, and the others stay."""
        if not given:
            return v
        v = v.copy()
        v[given] = 0
        base = self._momenta(t, q, v)
        ways = np.eye(len(v))[given]
        masses = np.stack([self._momenta(t, q, v + way) - base for way in ways], axis=1)
        v[given] = np.linalg.solve(masses[given], (p - base)[given])
        return v

    def _check_allowed(self, t: float, state: State, v: Floats | None, k: int) -> None:
        """Say so where a state that was changed is none that constraints allow."""
        q, other = state[0][None], (state[1] if v is None else v)[None]
        try:
            given = "" if v is None else "v0"
            project_start(self._program, q, other, given, self._values[None], t)
        except (InputError, ModelError) as error:
            why = str(error).split("\n")[0].removeprefix(f"{self._program.system}: ")
            why = why.replace("q0", "its position").replace("v0", "its velocity")
            self.failed = (
                f"The event {self._events.names[k]!r} changes the state to one that constraints do "
                f"not allow: {why} Change all that hang together, as system.consistent(q0, v0) "
                "finds it. "
            )


def constant_restitution(program: Program, event: Event, values: Floats) -> float | None:
    """Return the restitution of an impact, None where it depends on its speed."""
    if not isinstance(event.action, Impact):
        return None
    given = event.action.restitution
    if hasattr(given, "free_symbols") and speed_of_approach() in given.free_symbols:
        return None
    return _restitution(program, given, values)(0.0)


def _restitution(program: Program, given: Any, values: Floats) -> Callable[[float], float]:
    """Return the restitution as a function of the speed of approach.

    Raises InputError if it does not depend on that, and is not between 0 and 1.
    """
    if not hasattr(given, "free_symbols") or given.is_number:
        number = float(given)
        return lambda _: number
    approach, place = speed_of_approach(), program.names.parameters.found
    symbols = given.free_symbols - {approach}
    left = given.subs({symbol: float(values[place(symbol)]) for symbol in symbols})
    varies = left.has(approach)

    def restitution(speed: float) -> float:
        try:
            factor = float(left.subs(approach, speed))
        except TypeError:  # it is not real
            factor = float("nan")
        if not 0.0 <= factor <= 1.0:
            at = f" at a speed of approach of {speed:g}" if varies else ""
            raise InputError(
                f"the restitution {given} is {factor:g}{at}.\n"
                "It must be between 0 (plastic) and 1 (elastic)."
            )
        return factor

    if varies:
        return restitution
    number = restitution(0.0)
    return lambda _: number
