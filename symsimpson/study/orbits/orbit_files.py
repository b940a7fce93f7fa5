"""Files of families of orbits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import StorageError, reject
from symsimpson.study.orbits.find import OrbitArguments, read_search
from symsimpson.study.orbits.orbit import Family
from symsimpson.study.orbits.outcome import FamilyStatus
from symsimpson.study.orbits.shooting import Solution
from symsimpson.support.array_files import read_arrays, write_arrays
from symsimpson.support.names import read_mapping, spelled

#: Arguments of a search that a file cannot contain.
SYMBOLIC = ("fixed", "middle", "conditions", "events", "period")
KINDS = {
    **{"digest": str, "scheme": str, "parameter": str, "unknowns": list, "given": list},
    **{"status": FamilyStatus.__getitem__, "steps": list, "t0": float, "h": float},
}
SIZES = {"q": 2, "p": 2, "period": 1, "values": 2, "extra": 2, "tangents": 2}


def save_family(family: Family, path: Any) -> None:
    """Write a family to a file; see :meth:`Family.save`."""
    orbits, search = family.orbits, family.search
    given = [name for name in SYMBOLIC if getattr(search.given, name)]
    if search.flow.period_of is None and "period" in given:  # a number
        given.remove("period")
    saved = {
        "digest": search.stepper.program.header.digest,
        "scheme": search.stepper.scheme,
        "parameter": family.parameter,
        "status": family.status.name,
        "steps": [x.steps for x in orbits],
        "unknowns": [*orbits[0].unknowns],
        "given": given,
        "t0": float(search.flow.spec.t0),
        "h": float(search.flow.spec.h),
    }
    arrays = {
        "q": [x.q0 for x in orbits],
        "p": [x.p0 for x in orbits],
        "period": [x.period for x in orbits],
        "values": [x.values for x in orbits],
        "extra": [search.extra(x) for x in orbits],
        "tangents": family.tangents,
    }
    write_arrays(path, "family", saved, {name: np.array(x) for name, x in arrays.items()})


def open_family(tools: Any, stepper: Any, path: Any, **given: Any) -> Family:
    """Read a family from a file; see :meth:`Stepper.open_family`."""
    place, saved, arrays = read_arrays(path, "family", KINDS, SIZES)
    q, p, period, values, extra, tangents = arrays
    header = stepper.program.header
    if (saved["digest"], saved["scheme"]) != (header.digest, stepper.scheme):
        reject(
            "the family belongs to another system or scheme than this stepper.",
            where=str(place),
            remedy=f"Compile the same system with scheme={saved['scheme']!r}.",
            error=StorageError,
        )
    shape = (len(period), stepper.n)
    whole = q.shape == p.shape == shape and values.shape == (shape[0], len(stepper.parameters))
    if not whole or not len(extra) == len(tangents) == len(saved["steps"]) == shape[0] > 0:
        reject(
            "the file is damaged: its arrays do not match.", where=str(place), error=StorageError
        )
    fixed = {k: v for k, v in (given["fixed"] or {}).items() if spelled(k) != saved["parameter"]}
    given = {**given, "fixed": fixed}
    none = "no symbolic arguments"
    needed = ", ".join(f"{x}=" for x in saved["given"]) or none
    passed = ", ".join(f"{x}=" for x in SYMBOLIC if given[x]) or none
    if passed != needed:
        reject(
            f"the family was found with {needed}, and you passed {passed}.",
            where=str(place),
            why="The file contains numbers only.",
            remedy="Pass the same arguments as to periodic.",
        )
    conditions = read_mapping("conditions", given["conditions"], stepper.coordinates[0])
    symbols = {str(x): x for y in conditions.values() for x in getattr(y, "free_symbols", ())}
    orbits, integrals = [], None
    for k in range(shape[0]):
        parameters = dict(zip(stepper.parameters, values[k].tolist(), strict=True))
        arguments = OrbitArguments(
            q0=q[k],
            p0=p[k],
            steps=int(saved["steps"][k]),
            h=saved["h"],
            t0=saved["t0"],
            unknowns=tuple(symbols.get(x, x) for x in saved["unknowns"]),
            parameters={x: parameters[x] for x in parameters if x not in header.from_start},
            **{**given, "period": given["period"] or float(period[k])},
        )
        search, point = read_search(stepper, arguments, tools, integrals)
        integrals = search.shooting.integrals
        sweep = search.shooting.sweep(replace(point, extra=extra[k]))
        orbits.append(search.orbit(Solution(sweep, True, ())))
    course = saved["parameter"], saved["status"], tuple(tangents)
    return Family(tuple(orbits), *course, orbits[-1].search)
