"""Kernels that differentiate a step: by loops, of the equations themselves.

At the solution S dX = -(R_q dq0 + R_p dp0 + R_a da), with S the matrix of all unknowns there, and
then dq1 = dq0 + dX_d, dp1 = dp0 + h sum_i b_i dF_i. It is the derivative of whatever solved the
step: reduced parts have the same solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from symsimpson.codegen.adjoints import adjoint_kernels
from symsimpson.codegen.held_tangents import HeldDifferentials, each
from symsimpson.codegen.ir import Call, Function, Kernel, When
from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.storage import Storage
from symsimpson.codegen.unrolled import lanes
from symsimpson.codegen.written_tangent import is_written, written_tangent
from symsimpson.module.interface import WITH_PIVOTS

__all__ = ["differentiating"]

_ONE = ("W", "variation", "lane")
_AT_NODE = ("W", "h", "node", "variation", "lane")


def differentiating(
    low: Lowering, loops: LoopKernels, places: Sequence[int], *, following: bool
) -> tuple[list[Function], list[Kernel], dict[str, object]]:
    """Return the functions, kernels and tables that differentiate a step, if that is wanted.

    Coordinates stand in the order of ``places``; some may be ``following`` from the others.
    """
    if low.equations.varied is None:
        return [], [], {}
    storage = loops.held.storage if loops.held else loops.storage
    made = HeldDifferentials(low, loops, tuple(places), following)
    kernels = [*_tangent_kernels(made), *adjoint_kernels(made)]
    return made.functions(), kernels, made.tables() | _tables(storage, loops.degree)


def _tangent_kernels(made: HeldDifferentials) -> list[Kernel]:
    """Return what carries variations of the state to the end of the step that was taken."""
    of_start = each(
        Call("vary_start", _ONE),
        *made.if_varied(Call("add_slopes", _ONE)),
        Call("assemble_variation", _AT_NODE),
    )
    moved = each(
        Call("vary_path", _AT_NODE),
        Call("vary_momentum", _AT_NODE),
        *made.if_varied(Call("add_impulse", _AT_NODE)),
    )
    decay = (Call("decay_variation", _ONE),) if made.loops.damped else ()
    body = (
        Call("exchange_steps"),
        *made.path_known(),
        each(Call("begin_variation", _ONE)),
        *made.loops.all_rows(*made.parameter_slopes(), of_start, at_points=made.at_points()),
        *made.joined(),
        Call("factor_equations"),
        each(Call("solve_variation", _ONE)),
        *made.parted(),
        made.nodes(*made.drag(), *made.parameter_slopes(), moved),
        *made.pulls(),
        *made.impulse(),
        each(Call("close_variation", _ONE), *decay),
        Call("exchange_steps"),
        *made.projected(),
        *made.loops.mass_again(),
    )
    doc = "Carry variations of the state to the end of the step that was taken."
    kernels = [Kernel("tangent", doc, lanes((When(body),)))]
    if is_written(made.low):
        kernels = [written_tangent(made.low), replace(kernels[0], name=f"tangent{WITH_PIVOTS}")]
    if made.varied:
        doc = "Begin variations of parameters at given q and v."
        slopes = (*made.loops.start(), Call("parameter_slopes"), Call("vary_momentum_at_start"))
        kernels.append(Kernel("momentum_slopes", doc, lanes(slopes)))
    return kernels


def _tables(storage: Storage, degree: int) -> dict[str, object]:
    """Return what loops over variations must know."""
    own = {
        **storage.constants("TANGENT", degree),
        **storage.bounds("TANGENT", degree),
        "TANGENT_UNKNOWNS": storage.unknowns(degree),
    }
    return {key: own[key] for key in own if not key.endswith("_STEP")}
