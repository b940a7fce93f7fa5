"""Where an expression becomes zero: events of a run, and sections of a long one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.plotting import run_figures
from symsimpson.program.evaluating import watching
from symsimpson.program.input_values import whole_number
from symsimpson.program.observed import Observed, read_expression, refuse_constant
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results import html
from symsimpson.results.interpolate import DenseOutput
from symsimpson.results.states import States
from symsimpson.results.stored import Stored
from symsimpson.support.array_types import Floats
from symsimpson.support.names import did_you_mean, spelled

__all__ = ["Events", "find_events", "gather", "of_run", "read_zeros", "zeros"]

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
MOST_ITERATIONS = 100


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
        return run_figures.plot_section(self, (names, *more) if more else names, ax=ax)

    _repr_html_ = html.events

    def _further(self) -> dict[str, Any]:
        return {"direction": (("time",), self.direction)}

    def _table(self) -> dict[str, NDArray[Any]]:
        further = {name: values for name, (_, values) in self._further().items()}
        columns = self._columns()  # what the user named comes first
        return {"t": self.t, **columns, **{x: further[x] for x in further if x not in columns}}

    def _about(self) -> dict[str, Any]:
        return super()._about() | {"zeros of": self.expression, "message": self.message}


def read_zeros(program: Program, expression: Any, direction: int, wrap: Any) -> Zeros:
    """Read which zeros are wanted; raises InputError."""
    if whole_number(direction) not in (-1, 0, 1):
        raise InputError(
            f"direction is {direction!r}.\nPass 1 for zeros on the way up, -1 for those on the "
            "way down, or 0 for both."
        )
    names = program.names.coordinates
    wrap = wrap.tolist() if hasattr(wrap, "tolist") else wrap
    several = isinstance(wrap, (tuple, list, set, frozenset))
    given = program.coordinates if wrap is True else wrap if several else [wrap] if wrap else []
    places = [names.place(coordinate) for coordinate in given]
    if None in places:
        unknown = spelled(list(given)[places.index(None)])
        raise InputError(
            f"wrap names {unknown!r}, which is no coordinate.{did_you_mean(unknown, names.shown)}\n"
            f"The system has {', '.join(names.shown)}; True wraps all."
        )
    wrapped = tuple(place for place in places if place is not None)
    query = read_expression(program, expression, wrapped)
    refuse_constant(query, query.expression)
    if query.rest:
        raise InputError(
            f"{query.expression} is a rest alone, which jumps back to 0 and never changes its sign."
            "\nWrite where it is to be: Mod(q1, 2*pi) - pi has a zero in each turn at q1 = pi, "
            "Mod(q1 + pi, 2*pi) - pi at q1 = 0."
        )
    return query, int(direction)


def find_events(run: Stored, expression: Any, direction: int, wrap: Any) -> Events:
    """Find the zeros of an expression between the stored states of a run."""
    wanted = read_zeros(run.program, expression, direction, wrap)
    return gather(run, wanted, [zeros(run, wanted)])


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
def zeros(run: Stored, sought: Zeros, *, begins: bool = True) -> tuple[Floats, ...]:
    """Find times, positions, momenta and directions of the zeros between stored states."""
    wanted, direction = sought
    dense, wrapped = DenseOutput(run), list(wanted.wrapped)
    times, positions, momenta = _with_end(run, dense)
    watched = watching(run.program, [wanted], run.parameter_values)

    def value(t: Floats, q: Floats, p: Floats, turns: Floats) -> Floats:
        q = q.copy()
        q[:, wrapped] -= TURN * turns
        return watched(t, q, p)[:, 0]

    # an angle stays in the turn in which the interval begins; where it ends in another, that is
    # looked at as well
    turns = np.floor(positions[:, wrapped] / TURN + 0.5)
    begin = np.arange(len(times) - 1)
    passing = np.flatnonzero((turns[1:] != turns[:-1]).any(axis=1))
    start, turn = np.append(begin, passing), np.concatenate([turns[:-1], turns[passing + 1]])
    values = value(times, positions, momenta, turns)  # each state in its own turn
    first = np.append(values[:-1], values[passing])
    last = np.append(values[1:], values[passing + 1])
    if passing.size:  # an interval has one turn for both of its ends
        new, end = np.arange(len(begin), len(start)), passing + 1
        first[new] = value(times[passing], positions[passing], momenta[passing], turn[new])
        last[passing] = value(times[end], positions[end], momenta[end], turn[passing])
    below = first < 0
    if begins and start.size and first[0] == 0:
        below[0] = last[0] < 0  # the first state is no crossing
    change = (last < 0).astype(int) - below
    change[~np.isfinite(last - first)] = 0
    here = np.flatnonzero(change if direction == 0 else change == -direction)
    start, turn, change = start[here], turn[here], change[here]
    first, last = first[here], last[here]
    state: list[Floats] = [np.zeros((start.size, run.program.n)) for _ in "qp"]

    def at(which: NDArray[np.int64], later: Floats) -> Floats:
        q, p, codes = dense.after(start[which], later)
        q[codes != 0] = np.nan
        state[0][which], state[1][which] = q, p
        return value(times[start[which]] + later, q, p, turn[which])

    span = times[start + 1] - times[start]
    later = chandrupatla(at, span, first, last)
    left = at(np.arange(start.size), later)
    real = np.abs(left) <= JUMP * (np.abs(first) + np.abs(last))
    angles = state[0][:, wrapped] - TURN * turn
    real &= (np.abs(angles) <= (1 + SEAM) * np.pi).all(axis=1)
    order = np.lexsort((later * np.sign(span), start))
    order = order[real[order]]
    if passing.size:  # what lies on the seam was found on both of its sides
        same = (np.diff(start[order]) == 0) & (
            np.abs(np.diff(later[order])) <= SEAM * np.abs(span[order[1:]])
        )
        order = order[np.append(True, ~same)[: order.size]]
    q, p = (x[order] for x in state)
    return times[start[order]] + later[order], q, p, -change[order].astype(float)


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
