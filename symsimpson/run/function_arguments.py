"""Arguments and outputs of a run as a function: their names, shapes and conversion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_array
from symsimpson.program.observed import ObservedExpression, read_expression
from symsimpson.program.program import Program
from symsimpson.run.gradients import STATE, is_state
from symsimpson.stepping.driving import Samples, collect_inputs, count_steps_per_period
from symsimpson.stepping.inputs import read_times
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_settings
from symsimpson.support.array_types import Ints, Reals
from symsimpson.support.names import did_you_mean, spelled
from symsimpson.text.quantity import VECTORS

#: Outputs that are whole vectors of a state.
WHOLE = tuple(vector.name for vector in VECTORS)


@dataclass(frozen=True)
class Argument:
    """An argument of a function: a part of the initial state, a parameter or an input."""

    name: str  #: Name of the user, in messages.
    kind: str  #: "q", "v", "p", "parameter" or "input".
    place: int  #: Index of the parameter or input.
    shape: tuple[int, ...]  #: Shape of the value for one member.
    sign: int = 0  #: 1 for a parameter that is declared positive, -1 for a negative one.
    #: For each step the index of its value in an input of shape (L,).
    steps: Ints | None = None

    @property
    def of_state(self) -> bool:
        """True for q0, v0 and p0."""
        return self.kind in "qvp"

    @property
    def by_step(self) -> bool:
        """True for an input whose value may differ between steps."""
        return self.kind == "input" and self.shape != ()

    @property
    def is_plain(self) -> bool:
        """True unless a value of an input lasts several steps."""
        return self.steps is None or bool((self.steps == np.arange(self.steps.size)).all())

    def read(self, value: Any, program: Program) -> Reals:
        """Read a value for one member, or for K members with a first axis of length K.

        Raises InputError for another shape, and for values that are not finite real numbers.
        """
        numbers, name = program.numbers, f"argument {self.name}"
        array = read_array(name, value, numbers)
        axes = len(self.shape)
        if array.ndim not in (axes, axes + 1) or array.shape[array.ndim - axes :] != self.shape:
            many = str((0, *self.shape)).replace("(0", "(K")
            reject(
                f"{name} has shape {array.shape}, but must have shape {self.shape} or {many}.",
                where=program.system,
                remedy="Pass the value for one member, or one row for each of K members.",
            )
        if array.ndim > axes and not len(array):
            reject(f"{name} has no members.", remedy="Pass at least one row.")
        if not numbers.all_finite(array):
            reject(
                f"{name} contains a value that is not finite.",
                where=program.system,
                remedy="Check how you compute this value.",
            )
        if self.sign and not np.all(self.sign * array > 0):
            reject(
                f"{name} is declared {'positive' if self.sign > 0 else 'negative'}, but its value "
                "is not.",
                why="The equations were simplified with that sign.",
                remedy="Change the value or the declaration.",
            )
        return array

    def spread(self, values: Reals) -> Reals:
        """Return the values of an input at steps and nodes, shape (..., N or 1, s or 1)."""
        if self.steps is not None:
            return values[..., self.steps, None]
        return values if len(self.shape) == 2 else values[..., None, None]

    def gather(self, slopes: Reals) -> Reals:
        """Convert derivatives by steps and nodes, shape (..., N, s), to those by the value."""
        if self.steps is None:
            return slopes if len(self.shape) == 2 else slopes.sum(axis=(-2, -1))
        starts = np.flatnonzero(np.diff(self.steps, prepend=-1))
        by_value = np.zeros((*slopes.shape[:-2], *self.shape), dtype=slopes.dtype)
        if starts.size:
            by_value[..., : starts.size] = np.add.reduceat(slopes.sum(axis=-1), starts, axis=-1)
        return by_value


@dataclass(frozen=True)
class Output:
    """An output of a function: the vector q, v or p, or an expression of the state."""

    name: str
    #: Expressions of the components, or of the scalar; empty for q and p, which are the state.
    expressions: tuple[ObservedExpression, ...]
    shape: tuple[int, ...]  #: Shape at one state.


def as_list(given: Any) -> tuple[list[Any], bool]:
    """Return one name or several as a list, and whether there were several."""
    several = isinstance(given, (tuple, list))
    return (list(given) if several else [given]), several


def read_template(
    program: Program, request: Request, names: Sequence[Any]
) -> tuple[Request, RunSpec]:
    """Return the request with placeholders for the arguments, and its specification.

    Raises InputError if a part of the initial state is neither an argument nor given.
    """
    _check_names(program, names)
    parts = {STATE[spelled(x)] for x in names if is_state(program, x)}
    zeros: Any = np.zeros(program.n)
    for part, where in (("q", "q0"), ("v", "v0"), ("p", "p0")):
        if part in parts:
            if getattr(request, where) is not None:
                reject(
                    f"{where} is both an argument in wrt= and a fixed value.",
                    remedy=f"Remove {where}=, or remove it from wrt.",
                )
            request = request._replace(**{where: zeros})
    if request.q0 is None:
        reject(
            "the function has no initial positions.",
            where=program.system,
            remedy="Put 'q0' into wrt, or pass fixed positions as q0=.",
        )
    if request.v0 is None and request.p0 is None:
        reject(
            "the function has neither initial velocities nor momenta.",
            where=program.system,
            remedy="Put 'v0' or 'p0' into wrt, or pass fixed values as v0= or p0=.",
        )
    driven = {x for x in map(program.names.inputs.place, names) if x is not None}
    if driven:
        given = {} if request.inputs is None else collect_inputs(program, request.inputs)
        count = read_times(request, program.numbers, retimed=program.header.retimed)[1]
        placeholders = {program.inputs[k]: np.zeros(count) for k in driven}
        request = request._replace(inputs=collect_inputs(program, placeholders) | given)
    spec = read_settings(program, request)
    if not spec.steps:
        reject("a function needs at least one step.", remedy="Pass steps=1 or more.")
    return request, spec


def _check_names(program: Program, names: Sequence[Any]) -> None:
    """Raise InputError for a name in ``wrt`` that the system does not have."""
    tables = program.names.parameters, program.names.inputs
    for name in names:
        if not is_state(program, name) and all(table.place(name) is None for table in tables):
            key, known = spelled(name), ("q0", "v0", "p0", *program.parameters, *program.inputs)
            reject(
                f"wrt contains {key!r}, which {program.system} does not have."
                f"{did_you_mean(key, known)}",
                remedy=f"Pass a tuple of names from {', '.join(known)}.",
            )


def read_arguments(
    program: Program, request: Request, spec: RunSpec, names: Sequence[Any]
) -> tuple[Argument, ...]:
    """Read ``wrt``: names or symbols of parts of the initial state, parameters and inputs."""
    header, arguments = program.header, list[Argument]()
    inputs = collect_inputs(program, request.inputs) if program.inputs else {}
    for name in names:
        key = spelled(name)
        parameter, driven = (
            table.place(key) for table in (program.names.parameters, program.names.inputs)
        )
        if is_state(program, name):
            argument = Argument(f"{STATE[key]}0", STATE[key], 0, (program.n,))
        elif parameter is not None:
            program.check_given({name: 0.0})
            sign = {"positive": 1, "negative": -1}.get(header.signs[parameter], 0)
            argument = Argument(key, "parameter", parameter, (), sign)
        else:
            assert driven is not None
            values = inputs[program.inputs[driven]]
            argument = _input_argument(program, key, driven, values, spec)
        if any((x.kind, x.place) == (argument.kind, argument.place) for x in arguments):
            reject(f"wrt contains {key!r} twice.", remedy="Pass each name once.")
        arguments.append(argument)
    if not arguments:
        reject("wrt is empty.", remedy="Pass the arguments of the function: wrt=('q0', 'p0').")
    return tuple(arguments)


def _input_argument(program: Program, key: str, place: int, given: Any, spec: RunSpec) -> Argument:
    """Return the argument of an input; it has the shape of the values in ``inputs=``."""
    shape = np.shape(given.values if isinstance(given, Samples) else given)
    nodes = spec.steps, len(program.header.input_places)
    allowed: list[Any] = [(), (spec.steps,), nodes]
    if shape not in allowed if not isinstance(given, Samples) else len(shape) != 1:
        reject(
            f"the values of the input {key} have shape {shape}.",
            where=program.system,
            why="They are the template of an argument in wrt.",
            remedy=f"Pass a number, shape {nodes[:1]}, shape {nodes}, or samples of shape (L,).",
        )
    if isinstance(given, Samples):
        period = count_steps_per_period(key, given.period, spec.h, program.numbers)
        steps = np.arange(spec.steps) // period
        return Argument(key, "input", place, shape, steps=steps)
    each = np.arange(spec.steps)
    shape = nodes if callable(given) else shape
    return Argument(key, "input", place, shape, steps=each if len(shape) == 1 else None)


def read_output(program: Program, given: Any) -> Output:
    """Read one output: "q", "v", "p" or an expression of a state."""
    if isinstance(given, str) and given in WHOLE and given not in program.names.coordinates.places:
        vector = next(x for x in VECTORS if x.name == given)
        names = vector.shown(program.names) if given == "v" else []
        expressions = tuple(read_expression(program, name) for name in names)
        return Output(given, expressions, (program.n,))
    expression = read_expression(program, given, what=f"the output {given}")
    if expression.held:
        reject(
            f"the output {given} contains multipliers of constraints.",
            remedy="Compute multipliers from a run: run.multipliers.",
        )
    return Output(str(given), (expression,), ())
