"""The kernel of second derivatives of a step, made only where it is asked for."""

from __future__ import annotations

from dataclasses import replace

from symsimpson.codegen.differentials import GO_TO_NODE, Differentials, point_of_node
from symsimpson.codegen.ir import Call, Function, Kernel, Row, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.unrolled import lanes

__all__ = ["curvature_functions", "curvature_kernel", "curvature_tables"]

_AT_NODE = ("W", "node", "lane")
#: What is evaluated, the function that does it, and the block it leaves entries in.
_FUNCTIONS = {
    "node": ("node_curvature", "NODE_CURVATURE", "alpha.F + beta.P + gamma g at a node"),
    "point": ("point_curvature", "POINT_CURVATURE", "nu.phi - alpha.Phi^T mu at a control point"),
}


def curvature_tables(differentials: Differentials) -> dict[str, object]:
    """Return by which variables entries are, and how large the matrix of all is."""
    low, degree = differentials.low, differentials.loops.degree
    count = len(low.multipliers)
    first = (degree + 1) * low.n + degree * count
    tables: dict[str, object] = {
        "VARIED_FROM": first,
        "HESSIAN_SIZE": first + len(low.varied) * low.equations.scheme.stages,
    }
    for what, prefix in (("node", "CURVATURE"), ("point", "POINT")):
        pairs = low.curvatures.places(what)
        if what == "node" or count:
            tables |= {
                f"{prefix}_ROW": tuple(i for i, _ in pairs),
                f"{prefix}_COLUMN": tuple(j for _, j in pairs),
            }
    return tables


def curvature_functions(differentials: Differentials) -> list[Function]:
    """Write the second derivatives at a node, and at a control point if there are constraints."""
    low, functions = differentials.low, []
    for what, (name, block, of) in _FUNCTIONS.items():
        if what == "point" and not low.multipliers:
            continue
        here = point_of_node(low)
        v = tuple(low.step[0] * v for v in here.v or ())
        t = here.t - low.step[1] * low.step[0] if low.sized and here.t is not None else here.t
        point = replace(
            here, suffix=what, v=v, t=t, weights=low.weights, multipliers=low.multipliers
        )
        stores = [
            Store(Row(block, k), low.curvatures.entry(point, "curvatures", what, i, j))
            for k, (i, j) in enumerate(low.curvatures.places(what))
        ]
        doc = f"Second derivatives of {of}."
        functions.append(Function(name, doc, low.statements(stores, (Level.ITERATION,))))
    return functions


def curvature_kernel(differentials: Differentials) -> Kernel:
    """Return the kernel that evaluates them for the path that stands in the workspace."""
    loops = differentials.loops
    grown = (Call("grow_weights", _AT_NODE),) if loops.damped else ()
    at_node: tuple[Statement, ...] = (
        Call("weigh_node_rows", _AT_NODE),
        GO_TO_NODE,
        *grown,
        Call("node_curvature"),
        Call("add_curvature", _AT_NODE),
    )
    points = loops.points(
        "range(DEGREE + 1)",
        "clear_constraints",
        Call("weigh_point_rows", ("W", "h", "point", "lane")),
        Call("point_curvature"),
        Call("add_point_curvature", ("W", "point", "lane")),
    )
    body = (Call("clear_hessian_of_step"), loops.nodes("range(NODES)", *at_node), *points)
    return Kernel("curvature", "Second derivatives of weighted rows of a step.", lanes(body))
