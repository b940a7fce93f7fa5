"""Kernels that carry derivatives of a cost from the end of a step back to its start.

They are the transpose of the tangent, and so the exact derivatives of the cost that is computed.
"""

from __future__ import annotations

from symsimpson.codegen.constrained_tangents import HeldDifferentials
from symsimpson.codegen.differentials import GO_TO_NODE
from symsimpson.codegen.ir import Call, IfActive, Kernel, Loop, Statement
from symsimpson.codegen.unrolled import lanes

__all__ = ["adjoint_kernels"]

_HERE = ("W", "node", "lane")
_AT_NODE = ("W", "h", "node", "lane")


def adjoint_kernels(differentials: HeldDifferentials) -> list[Kernel]:
    """Return the adjoint of a step and of p0 = L_v(q0, v0), and what keeps steps for it."""
    timed = differentials.timed()
    step = lanes((IfActive(_step(timed)),))
    start = (
        *timed.loops.start(),
        Call("jet"),
        *timed.at_state(0),
        *timed.if_varied(Call("pull_momentum_slopes")),
        Call("pull_momentum"),
    )
    return [
        Kernel("adjoint", "Carry derivatives of a cost back over the step that was taken.", step),
        Kernel("start_adjoint", "Derivatives by q0 and v0 from those by q0 and p0.", lanes(start)),
        Kernel(
            "record", "Keep the step that was taken.", lanes((IfActive((Call("record_step"),)),))
        ),
        *(_cost_kernels(timed) if timed.costly else ()),
    ]


def _step(differentials: HeldDifferentials) -> tuple[Statement, ...]:
    # what is differentiated by h is varied, and parameters have said where the node is
    cost = differentials.if_costly(Call("cost_slopes"), Call("add_cost", _AT_NODE))
    nodes = Loop(
        "node", "range(NODES)", (Call("weigh_node", _AT_NODE), Call("pull_parameters", _HERE))
    )
    return (
        *differentials.pulled_end(),
        Call("exchange_steps"),
        *differentials.path_known(),
        *((Call("decay_adjoint"),) if differentials.loops.damped else ()),
        Call("begin_adjoint"),
        *differentials.assembled(*cost),
        Call("pull_end"),
        *differentials.pulled_right(),
        *differentials.adjoint_joined(),
        Call("factor_equations"),
        Call("solve_adjoint"),
        *differentials.adjoint_parted(),
        *differentials.if_varied(nodes),
        Call("pull_start"),
        *differentials.pulled_start(),
        Call("close_adjoint"),
        Call("exchange_steps"),
    )


def _cost_kernels(differentials: HeldDifferentials) -> list[Kernel]:
    """Return what evaluates a running cost over the step that was taken, and anywhere."""
    step = (
        Call("exchange_steps"),
        *differentials.path_known(),
        differentials.loops.nodes(
            "range(NODES)",
            *differentials.at(GO_TO_NODE),
            Call("cost_slopes"),
            Call("integrate_cost", _AT_NODE),
        ),
        Call("exchange_steps"),
    )
    state = differentials.at(Call("go_to_state", ("W", "h", "0", "lane")))
    here = (Call("take_for_velocity"), *differentials.loops.start(), *state, Call("cost_slopes"))
    return [
        Kernel(
            "step_cost",
            "Add the running cost of the step that was taken.",
            lanes((IfActive(step),)),
        ),
        Kernel(
            "running_cost",
            "The running cost at q and v, which stands in the place of p.",
            lanes(here),
        ),
    ]
