"""Constraints at a point of a step: phi, Phi = dphi/dq, A v - b, and the forces of multipliers."""

from __future__ import annotations

from symsimpson.discrete.jet import Jet, Key, written_as_jet
from symsimpson.graph.derive import Derivatives
from symsimpson.graph.nodes import ZERO, Graph, Value
from symsimpson.graph.rebuild import rebuilt
from symsimpson.mechanics.constraints import accelerations
from symsimpson.mechanics.plain import Plain

__all__ = ["derive_constraints"]


def derive_constraints(plain: Plain) -> Jet:
    """Derive all that a step and its results ask of constraints, and of L beside them.

    Outputs are ``("phi", c)``, ``("Phi", c, a)``, Phi and behind it A, ``("pull", a, b)``, the
    derivatives of Phi^T lambda + A^T nu by q; of velocity constraints ``("b", c)``, ``("rate",
    c)``, A v - b, with ``("b_q", c, a)`` and ``("rate_q", c, a)``; and of a state ``("curve", c)``,
    v.phi_qq.v or the like of A v - b, and ``("push", a)``, L_q + f - (d L_v/dq) v - d L_v/dt, which
    is M v' + Phi^T lambda + A^T nu. Symbols l_c stand for the multipliers.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    q, v = places[:n], places[n : 2 * n]
    multipliers = graph.numbers(symbol.name for symbol in plain.multipliers)
    held = plain.held_rows(graph)
    L, *f = rebuilt(plain.graph, [plain.L, *plain.f], {}, graph)
    derivatives, time = Derivatives(graph), graph.symbol(plain.t.name)[1]
    rows, push, curve, rates = accelerations(graph, L, held, f, (q, v, time))
    m = len(held.phi)
    outputs: dict[Key, Value] = {("phi", c): value for c, value in enumerate(held.phi)}
    outputs |= {("Phi", c, a): x for c, row in enumerate(rows) for a, x in enumerate(row)}
    outputs |= {("curve", c): value for c, value in enumerate(curve)}
    outputs |= {("push", a): value for a, value in enumerate(push)}
    for c, (*_, b) in enumerate(held.rows, m):
        outputs |= {("phi", c): ZERO, ("b", c): b, ("rate", c): rates[c]}
        outputs |= {("rate_q", c, a): derivatives(rates[c], x) for a, x in enumerate(q)}
        outputs |= {("b_q", c, a): derivatives(b, x) for a, x in enumerate(q)}
    for a, pull in enumerate(held.pulls(graph, q, multipliers)):
        outputs |= {("pull", a, b): derivatives(pull, x) for b, x in enumerate(q)}
    return written_as_jet(plain, graph, outputs)
