"""Residuals and impulses in which every rounded number enters as it does in one L_d.

A step is symplectic if its equations are the derivatives of one function L_d, whatever the function
is. So the numbers for h b_i, c_i, A_ik, B_ik and 1/h may be rounded, but they have to be the same
numbers in the path and in the residual: forces and momenta at nodes are multiplied by h b_i first,
and then by entries of the tables; products of tables would be rounded anew, and let the energy
drift. With the bends Y_k = X_k - c_k X_d of the path from a straight line,

    q_i = q0 + c_i X_d + sum_k A_ik Y_k,    v_i = (X_d + sum_k B_ik Y_k)/h,    0 < k < d,

the row of q0 takes no differences of tables, and no large numbers that cancel:

    p0 + sum_i h b_i L_q - sum_i c_i h b_i L_q - (1/h) sum_i h b_i L_v = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.lower import Lowering
from symsimpson.graph.nodes import UNIT

__all__ = ["Increments", "WeightedRows", "bend", "unit_row", "weighted_residual"]

#: X_1..X_d, each by coordinate.
Increments = Sequence[Mapping[int, Expression] | Sequence[Expression]]
#: Gives L_q or L_v at a node: ``value(i, a)``.
AtNode = Callable[[int, int], Expression]


def unit_row(row: Sequence[object]) -> int | None:
    """Return the control point at which a node stands, None if at none.

    Examples
    --------
    >>> unit_row([0, 1]), unit_row([0.5, 0.5])
    (1, None)
    """
    places = [k for k, x in enumerate(row) if x != 0]
    return places[0] if len(places) == 1 and row[places[0]] == 1 else None


def bend(low: Lowering, k: int, a: int, X: Increments | None = None) -> Expression:
    """Return Y_k = X_k - c_k X_d, 0 < k < d, of the increments or of others."""
    X = low.increments if X is None else X
    value = X[k - 1][a] - low.scheme.points[k] * X[-1][a]
    return low.graph.define(f"{low.names.coordinates[a]}_Y{k}", value, "path")


class WeightedRows:
    """D_k L_d and p1 - p0 for coordinates, from L_q and L_v at the nodes."""

    def __init__(self, low: Lowering, force: AtNode, momentum: AtNode | None = None) -> None:
        self._low, self._force, self._momentum = low, force, momentum
        self._scheme, self._stages = low.scheme, range(low.equations.scheme.stages)

    def _weighted(self, name: str, i: int, a: int, value: Expression) -> Expression:
        low = self._low
        scheme = self._scheme
        weight = low.h * scheme.weights[i] * low.growth(scheme.nodes[i])
        return low.graph.define(
            f"{name}_{low.names.coordinates[a]}_{i}_w", weight * value, f"node {i}, weighted"
        )

    def _forces(self, a: int) -> list[Expression]:
        """Return h b_i L_q at the nodes."""
        return [self._weighted("Lq", i, a, self._force(i, a)) for i in self._stages]

    def _momenta(self, a: int) -> list[Expression]:
        """Return h b_i L_v at the nodes; none where M is constant and the rows have its inertia."""
        momentum = self._momentum
        if momentum is None:
            return []
        return [self._weighted("Lv", i, a, momentum(i, a)) for i in self._stages]

    def _define(self, hint: str, value: Expression) -> Expression:
        return self._low.graph.define(hint, value, "residual D_k L_d")

    def row(self, k: int, a: int) -> Expression:
        """Return D_k L_d for 0 < k < d."""
        A, B = self._scheme.A, self._scheme.B
        total = self._low.graph.total
        forces = total(A[i][k] * f for i, f in enumerate(self._forces(a)))
        momenta = total(B[i][k] * p for i, p in enumerate(self._momenta(a)))
        name = self._low.names.coordinates[a]
        return forces + self._define(f"Lv_{k}_{name}", momenta) / self._low.h

    def start(self, a: int) -> Expression:
        """Return p0 and what q0 adds where bends are held, p0 + D_0 L_d + sum (1 - c_k) D_k L_d.

        The forces are added up first: 1 - c_i need not be what rounding makes of it.
        """
        low, points = self._low, self._scheme.points
        name = low.names.coordinates[a]
        whole: list[Expression] = [low.p[a]]
        shares: list[Expression] = []
        for i, force in enumerate(self._forces(a)):
            place = unit_row(self._scheme.A[i])
            c = self._scheme.nodes[i] if place is None else points[place]
            q = c.coefficient.denominator
            exact = c.node == UNIT and q & (q - 1) == 0
            whole.append((1 - c) * force if exact else force)
            if not exact:
                shares.append(c * force)
        total = low.graph.total
        inertia = self._define(f"Lv_{name}", total(self._momenta(a)))
        forces = self._define(f"Lq_{name}", total(shares))
        return self._define(f"p_{name}_0", total(whole)) - forces - inertia / low.h

    def rest(self, rows: Sequence[Expression]) -> Expression:
        """Return sum (1 - c_k) D_k L_d, by which the row above differs from that of q0 alone.

        Elimination is stable with that; at the solution it is zero, whatever the factors are.
        """
        points = self._scheme.points[1:]
        return self._low.graph.total((1 - c) * row for c, row in zip(points, rows, strict=False))

    def impulse(self, a: int) -> Expression:
        """Return p1 - p0."""
        return self._low.graph.total(self._forces(a))


def weighted_residual(
    low: Lowering, rows: WeightedRows, order: Sequence[int], group: Sequence[int]
) -> list[Expression]:
    """Return the right-hand side of a Newton iteration: rows in an order in which 0 comes last."""
    define, names = low.graph.define, low.names.coordinates
    residuals: dict[tuple[int, int], Expression] = {}
    for k in order:
        for a in group:
            if k > 0:
                value = rows.row(k, a)
            else:
                value = rows.start(a) - rows.rest([residuals[m, a] for m in sorted(order) if m > 0])
            residuals[k, a] = define(f"R_{k}_{names[a]}", value, "residual D_k L_d")
    return [-residuals[k, a] for k in order for a in group]
