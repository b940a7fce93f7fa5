"""Values of inputs, step by step: read, checked, and between the nodes of a step."""

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
from symsimpson.support.calling import explained

#: A period may miss a whole number of steps by so much of a step.
STEP_FRACTION = 1e-6
#: Times are the same that differ by so much of themselves, in steps.
SAME_TIME = 2.0**-48


@dataclass(frozen=True)
class Samples:
    """Values of an input that are held for a period each; see :func:`samples`."""

    values: ArrayLike
    period: Any


@explained()
def samples(values: ArrayLike, *, period: float) -> Samples:
    """Say that the values of an input are held for a period each, from the start of the run on.

    Parameters
    ----------
    values : array_like, shape (L,), or (K, L) in an ensemble of K members
    period : float
        A whole number of steps: a jump within a step would cost the order of the scheme.

    Returns
    -------
    Samples
        What ``integrate(..., inputs={"u": samples(values, period=0.05)})`` takes.

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


def read_driving(
    program: Program, given: Any, h: Any, steps: int, t0: Any, members: int | None = None
) -> Reals:
    """Read the values of all inputs of a run, or of the ``members`` of an ensemble.

    They are given by symbol or by name; or all of them along the last axis. Functions of time are
    evaluated at the nodes of the steps from t0 on. ``members`` is 1 where nothing but the inputs
    tells how many there are. The values have the shape (K, N, s, m), by member, step, node and
    input; where an axis has one entry, the entry is used for all. Raises InputError if one is
    missing, unknown or not finite, or has the wrong shape.
    """
    names, numbers = program.inputs, program.numbers
    if not names:
        if given is None:
            return NO_INPUTS
        reject(
            f"{program.system} has no inputs.",
            remedy="Declare them: MechanicalSystem(..., forces={q: u}, inputs=(u,)).",
        )
    values = given_inputs(program, given)
    missing = [name for name in names if name not in values]
    if missing:
        reject(
            f"{program.system}: the input {missing[0]} has no values.",
            remedy="Pass inputs="
            f"{{{missing[0]!r}: values}}, one value for each of the {steps} steps, or at the nodes "
            "of all steps: stepper.node_times(h, steps); or a function of time.",
        )
    for name, value in values.items():
        if callable(value):
            _check_times(program, name)
            times = node_times(program, h, steps, t0)
            values[name] = values_at(f"input {name}", value, times)[None]
    read = [_one(program, name, values[name], h, steps, members) for name in names]
    try:
        shape = np.broadcast_shapes(*(array.shape for array in read))
    except ValueError:
        sizes = ", ".join(f"{name} of {len(x)}" for name, x in zip(names, read, strict=True))
        reject(
            f"inputs are given for different numbers of members: {sizes}.",
            remedy="Give each input an axis of all members, or none.",
        )
    inputs = np.stack([np.broadcast_to(array, shape) for array in read], axis=-1)
    return inputs if inputs.shape[1] else numbers.zeros((1, 1, 1, len(names)))


def given_inputs(program: Program, given: Any) -> dict[str, Any]:
    """Return what is given for each input, by its name."""
    names, given = program.inputs, program.default_inputs if given is None else given
    functions = getattr(given, "functions", None)  # as a result of optimal control has them
    if isinstance(functions, Mapping) and functions.keys() >= {*names}:
        given = {name: functions[name] for name in names}
    if given is None:
        return {}
    if isinstance(given, Mapping):
        return {names[k]: x for k, x in program.names.inputs.by_place(given).items()}
    if len(names) == 1 and callable(given):
        return {names[0]: given}
    array = read_array("inputs", given, program.numbers)
    if len(names) == 1 and (array.ndim < 2 or array.shape[-1] != 1):
        return {names[0]: array}
    if array.ndim == 0 or array.shape[-1] != len(names):
        reject(
            f"inputs has shape {array.shape}: its last axis is not that of the {len(names)} inputs "
            f"{', '.join(names)}.",
            remedy=f"Pass a mapping, inputs={{{names[0]!r}: values, ...}}.",
        )
    return {name: array[..., k] for k, name in enumerate(names)}


def _check_times(program: Program, name: str) -> None:
    """Raise InputError for a function of time where derivatives move the times."""
    moved = {"h", "t"}.intersection(program.header.varied_by or ())
    if moved:
        reject(
            f"input {name} is a function of time, and a derivative by {min(moved)!r} moves the "
            "times.",
            remedy="Pass its values: f(stepper.node_times(h, steps, t0)).",
        )


def _one(program: Program, name: str, given: Any, h: Any, steps: int, members: int | None) -> Reals:
    """Read the values of one input, shape (K, N, s) or with ones in their places."""
    numbers, nodes = program.numbers, len(program.header.input_places)
    held = isinstance(given, Samples)
    array = read_array(f"input {name}", given.values if held else given, numbers)
    if held:
        count = min(steps_a_period(name, given.period, h, numbers), max(steps, 1))
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
        **({} if held else {(steps, nodes): (1, steps, nodes)}),
        **({} if held else {(many, steps, nodes): (many, steps, nodes)}),
    }
    if members == steps == nodes and shape == (steps, nodes):
        reject(
            f"input {name} has shape {shape}, which may be (members, steps) or (steps, nodes).",
            remedy=f"Say which by one axis more: ({members}, {steps}, 1), or (1, {steps}, "
            f"{nodes}).",
        )
    if shape not in fitting and shape != (1, steps, nodes):
        ways = f"({steps},), a value for each step, or ({steps}, {nodes}), one for each node"
        if members is not None:
            ways += f"; with {members} before them if each member has its own"
        reject(
            f"input {name} has {'steps of samples' if held else 'shape'} {shape}, and the run has "
            f"{steps} steps of {nodes} nodes.",
            remedy=f"Pass one of shape {ways}: "
            "stepper.node_times(h, steps) are the times of nodes.",
        )
    if not numbers.all_finite(array):
        bad = tuple(np.argwhere(~numbers.finite(array))[0].tolist())
        where = f" at {name}{list(bad)}" if bad else ""
        reject(
            f"input {name} is {float(array[bad])}{where}, not finite.",
            remedy="Look where the number comes from.",
        )
    return array.reshape(fitting.get(shape, shape))


def steps_a_period(name: str, period: Any, h: Any, numbers: Numbers) -> int:
    """Return how many steps a value is held."""
    exact = abs(float(read_number(f"the period of input {name}", period, numbers) / h))
    exact = min(exact, float(MOST_STEPS))  # longer than any run
    count = round(exact)
    if count < 1 or abs(exact - count) > STEP_FRACTION:
        fit = float(period) / max(1, -(-exact // 1))
        reject(
            f"input {name}: the period {float(period):.15g} is {exact:.12g} steps of "
            f"h={abs(float(h)):.15g}, no whole number of them.",
            remedy=f"A jump within a step would cost the order of the scheme. Use h={fit!r}.",
        )
    return count


def places(program: Program) -> Reals:
    """Return where in a step its nodes are, shape (s,), as parts of it."""
    given = program.header.input_places
    return program.numbers.read([Decimal(place) for place in given])


def since(inputs: Reals, step: int) -> Reals:
    """Return the inputs from a step on."""
    return inputs if inputs.shape[1] == 1 else inputs[:, step:]


def at_places(program: Program, inputs: Reals, step: NDArray[np.int64], at: Reals) -> Reals:
    """Return the inputs at places of steps that need not be nodes.

    Held inputs stay what they are. Those at nodes go by the polynomial through the s nodes of the
    step: exact up to degree s - 1. For numbers of steps, of shape (k,), and places ``at`` in them,
    from 0 to 1, of shape (k, r), they are of shape (1, k, r, m), with r = 1 where all are held.
    """
    node_values = inputs[0, np.minimum(step, inputs.shape[1] - 1)]
    first = node_values[:, :1]
    held = (node_values == first).all(axis=(1, 2), keepdims=True)
    if held.all():
        return first[None]
    c = places(program)
    values = 0 * at[:, :, None] * first
    for j in range(c.size):
        basis = 1 + 0 * at
        for i in range(c.size):
            if i != j:
                basis = basis * (at - c[i]) / (c[j] - c[i])
        values = values + basis[:, :, None] * node_values[:, j : j + 1]
    return np.where(held, first, values)[None]


@dataclass(frozen=True)
class Driven:
    """Inputs by step, as a run was given them, and when its steps are."""

    #: Of an ensemble, (K, N, s, m) where each member has its own, shape (1, N, s, m).
    values: Reals
    #: Time at which the first step begins, and the step.
    begin: Any
    h: Any
    steps: int  #: Number of steps, one that ended within itself included.

    def of_member(self, member: int) -> Driven:
        """Return those of a member of an ensemble."""
        return self if len(self.values) == 1 else replace(self, values=self.values[[member]])

    def at(self, program: Program, t: Reals, *, arriving: bool = False) -> Reals:
        """Return the inputs at times, shape (1, len(t), 1, m).

        Where a step ends, they are those of the next one, or of that which arrives there.
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
            return at_places(program, numbers.read(self.values), step, place[:, None])


