"""Ensembles on disk: a Zarr store holds what was asked for, and what was found chunk by chunk.

The store is made up front and says all that is to be computed: initial states, parameters, times
and the generated module. A chunk of members is written when it is done, its statuses last; until
then they read INTERRUPTED. So whoever opens the store knows what is missing and how to compute it.
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
from symsimpson.results.trajectory import RECORDED
from symsimpson.run.ensemble.ensemble import Ensemble, names_in_dataset
from symsimpson.run.ensemble.lanes import run_blocks, seconds_of_member
from symsimpson.run.ensemble.members import Results, Task, ensemble_of
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import library
from symsimpson.support.files import check_folder, read_path
from symsimpson.support.progress import Progress
from symsimpson.text.header import digest
from symsimpson.text.interface import SMALL_PIVOT

LOG = logging.getLogger(__name__)
#: Seconds of one thread's work in a chunk, and bytes of states that it has at most.
CHUNK_SECONDS = 0.5
CHUNK_BYTES = 2**26


@dataclass(frozen=True, eq=False)
class Store:
    """An ensemble on disk."""

    path: str
    group: Any  #: Of zarr.
    program: Program
    task: Task
    chunk: int  #: Members of a chunk.
    given: Mapping[str, Any]  #: Initial states, parameters and axes; the other arrays are results.
    #: By chunk, how small pivots of M of its members became.
    pivots: dict[int, Any] = field(default_factory=dict)

    @property
    def results(self) -> set[str]:
        """Names of the arrays that are written chunk by chunk."""
        return {*self.group.array_keys()} - {*self.given}

    @property
    def small_pivots(self) -> Floats:
        """How small pivots of M of all members became, as far as they ran since it was opened."""
        pivots = np.full(self.task.members, SMALL_PIVOT)
        for chunk, known in self.pivots.items():
            pivots[self.members(chunk)] = known
        return pivots

    def members(self, chunk: int) -> slice:
        """Return the members of a chunk."""
        return members_of(chunk, self.chunk, self.task.members)

    def size(self, chunk: int) -> int:
        """Count the members of a chunk."""
        members = self.members(chunk)
        return int(members.stop - members.start)

    def missing(self) -> Iterator[int]:
        """Return the chunks that are not done, or of which something is damaged or gone."""
        whole = whole_group(self.group)
        for chunk in range(-(-self.task.members // self.chunk)):
            members = self.members(chunk)
            try:
                if (self.group["status"][members] != Status.INTERRUPTED).all():
                    for name in self.results:
                        whole[name][members]
                    continue
            except (OSError, ValueError, RuntimeError, StorageError) as error:
                LOG.info("%s: chunk %d is computed again: %s", self.path, chunk, error)
            yield chunk

    def mend(self) -> None:
        """Write initial states, parameters and axes again if a chunk is missing or damaged."""
        whole = whole_group(self.group)
        for name, values in self.given.items():
            try:
                whole[name][:]
            except StorageError:
                self.group[name][:] = values

    def ensemble(self) -> Ensemble:
        """Return what is in the store; states stay on disk."""
        task, program = self.task, self.program
        reduced, _ = names_in_dataset([r.name for r in task.reductions], program.parameters)
        with said(self.path, "read"):
            status = self.group["status"][:]
            waiting = np.unique(np.flatnonzero(status == Status.INTERRUPTED) // self.chunk).tolist()
            group = whole_group(self.group, {(x, k) for x in self.results for k in waiting})
            steps, iterations = (group[x][:] for x in ("steps", "newton_iterations"))
            watched = {name: group[stored][:] for name, stored in reduced.items()}
        return ensemble_of(
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


def whole_group(group: Any, waiting: Container[tuple[str, int]] = ()) -> Any:
    """Return a group that raises StorageError for chunks that are missing or damaged.

    Chunks may be missing that are ``waiting`` to be computed: names of arrays, and numbers.
    """
    import zarr

    from symsimpson.run.ensemble.chunks import WholeChunks

    return zarr.open_group(WholeChunks(group.store, waiting), mode="r+")


def members_of(chunk: int, size: int, members: int) -> slice:
    """Return the members of a chunk of a certain size."""
    return slice(chunk * size, min((chunk + 1) * size, members))


def open_store(path: object, program: Program, task: Task) -> Store:
    """Make a store for an ensemble, or open the one that was begun.

    Raises InputError if zarr or xarray is missing, or the folder holds something else; StorageError
    if it cannot be read or written.
    """
    library("xarray", "store=", "data")  # the store is laid out as a dataset
    zarr = library("zarr", "store=", "data")
    read_path("store", path)
    place = os.fspath(cast("str | os.PathLike[str]", path))
    if "://" not in place:
        check_folder(Path(place), "store", "opened")
        place = os.path.abspath(place)
    asked = _asked(program, task)
    with said(place, "opened"):
        try:
            group = zarr.open_group(place, mode="r")
        except FileNotFoundError:
            here = "://" not in place and os.path.exists(place)
            if here and (os.path.isfile(place) or os.listdir(place)):
                raise _other(place, "holds something that is no ensemble") from None
            return _create(place, program, task, asked)
        attributes: dict[str, Any] = dict(group.attrs)
        if attributes.get("begun_by") != "symsimpson":
            raise _other(place, "holds a dataset that is no ensemble of symsimpson")
        if "asked" not in attributes:  # broken off while it was made: nothing is lost
            return _create(place, program, task, asked)
        differing = [key for key in asked if attributes["asked"].get(key) != asked[key]]
        if differing:
            raise _other(place, f"holds another ensemble: {', '.join(differing)} differ")
        opened, (given, _) = zarr.open_group(place, mode="r+"), _given(program, task)
        store = Store(place, opened, program, task, attributes["chunk"], given)
        store.mend()
        return store


def _other(place: str, what: str) -> InputError:
    return InputError(
        f"store={place!r} {what}.\nNothing was changed there. Name a new folder, or repeat the "
        "call that began the store: it goes on from what is done."
    )


def _asked(program: Program, task: Task) -> dict[str, Any]:
    """Say what is to be computed, such that what is equal here has equal results."""
    return {
        "module": digest(program.source),
        **task.as_json(),
        "given": task.given,
        "members": task.members,
        "tangents": None if task.tangents is None else task.tangents.tolist(),
        "record": list(task.record),
        "reduce": json.dumps([r.asked for r in task.reductions]),
        "initial states": hashlib.sha256(task.q0.tobytes() + task.other0.tobytes()).hexdigest(),
        "parameters": hashlib.sha256(task.parameters.tobytes()).hexdigest(),
    }


def _create(place: str, program: Program, task: Task, asked: dict[str, Any]) -> Store:
    """Lay out a store; what was asked for is written last, when all else stands."""
    import zarr
    from zarr.codecs import ZstdCodec

    chunk, (given, template) = _chunk(program, task), _given(program, task)
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
        if name in given:
            write_all(array)[:] = given[name]
    with warnings.catch_warnings():  # zarr warns that other readers may pass over it
        warnings.simplefilter("ignore")
        group = zarr.consolidate_metadata(place)
    # xarray takes those for coordinates that a dataset names so
    coordinates = " ".join(name for name in template.coords if name not in template.dims)
    last = {"coordinates": coordinates} if coordinates else {}
    group.attrs.update(last | {"source": program.source, "asked": asked})
    return Store(place, group, program, task, chunk, given)


def _given(program: Program, task: Task) -> tuple[dict[str, Any], Any]:
    """Return the given arrays of all members and the axes by name, and a dataset of one member."""
    first_task = task.part(slice(0, 1))
    results = Results(first_task, program.header).columns()
    template = ensemble_of(program, first_task, **results).to_xarray()
    given = {x: v.values for x, v in template.variables.items() if v.dims[0] != "member"}
    given = {x: v if v.dtype.kind in "if" else v.astype(object) for x, v in given.items()}
    given |= {"q0": task.q0, task.given: task.other0, "member": np.arange(task.members)}
    identifiers = program.names.parameters.own
    _, names = names_in_dataset([r.name for r in task.reductions], identifiers)
    given |= {names[name]: task.parameters[:, k] for k, name in enumerate(identifiers)}
    return given, template


def _chunk(program: Program, task: Task) -> int:
    """Choose how many members a chunk has."""
    lanes, seconds = task.lanes, seconds_of_member(program, task)
    enough = int(CHUNK_SECONDS * task.threads / seconds) // lanes * lanes
    room = CHUNK_BYTES // (16 * task.stored * program.n)
    return max(1, min(max(enough, lanes), room, task.members))


def run_missing(store: Store) -> bool:
    """Compute in this process what a store lacks; tells whether Ctrl-C stopped it."""
    task = store.task
    try:
        with Progress(task.members, task.progress) as progress:
            missing = list(store.missing())
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


def write_all(array: Any) -> Any:
    """Return an array that writes chunks of NaN, too; without them, they would look lost."""
    return array.with_config({"write_empty_chunks": True})


def write_chunk(path: str, group: Any, members: slice, ensemble: Ensemble) -> None:
    """Write what some members came to, statuses last."""
    names, _ = names_in_dataset(ensemble.reduced, ensemble.parameters)
    columns = {"q": ensemble.q, "p": ensemble.p}
    columns |= {f"{RECORDED}{name}": rows for name, rows in ensemble.recorded.items()}
    if ensemble.variations is not None:
        columns["variations"] = ensemble.variations
    columns |= {names[name]: values for name, values in ensemble.reduced.items()}
    columns |= {"steps": ensemble.steps, "newton_iterations": ensemble.newton_iterations}
    columns |= {"status": ensemble.status}
    with said(path, "written"):
        for name, values in columns.items():
            write_all(group[name])[members] = values


@contextmanager
def said(path: str, what: str) -> Iterator[None]:
    """Turn failures of files into errors that say where."""
    try:
        yield
    except SymsimpsonError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reject(
            f"{path}: the store cannot be {what}: {type(error).__name__}: {error}",
            remedy="Check space and permissions. The same call goes on from what is done.",
            error=StorageError,
            cause=error,
        )
