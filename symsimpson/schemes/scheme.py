"""Galerkin variational integrators, with their tables of coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from symsimpson.errors import SchemeError, reject
from symsimpson.schemes.quadrature import Quadrature, gauss, lagrange_basis, lobatto, radau
from symsimpson.support.markup import aligned, in_text
from symsimpson.support.names import counted

Table = tuple[tuple[sp.Expr, ...], ...]
#: Largest number of table entries that LaTeX output shows.
MOST_NUMBERS = 42
_QUADRATURES = {"gauss": gauss, "lobatto": lobatto, "radau": radau}


def _number(expression: sp.Expr) -> sp.Expr:
    """Simplify an exact number, and round a tiny decimal number to zero."""
    if expression.is_Float:
        return expression if abs(expression) > 1e-50 else sp.S.Zero
    return sp.radsimp(sp.expand(expression))


@dataclass(frozen=True, repr=False)
class Scheme:
    r"""A Galerkin variational integrator.

    The path over one step is a polynomial of degree d through control points X_0 = q0, ...,
    X_d = q1 at the Lobatto points. A quadrature (b_i, c_i) approximates the action:

    .. math:: L_d = h \sum_i b_i L\bigl(\sum_k A_{ik} X_k, \tfrac1h \sum_k B_{ik} X_k\bigr).

    Attributes
    ----------
    name : str
        The name of the scheme for ``compile`` and in file names.
    quadrature : Quadrature
        The quadrature with nodes c_i and weights b_i, i = 1..s.
    degree : int
        The degree d of the path.

    References
    ----------
    .. [1] J. E. Marsden and M. West, Acta Numerica 10 (2001), section 2.2.6.
    .. [2] S. Ober-Bloebaum, Galerkin variational integrators and modified symplectic Runge-Kutta
       methods, IMA J. Numer. Anal. 37 (2017), 375-406.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.SIMPSON.order, ss.SIMPSON.degree, ss.SIMPSON.points
    (4, 2, (0, 1/2, 1))
    """

    name: str
    quadrature: Quadrature = field(repr=False)
    degree: int

    @property
    def stages(self) -> int:
        """Number s of quadrature nodes."""
        return len(self.quadrature.nodes)

    @property
    def exact(self) -> bool:
        """True if the tables are exact numbers. If not, modules compute their own."""
        return self.quadrature.exact and lobatto(self.degree + 1).exact

    @property
    def by_stages(self) -> bool:
        """True if a step may iterate over velocities and forces at the nodes (stages).

        If s = d, the stages determine the path, and the scheme is a symplectic partitioned
        Runge-Kutta method. For s < 3, Newton's method has the same cost.
        """
        return self.quadrature.symmetric and self.degree == self.stages > 2

    @property
    def symmetric(self) -> bool:
        """True if a step with -h is the inverse of a step with h."""
        return self.quadrature.symmetric

    @property
    def order(self) -> int:
        """Order of consistency: min(2d, order of the quadrature)."""
        return min(2 * self.degree, self.quadrature.order)

    @property
    def unbounded(self) -> bool:
        """True if a linear oscillator is stable at any step size, as for Gauss methods."""
        return self.quadrature.kind == "gauss" and self.degree == self.stages

    @property
    def formula(self) -> Sequence[str]:
        """The discrete Lagrangian, as lines of text."""
        kind, nodes = self.quadrature.kind.capitalize(), counted(self.stages, "node")
        return (
            "    L_d(X_0, ..., X_d) = h sum_i b_i L(sum_k A_ik X_k, 1/h sum_k B_ik X_k),",
            f"    d = {self.degree}, X_0 = q0, X_d = q1, {kind} quadrature, {nodes},",
            "    p0 = -D_0 L_d,  D_k L_d = 0 for 0 < k < d,  p1 = D_d L_d",
        )

    @property
    def legend(self) -> str:
        """The legend of the tables."""
        return "nodes, weights b_i, A_ik = l_k(c_i), B_ik = l_k'(c_i), and the predictor"

    @property
    def references(self) -> Sequence[str]:
        """The publications, as lines of text."""
        return (
            "J. E. Marsden and M. West, Acta Numerica 10 (2001); S. Ober-Bloebaum, IMA J.",
            "Numer. Anal. 37 (2017).",
        )

    @property
    def tables(self) -> Mapping[str, tuple[sp.Expr, ...] | Table]:
        """The tables by their names in modules; empty if they are not exact numbers."""
        if not self.exact:
            return {}
        return {
            "POINTS": self.points,
            "PLACES": self.quadrature.nodes,
            "WEIGHTS": self.quadrature.weights,
            "END_SLOPE": self.end_slope,
            "START_SLOPE": self.correction,
            "BASIS": self.A,
            "BASIS_SLOPE": self.B,
            "EXTRAPOLATION": self.extrapolation,
        }

    @property
    def at_gauss_points(self) -> tuple[tuple[sp.Expr, ...], Table, Table]:
        """The d Gauss points, and two d by d + 1 tables: the basis and its slopes there."""
        points = gauss(self.degree).nodes
        values = (lagrange_basis(self.points, c) for c in points)
        basis = tuple(tuple(map(_number, row)) for row in values)
        return points, basis, tuple(map(self._slopes, points))

    def oscillator(self, x: float) -> NDArray[np.float64]:
        """Return the matrix of a step with h = x of the oscillator q'' = -q.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> round(float(np.linalg.det(ss.SIMPSON.oscillator(0.5))), 12)  # area is preserved
        1.0
        """
        A, B, b = self._doubles
        # D_k L_d = sum_m K_km X_m for the control points X
        K = B.T @ (b[:, None] * B) / x - x * A.T @ (b[:, None] * A)
        ends, inner = np.ix_([0, -1], [0, -1]), slice(1, -1)
        if self.degree > 1:
            solved = np.linalg.solve(K[inner, inner], K[inner][:, [0, -1]])
            K = K[ends] - K[[0, -1]][:, inner] @ solved
        a, d, c = K[0, 0], K[1, 1], K[0, 1]  # p0 = -(a q0 + c q1), p1 = c q0 + d q1
        return np.array([[-a / c, -1 / c], [c - a * d / c, -d / c]])

    @cached_property
    def _doubles(self) -> tuple[NDArray[np.float64], ...]:
        """A, B and the weights as doubles."""
        tables = self.A, self.B, self.quadrature.weights
        return tuple(np.array(table, dtype=np.float64) for table in tables)

    @cached_property
    def points(self) -> tuple[sp.Expr, ...]:
        """The d + 1 Lobatto points at which the control points are."""
        return lobatto(self.degree + 1).nodes

    @cached_property
    def A(self) -> Table:
        """The s by d + 1 table A_ik = l_k(c_i)."""
        return tuple(
            tuple(_number(value) for value in lagrange_basis(self.points, c))
            for c in self.quadrature.nodes
        )

    @cached_property
    def B(self) -> Table:
        """The s by d + 1 table B_ik = l_k'(c_i)."""
        return tuple(self._slopes(c) for c in self.quadrature.nodes)

    @cached_property
    def stiffness(self) -> Table:
        """S_km = sum_i b_i B_ik B_im. For constant M, the path has T = X.S.X M/(2h)."""
        b, d = self.quadrature.weights, self.degree

        def entry(k: int, m: int) -> sp.Expr:
            return _number(sp.Add(*(b[i] * row[k] * row[m] for i, row in enumerate(self.B))))

        return tuple(tuple(entry(k, m) for m in range(d + 1)) for k in range(d + 1))

    @cached_property
    def extrapolation(self) -> Table:
        """E_kj: the path of the last step at 1 + c_k from its increments X_j - X_0, k, j = 1..d."""
        d = self.degree
        rows = [lagrange_basis(self.points, 1 + c) for c in self.points[1:]]
        return tuple(
            tuple(_number(row[j] - (1 if j == d else 0)) for j in range(1, d + 1)) for row in rows
        )

    @cached_property
    def end_slope(self) -> tuple[sp.Expr, ...]:
        """l_j'(1), j = 1..d: h times the velocity at the end of a step from its increments."""
        return self._slopes(sp.S.One)[1:]

    @cached_property
    def correction(self) -> tuple[sp.Expr, ...]:
        """g_k, k = 1..d: the change of the extrapolation per unit of the slope at the start.

        The predictor is the polynomial of degree d + 1 through the control points of the last
        step with the slope h v0 at the new start: X_k = sum_j E_kj X_j' + g_k (h v0 - slope').
        """
        x = sp.Symbol("x", real=True)
        omega = sp.prod([x - (point - 1) for point in self.points])
        slope = sp.diff(omega, x).subs(x, 0)
        return tuple(_number(omega.subs(x, c) / slope) for c in self.points[1:])

    def _slopes(self, c: sp.Expr) -> tuple[sp.Expr, ...]:
        """Return l_k'(c), k = 0..d."""
        x = sp.Symbol("x", real=True)
        basis = lagrange_basis(self.points, x)
        return tuple(_number(sp.diff(sp.expand(value), x).subs(x, c)) for value in basis)

    def _repr_latex_(self) -> str:
        rule = self.quadrature
        tables = {"c_i": sp.Matrix([rule.nodes]), "b_i": sp.Matrix([rule.weights])}
        if self.exact and self.stages * (self.degree + 1) <= MOST_NUMBERS:
            tables |= {"A_{ik}": sp.Matrix(self.A), "B_{ik}": sp.Matrix(self.B)}
        else:
            tables = {name: table.evalf(6) for name, table in tables.items()}
        rows = [(name, sp.latex(table)) for name, table in tables.items()]
        return aligned([self._title(f"{rule.kind} quadrature"), ("d", str(self.degree)), *rows])

    def _title(self, kind: str) -> tuple[str, str]:
        """Return the first row of LaTeX output."""
        return "", rf"\text{{{in_text(self.name)}: {kind}, order {self.order}}}"

    def __repr__(self) -> str:
        kind = self.quadrature.kind.capitalize()
        return (
            f"Scheme({self.name!r}: {kind} quadrature with {counted(self.stages, 'node')}, "
            f"degree {self.degree}, order {self.order})"
        )


