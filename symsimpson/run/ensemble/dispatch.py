"""Where an ensemble is computed and kept: here or on a cluster, in memory or in a store."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from symsimpson.errors import InputError, Interrupted
from symsimpson.program.observed import read_reductions
from symsimpson.program.program import Program
from symsimpson.run.ensemble.cluster import check_client, run_on_cluster
from symsimpson.run.ensemble.ensemble import Ensemble
from symsimpson.run.ensemble.lanes import run_blocks, with_ends, with_fastest_lanes
from symsimpson.run.ensemble.members import Task, read_task
from symsimpson.run.ensemble.singles import look_at_ends, look_at_steps
from symsimpson.run.ensemble.store import open_store, run_missing
from symsimpson.run.requested import program_for
from symsimpson.stepping.inputs import read_failure
from symsimpson.stepping.request import Request
from symsimpson.stepping.variations import refuse_retimed, varied_program
from symsimpson.support.progress import Progress, read_progress


def run_ensemble(
    program: Program,
    request: Request,
    store: Any,
    threads: int | None,
    client: Any,
    progress: bool | None,
    on_failure: str,
) -> Ensemble:
    """Run an ensemble as requested; arguments are those of :meth:`Stepper.ensemble`.

    Raises InputError if no member could begin, or it cannot be kept or computed there; Interrupted
    at Ctrl-C, with what is done.
    """
    read_failure(on_failure)
    read_progress(progress)
    program = _telling(program, request)
    task = read_task(program, request, threads, progress, on_disk=store is not None)
    look_at_steps(program, task)
    task = with_fastest_lanes(program, task) if client is None else task
    ensemble, stopped = _run(program, task, store, client)
    if not stopped and task.run_events is None:  # else energies change with what events do
        look_at_ends(program, task, ensemble)
    elif stopped and on_failure == "raise":
        raise Interrupted(ensemble.message, trajectory=ensemble)
    return ensemble


def _telling(program: Program, request: Request) -> Program:
    """Return the program whose ensembles carry along what they are asked for.

    Raises InputError if both are asked for.
    """
    telling = any(reduction.of_variations for reduction in read_reductions(program, request.reduce))
    if request.varied or telling:
        refuse_retimed(program, "derivatives of ensembles")
    if request.varied and telling:
        raise InputError(
            "tangents and sensitivities of an ensemble do not go with reductions that tell of "
            "variations.\nLeave out one of them."
        )
    if telling:
        return varied_program(program, ())
    return program_for(program, request)


def _run(program: Program, task: Task, store: Any, client: Any) -> tuple[Ensemble, bool]:
    if store is not None and task.retimed:
        raise InputError(
            f"{program.system} is retimed: its members have times of their own, and a store has "
            "one row of times for all.\nLeave store out, and store few states of each."
        )
    if store is not None and task.run_events is not None:
        raise InputError(
            "a store does not keep events, which its members would have to be run with again.\n"
            "Leave store out; every=None and reduce= keep few numbers of each member."
        )
    if client is not None:
        check_client(client, store)
        if task.inputs.size:
            raise InputError(
                f"{program.system} has inputs, which a store does not hand to workers.\n"
                "Run the ensemble on this machine: leave client out."
            )
    if store is None:
        with Progress(task.members, task.progress) as progress:
            if task.t_end is not None and task.every:
                return _run_to_ends(program, task, progress.add)
            return run_blocks(program, task, progress.add)
    opened = open_store(store, program, task)
    interrupted = run_missing(opened) if client is None else run_on_cluster(opened, client)
    return opened.ensemble(), interrupted


def _run_to_ends(
    program: Program, task: Task, count: Callable[[int], None]
) -> tuple[Ensemble, bool]:
    """Store states on the way to ends that come after numbers of steps not known before.

    They are known when all members have run once.
    """
    ends, stopped = run_blocks(program, replace(task, every=0), count)
    if stopped:
        return ends, stopped
    steps = int(ends.steps.max()) + 1  # of the last one a part is taken
    again = replace(task, steps=steps, reductions=())
    try:
        ensemble, stopped = run_blocks(program, again, lambda done: None)
    except MemoryError:
        raise InputError(
            f"{task.members} members with up to {again.stored} stored states of {2 * program.n} "
            "numbers do not fit into memory.\nStore fewer: every=100, or every=None for the last "
            "states only."
        ) from None
    return with_ends(ensemble, ends, task.every), stopped
