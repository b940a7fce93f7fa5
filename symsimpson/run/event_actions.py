"""Actions of events on a state: impacts by Newton's law, one after the other; changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError, ModelError, reject
from symsimpson.program.observed import evaluate, watching
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
    """Computes states after single events.

    The program and the ``values`` of its parameters decide what kind of number that is. ``rows``
    evaluates all expressions of the events at states (t, q, p). ``sign`` is that of the step size.
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
        """Return the rate of the gap of an impact."""
        place = self._events.rate[k]
        assert place is not None
        return row[place]

    def slope(self, row: Reals, k: int) -> Reals:
        """Return the derivatives of the gap of an impact by q."""
        first = self._events.slopes[k]
        assert first is not None
        return row[first : first + self._program.n]

    def velocities(self, t: Any, q: Reals, p: Reals) -> Reals:
        """Return velocities at one position, of several momenta."""
        times, places = np.full(len(p), t), np.repeat(q[None], len(p), axis=0)
        n = self._program.n
        return evaluate(self._program, "energy", "VELOCITY", n, (times, places, p), self._values)

    def hit(
        self, t: Any, state: tuple[Reals, Reals], row: Reals, k: int, law: Callable[[Any], Any]
    ) -> tuple[tuple[Reals, Reals], Any]:
        """Return the state after an impact, and its impulse: v jumps along M^-1 dg/dq.

        The impulse is 0 if nothing is free to move along it. ``law`` gives the restitution by the
        speed of approach.
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

    def change(
        self, t: Any, state: tuple[Reals, Reals], row: Reals, k: int
    ) -> tuple[tuple[Reals, Reals], Reals | None]:
        """Return the state after a change, and its velocities where the change gives some."""
        q, p = (x.copy() for x in state)
        v, given = self.velocities(t, state[0], p[None])[0].copy(), self._events.changes[k]
        for block, place, number in given:
            {"q": q, "v": v, "p": p}[block][place] = row[number]
        blocks = {block for block, *_ in given}
        # velocities are kept where positions change, unless momenta are given
        if "v" in blocks or "p" not in blocks:
            fixed = sorted({place for block, place, _ in given if block == "p"})
            p = self._momenta(t, q, self._with_momenta(t, q, v, p, fixed))
        return (q, p), v if "v" in blocks else None

    def _momenta(self, t: Any, q: Reals, v: Reals) -> Reals:
        """Return the momenta of velocities at a position."""
        run = Run(self._program, self._values, self.sign, t, 0, 1)
        run.begin(q, v, velocity=True)
        return run.end()[1][0]

    def _with_momenta(self, t: Any, q: Reals, v: Reals, p: Reals, given: list[int]) -> Reals:
        """Return velocities of which some are those of given momenta, and the others stay."""
        if not given:
            return v
        v = v.copy()
        v[given] = 0
        base = self._momenta(t, q, v)
        ways = np.eye(len(v))[given]
        masses = np.stack([self._momenta(t, q, v + way) - base for way in ways], axis=1)
        v[given] = self._program.numbers.solve(masses[given], (p - base)[given])
        return v


def read_restitution(program: Program, given: Any, values: Reals) -> Callable[[Any], Any]:
    """Return a restitution as a function of the speed of approach; NaN where it is not real."""
    if not hasattr(given, "free_symbols") or given.is_number:
        number = float(given)
        return lambda _: number
    approach, place = speed_of_approach(), program.names.parameters.found
    symbols = given.free_symbols - {approach}
    left = given.subs({symbol: values.item(place(symbol)) for symbol in symbols})

    def restitution(speed: Any) -> Any:
        try:
            return program.numbers.read(left.subs(approach, speed)).item()
        except TypeError:  # it is not real
            return math.nan

    return restitution


#: So many impacts at one time are taken one after the other.
MOST_MAPS = 500
#: States at an event are known to so much of themselves.
ROUNDINGS = 16 * 2.0**-52
#: Of so many states it is known what is asked for there, beside the last one.
KNOWN = 4


class EventActions:
    """Evaluates what events ask for, and does what they say; ``failed`` says why it could not."""

    def __init__(self, program: Program, spec: RunSpec, run_events: RunEvents) -> None:
        self._program, self._events, self._values = program, run_events, spec.parameters
        #: Returns all that is asked for at states.
        self.rows = watching(program, run_events.watched, spec.parameters)
        sign = 1.0 if spec.h > 0 else -1.0
        self._maps = EventMaps(program, run_events, spec.parameters, self.rows, sign)
        self.failed, self._known = "", list[tuple[float, State, Floats]]()
        self.beyond: State | None = None  #: Where the motion goes on beyond a kink.
        #: Impacts whose gap, and its rate, are zero behind the last actions.
        self.touched = set[int]()
        #: Which events are impacts.
        self.impacts = np.array([place is not None for place in run_events.rate])
        self._laws = {
            k: read_restitution(program, event.action.restitution, spec.parameters)
            for k, event in enumerate(run_events.events)
            if isinstance(event.action, Impact)
        }

    def row(self, t: float, state: State) -> Floats:
        """Return all that is asked for at one state; of the last ones it is known."""
        for when, where, known in self._known:
            if where is state and when == t:
                return known
        row = self._maps.row(t, state)
        self._known = [(t, state, row), *self._known[:KNOWN]]
        return row

    def values(self, t: float, state: State) -> Floats:
        """Return the expressions of events at a state."""
        return self.row(t, state)[: len(self._events.events)]

    def loses(self, k: int, before: State, behind: State, t: float) -> bool:
        """Return whether an event is an impact that left a slower rate, or a change."""
        if not self.impacts[k]:
            return bool(self._events.changes[k])
        rates = [abs(self._maps.rate(self.row(t, state), k)) for state in (before, behind)]
        return bool(rates[1] < (1 - 1e-9) * rates[0])

    def allowed(self, row: Floats, k: int) -> bool:
        """Return whether the condition of an event holds."""
        place = self._events.when[k]
        return place is None or bool(row[place] > 0)

    def may_all_hit(self, t: float, state: State, events: Sequence[int]) -> bool:
        """Return whether all of some events are impacts that may act on a state."""
        row = self.row(t, state)
        return all(self.impacts[k] and self.allowed(row, k) for k in events)

    def restitution(self, k: int, speed: float | None = None) -> float | None:
        """Return the restitution of an event, None without one, or if that needs a speed.

        Raises InputError if it is not between 0 and 1.
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
            rates = {k: self._maps.rate(row, k) for k in near if self.allowed(row, k)}
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
            if self.failed:
                return

    def _terms_of_rate(self, row: Floats, v: Floats, k: int) -> float:
        """Return the sizes of the terms of which the rate of a gap is made."""
        terms = self._maps.slope(row, k) * v
        moved = float(self._maps.rate(row, k) - terms.sum())
        return max(float(np.abs(terms).sum()) + abs(moved), 1e-300)

    def _hit(self, t: float, state: State, row: Floats, k: int) -> tuple[State, float]:
        """Return the state after an impact and its impulse, unless it fails."""
        name = self._events.names[k]
        try:
            e = self.restitution(k, -self._maps.sign * float(self._maps.rate(row, k)))
        except InputError as error:
            self.failed = f"The event {name!r} cannot act: {error} "
            return state, 0.0
        if self._maps.sign < 0 and e != 1.0:
            self.failed = (
                f"The impact {name!r} loses energy, which a run backwards would "
                "have to give. Take restitution 1, or run forwards. "
            )
            return state, 0.0
        state, impulse = self._maps.hit(t, state, row, k, lambda _: e)
        if not impulse:
            self.failed = f"The gap {name!r} closes, but moves nothing that is free to. "
        return state, float(impulse)

    def _changed(self, t: float, state: State, k: int) -> State:
        """Return the state after an event that is no impact."""
        if not self._events.changes[k]:
            return self.beyond or state
        behind, v = self._maps.change(t, state, self.row(t, state), k)
        self._check_allowed(t, behind, v, k)
        return behind

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
