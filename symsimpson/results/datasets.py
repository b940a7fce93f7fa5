"""The dataset of a trajectory for files, and its digest."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np

from symsimpson.results.states import FinishedRun

#: Prefix of the names of recorded sums in files.
RECORDED = "recorded_"
#: Name of the records of events in files.
EVENTS = "acted"


def trajectory_dataset(run: FinishedRun) -> Any:
    """Return an ``xarray.Dataset`` from which :func:`open_trajectory` rebuilds the trajectory."""
    dataset = run.to_xarray()
    text = np.frombuffer(run.program.source.encode(), dtype=np.uint8)  # long, for an attribute
    dataset["module"] = (("byte",), text, {"long_name": "the generated module, a text in UTF-8"})
    if run.event_names:
        text = np.frombuffer(_events_as_json(run).encode(), dtype=np.uint8)
        dataset[EVENTS] = (("byte_of_events",), text, {"long_name": "records of events, JSON"})
    if run.input_values.size:
        about = {"long_name": "inputs of steps, at their nodes"}
        dataset["inputs"] = (("step", "node", "input"), run.input_values[0], about)
    if run.begun is not None:
        dataset.attrs["begun"] = [float(run.begun[0]), *run.begun[1].ravel().tolist()]
    dataset.attrs |= {
        "every": run.every or 0,
        "parameter_values": run.parameter_values.tolist(),
        "sha256": trajectory_digest(run),
    }
    for name, rows in run.recorded_values:
        dataset[f"{RECORDED}{name}"] = (("time", f"{name}_number"), rows)
    if users := run.program.names.users:
        dataset.attrs["names"] = json.dumps(users)
    if run.reduced_values:
        dataset.attrs["reduced"] = json.dumps(run.reduced_values)
    if run.variations is not None:
        about = {"long_name": "variations of the state, then of what is varied"}
        dataset["variations"] = (("time", "state", "variation"), run.variations, about)
        if run.varied_by is not None:
            dataset.attrs["varied_by"] = list(run.varied_by) or [""]
    return dataset


def _events_as_json(run: FinishedRun) -> str:
    """Return the records of events as JSON."""
    records = [x.as_json for x in run.records]
    about = {"names": run.event_names, "ended_by": run.ended_by, "records": records}
    return json.dumps(about | ({} if run.history is None else {"modes": run.history.as_json()}))


def trajectory_digest(run: FinishedRun) -> str:
    """Return the SHA-256 digest of the arrays, the settings and the module of a trajectory."""
    reduced = (run.reduced_values,) if run.reduced_values else ()
    outcome = run.status.name, run.message, run.program.source
    acted = (_events_as_json(run),) if run.event_names else ()
    users = run.program.names.users
    named = (json.dumps(users),) if users else ()
    estimate = () if run.error_estimate is None else (float(run.error_estimate),)
    about = (float(run.h), run.steps, run.every, *outcome, *reduced, *acted, *named, *estimate)
    content = hashlib.sha256(repr(about).encode())
    tau = () if run.tau_values is None else (run.tau_values,)
    beside = [] if run.variations is None else [run.variations]
    beside += [] if run.begun is None else [np.array(run.begun[0]), run.begun[1]]
    beside += [rows for _, rows in run.recorded_values]
    states = run.t, run.q, run.p
    arrays = run.parameter_values, run.newton_iterations, run.input_values, *tau, *beside
    for array in (*states, *arrays):
        content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()
