"""Events: zeros of expressions during a run, and the records of events that acted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.evaluation import make_evaluator
from symsimpson.program.input_values import whole_number
from symsimpson.program.observed import ObservedExpression, check_not_constant, read_expression
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.interpolate import DenseOutput
from symsimpson.results.states import FinishedRun, States
from symsimpson.results.tables import Variable
from symsimpson.support.array_types import Floats
from symsimpson.support.contact_values import OF_CONTACT
from symsimpson.support.names import did_you_mean, spelled
from symsimpson.text.interface import ZERO

ZeroQuery = tuple[ObservedExpression, int]
#: Period of angles.
TURN = 2 * np.pi
#: Tolerance of the time of a zero, relative to the time between two states: round-off.
RESOLUTION = 4 * np.finfo(float).eps
#: A change of sign is a jump or a pole if the value there exceeds this part of values around it.
JUMP = 1e-6
#: Relative tolerance within which a zero lies where the wrapping of an angle jumps.
SEAM = 1e-9
MOST_ITERATIONS, TINY = 100, 1e-300
#: Distances from a zero, relative to a step, at which the sign of an expression is evaluated.
BESIDE = (1e-6, 1e-3, 2.0**-5)
#: Weights of the values at 0, 1/3, 2/3 and 1 that give the slope at 0 of a cubic through them.
SLOPE = (-5.5, 9.0, -4.5, 1.0)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Events(States):
    """The states of a run at which an expression is zero.

    The class inherits the attributes of :class:`States`, such as ``v`` and ``energy``.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times of the zeros, in the order of the run.
    q, p : ndarray, shape (N, n)
        Positions and conjugate momenta. Angles in ``wrap`` lie between -pi and pi.
    direction : ndarray of int, shape (N,)
        1 if the expression increases along the run, -1 if it decreases.
    expression : str
        The expression, as text.
    status : Status
        The outcome of the run.
    message : str
        The outcome of the run, as text.

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
        """Draw the Poincaré section: one quantity over another, at the zeros.

        Parameters
        ----------
        names : str or sequence of str, optional
            Two names, as in ``run["q1"]``: the method draws the second quantity over the first. By
            default, these are the first coordinate that the section does not fix, and its
            momentum. If you pass one name, or more than two, the method draws them over time.
        *more : str
            More names.
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes.

        Returns
        -------
        matplotlib axes
            The axes of the figure.

        Raises
        ------
        InputError
            If matplotlib is not installed, or a name is unknown.

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

    def _extra_variables(self) -> list[Variable]:
        return [event_variable("direction", self.direction)]

    def _attributes(self) -> dict[str, Any]:
        return super()._attributes() | {"zeros of": self.expression, "message": self.message}


def event_variable(name: str, values: Any) -> Variable:
    """Return a variable of events; its column has the prefix ``event_`` if the name is taken."""
    return Variable(name, values, ("time",), columns=(name,), prefix="event_")


def read_zeros(program: Program, expression: Any, direction: int, wrap: Any) -> ZeroQuery:
    """Read the arguments of ``run.events``; raise InputError if they are invalid."""
    if whole_number(direction) not in (-1, 0, 1):
        reject(
            f"direction is {direction!r}.",
            remedy="Pass 1 for increasing values, -1 for decreasing values, or 0 for both.",
        )
    names = program.names.coordinates
    wrap = wrap.tolist() if hasattr(wrap, "tolist") else wrap
    several = isinstance(wrap, (tuple, list, set, frozenset))
    angles = program.coordinates if wrap is True else wrap if several else [wrap] if wrap else []
    places = [names.place(coordinate) for coordinate in angles]
    if None in places:
        unknown = spelled(list(angles)[places.index(None)])
        reject(
            f"wrap has {unknown!r}, which is not a coordinate.{did_you_mean(unknown, names.shown)}",
            remedy=f"The coordinates are {', '.join(names.shown)}. wrap=True wraps all of them.",
        )
    wrapped = tuple(place for place in places if place is not None)
    query = read_expression(program, expression, wrapped)
    check_not_constant(query, query.expression)
    if query.rest:
        reject(
            f"{query.expression} never changes its sign.",
            why="Mod gives a remainder, which jumps back to 0.",
            remedy="Subtract a value: Mod(q1, 2*pi) - pi has a zero in each turn at q1 = pi. "
            "Mod(q1 + pi, 2*pi) - pi has its zeros at q1 = 0.",
        )
    return query, int(direction)


def merge_zeros(
    run: FinishedRun, wanted: ZeroQuery, crossings: Sequence[tuple[Floats, ...]]
) -> Events:
    """Join the zeros of consecutive pieces of a run, and wrap their angles."""
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
        **run_fields(run),
    )


def run_fields(run: Any) -> dict[str, Any]:
    """Return the fields of a run that states found in it share."""
    names = ("status", "message", "program", "parameter_values", "driven")
    about = {name: getattr(run, name) for name in names}
    return about | {"history": getattr(run, "history", None)}


@np.errstate(over="ignore", invalid="ignore")  # values that are not finite are not zeros
def find_zeros(run: FinishedRun, sought: ZeroQuery) -> tuple[Floats, ...]:
    """Return times, positions, momenta and directions of the zeros at and between stored states.

    A zero at the first state does not count. A zero at the last state counts, unless the motion
    turns back there.
    """
    wanted, direction = sought
    if wanted.held and getattr(run, "history", None) is not None:
        reject(
            f"{wanted.expression} contains a multiplier, which depends on the mode of contacts.",
            where=run.program.system,
            remedy="Pass it as an event of the run: events=[symsimpson.Event(...)].",
        )
    dense, wrapped = run.sol, list(wanted.wrapped)
    times, positions, momenta = _append_end(run, dense)
    pair = [wanted, replace(wanted, text=wanted.size)]
    watched = make_evaluator(run.program, pair, run.parameter_values)

    def value(t: Floats, q: Floats, p: Floats, turns: Floats) -> Floats:
        q = q.copy()
        q[:, wrapped] -= TURN * turns
        return watched(t, q, p).T

    # an interval has the turn of each angle at its beginning; if it ends in another turn, it is
    # searched a second time, in that turn
    turns = np.floor(positions[:, wrapped] / TURN + 0.5)
    passing = np.flatnonzero((turns[1:] != turns[:-1]).any(axis=1))
    values, sizes_at = value(times, positions, momenta, turns)  # each state in its own turn
    small = ZERO * (watched(times, positions, momenta)[:, 1] if wrapped else sizes_at)
    distance, up = np.abs(values), values > 0
    limit = np.fmax(small, ZERO * np.max(distance, initial=0.0, where=np.isfinite(distance)))
    far = distance > limit
    plain = far[1:] & far[:-1] & (up[1:] == up[:-1])  # intervals without a zero
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

    def examine_end(end: int, way: int) -> tuple[Floats, Floats, Floats]:
        """Return signs at one end of all intervals, places near it, and values there."""
        at_ends, sizes, places = (first, last)[end].copy(), small[start + end], end * span
        signs, which = np.sign(at_ends), np.flatnonzero(np.abs(at_ends) <= limit[start + end])
        if which.size:  # compared with the values beside it, the value is zero or is not
            near = at(which, places[which] + way * BESIDE[1] * span[which])[0]
            least = np.fmax(sizes[which], ZERO / BESIDE[1] * np.abs(near))
            which = which[np.abs(at_ends[which]) <= least]
            place, ahead = places[which], way * span[which]
            beside = signs_near(lambda part: at(which, place + part * ahead), sizes[which])
            clear = np.where(np.abs(at_ends[which]) > sizes[which], signs[which], 0)
            signs[which] = np.where(beside == 0, clear, beside)
            places[which] += BESIDE[1] * ahead
            at_ends[which] = at(which, places[which])[0]
            lost = which[np.sign(at_ends[which]) != signs[which]]
            at_ends[lost] = TINY * signs[lost]
        return signs, places, at_ends

    (left, low, first), (right, high, last) = examine_end(0, 1), examine_end(1, -1)
    known = np.stack([left[:count], right[:count]], axis=1)
    known[passing, 1] = right[count:]  # in the turn of the next interval
    flat = known.ravel()  # a value that stays at zero keeps its last sign
    flat = flat[np.maximum.accumulate(np.where(flat == 0, 0, np.arange(flat.size)))]
    left[:count], alone = flat[::2], np.delete(np.arange(count), passing)
    right[alone] = flat[2 * alone + 1]
    behind = np.append(flat[2::2], 0.0)
    at_end = count and start[count - 1] == len(times) - 2
    if at_end and high[count - 1] != span[count - 1]:  # zero at the end: look beyond it
        end = np.array([min(len(times), len(run.t)) - 1])

        def beyond(part: float) -> Floats:
            q, p, codes = dense.after(end, times[-1:] - times[end] + part * span[count - 1])
            q[codes != 0] = np.nan
            return value(times[-1:] + part * span[count - 1], q, p, turns[-1:])

        (sign,) = signs_near(beyond, small[-1:])
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
    if passing.size:  # a zero where wrapping jumps was found on both sides
        same = (np.diff(start[order]) == 0) & (
            np.abs(np.diff(later[order])) <= SEAM * np.abs(span[order[1:]])
        )
        order = order[np.append(True, ~same)[: order.size]]
    return (times[start] + later)[order], q[order], p[order], signs[order]


def signs_near(values: Callable[[float], Floats], small: Floats) -> Floats:
    """Return the signs of expressions beside a zero; 0 means that the sign is unknown.

    ``values(part)`` returns values and their sizes ``part`` steps from the zero. The slope there
    decides, because the motion may return at once. If the slope is zero, the value decides.
    """
    signs = np.zeros_like(small)
    for part in BESIDE:
        there = np.array([values(part * place) for place in (0.0, 1 / 3, 2 / 3, 1.0)])
        least = np.fmax(small, ZERO * np.max(there[:, 1], axis=0))
        slope, curved = np.tensordot(SLOPE, there[:, 0], 1), 100 * part**2 * np.abs(there[-1, 0])
        clear = (signs == 0) & (np.abs(slope) > np.fmax(least, curved))
        signs = np.where(clear, np.sign(slope), signs)
    return np.where((signs == 0) & (np.abs(there[-1, 0]) > least), np.sign(there[-1, 0]), signs)


def _append_end(run: FinishedRun, dense: DenseOutput) -> tuple[Floats, Floats, Floats]:
    """Return the stored states, and the final state of the run if it was not stored."""
    times, positions, momenta = run.t, run.q, run.p
    missing = run.every and run.steps % run.every
    if missing and run.tau_values is None and run.ended_by is None:
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
    """Find a zero in each of many intervals from 0 to ``span`` by Chandrupatla's method.

    The method interpolates by an inverse quadratic polynomial if this is reliable, else it bisects
    (T. R. Chandrupatla, Adv. Eng. Softw. 28 (1997), 145-149). ``first`` and ``last`` are the values
    at the ends. ``function`` takes the numbers of intervals and a place in each.
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


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Actions(Events):
    """The states at which an event acted on a run, before and after its action.

    The class inherits the attributes of :class:`Events`: ``t``, ``q``, ``p`` and quantities such as
    ``energy`` describe the states before the action.

    Attributes
    ----------
    q_after, p_after : ndarray, shape (N, n)
        Positions and conjugate momenta after the action.
    impulse : ndarray, shape (N,)
        Impulse of an impact along the gradient of the gap. It is 0 for other actions.
    simultaneous : ndarray of bool, shape (N,)
        True if another impact acted at the same time.
    kind : list of str
        What happened at a contact or a friction element: "impact", "rest", "lift", "stick", "slip+"
        or "slip-". It is empty for other events.

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
    kind: list[str]

    @property
    def after(self) -> States:
        """The states after the actions, with quantities such as ``energy``."""
        return self.with_states(self.t, self.q_after, self.p_after)

    def _extra_variables(self) -> list[Variable]:
        further = {
            "direction": self.direction,
            "impulse": self.impulse,
            "simultaneous": self.simultaneous.astype(int),
        }
        if any(self.kind):
            further["kind"] = np.array(self.kind)
        return [event_variable(name, values) for name, values in further.items()]


def read_actions(run: Any, name: str) -> Actions:
    """Return the record of an event of a run, by its name; a contact includes its friction."""
    wanted = {k for k, x in enumerate(run.event_names) if x in (name, f"{name}{OF_CONTACT}")}
    records = [record for record in run.records if record.event in wanted]

    def rows(what: str) -> Floats:
        values = [getattr(record, what) for record in records]
        return np.reshape(np.array(values, dtype=np.float64), (len(records), run.program.n))

    return Actions(
        t=np.array([record.t for record in records]),
        q=rows("q"),
        p=rows("p"),
        direction=np.array([record.direction for record in records], dtype=np.int64),
        expression=name,
        **run_fields(run),
        q_after=rows("q_after"),
        p_after=rows("p_after"),
        impulse=np.array([record.impulse for record in records]),
        simultaneous=np.array([record.simultaneous for record in records], dtype=np.bool_),
        kind=[record.kind for record in records],
    )


def event_energies(run: Any) -> Floats:
    """Return the energy that events added to a run up to each stored state, shape (N + 1,)."""
    _, t, step, q, p, q_after, p_after, *_ = map(np.array, zip(*run.records, strict=True))
    before, after = run.with_states(t, q, p), run.with_states(t, q_after, p_after)
    change, header = after.energy - before.energy, run.program.header
    if not (header.canonical or header.general):
        # V is equal if q is; it may be NaN at the zero of a root
        same_q = (before.q == after.q).all(axis=1)
        change = np.where(same_q, after.kinetic_energy - before.kinetic_energy, change)
    total = np.concatenate([[0.0], np.cumsum(change)])
    # an event at the beginning of a step belongs to that step, except at both ends of the run
    states = (run.every or 1) * np.arange(len(run))
    acted = np.searchsorted(step, states, side="left")
    acted[0] = np.sum((step == 0) & (t == run.t[0]))
    if run.success and (run.ended_by is not None or states[-1] == run.steps):
        acted[-1] = len(run.records)
    energies: Floats = total[acted]
    return energies
