"""Where an expression becomes zero: events of a run, and sections of a long one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.evaluate import watch
from symsimpson.runtime.interpolate import DenseOutput
from symsimpson.runtime.observe import TURN, Observed, read_expression
from symsimpson.runtime.states import States
from symsimpson.runtime.status import Status
from symsimpson.runtime.trajectory import Trajectory

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["Events", "find_events", "gather", "read_question", "zeros"]

Floats = NDArray[np.float64]
Question = tuple[Observed, int]
#: Zeros are located to so much of the time between two states: rounding.
RESOLUTION = 4 * np.finfo(float).eps
#: A change of sign where the value stays above this part of the values around is no zero, but a
#: jump or a pole.
JUMP = 1e-6
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

    _connected: ClassVar[bool] = False

    direction: NDArray[np.int64]
    expression: str
    status: Status
    message: str

    def _repr_html_(self) -> str:
        from symsimpson.display.results import events

        return events(self)

    def _further(self) -> dict[str, Any]:
        return {"direction": (("time",), self.direction)}

    def _about(self) -> dict[str, Any]:
        return super()._about() | {"zeros of": self.expression, "message": self.message}


def read_question(stepper: Stepper, expression: Any, direction: int, wrap: Any) -> Question:
    """Read which zeros are wanted.

    Raises
    ------
    InputError
    """
    if direction not in (-1, 0, 1):
        raise InputError(
            f"direction is {direction!r}.\nPass 1 for zeros on the way up, -1 for those on the "
            "way down, or 0 for both."
        )
    names = stepper.coordinates
    wanted = names if wrap is True else (wrap,) if isinstance(wrap, str) else tuple(wrap or ())
    unknown = [name for name in map(str, wanted) if name.removesuffix("(t)") not in names]
    if unknown:
        raise InputError(
            f"wrap names {unknown[0]!r}, which is no coordinate.\n"
            f"The system has {', '.join(names)}; True wraps all."
        )
    wrapped = tuple(names.index(str(name).removesuffix("(t)")) for name in wanted)
    return read_expression(stepper._facts, expression, wrapped), int(direction)


def find_events(run: Trajectory, expression: Any, direction: int, wrap: Any) -> Events:
    """Find the zeros of an expression between the stored states of a run."""
    question = read_question(run._stepper, expression, direction, wrap)
    return gather(run, question, [zeros(run, question)])


def gather(run: Trajectory, question: Question, found: Sequence[tuple[Floats, ...]]) -> Events:
    """Put zeros together that were found one after the other."""
    n = run._stepper.n
    none = np.zeros(0), np.zeros((0, n)), np.zeros((0, n)), np.zeros(0)
    t, q, p, direction = (np.concatenate(parts) for parts in zip(none, *found, strict=True))
    for a in question[0].wrapped:
        q[:, a] -= TURN * np.floor(q[:, a] / TURN + 0.5)
    return Events(
        t=t, q=q, p=p, direction=direction.astype(np.int64), expression=question[0].expression,
        status=run.status, message=run.message, _stepper=run._stepper, _values=run._values,
    )  # fmt: skip


def zeros(run: Trajectory, question: Question, *, begins: bool = True) -> tuple[Floats, ...]:
    """Find times, positions, momenta and directions of the zeros between stored states."""
    wanted, direction = question
    dense, stepper = DenseOutput(run), run._stepper
    value = watch(stepper, [wanted], run.t, run.q, run.p, run._values)[:, 0]
    below = value < 0
    if begins and value.size > 1 and value[0] == 0:
        below[0] = below[1]  # the first state is no crossing
    change = below[1:].astype(int) - below[:-1]
    change[~np.isfinite(value[1:] - value[:-1])] = 0
    start = np.flatnonzero(change if direction == 0 else change == -direction)
    state: list[Floats] = [np.zeros((start.size, stepper.n)) for _ in "qp"]

    def at(which: NDArray[np.int64], later: Floats) -> Floats:
        q, p, codes = dense.after(start[which], later)
        q[codes != 0] = np.nan
        state[0][which], state[1][which] = q, p
        times = run.t[start[which]] + later
        return watch(stepper, [wanted], times, q, p, run._values)[:, 0]

    span = run.t[start + 1] - run.t[start]
    ends = value[start], value[start + 1]
    later = chandrupatla(at, span, *ends)
    left = at(np.arange(start.size), later)
    real = np.abs(left) <= JUMP * (np.abs(ends[0]) + np.abs(ends[1]))
    q, p = (x[real] for x in state)
    return run.t[start[real]] + later[real], q, p, -change[start[real]].astype(float)


def chandrupatla(
    function: Callable[[NDArray[np.int64], Floats], Floats], span: Floats, first: Floats,
    last: Floats,
) -> Floats:  # fmt: skip
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
