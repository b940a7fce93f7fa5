"""Events: zeros of expressions along a run, records of what acted on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.input_values import whole_number
from symsimpson.program.observed import Observed, read_expression, refuse_constant, watching
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.interpolate import DenseOutput
from symsimpson.results.states import States, Stored
from symsimpson.results.tables import Variable
from symsimpson.support.array_types import Floats
from symsimpson.support.names import did_you_mean, spelled
from symsimpson.text.interface import ZERO

Zeros = tuple[Observed, int]
#: Angles that differ by this are one.
TURN = 2 * np.pi
#: Zeros are located to so much of the time between two states: rounding.
RESOLUTION = 4 * np.finfo(float).eps
#: A change of sign where the value stays above this part of the values around is no zero, but a
#: jump or a pole.
JUMP = 1e-6
#: Zeros so near to where an angle is wrapped lie there.
SEAM = 1e-9
MOST_ITERATIONS, TINY = 100, 1e-300
#: So near to a zero, relative to a step, an expression is looked at to know its sign beside it.
BESIDE = (1e-6, 1e-3, 2.0**-5)
#: Weights of four values, from 0 to 1, whose sum is the slope at 0 of a cubic through them.
SLOPE = (-5.5, 9.0, -4.5, 1.0)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Events(States):
    """The states in which an expression is zero.

    Attributes
    ----------
    t : ndarray, shape (N,)
    q, p : ndarray, shape (N, n)
        Angles that were to be wrapped lie between -pi and pi.
    direction : ndarray of int, shape (N,)
        1 where the expression goes up with the run, -1 where it goes down.
    expression : str
    status : Status
        How the run ended that was looked through.
    message : str
        The same in words.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> run.events("theta")
    Events(pendulum, simpson: 5 states, 0.534783 <= t <= 4.81305)
    """

    direction: NDArray[np.int64]
    expression: str
    status: Status
    message: str

    @property
    def _connected(self) -> bool:
        return False

    def plot(self, names: str | Sequence[str] | None = None, *more: str, ax: Any = None) -> Any:
        """Draw the section: one quantity over another, at the zeros.

        Parameters
        ----------
        names : str or sequence of str, optional
            Two names, as in ``run["q1"]``: the second is drawn over the first. By default these
            are the first coordinate that the section does not fix, and its momentum. One name, or
            more than two, are drawn over time.
        *more : str
            Further names.
        ax : matplotlib axes, optional
            Axes to draw in; new ones unless given.

        Returns
        -------
        matplotlib axes

        Raises
        ------
        InputError
            If matplotlib is not installed, or there is no such quantity.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.double_pendulum())
        >>> run = stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.01, t_end=10)
        >>> ax = run.events("q1").plot()
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('q2', 'p_q2')
        """
        from symsimpson.plotting.run_figures import plot_section

        return plot_section(self, (names, *more) if more else names, ax=ax)

    def _repr_html_(self) -> str:
        from symsimpson.results.html import events

        return events(self)

    def _further(self) -> list[Variable]:
        return [of_event("direction", self.direction)]

    def _about(self) -> dict[str, Any]:
        return super()._about() | {"zeros of": self.expression, "message": self.message}


def of_event(name: str, values: Any) -> Variable:
    """Return a variable that only events have."""
    return Variable(name, values, ("time",), columns=(name,), prefix="event_")


def read_zeros(program: Program, expression: Any, direction: int, wrap: Any) -> Zeros:
    """Read which zeros are wanted; raises InputError."""
    if whole_number(direction) not in (-1, 0, 1):
        reject(
            f"direction is {direction!r}.",
            remedy="Pass 1 for zeros on the way up, -1 for those on the way down, or 0 for both.",
        )
    names = program.names.coordinates
    wrap = wrap.tolist() if hasattr(wrap, "tolist") else wrap
    several = isinstance(wrap, (tuple, list, set, frozenset))
    given = program.coordinates if wrap is True else wrap if several else [wrap] if wrap else []
    places = [names.place(coordinate) for coordinate in given]
    if None in places:
        unknown = spelled(list(given)[places.index(None)])
        reject(
            f"wrap names {unknown!r}, which is no coordinate.{did_you_mean(unknown, names.shown)}",
            remedy=f"The system has {', '.join(names.shown)}; True wraps all.",
        )
    wrapped = tuple(place for place in places if place is not None)
    query = read_expression(program, expression, wrapped)
    refuse_constant(query, query.expression)
    if query.rest:
        reject(
            f"{query.expression} is a rest alone, which jumps back to 0 and never changes "
            "its sign.",
            remedy="Write where it is to be: Mod(q1, 2*pi) - pi has a zero in each turn "
            "at q1 = pi, "
            "Mod(q1 + pi, 2*pi) - pi at q1 = 0.",
        )
    return query, int(direction)


def gather(run: Stored, wanted: Zeros, crossings: Sequence[tuple[Floats, ...]]) -> Events:
    """Put zeros together that were found one after the other."""
    n = run.program.n
    none = np.zeros(0), np.zeros((0, n)), np.zeros((0, n)), np.zeros(0)
    t, q, p, direction = (np.concatenate(parts) for parts in zip(none, *crossings, strict=True))
    for a in wanted[0].wrapped:
        q[:, a] -= TURN * np.floor(q[:, a] / TURN + 0.5)
    return Events(
        t=t,
        q=q,
        p=p,
        direction=direction.astype(np.int64),
        expression=wanted[0].expression,
        **of_run(run),
    )


def of_run(run: Any) -> dict[str, Any]:
    """Return how a run ended and with what it ran, for states that were found in it."""
    names = ("status", "message", "program", "parameter_values", "driven")
    return {name: getattr(run, name) for name in names}


@np.errstate(over="ignore", invalid="ignore")  # where there is no finite value, there is no zero
def zeros(run: Stored, sought: Zeros) -> tuple[Floats, ...]:
    """Find times, positions, momenta and directions of the zeros at and between stored states.

    A zero at the first state is none; at the last one it is, unless the motion turns back there.
    """
    wanted, direction = sought
    dense, wrapped = DenseOutput(run), list(wanted.wrapped)
    times, positions, momenta = _with_end(run, dense)
    asked = [wanted, replace(wanted, text=wanted.size)]
    watched = watching(run.program, asked, run.parameter_values)

    def value(t: Floats, q: Floats, p: Floats, turns: Floats) -> Floats:
        q = q.copy()
        q[:, wrapped] -= TURN * turns
        return watched(t, q, p).T

    # an angle stays in the turn in which the interval begins; where it ends in another, that is
    # looked at as well
    turns = np.floor(positions[:, wrapped] / TURN + 0.5)
    passing = np.flatnonzero((turns[1:] != turns[:-1]).any(axis=1))
    values, sizes_at = value(times, positions, momenta, turns)  # each state in its own turn
    small = ZERO * (watched(times, positions, momenta)[:, 1] if wrapped else sizes_at)
    distance, up = np.abs(values), values > 0
    limit = np.fmax(small, ZERO * np.max(distance, initial=0.0, where=np.isfinite(distance)))
    far = distance > limit
    plain = far[1:] & far[:-1] & (up[1:] == up[:-1])  # no zero is to be looked for
    plain[passing] = False
    begin = np.flatnonzero(~plain)
    count, start = len(begin), np.append(begin, passing)
    turn = np.concatenate([turns[begin], turns[passing + 1]])
    first, last = values[start], values[start + 1]
    if passing.size:  # an interval has one turn for both of its ends
        new, end = np.arange(count, len(start)), passing + 1
        first[new] = value(times[passing], positions[passing], momenta[passing], turn[new])[0]
        passing = np.searchsorted(begin, passing)
        last[passing] = value(times[end], positions[end], momenta[end], turn[passing])[0]
    span = times[start + 1] - times[start]
    state: list[Floats] = [np.zeros((start.size, run.program.n)) for _ in "qp"]

    def at(which: NDArray[np.int64], later: Floats) -> Floats:
        q, p, codes = dense.after(start[which], later)
        q[codes != 0] = np.nan
        state[0][which], state[1][which] = q, p
        return value(times[start[which]] + later, q, p, turn[which])

    def looked_at(end: int, way: int) -> tuple[Floats, Floats, Floats]:
        """Return signs at one end of all intervals, places near it, and values there."""
        at_ends, sizes, places = (first, last)[end].copy(), small[start + end], end * span
        signs, which = np.sign(at_ends), np.flatnonzero(np.abs(at_ends) <= limit[start + end])
        if which.size:  # only against what is beside it is it known to be zero
            near = at(which, places[which] + way * BESIDE[1] * span[which])[0]
            least = np.fmax(sizes[which], ZERO / BESIDE[1] * np.abs(near))
            which = which[np.abs(at_ends[which]) <= least]
            place, ahead = places[which], way * span[which]
            beside = signs_beside(lambda part: at(which, place + part * ahead), sizes[which])
            clear = np.where(np.abs(at_ends[which]) > sizes[which], signs[which], 0)
            signs[which] = np.where(beside == 0, clear, beside)
            places[which] += BESIDE[1] * ahead
            at_ends[which] = at(which, places[which])[0]
            lost = which[np.sign(at_ends[which]) != signs[which]]
            at_ends[lost] = TINY * signs[lost]
        return signs, places, at_ends

    (left, low, first), (right, high, last) = looked_at(0, 1), looked_at(1, -1)
    known = np.stack([left[:count], right[:count]], axis=1)
    known[passing, 1] = right[count:]  # in the turn of the next interval
    flat = known.ravel()  # what rests at zero stays on the side on which it was
    flat = flat[np.maximum.accumulate(np.where(flat == 0, 0, np.arange(flat.size)))]
    left[:count], alone = flat[::2], np.delete(np.arange(count), passing)
    right[alone] = flat[2 * alone + 1]
    behind = np.append(flat[2::2], 0.0)
    at_end = count and start[count - 1] == len(times) - 2
    if at_end and high[count - 1] != span[count - 1]:  # zero at the end: if unknown, it goes on
        end = np.array([min(len(times), len(run.t)) - 1])

        def beyond(part: float) -> Floats:
            q, p, codes = dense.after(end, times[-1:] - times[end] + part * span[count - 1])
            q[codes != 0] = np.nan
            return value(times[-1:] + part * span[count - 1], q, p, turns[-1:])

        (sign,) = signs_beside(beyond, small[-1:])
        behind[-1] = sign or -flat[-1]
    within = np.where(left * right < 0, right, 0)
    at_states = np.where(flat[1::2] * behind < 0, behind, 0)
    here, states = (
        np.flatnonzero((x == direction) if direction else x) for x in (within, at_states)
    )
    later = low[here] + chandrupatla(
        lambda which, x: at(here[which], low[here[which]] + x)[0],
        high[here] - low[here],
        first[here],
        last[here],
    )
    rest = at(here, later)[0]
    real = np.abs(rest) <= JUMP * (np.abs(first[here]) + np.abs(last[here]))
    angles = state[0][here][:, wrapped] - TURN * turn[here]
    real &= (np.abs(angles) <= (1 + SEAM) * np.pi).all(axis=1)
    here, later = here[real], np.append(later[real], span[states])
    q, p = (
        np.append(x[here], y[start[states] + 1], axis=0)
        for x, y in zip(state, (positions, momenta), strict=True)
    )
    signs, start = np.append(within[here], at_states[states]), np.append(start[here], start[states])
    span = times[start + 1] - times[start]
    order = np.lexsort((later * np.sign(span), start))
    if passing.size:  # what lies on the seam was found on both of its sides
        same = (np.diff(start[order]) == 0) & (
            np.abs(np.diff(later[order])) <= SEAM * np.abs(span[order[1:]])
        )
        order = order[np.append(True, ~same)[: order.size]]
    return (times[start] + later)[order], q[order], p[order], signs[order]


def signs_beside(values: Callable[[float], Floats], small: Floats) -> Floats:
    """Return signs of expressions a little beside a zero, 0 where they are not known.

    ``values`` gives them, and their sizes, at a part of a step from it. Slopes at the zero tell the
    sign, as the motion may come back at once; values themselves do where slopes are zero.
    """
    signs = np.zeros_like(small)
    for part in BESIDE:
        there = np.array([values(part * place) for place in (0.0, 1 / 3, 2 / 3, 1.0)])
        least = np.fmax(small, ZERO * np.max(there[:, 1], axis=0))
        slope, curved = np.tensordot(SLOPE, there[:, 0], 1), 100 * part**2 * np.abs(there[-1, 0])
        clear = (signs == 0) & (np.abs(slope) > np.fmax(least, curved))
        signs = np.where(clear, np.sign(slope), signs)
    return np.where((signs == 0) & (np.abs(there[-1, 0]) > least), np.sign(there[-1, 0]), signs)


def _with_end(run: Stored, dense: DenseOutput) -> tuple[Floats, Floats, Floats]:
    """Return the stored states, and the last one of the run where that was not stored."""
    times, positions, momenta = run.t, run.q, run.p
    left_out = run.every and run.steps % run.every
    if left_out and run.tau_values is None and run.ended_by is None:
        end = np.array([run.t[0] + run.h * run.steps])
        q, p, codes = dense.after(np.array([len(times) - 1]), end - times[-1])
        if not codes.any():
            times = np.append(times, end)
            positions, momenta = np.vstack([positions, q]), np.vstack([momenta, p])
    return times, positions, momenta


def chandrupatla(
    function: Callable[[NDArray[np.int64], Floats], Floats],
    span: Floats,
    first: Floats,
    last: Floats,
) -> Floats:
    """Find a zero in each of many intervals from 0 to ``span``, with the values at their ends.

    Inverse quadratic interpolation where that can be trusted, else bisection (T. R. Chandrupatla,
    Adv. Eng. Softw. 28 (1997), 145-149). ``function`` takes numbers of intervals, and places.
    """
    a, b, c = np.zeros_like(span), span.copy(), np.zeros_like(span)
    fa, fb, fc = first.copy(), last.copy(), first.copy()
    part = np.full(span.shape, 0.5)
    best = np.where(np.abs(first) < np.abs(last), 0.0, span)
    active = np.flatnonzero((first != 0) & (last != 0))
    for _ in range(MOST_ITERATIONS):
        if not active.size:
            break
        i = active
        x = a[i] + part[i] * (b[i] - a[i])
        fx = function(i, x)
        same = np.sign(fx) == np.sign(fa[i])
        c[i], fc[i] = np.where(same, a[i], b[i]), np.where(same, fa[i], fb[i])
        b[i], fb[i] = np.where(same, b[i], a[i]), np.where(same, fb[i], fa[i])
        a[i], fa[i] = x, fx
        nearer = np.abs(fa[i]) < np.abs(fb[i])
        best[i] = np.where(nearer, a[i], b[i])
        width = np.abs(b[i] - a[i])
        smallest = RESOLUTION * np.abs(span[i]) / np.maximum(width, 1e-300)
        done = (smallest > 0.5) | (fx == 0) | ~np.isfinite(fx)
        with np.errstate(all="ignore"):
            xi = (a[i] - b[i]) / (c[i] - b[i])
            phi = (fa[i] - fb[i]) / (fc[i] - fb[i])
            trusted = (phi**2 < xi) & ((1 - phi) ** 2 < 1 - xi)
            inverse = fa[i] / (fb[i] - fa[i]) * fc[i] / (fb[i] - fc[i]) + (c[i] - a[i]) / (
                b[i] - a[i]
            ) * fa[i] / (fc[i] - fa[i]) * fb[i] / (fc[i] - fb[i])
        guess = np.where(trusted & np.isfinite(inverse), inverse, 0.5)
        part[i] = np.clip(guess, np.minimum(smallest, 0.5), 1 - np.minimum(smallest, 0.5))
        active = i[~done]
    return best


class Record(NamedTuple):
    """One event that acted: its number, the time, the step, and the states on both sides."""

    event: int
    t: float
    step: int
    q: Floats
    p: Floats
    q_after: Floats
    p_after: Floats
    direction: int
    impulse: float
    simultaneous: bool

    @property
    def as_json(self) -> list[Any]:
        """The record in values of JSON."""
        return [x.tolist() if isinstance(x, np.ndarray) else x for x in self]

    def since(self, step: int) -> Record:
        """Return the record in a run that begins at a step of this one."""
        return self._replace(step=self.step - step)

    @classmethod
    def read(cls, values: list[Any]) -> Record:
        """Return the record with these values of JSON."""
        numbers: list[Any] = [np.array(x) if isinstance(x, list) else x for x in values]
        return cls(*numbers)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Actions(Events):
    """The states in which an event acted on a run; those of :class:`Events` are before it.

    Attributes
    ----------
    q_after, p_after : ndarray, shape (N, n)
        The states after it.
    impulse : ndarray, shape (N,)
        Of impacts, along the slope of the gap; 0 for others.
    simultaneous : ndarray of bool, shape (N,)
        Whether another impact acted at the same time.

    Examples
    --------
    >>> import symsimpson as ss
    >>> (z,) = ss.coordinates("z")
    >>> ball = ss.MechanicalSystem("ball", coordinates=(z,), kinetic=z.diff()**2/2, potential=10*z)
    >>> floor = ss.Event(z, name="floor", action=ss.Impact(0.8))
    >>> run = ss.compile(ball).integrate([1.0], v0=[0.0], h=0.01, t_end=2, events=[floor])
    >>> hits = run.events("floor")
    >>> hits.impulse.round(3).tolist(), (hits.after.energy - hits.energy).round(3).tolist()
    ([8.05, 6.44, 5.152], [-3.6, -2.304, -1.475])
    """

    q_after: Floats
    p_after: Floats
    impulse: Floats
    simultaneous: NDArray[np.bool_]

    @property
    def after(self) -> States:
        """The states after the actions."""
        return self.with_states(self.t, self.q_after, self.p_after)

    def _further(self) -> list[Variable]:
        further = {
            "direction": self.direction,
            "impulse": self.impulse,
            "simultaneous": self.simultaneous.astype(int),
        }
        return [of_event(name, values) for name, values in further.items()]


def actions_of(run: Any, name: str) -> Actions:
    """Return what an event of a run did, by its name."""
    number = run.event_names.index(name)
    records = [record for record in run.records if record.event == number]

    def rows(what: str) -> Floats:
        values = [getattr(record, what) for record in records]
        return np.reshape(np.array(values, dtype=np.float64), (len(records), run.program.n))

    return Actions(
        t=np.array([record.t for record in records]),
        q=rows("q"),
        p=rows("p"),
        direction=np.array([record.direction for record in records], dtype=np.int64),
        expression=name,
        **of_run(run),
        q_after=rows("q_after"),
        p_after=rows("p_after"),
        impulse=np.array([record.impulse for record in records]),
        simultaneous=np.array([record.simultaneous for record in records], dtype=np.bool_),
    )


def energies_given(run: Any) -> Floats:
    """Return the energy that events gave up to each stored state of a run."""
    _, t, step, q, p, q_after, p_after, *_ = map(np.array, zip(*run.records, strict=True))
    before, behind = run.with_states(t, q, p), run.with_states(t, q_after, p_after)
    stays = (before.q == behind.q).all(axis=1)  # and V, which may be NaN at the zero of a root
    moved, pushed = behind.energy - before.energy, behind.kinetic_energy - before.kinetic_energy
    total = np.concatenate([[0.0], np.cumsum(np.where(stays, pushed, moved))])
    # a step has in it what acts where it begins, but for the start and the end of a run
    states = (run.every or 1) * np.arange(len(run))
    acted = np.searchsorted(step, states, side="left")
    acted[0] = np.sum((step == 0) & (t == run.t[0]))
    if run.success and (run.ended_by is not None or states[-1] == run.steps):
        acted[-1] = len(run.records)
    energies: Floats = total[acted]
    return energies
