"""Kernels that differentiate a step, and the functions of the system that they call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import accumulate, starmap
from typing import Any

import sympy as sp

from symsimpson.discrete.reductions import Affine, Linear, Routh
from symsimpson.lower.expression import Expression
from symsimpson.lower.facts import solve_tables
from symsimpson.lower.ir import Function, Kernel, Row, Store, store_rows
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.specialise import kernel_from_text
from symsimpson.lower.storage import Border, Storage
from symsimpson.lower.traced_parts import TracedPart
from symsimpson.text.interface import WITH_PIVOTS

#: With more products than this, variations are solved for one by one.
MOST_TERMS = 4000

#: Blocks of derivatives by parameters, and the names of these in the jet.
_BLOCKS = (("NODE_F_A", "F_a"), ("NODE_P_A", "P_a"))
#: Second derivatives: the function, the block with its entries, and the tables of their variables.
_CURVATURES = {
    "node": ("node_curvature", "NODE_CURVATURE", "CURVATURE"),
    "point": ("point_curvature", "POINT_CURVATURE", "POINT"),
}
DOCS = {
    "parameter_slopes": "Derivatives of F and P by the parameters that are varied, at a node.",
    "constraint_parameter_slopes": (
        "Derivatives of phi and of Phi^T lambda by parameters, at a control point."
    ),
    "rate_parameter_slopes": (
        "Derivatives of A v - b by the parameters that are varied, at a point."
    ),
    "carried_parameter_slopes": "Derivatives of b by the parameters that are varied, at a point.",
    "cost_slopes": "The running cost and its derivatives, at a node.",
    "node_curvature": "Second derivatives of alpha.F + beta.P + gamma g at a node.",
    "point_curvature": "Second derivatives of nu.phi - alpha.Phi^T mu at a control point.",
}


def derivative_kernels(
    low: Lowering, storage: Storage, held: Border | None, facts: Mapping[str, object]
) -> tuple[list[Function], list[Kernel], dict[str, object]]:
    """Return the functions, kernels and tables that differentiate a step.

    The results are empty if nothing is varied. The kernels linearise the equations of the step at
    its solution. Reduced parts have the same solution, so the derivative does not depend on them.
    """
    if low.equations.varied is None:
        return [], [], {}
    places = storage.order
    stores = _parameter_stores(low, places) | _cost_stores(low, places) | _curvature_stores(low)
    functions = [
        Function(name, DOCS[name], low.statements(some, (Level.ITERATION,)))
        for name, some in stores.items()
    ]
    tables = _tables(low, storage, held)
    if facts["BY_COLUMNS"]:
        functions += _TracedEnd(low, facts, tables).functions()
    return functions, [*_kernels(facts)], tables


class _TracedEnd:
    """Traces the map of a variation to the end of a step, with inner control points eliminated.

    This takes fewer operations than computing all columns of the derivative.
    """

    def __init__(
        self, low: Lowering, facts: Mapping[str, object], tables: Mapping[str, object]
    ) -> None:
        self._low, scheme, d = low, low.equations.scheme, low.equations.scheme.degree
        routh, *_ = (*(x for x in low.equations.parts if isinstance(x, Routh)), None)
        self._cyclic = cyclic = () if routh is None else routh.cyclic
        self._order = [*(a for a in range(low.n) if a not in cyclic), *cyclic]
        rows, columns = ((*range(1, d + 1),),) * 2 if d > 1 else ((0,), (1,))
        tables = {
            **tables,
            **(solve_tables(routh, scheme) if routh is not None else {}),
            **_slope_tables(low, self._order),
            "OTHERS": low.n - len(cyclic),
            "BASIS": tuple((*row, sp.S.One) for row in scheme.A),
            "BASIS_SLOPE": tuple((*row, sp.S.Zero) for row in scheme.B),
            "ROW_ORDER": (*rows, d + 1),
            "COLUMN_ORDER": (*columns, d + 1),
            "EQUATION_STRIDE": (d + 1) * low.n + len(low.varied),
        }
        known = {**facts, "TRACED": True, "SYMMETRIC": d > 1 and not low.equations.plain.forces}
        if routh is not None:
            known |= {"CYCLIC": len(cyclic), "EXTRA": len(routh.annihilator)}
        names = ("cyclic_velocities", "differentiate_node", "condense", "move_end")
        blocks = sizes(low, by_columns=True)
        whole = low.with_jet(low.equations.jet)
        self._part = TracedPart(whole, self._order, names, known, tables, blocks, routh)

    def functions(self) -> tuple[Function, Function]:
        """Return the function that differentiates the end, and the one that moves a variation."""
        low = self._low
        self._condense()
        size, count = 2 * low.n, len(low.varied)
        units = ([int(k == j) for j in range(count)] for k in range(count))
        ends = [x for unit in units for x in self._move([0] * size, unit)]
        kept = [Store(Row("DERIVATIVE", k), value) for k, value in enumerate(ends)]
        rows = [Row("TANGENT", f"first + {k}") for k in range(size)]
        hints = [f"d{p}{q}" for p in ("", "p_") for q in low.names.coordinates]
        variation = [low.graph.fresh(hint, Level.LATE) for hint in hints]
        low.rows |= dict(zip(variation, rows, strict=True))
        moved = [Store(*x) for x in zip(rows, self._move(variation, [0] * count), strict=True)]
        opening, carried, _ = low.split_statements(
            kept, moved, lambda k: Row("DERIVATIVE", len(ends) + k)
        )
        doc = "Find what moves variations to the end of the step."
        first = Function("differentiate_end", doc, opening, ("W", "h", "t", "lane"))
        doc = "Carry a variation to the end of the step."
        return first, Function("move_variation", doc, carried, ("W", "h", "t", "first", "lane"))

    def _condense(self) -> None:
        """Differentiate all nodes, and eliminate the inner control points."""
        low, part, names = self._low, self._part, self._part.trace.names
        part.begin()
        if low.varies_h and not low.equations.plain.autonomous:
            part.set_rows("TIME_GRID", low.grid)
        names["parameter_slopes"] = self._set_parameter_slopes
        if self._cyclic:
            part.run("cyclic_velocities", low.h, low.t, 0)
        for node in range(low.equations.scheme.stages):
            part.run("differentiate_node", low.h, low.t, node)
        names["JACOBIAN"] = first = names["CONDENSED"]
        names["DEGREE"] += 1
        end, names["UNKNOWNS"] = names["UNKNOWNS"] - low.n, names["UNKNOWNS"] + low.n
        names["CONDENSED_END"] = first + end * (names["EQUATION_STRIDE"] + 1)
        part.run("condense", low.h)

    def _set_parameter_slopes(self, W: Any, lane: int) -> None:
        """Set the rows of the derivatives by parameters at the current node."""
        low, part, section = self._low, self._part, self._part.trace.section
        step = tuple(part.row("NODE_STEP", k) for k in range(3 * low.varies_h))
        here, entry = replace(part.point(moving=True), step=step), low.slopes.entry
        for block, what in _BLOCKS:
            entries = _nonzero_slopes(low, self._order, what)
            values = (partial(entry, here, section, what, self._order[s], by) for by, s in entries)
            part.set_rows(block, values)

    def _move(self, variation: Sequence[Any], parameters: Sequence[int]) -> list[Expression]:
        """Move a variation of the state and of parameters."""
        part, n, define = self._part, self._low.n, self._low.graph.define
        dq, dp = ([variation[first + a] for a in self._order] for first in (0, n))
        part.set_rows("TANGENT", (*dq, *parameters, *dp))
        part.run("move_end")
        places = [*map(self._order.index, range(n))]
        places += [n + len(parameters) + s for s in places]
        return [define("moved", part.row("TANGENT", k), "end of the step") for k in places]


def _kernels(facts: Mapping[str, object]) -> Iterable[Kernel]:
    """Yield the kernels of tangent and adjoint, of a running cost, and of second derivatives."""
    if facts["CANONICAL"]:
        names = ["tangent", "adjoint"]
        if facts["REGULAR"] and facts["VARIED_BY"]:
            names.append("momentum_slopes")
        if facts["REGULAR"]:
            names.append("start_adjoint")
        for name in names:
            yield replace(kernel_from_text(f"phase_{name}", facts), name=name)
        others = ["record", *(("step_cost", "running_cost") if facts["COSTED"] else ())]
        yield from (kernel_from_text(name, facts) for name in others)
        return
    tangent = kernel_from_text("tangent", facts)
    if facts["BY_COLUMNS"]:
        yield replace(tangent, straight=True)
        pivoted = kernel_from_text("tangent", {**facts, "BY_COLUMNS": False})
        yield replace(pivoted, name=f"tangent{WITH_PIVOTS}")
    else:
        yield tangent
    names = [
        *(("momentum_slopes",) if facts["VARIED_BY"] else ()),
        *("adjoint", "start_adjoint", "record"),
        *(("step_cost", "running_cost") if facts["COSTED"] else ()),
        *(("curvature",) if facts["SECOND"] else ()),
    ]
    yield from (kernel_from_text(name, facts) for name in names)


def _parameter_stores(low: Lowering, places: Sequence[int]) -> dict[str, list[Store]]:
    """Return the stores of derivatives by the varied parameters, for each function."""
    varied, plain, here = low.varied, low.equations.plain, low.node
    if not varied:
        return {}
    point = replace(here, suffix="c", multipliers=low.multipliers)

    def by_parameters(*kinds: tuple[str, str, Sequence[int]]) -> list[Store]:
        """Store derivatives, each kind with its block and the rows or constraints it has."""
        return [
            Store(Row(block, j * len(which) + k), low.slopes.entry(point, "slopes", what, c, name))
            for j, name in enumerate(varied)
            for block, what, which in kinds
            for k, c in enumerate(which)
        ]

    stores = {
        "parameter_slopes": [
            Store(Row(block, k), low.slopes.entry(here, "slopes", what, places[s], name))
            for block, what in _BLOCKS
            for k, (name, s) in enumerate(_nonzero_slopes(low, places, what))
        ]
    }
    count = range(len(low.multipliers))
    first, rolling = plain.first_side, range(len(plain.constraints), len(count))
    sides = range(first, len(count))
    if count:
        kinds = ("CONSTRAINT_A", "phi_a", count), ("CONSTRAINT_QA", "pull_a", places)
        stores["constraint_parameter_slopes"] = by_parameters(*kinds)
    if rolling:
        rates = by_parameters(("SLIP_A", "rate_a", rolling))
        rows = [j * len(sides) + c - first for j in range(len(varied)) for c in rolling]
        stores["rate_parameter_slopes"] = [
            replace(store, row=Row("SLIP_A", row)) for store, row in zip(rates, rows, strict=True)
        ]
    if plain.carried:
        stores["carried_parameter_slopes"] = by_parameters(("SLIP_A", "b_a", sides))
    return stores


def _cost_stores(low: Lowering, places: Sequence[int]) -> dict[str, list[Store]]:
    """Return the stores of a running cost and its derivatives, if there is a cost."""
    if low.equations.cost is None:
        return {}
    keys: list[tuple[str, *tuple[int | str, ...]]] = [("g",)]
    keys += [(what, a) for what in ("g_q", "g_v") for a in places]
    keys += [("g_a", name) for name in low.varied]
    here = low.node
    values = (low.cost.entry(here, "cost", *key) for key in keys)
    return {"cost_slopes": store_rows("NODE_COST", values)}


def _curvature_stores(low: Lowering) -> dict[str, list[Store]]:
    """Return the stores of second derivatives at a node, and at a control point for constraints."""
    here, stores = low.node, {}
    v = tuple(low.step[0] * v for v in here.v or ())
    t = here.t - low.step[1] * low.step[0] if low.varies_h and here.t is not None else here.t
    for what, (name, block, _) in _CURVATURES.items() if low.equations.second else ():
        if what == "point" and not low.multipliers:
            continue
        point = replace(
            here, suffix=what, v=v, t=t, weights=low.weights, multipliers=low.multipliers
        )
        entry = partial(low.curvatures.entry, point, "curvatures", what)
        stores[name] = store_rows(block, starmap(entry, low.curvatures.places(what)))
    return stores


def _tables(low: Lowering, storage: Storage, held: Border | None) -> dict[str, object]:
    """Return the tables that the loops over derivatives read."""
    whole, degree = held.storage if held else storage, low.equations.scheme.degree
    constants = {**whole.constants("TANGENT", degree), **whole.bounds("TANGENT", degree)}
    if low.equations.plain.hamiltonian is not None:
        whole, degree = Storage.dense(low.n), 2 * degree  # y and g at all nodes
        constants = {**whole.constants("TANGENT", degree), **whole.bounds("TANGENT", degree)}
    tables = {
        "VARIED": len(low.varied),
        **{key: constants[key] for key in constants if not key.endswith("_STEP")},
        "TANGENT_UNKNOWNS": whole.unknowns(degree),
    }
    tables |= _slope_tables(low, storage.order)
    if not low.equations.second:
        return tables
    count = len(low.multipliers)
    first = (degree + 1) * low.n + degree * count
    tables["VARIED_FROM"] = first
    tables["HESSIAN_SIZE"] = first + len(low.varied) * low.equations.scheme.stages
    for what, (_, _, prefix) in _CURVATURES.items():
        pairs = low.curvatures.places(what)
        if what == "node" or count:
            tables[f"{prefix}_ROW"] = tuple(i for i, _ in pairs)
            tables[f"{prefix}_COLUMN"] = tuple(j for _, j in pairs)
    return tables


def _slope_tables(low: Lowering, places: Sequence[int]) -> dict[str, object]:
    """Return the rows of the derivatives of F and P by parameters that are not zero.

    The derivatives by one parameter are adjacent. A table lists the places of their coordinates.
    """
    tables: dict[str, object] = {}
    for block, what in _BLOCKS if low.varied else ():
        rows, name = _nonzero_slopes(low, places, what), block.removeprefix("NODE_")
        counts = (sum(parameter == varied for parameter, _ in rows) for varied in low.varied)
        tables[f"{name}_FROM"] = (0, *accumulate(counts))
        tables[f"{name}_PLACE"] = (*(s for _, s in rows), 0)
    return tables


def traces_end(low: Lowering) -> bool:
    """Return whether the derivative of a small step is traced."""
    equations = low.equations
    n, size, stages = low.n, equations.unknowns.size, equations.scheme.stages
    columns = 2 * n + len(low.varied)
    few = columns * (size**2 + 2 * stages * n**2) + size**3 / 3 <= MOST_TERMS
    # the derivatives of linear equations do not depend on the path
    linear = () if low.varied else (Affine, Linear)
    known = all(part.columns or isinstance(part, linear) for part in equations.parts)
    alone = sum(isinstance(part, Routh) for part in equations.parts) < 2
    return few and known and alone and not equations.plain.constraint_names


def sizes(low: Lowering, *, by_columns: bool) -> dict[str, Any]:
    """Return the numbers that set the sizes of blocks for derivatives of a step."""
    if low.equations.varied is None:
        return {}
    slopes = [1 + len(_nonzero_slopes(low, range(low.n), what)) for _, what in _BLOCKS]
    places = [len(low.curvatures.places(x)) if low.equations.second else 0 for x in _CURVATURES]
    return {
        **dict(zip(("f_slopes", "p_slopes"), slopes, strict=True)),
        **dict(zip(("curvatures", "point_curvatures"), places, strict=True)),
        "differentiated": True,
        "by_columns": by_columns,
        "costly": low.equations.cost is not None,
        "second": low.equations.second,
        "sized": low.varies_h,
        "varied": len(low.varied),
    }


def _nonzero_slopes(low: Lowering, places: Sequence[int], what: str) -> list[tuple[str, int]]:
    """List the derivatives that do not vanish, each by its parameter and place."""
    return [
        (name, s)
        for name in low.varied
        for s, a in enumerate(places)
        if not low.slopes.vanishes(what, a, name)
    ]
