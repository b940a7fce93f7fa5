"""Trajectories from files: netCDF and Zarr, by way of xarray."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np

from symsimpson.errors import InputError, StaleKernelError, StorageError, SymsimpsonError, reject
from symsimpson.program.numbers import NO_INPUTS
from symsimpson.program.program import Program, read_program
from symsimpson.program.recorders import NAMED
from symsimpson.program.status import Status
from symsimpson.results.events import Record
from symsimpson.results.tables import TABLES, check_kind
from symsimpson.results.trajectory import EVENTS, RECORDED, Trajectory, digest_of
from symsimpson.stepping.driving import driven
from symsimpson.support.extras import library
from symsimpson.support.files import read_path

#: What reads tables again.
READERS = {".npz": "numpy.load", ".csv": "pandas.read_csv", ".parquet": "pandas.read_parquet"}
#: What a file must hold: variables, and attributes beside the dataset's own.
VARIABLES = ("q", "p", "newton_iterations", "module")
ATTRIBUTES = ("h", "steps", "every", "status", "message", "parameter_values", "sha256")
#: Attributes that every result of a run has, also one that is no trajectory.
RESULT = ("system", "scheme", "message")


def open_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Open a trajectory that ``run.save`` wrote.

    The module in the file is checked, as by :func:`symsimpson.load`, before anything of it runs.

    Parameters
    ----------
    path : path
        A ``.nc`` file or a ``.zarr`` store.

    Returns
    -------
    Trajectory
        With all that it had: energies, dense output, events.

    Raises
    ------
    InputError
        If the name ends otherwise, or a library is missing.
    StorageError
        If the file cannot be read, or holds no trajectory.

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
            f"{where}: a {kind} file is a table, and holds no run that could go on.",
            remedy="Read it with "
            f"{READERS[kind]}; run.save('run.nc') or 'run.zarr' keeps all of a run.",
        )
    if not where.exists():
        reject(
            f"{where}: there is no such file.",
            remedy="run.save(path) makes one.",
            error=StorageError,
        )
    xarray = library("xarray", "a trajectory in a file", "data")
    try:
        if kind == ".nc":
            with xarray.open_dataset(where, engine="netcdf4", decode_times=False) as opened:
                dataset = opened.load()
        else:
            how = {"chunks": None, "consolidated": False, "decode_times": False}
            dataset = xarray.open_zarr(where, **how).load()
    except Exception as error:  # whatever a damaged file makes the libraries raise
        reject(
            f"{where}: the file cannot be read: {str(error)[:200]}.",
            remedy="It is damaged, or no trajectory.",
            error=StorageError,
        )
    missing = [name for name in VARIABLES if name not in dataset]
    missing += [name for name in ATTRIBUTES if name not in dataset.attrs]
    if missing and all(name in dataset.attrs for name in RESULT):
        reject(
            f"{where}: this is a result of symsimpson, but no run that could go on: states at "
            f"chosen times, chosen quantities or zeros. It has no {missing[0]!r}.",
            remedy="Read it with "
            f"xarray.open_{'zarr' if kind == '.zarr' else 'dataset'}. To open a run again, "
            "integrate without t_eval= and save=, and save that.",
            error=StorageError,
        )
    if missing:
        reject(
            f"{where}: this is no trajectory that symsimpson saved: it has no {missing[0]!r}.",
            remedy="Open it with xarray to see what it holds.",
            error=StorageError,
        )
    try:
        text = np.asarray(dataset["module"], dtype=np.uint8).tobytes().decode()
        users = json.loads(str(dataset.attrs.get("names", "{}")))
        program = read_program(text, os.fspath(where), users=users)
        run = _trajectory(dataset, program)
        if digest_of(run) != dataset.attrs["sha256"]:
            raise ValueError("its content does not have the digest that it names")
        return run
    except (StaleKernelError, InputError):
        raise
    except (SymsimpsonError, ValueError, TypeError, KeyError, OverflowError) as error:
        reject(
            f"{where}: the file contradicts itself: {error}.",
            remedy="It is damaged, or was edited.",
            error=StorageError,
        )


def _trajectory(dataset: Any, program: Program) -> Trajectory:
    """Put a trajectory together, of which all parts must fit."""
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
        stored += int(every > 0 and len(tau) == stored + 1)  # the end, behind part of a step
    shapes = (t.shape, q.shape, p.shape, iterations.shape, values.shape)
    many = stored, program.n
    wanted = (stored,), many, many, (stored,), (len(program.parameters),)
    if shapes != wanted or not np.isfinite(h) or h == 0:
        raise ValueError(f"arrays have shapes {shapes}, not {wanted}")
    whole = steps // every + 1 if every > 0 else 0
    exact = t[0] * (not retimed) + h * every * np.arange(whole)
    grid = (tau if retimed else t)[:whole]
    rounding = 16 * np.finfo(float).eps * np.abs(exact).max(initial=0)
    if not np.abs(grid - exact).max(initial=0) <= rounding:
        raise ValueError("times are not steps apart")
    if retimed and not (np.diff(t) * h > 0).all():
        raise ValueError("times do not go on")
    inputs = NO_INPUTS
    if program.inputs:
        inputs = np.ascontiguousarray(dataset["inputs"], dtype=np.float64)[None]
        given = inputs.shape[1]  # more than steps where the run ended before
        if 1 != given < max(steps, 1) or inputs.shape[3] != len(program.inputs):
            raise ValueError(f"inputs have shape {inputs.shape[1:]}")
        if inputs.shape[2] not in (1, len(program.header.input_places)):
            raise ValueError(f"inputs have {inputs.shape[2]} nodes")
    ways = varied = None
    if "variations" in dataset:
        ways = np.ascontiguousarray(dataset["variations"], dtype=np.float64)
        if ways.ndim != 3 or ways.shape[:2] != (stored, 2 * program.n):
            raise ValueError(f"variations have shape {ways.shape}")
        if "varied_by" in about:
            varied = tuple(x for x in np.atleast_1d(about["varied_by"]).tolist() if x)
    begun = None
    if "begun" in about:
        first, *numbers = map(float, about["begun"])
        if every or len(numbers) != 2 * program.n:
            raise ValueError(f"the start has {len(numbers)} numbers")
        begun = first, np.array(numbers).reshape(2, program.n)
    reduced = json.loads(str(about.get("reduced", "[]")))
    recorded = [
        (name.removeprefix(RECORDED), np.ascontiguousarray(dataset[name], dtype=np.float64))
        for name in map(str, dataset)
        if name.startswith(RECORDED)
    ]
    for name, rows in recorded:
        if name not in NAMED or rows.ndim != 2 or len(rows) != stored:
            raise ValueError(f"{name} is not recorded, or has shape {rows.shape}")
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
        driven=driven(inputs, begin, h, steps, ended) if every or ended is None else None,
        tau_values=tau if retimed else None,
        begun=begun,
        variations=ways,
        varied_by=varied,
        recorded_values=tuple(recorded),
        reduced_values=tuple((str(k), float(x)) for k, x in reduced),
        records=tuple(Record.read(entry) for entry in acted["records"]),
        event_names=tuple(acted["names"]),
        ended_by=acted["ended_by"],
        error_estimate=float(about["error_estimate"]) if "error_estimate" in about else None,
    )
