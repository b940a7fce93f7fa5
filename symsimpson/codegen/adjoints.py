"""Kernels that carry derivatives of a cost from the end of a step back to its start.

They are the transpose of the tangent, and so the exact derivatives of the cost that is computed.
"""

from __future__ import annotations

from symsimpson.codegen.differentials import GO_TO_NODE
from symsimpson.codegen.held_tangents import HeldDifferentials
from symsimpson.codegen.ir import Call, Kernel, Loop, Statement, When
from symsimpson.codegen.unrolled import lanes

__all__ = ["adjoint_kernels"]

_HERE = ("W", "node", "lane")
_AT_NODE = ("W", "h", "node", "lane")


def adjoint_kernels(differentials: HeldDifferentials) -> list[Kernel]:
    """Return the adjoint of a step and of p0 = L_v(q0, v0), and what keeps steps for it."""
    made = differentials.timed()
    step = lanes((When(_step(made)),))
    start = (
        *made.loops.start(),
        Call("jet"),
        *made.at_state(0),
        *made.if_varied(Call("pull_momentum_slopes")),
        Call("pull_momentum"),
    )
    return [
        Kernel("adjoint", "Carry derivatives of a cost back over the step that was taken.", step),
        Kernel("start_adjoint", "Derivatives by q0 and v0 from those by q0 and p0.", lanes(start)),
        Kernel("record", "Keep the step that was taken.", lanes((When((Call("record_step"),)),))),
        *(_cost_kernels(made) if made.costly else ()),
    ]


def _step(made: HeldDifferentials) -> tuple[Statement, ...]:
    # what is differentiated by h is varied, and parameters have said where the node is
    cost = made.if_costly(Call("cost_slopes"), Call("add_cost", _AT_NODE))
    nodes = Loop(
        "node", "range(NODES)", (Call("weigh_node", _AT_NODE), Call("pull_parameters", _HERE))
    )
    return (
        *made.pulled_end(),
        Call("exchange_steps"),
        *made.path_known(),
        *((Call("decay_adjoint"),) if made.loops.damped else ()),
        Call("begin_adjoint"),
        *made.assembled(*cost),
        Call("pull_end"),
        *made.pulled_right(),
        *made.adjoint_joined(),
        Call("factor_equations"),
        Call("solve_adjoint"),
        *made.adjoint_parted(),
        *made.if_varied(nodes),
        Call("pull_start"),
        *made.pulled_start(),
        Call("close_adjoint"),
        Call("exchange_steps"),
    )


def _cost_kernels(made: HeldDifferentials) -> list[Kernel]:
    """Return what evaluates a running cost over the step that was taken, and anywhere."""
    step = (
        Call("exchange_steps"),
        *made.path_known(),
        made.loops.nodes(
            "range(NODES)",
            *made.at(GO_TO_NODE),
            Call("cost_slopes"),
            Call("integrate_cost", _AT_NODE),
        ),
        Call("exchange_steps"),
    )
    state = made.at(Call("go_to_state", ("W", "h", "0", "lane")))
    here = (Call("take_for_velocity"), *made.loops.start(), *state, Call("cost_slopes"))
    return [
        Kernel(
            "step_cost", "Add the running cost of the step that was taken.", lanes((When(step),))
        ),
        Kernel(
            "running_cost",
            "The running cost at q and v, which stands in the place of p.",
            lanes(here),
        ),
    ]
