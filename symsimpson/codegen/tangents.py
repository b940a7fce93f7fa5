"""Kernels that differentiate a step: by loops, of the equations themselves.

At the solution S dX = -(R_q dq0 + R_p dp0 + R_a da), with S the matrix of all unknowns there, and
then dq1 = dq0 + dX_d, dp1 = dp0 + h sum_i b_i dF_i. It is the derivative of whatever solved the
step: reduced parts have the same solution.
"""

from __future__ import annotations

from collections.abc import Sequence

from symsimpson.codegen.ir import Call, Function, Kernel, Loop, Row, Statement, Store, When
from symsimpson.codegen.levels import Level
from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.storage import Storage
from symsimpson.codegen.template import Point
from symsimpson.codegen.unrolled import lanes

__all__ = ["differentiate", "tangent_sizes"]

_ONE = ("W", "variation", "lane")
_AT_NODE = ("W", "h", "node", "variation", "lane")


def differentiate(
    low: Lowering, loops: LoopKernels, places: Sequence[int], functions: list[Function],
    kernels: list[Kernel], tables: dict[str, object], *, following: bool,
) -> None:  # fmt: skip
    """Add what differentiates a step, if that is wanted."""
    if low.equations.varied is None:
        return
    varied = len(low.varied)
    if varied:
        functions.append(_slope_function(low, places))
        kernels.append(_momentum_slopes(loops))
    kernels.append(_tangent_kernel(loops, following=following, varied=bool(varied)))
    tables |= _tables(loops.storage, loops.degree, varied)


def tangent_sizes(low: Lowering) -> dict[str, int]:
    """Return the sizes of what derivatives of a step have in the workspace."""
    if low.equations.varied is None:
        return {}
    slopes = len(low.varied) * low.n
    return {"NODE_F_A": slopes, "NODE_P_A": slopes, "TANGENTS": 1,
            "EXCHANGE": low.equations.unknowns.size}  # fmt: skip


def _tangent_kernel(loops: LoopKernels, *, following: bool, varied: bool) -> Kernel:
    """Return what carries variations of the state to the end of the step that was taken.

    Its path is known, but for coordinates that are ``following`` from the others. Parameters may
    be ``varied``, too.
    """
    known: tuple[Statement, ...] = ()
    if following:
        known = (*loops.all_rows(), Call("solve_following"))
    slopes = (Call("parameter_slopes"),) if varied else ()
    grown: tuple[Statement, ...] = ()
    if loops.damped:
        grown = (Call("grow_slopes", ("W", "node", "lane")),) if varied else ()
    of_start = _each(
        Call("vary_start", _ONE), *((Call("add_slopes", _ONE),) if varied else ()),
        Call("assemble_variation", _AT_NODE),
    )  # fmt: skip
    moved = _each(
        Call("vary_path", _AT_NODE), Call("vary_momentum", _AT_NODE),
        *((Call("add_impulse", _AT_NODE),) if varied else ()),
    )  # fmt: skip
    weighted = (Call("grow_node", ("W", "node", "lane")),) if loops.damped else ()
    drag = (Call("add_drag"),) if loops.dragged else ()
    decay = (Call("decay_variation", _ONE),) if loops.damped else ()
    body = (
        Call("exchange_steps"),
        *known,
        _each(Call("begin_variation", _ONE)),
        *loops.all_rows(*slopes, *grown, of_start),
        Call("factor_equations"),
        _each(Call("solve_variation", _ONE)),
        loops.nodes("range(NODES)", Call("jet"), *weighted, *drag, *slopes, *grown, moved),
        _each(Call("close_variation", _ONE), *decay),
        Call("exchange_steps"),
    )
    doc = "Carry variations of the state to the end of the step that was taken."
    return Kernel("tangent", doc, lanes((When(body),)))


def _each(*body: Statement) -> Loop:
    return Loop("variation", "range(int(W[TANGENTS, lane]))", body)


def _momentum_slopes(loops: LoopKernels) -> Kernel:
    """Return the derivatives of p = L_v(q, v) by the parameters that are varied, at a state."""
    doc = "Derivatives of p by the parameters that are varied, at (q, v)."
    return Kernel("momentum_slopes", doc, lanes((*loops.start(), Call("parameter_slopes"))))


def _slope_function(low: Lowering, places: Sequence[int]) -> Function:
    """Write the derivatives of F and P by the parameters that are varied, at a node."""
    point = Point("i", low.node_q, low.node_v, low.node_t, low.node_u)
    stores = [
        Store(Row(block, j * low.n + s), low.slopes.entry(point, "slopes", what, a, name))
        for j, name in enumerate(low.varied)
        for block, what in (("NODE_F_A", "F_a"), ("NODE_P_A", "P_a"))
        for s, a in enumerate(places)
    ]  # fmt: skip
    doc = "Derivatives of F and P by the parameters that are varied, at a node."
    return Function("parameter_slopes", doc, low.statements(stores, (Level.ITERATION,)))


def _tables(storage: Storage, degree: int, varied: int) -> dict[str, object]:
    """Return what loops over variations must know."""
    own = {
        **storage.constants("TANGENT", degree),
        **storage.bounds("TANGENT", degree),
        "TANGENT_UNKNOWNS": storage.unknowns(degree),
        "VARIED": varied,
    }
    return {key: own[key] for key in own if not key.endswith("_STEP")}
