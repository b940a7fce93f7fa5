"""What derivatives of a step by parameters ask of a node: those of F and P."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import sympy as sp

from symsimpson.discrete.jet import Jet, Key, written_as_jet
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.nodes import Graph, Value
from symsimpson.graph.rebuild import rebuilt

if TYPE_CHECKING:
    from symsimpson.mechanics.plain import Plain

__all__ = ["derive_slopes"]


def derive_slopes(plain: Plain, varied: Mapping[str, sp.Symbol]) -> Jet:
    """Derive F = L_q + f and P = L_v by parameters and inputs.

    Parameters
    ----------
    plain : Plain
    varied : mapping from name to plain symbol

    Returns
    -------
    Jet
        Outputs ``("F_a", i, name)`` and ``("P_a", i, name)``.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    moving = places[: 2 * n]
    L, *f = rebuilt(plain.graph, [plain.L, *plain.f], {}, graph)
    derivatives = Derivatives(graph)
    outputs: dict[Key, Value] = {}
    for name, x in zip(varied, graph.numbers(s.name for s in varied.values()), strict=True):
        slopes = gradient(graph, derivatives(L, x), moving)
        for i in range(n):
            outputs["F_a", i, name] = graph.add([slopes[i], derivatives(f[i], x)])
            outputs["P_a", i, name] = slopes[n + i]
    return written_as_jet(plain, graph, outputs)
