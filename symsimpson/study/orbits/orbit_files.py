"""Files of families of orbits."""

from __future__ import annotations

import json
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from symsimpson.errors import StorageError
from symsimpson.study.orbits.find import OrbitArguments, read_search
from symsimpson.study.orbits.orbit import Family
from symsimpson.study.orbits.outcome import FamilyStatus
from symsimpson.study.orbits.shooting import Solution
from symsimpson.support.files import read_path


def save_family(family: Family, path: Any) -> None:
    """Write a family to a file; see :meth:`Family.save`."""
    place = FilePath(read_path("path", path)).with_suffix(".npz")
    orbits, search = family.orbits, family.search
    about = {
        "digest": search.stepper.program.header.digest,
        "scheme": search.stepper.scheme,
        "parameter": family.parameter,
        "status": int(family.status),
        "steps": [x.search.flow.steps for x in orbits],
        "unknowns": [dict(x.unknowns) for x in orbits],
    }
    try:
        np.savez(
            place,
            about=json.dumps(about),
            q=[x.q0 for x in orbits],
            p=[x.p0 for x in orbits],
            period=[x.period for x in orbits],
            values=[x.values for x in orbits],
            tangents=np.array(family.tangents),
        )
    except OSError as error:
        raise StorageError(f"the family cannot be written to {place}: {error}") from error


def open_family(stepper: Any, tools: Any, path: Any) -> Family:
    """Read a family from a file; see :meth:`Stepper.open_family`."""
    place = FilePath(read_path("path", path))
    place = place if place.suffix == ".npz" else place.with_suffix(".npz")
    try:
        with np.load(place, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            q, p, period, values, tangents = (
                np.asarray(file[x], dtype=np.float64)
                for x in ("q", "p", "period", "values", "tangents")
            )
    except (OSError, ValueError, KeyError) as error:
        raise StorageError(f"{place} has no family of orbits: {error}") from error
    if (about["digest"], about["scheme"]) != (stepper.program.header.digest, stepper.scheme):
        raise StorageError(f"{place} belongs to another system or scheme than this stepper.")
    orbits, integrals = [], None
    parameter = str(about["parameter"])
    names = [*about["unknowns"][0]]
    if parameter in stepper.parameters and parameter not in names:
        names.append(parameter)
    for k in range(len(q)):
        known = dict(zip(stepper.parameters, values[k].tolist(), strict=True))
        given = OrbitArguments(
            q[k],
            None,
            p[k],
            period=float(period[k]),
            steps=int(about["steps"][k]),
            unknowns=tuple(names),
            parameters=known,
        )
        search, point = read_search(stepper, given, tools, integrals)
        integrals = search.shooting.integrals
        orbits.append(search.orbit(Solution(search.shooting.sweep(point), True, ())))
    status = FamilyStatus(int(about["status"]))
    return Family(tuple(orbits), parameter, status, tuple(tangents), orbits[0].search)
