"""Check what a run is asked for, once, before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import InputError
from symsimpson.program.input_values import MOST_STEPS, read_count, read_number
from symsimpson.stepping.request import Request
from symsimpson.support.names import counted, shortened

if TYPE_CHECKING:
    from symsimpson.program.numbers import Numbers


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
            raise InputError(
                f"t_end={float(end):.15g} is {exact:.12g} steps of h={float(given):.15g} from t0="
                f"{float(t0):.15g}, not a whole number.\nUse h={float(h)!r}, steps={number}, or "
                "exact_h=False."
            )
    _check_times(h, t0, number, numbers)
    return h, number, t0


def step_taken(request: Request, h: Any, steps: int, numbers: Numbers) -> str:
    """Return a sentence on the step, with a blank before it, if it is not the requested one."""
    given, number = read_step(request.h, numbers), counted(steps, "step")
    changed = f" The step is h={float(h):.15g}, not {float(given):.15g}: t_end is {number} from t0."
    return "" if h == given else changed


def _check_times(h: Any, t0: Any, steps: int, numbers: Numbers) -> None:
    """Refuse steps that are lost in rounding where they are added to times.

    Raises InputError if some of the times t0 + k h are the same number.
    """
    farthest, digits = max(abs(t0), abs(t0 + h * steps)), getattr(numbers, "digits", None)
    spacing = farthest * (2.0**-52 if digits is None else 10.0 ** (1 - digits))
    if steps and abs(h) < spacing:
        raise InputError(
            f"steps of h={float(h):g} are lost in rounding at t={float(farthest):g}, where numbers "
            f"are {float(spacing):.2g} apart: times would not move, and what depends on them would "
            "stand still.\nTake t0=0 and put the time of the start into the functions of time, or "
            "take larger steps."
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
        raise InputError(
            f"a run needs exactly one of t_end and steps, and has {given}.\n"
            "Pass t_end=10.0 or steps=1000."
        )


def _read_end(request: Request, h: Any, t0: Any, numbers: Numbers) -> Any:
    """Read ``t_end``, which must lie ahead."""
    end = read_number("t_end", request.t_end, numbers)
    if float((end - t0) / h) < 0:
        raise InputError(
            f"t_end={float(end):.15g} is not reached from t0={float(t0):.15g} with "
            f"h={float(h):g}.\nUse a negative h to run backwards."
        )
    return end


def read_step(h: Any, numbers: Numbers) -> Any:
    """Read the step, a finite number other than zero."""
    h = read_number("h", h, numbers)
    if h == 0:
        raise InputError(
            "the step h is 0.\nTime would stand still. Pass h > 0, or h < 0 backwards."
        )
    if isinstance(h, float) and abs(h) < LEAST_STEP:
        raise InputError(
            f"the step h is {h!r}, so small that what is divided by it, or its square, leaves the "
            f"range of double precision.\nPass h above {LEAST_STEP:g}, or take another unit of "
            "time; steps of many digits have no such limit."
        )
    return h


def read_every(every: Any) -> int:
    """Read the stride of storage; None, for the last state only, becomes 0."""
    return 0 if every is None else read_count("every", every, least=1)


def refuse_too_many(steps: float) -> None:
    """Refuse more steps than can be counted."""
    if steps > MOST_STEPS:
        raise InputError(f"{steps:.3g} steps are too many to count.\nUse a larger h.")


def refuse_together(request: Request) -> None:
    """Refuse what does not go with chosen times or quantities; raises InputError."""
    for name in ("tangents", "sensitivities", "checkpoint", "record"):
        if getattr(request, name) is not None:
            raise InputError(
                f"{name} needs the states of all steps, of which t_eval or save keeps some.\n"
                "Leave t_eval and save out, and take run.at(times) or run['energy'] afterwards."
            )
    if request.t_eval is not None and request.every != 1:
        raise InputError(
            f"every={request.every!r} and t_eval both say which states to keep.\nPass one of them."
        )


def read_failure(on_failure: Any) -> None:
    """Check what is to be done about a failure."""
    if not (isinstance(on_failure, str) and on_failure in ("raise", "return")):
        raise InputError(f"on_failure is {shortened(on_failure)}.\nChoose 'raise' or 'return'.")


def read_given(who: str, how: str, request: Request) -> tuple[Literal["v0", "p0"], ArrayLike]:
    """Return the one of v0 and p0 that is there, with its name."""
    v0, p0 = request.v0, request.p0
    if v0 is not None and p0 is None:
        return "v0", v0
    if p0 is not None and v0 is None:
        return "p0", p0
    given = "neither" if v0 is None else "both"
    raise InputError(f"{who} needs exactly one of v0 and p0, and has {given}.\n{how}")


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
