"""Where an ensemble is computed and kept: here or on a cluster, in memory or in a store."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from typing import Any, cast

import numpy as np

from symsimpson.errors import Interrupted, StorageError, SymsimpsonError, reject
from symsimpson.program.configuration import lanes_for
from symsimpson.program.numbers import NO_INPUTS
from symsimpson.program.observed import read_reductions
from symsimpson.program.program import Program, read_program
from symsimpson.run.ensemble.ensemble import Ensemble, names_in_dataset
from symsimpson.run.ensemble.lanes import run_blocks, with_ends, with_fastest_lanes
from symsimpson.run.ensemble.members import Task, read_task
from symsimpson.run.ensemble.singles import look_at_ends, look_at_steps
from symsimpson.run.ensemble.store import (
    Store,
    members_of,
    open_store,
    run_missing,
    said,
    whole_group,
    write_chunk,
)
from symsimpson.run.requested import program_for
from symsimpson.stepping.inputs import read_failure, refuse_retimed, varied_program
from symsimpson.stepping.request import Request
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import library
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
    """Return the program whose ensembles carry what is asked for; raise InputError for both."""
    telling = any(reduction.of_variations for reduction in read_reductions(program, request.reduce))
    if request.varied or telling:
        refuse_retimed(program, "derivatives of ensembles")
    if request.varied and telling:
        reject(
            "tangents and sensitivities of an ensemble do not go with reductions that tell of "
            "variations.",
            remedy="Leave out one of them.",
        )
    if telling:
        return varied_program(program, ())
    return program_for(program, request)


def _run(program: Program, task: Task, store: Any, client: Any) -> tuple[Ensemble, bool]:
    if store is not None and task.retimed:
        reject(
            f"{program.system} is retimed: its members have times of their own, and a store has "
            "one row of times for all.",
            remedy="Leave store out, and store few states of each.",
        )
    if store is not None and task.run_events is not None:
        reject(
            "a store does not keep events, which its members would have to be run with again.",
            remedy="Leave store out; every=None and reduce= keep few numbers of each member.",
        )
    if client is not None:
        check_client(client, store)
        if task.inputs.size:
            reject(
                f"{program.system} has inputs, which a store does not hand to workers.",
                remedy="Run the ensemble on this machine: leave client out.",
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
        reject(
            f"{task.members} members with up to {again.stored} stored states of {2 * program.n} "
            "numbers do not fit into memory.",
            remedy="Store fewer: every=100, or every=None for the last states only.",
        )
    return with_ends(ensemble, ends, task.every), stopped


#: Tasks that wait at the scheduler for each thread of the cluster.
AHEAD = 4


def check_client(client: Any, store: object) -> None:
    """Raise InputError for no client of dask.distributed, or a client without a store."""
    known = library("distributed", "client=", "cluster").Client
    if not isinstance(client, known) or client.asynchronous:
        reject(
            f"client is {type(client).__name__}, not a synchronous client of dask.distributed.",
            remedy="Pass client=distributed.Client(...).",
        )
    if client.status != "running":
        reject(
            f"the client is {client.status}: it has no scheduler to send tasks to.",
            remedy="Make a new one, distributed.Client(...), and use it before it is closed.",
        )
    if store is None:
        reject(
            "client= needs store=, which the workers write to.",
            remedy="Pass store='folder', one that all workers reach.",
        )


def run_on_cluster(store: Store, client: Any) -> bool:
    """Let the workers of a client compute what a store lacks; tells whether Ctrl-C stopped it.

    A worker gets the path of the store, the digest of its module, and the number of a chunk. It
    reads its task from the store and writes the results there. Raises StorageError if a task fails
    on the workers.
    """
    import distributed

    module = digest(store.program.source)
    chunks = list(store.missing())
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
                store.pivots[chunk] = _result(future, store)
                progress.add(store.size(chunk))
                for after in islice(waiting, 1):
                    running.add(submit(after))
        except KeyboardInterrupt:
            return True
        finally:
            client.cancel(list(running.futures))
    return False


def _result(future: Any, store: Store) -> Any:
    """Return the result of a task; raise StorageError if the task failed."""
    try:
        return future.result()
    except SymsimpsonError:
        raise
    except Exception as error:  # a worker may fail in any way
        reject(
            f"{store.path}: a task failed on the workers: {type(error).__name__}: {error}",
            remedy="What is done is in the store. Look at the workers' logs; the same "
            "call goes on.",
            error=StorageError,
            cause=error,
        )


def compute_chunk(path: str, module: str, chunk: int) -> Floats | None:
    """Compute a chunk of a store, on a worker; returns how small pivots of M of its members became.

    ``module`` is the SHA-256 of the generated module: no other is executed. Raises StorageError if
    the store cannot be read or written, or its module is another one.
    """
    import zarr

    with said(path, "read"):
        group: Any = zarr.open_group(path, mode="r+")
        about: dict[str, Any] = dict(group.attrs)
        source, asked, size = about["source"], about["asked"], about["chunk"]
    if digest(source) != module:
        reject(
            f"{path}: the module in the store is not the one that was asked for.",
            remedy="It was changed or damaged. Begin a new store.",
            error=StorageError,
        )
    program = _program(source, "the module in a store")
    reduce = {name: (kind, text) for name, kind, text in json.loads(asked["reduce"])}
    reductions = read_reductions(program, reduce)
    _, names = names_in_dataset(reduce, program.parameters)
    members = members_of(chunk, size, asked["members"])
    with said(path, "read"):
        given = whole_group(group)
        q0, other0 = (given[name][members] for name in ("q0", asked["given"]))
        columns = [given[names[name]][members] for name in program.parameters]
    parameters = np.array(columns).reshape(-1, len(q0)).T.copy()
    h, t0, steps, every = (asked[key] for key in ("h", "t0", "steps", "every"))
    plain = q0, other0, asked["given"], parameters, h, t0, steps, every, NO_INPUTS
    task = Task(
        *plain,
        threads=1,
        progress=False,
        lanes=lanes_for(program.header.rows, len(q0)),
        tangents=None if asked["tangents"] is None else np.array(asked["tangents"]),
        record=tuple(asked["record"]),
        reductions=reductions,
    )
    ensemble, _ = run_blocks(program, task, lambda done: None)
    write_chunk(path, group, members, ensemble)
    return ensemble.small_pivots


_program = lru_cache(maxsize=16)(read_program)
