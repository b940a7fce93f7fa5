"""Actions of events on a state: impacts by Newton's law of restitution, and changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError, ModelError, reject
from symsimpson.program.evaluation import evaluate, make_evaluator
from symsimpson.program.program import Program
from symsimpson.stepping.constrained_start import project_start
from symsimpson.stepping.event import Impact
from symsimpson.stepping.run import Run
from symsimpson.stepping.run_events import RunEvents
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, Reals, State
from symsimpson.support.names import speed_of_approach
from symsimpson.text.driver.impacts import STILL


class EventMaps:
    """Maps from the state before an event to the state after it.

    The program and the ``values`` of its parameters determine the type of numbers. ``rows``
    evaluates all expressions of the events at states (t, q, p). ``sign`` is the sign of the step
    size.
    """

    def __init__(
        self,
        program: Program,
        run_events: RunEvents,
        values: Reals,
        rows: Callable[[Reals, Reals, Reals], Reals],
        sign: float = 1.0,
    ) -> None:
        self._program, self._events, self._values = program, run_events, values
        self._rows, self.sign = rows, sign

    def row(self, t: Any, state: tuple[Reals, Reals]) -> Reals:
        """Return the values of all expressions at one state."""
        q, p = state
        row: Reals = self._rows(np.array([t]), q[None], p[None])[0]
        return row

    def rate(self, row: Reals, k: int) -> Any:
        """Return the rate (total time derivative) of the gap of impact ``k``."""
        place = self._events.rate[k]
        assert place is not None
        return row[place]

    def slope(self, row: Reals, k: int) -> Reals:
        """Return the gradient of the gap of impact ``k`` by q, shape (n,)."""
        first = self._events.slopes[k]
        assert first is not None
        return row[first : first + self._program.n]

    def velocities(self, t: Any, q: Reals, p: Reals) -> Reals:
        """Return the velocities of several momenta at one position, shape (len(p), n)."""
        times, places = np.full(len(p), t), np.repeat(q[None], len(p), axis=0)
        n = self._program.n
        return evaluate(self._program, "energy", "VELOCITY", n, (times, places, p), self._values)

    def apply_impact(
        self, t: Any, state: tuple[Reals, Reals], row: Reals, k: int, law: Callable[[Any], Any]
    ) -> tuple[tuple[Reals, Reals], Any]:
        """Return the state after an impact and its impulse; v jumps along M^-1 dg/dq.

        The impulse is 0 if constraints prevent any motion along the gap. ``law`` maps the speed of
        approach to the restitution.
        """
        (q, p), n = state, self.slope(row, k)
        v, there, origin = self.velocities(t, q, np.stack([p, n, 0 * p]))
        w, rate = there - origin, self.rate(row, k)
        weight = n @ w
        if not weight > 0:
            return state, 0.0
        impulse = (1 + law(-self.sign * rate)) * -rate / weight
        if self._program.header.constraints:
            return (q, self._momenta(t, q, v + impulse * w)), impulse
        return (q, p + impulse * n), impulse

    def apply_change(
        self, t: Any, state: tuple[Reals, Reals], row: Reals, k: int
    ) -> tuple[tuple[Reals, Reals], Reals | None]:
        """Return the state after a change, and its velocities where the change gives some."""
        q, p = (x.copy() for x in state)
        v, given = self.velocities(t, state[0], p[None])[0].copy(), self._events.changes[k]
        for block, place, number in given:
            {"q": q, "v": v, "p": p}[block][place] = row[number]
        blocks = {block for block, *_ in given}
        # a change of positions leaves the velocities, unless it sets momenta
        if "v" in blocks or "p" not in blocks:
            fixed = sorted({place for block, place, _ in given if block == "p"})
            p = self._momenta(t, q, self._solve_velocities(t, q, v, p, fixed))
        return (q, p), v if "v" in blocks else None

    def _momenta(self, t: Any, q: Reals, v: Reals) -> Reals:
        """Return the momenta of velocities at a position."""
        run = Run(self._program, self._values, self.sign, t)
        run.begin(q, v, velocity=True)
        return run.end()[1][0]

    def _solve_velocities(self, t: Any, q: Reals, v: Reals, p: Reals, given: list[int]) -> Reals:
        """Solve for the velocities whose coordinates have ``given`` momenta; keep the others."""
        if not given:
            return v
        v = v.copy()
        v[given] = 0
        base = self._momenta(t, q, v)
        units = np.eye(len(v))[given]
        masses = np.stack([self._momenta(t, q, v + unit) - base for unit in units], axis=1)
        v[given] = self._program.numbers.solve(masses[given], (p - base)[given])
        return v


def read_restitution(program: Program, given: Any, values: Reals) -> Callable[[Any], Any]:
    """Return the restitution as a function of the speed of approach; NaN if it is not real."""
    if not hasattr(given, "free_symbols") or given.is_number:
        number = float(given)
        return lambda _: number
    approach, place = speed_of_approach(), program.names.parameters.found
    symbols = given.free_symbols - {approach}
    left = given.subs({symbol: values.item(place(symbol)) for symbol in symbols})

    def restitution(speed: Any) -> Any:
        try:
            return program.numbers.read(left.subs(approach, speed)).item()
        except TypeError:  # not real
            return math.nan

    return restitution


#: Largest number of successive impacts at one time.
MOST_IMPACTS = 500
#: Relative round-off of the state at an event.
STATE_ROUND_OFF = 16 * 2.0**-52
#: Number of states, besides the last one, whose expressions are cached.
CACHED_STATES = 4


class EventActions:
    """Evaluation of the expressions of events, and their actions on a state.

    ``failed`` has the reason if an action is impossible, else it is empty.
    """

    def __init__(self, program: Program, spec: RunSpec, run_events: RunEvents) -> None:
        self._program, self._events, self._values = program, run_events, spec.parameters
        #: Evaluates all expressions of the events at states.
        self.rows = make_evaluator(program, run_events.watched, spec.parameters)
        sign = 1.0 if spec.h > 0 else -1.0
        self._maps = EventMaps(program, run_events, spec.parameters, self.rows, sign)
        self.failure, self._known = "", list[tuple[float, State, Floats]]()
        #: State from which the motion continues after a kink.
        self.state_beyond_kink: State | None = None
        #: Impacts whose gap and rate are both zero after the last actions.
        self.touched = set[int]()
        #: Whether each event is an impact.
        self.impacts = np.array([place is not None for place in run_events.rate])
        self._laws = {
            k: read_restitution(program, event.action.restitution, spec.parameters)
            for k, event in enumerate(run_events.events)
            if isinstance(event.action, Impact)
        }

    def row(self, t: float, state: State) -> Floats:
        """Return the values of all expressions at one state, from the cache if possible."""
        for when, where, known in self._known:
            if where is state and when == t:
                return known
        row = self._maps.row(t, state)
        self._known = [(t, state, row), *self._known[:CACHED_STATES]]
        return row

    def values(self, t: float, state: State) -> Floats:
        """Return the values of the event expressions at a state, one for each event."""
        return self.row(t, state)[: len(self._events.events)]

    def dissipates(self, k: int, before: State, after: State, t: float) -> bool:
        """Return whether an event is a change, or an impact that reduced the rate of its gap."""
        if not self.impacts[k]:
            return bool(self._events.changes[k])
        rates = [abs(self._maps.rate(self.row(t, state), k)) for state in (before, after)]
        return bool(rates[1] < (1 - 1e-9) * rates[0])

    def may_act(self, row: Floats, k: int) -> bool:
        """Return whether the condition of an event holds."""
        place = self._events.when[k]
        return place is None or bool(row[place] > 0)

    def may_all_hit(self, t: float, state: State, events: Sequence[int]) -> bool:
        """Return whether all given events are impacts whose conditions hold at a state."""
        row = self.row(t, state)
        return all(self.impacts[k] and self.may_act(row, k) for k in events)

    def restitution(self, k: int, speed: float | None = None) -> float | None:
        """Return the restitution of an event.

        Return None if the event has none, or if it depends on a speed and ``speed`` is None. Raises
        InputError if the restitution is not between 0 and 1.
        """
        given = getattr(self._events.events[k].action, "restitution", None)
        needs_speed = speed_of_approach() in getattr(given, "free_symbols", ())
        if given is None or (needs_speed and speed is None):
            return None
        factor = self._laws[k](speed or 0.0)
        if not 0.0 <= factor <= 1.0:
            at = "" if speed is None else f" at a speed of approach of {speed:g}"
            reject(
                f"the restitution {given} is {factor:g}{at}.",
                remedy="It must be between 0 (plastic) and 1 (elastic).",
            )
        return float(factor)

    def sizes(self, row: Floats, q: Floats) -> Floats:
        """Return the sizes of the terms of each event expression, which bound its round-off."""
        sizes = row[[*self._events.sizes]]
        for k, first in enumerate(self._events.slopes):
            if first is not None:
                sizes[k] = max(sizes[k], np.abs(row[first : first + len(q)] * q).sum())
        return sizes

    def rounding(self, t: float, state: State) -> Floats:
        """Return the change of event expressions for round-off changes of time and state."""
        n, place = len(state[0]), np.concatenate([[t], *state])
        places = np.tile(place, (len(place) + 1, 1))
        places[1:] += np.diag(STATE_ROUND_OFF * place)
        rows = self.rows(places[:, 0], places[:, 1 : n + 1], places[:, n + 1 :])
        with np.errstate(all="ignore"):  # ignore expressions without a finite value
            changes = np.abs(rows[1:, : len(self.impacts)] - rows[0, : len(self.impacts)])
        return np.asarray(changes.sum(axis=0, where=np.isfinite(changes)))

    def touching_impacts(self, values: Floats, small: Floats) -> NDArray[np.bool_]:
        """Return which events are impacts whose gap is zero up to ``small``."""
        return self.impacts & (np.abs(values) <= small)

    def stays_in_contact(
        self, t: float, state: State, part: float, events: Sequence[int], small: Floats
    ) -> bool:
        """Return whether bodies that touched have not separated during the last partial step.

        ``part`` is the duration of the partial step.
        """
        moved = np.abs(part * self.rates(self.row(t, state)))
        near = self.touched.issuperset(events) and not (moved > small)[[*events]].any()
        return near and self.may_all_hit(t, state, events)

    def rates(self, row: Floats) -> Floats:
        """Return the rates of gaps, and 0 for other expressions."""
        return np.array([0.0 if place is None else row[place] for place in self._events.rate])

    def apply(
        self, t: float, state: State, events: Sequence[int], small: Floats
    ) -> Iterator[tuple[int, State, State, float]]:
        """Let events act on a state: changes first, then impacts in order of approach speed.

        Yields the number of each event, the states before and after it, and its impulse.
        """
        for k in events:
            if not self.impacts[k]:
                before, state = state, self._change(t, state, k)
                yield k, before, state, 0.0
                if self.failure:
                    return
        forced = {k for k in events if self.impacts[k]}
        for _ in range(MOST_IMPACTS):
            row = self.row(t, state)
            touch = self.touching_impacts(row[: len(small)], small)
            near = [k for k in range(len(small)) if k in forced or touch[k]]
            rates = {k: self._maps.rate(row, k) for k in near if self.may_act(row, k)}
            velocities = self._maps.velocities(t, state[0], state[1][None])[0]
            still = {k: STILL * self._terms_of_rate(row, velocities, k) for k in rates}
            nearing = {k: -self._maps.sign * rate for k, rate in rates.items()}
            closing = {k: speed for k, speed in nearing.items() if speed > still[k]}
            forced.clear()
            if not closing:
                self.touched = {k for k, speed in nearing.items() if speed >= -still[k]}
                return
            k = max(closing, key=lambda k: closing[k])
            before = state
            state, impulse = self._hit(t, state, row, k)
            yield k, before, state, impulse
            if self.failure:
                return

    def _terms_of_rate(self, row: Floats, v: Floats, k: int) -> float:
        """Return the sum of the sizes of the terms in the rate of a gap."""
        terms = self._maps.slope(row, k) * v
        moved = float(self._maps.rate(row, k) - terms.sum())
        return max(float(np.abs(terms).sum()) + abs(moved), 1e-300)

    def _hit(self, t: float, state: State, row: Floats, k: int) -> tuple[State, float]:
        """Return the state after an impact and its impulse; set ``failed`` if it cannot act."""
        name = self._events.names[k]
        try:
            e = self.restitution(k, -self._maps.sign * float(self._maps.rate(row, k)))
        except InputError as error:
            self.failure = f"The event {name!r} cannot act: {error} "
            return state, 0.0
        if self._maps.sign < 0 and e != 1.0:
            self.failure = (
                f"The impact {name!r} dissipates energy, so it cannot act in a backward run. Use "
                "restitution 1, or a positive h. "
            )
            return state, 0.0
        state, impulse = self._maps.apply_impact(t, state, row, k, lambda _: e)
        if not impulse:
            self.failure = (
                f"The gap {name!r} closes, but constraints prevent any motion that opens it. "
            )
        return state, float(impulse)

    def _change(self, t: float, state: State, k: int) -> State:
        """Return the state after a change, a switch or an event without action."""
        if not self._events.changes[k]:
            return self.state_beyond_kink or state
        after, v = self._maps.apply_change(t, state, self.row(t, state), k)
        self._check_allowed(t, after, v, k)
        return after

    def _check_allowed(self, t: float, state: State, v: Floats | None, k: int) -> None:
        """Set ``failed`` if a change led to a state that violates the constraints."""
        q, other = state[0][None], (state[1] if v is None else v)[None]
        try:
            given = "" if v is None else "v0"
            project_start(self._program, q, other, given, self._values[None], t)
        except (InputError, ModelError) as error:
            why = str(error).split("\n")[0].removeprefix(f"{self._program.system}: ")
            why = why.replace("q0", "its position").replace("v0", "its velocity")
            self.failure = (
                f"The event {self._events.names[k]!r} leads to a state that violates the "
                f"constraints: {why} Change all coordinates that the constraints couple. "
                "system.consistent(q0, v0) computes a consistent state. "
            )
