"""Read trajectories from netCDF and Zarr files with xarray."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np

from symsimpson.errors import InputError, StaleKernelError, StorageError, SymsimpsonError, reject
from symsimpson.program.numbers import NO_INPUTS
from symsimpson.program.program import Program, read_program
from symsimpson.program.recorders import RECORDERS
from symsimpson.program.status import Status
from symsimpson.results.datasets import EVENTS, RECORDED, trajectory_digest
from symsimpson.results.event_record import EventRecord
from symsimpson.results.mode_history import ModeHistory
from symsimpson.results.tables import TABLES, check_kind
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.driving import make_input_history
from symsimpson.support.extras import import_library
from symsimpson.support.files import read_path

#: Functions of other libraries that read tables.
TABLE_READERS = {".npz": "numpy.load", ".csv": "pandas.read_csv", ".parquet": "pandas.read_parquet"}
#: Variables and attributes that the file of a trajectory must have.
VARIABLES = ("q", "p", "newton_iterations", "module")
ATTRIBUTES = ("h", "steps", "every", "status", "message", "parameter_values", "sha256")
#: Attributes that the file of every result has, including results that are not trajectories.
RESULT = ("system", "scheme", "message")


def open_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Open a trajectory that ``run.save`` wrote.

    Like :func:`symsimpson.load`, the function checks the module in the file before it executes it.

    Parameters
    ----------
    path : path
        A ``.nc`` file or a ``.zarr`` store.

    Returns
    -------
    Trajectory
        The saved trajectory, with its energies, dense output and events.

    Raises
    ------
    InputError
        If the extension is not supported, or a library is missing.
    StorageError
        If the file cannot be read, or does not contain a trajectory.

    Examples
    --------
    >>> import tempfile, pathlib, symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.nc"
    >>> run.save(path)
    >>> again = ss.open_trajectory(path)
    >>> bool((again.q == run.q).all()), again.energy[3] == run.energy[3]
    (True, np.True_)
    """
    where = read_path("the trajectory's file", path)
    kind = check_kind(where)
    if kind in TABLES:
        reject(
            f"a {kind} file is a table and does not contain a whole run.",
            where=str(where),
            remedy=f"Read it with {TABLE_READERS[kind]}. "
            "run.save('run.nc') or run.save('run.zarr') saves a whole run.",
        )
    if not where.exists():
        reject(
            "there is no such file.",
            where=str(where),
            remedy="run.save(path) writes one.",
            error=StorageError,
        )
    xarray = import_library("xarray", "a trajectory in a file", "data")
    try:
        if kind == ".nc":
            with xarray.open_dataset(where, engine="netcdf4", decode_times=False) as opened:
                dataset = opened.load()
        else:
            how = {"chunks": None, "consolidated": False, "decode_times": False}
            dataset = xarray.open_zarr(where, **how).load()
    except Exception as error:  # whatever a damaged file makes the libraries raise
        reject(
            f"the file cannot be read: {str(error)[:200]}.",
            where=str(where),
            why="It is damaged, or it is not a trajectory.",
            remedy="Save the run again with run.save(path).",
            error=StorageError,
        )
    missing = [name for name in VARIABLES if name not in dataset]
    missing += [name for name in ATTRIBUTES if name not in dataset.attrs]
    if missing and all(name in dataset.attrs for name in RESULT):
        reject(
            f"this result of symsimpson is not a whole run: it has no {missing[0]!r}.",
            where=str(where),
            why="It has only states at chosen times, chosen quantities or zeros.",
            remedy=f"Read it with xarray.open_{'zarr' if kind == '.zarr' else 'dataset'}. "
            "To save a whole run, integrate without t_eval= and save=.",
            error=StorageError,
        )
    if missing:
        reject(
            f"symsimpson did not save this file as a trajectory: it has no {missing[0]!r}.",
            where=str(where),
            remedy="Open it with xarray to see its contents.",
            error=StorageError,
        )
    try:
        text = np.asarray(dataset["module"], dtype=np.uint8).tobytes().decode()
        users = json.loads(str(dataset.attrs.get("names", "{}")))
        program = read_program(text, os.fspath(where), users=users)
        run = _build_trajectory(dataset, program)
        if trajectory_digest(run) != dataset.attrs["sha256"]:
            raise ValueError("its content does not match its digest")
        return run
    except (StaleKernelError, InputError):
        raise
    except (SymsimpsonError, ValueError, TypeError, KeyError, OverflowError) as error:
        reject(
            f"the file contradicts itself: {error}.",
            where=str(where),
            why="It is damaged, or it was edited.",
            remedy="Save the run again with run.save(path).",
            error=StorageError,
        )


