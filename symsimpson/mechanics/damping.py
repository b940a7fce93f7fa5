"""Damping that is linear in the momenta: of all alike, or of each by itself."""

from __future__ import annotations

from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.findings import Findings
from symsimpson.graph.nodes import ZERO, Value, scaled
from symsimpson.graph.rebuild import fixed, rebuilt
from symsimpson.mechanics.plain import Plain

__all__ = ["damping_rate", "decay_rates", "forces_at_rest"]


def damping_rate(plain: Plain) -> Value | None:
    """Return gamma where the forces are f = -2 gamma L_v, gamma made of parameters; else None.

    The motion is then that of the Lagrangian e^(2 gamma t) L (R. McLachlan and M. Perlmutter,
    J. Geom. Phys. 39 (2001) 276).
    """
    graph, v = plain.graph, plain.numbers(plain.v)
    if not all(c for c, _ in plain.f):
        return None
    mass = plain.entry(0, 0)
    slope = Derivatives(graph)(plain.f[0], v[0])
    if not slope[0]:
        return None
    rate = scaled(-1, graph.multiply([slope, (1, graph.kept((2 * mass[0], mass[1])), -1)]))
    momenta = gradient(graph, plain.L, v)
    pairs = zip(plain.f, momenta, strict=True)
    left = [graph.add([f, graph.multiply([(2, 0), rate, p])]) for f, p in pairs]
    findings = Findings(graph, [rate, *left])
    if not all(map(findings.vanishes, left)):
        return None
    moving = plain.numbers((*plain.q, *plain.v, *plain.u, plain.t))
    present = graph.nodes[rate[1]].symbols.intersection(moving)
    if any(findings.depends(rate, x) for x in present):
        return None
    return fixed(graph, rate, present) if present else rate


def decay_rates(plain: Plain) -> tuple[Value, ...] | None:
    """Return Gamma_i where forces are f_i = g_i(t, q, u) - Gamma_i (M v)_i; else None.

    M must be constant. The rates are made of parameters, each zero or known to be positive; where
    all are alike they are twice the gamma of :func:`damping_rate`.
    """
    graph, v = plain.graph, plain.numbers(plain.v)
    n, derivatives = len(v), Derivatives(graph)
    slopes = [[derivatives(f, x) for x in v] for f in plain.f]
    rates = []
    for i in range(n):
        slope, inverse = slopes[i][i], (1, graph.kept(plain.entry(i, i)), -1)
        rates.append(scaled(-1, graph.multiply([slope, inverse])) if slope[0] else ZERO)
    moving = set(plain.numbers((*plain.q, *plain.v, *plain.u, plain.t)))
    if any(not graph.nodes[k].symbols.isdisjoint(moving) for _, k in rates):
        return None
    left = [
        graph.add([slopes[i][j], graph.multiply([rates[i], plain.entry(i, j)])])
        for i in range(n)
        for j in range(n)
    ]
    findings = Findings(graph, left)
    if not all(map(findings.vanishes, left)):
        return None
    known = all(not rate[0] or plain.signs(rate) == (1, True) for rate in rates)
    return tuple(rates) if known else None


def forces_at_rest(plain: Plain) -> tuple[Value, ...]:
    """Return the forces with v = 0."""
    still = dict.fromkeys(plain.numbers(plain.v), ZERO)
    return tuple(rebuilt(plain.graph, list(plain.f), still))
