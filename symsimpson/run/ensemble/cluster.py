"""Ensembles on many machines, by dask.distributed.

A worker is told where the store is, the digest of the module it holds, and the number of a chunk.
It reads what is to be computed from the store and writes there what it computed; no function and
no object of this package is sent.
"""

from __future__ import annotations

import json
from functools import lru_cache
from itertools import islice
from typing import Any, cast

import numpy as np

from symsimpson.errors import InputError, StorageError, SymsimpsonError
from symsimpson.program.configuration import lanes_for
from symsimpson.program.numbers import NO_INPUTS
from symsimpson.program.observed import read_reductions
from symsimpson.program.program import Program, read_program
from symsimpson.run.ensemble.ensemble import names_in_dataset
from symsimpson.run.ensemble.lanes import run_blocks
from symsimpson.run.ensemble.members import Task
from symsimpson.run.ensemble.store import Store, members_of, said, whole_group, write_chunk
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import library
from symsimpson.support.progress import Progress
from symsimpson.text.header import digest

#: Tasks that wait at the scheduler for each thread of the cluster.
AHEAD = 4


def check_client(client: Any, store: object) -> None:
    """Refuse what is no client of dask.distributed, or a client without a store.

    Raises InputError.
    """
    known = library("distributed", "client=", "cluster").Client
    if not isinstance(client, known) or client.asynchronous:
        raise InputError(
            f"client is {type(client).__name__}, not a synchronous client of dask.distributed.\n"
            "Pass client=distributed.Client(...)."
        )
    if client.status != "running":
        raise InputError(
            f"the client is {client.status}: it has no scheduler to send tasks to.\n"
            "Make a new one, distributed.Client(...), and use it before it is closed."
        )
    if store is None:
        raise InputError(
            "client= needs store=, which the workers write to.\n"
            "Pass store='folder', one that all workers reach."
        )


def run_on_cluster(store: Store, client: Any) -> bool:
    """Let the workers of a client compute what a store lacks; tells whether Ctrl-C stopped it.

    Raises StorageError if a task fails on the workers.
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
        raise StorageError(
            f"{store.path}: a task failed on the workers: {type(error).__name__}: {error}\n"
            "What is done is in the store. Look at the workers' logs; the same call goes on."
        ) from error


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
        raise StorageError(
            f"{path}: the module in the store is not the one that was asked for.\n"
            "It was changed or damaged. Begin a new store."
        )
    program = _program(source)
    reduce = {name: (kind, text) for name, kind, text in json.loads(asked["reduce"])}
    reductions = read_reductions(program, reduce)
    _, names = names_in_dataset(reduce, program.parameters)
    members = members_of(chunk, size, asked["members"])
    with said(path, "read"):
        given = whole_group(group)
        q0, other0 = (given[name][members] for name in ("q0", asked["given"]))
        columns = [given[names[name]][members] for name in program.parameters]
    parameters = np.array(columns).reshape(-1, len(q0)).T.copy()
    task = Task(
        q0,
        other0,
        asked["given"],
        parameters,
        asked["h"],
        asked["t0"],
        asked["steps"],
        asked["every"],
        NO_INPUTS,
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


@lru_cache(maxsize=16)
def _program(source: str) -> Program:
    return read_program(source, "the module in a store")
