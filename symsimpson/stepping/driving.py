"""Input signals of a run: read, check and interpolate their values at the nodes of steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import reject
from symsimpson.program.input_values import (
    MOST_STEPS,
    read_array,
    read_count,
    read_number,
    values_at,
)
from symsimpson.program.numbers import NO_INPUTS, Numbers
from symsimpson.program.program import Program
from symsimpson.stepping.inputs import read_step
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explain_arguments

#: Largest difference between a period and a whole number of steps, as a fraction of a step.
STEP_FRACTION = 1e-6
#: Largest relative difference of two times that count as equal.
SAME_TIME = 2.0**-48


@dataclass(frozen=True)
class Samples:
    """A piecewise constant input: each value lasts one period; see :func:`samples`."""

    values: ArrayLike
    period: Any


@explain_arguments()
def samples(values: ArrayLike, *, period: float) -> Samples:
    """Make a piecewise constant input: each value lasts one period, from the start of the run.

    Parameters
    ----------
    values : array_like, shape (L,), or (K, L) in an ensemble of K members
        Values of the input, one for each period.
    period : float
        Duration of each value, in units of time. It must be a whole number of steps, because a
        jump within a step would reduce the order of the scheme.

    Returns
    -------
    Samples
        The signal for ``integrate(..., inputs={"u": samples(values, period=0.05)})``.

    Examples
    --------
    >>> import sympy as sp, symsimpson as ss
    >>> (x,), u = ss.coordinates("x"), sp.Symbol("u")
    >>> cart = ss.MechanicalSystem("cart", coordinates=(x,), kinetic=x.diff()**2/2,
    ...                            potential=0*x, forces={x: u}, inputs=(u,))
    >>> run = ss.compile(cart).integrate([0.0], v0=[0.0], h=0.01, steps=20,
    ...                                  inputs={"u": ss.samples([1.0, -1.0], period=0.1)})
    >>> float(run["v_x"][10].round(12)), float(run["v_x"][-1].round(12))
    (0.1, 0.0)
    """
    return Samples(values, period)


def read_input_values(
    program: Program, given: Any, h: Any, steps: int, t0: Any, members: int | None = None
) -> Reals:
    """Read the values of all inputs of a run, or of an ensemble with ``members``.

    ``given`` is a mapping from symbols or names, or an array with the inputs along its last axis.
    Functions of time are evaluated at the nodes of the steps from t0 on. ``members`` is 1 if only
    the inputs determine the number of members. The result has shape (K, N, s, m): member, step,
    node and input. An axis of length 1 is broadcast. Raises InputError if an input is missing,
    unknown or not finite, or has the wrong shape.
    """
    names, numbers = program.inputs, program.numbers
    if not names:
        if given is None:
            return NO_INPUTS
        reject(
            "the system has no inputs.",
            where=program.system,
            remedy="Declare them: MechanicalSystem(..., forces={q: u}, inputs=(u,)).",
        )
    values = collect_inputs(program, given)
    missing = [name for name in names if name not in values]
    if missing:
        reject(
            f"the input {missing[0]} has no values.",
            where=program.system,
            remedy=f"Pass inputs={{{missing[0]!r}: values}} with one value for each of the "
            f"{steps} steps. You may also pass a function of time, or values at all nodes: see "
            "stepper.node_times(h, steps).",
        )
    for name, value in values.items():
        if callable(value):
            _check_times(program, name)
            times = node_times(program, h, steps, t0)
            values[name] = values_at(f"input {name}", value, times)[None]
    read = [_read_input(program, name, values[name], h, steps, members) for name in names]
    try:
        shape = np.broadcast_shapes(*(array.shape for array in read))
    except ValueError:
        sizes = ", ".join(f"{name} of {len(x)}" for name, x in zip(names, read, strict=True))
        reject(
            f"the inputs have different numbers of members: {sizes}.",
            remedy="Give each input either an axis of all members or no such axis.",
        )
    inputs = np.stack([np.broadcast_to(array, shape) for array in read], axis=-1)
    return inputs if inputs.shape[1] else numbers.zeros((1, 1, 1, len(names)))


def collect_inputs(program: Program, given: Any) -> dict[str, Any]:
    """Return a mapping from the name of each input to its unread values."""
    names, given = program.inputs, program.default_inputs if given is None else given
    functions = getattr(given, "functions", None)  # of a result of optimal control
    if isinstance(functions, Mapping) and functions.keys() >= {*names}:
        given = {name: functions[name] for name in names}
    if given is None:
        return {}
    if isinstance(given, Mapping):
        known = program.names.inputs.values_by_place(given)
        return dict(program.default_inputs or {}) | {names[k]: x for k, x in known.items()}
    if len(names) == 1 and callable(given):
        return {names[0]: given}
    array = read_array("inputs", given, program.numbers)
    if len(names) == 1 and (array.ndim < 2 or array.shape[-1] != 1):
        return {names[0]: array}
    if array.ndim == 0 or array.shape[-1] != len(names):
        reject(
            f"inputs has shape {array.shape}, but its last axis must have length {len(names)}: "
            f"{', '.join(names)}.",
            remedy=f"Pass a mapping, inputs={{{names[0]!r}: values, ...}}.",
        )
    return {name: array[..., k] for k, name in enumerate(names)}


def _check_times(program: Program, name: str) -> None:
    """Reject a function of time if a derivative by h or t changes the times of the nodes."""
    moved = {"h", "t"}.intersection(program.header.varied_by or ())
    if moved:
        reject(
            f"input {name} is a function of time.",
            why=f"A derivative by {min(moved)!r} would change the times.",
            remedy="Pass the values instead: f(stepper.node_times(h, steps, t0)).",
        )


def _read_input(
    program: Program, name: str, given: Any, h: Any, steps: int, members: int | None
) -> Reals:
    """Read the values of one input, shape (K, N, s); each axis may have length 1."""
    numbers, nodes = program.numbers, len(program.header.input_places)
    sampled = isinstance(given, Samples)
    array = read_array(f"input {name}", given.values if sampled else given, numbers)
    if sampled:
        count = min(count_steps_per_period(name, given.period, h, numbers), max(steps, 1))
        array = np.repeat(array, count, axis=-1)
        array = array[..., :steps] if array.ndim else array
    shape, many = array.shape, members or 1
    if members == 1 and array.ndim > 1 and shape != (steps, nodes) and shape[1] == steps:
        many = len(array)
    fitting: dict[tuple[int, ...], tuple[int, ...]] = {
        (): (1, 1, 1),
        (steps,): (1, steps, 1),
        (steps, 1): (1, steps, 1),
        (many, steps): (many, steps, 1),
        (many, steps, 1): (many, steps, 1),
        **({} if sampled else {(steps, nodes): (1, steps, nodes)}),
        **({} if sampled else {(many, steps, nodes): (many, steps, nodes)}),
    }
    if members == steps == nodes and shape == (steps, nodes):
        reject(
            f"input {name} has shape {shape}.",
            why="It may mean (members, steps) or (steps, nodes).",
            remedy=f"Add an axis: use shape ({members}, {steps}, 1) or (1, {steps}, {nodes}).",
        )
    if shape not in fitting and shape != (1, steps, nodes):
        more = "" if members is None else f" Put an axis of {members} members first if they differ."
        reject(
            f"input {name} has shape {shape}{' after conversion of samples' if sampled else ''}.",
            why=f"The run has {steps} steps of {nodes} nodes.",
            remedy=f"Pass shape ({steps},), a value for each step, or ({steps}, {nodes}), a value "
            f"for each node. stepper.node_times(h, steps) returns the times of the nodes.{more}",
        )
    if not numbers.all_finite(array):
        bad = tuple(np.argwhere(~numbers.finite(array))[0].tolist())
        where = f" at {name}{list(bad)}" if bad else ""
        reject(
            f"input {name} is {float(array[bad])}{where}, not finite.",
            remedy="Check how you compute this value.",
        )
    return array.reshape(fitting.get(shape, shape))


def count_steps_per_period(name: str, period: Any, h: Any, numbers: Numbers) -> int:
    """Return the number of steps in a sampling period; raise InputError if it is not whole."""
    exact = abs(float(read_number(f"the period of input {name}", period, numbers) / h))
    exact = min(exact, float(MOST_STEPS))  # longer than any run
    count = round(exact)
    if count < 1 or abs(exact - count) > STEP_FRACTION:
        fit = float(period) / max(1, -(-exact // 1))
        reject(
            f"the period {float(period):.15g} is {exact:.12g} steps of h={abs(float(h)):.15g}, "
            "not a whole number.",
            where=f"input {name}",
            why="A jump within a step would reduce the order of the scheme.",
            remedy=f"Use h={fit!r}.",
        )
    return count


def node_places(program: Program) -> Reals:
    """Return the places of the nodes within a step, from 0 to 1, shape (s,)."""
    given = program.header.input_places
    return program.numbers.read([Decimal(place) for place in given])


def inputs_from_step(inputs: Reals, step: int) -> Reals:
    """Return the inputs of all steps from ``step`` on."""
    return inputs if inputs.shape[1] == 1 else inputs[:, step:]


def interpolate_inputs(
    program: Program, inputs: Reals, step: NDArray[np.int64], at: Reals
) -> Reals:
    """Interpolate the inputs at any places of the given steps.

    The interpolation polynomial passes through the s nodes of the step and is exact up to degree
    s - 1. Inputs that are constant over a step keep their values exactly. ``step`` has shape (k,),
    and the places ``at``, from 0 to 1, have shape (k, r). The result has shape (1, k, r, m), with
    r = 1 if all inputs are constant over their steps.
    """
    node_values = inputs[0, np.minimum(step, inputs.shape[1] - 1)]
    first = node_values[:, :1]
    constant = (node_values == first).all(axis=(1, 2), keepdims=True)
    if constant.all():
        return first[None]
    c = node_places(program)
    values = 0 * at[:, :, None] * first
    for j in range(c.size):
        basis = 1 + 0 * at
        for i in range(c.size):
            if i != j:
                basis = basis * (at - c[i]) / (c[j] - c[i])
        values = values + basis[:, :, None] * node_values[:, j : j + 1]
    return np.where(constant, first, values)[None]


@dataclass(frozen=True)
class InputHistory:
    """The inputs of a run, with the times of its steps."""

    #: Shape (1, N, s, m), or (K, N, s, m) if the members of an ensemble have different inputs.
    values: Reals
    begin: Any  #: Time at which the first step begins.
    h: Any  #: Step size.
    steps: int  #: Number of steps, including a step that an event ended.

    def of_member(self, member: int) -> InputHistory:
        """Return the inputs of one ensemble member."""
        return self if len(self.values) == 1 else replace(self, values=self.values[[member]])

    def at(self, program: Program, t: Reals, *, arriving: bool = False) -> Reals:
        """Return the inputs at times ``t``, shape (1, len(t), 1, m).

        At the boundary of two steps, the later step counts, or the earlier if ``arriving``.
        """
        numbers, last = program.numbers, max(self.steps - 1, 0)
        with numbers.working():
            times, begin, h = map(numbers.read, (t, self.begin, self.h))
            passed = (times - begin) / h
            rough, whole = (f(passed.astype(np.float64)) for f in (np.asarray, np.rint))
            far = max(abs(x.astype(np.float64)).max(initial=0.0) for x in (times, begin))
            at_end = abs(rough - whole) <= SAME_TIME * (1 + far / abs(float(h)))
            step = np.where(at_end, whole - arriving, np.floor(rough))
            step = np.where(np.isfinite(step), step, 0).astype(np.int64).clip(0, last)
            exact = numbers.read(whole - step)
            place = np.where(at_end, exact, passed - numbers.read(step))
            return interpolate_inputs(program, numbers.read(self.values), step, place[:, None])


def make_input_history(
    inputs: Reals, begin: Any, h: Any, steps: int, ended_by: str | None = None
) -> InputHistory | None:
    """Return the inputs of a run with the times of its steps; None if the system has no inputs."""
    return InputHistory(inputs, begin, h, steps + (ended_by is not None)) if inputs.size else None


def inputs_at_times(
    program: Program, driven: InputHistory | None, t: Reals, *, arriving: bool = False
) -> Reals:
    """Return the inputs at times of a run, as :meth:`Driven.at` does.

    Raises InputError if the system has inputs and ``driven`` is None.
    """
    if not program.inputs:
        return NO_INPUTS
    if driven is None:
        reject(
            f"the inputs {', '.join(program.inputs)} at these states are unknown.",
            where=program.system,
            remedy="Compute quantities that depend on inputs from the run itself, or from "
            "run.at(times).",
        )
    return driven.at(program, t, arriving=arriving)


def node_times(program: Program, h: Any, steps: Any, t0: Any) -> Reals:
    """Return the times of the nodes of steps, shape (steps, s); raise InputError without inputs."""
    if not program.inputs:
        reject(
            "the system has no inputs, so no node times are needed.",
            where=program.system,
            remedy="Declare inputs: MechanicalSystem(..., forces={q: u}, inputs=(u,)).",
        )
    numbers = program.numbers
    with numbers.working():
        step, start = read_step(h, numbers), read_number("t0", t0, numbers)
        count = read_count("steps", steps, least=0)
        place = numbers.counted(0, count, 1)[:, None] + node_places(program)
        return numbers.result(start + step * place)