def driven(
    inputs: Reals, begin: Any, h: Any, steps: int, ended_by: str | None = None
) -> Driven | None:
    """Return how inputs went over whole steps, and over that in which an event ended them."""
    return Driven(inputs, begin, h, steps + (ended_by is not None)) if inputs.size else None


def inputs_there(
    program: Program, driven: Driven | None, t: Reals, *, arriving: bool = False
) -> Reals:
    """Return the inputs at times of a run, as :meth:`Driven.at` does.

    Raises InputError if the system has inputs, and it is not known how they went.
    """
    if not program.inputs:
        return NO_INPUTS
    if driven is None:
        reject(
            f"{program.system}: the inputs {', '.join(program.inputs)} at these states are not "
            "known.",
            remedy="Take what depends on them of the run itself, or of run.at(times).",
        )
    return driven.at(program, t, arriving=arriving)


def node_times(program: Program, h: Any, steps: Any, t0: Any) -> Reals:
    """Return the times of the nodes of steps, shape (steps, s); raise InputError without inputs."""
    if not program.inputs:
        reject(
            f"{program.system} has no inputs, so there are no times to take them at.",
            remedy="Declare them: MechanicalSystem(..., forces={q: u}, inputs=(u,)).",
        )
    numbers = program.numbers
    with numbers.working():
        step, start = read_step(h, numbers), read_number("t0", t0, numbers)
        count = read_count("steps", steps, least=0)
        place = numbers.counted(0, count, 1)[:, None] + places(program)
        return numbers.result(start + step * place)
