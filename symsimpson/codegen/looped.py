"""Kernels that take the nodes in a loop: any system by need, large systems always."""

from __future__ import annotations

from collections.abc import Iterable

import sympy as sp

from symsimpson.codegen.ir import Call, Function, Kernel, Loop, Row, Statement, Store, When
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.straight import STATE, lanes, momentum_stores
from symsimpson.codegen.template import Point

__all__ = ["equations_kernel", "jet_function", "looped_energy", "looped_kernels", "node_functions"]

_HERE = ("W", "lane")


def _nodes(*body: Statement) -> Loop:
    return Loop("node", "NODES", body)


def _call(name: str, *arguments: str) -> Call:
    return Call(name, arguments or _HERE)


def _entries(low: Lowering, point: Point, what: str, block: str) -> list[Store]:
    """Store a vector or a matrix of the jet in its block."""
    n = low.n
    if what in ("L_q", "a"):
        indices: Iterable[tuple[int, ...]] = ((i,) for i in range(n))
    else:
        indices = ((i, j) for i in range(n) for j in range(n))
    return [
        Store(Row(block, number), low.template.entry(point, "jet", what, *index))
        for number, index in enumerate(indices)
    ]


def jet_function(low: Lowering) -> Function:
    """Evaluate the whole jet at the node that stands in the node's rows."""
    point = Point("i", low.node_q, low.node_v)

    def momentum(a: int) -> sp.Expr:
        return low.template.momentum(point, "jet", a)

    stores = [
        *_entries(low, point, "L_q", "NODE_L_Q"),
        *(
            Store(Row("NODE_L_V", a), low.graph.define(f"Lv_{name}_i", momentum(a), "jet"))
            for a, name in enumerate(low.names.coordinates)
        ),
        *_entries(low, point, "L_qq", "NODE_L_QQ"),
        *_entries(low, point, "L_qv", "NODE_L_QV"),
        *_entries(low, point, "M", "NODE_L_VV"),
    ]
    doc = "L_q, L_v, L_qq, L_qv and L_vv = M at a node."
    return Function("jet", doc, low.statements(stores, (Level.ITERATION,)))


def node_functions(low: Lowering) -> list[Function]:
    """Give the parts of a jet that large systems evaluate alone."""
    node = Point("i", low.node_q, low.node_v)
    gradient = _entries(low, node, "L_q", "NODE_L_Q")
    here = low.start_point()
    mass = [*_entries(low, here, "M", "NODE_L_VV"), *_entries(low, here, "a", "NODE_L_V")]
    v = Point(here.suffix, low.q, low.v)
    momentum = momentum_stores(low, v)
    return [
        Function("gradient", "L_q at a node.", low.statements(gradient, (Level.ITERATION,))),
        Function("mass", "M and a at q.", low.statements(mass, STATE)),
        Function("momentum", "p = M v + a.", low.statements(momentum, STATE)),
    ]


def looped_kernels(low: Lowering) -> list[Kernel]:
    """Make the kernels of a step with loops over nodes, coordinates and unknowns."""
    solve = (_call("mass"), _call("solve_mass"))
    advance = (
        _call("clear_momentum"),
        _nodes(_call("path", "W", "h", "node", "lane"), _call("gradient"),
               _call("accumulate", "W", "h", "node", "lane")),
        _call("close_step"),
        *solve,
        _call("predict", "W", "h", "lane"),
    )  # fmt: skip
    return [
        Kernel("start", "Begin at (q, p) with increments of constant velocity.",
               lanes((*solve, _call("straight", "W", "h", "lane")))),
        Kernel("legendre", "p = dL/dv from q and v.", lanes((_call("momentum"),))),
        newton_kernel("newton"),
        Kernel("advance", "Close a step by compensated sums, then predict the next increments.",
               lanes((When(advance),))),
    ]  # fmt: skip


def looped_energy(low: Lowering) -> Kernel:
    """H = v.(p - a)/2 + V for a large system."""
    potential = low.template.output(low.start_point(), "potential", ("V",))
    kinetic = low.names.fresh("kinetic")
    store = Store(Row("ENERGY", 0), kinetic + potential)
    body = (
        _call("mass"),
        _call("solve_mass"),
        Call("kinetic_energy", _HERE, result=kinetic),
        *low.statements((store,), STATE),
    )
    return Kernel("energy", "The Hamiltonian at (q, p).", lanes(body))


def equations_body() -> tuple[Statement, ...]:
    """Give the statements that leave residual and Jacobian in their rows."""
    everywhere = ("W", "h", "node", "lane")
    return (
        _call("clear"),
        _nodes(_call("path", *everywhere), _call("jet"), _call("assemble", *everywhere)),
    )


def newton_kernel(name: str) -> Kernel:
    """Make a Newton iteration with loops and pivoting."""
    body = (*equations_body(), _call("solve_pivoted"), _call("update_increments"))
    doc = "One Newton iteration, assembled node by node and solved with row pivoting."
    return Kernel(name, doc, lanes((When(body),)))


def equations_kernel() -> Kernel:
    """Give the equations themselves, all of them, whatever a step solves."""
    doc = "Residual and Jacobian of the step, rows in the order of elimination."
    return Kernel("equations", doc, lanes(equations_body()))
