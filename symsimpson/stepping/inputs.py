"""Read and check the arguments of a run before it starts."""

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
from symsimpson.support.contact_values import reject_contacts
from symsimpson.support.names import counted, did_you_mean, shortened, spelled

#: Largest difference between t_end and a whole number of steps, as a fraction of a step. The
#: relative round-off of times is added to it; the sum is at most ``MOST_MISSED``.
STEP_FRACTION, ROUNDING, MOST_MISSED = 1e-6, 2.0**-51, 0.1
#: Smallest step size: the square of a smaller one underflows, and M / h may overflow.
LEAST_STEP = 1e-150


def read_steps(
    request: Request, numbers: Numbers, *, retimed: bool = False
) -> tuple[Any, int, Any]:
    """Read the step size, the number of steps and the initial time.

    The request has exactly one of ``t_end`` and ``steps``. If h does not divide the duration, the
    next smaller step size that does replaces it.
    """
    h, t0 = read_step(request.h, numbers), read_number("t0", request.t0, numbers)
    _check_length(request)
    if request.steps is not None:
        number = read_count("steps", request.steps, least=0)
        # with a time transformation, h is only the first step in physical time
        _check_times(h, t0, min(number, 1) if retimed else number, numbers)
        return h, number, t0
    end = _read_end(request, h, t0, numbers)
    exact = float((end - t0) / h)
    reject_too_many_steps(exact)
    number = round(exact)
    lost = ROUNDING * (exact + float(max(abs(t0), abs(end)) / abs(h)))
    if abs(exact - number) > min(STEP_FRACTION + lost, MOST_MISSED):
        given, number = h, math.ceil(exact)
        h = (end - t0) / number
        if request.exact_h:
            reject(
                f"t_end={float(end):.15g} is {exact:.12g} steps of h={float(given):.15g} after t0="
                f"{float(t0):.15g}, not a whole number.",
                remedy=f"Use h={float(h)!r}, steps={number}, or exact_h=False.",
            )
    _check_times(h, t0, number, numbers)
    return h, number, t0


def describe_changed_step(request: Request, h: Any, steps: int, numbers: Numbers) -> str:
    """Return a sentence, after a blank, on a step size that differs from the requested one."""
    given, number = read_step(request.h, numbers), counted(steps, "step")
    changed = (
        f" The step size is h={float(h):.15g}, not {float(given):.15g}, so that {number} end at "
        "t_end."
    )
    return "" if h == given else changed


def _check_times(h: Any, t0: Any, steps: int, numbers: Numbers) -> None:
    """Raise InputError if two successive times t0 + k h round to the same number."""
    farthest, digits = max(abs(t0), abs(t0 + h * steps)), getattr(numbers, "digits", None)
    spacing = farthest * (2.0**-52 if digits is None else 10.0 ** (1 - digits))
    if steps and abs(h) < spacing:
        reject(
            f"a step of h={float(h):g} is below round-off at t={float(farthest):g}.",
            why=f"Numbers there are {float(spacing):.2g} apart, so the time would not advance.",
            remedy="Use t0=0 and shift the functions of time by the initial time, or use a larger "
            "h.",
        )


def read_times(request: Request, numbers: Numbers, *, retimed: bool) -> tuple[Any, int, Any, Any]:
    """Read the step size, the number of steps, the initial time and the final time.

    With a time transformation and ``t_end``, the number of steps is unknown: it is then the upper
    limit ``MOST_STEPS``. Otherwise the final time is None.
    """
    if not retimed or request.t_end is None:
        return *read_steps(request, numbers, retimed=retimed), None
    h, t0 = read_step(request.h, numbers), read_number("t0", request.t0, numbers)
    _check_length(request)
    end = _read_end(request, h, t0, numbers)
    _check_times(h, t0, int(end != t0), numbers)
    return h, MOST_STEPS, t0, end


def _check_length(request: Request) -> None:
    """Reject a request without exactly one of ``t_end`` and ``steps``."""
    if (request.t_end is None) == (request.steps is None):
        given = "neither" if request.t_end is None else "both"
        reject(
            f"a run needs exactly one of t_end and steps, but has {given}.",
            remedy="Pass t_end=10.0 or steps=1000.",
        )


