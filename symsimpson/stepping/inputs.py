"""Check what a run is asked for, once, before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import InputError, reject
from symsimpson.program.input_values import (
    MOST_STEPS,
    read_array,
    read_count,
    read_number,
    whole_number,
)
from symsimpson.program.numbers import Numbers
from symsimpson.program.program import Program
from symsimpson.stepping.request import Request
from symsimpson.support.array_types import Reals
from symsimpson.support.names import counted, did_you_mean, shortened, spelled

#: The end of a run may miss a whole number of steps by so much of a step, and by what double
#: precision loses of times and of their quotient; by a tenth at most.
STEP_FRACTION, ROUNDING, MOST_MISSED = 1e-6, 2.0**-51, 0.1
#: Squares of smaller steps are hardly numbers any more, and masses divided by them may be infinite.
LEAST_STEP = 1e-150


def read_steps(
    request: Request, numbers: Numbers, *, retimed: bool = False
) -> tuple[Any, int, Any]:
    """Read step, number of steps and start time; exactly one of ``t_end`` and ``steps``.

    If the step does not divide the duration, the nearest smaller one that does takes its place.
    """
    h, t0 = read_step(request.h, numbers), read_number("t0", request.t0, numbers)
    _check_length(request)
    if request.steps is not None:
        number = read_count("steps", request.steps, least=0)
        # steps that are fixed in another time: h is the first one
        _check_times(h, t0, min(number, 1) if retimed else number, numbers)
        return h, number, t0
    end = _read_end(request, h, t0, numbers)
    exact = float((end - t0) / h)
    refuse_too_many(exact)
    number = round(exact)
    lost = ROUNDING * (exact + float(max(abs(t0), abs(end)) / abs(h)))
    if abs(exact - number) > min(STEP_FRACTION + lost, MOST_MISSED):
        given, number = h, math.ceil(exact)
        h = (end - t0) / number
        if request.exact_h:
            reject(
                f"t_end={float(end):.15g} is {exact:.12g} steps of h={float(given):.15g} from t0="
                f"{float(t0):.15g}, not a whole number.",
                remedy=f"Use h={float(h)!r}, steps={number}, or exact_h=False.",
            )
    _check_times(h, t0, number, numbers)
    return h, number, t0


def step_taken(request: Request, h: Any, steps: int, numbers: Numbers) -> str:
    """Return a sentence on the step, with a blank before it, if it is not the requested one."""
    given, number = read_step(request.h, numbers), counted(steps, "step")
    changed = f" The step is h={float(h):.15g}, not {float(given):.15g}: t_end is {number} from t0."
    return "" if h == given else changed


def _check_times(h: Any, t0: Any, steps: int, numbers: Numbers) -> None:
    """Raise InputError if some of the times t0 + k h are the same number."""
    farthest, digits = max(abs(t0), abs(t0 + h * steps)), getattr(numbers, "digits", None)
    spacing = farthest * (2.0**-52 if digits is None else 10.0 ** (1 - digits))
    if steps and abs(h) < spacing:
        reject(
            f"steps of h={float(h):g} are lost in rounding at t={float(farthest):g}, where numbers "
            f"are {float(spacing):.2g} apart: times would not move, and what depends on them would "
            "stand still.",
            remedy="Take t0=0 and put the time of the start into the functions of time, or "
            "take larger steps.",
        )


def read_times(request: Request, numbers: Numbers, *, retimed: bool) -> tuple[Any, int, Any, Any]:
    """Read step, number of steps and start time; and the end of a run of unknown length.

    That is one whose steps are fixed in another time: the number of steps is then the most.
    """
    if not retimed or request.t_end is None:
        return *read_steps(request, numbers, retimed=retimed), None
    h, t0 = read_step(request.h, numbers), read_number("t0", request.t0, numbers)
    _check_length(request)
    end = _read_end(request, h, t0, numbers)
    _check_times(h, t0, int(end != t0), numbers)
    return h, MOST_STEPS, t0, end


def _check_length(request: Request) -> None:
    """Refuse a run that has not exactly one of ``t_end`` and ``steps``."""
    if (request.t_end is None) == (request.steps is None):
        given = "neither" if request.t_end is None else "both"
        reject(
            f"a run needs exactly one of t_end and steps, and has {given}.",
            remedy="Pass t_end=10.0 or steps=1000.",
        )


def _read_end(request: Request, h: Any, t0: Any, numbers: Numbers) -> Any:
    """Read ``t_end``, which must lie ahead."""
    end = read_number("t_end", request.t_end, numbers)
    if float((end - t0) / h) < 0:
        reject(
            f"t_end={float(end):.15g} is not reached from t0={float(t0):.15g} with h={float(h):g}.",
            remedy="Use a negative h to run backwards.",
        )
    return end


def read_step(h: Any, numbers: Numbers) -> Any:
    """Read the step, a finite number other than zero."""
    h = read_number("h", h, numbers)
    if h == 0:
        reject("the step h is 0.", remedy="Time would stand still. Pass h > 0, or h < 0 backwards.")
    if isinstance(h, float) and abs(h) < LEAST_STEP:
        reject(
            f"the step h is {h!r}, so small that what is divided by it, or its square, leaves the "
            "range of double precision.",
            remedy=f"Pass h above {LEAST_STEP:g}, or take another unit of "
            "time; steps of many digits have no such limit.",
        )
    return h


def read_every(every: Any) -> int:
    """Read the stride of storage; None, for the last state only, becomes 0."""
    return 0 if every is None else read_count("every", every, least=1)


def refuse_too_many(steps: float) -> None:
    """Refuse more steps than can be counted."""
    if steps > MOST_STEPS:
        reject(f"{steps:.3g} steps are too many to count.", remedy="Use a larger h.")


def refuse_together(request: Request) -> None:
    """Refuse what does not go with chosen times or quantities; raises InputError."""
    for name in ("tangents", "sensitivities", "checkpoint", "record"):
        if getattr(request, name) is not None:
            reject(
                f"{name} needs the states of all steps, of which t_eval or save keeps some.",
                remedy="Leave t_eval and save out, and take run.at(times) or "
                "run['energy'] afterwards.",
            )
    if request.t_eval is not None and request.every != 1:
        reject(
            f"every={request.every!r} and t_eval both say which states to keep.",
            remedy="Pass one of them.",
        )


def read_failure(on_failure: Any) -> None:
    """Check what is to be done about a failure."""
    if not (isinstance(on_failure, str) and on_failure in ("raise", "return")):
        reject(f"on_failure is {shortened(on_failure)}.", remedy="Choose 'raise' or 'return'.")


def read_given(who: str, how: str, request: Request) -> tuple[Literal["v0", "p0"], ArrayLike]:
    """Return the one of v0 and p0 that is there, with its name."""
    v0, p0 = request.v0, request.p0
    if v0 is not None and p0 is None:
        return "v0", v0
    if p0 is not None and v0 is None:
        return "p0", p0
    given = "neither" if v0 is None else "both"
    reject(f"{who} needs exactly one of v0 and p0, and has {given}.", remedy=f"{how}")


def refused_start(
    system: str, where: str, pivot: float, finite: bool, *, zero: Sequence[str] | None = None
) -> InputError:
    """Say why a run cannot begin at q0, from the smallest pivot of M there.

    Where M is singular at other positions, too, ``zero`` names the parameters that are 0.
    """
    if zero is not None:
        which = f" {', '.join(zero)} {'are' if len(zero) > 1 else 'is'} 0." if zero else ""
        return InputError(
            f"{system}: the mass matrix is singular at {where}, and at other positions, too.\n"
            "No velocity follows from a momentum without mass. Check the parameters that stand in "
            f"the kinetic energy.{which}"
        )
    if finite and not (np.isfinite(pivot) and pivot >= 0):
        return InputError(
            f"{system}: the mass matrix is not positive definite at {where}.\nKinetic energy must "
            "be positive for every velocity. Check the masses, and that q0 is not a singular "
            "point of the coordinates (a pole of spherical angles, say)."
        )
    return InputError(
        f"{system}: the velocity is not finite at {where}.\nq0 is a singular point of the "
        "coordinates or too large for them. Begin elsewhere."
    )


#: What a step has besides parameters and inputs.
STEP = ("h", "t")
#: The same where parameters may be called so: no name of a user's has parentheses.
STEP_ITSELF = ("(h)", "(t)")


def read_varied(program: Program, names: Any, *, of_steps: bool = False) -> tuple[str, ...]:
    """Read names of parameters and inputs, or their symbols; as the module names them.

    "h" and "t" are the size of the steps and the time of their start, unless parameters are called
    so. A run has one h for all steps, whose times it moves: where something depends on the time,
    only single steps are differentiated by it, those ``of_steps``. Raises InputError if there is no
    such parameter or input, or one is named twice.
    """
    given: Iterable[Any] = names if isinstance(names, (tuple, list)) else (names,)
    names_of, header = program.names, program.header
    varied: list[str] = []
    for name in given:
        place, driven = names_of.parameters.place(name), names_of.inputs.place(name)
        key = spelled(name)
        if place is not None:
            varied.append(header.parameters[place])
            if varied[-1] in header.from_start:
                reject(
                    f"{key} follows from the start of a run of {program.system}: nothing is "
                    "differentiated by it.",
                    remedy="Differentiate by the state, tangents=, or by other parameters.",
                )
        elif driven is not None:
            varied.append(header.inputs[driven])
        elif key in STEP and not header.retimed:
            if key == "h" and not (of_steps or header.autonomous):
                reject(
                    f"{program.system} depends on time, and h moves the times of all steps of "
                    "a run.",
                    remedy="Differentiate single steps by h: stepper.tangent, stepper.linearise.",
                )
            varied.append(key)
        else:
            known = (*program.parameters, *program.inputs)
            reject(
                f"{key!r} is no parameter or input of {program.system}.{did_you_mean(key, known)}",
                remedy=f"It has {', '.join(known) or 'none'}; a step has h and t.",
            )
    if len(set(varied)) < len(varied):
        reject(
            f"one of {', '.join(varied)} is named twice.",
            remedy="Name each parameter or input once.",
        )
    return tuple(varied)


def varied_program(
    program: Program, names: tuple[str, ...], running: Any = None, *, second: bool = False
) -> Program:
    """Return a program whose module differentiates its steps by these parameters and inputs.

    A ``running`` cost is integrated by it, too; it may differentiate rows a ``second`` time. Raises
    InputError if the module was loaded from a file that does not.
    """
    varied_by = program.header.varied_by
    complete = "curvature" in program.header.functions or not second
    if varied_by == names and running is None and complete:
        return program
    key = names, running, second
    if key not in program.findings.variants:
        if program.differentiate is None:
            if program.header.retimed:
                reject(
                    f"this module of {program.system} does not differentiate its runs.",
                    remedy="Make a stepper with symsimpson.compile.",
                )
            known = (
                "" if varied_by is None else f" but by {', '.join(varied_by) or 'the state alone'}"
            )
            reject(
                f"this module of {program.system} does not differentiate its steps by "
                f"{', '.join(names) or 'the state'}{known}.",
                remedy="Make a stepper with "
                "symsimpson.compile, or a module with symsimpson.generate(..., "
                f"derivatives={names!r}).",
            )
        program.findings.variants[key] = program.differentiate(names, running, second=second)
    return program.findings.variants[key]


def refuse_retimed(program: Program, what: str) -> None:
    """Refuse what is not there for steps that are fixed in another time; raises InputError."""
    if program.header.retimed:
        reject(
            f"{program.system} is retimed, and {what} are not taken in another time yet.",
            remedy="Single runs carry tangents= and sensitivities=; or take the system as it was.",
        )


def read_tangents(program: Program, tangents: Any) -> Reals:
    """Read variations of the initial state: so many unit vectors, or columns (dq, dp).

    Raises InputError if there are too many, or the shape is another.
    """
    numbers, size = program.numbers, 2 * program.n
    count = whole_number(tangents)
    if count is not None or isinstance(tangents, bool):
        if count is None or not 0 <= count <= size:
            reject(
                f"tangents={tangents!r}, but {program.system} has a state of {size} numbers.",
                remedy=f"Pass tangents={size} for the whole derivative, or an array of "
                f"shape ({size}, k).",
            )
        return numbers.read(np.eye(size)[:, :count])
    columns = read_array("tangents", tangents, numbers)
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or columns.shape[0] != size or not numbers.all_finite(columns):
        reject(
            f"tangents has shape {columns.shape}, or is not finite; expected ({size}, k): a column "
            f"of {program.n} numbers dq and {program.n} numbers dp for each variation.",
            remedy="Pass tangents=k for the first k unit vectors.",
        )
    return columns
