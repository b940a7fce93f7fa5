"""States after single events, in any kind of number: double precision, or many digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.stepping.run import Run
from symsimpson.stepping.run_events import RunEvents
from symsimpson.support.array_types import Reals
from symsimpson.support.names import speed_of_approach


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
