"""Gauss, Lobatto and left Radau quadrature on [0, 1], with exact nodes and weights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import sympy as sp
from sympy.integrals.quadrature import gauss_legendre, gauss_lobatto

from symsimpson.errors import SchemeError, reject
from symsimpson.support.names import counted

#: Largest number of nodes that are written in radicals. With one node more, their products are
#: many pages long.
CLOSED_FORM = {"gauss": 4, "lobatto": 5, "radau": 3}
#: Digits of decimal nodes. Modules with more digits compute their own.
SHOWN_DIGITS = 60
#: Largest number of nodes.
MOST = 16

_x = sp.Symbol("x", real=True)


@dataclass(frozen=True)
class Quadrature:
    """A quadrature rule on [0, 1].

    Attributes
    ----------
    kind : str
        The name of the rule: ``"gauss"``, ``"lobatto"``, ``"radau"`` or ``"composition"``.
    nodes, weights : tuple of sympy numbers
        The nodes c_i and their weights b_i.
    order : int
        The order p: polynomials of degree p - 1 are integrated exactly.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.SIMPSON.quadrature.nodes, ss.SIMPSON.quadrature.weights
    ((0, 1/2, 1), (1/6, 2/3, 1/6))
    """

    kind: str
    nodes: tuple[sp.Expr, ...]
    weights: tuple[sp.Expr, ...]
    order: int

    @property
    def symmetric(self) -> bool:
        """True if nodes and weights are symmetric about the midpoint."""
        return self.kind != "radau"

    @property
    def exact(self) -> bool:
        """True if nodes and weights are exact numbers instead of decimal numbers."""
        return not any(node.is_Float for node in self.nodes)


@cache
def gauss(nodes: int) -> Quadrature:
    """Return the Gauss rule of order 2s, with the zeros of the Legendre polynomial."""
    _check_nodes("gauss", nodes, 1)
    if nodes > CLOSED_FORM["gauss"]:
        return Quadrature("gauss", *_map_rule(gauss_legendre(nodes, SHOWN_DIGITS)), 2 * nodes)
    points = _unit_roots(sp.legendre(nodes, _x))
    return Quadrature("gauss", points, _weights(points), 2 * nodes)


@cache
def lobatto(nodes: int) -> Quadrature:
    """Return the Lobatto rule of order 2s - 2, with both ends and extrema of P_(s-1)."""
    _check_nodes("lobatto", nodes, 2)
    if nodes > CLOSED_FORM["lobatto"]:
        abscissae, weights = _map_rule(gauss_lobatto(nodes, SHOWN_DIGITS))
        points = (sp.S.Zero, *abscissae[1:-1], sp.S.One)
        return Quadrature("lobatto", points, weights, 2 * nodes - 2)
    inner = _unit_roots(sp.diff(sp.legendre(nodes - 1, _x), _x)) if nodes > 2 else ()
    points = (sp.S.Zero, *inner, sp.S.One)
    return Quadrature("lobatto", points, _weights(points), 2 * nodes - 2)


@cache
def radau(nodes: int) -> Quadrature:
    """Return the left Radau rule of order 2s - 1, with the start and s - 1 inner nodes."""
    _check_nodes("radau", nodes, 1)
    if nodes > CLOSED_FORM["radau"]:
        reject(
            f"a Radau quadrature can have at most {CLOSED_FORM['radau']} nodes, not {nodes}.",
            remedy="Choose 'radau5', or a Gauss scheme of higher order.",
            error=SchemeError,
        )
    # the zeros of P_(s-1) + P_s on [-1, 1], one of which is -1
    points = _unit_roots(sp.expand(sp.legendre(nodes - 1, _x) + sp.legendre(nodes, _x)))
    return Quadrature("radau", points, _weights(points), 2 * nodes - 1)


def lagrange_basis(points: tuple[sp.Expr, ...], x: sp.Expr) -> tuple[sp.Expr, ...]:
    """Return the Lagrange polynomials l_k(x) of the points, with l_k(points[j]) = 1 if j = k."""
    return tuple(
        sp.prod([(x - other) / (point - other) for other in points if other != point])
        for point in points
    )


def _check_nodes(kind: str, nodes: int, least: int) -> None:
    """Reject a number of nodes that is not an integer from ``least`` to MOST."""
    if isinstance(nodes, bool) or not isinstance(nodes, int) or nodes < least:
        reject(
            f"a {kind} quadrature has at least {counted(least, 'node')}, not {nodes!r}.",
            remedy=f"Pass nodes={least} or more.",
            error=SchemeError,
        )
    if nodes > MOST:
        reject(
            f"a quadrature can have at most {MOST} nodes, not {nodes!r}.",
            why="In double precision, round-off errors hide orders beyond 20.",
            remedy="Use fewer nodes.",
            error=SchemeError,
        )


def _map_rule(
    rule: tuple[list[sp.Expr], list[sp.Expr]],
) -> tuple[tuple[sp.Expr, ...], tuple[sp.Expr, ...]]:
    """Map nodes and weights from [-1, 1] to [0, 1]."""
    nodes, weights = rule
    return tuple((1 + x) / 2 for x in nodes), tuple(w / 2 for w in weights)


def _unit_roots(polynomial: sp.Expr) -> tuple[sp.Expr, ...]:
    """Return the sorted real roots on [-1, 1], mapped to [0, 1]."""
    roots = sorted(sp.roots(polynomial, _x), key=lambda root: float(sp.N(root, 30)))
    return tuple(sp.radsimp(sp.expand((1 + root) / 2)) for root in roots)


def _weights(points: tuple[sp.Expr, ...]) -> tuple[sp.Expr, ...]:
    """Return the integrals of the Lagrange polynomials over [0, 1]."""
    weights = []
    for basis in lagrange_basis(points, _x):
        terms = sp.expand(basis).as_coefficients_dict(_x)
        whole = sum(c / (sp.degree(power, _x) + 1) for power, c in terms.items())
        weights.append(sp.radsimp(sp.expand(whole)))
    return tuple(weights)
