"""Where an ensemble is computed and kept: here or on a cluster, in memory or in a store."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from symsimpson.errors import InputError
from symsimpson.runtime.ensembles.arrivals import with_ends
from symsimpson.runtime.ensembles.blocks import run_blocks
from symsimpson.runtime.ensembles.cluster import check_client, run_on_cluster
from symsimpson.runtime.ensembles.ensemble import Ensemble
from symsimpson.runtime.ensembles.judged import look_at_ends, look_at_steps
from symsimpson.runtime.ensembles.store import open_store, run_missing
from symsimpson.runtime.ensembles.task import Task
from symsimpson.support.progress import Progress

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["run_ensemble"]


def run_ensemble(stepper: Stepper, task: Task, store: Any, client: Any) -> tuple[Ensemble, bool]:
    """Run an ensemble; tells whether Ctrl-C stopped it.

    Raises
    ------
    InputError
        If no member could begin, or it cannot be kept or computed there.
    """
    look_at_steps(stepper, task)
    found, stopped = _run(stepper, task, store, client)
    if not stopped:
        look_at_ends(stepper, task, found)
    return found, stopped


def _run(stepper: Stepper, task: Task, store: Any, client: Any) -> tuple[Ensemble, bool]:
    if store is not None and task.retimed:
        raise InputError(
            f"{stepper.system} is retimed: its members have times of their own, and a store has "
            "one row of times for all.\nLeave store out, and store few states of each."
        )
    if client is not None:
        check_client(client, store)
        if task.inputs.size:
            raise InputError(
                f"{stepper.system} has inputs, which a store does not hand to workers.\n"
                "Run the ensemble on this machine: leave client out."
            )
    if store is None:
        with Progress(task.members, task.progress) as progress:
            if task.t_end is not None and task.every:
                return _run_to_ends(stepper, task, progress.add)
            return run_blocks(stepper, task, progress.add)
    opened = open_store(store, stepper, task)
    interrupted = run_missing(opened) if client is None else run_on_cluster(opened, client)
    return opened.ensemble(), interrupted


def _run_to_ends(
    stepper: Stepper, task: Task, count: Callable[[int], None]
) -> tuple[Ensemble, bool]:
    """Store states on the way to ends that come after numbers of steps not known before.

    They are known when all members have run once.
    """
    ends, stopped = run_blocks(stepper, replace(task, every=0), count)
    if stopped:
        return ends, stopped
    steps = int(ends.steps.max()) + 1  # of the last one a part is taken
    again = replace(task, steps=steps, reductions=())
    try:
        found, stopped = run_blocks(stepper, again, lambda done: None)
    except MemoryError:
        raise InputError(
            f"{task.members} members with up to {again.stored} stored states of {2 * stepper.n} "
            "numbers do not fit into memory.\nStore fewer: every=100, or every=None for the last "
            "states only."
        ) from None
    return with_ends(found, ends, task.every), stopped
