"""Execution of ensembles: on this machine or a cluster, in memory or in a store."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from itertools import islice
from typing import Any, cast

import numpy as np

from symsimpson.errors import Interrupted, StorageError, SymsimpsonError, reject
from symsimpson.program.configuration import lanes_for
from symsimpson.program.numbers import NO_INPUTS
from symsimpson.program.observed import read_reductions
from symsimpson.program.program import Program, read_program
from symsimpson.run.ensemble.ensemble import Ensemble, names_in_dataset
from symsimpson.run.ensemble.lanes import append_ends, choose_lanes, run_blocks
from symsimpson.run.ensemble.members import EnsembleSpec, read_ensemble_spec
from symsimpson.run.ensemble.own_steps import has_own_steps, read_own_steps, run_groups
from symsimpson.run.ensemble.singles import check_results, check_steps
from symsimpson.run.ensemble.store import (
    Store,
    open_store,
    open_verified,
    run_missing,
    slice_of_chunk,
    store_errors,
    write_chunk,
)
from symsimpson.run.requested import program_for_request
from symsimpson.stepping.inputs import check_on_failure, program_with_derivatives, reject_retimed
from symsimpson.stepping.request import Request
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import import_library
from symsimpson.support.progress import Progress, read_progress
from symsimpson.text.header import digest


def run_ensemble(
    program: Program,
    request: Request,
    store: Any,
    threads: int | None,
    client: Any,
    progress: bool | None,
    on_failure: str,
) -> Ensemble:
    """Run an ensemble with the arguments of :meth:`Stepper.ensemble`.

    Raises InputError for invalid arguments, or if no member can start. Raises Interrupted after
    Ctrl-C, with the results so far.
    """
    check_on_failure(on_failure)
    read_progress(progress)
    program = _program_for_ensemble(program, request)
    differing = has_own_steps(request)
    if differing and (store is not None or client is not None):
        reject(
            "store= and client= need a common step size and initial time.",
            where=program.system,
            remedy="Pass numbers for h and t0, or keep the ensemble in memory.",
        )
    if differing:
        h, t0, request = read_own_steps(program, request)
    task = read_ensemble_spec(program, request, threads, progress, on_disk=store is not None)
    run = partial(run_spec, program, store=store, client=client, on_failure=on_failure)
    return run_groups(program, task, (h, t0), run) if differing else run(task)


def run_spec(
    program: Program,
    task: EnsembleSpec,
    *,
    store: Any = None,
    client: Any = None,
    on_failure: str = "raise",
) -> Ensemble:
    """Run a task; warn if steps are too large or do not resolve a motion.

    Raises Interrupted after Ctrl-C unless ``on_failure`` is "return".
    """
    if not task.checked:
        check_steps(program, task)
    alone = client is not None or program.modes is not None
    task = task if alone else choose_lanes(program, task)
    ensemble, stopped = _run_task(program, task, store, client)
    if not stopped and not task.event_names:  # events change the energy
        check_results(program, task, ensemble)
    elif stopped and on_failure == "raise":
        raise Interrupted(ensemble.message, trajectory=ensemble)
    return ensemble


def _program_for_ensemble(program: Program, request: Request) -> Program:
    """Return the program with the derivatives that an ensemble needs.

    Raises InputError if the request combines derivatives with reductions of variations.
    """
    chaos = any(reduction.of_variations for reduction in read_reductions(program, request.reduce))
    if request.varied or chaos:
        reject_retimed(program, "derivatives of ensembles")
    if request.varied and chaos:
        reject(
            "tangents and sensitivities of an ensemble cannot be combined with reductions of "
            "variations (lyapunov, megno, sali).",
            remedy="Remove one of the two.",
        )
    if chaos:
        return program_with_derivatives(program, ())
    return program_for_request(program, request)


def _run_task(
    program: Program, task: EnsembleSpec, store: Any, client: Any
) -> tuple[Ensemble, bool]:
    """Run a task in memory, in a store or on a cluster; return also whether Ctrl-C stopped it."""
    if store is not None and task.retimed:
        reject(
            "store= cannot be combined with a time transformation.",
            where=program.system,
            why="Each member has its own times, but a store has the same times for all members.",
            remedy="Remove store, and store few states of each member.",
        )
    if store is not None and task.event_names:
        reject(
            "store= cannot be combined with events, contacts or dry friction.",
            why="A store does not save events, so it could not continue an interrupted ensemble.",
            remedy="Remove store. To save memory, use every=None and reduce=.",
        )
    if client is not None:
        check_client(client, store)
        if task.inputs.size:
            reject(
                "client= cannot be combined with inputs.",
                where=program.system,
                why="A store does not pass inputs to the workers.",
                remedy="Run the ensemble on this machine: remove client.",
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
    program: Program, task: EnsembleSpec, count: Callable[[int], None]
) -> tuple[Ensemble, bool]:
    """Run members up to ``t_end`` with a time transformation, and store states on the way.

    A first run of all members determines their numbers of steps, and a second one stores states.
    """
    ends, stopped = run_blocks(program, replace(task, every=0), count)
    if stopped:
        return ends, stopped
    steps = int(ends.steps.max()) + 1  # the last one is a partial step
    again = replace(task, steps=steps, reductions=())
    try:
        ensemble, stopped = run_blocks(program, again, lambda done: None)
    except MemoryError:
        reject(
            f"{task.members} members with up to {again.stored} stored states of {2 * program.n} "
            "numbers do not fit into memory.",
            remedy="Store fewer states: every=100, or every=None for the last states only.",
        )
    return append_ends(ensemble, ends, task.every), stopped


#: Number of tasks that wait at the scheduler for each thread of the cluster.
AHEAD = 4


def check_client(client: Any, store: object) -> None:
    """Raise InputError for an invalid or closed client, or a client without a store."""
    known = import_library("distributed", "client=", "cluster").Client
    if not isinstance(client, known) or client.asynchronous:
        reject(
            f"client is {type(client).__name__}, not a synchronous client of dask.distributed.",
            remedy="Pass client=distributed.Client(...).",
        )
    if client.status != "running":
        reject(
            f"the client is {client.status}, so it cannot send tasks to a scheduler.",
            remedy="Make a new client, distributed.Client(...), and use it before you close it.",
        )
    if store is None:
        reject(
            "client= needs store=, because the workers write their results there.",
            remedy="Pass store='folder', a folder that all workers can access.",
        )


def run_on_cluster(store: Store, client: Any) -> bool:
    """Compute the missing chunks of a store on a cluster; return whether Ctrl-C stopped it.

    A worker receives the path of the store, the digest of the generated module and a chunk number.
    It reads its task from the store and writes the results there. Raises StorageError if a task
    fails on a worker.
    """
    import distributed

    module = digest(store.program.source)
    chunks = list(store.missing_chunks())
    waiting, sent = iter(chunks), dict[str, int]()

    def submit(chunk: int) -> Any:
        future = client.submit(compute_chunk, store.path, module, chunk, pure=False)
        sent[future.key] = chunk
        return future

    members = store.task.members
    with Progress(members, store.task.progress) as progress:
        progress.add(members - sum(map(store.size, chunks)))
        window = AHEAD * max(1, sum(client.nthreads().values()))
        running: Any = cast(Any, distributed).as_completed([])
        try:
            for chunk in islice(waiting, window):
                running.add(submit(chunk))
            for future in running:
                chunk = sent.pop(future.key)
                store.pivots[chunk] = _task_result(future, store)
                progress.add(store.size(chunk))
                for after in islice(waiting, 1):
                    running.add(submit(after))
        except KeyboardInterrupt:
            return True
        finally:
            client.cancel(list(running.futures))
    return False


def _task_result(future: Any, store: Store) -> Any:
    """Return the result of a task; raise StorageError if the task failed."""
    try:
        return future.result()
    except SymsimpsonError:
        raise
    except Exception as error:  # a worker may fail in any way
        reject(
            f"a task failed on a worker: {type(error).__name__}: {error}",
            where=store.path,
            remedy="The store has the results so far. Check the workers' logs, then repeat the "
            "call to continue.",
            error=StorageError,
            cause=error,
        )


def compute_chunk(path: str, module: str, chunk: int) -> Floats | None:
    """Compute a chunk of a store on a worker; return the smallest pivots of M of its members.

    ``module`` is the SHA-256 digest of the generated module; no other module is executed. Raises
    StorageError if the store cannot be read or written, or if its module has another digest.
    """
    import zarr

    with store_errors(path, "read"):
        group: Any = zarr.open_group(path, mode="r+")
        about: dict[str, Any] = dict(group.attrs)
        source, description, size = about["source"], about["asked"], about["chunk"]
    if digest(source) != module:
        reject(
            "the generated module in the store has another digest than the requested one.",
            where=path,
            why="The store was changed or damaged.",
            remedy="Start with a new store.",
            error=StorageError,
        )
    program = _program(source, "the module in a store")
    reduce = {name: (kind, text) for name, kind, text in json.loads(description["reduce"])}
    reductions = read_reductions(program, reduce)
    _, names = names_in_dataset(reduce, program.parameters)
    members = slice_of_chunk(chunk, size, description["members"])
    with store_errors(path, "read"):
        arrays = open_verified(group)
        q0, other0 = (arrays[name][members] for name in ("q0", description["given"]))
        columns = [arrays[names[name]][members] for name in program.parameters]
    parameters = np.array(columns).reshape(-1, len(q0)).T.copy()
    h, t0, steps, every = (description[key] for key in ("h", "t0", "steps", "every"))
    plain = q0, other0, description["given"], parameters, h, t0, steps, every, NO_INPUTS
    task = EnsembleSpec(
        *plain,
        threads=1,
        progress=False,
        lanes=lanes_for(program.header.rows, len(q0)),
        tangents=None if description["tangents"] is None else np.array(description["tangents"]),
        record=tuple(description["record"]),
        reductions=reductions,
    )
    ensemble, _ = run_blocks(program, task, lambda done: None)
    write_chunk(path, group, members, ensemble)
    return ensemble.small_pivots


_program = lru_cache(maxsize=16)(read_program)
