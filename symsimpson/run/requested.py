"""Runs of all kinds as they are requested: short ones, with derivatives, of chosen states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from symsimpson.errors import InputError
from symsimpson.program.program import Program
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.integrate import integrate
from symsimpson.run.short_runs import brief_run
from symsimpson.run.timed import timed_run
from symsimpson.stepping.inputs import read_failure, refuse_together
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import read_run
from symsimpson.stepping.variations import read_varied, varied_program
from symsimpson.support.progress import read_progress

if TYPE_CHECKING:
    from symsimpson.results.sampled import Sampled, Saved


def run(
    program: Program,
    request: Request,
    checkpoint_every: int | None = None,
    progress: bool | None = None,
    on_failure: str = "raise",
) -> Any:
    """Run as requested; further arguments are those of :meth:`Stepper.integrate`.

    Raises InputError, StorageError, ConvergenceError or Interrupted.
    """
    if checkpoint_every is not None and request.checkpoint is None:
        raise InputError(
            f"checkpoint_every={checkpoint_every!r} says how often a file is written, and there is "
            "none.\nPass checkpoint='run.ckpt', too, or leave it out."
        )
    if request.t_eval is not None or request.save is not None:
        return _chosen(program, request, progress, on_failure)
    plain = request.inputs is None and not request.recorded and request.checkpoint is None
    plain = plain and request.events is None
    read_progress(progress)
    read_failure(on_failure)
    if plain and progress is None:
        over = brief_run(program, request)
        if over is not None:
            return over
    if program.header.retimed and request.varied:
        if request.checkpoint is not None:
            raise InputError(
                f"{program.system} is retimed, and a checkpoint keeps no derivatives in another "
                "time.\nLeave out checkpoint, or tangents and sensitivities."
            )
        names = _names_to_vary(program, request)
        return timed_run(program, read_run(program, request), names, progress, on_failure)
    program = program_for(program, request)
    spec = read_run(program, request)
    return integrate(program, spec, progress, on_failure, request.checkpoint, checkpoint_every)


def _chosen(
    program: Program, request: Request, progress: bool | None, on_failure: str
) -> Sampled | Saved:
    """Run, and keep chosen states or quantities."""
    from symsimpson.run.chosen import chosen_run, last_time  # few runs need it

    refuse_together(request)
    if request.t_eval is not None and request.t_end is None and request.steps is None:
        t_end, steps = last_time(program, request)
        request = request._replace(t_end=t_end, steps=steps)
    spec = read_run(program, request)
    return chosen_run(program, spec, request.t_eval, request.save, progress, on_failure)


def end_of_step(program: Program, request: Request) -> Trajectory:
    """Take the one step of a request, and return the state behind it."""
    end = brief_run(program, request) if request.inputs is None else None
    if end is None:
        end = integrate(program, read_run(program, request))
    return end


def tangent_of_step(program: Program, request: Request, names: tuple[str, ...]) -> Trajectory:
    """Take the one step of a request, with its derivatives by the state and by these names."""
    if program.header.retimed:
        spec = read_run(program, request)
        return timed_run(program, spec, names, False, "raise", fixed_steps=True)
    program = varied_program(program, names)
    return integrate(program, read_run(program, request))


def program_for(program: Program, request: Request) -> Program:
    """Return the variant of a program that computes the derivatives a request asks for."""
    if not request.varied:
        return program
    return varied_program(program, _names_to_vary(program, request))


def _names_to_vary(program: Program, request: Request) -> tuple[str, ...]:
    """Read the names of the parameters and inputs to differentiate by.

    Raises InputError if there is no such parameter or input.
    """
    return read_varied(program, () if request.sensitivities is None else request.sensitivities)
