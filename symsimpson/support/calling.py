"""Calls of the user: messages for wrong arguments, and warnings at the line of the caller."""

from __future__ import annotations

import inspect
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from types import FrameType, FunctionType
from typing import Any, ParamSpec, TypeVar

from symsimpson.errors import (
    ConstraintWarning,
    InputError,
    ResolutionWarning,
    StabilityWarning,
    SymsimpsonError,
)
from symsimpson.support.names import counted, did_you_mean

VARIADIC, KEYWORDS = inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD
P = ParamSpec("P")
Result = TypeVar("Result")
Kind = TypeVar("Kind", bound=type)

#: Names that other libraries give to arguments of this package.
ELSEWHERE = {
    "h": "dt step step_size stepsize timestep delta_t",
    "t_end": "t_span tf t_final t_max tmax T duration",
    "steps": "n_steps num_steps N",
    "every": "t_eval stride",
    "t_eval": "saveat ts",
    "t0": "t_start",
    "error": "tol rtol atol",
    "parameters": "args params",
    "q0": "y0 x0 q",
    "v0": "v",
    "p0": "p",
    "inputs": "u",
    "scheme": "method integrator",
    "kinetic": "T T_kin",
    "potential": "V U",
    "q": "q0",
    "v": "v0",
    "p": "p0",
}
#: The arguments for times. A message lists them if an unknown argument means one of them.
TIMES = {
    "h": "the step size is h=",
    "t_end": "the end is t_end= or steps=",
    "every": "every= selects the states to store",
}
#: Advice by function and argument: another call that has this argument, or does not need it.
CHOOSING = "ss.integrate(system, ..., error=1e-6)"
ADVICE = {
    "Stepper.integrate": {"error": f" Use {CHOOSING}: it chooses the step size."},
    "integrate": dict.fromkeys(
        ["tangents", "sensitivities", "record", "reduce", "checkpoint", "checkpoint_every"],
        " Use stepper.integrate with the step size in run.h.",
    ),
}
NO_STEP = f", the step size. Pass it, or use {CHOOSING}, which chooses it"


def explain_arguments(
    kind: type[SymsimpsonError] = InputError, hint: str = ""
) -> Callable[[Callable[P, Result]], Callable[P, Result]]:
    """Decorate a function: wrong arguments raise an error of the package, not a TypeError.

    ``kind`` is the class of the error, and ``hint`` is the end of its message. The arguments are
    examined only after a call has failed, so that successful calls cost nothing.
    """

    def around(function: Callable[P, Result]) -> Callable[P, Result]:
        @wraps(function)
        def call(*given: P.args, **named: P.kwargs) -> Result:
            try:
                return function(*given, **named)
            except TypeError as error:
                # a TypeError from inside the function is a different mistake
                within = error.__traceback__ is not None and error.__traceback__.tb_next
                problem = None if within else _problem(function, given, named)
                if problem is None:
                    raise
                raise kind(problem + hint) from None

        return call

    return around


def explain_methods(
    kind: type[SymsimpsonError] = InputError, also: tuple[str, ...] = ()
) -> Callable[[Kind], Kind]:
    """Decorate public methods of a class, and those in ``also``, with :func:`explain_arguments`."""

    def around(cls: Kind) -> Kind:
        for name, member in list(vars(cls).items()):
            if name.startswith("_") and name not in also:
                continue
            if isinstance(member, FunctionType):
                setattr(cls, name, explain_arguments(kind)(member))
            elif isinstance(member, classmethod):
                setattr(cls, name, classmethod(explain_arguments(kind)(member.__func__)))
        return cls

    return around


def warn(message: str, category: type[Warning]) -> None:
    """Issue a warning at the line outside of the package that led to it."""
    level, frame = 0, sys._getframe().f_back
    while frame is not None and _inside(frame):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level + 2)


@contextmanager
def without_step_warnings(*kinds: type[Warning]) -> Iterator[None]:
    """Ignore warnings of some kinds in this context; by default all warnings of step sizes."""
    with warnings.catch_warnings():
        for kind in kinds or (StabilityWarning, ResolutionWarning, ConstraintWarning):
            warnings.simplefilter("ignore", kind)
        yield


def _inside(frame: FrameType) -> bool:
    """Return whether a frame belongs to the package or to contextlib, which calls the package."""
    module: Any = frame.f_globals.get("__name__", "")
    return str(module).partition(".")[0] in ("symsimpson", "contextlib")


def _problem(
    function: Callable[..., object], given: tuple[object, ...], named: dict[str, object]
) -> str | None:
    """Return a message for the wrong arguments of a call; None if Python's message is as good."""
    method = "." in function.__qualname__ and "<locals>" not in function.__qualname__
    name = function.__qualname__
    if method and given:  # the class of the user's object, which may inherit the method
        owner = given[0] if isinstance(given[0], type) else type(given[0])
        name = f"{owner.__name__}.{function.__name__}"
    name = name.removesuffix(".__init__")
    known = inspect.signature(function).parameters
    arguments = [key for key in known if key not in ("self", "cls")]
    placed = [
        key for key in arguments if known[key].kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
    ]
    named_here = [key for key in arguments if known[key].kind not in (VARIADIC, KEYWORDS)]
    takes = f"It takes {', '.join(f'{key}=' for key in named_here) or 'none'}."
    for key in named:
        if key not in arguments:
            meant = [x for x, others in ELSEWHERE.items() if key in others.split()]
            here = next((x for x in meant if x in arguments), "")
            advice = ADVICE.get(function.__qualname__, {})
            known_as = (x for x in (key, *meant) if x in advice)
            hint = f" Did you mean {here}=?" if here else advice.get(next(known_as, ""), "")
            hint = hint or did_you_mean(key, arguments).replace("?", "=?")
            times = [text for time, text in TIMES.items() if time in arguments]
            about = here in TIMES and len(times) > 1
            return (
                f"{name} has no argument {key}=.{hint}\n"
                + (f"{'; '.join(times).capitalize()}.\n" if about else "")
                + takes
            )
    count = len(given) - int(method)
    if count > len(placed):
        others = [key for key in named_here if key not in placed]
        most = f"at most {counted(len(placed), 'positional argument')}" if placed else "none"
        listed = f": {', '.join(placed)}" if placed else ""
        passed = counted(count, "positional argument")
        said = f"{name} got {passed}, and takes {most}{listed}.\n"
        short = name.rpartition(".")[2]
        if not arguments:
            return f"{said}Call it without arguments: {short}()."
        several, numbers = "", all(hasattr(x, "__float__") for x in given[int(method) :])
        if numbers and placed and "ArrayLike" in str(known[placed[0]].annotation):
            what = "inputs" if placed[0] == "u" else "numbers"
            several = f" Pass several {what} as one list: {placed[0]}=[a, b]."
        if not others:
            return said + (several.lstrip() or "Remove the others.")
        every = ", ".join([*placed, *(f"{key}=..." for key in others)])
        return f"{said}Pass the others by name: {short}({every}).{several}"
    filled = {*placed[:count], *named}
    needed = [key for key in named_here if known[key].default is inspect.Parameter.empty]
    missing = [f"{key}=" for key in needed if key not in filled]
    if missing:
        only_step = missing == ["h="] and function.__qualname__ in ADVICE
        what = f"{', '.join(missing)}{NO_STEP if only_step else ''}"
        return f"{name.rpartition('.')[2]} is missing {what}.\n{takes}"
    return None
