"""Expressions of SymPy's mechanics that are zero, or without effect, identically."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.graph.derive import gradient
from symsimpson.graph.findings import Findings
from symsimpson.graph.nodes import ZERO, Graph, Value
from symsimpson.graph.rebuild import rebuilt
from symsimpson.mechanics.coordinates import time
from symsimpson.mechanics.expression_checks import read_expression
from symsimpson.mechanics.independence import vanishes
from symsimpson.mechanics.plain import Symbols
from symsimpson.support.literals import float_literals

__all__ = ["Identities"]

#: Longer expressions are not simplified: SymPy may take for ever.
TOO_LONG = 120
#: Steps to a state that satisfies constraints, and what counts as zero there.
ITERATIONS, NOTHING = 20, 1e-9


class Identities:
    """Tests of expressions in coordinates and velocities, with constraints of positions.

    ``name`` is that of the system, ``source`` what the expressions are in, as messages say it. The
    constraints are expressions of positions, zero in every motion.
    """

    def __init__(
        self,
        name: str,
        source: str,
        coordinates: Sequence[AppliedUndef],
        constraints: Sequence[sp.Expr],
    ) -> None:
        self.name, self.source, self.coordinates = name, source, coordinates
        self.constraints = constraints
        self.rates = [q.diff(time) for q in coordinates]

    def others(self, expressions: Iterable[sp.Expr]) -> list[sp.Expr]:
        """List the symbols and functions in expressions besides coordinates, velocities and t."""
        kinds = (sp.Symbol, AppliedUndef, sp.Derivative)
        atoms = set().union(*(x.atoms(*kinds) for x in expressions))
        return sorted(atoms - {time, *self.coordinates, *self.rates}, key=sp.default_sort_key)

    def read(self, expressions: Iterable[sp.Expr]) -> tuple[Graph, list[Value]]:
        """Read expressions, in which everything else is a parameter."""
        expressions = list(map(sp.sympify, expressions))
        symbols = Symbols(self.coordinates, dict.fromkeys(self.others(expressions), 0.0))
        allowed = (*symbols.q, *symbols.v, *symbols.a, symbols.t)
        return symbols.graph, [
            read_expression(self.name, self.source, x, symbols, symbols.known, allowed)
            for x in expressions
        ]

    def vanish(self, expressions: Iterable[sp.Expr]) -> bool:
        """Return whether all of some expressions are zero."""
        expressions = list(expressions)
        graph, values = self.read(expressions)
        known = Findings(graph, values)
        return all(
            known.vanishes(value)  # roots of squares and the like, SymPy knows
            or (known.opaque(value) and sp.count_ops(x) < TOO_LONG and vanishes(x))
            for x, value in zip(expressions, values, strict=True)
        )

    def idle(self, force: Sequence[sp.Expr]) -> bool:
        """Return whether a force does nothing that the constraints allow, looked at in doubles."""
        if self.vanish(force):
            return True
        if not self.constraints:
            return False
        phi, others = sp.Matrix(self.constraints), self.others([*force, *self.constraints])
        dummies = {x: sp.Dummy() for x in (*self.coordinates, *self.rates, time, *others)}
        parts = sp.Matrix(force), phi.row_join(phi.diff(time)), phi.jacobian(self.coordinates)
        at = sp.lambdify(
            [*dummies.values()], float_literals([x.xreplace(dummies) for x in parts]), cse=True
        )
        state = np.random.default_rng(20).uniform(0.3, 1, len(dummies))
        for _ in range(ITERATIONS):
            force_values, gaps, slopes = map(np.asarray, at(*state))
            inverse = np.linalg.pinv(slopes)
            state[: 2 * len(force)] -= (inverse @ gaps).T.ravel()
        left = force_values - inverse @ slopes @ force_values
        return bool(max(np.abs(gaps).max(), np.abs(left).max()) < NOTHING)

    def rows(self, equations: Sequence[sp.Expr]) -> tuple[Graph, list[list[Value]]]:
        """Return the coefficients of equations that are linear in the velocities."""
        graph, values = self.read([*self.rates, *equations])
        v = [n for _, n in values[: len(self.rates)]]
        rest = rebuilt(graph, values[len(v) :], dict.fromkeys(v, ZERO))
        slopes = (gradient(graph, value, v) for value in values[len(v) :])
        return graph, [[*row, last] for row, last in zip(slopes, rest, strict=True)]
