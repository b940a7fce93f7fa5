"""Facts for conditions, tables for loops and sizes of blocks of a module."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import sympy as sp

from symsimpson.discrete.combined_rows import force_factor, inertia_factor, rationalise
from symsimpson.discrete.reductions import Composed, Constrained, Part, Routh, Separable
from symsimpson.lower.forms import has_drifts
from symsimpson.lower.lower import Lowering
from symsimpson.lower.storage import Border, Storage, node_stride
from symsimpson.schemes.scheme import Scheme
from symsimpson.text.table import Sizes


def facts(low: Lowering, part: Part, storage: Storage, held: Border | None) -> dict[str, object]:
    """Return the facts of a module that solves for a part, for an M that is not constant."""
    equations, plain = low.equations, low.equations.plain
    follows = isinstance(part, Separable) and part.last is not None
    return {
        "AUTONOMOUS": plain.autonomous,
        "DRIVEN": bool(plain.u),
        "TIMED": bool(plain.u) or not plain.autonomous,
        "ALIKE": plain.autonomous and not plain.u,
        "DRAGGED": plain.dragged,
        "DAMPED": plain.rate is not None,
        "HOLONOMIC": len(plain.constraints),
        "CARRIED": plain.carried,
        "MOVING": plain.moving,
        "FIRST_SIDE": plain.first_side,
        "GYROSCOPIC": equations.system.structure.gyroscopic,
        "LOOKED_AT": equations.needs_path,
        "DIFFERENTIATED": equations.varied is not None,
        "VARIED_BY": len(low.varied),
        "SIZED": low.varies_h,
        "GRIDDED": low.varies_h and not plain.autonomous,
        "COSTED": equations.cost is not None,
        "TIMED_COST": plain.autonomous and cost_of_time(low),
        "SECOND": equations.second,
        "CYCLIC": len(part.cyclic) if isinstance(part, Routh) else 0,
        "EXTRA": len(part.annihilator) if isinstance(part, Routh) else 0,
        "SEPARABLE": isinstance(part, Separable),
        "FOLLOWS": follows and bool(part.columns),
        "STRAIGHT_PATH": follows and not part.columns,
        "COMPOSED": isinstance(part, Composed),
        "ITERATED": bool(part.columns),
        "FOLLOWING": False,
        "TRACED": False,
        "PAIRED": False,
        "CANONICAL": plain.hamiltonian is not None,
        "ONE_NODE": equations.scheme.stages == 1,
        "QUADRATIC_L": plain.quadratic,
        "DEFINITE": plain.definite and plain.hamiltonian is None,
        "HELD": held is not None,
        "ROLLING": held is not None and held.velocities > 0,
        "CONSTANT_MASS": False,
        "PIVOTS": True,
        # elimination in a band exchanges rows
        "NEWTON_IN_ORDER": bool(plain.velocity_constraints)
        and not (low.singular_mass or storage.banded),
        "IN_PAIRS": False,
        "CLEARED": cleared_rows(storage, equations.scheme.degree, held),
        "WEIGHTED": True,
    }


def cost_of_time(low: Lowering) -> bool:
    """Return whether a running cost depends on the time."""
    cost, plain = low.equations.cost, low.equations.plain
    return cost is not None and cost.depends(plain.t)


def node_tables(scheme: Scheme) -> dict[str, object]:
    """Return the control point at each node, or 0, and whether its place is exact."""
    nodes = scheme.quadrature.nodes
    if not scheme.exact:
        return {"AT_POINT": (0,) * len(nodes), "EXACT_PLACE": (0,) * len(nodes)}
    at = [_control_point(row) for row in scheme.A]
    exact = [int(c.is_Rational and c.q & (c.q - 1) == 0) for c in nodes]
    # the points of velocity constraints follow the nodes
    return {"AT_POINT": (*at, *[0] * scheme.degree), "EXACT_PLACE": (*exact,)}


def _control_point(row: Sequence[sp.Expr]) -> int:
    """Return the control point at a node; 0 if there is none, or for q0."""
    places = [k for k, x in enumerate(row) if x != 0]
    return places[0] if len(places) == 1 and row[places[0]] == 1 else 0


def equation_constants(storage: Storage, degree: int, held: Border | None) -> dict[str, object]:
    """Return the strides of the matrix of all equations."""
    # the matrix of the nodes follows the matrix of all unknowns
    before = held.storage.size(degree) if held else 0
    constants = storage.constants("EQUATION", degree, before)
    return {**constants, "CLEARED": cleared_rows(storage, degree, held)}


def cleared_rows(storage: Storage, degree: int, held: Border | None) -> int:
    """Count the rows of the matrix of all unknowns that must be cleared first."""
    whole = held.storage if held else storage
    return whole.size(degree) if held or storage.banded else 0


def solve_constants(
    storage: Storage, columns: tuple[int, ...], held: Border | None = None
) -> dict[str, object]:
    """Return the tables of an elimination for the unknowns of these control points."""
    blocks = len(columns)
    if held:
        every, constants = held.storage, storage.constants("SOLVE", blocks)
        steps = {key: constants[key] for key in ("SOLVE_ROW_STEP", "SOLVE_PLACE_STEP")}
        steps["SOLVE_COORDINATES"] = storage.n  # elimination takes constraints besides
        return {**solve_constants(every, columns), **steps, **held.constants(blocks)}
    return {
        "BLOCKS": blocks,
        "SOLVE_COLUMNS": columns,
        "SOLVE_UNKNOWNS": storage.unknowns(blocks),
        "SOLVE_COORDINATES": storage.n,
        **storage.constants("SOLVE", blocks),
        **storage.bounds("SOLVE", blocks),
    }


def _cyclic_tables(part: Routh, scheme: Scheme) -> dict[str, object]:
    """Return the tables by which loops find velocities and increments of cyclic coordinates.

    Velocities are polynomials, found from their values at the last nodes.
    """
    d, c = scheme.degree, scheme.quadrature.nodes
    used = range(scheme.stages - d, scheme.stages)
    inverse = sp.Matrix([scheme.B[i][1:] for i in used]).inv()
    unused = [sp.S.Zero] * (scheme.stages - d)
    at_end = [prod((1 - c[j]) / (c[i] - c[j]) for j in used if j != i) for i in used]
    ends = scheme.A[-1][d] == 1 and not any(scheme.A[-1][:d])
    return {
        "OTHERS": len(part.coordinates),
        "CYCLIC": len(part.cyclic),
        "EXTRA": len(part.annihilator),
        "REFERENCE": part.reference,
        "SEEN": scheme.stages + (0 if ends else 2),
        "ANNIHILATOR": part.annihilator or ((sp.S.Zero,),),
        "REACHED_BY": tuple((*unused, *map(rationalise, inverse.row(k))) for k in range(d)),
        "AT_END": (*unused, *map(rationalise, at_end)),
        "CYCLIC_MOVING": (*map(int, part.factors.changing),),
        "SOLVE_COORDINATES": len(part.coordinates),
        "SOLVE_UNKNOWNS": len(part.coordinates) * d,
        "SOLVE_ROW_STEP": len(part.coordinates),
        "SOLVE_STRIDE": len(part.coordinates) * d,
    }


def solve_tables(part: Part, scheme: Scheme) -> dict[str, object]:
    """Return the tables that combine nodes and control points."""
    if isinstance(part, Routh):
        return _cyclic_tables(part, scheme)
    if isinstance(part, Constrained):
        points = range(scheme.degree + 1)
        rows = (*(part.rows.index(k) if k in part.rows else -1 for k in points),)
        columns = (*(part.columns.index(k) if k in part.columns else -1 for k in points),)
        return {"ROW_OF_POINT": rows, "COLUMN_OF_POINT": columns}
    if not isinstance(part, Separable):
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
                rationalise(x - test[0] * (1 - c)) for x, c in zip(test, scheme.points, strict=True)
            )
            for test in part.tests
        ),
        "STIFFNESS": tuple(row[1:d] for row in S[1:d]) or ((sp.S.Zero,),),
        "TEST_FORCE": forces,
    }
    tests = part.tests
    if part.last is not None:
        last = part.last_test(d)
        tests = (*tests, last)
        if part.columns:
            scale = rationalise(-1 / S[part.last][d])
            tables |= {
                "LAST": part.last,
                "LAST_SCALE": scale,
                "LAST_MOVED": tuple(rationalise(scale * S[part.last][m]) for m in part.columns),
                "LAST_FORCE": tuple(force_factor(last, scheme, i) for i in nodes),
            }
    pulled = (any(force_factor(test, scheme, i) != 0 for test in tests) for i in nodes)
    tables["FORCE_NODES"] = tuple(i for i, asked in enumerate(pulled) if asked)
    return tables


def common_sizes(low: Lowering, held: Border | None, routh: Routh | None) -> dict[str, Any]:
    """Return the sizes that modules and traces share."""
    equations = low.equations
    return {
        "parameters": len(low.names.parameters),
        "inputs": len(low.names.inputs),
        "powers": len(equations.plain.powers),
        "degree": equations.scheme.degree,
        "nodes": equations.scheme.stages,
        "m": held.count if held else 0,
        "rolling": held.velocities if held else 0,
        "sides": held.count - equations.plain.first_side if held else 0,
        "constrained": held is not None,
        "carried": equations.plain.carried,
        "stride": node_stride(equations),
        "cyclic": len(routh.cyclic) if routh else 0,
        "cyclic_multipliers": routh.multipliers if routh else 0,
    }


def sizes(
    low: Lowering,
    known: Mapping[str, object],
    storage: Storage,
    held: Border | None,
    routh: Routh | None,
    **more: Any,
) -> Sizes:
    """Return the numbers that set the sizes of all blocks; ``more`` has further ones."""
    plain, unknowns = low.equations.plain, low.equations.unknowns
    looped = low.equations.varied is not None or not known["IN_PAIRS"]
    retimed = low.equations.system.retiming is not None
    bordered = () if held is None else (held.storage,)
    jacobian = [part.size(unknowns.control_points) for part in (storage, *bordered)]
    canonical = plain.hamiltonian is not None
    if canonical:
        jacobian = [unknowns.size**2]
    return Sizes(
        n=low.n,
        invariants=len(low.names.invariants),
        unknowns=unknowns.size,
        entries=storage.node_size,
        bordered=sum(part.node_size for part in bordered),
        jacobian=sum(jacobian),
        hoisted=len(low.hoisted),
        coefficients=len(low.coefficients),
        pivots=len(low.scales),
        by_nodes=looped or bool(plain.powers) or retimed or not plain.quadratic,
        assembled=bool(low.equations.rows) and looped,
        constant_mass=bool(known["CONSTANT_MASS"]),
        dragged=plain.dragged,
        decaying=bool(known.get("FRICTION")),
        timed=not plain.autonomous or cost_of_time(low),
        damped=plain.rate is not None,
        drifting=has_drifts(low.equations),
        retimed=retimed,
        indefinite=not plain.definite,
        inverted=canonical or not plain.quadratic,
        canonical=canonical,
        **common_sizes(low, held, routh),
        **more,
    )
