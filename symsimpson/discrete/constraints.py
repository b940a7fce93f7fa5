"""Constraints at a point of a step: phi, Phi = dphi/dq, and the forces of multipliers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symsimpson.discrete.jet import Jet, Key, written_as_jet
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.nodes import Graph, Value
from symsimpson.graph.rebuild import rebuilt
from symsimpson.mechanics.constraints import accelerations

if TYPE_CHECKING:
    from symsimpson.mechanics.plain import Plain

__all__ = ["derive_constraints"]


def derive_constraints(plain: Plain) -> Jet:
    """Derive all that a step and its results ask of constraints, and of L beside them.

    Returns
    -------
    Jet
        Outputs ``("phi", c)``, ``("Phi", c, a)``, ``("pull", a, b)``, the second derivatives of
        lambda.phi; and of a state ``("curve", c)``, v.phi_qq.v, and ``("push", a)``,
        L_q + f - (d L_v/dq) v - d L_v/dt, which is M v' + Phi^T lambda. Symbols l_c stand for the
        multipliers.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    q, v = places[:n], places[n : 2 * n]
    multipliers = graph.numbers(symbol.name for symbol in plain.multipliers)
    L, *values = rebuilt(plain.graph, [plain.L, *plain.constraints.values(), *plain.f], {}, graph)
    phi, f = values[: len(multipliers)], values[len(multipliers) :]
    derivatives, time = Derivatives(graph), graph.symbol(plain.t.name)[1]
    slopes, push, curve = accelerations(graph, L, phi, f, (q, v, time))
    outputs: dict[Key, Value] = {("phi", c): value for c, value in enumerate(phi)}
    outputs |= {("Phi", c, a): x for c, row in enumerate(slopes) for a, x in enumerate(row)}
    outputs |= {("curve", c): value for c, value in enumerate(curve)}
    outputs |= {("push", a): value for a, value in enumerate(push)}
    held = graph.add(graph.products(phi, multipliers))
    for a, slope in enumerate(gradient(graph, held, q)):
        outputs |= {("pull", a, b): derivatives(slope, x) for b, x in enumerate(q)}
    return written_as_jet(plain, graph, outputs)