def _read_end(request: Request, h: Any, t0: Any, numbers: Numbers) -> Any:
    """Read ``t_end``; raise InputError if steps of h lead away from it."""
    end = read_number("t_end", request.t_end, numbers)
    if float((end - t0) / h) < 0:
        reject(
            f"the run cannot reach t_end={float(end):.15g} from t0={float(t0):.15g} with "
            f"h={float(h):g}.",
            remedy="Use a negative h to run backwards.",
        )
    return end


def read_step(h: Any, numbers: Numbers) -> Any:
    """Read the step size, a finite number other than zero."""
    h = read_number("h", h, numbers)
    if h == 0:
        reject(
            "the step size h is 0.",
            why="Time would not advance.",
            remedy="Pass h > 0, or h < 0 to run backwards.",
        )
    if isinstance(h, float) and abs(h) < LEAST_STEP:
        reject(
            f"the step size h is {h!r}.",
            why="Its square or quotients by it leave the range of double precision.",
            remedy=f"Pass |h| above {LEAST_STEP:g}, or use a smaller unit of time. Multiprecision "
            "has no such limit.",
        )
    return h


def read_every(every: Any) -> int:
    """Read the number of steps between stored states; None (only the last state) becomes 0."""
    return 0 if every is None else read_count("every", every, least=1)


def reject_too_many_steps(steps: float) -> None:
    """Reject more than ``MOST_STEPS`` steps."""
    if steps > MOST_STEPS:
        reject(
            f"a run of {steps:.3g} steps is too long; the limit is {MOST_STEPS:.3g} steps.",
            remedy="Use a larger h.",
        )


def reject_combinations(request: Request) -> None:
    """Raise InputError for arguments that exclude ``t_eval`` or ``save``."""
    for name in ("tangents", "sensitivities", "checkpoint", "record"):
        if getattr(request, name) is not None:
            reject(
                f"{name} cannot be combined with t_eval or save.",
                why=f"{name} needs the states of all steps, but t_eval and save store only some.",
                remedy="Remove t_eval and save. Use run.at(times) or run['energy'] after the run.",
            )
    if request.t_eval is not None and request.every != 1:
        reject(
            f"every={request.every!r} cannot be combined with t_eval.",
            why="Both choose which states the run stores.",
            remedy="Pass one of them.",
        )


def check_on_failure(on_failure: Any) -> None:
    """Check that ``on_failure`` is "raise" or "return"."""
    if not (isinstance(on_failure, str) and on_failure in ("raise", "return")):
        reject(f"on_failure is {shortened(on_failure)}.", remedy="Pass 'raise' or 'return'.")


def choose_v0_or_p0(who: str, how: str, request: Request) -> tuple[Literal["v0", "p0"], ArrayLike]:
    """Return the name and the value of the one of v0 and p0 that the request has."""
    v0, p0 = request.v0, request.p0
    if v0 is not None and p0 is None:
        return "v0", v0
    if p0 is not None and v0 is None:
        return "p0", p0
    given = "neither" if v0 is None else "both"
    reject(f"{who} needs exactly one of v0 and p0, but has {given}.", remedy=how)


def make_start_error(
    system: str, where: str, pivot: float, finite: bool, *, zero: Sequence[str] | None = None
) -> InputError:
    """Make the error for a singular or indefinite mass matrix M at q0.

    ``pivot`` is the smallest pivot of M, and ``finite`` says whether q0 is finite. If M is singular
    at other positions too, ``zero`` has the names of the parameters that are 0.
    """
    if zero is not None:
        which = f" {', '.join(zero)} {'are' if len(zero) > 1 else 'is'} 0." if zero else ""
        return InputError(
            f"{system}: the mass matrix is singular at {where}, and at other positions, too. "
            "A momentum then does not determine the velocity.\n"
            f"Check the parameters of the kinetic energy.{which}"
        )
    if finite and not (np.isfinite(pivot) and pivot >= 0):
        return InputError(
            f"{system}: the mass matrix is not positive definite at {where}. The kinetic energy "
            "must be positive for every velocity.\nCheck the masses. Check also that q0 is not a "
            "singular point of the coordinates, such as a pole of spherical angles."
        )
    return InputError(
        f"{system}: the velocity is not finite at {where}. There q0 is a singular point of the "
        "coordinates, or too large.\nStart from another position."
    )


#: Variables of a step itself: the step size and the time at its start.
STEP = ("h", "t")
#: Unambiguous names of the same variables: names of parameters cannot contain parentheses.
STEP_ITSELF = ("(h)", "(t)")


