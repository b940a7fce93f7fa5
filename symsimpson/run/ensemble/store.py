"""Ensembles on disk: a Zarr store has the arguments, and the results chunk by chunk.

The store is created before the runs and contains all arguments: initial states, parameters, times
and the generated module. A chunk of members is written when it is complete, its statuses last.
Until then the statuses are INTERRUPTED. Any process that opens the store can therefore find and
compute the missing chunks.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import warnings
from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from symsimpson.errors import InputError, StorageError, SymsimpsonError, reject
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.datasets import RECORDED
from symsimpson.run.ensemble.ensemble import Ensemble, names_in_dataset
from symsimpson.run.ensemble.lanes import measure_member_time, run_blocks
from symsimpson.run.ensemble.members import EnsembleSpec, MemberResults, make_ensemble
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import import_library
from symsimpson.support.files import check_folder, read_path
from symsimpson.support.progress import Progress
from symsimpson.text.header import digest
from symsimpson.text.interface import SMALL_PIVOT

LOG = logging.getLogger(__name__)
#: Computing time of a chunk in seconds for each thread, and largest size of its states in bytes.
CHUNK_SECONDS = 0.5
CHUNK_BYTES = 2**26


@dataclass(frozen=True, eq=False)
class Store:
    """An ensemble on disk."""

    path: str
    group: Any  #: The Zarr group.
    program: Program
    task: EnsembleSpec
    chunk: int  #: Number of members in a chunk.
    arrays: Mapping[str, Any]  #: Initial states, parameters and axes; other arrays are results.
    #: Smallest pivots of M of the members of each chunk.
    pivots: dict[int, Any] = field(default_factory=dict)

    @property
    def results(self) -> set[str]:
        """Names of the arrays that are written chunk by chunk."""
        return {*self.group.array_keys()} - {*self.arrays}

    @property
    def small_pivots(self) -> Floats:
        """Smallest pivot of M of each member that this process has run."""
        pivots = np.full(self.task.members, SMALL_PIVOT)
        for chunk, known in self.pivots.items():
            pivots[self.members(chunk)] = known
        return pivots

    def members(self, chunk: int) -> slice:
        """Return the members of a chunk."""
        return slice_of_chunk(chunk, self.chunk, self.task.members)

    def size(self, chunk: int) -> int:
        """Count the members of a chunk."""
        members = self.members(chunk)
        return int(members.stop - members.start)

    def missing_chunks(self) -> Iterator[int]:
        """Yield the numbers of chunks that are incomplete, damaged or missing."""
        whole = open_verified(self.group)
        for chunk in range(-(-self.task.members // self.chunk)):
            members = self.members(chunk)
            try:
                if (self.group["status"][members] != Status.INTERRUPTED).all():
                    for name in self.results:
                        whole[name][members]
                    continue
            except (OSError, ValueError, RuntimeError, StorageError) as error:
                LOG.info("%s: chunk %d is recomputed: %s", self.path, chunk, error)
            yield chunk

    def repair(self) -> None:
        """Write initial states, parameters and axes again if a chunk is missing or damaged."""
        whole = open_verified(self.group)
        for name, values in self.arrays.items():
            try:
                whole[name][:]
            except StorageError:
                self.group[name][:] = values

    def ensemble(self) -> Ensemble:
        """Return the ensemble in the store; its states remain on disk."""
        task, program = self.task, self.program
        reduced, _ = names_in_dataset([r.name for r in task.reductions], program.parameters)
        with store_errors(self.path, "read"):
            status = self.group["status"][:]
            waiting = np.unique(np.flatnonzero(status == Status.INTERRUPTED) // self.chunk).tolist()
            group = open_verified(self.group, {(x, k) for x in self.results for k in waiting})
            steps, iterations = (group[x][:] for x in ("steps", "newton_iterations"))
            watched = {name: group[stored][:] for name, stored in reduced.items()}
        return make_ensemble(
            program,
            task,
            q=group["q"],
            p=group["p"],
            status=status,
            steps=steps,
            newton_iterations=iterations,
            reduced=watched,
            store=self.path,
            small_pivots=self.small_pivots,
            **({"variations": group["variations"]} if "variations" in group else {}),
            recorded={name: group[f"{RECORDED}{name}"] for name in task.record},
        )


def open_verified(group: Any, waiting: Container[tuple[str, int]] = ()) -> Any:
    """Return a group that raises StorageError for missing or damaged chunks.

    ``waiting`` contains pairs of array name and chunk number that may be missing.
    """
    import zarr

    from symsimpson.run.ensemble.chunks import VerifiedStore

    return zarr.open_group(VerifiedStore(group.store, waiting), mode="r+")


def slice_of_chunk(chunk: int, size: int, members: int) -> slice:
    """Return the slice of members in chunk number ``chunk`` of ``size`` members."""
    return slice(chunk * size, min((chunk + 1) * size, members))


def open_store(path: object, program: Program, task: EnsembleSpec) -> Store:
    """Create a store for an ensemble, or open an existing one with the same arguments.

    Raises InputError if zarr or xarray is missing, or if the folder has other content. Raises
    StorageError if the store cannot be read or written.
    """
    import_library("xarray", "store=", "data")  # the store has the layout of a dataset
    zarr = import_library("zarr", "store=", "data")
    read_path("store", path)
    place = os.fspath(cast("str | os.PathLike[str]", path))
    if "://" not in place:
        check_folder(Path(place), "store", "opened")
        place = os.path.abspath(place)
    description = _describe_task(program, task)
    with store_errors(place, "opened"):
        try:
            group = zarr.open_group(place, mode="r")
        except FileNotFoundError:
            here = "://" not in place and os.path.exists(place)
            if here and (os.path.isfile(place) or os.listdir(place)):
                raise _make_content_error(place, "contains other files and no ensemble") from None
            return _create_store(place, program, task, description)
        attributes: dict[str, Any] = dict(group.attrs)
        if attributes.get("begun_by") != "symsimpson":
            raise _make_content_error(
                place, "contains a dataset that is not an ensemble of symsimpson"
            )
        if "asked" not in attributes:  # its creation was interrupted, before any run
            return _create_store(place, program, task, description)
        differing = [key for key in description if attributes["asked"].get(key) != description[key]]
        if differing:
            raise _make_content_error(
                place, f"contains another ensemble: {', '.join(differing)} differ"
            )
        opened, (arrays, _) = zarr.open_group(place, mode="r+"), _given_arrays(program, task)
        store = Store(place, opened, program, task, attributes["chunk"], arrays)
        store.repair()
        return store


def _make_content_error(place: str, what: str) -> InputError:
    """Make the error for a folder with other content."""
    return InputError(
        f"store={place!r} {what}. Its content is unchanged.\nChoose a new folder, or repeat the "
        "call that created the store to continue it."
    )


def _describe_task(program: Program, task: EnsembleSpec) -> dict[str, Any]:
    """Return a JSON description of a task; tasks with equal descriptions have equal results."""
    return {
        "module": digest(program.source),
        **task.as_json(),
        "given": task.given,
        "members": task.members,
        "tangents": None if task.tangents is None else task.tangents.tolist(),
        "record": list(task.record),
        "reduce": json.dumps([r.entries for r in task.reductions]),
        "initial states": hashlib.sha256(task.q0.tobytes() + task.other0.tobytes()).hexdigest(),
        "parameters": hashlib.sha256(task.parameters.tobytes()).hexdigest(),
    }


def _create_store(
    place: str, program: Program, task: EnsembleSpec, description: dict[str, Any]
) -> Store:
    """Create a store; write the description of the task last, when all arrays exist."""
    import zarr
    from zarr.codecs import ZstdCodec

    chunk, (arrays, template) = _choose_chunk_size(program, task), _given_arrays(program, task)
    about = {key: value for key, value in template.attrs.items() if key != "outcome"}
    about |= {"begun_by": "symsimpson", "chunk": chunk}
    group = zarr.create_group(place, overwrite=True, attributes=about, zarr_format=3)
    for name, variable in template.variables.items():
        integers, text = variable.dtype.kind == "i", variable.dtype.kind not in "if"
        shape, chunks = variable.shape, variable.shape
        if variable.dims[0] == "member":
            shape, chunks = (task.members, *shape[1:]), (min(chunk, task.members), *chunks[1:])
        array = group.create_array(
            name,
            shape=shape,
            chunks=chunks,
            dtype=str if text else variable.dtype,
            dimension_names=variable.dims,
            attributes=dict(variable.attrs),
            compressors=[ZstdCodec(level=0, checksum=True)],
            fill_value="" if text else int(Status.INTERRUPTED) if integers else np.nan,
        )
        if name in arrays:
            writing_nan(array)[:] = arrays[name]
    with warnings.catch_warnings():  # zarr warns that other readers may ignore these metadata
        warnings.simplefilter("ignore")
        group = zarr.consolidate_metadata(place)
    # xarray reads the names of coordinates from this attribute
    coordinates = " ".join(name for name in template.coords if name not in template.dims)
    last = {"coordinates": coordinates} if coordinates else {}
    group.attrs.update(last | {"source": program.source, "asked": description})
    return Store(place, group, program, task, chunk, arrays)


def _given_arrays(program: Program, task: EnsembleSpec) -> tuple[dict[str, Any], Any]:
    """Return the initial states, parameters and axes by name, and a template dataset.

    The template is the dataset of one member.
    """
    first_task = task.part(slice(0, 1))
    results = MemberResults(first_task, program.header).columns()
    template = make_ensemble(program, first_task, **results).to_xarray()
    arrays = {x: v.values for x, v in template.variables.items() if v.dims[0] != "member"}
    arrays = {x: v if v.dtype.kind in "if" else v.astype(object) for x, v in arrays.items()}
    arrays |= {"q0": task.q0, task.given: task.other0, "member": np.arange(task.members)}
    identifiers = program.names.parameters.own
    _, names = names_in_dataset([r.name for r in task.reductions], identifiers)
    arrays |= {names[name]: task.parameters[:, k] for k, name in enumerate(identifiers)}
    return arrays, template


def _choose_chunk_size(program: Program, task: EnsembleSpec) -> int:
    """Return the number of members in a chunk, from their computing time and size."""
    lanes, seconds = task.lanes, measure_member_time(program, task)
    by_time = int(CHUNK_SECONDS * task.threads / seconds) // lanes * lanes
    by_size = CHUNK_BYTES // (16 * task.stored * program.n)
    return max(1, min(max(by_time, lanes), by_size, task.members))


def run_missing(store: Store) -> bool:
    """Compute the missing chunks of a store in this process; return whether Ctrl-C stopped it."""
    task = store.task
    try:
        with Progress(task.members, task.progress) as progress:
            missing = list(store.missing_chunks())
            progress.add(task.members - sum(map(store.size, missing)))
            for chunk in missing:
                part = task.part(store.members(chunk))
                ensemble, interrupted = run_blocks(store.program, part, progress.add)
                if interrupted:
                    return True
                store.pivots[chunk] = ensemble.small_pivots
                write_chunk(store.path, store.group, store.members(chunk), ensemble)
    except KeyboardInterrupt:
        return True
    return False


def writing_nan(array: Any) -> Any:
    """Return an array that also writes chunks of NaN, which would otherwise look missing."""
    return array.with_config({"write_empty_chunks": True})


def write_chunk(path: str, group: Any, members: slice, ensemble: Ensemble) -> None:
    """Write the results of some members, their statuses last."""
    names, _ = names_in_dataset(ensemble.reduced, ensemble.parameters)
    columns = {"q": ensemble.q, "p": ensemble.p}
    columns |= {f"{RECORDED}{name}": rows for name, rows in ensemble.recorded.items()}
    if ensemble.variations is not None:
        columns["variations"] = ensemble.variations
    columns |= {names[name]: values for name, values in ensemble.reduced.items()}
    columns |= {"steps": ensemble.steps, "newton_iterations": ensemble.newton_iterations}
    columns |= {"status": ensemble.status}
    with store_errors(path, "written"):
        for name, values in columns.items():
            writing_nan(group[name])[members] = values


@contextmanager
def store_errors(path: str, what: str) -> Iterator[None]:
    """Convert errors of files into StorageError with the path of the store."""
    try:
        yield
    except SymsimpsonError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reject(
            f"the store cannot be {what}: {type(error).__name__}: {error}",
            where=path,
            remedy="Check disk space and permissions, then repeat the call to continue.",
            error=StorageError,
            cause=error,
        )
