"""Variations of a state: what a run is asked to differentiate, and how they begin."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.program.input_values import read_array, whole_number
from symsimpson.support.array_types import Reals
from symsimpson.support.names import did_you_mean, spelled

if TYPE_CHECKING:
    from symsimpson.program.program import Program
    from symsimpson.stepping.run import Run


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
                raise InputError(
                    f"{key} follows from the start of a run of {program.system}: nothing is "
                    "differentiated by it.\nDifferentiate by the state, tangents=, or by other "
                    "parameters."
                )
        elif driven is not None:
            varied.append(header.inputs[driven])
        elif key in STEP and not header.retimed:
            if key == "h" and not (of_steps or header.autonomous):
                raise InputError(
                    f"{program.system} depends on time, and h moves the times of all steps of "
                    "a run.\nDifferentiate single steps by h: stepper.tangent, stepper.linearise."
                )
            varied.append(key)
        else:
            known = (*program.parameters, *program.inputs)
            raise InputError(
                f"{key!r} is no parameter or input of {program.system}.{did_you_mean(key, known)}\n"
                f"It has {', '.join(known) or 'none'}; a step has h and t."
            )
    if len(set(varied)) < len(varied):
        raise InputError(
            f"one of {', '.join(varied)} is named twice.\nName each parameter or input once."
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
                raise InputError(
                    f"this module of {program.system} does not differentiate its runs.\n"
                    "Make a stepper with symsimpson.compile."
                )
            known = (
                "" if varied_by is None else f" but by {', '.join(varied_by) or 'the state alone'}"
            )
            raise InputError(
                f"this module of {program.system} does not differentiate its steps by "
                f"{', '.join(names) or 'the state'}{known}.\nMake a stepper with "
                "symsimpson.compile, or a module with symsimpson.generate(..., "
                f"derivatives={names!r})."
            )
        program.findings.variants[key] = program.differentiate(names, running, second=second)
    return program.findings.variants[key]


def refuse_retimed(program: Program, what: str) -> None:
    """Refuse what is not there for steps that are fixed in another time; raises InputError."""
    if program.header.retimed:
        raise InputError(
            f"{program.system} is retimed, and {what} are not taken in another time yet.\n"
            "Single runs carry tangents= and sensitivities=; or take the system as it was."
        )


def read_tangents(program: Program, tangents: Any) -> Reals:
    """Read variations of the initial state: so many unit vectors, or columns (dq, dp).

    Raises InputError if there are too many, or the shape is another.
    """
    numbers, size = program.numbers, 2 * program.n
    count = whole_number(tangents)
    if count is not None or isinstance(tangents, bool):
        if count is None or not 0 <= count <= size:
            raise InputError(
                f"tangents={tangents!r}, but {program.system} has a state of {size} numbers.\n"
                f"Pass tangents={size} for the whole derivative, or an array of shape ({size}, k)."
            )
        return numbers.read(np.eye(size)[:, :count])
    columns = read_array("tangents", tangents, numbers)
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or columns.shape[0] != size or not numbers.all_finite(columns):
        raise InputError(
            f"tangents has shape {columns.shape}, or is not finite; expected ({size}, k): a column "
            f"of {program.n} numbers dq and {program.n} numbers dp for each variation.\n"
            "Pass tangents=k for the first k unit vectors."
        )
    return columns


def begin_variations(program: Program, run: Run, tangents: Reals, *, velocity: bool) -> None:
    """Let variations of the state and of parameters begin.

    Those of parameters leave q0 as it is, and p0 or, where that was given, v0: then
    p0 = L_v(q0, v0) changes with the parameters.
    """
    n, given = program.n, tangents.shape[1]
    varied = len(program.header.varied_by or ())
    count = given + varied
    run.rows("TANGENTS", 1)[:] = count
    run.rows("TANGENT", 2 * n * given)[:] = tangents.T.ravel()
    if velocity and varied:
        run.apply("momentum_slopes")
    run.store(0)