def read_variables(program: Program, names: Any, *, adjoint: bool = False) -> tuple[str, ...]:
    """Read the names or symbols of differentiation variables; return their names in the module.

    A variable is a parameter, an input, the step size "h" or the time "t" at the start of a step.
    A parameter with the name "h" or "t" takes precedence. If the system depends on time, h moves
    the times of all steps, which an ``adjoint`` run does not differentiate. Raises InputError for
    an unknown or repeated name.
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
                    f"a derivative by {key} is not available.",
                    where=program.system,
                    why=f"{key} follows from the initial state of the run.",
                    remedy="Differentiate by the state (tangents=) or by other parameters.",
                )
        elif driven is not None:
            if program.modes is not None:
                reject(
                    f"a derivative by the input {key} is not available with contacts or friction.",
                    where=program.system,
                    why="The times at which modes change depend on the input.",
                    remedy="Declare a constant input as a parameter.",
                )
            varied.append(header.inputs[driven])
        elif key in STEP and not header.retimed:
            if key == "h" and adjoint and not header.autonomous:
                reject(
                    "a gradient by h is not available if the system depends on time.",
                    where=program.system,
                    why="A change of h moves the times of all steps.",
                    remedy="Pass sensitivities='h' to stepper.integrate.",
                )
            varied.append(key)
        else:
            known = (*program.parameters, *program.inputs, *(() if header.retimed else STEP))
            reject(
                f"{program.system} has no parameter or input {key!r}.{did_you_mean(key, known)}",
                remedy=f"Choose from {', '.join(known) or 'none'}.",
            )
    if len(set(varied)) < len(varied):
        reject(
            f"a name occurs twice in {', '.join(varied)}.",
            remedy="Pass each parameter or input once.",
        )
    return tuple(varied)


def program_with_derivatives(
    program: Program, names: tuple[str, ...], running: Any = None, *, second: bool = False
) -> Program:
    """Return a program that differentiates its steps by these parameters and inputs.

    The program also integrates the ``running`` cost. With ``second``, it computes second
    derivatives. Raises InputError if the module comes from a file without these derivatives.
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
                    "this module has no derivatives of its runs.",
                    where=program.system,
                    remedy="Make a stepper with symsimpson.compile.",
                )
            known = (
                "" if varied_by is None else f" but by {', '.join(varied_by) or 'the state alone'}"
            )
            reject(
                f"this module does not differentiate its steps by "
                f"{', '.join(names) or 'the state'}{known}.",
                where=program.system,
                remedy="Make a stepper with symsimpson.compile, or a module with "
                f"symsimpson.generate(..., derivatives={names!r}).",
            )
        program.findings.variants[key] = program.differentiate(names, running, second=second)
    return program.findings.variants[key]


def reject_retimed(program: Program, what: str) -> None:
    """Raise InputError if the system has a time transformation, contacts or dry friction."""
    reject_contacts(program.modes, program.system, what)
    if program.header.retimed:
        reject(
            f"{what} do not support a time transformation yet.",
            where=program.system,
            remedy="Use a single run with tangents= or sensitivities=, or use the original system "
            "without the time transformation.",
        )


def read_tangents(program: Program, tangents: Any) -> Reals:
    """Read variations of the initial state; return columns (dq, dp), shape (2 n, k).

    An integer k means the first k unit vectors. Raises InputError for a wrong number or shape.
    """
    numbers, size = program.numbers, 2 * program.n
    count = whole_number(tangents)
    if count is not None or isinstance(tangents, bool):
        if count is None or not 0 <= count <= size:
            reject(
                f"tangents={tangents!r}, but the state has {size} numbers.",
                where=program.system,
                remedy=f"Pass tangents={size} for the full derivative, or an array of "
                f"shape ({size}, k).",
            )
        return numbers.read(np.eye(size)[:, :count])
    columns = read_array("tangents", tangents, numbers)
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or columns.shape[0] != size or not numbers.all_finite(columns):
        reject(
            f"tangents has shape {columns.shape} or is not finite; the shape must be ({size}, k).",
            why=f"Each variation is a column of {program.n} numbers dq and {program.n} numbers dp.",
            remedy="Pass tangents=k for the first k unit vectors.",
        )
    return columns