def _build_trajectory(dataset: Any, program: Program) -> Trajectory:
    """Build a trajectory from a dataset; raise ValueError if its arrays do not fit together."""
    about = dataset.attrs
    t = np.asarray(dataset["time"], dtype=np.float64)
    q, p = (np.ascontiguousarray(dataset[name], dtype=np.float64) for name in "qp")
    values = np.atleast_1d(np.asarray(about["parameter_values"], dtype=np.float64))
    iterations = np.asarray(dataset["newton_iterations"], dtype=np.int64)
    h, steps, every = float(about["h"]), int(about["steps"]), int(about["every"])
    stored = steps // every + 1 if every > 0 else 1
    tau, retimed = t - t[0], program.header.retimed
    acted: dict[str, Any] = {"names": [], "ended_by": None, "records": []}
    if EVENTS in dataset:
        acted = json.loads(np.asarray(dataset[EVENTS], dtype=np.uint8).tobytes().decode())
    if acted["ended_by"] is not None:  # within a step
        stored += int(every > 0 and len(t) == stored + 1)
    if retimed:
        tau = np.asarray(dataset["tau"], dtype=np.float64)
        stored += int(every > 0 and len(tau) == stored + 1)  # the end, after part of a step
    shapes = (t.shape, q.shape, p.shape, iterations.shape, values.shape)
    of_states = stored, program.n
    expected = (stored,), of_states, of_states, (stored,), (len(program.parameters),)
    if shapes != expected or not np.isfinite(h) or h == 0:
        raise ValueError(f"arrays have shapes {shapes}, not {expected}")
    whole = steps // every + 1 if every > 0 else 0
    exact = t[0] * (not retimed) + h * every * np.arange(whole)
    grid = (tau if retimed else t)[:whole]
    rounding = 16 * np.finfo(float).eps * np.abs(exact).max(initial=0)
    if not np.abs(grid - exact).max(initial=0) <= rounding:
        raise ValueError("its times are not a uniform time grid")
    if retimed and not (np.diff(t) * h > 0).all():
        raise ValueError("its times are not monotonic")
    inputs = NO_INPUTS
    if program.inputs:
        inputs = np.ascontiguousarray(dataset["inputs"], dtype=np.float64)[None]
        count = inputs.shape[1]  # more than ``steps`` if the run ended early
        if 1 != count < max(steps, 1) or inputs.shape[3] != len(program.inputs):
            raise ValueError(f"its inputs have shape {inputs.shape[1:]}")
        if inputs.shape[2] not in (1, len(program.header.input_places)):
            raise ValueError(f"its inputs have {inputs.shape[2]} nodes")
    variations = varied = None
    if "variations" in dataset:
        variations = np.ascontiguousarray(dataset["variations"], dtype=np.float64)
        if variations.ndim != 3 or variations.shape[:2] != (stored, 2 * program.n):
            raise ValueError(f"its variations have shape {variations.shape}")
        if "varied_by" in about:
            varied = tuple(x for x in np.atleast_1d(about["varied_by"]).tolist() if x)
    begun = None
    if "begun" in about:
        first, *numbers = map(float, about["begun"])
        if every or len(numbers) != 2 * program.n:
            raise ValueError(f"its initial state has {len(numbers)} numbers")
        begun = first, np.array(numbers).reshape(2, program.n)
    reduced = json.loads(str(about.get("reduced", "[]")))
    recorded = [
        (name.removeprefix(RECORDED), np.ascontiguousarray(dataset[name], dtype=np.float64))
        for name in map(str, dataset)
        if name.startswith(RECORDED)
    ]
    for name, rows in recorded:
        if name not in RECORDERS or rows.ndim != 2 or len(rows) != stored:
            raise ValueError(f"{name!r} is an unknown record, or has shape {rows.shape}")
    ended = acted["ended_by"]
    begin = t[0] if every else t[0] - h * steps
    return Trajectory(
        t=t,
        q=q,
        p=p,
        newton_iterations=iterations,
        h=h,
        steps=steps,
        every=every or None,
        status=Status[str(about["status"])],
        message=str(about["message"]),
        program=program,
        parameter_values=values,
        input_values=inputs,
        driven=make_input_history(inputs, begin, h, steps, ended)
        if every or ended is None
        else None,
        tau_values=tau if retimed else None,
        begun=begun,
        variations=variations,
        varied_by=varied,
        recorded_values=tuple(recorded),
        reduced_values=tuple((str(k), float(x)) for k, x in reduced),
        records=tuple(EventRecord.read(entry) for entry in acted["records"]),
        event_names=tuple(acted["names"]),
        ended_by=acted["ended_by"],
        history=ModeHistory.read(acted["modes"]) if "modes" in acted else None,
        error_estimate=float(about["error_estimate"]) if "error_estimate" in about else None,
    )
