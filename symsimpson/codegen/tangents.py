"""Kernels that differentiate a step: by loops, of the equations themselves.

They solve these, linearised at the solution: the derivative of whatever solved the step, as reduced
parts have the same solution. The matrix of ``library/slopes.py`` is assembled once a step; the
tangent multiplies with it, and the adjoint with its transpose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from symsimpson.codegen.adjoints import adjoint_kernels
from symsimpson.codegen.constrained_tangents import HeldDifferentials, each
from symsimpson.codegen.ir import Call, Function, IfActive, Index, Kernel, Loop, Statement
from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.second_derivatives import (
    curvature_functions,
    curvature_kernel,
    curvature_tables,
)
from symsimpson.codegen.storage import Storage
from symsimpson.codegen.unrolled import lanes
from symsimpson.module.interface import WITH_PIVOTS

__all__ = ["differentiating"]

_ONE = ("W", "dq", "room", "lane")
_ROOM = ("W", "room", "lane")


def differentiating(
    low: Lowering, loops: LoopKernels, places: Sequence[int], *, following: bool, in_order: bool
) -> tuple[list[Function], list[Kernel], dict[str, object]]:
    """Return the functions, kernels and tables that differentiate a step, if that is wanted.

    Coordinates stand in the order of ``places``; some may be ``following`` from the others. All
    unknowns may be eliminated ``in_order`` where Newton's method does so.
    """
    if low.equations.varied is None:
        return [], [], {}
    storage = loops.held.storage if loops.held else loops.storage
    differentials = HeldDifferentials(low, loops, tuple(places), following, in_order)
    kernels = [*_tangent_kernels(differentials), *adjoint_kernels(differentials)]
    functions = differentials.functions()
    tables = differentials.tables() | _tables(storage, loops.degree)
    if low.equations.second:
        kernels.append(curvature_kernel(differentials))
        functions += curvature_functions(differentials)
        tables |= curvature_tables(differentials)
    return functions, kernels, tables


def _tangent_kernels(differentials: HeldDifferentials) -> list[Kernel]:
    """Return what carries variations of the state to the end of the step that was taken."""
    kernels = [_tangent(differentials, _by_variations(differentials))]
    if differentials.in_order:
        pivoted = replace(kernels[0], name=f"tangent{WITH_PIVOTS}")
        kernels = [
            replace(_tangent(differentials, _by_columns(differentials)), straight=True),
            pivoted,
        ]
    if differentials.varied:
        doc = "Begin variations of parameters at given q and v."
        slopes = (
            *differentials.loops.start(),
            *differentials.at_state(0),
            Call("vary_momentum_at_start"),
        )
        kernels.append(Kernel("momentum_slopes", doc, lanes(slopes)))
    return kernels


def _tangent(differentials: HeldDifferentials, moved: Sequence[Statement]) -> Kernel:
    """Return the kernel, in which the matrix of the step is assembled before what it moves."""
    body = (
        Call("exchange_steps"),
        *differentials.path_known(),
        *differentials.assembled(),
        *moved,
        Call("exchange_steps"),
        *differentials.projected(),
        *differentials.loops.mass_again(),
    )
    doc = "Carry variations of the state to the end of the step that was taken."
    return Kernel("tangent", doc, lanes((IfActive(body),)))


def _by_variations(differentials: HeldDifferentials) -> tuple[Statement, ...]:
    """Solve for each variation."""
    return (
        each(*_begun(differentials)),
        *differentials.varied_points(),
        *differentials.joined(),
        Call("factor_equations"),
        each(Call("solve_variation", _ROOM)),
        *differentials.parted(),
        *differentials.pulls(),
        *differentials.impulse(),
        each(*_closed(differentials)),
    )


def _by_columns(differentials: HeldDifferentials) -> tuple[Statement, ...]:
    """Solve for the columns of the derivative, and multiply variations with it."""
    here = (
        Index("dq", "DERIVATIVE + column * 2 * DIMENSION"),
        Index("room", "COLUMN_ROOM + column * (UNKNOWNS + DIMENSION)"),
        Index("parameter", "column - 2 * DIMENSION"),
        Call("begin_column", ("W", "column", "lane")),
    )
    solve = Call("solve_variation_in_order", _ROOM)
    return (
        Call("factor_equations_in_order"),
        Loop(
            "column",
            "range(2 * DIMENSION + VARIED)",
            (*here, *_begun(differentials), solve, *_closed(differentials)),
        ),
        each(Call("move_variation", ("W", "dq", "room", "parameter", "lane"))),
    )


def _begun(differentials: HeldDifferentials) -> tuple[Statement, ...]:
    parameter = Call("add_parameter", ("W", "h", "room", "parameter", "lane"))
    return (Call("begin_variation", _ONE), *differentials.if_varied(parameter))


def _closed(differentials: HeldDifferentials) -> tuple[Statement, ...]:
    decay = (Call("decay_variation", ("W", "dq", "lane")),) if differentials.loops.damped else ()
    return (Call("close_variation", _ONE), *decay)


def _tables(storage: Storage, degree: int) -> dict[str, object]:
    """Return what loops over variations must know."""
    constants = {
        **storage.constants("TANGENT", degree),
        **storage.bounds("TANGENT", degree),
        "TANGENT_UNKNOWNS": storage.unknowns(degree),
    }
    return {key: constants[key] for key in constants if not key.endswith("_STEP")}