def galerkin(quadrature: str, nodes: int, degree: int) -> Scheme:
    """Make a scheme from its quadrature and the degree of its path.

    Parameters
    ----------
    quadrature : {"lobatto", "gauss", "radau"}
        The quadrature. "radau" has a node at the start of a step and none at its end. With
        s = d, "radau" makes momenta decay under strong damping; the others do not.
    nodes : int
        The number s of quadrature nodes.
    degree : int
        The degree d of the path, at most s.

    Returns
    -------
    Scheme
        The scheme, of order min(2d, order of the quadrature).

    Raises
    ------
    SchemeError
        If the quadrature is unknown, or the degree exceeds the number of nodes.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.galerkin(quadrature="lobatto", nodes=3, degree=2) is ss.SIMPSON
    True
    >>> ss.galerkin("gauss", 2, 2).order
    4
    """
    if not isinstance(quadrature, str) or quadrature not in _QUADRATURES:
        reject(
            f"there is no quadrature {quadrature!r}.",
            remedy="Choose 'lobatto', 'gauss' or 'radau'.",
            error=SchemeError,
        )
    if isinstance(nodes, bool) or not isinstance(nodes, int):
        reject(
            f"a {quadrature} quadrature has a whole number of nodes, not {nodes!r}.",
            remedy="Pass an integer, such as nodes=2.",
            error=SchemeError,
        )
    rule = _QUADRATURES[quadrature](nodes)
    if isinstance(degree, bool) or not isinstance(degree, int) or degree < 1:
        reject(
            f"the degree of a path is an integer of at least 1, not {degree!r}.",
            remedy="Pass degree=1 or more.",
            error=SchemeError,
        )
    if degree > nodes:
        reject(
            f"{counted(nodes, 'quadrature node')} cannot determine a path of degree {degree}.",
            why="The order would drop, and the Newton matrix would be singular for free motion.",
            remedy=f"Pass degree={nodes} or less, or more nodes.",
            error=SchemeError,
        )
    return _scheme(rule, degree)


@cache
def _scheme(rule: Quadrature, degree: int) -> Scheme:
    """Make each scheme once, so that equal ones are identical and share their tables."""
    return Scheme(_name(rule.kind, len(rule.nodes), degree), rule, degree)


def _name(quadrature: str, nodes: int, degree: int) -> str:
    """Return the name: "midpoint", "simpson", kind and order, or kind, nodes and degree."""
    if (quadrature, nodes, degree) == ("gauss", 1, 1):
        return "midpoint"
    if (quadrature, nodes, degree) == ("lobatto", 3, 2):
        return "simpson"
    if quadrature == "gauss" and degree == nodes:
        return f"gauss{2 * nodes}"
    if quadrature == "lobatto" and degree == nodes - 1:
        return f"lobatto{2 * nodes - 2}"
    if quadrature == "radau" and degree == nodes:
        return f"radau{2 * nodes - 1}"
    return f"{quadrature}_{nodes}_{degree}"


#: The implicit midpoint rule: order 2, one Gauss node, a straight path.
MIDPOINT = galerkin("gauss", 1, 1)
#: Order 4: Simpson's rule, a parabolic path.
SIMPSON = galerkin("lobatto", 3, 2)
