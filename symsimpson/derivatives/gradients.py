"""The gradient of a cost of a run: what was asked for, read; and brought into its shapes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsimpson.derivatives.adjoint_run import Objective, differentiate_back
from symsimpson.derivatives.state_costs import read_cost, read_samples
from symsimpson.errors import InputError
from symsimpson.program.input_values import read_count
from symsimpson.program.numbers import Numbers
from symsimpson.program.program import Program
from symsimpson.results.motion_derivatives import Gradient
from symsimpson.stepping.driving import Samples, given_inputs, steps_a_period
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.stepping.variations import read_varied, refuse_retimed, varied_program
from symsimpson.support.array_types import Reals
from symsimpson.support.names import spelled

#: The initial state, by what was given of it.
STATE = {"q": "q", "v": "v", "p": "p", "q0": "q", "v0": "v", "p0": "p"}


@dataclass(frozen=True)
class Wanted:
    """A cost, and what to differentiate it by."""

    #: Expressions of the last state, and along the path.
    cost: Any
    running: Any
    samples: Mapping[Any, Any] | None  #: Values, by expression.
    every: Any  #: Steps between samples.
    wrt: Sequence[Any]  #: Names or symbols.


def gradient_of(
    program: Program, request: Request, wanted: Wanted, progress: bool | None
) -> Gradient:
    """Return the cost of a run and its derivatives.

    Raises InputError, ConvergenceError or Interrupted.
    """
    refuse_retimed(program, "gradients of costs")
    several = isinstance(wanted.wrt, (tuple, list, set, frozenset))
    variables: Sequence[Any] = list(wanted.wrt) if several else [wanted.wrt]
    pairs = [(spelled(x), _is_state(program, x)) for x in variables]
    names = [name for name, state in pairs if not state]
    _check(wanted, pairs, velocities=request.v0 is not None)
    running = wanted.running
    # tables of others have an iterator, matrices of SymPy but a shape
    several = hasattr(running, "__iter__") or bool(getattr(running, "shape", False))
    if several and not isinstance(running, str):
        raise InputError(
            f"running is a {type(running).__name__}, not one expression.\nAdd up what costs."
        )
    if "h" in names and _moves(running) and program.names.parameters.place("h") is None:
        raise InputError(
            "running= contains the time, and h moves the times of all steps of a run.\n"
            "Leave h out of wrt, or write the cost without the time."
        )
    program = varied_program(program, read_varied(program, names), running)
    spec = read_run(program, request)
    every = read_count("every", wanted.every, least=1)
    samples = read_samples(program, wanted.samples, spec.steps, every)
    objective = Objective(read_cost(program, wanted.cost), samples, every)
    header = program.header
    varied = header.varied_by or ()
    of_inputs = [j for j, name in enumerate(varied) if name in header.inputs]
    derivatives = differentiate_back(program, spec, objective, of_inputs, progress)
    given = given_inputs(program, request.inputs) if of_inputs else {}
    n, parts = program.n, {}
    for name, state in pairs:
        if state:
            parts[name] = derivatives.state[:n] if STATE[name] == "q" else derivatives.state[n:]
            continue
        varied_name = varied[names.index(name)]
        if varied_name in header.inputs:
            slopes = derivatives.by_step[:, of_inputs.index(names.index(name))]
            key = program.inputs[header.inputs.index(varied_name)]
            parts[name] = _of_input(key, slopes, given[key], spec, program.numbers)
        else:
            parts[name] = np.asarray(derivatives.parameters[names.index(name)])
    return Gradient(derivatives.value, parts)


def _moves(running: Any) -> bool:
    """Return whether the time stands in a cost along the path."""
    if not hasattr(running, "xreplace"):
        return re.search(r"\bt\b", str(running)) is not None
    from sympy import Derivative, Dummy, Symbol  # SymPy is there by now
    from sympy.core.function import AppliedUndef

    moved = running.xreplace({x: Dummy() for x in running.atoms(Derivative)})
    moved = moved.xreplace({x: Dummy() for x in moved.atoms(AppliedUndef)})
    return Symbol("t") in moved.free_symbols


def _is_state(program: Program, variable: Any) -> bool:
    """Return whether a variable is the initial state: a text, or no symbol of a parameter."""
    names, key = program.names, spelled(variable)
    known = names.parameters.place(key) is not None or names.inputs.place(key) is not None
    return key in STATE and not (known and (key.endswith("0") or not isinstance(variable, str)))


def _check(wanted: Wanted, pairs: Sequence[tuple[str, bool]], *, velocities: bool) -> None:
    """Refuse a cost of nothing, and derivatives by a state that was not given."""
    none = wanted.samples is None or (isinstance(wanted.samples, Mapping) and not wanted.samples)
    if wanted.cost is None and wanted.running is None and none:
        raise InputError(
            "there is no cost to differentiate.\nPass cost= of the last state, running= along "
            "the path, or samples= that the run is to come near to."
        )
    if not pairs:
        raise InputError("wrt is empty.\nName what to differentiate by: wrt=('q', 'l1').")
    wrong, right = ("p", "v") if velocities else ("v", "p")
    of_state = [STATE[name] for name, state in pairs if state]
    if wrong in of_state:
        raise InputError(
            f"wrt names {wrong!r}, and the run begins with {right}0.\n"
            f"Pass {wrong}0, or differentiate by {right!r}."
        )
    if len({STATE[name] if state else name for name, state in pairs}) < len(pairs):
        raise InputError(
            f"wrt is {', '.join(name for name, _ in pairs)}.\nName each only once, and what has a "
            "name of the state in a call of its own."
        )


def _of_input(name: str, slopes: Reals, given: Any, spec: RunSpec, numbers: Numbers) -> Reals:
    """Bring the derivatives through steps and nodes, shape (N, s), into the shape of an input."""
    if isinstance(given, Samples):
        values = np.asarray(given.values)
        if not values.ndim:
            return np.asarray(slopes.sum())
        starts = np.arange(0, spec.steps, steps_a_period(name, given.period, spec.h, numbers))
        by_sample = 0 * np.resize(slopes[0], values.shape)
        by_sample[: starts.size] = np.add.reduceat(slopes.sum(axis=1), starts)
        return by_sample
    shape = slopes.shape if callable(given) else np.shape(given)
    if not shape:
        return np.asarray(slopes.sum())
    derivatives = slopes if slopes.size == np.prod(shape) else slopes.sum(axis=1)
    return derivatives.reshape(shape)
