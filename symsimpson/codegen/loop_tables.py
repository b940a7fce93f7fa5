"""Tables by which loops go over equations, unknowns, nodes and control points."""

from __future__ import annotations

import sympy as sp

from symsimpson.codegen.constraint_order import Held
from symsimpson.codegen.storage import Storage
from symsimpson.discrete.combined_rows import force_factor, inertia_factor, simplified
from symsimpson.discrete.reductions import Constrained, Coupled, Separable
from symsimpson.schemes.scheme import Scheme

__all__ = ["equation_constants", "solve_constants", "solve_tables"]


def equation_constants(storage: Storage, degree: int, held: Held | None) -> dict[str, object]:
    """Return what loops over the entries of all equations must know."""
    # what nodes contribute stands behind the matrix of all unknowns
    before = held.storage.size(degree) if held else 0
    return {**storage.constants("EQUATION", degree, before)}


def solve_constants(
    storage: Storage, columns: tuple[int, ...], held: Held | None = None
) -> dict[str, object]:
    """Return what elimination must know of the unknowns that it finds: these control points."""
    blocks = len(columns)
    if held:
        every, constants = held.storage, storage.constants("SOLVE", blocks)
        steps = {key: constants[key] for key in ("SOLVE_ROW_STEP", "SOLVE_PLACE_STEP")}
        return {**solve_constants(every, columns), **steps, **held.constants(blocks)}
    return {
        "BLOCKS": blocks,
        "SOLVE_COLUMNS": columns,
        "SOLVE_UNKNOWNS": storage.unknowns(blocks),
        **storage.constants("SOLVE", blocks),
        **storage.bounds("SOLVE", blocks),
    }


def solve_tables(part: Constrained | Coupled | Separable, scheme: Scheme) -> dict[str, object]:
    """Return the tables by which the loops combine nodes and control points."""
    if isinstance(part, Constrained):
        points = range(scheme.degree + 1)
        rows = (*(part.rows.index(k) if k in part.rows else -1 for k in points),)
        columns = (*(part.columns.index(k) if k in part.columns else -1 for k in points),)
        return {"ROW_OF_POINT": rows, "COLUMN_OF_POINT": columns}
    if isinstance(part, Coupled):
        return {}
    S, d, nodes = scheme.stiffness, scheme.degree, range(scheme.stages)
    forces = tuple(tuple(force_factor(test, scheme, i) for test in part.tests) for i in nodes)
    tables: dict[str, object] = {
        "TEST_START": tuple(test[0] for test in part.tests),
        "TEST_STIFFNESS": tuple(
            tuple(inertia_factor(test, scheme, m) for m in part.columns) for test in part.tests
        ),
        "TEST_ROWS": tuple(
            tuple(
                simplified(x - test[0] * (1 - c)) for x, c in zip(test, scheme.points, strict=True)
            )
            for test in part.tests
        ),
        "STIFFNESS": tuple(row[1:d] for row in S[1:d]) or ((sp.S.Zero,),),
        "TEST_FORCE": forces,
        "FORCE_NODES": tuple(i for i in nodes if any(factor != 0 for factor in forces[i])),
    }
    if part.last is not None:
        test = part.last_test(d)
        scale = simplified(-1 / S[part.last][d]) if part.last else sp.S.One
        tables |= {
            "LAST_START": test[0],
            "LAST_SCALE": scale,
            "LAST": part.last,
            "LAST_NODES": tuple(i for i in nodes if force_factor(test, scheme, i) != 0),
        }
    return tables
