"""Damping in proportion to the momenta, under which areas of phase space shrink evenly."""

from __future__ import annotations

from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.findings import Findings
from symsimpson.graph.nodes import Value, scaled
from symsimpson.graph.rebuild import fixed
from symsimpson.mechanics.plain import Plain

__all__ = ["damping_rate"]


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
    left = [
        graph.add([f, graph.multiply([(2, 0), rate, p])])
        for f, p in zip(plain.f, momenta, strict=True)
    ]
    findings = Findings(graph, [rate, *left])
    if not all(map(findings.vanishes, left)):
        return None
    moving = plain.numbers((*plain.q, *plain.v, *plain.u, plain.t))
    present = graph.nodes[rate[1]].symbols.intersection(moving)
    if any(findings.depends(rate, x) for x in present):
        return None
    return fixed(graph, rate, present) if present else rate
