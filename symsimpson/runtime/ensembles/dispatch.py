"""Where an ensemble is computed and kept: here or on a cluster, in memory or in a store."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from symsimpson.errors import InputError
from symsimpson.progress import Progress
from symsimpson.runtime.ensembles.blocks import Task, run_blocks
from symsimpson.runtime.ensembles.cluster import check_client, run_on_cluster
from symsimpson.runtime.ensembles.ensemble import Ensemble
from symsimpson.runtime.ensembles.store import open_store, run_missing

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["run_ensemble"]


def run_ensemble(stepper: Stepper, task: Task, store: Any, client: Any) -> tuple[Ensemble, bool]:
    """Run an ensemble; tells whether Ctrl-C stopped it."""
    if client is not None:
        check_client(client, store)
        if task.inputs.size:
            raise InputError(
                f"{stepper.system} has inputs, which a store does not hand to workers.\n"
                "Run the ensemble on this machine: leave client out."
            )
    if store is None:
        with Progress(task.members, task.progress) as progress:
            return run_blocks(stepper, task, progress.add)
    opened = open_store(store, stepper, task)
    interrupted = run_missing(opened) if client is None else run_on_cluster(opened, client)
    return opened.ensemble(), interrupted
