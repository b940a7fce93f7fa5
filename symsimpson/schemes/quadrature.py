"""Gauss, Lobatto and left Radau quadrature on [0, 1], with exact nodes and weights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import sympy as sp
from sympy.integrals.quadrature import gauss_legendre, gauss_lobatto

from symsimpson.errors import SchemeError, reject

#: Roots of Legendre polynomials and of their derivatives are written in radicals up to here; with
#: one node more, products of them fill pages.
CLOSED_FORM = {"gauss": 4, "lobatto": 5, "radau": 3}
#: Beyond that they are decimal numbers here; modules make them with as many digits as they need.
SHOWN_DIGITS = 60
#: So many nodes at most.
MOST = 16

_x = sp.Symbol("x", real=True)


@dataclass(frozen=True)
class Quadrature:
    """A quadrature rule on [0, 1].

    Attributes
    ----------
    kind : str
        ``"gauss"``, ``"lobatto"`` or ``"radau"``.
    nodes, weights : tuple of sympy numbers
        c_i in increasing order, and b_i.
    order : int
        Polynomials of degree ``order - 1`` are integrated exactly.
    """

    kind: str
    nodes: tuple[sp.Expr, ...]
    weights: tuple[sp.Expr, ...]
    order: int

    @property
    def symmetric(self) -> bool:
        """Whether the rule is the same from both ends."""
        return self.kind != "radau"

    @property
    def exact(self) -> bool:
        """Whether nodes and weights are exact numbers, not decimal ones."""
        return not any(node.is_Float for node in self.nodes)


@cache
def gauss(nodes: int) -> Quadrature:
    """Return the Gauss rule: the zeros of the Legendre polynomial, order 2s."""
    _check("gauss", nodes, 1)
    if nodes > CLOSED_FORM["gauss"]:
        return Quadrature("gauss", *_decimal(gauss_legendre(nodes, SHOWN_DIGITS)), 2 * nodes)
    points = _unit_roots(sp.legendre(nodes, _x))
    return Quadrature("gauss", points, _weights(points), 2 * nodes)


@cache
def lobatto(nodes: int) -> Quadrature:
    """Return the Lobatto rule: both ends and the extrema of a Legendre polynomial, order 2s - 2."""
    _check("lobatto", nodes, 2)
    if nodes > CLOSED_FORM["lobatto"]:
        abscissae, weights = _decimal(gauss_lobatto(nodes, SHOWN_DIGITS))
        points = (sp.S.Zero, *abscissae[1:-1], sp.S.One)
        return Quadrature("lobatto", points, weights, 2 * nodes - 2)
    inner = _unit_roots(sp.diff(sp.legendre(nodes - 1, _x), _x)) if nodes > 2 else ()
    points = (sp.S.Zero, *inner, sp.S.One)
    return Quadrature("lobatto", points, _weights(points), 2 * nodes - 2)


@cache
def radau(nodes: int) -> Quadrature:
    """Return the left Radau rule: the start and s - 1 nodes inside, order 2s - 1."""
    _check("radau", nodes, 1)
    if nodes > CLOSED_FORM["radau"]:
        reject(
            f"a Radau quadrature has at most {CLOSED_FORM['radau']} nodes here, not {nodes}.",
            remedy="Choose 'radau5', or a Gauss scheme of higher order.",
            error=SchemeError,
        )
    # zeros of P_(s-1) + P_s on [-1, 1], of which -1 is one
    points = _unit_roots(sp.expand(sp.legendre(nodes - 1, _x) + sp.legendre(nodes, _x)))
    return Quadrature("radau", points, _weights(points), 2 * nodes - 1)


def lagrange_basis(points: tuple[sp.Expr, ...], x: sp.Expr) -> tuple[sp.Expr, ...]:
    """Return the Lagrange polynomials l_k(x) of the points, with l_k(points[j]) = 1 if j = k."""
    return tuple(
        sp.prod([(x - other) / (point - other) for other in points if other != point])
        for point in points
    )


def _check(kind: str, nodes: int, least: int) -> None:
    if isinstance(nodes, bool) or not isinstance(nodes, int) or nodes < least:
        reject(
            f"a {kind} quadrature has at least {least} node(s), not {nodes!r}.",
            remedy=f"Choose nodes={least} or more.",
            error=SchemeError,
        )
    if nodes > MOST:
        reject(
            f"a quadrature has at most {MOST} nodes here, not {nodes!r}.",
            remedy="Rounding leaves nothing of an order beyond 20 in double precision. "
            "Use fewer nodes.",
            error=SchemeError,
        )


def _decimal(
    rule: tuple[list[sp.Expr], list[sp.Expr]],
) -> tuple[tuple[sp.Expr, ...], tuple[sp.Expr, ...]]:
    """Move nodes and weights from [-1, 1] to [0, 1]."""
    nodes, weights = rule
    return tuple((1 + x) / 2 for x in nodes), tuple(w / 2 for w in weights)


def _unit_roots(polynomial: sp.Expr) -> tuple[sp.Expr, ...]:
    """Return the real roots on [-1, 1], moved to [0, 1] and sorted."""
    roots = sorted(sp.roots(polynomial, _x), key=lambda root: float(sp.N(root, 30)))
    return tuple(sp.radsimp(sp.expand((1 + root) / 2)) for root in roots)


def _weights(points: tuple[sp.Expr, ...]) -> tuple[sp.Expr, ...]:
    """Integrate the Lagrange polynomials over [0, 1], term by term."""
    weights = []
    for basis in lagrange_basis(points, _x):
        terms = sp.expand(basis).as_coefficients_dict(_x)
        whole = sum(c / (sp.degree(power, _x) + 1) for power, c in terms.items())
        weights.append(sp.radsimp(sp.expand(whole)))
    return tuple(weights)
