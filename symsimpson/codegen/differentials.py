"""Kernels that differentiate a step, with the functions of the system that they call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import accumulate, starmap
from typing import Any

from symsimpson.codegen.ir import Function, Kernel, Row, Store, stored
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.specialise import kernel_from_text
from symsimpson.codegen.storage import LoopKernels
from symsimpson.codegen.traced_parts import TracedPart
from symsimpson.module.interface import WITH_PIVOTS

#: With more products than this, variations are solved for one by one.
MOST_TERMS = 4000

#: Derivatives by parameters, and where they stand.
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


def differentiating(
    low: Lowering, loops: LoopKernels, facts: Mapping[str, object]
) -> tuple[list[Function], list[Kernel], dict[str, object]]:
    """Return the functions, kernels and tables that differentiate a step, if that is wanted.

    They solve the equations of the step, linearised at the solution: this is the derivative of
    whatever solved the step, as reduced parts have the same solution.
    """
    if low.equations.varied is None:
        return [], [], {}
    places = loops.storage.order
    stores = _slopes(low, places) | _cost(low, places) | _curvatures(low)
    functions = [
        Function(name, DOCS[name], low.statements(some, (Level.ITERATION,)))
        for name, some in stores.items()
    ]
    tables = _tables(low, loops)
    if facts["BY_COLUMNS"]:
        functions.append(_derivative(low, facts, tables))
    return functions, [*_kernels(facts)], tables


def _derivative(
    low: Lowering, facts: Mapping[str, object], tables: Mapping[str, object]
) -> Function:
    """Return the derivative of a step as a whole, written out."""
    name, every = "find_derivative", range(low.n)
    whole = low.of_all(low.equations.jet)
    known = {**facts, "TRACED": True}
    part = TracedPart(whole, every, [name], known, tables, sizes(low, by_columns=True))
    part.begin()

    def slopes(W: Any, lane: int) -> None:
        here, section = part.point(moving=True), part.trace.section
        here = replace(here, step=tuple(part.row("NODE_STEP", k) for k in range(3 * low.sized)))
        for block, what in _BLOCKS:
            entries = _not_zero(low, every, what)
            part.hold(
                block, (partial(low.slopes.entry, here, section, what, s, by) for by, s in entries)
            )

    part.trace.names["parameter_slopes"] = slopes
    part.run_step(name)
    size = 2 * low.n * (2 * low.n + len(low.varied))
    values = part.named("DERIVATIVE", size, section="derivative")
    doc = "Find the derivative of a step, column by column."
    lines = low.statements(stored("DERIVATIVE", values), (Level.STEP, Level.ITERATION))
    return Function(name, doc, lines, ("W", "h", "t", "lane"))


def _kernels(facts: Mapping[str, object]) -> Iterable[Kernel]:
    """Yield the kernels of tangent and adjoint, of a running cost, and of second derivatives."""
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


def _slopes(low: Lowering, places: Sequence[int]) -> dict[str, list[Store]]:
    """Return the derivatives by the parameters that are varied, which functions evaluate."""
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
            for k, (name, s) in enumerate(_not_zero(low, places, what))
        ]
    }
    count = range(len(low.multipliers))
    rolling = range(len(plain.constraints), len(plain.held))
    if count:
        kinds = ("CONSTRAINT_A", "phi_a", count), ("CONSTRAINT_QA", "pull_a", places)
        stores["constraint_parameter_slopes"] = by_parameters(*kinds)
    if rolling:
        stores["rate_parameter_slopes"] = by_parameters(("RATE_A", "rate_a", rolling))
    if plain.carried:
        stores["carried_parameter_slopes"] = by_parameters(("RATE_A", "b_a", rolling))
    return stores


def _cost(low: Lowering, places: Sequence[int]) -> dict[str, list[Store]]:
    """Return a running cost and its derivatives, if there is one."""
    if low.equations.cost is None:
        return {}
    keys: list[tuple[str, *tuple[int | str, ...]]] = [("g",)]
    keys += [(what, a) for what in ("g_q", "g_v") for a in places]
    keys += [("g_a", name) for name in low.varied]
    here = low.node
    values = (low.cost.entry(here, "cost", *key) for key in keys)
    return {"cost_slopes": stored("NODE_COST", values)}


def _curvatures(low: Lowering) -> dict[str, list[Store]]:
    """Return the second derivatives at a node, and at a control point if there are constraints."""
    here, stores = low.node, {}
    v = tuple(low.step[0] * v for v in here.v or ())
    t = here.t - low.step[1] * low.step[0] if low.sized and here.t is not None else here.t
    for what, (name, block, _) in _CURVATURES.items() if low.equations.second else ():
        if what == "point" and not low.multipliers:
            continue
        point = replace(
            here, suffix=what, v=v, t=t, weights=low.weights, multipliers=low.multipliers
        )
        entry = partial(low.curvatures.entry, point, "curvatures", what)
        stores[name] = stored(block, starmap(entry, low.curvatures.places(what)))
    return stores


def _tables(low: Lowering, loops: LoopKernels) -> dict[str, object]:
    """Return what the loops must know.

    Those derivatives of F and P by a parameter that are not zero stand one after the other; their
    coordinates are given by place.
    """
    storage, degree = (loops.held or loops).storage, loops.degree
    constants = {**storage.constants("TANGENT", degree), **storage.bounds("TANGENT", degree)}
    tables = {
        "VARIED": len(low.varied),
        **{key: constants[key] for key in constants if not key.endswith("_STEP")},
        "TANGENT_UNKNOWNS": storage.unknowns(degree),
    }
    for block, what in _BLOCKS if low.varied else ():
        rows, name = _not_zero(low, loops.storage.order, what), block.removeprefix("NODE_")
        counts = (sum(parameter == varied for parameter, _ in rows) for varied in low.varied)
        tables[f"{name}_FROM"] = (0, *accumulate(counts))
        tables[f"{name}_PLACE"] = (*(s for _, s in rows), 0)
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


def few_columns(low: Lowering) -> bool:
    """Return whether the derivative of a step is worth to be computed as a whole."""
    n, size, stages = low.n, low.equations.unknowns.size, low.equations.scheme.stages
    columns = 2 * n + len(low.varied)
    return columns * (size**2 + 2 * stages * n**2) + size**3 / 3 <= MOST_TERMS


def sizes(low: Lowering, *, by_columns: bool) -> dict[str, Any]:
    """Return numbers that the sizes of what derivatives of a step have follow from."""
    if low.equations.varied is None:
        return {}
    slopes = [1 + len(_not_zero(low, range(low.n), what)) for _, what in _BLOCKS]
    places = [len(low.curvatures.places(x)) if low.equations.second else 0 for x in _CURVATURES]
    return {
        **dict(zip(("f_slopes", "p_slopes"), slopes, strict=True)),
        **dict(zip(("curvatures", "point_curvatures"), places, strict=True)),
        "differentiated": True,
        "by_columns": by_columns,
        "costly": low.equations.cost is not None,
        "second": low.equations.second,
        "sized": low.sized,
        "varied": len(low.varied),
    }


def _not_zero(low: Lowering, places: Sequence[int], what: str) -> list[tuple[str, int]]:
    """List the derivatives that do not vanish: by which parameter, and at which place."""
    return [
        (name, s)
        for name in low.varied
        for s, a in enumerate(places)
        if not low.slopes.vanishes(what, a, name)
    ]
