"""Tests whether expressions vanish identically or depend on each other.

Where a finite field leaves a question open, sixty digits can refuse it, or SymPy can grant it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import Enum

import mpmath
import numpy as np
import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import time
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.plain import Plain, Symbols
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import doubles, evaluated
from symsimpson.graph.findings import Findings
from symsimpson.graph.nodes import ZERO, Graph, Value
from symsimpson.graph.read import tree_size, was_float
from symsimpson.graph.rebuild import rebuilt

DIGITS = 60
#: Where sums of terms of size one end that vanish identically.
NOTHING = mpmath.mpf("1e-45")
#: Slopes below this, in units of their terms, are reported: floats are taken as they are.
NEARLY = mpmath.mpf("1e-12")
#: Points of the samples; several, because one may be a zero by chance, of both signs.
SAMPLES = (mpmath.mpf(37) / 53, mpmath.mpf(29) / 23, -mpmath.mpf(37) / 53, -mpmath.mpf(29) / 23)
#: Longer expressions are not simplified: SymPy may take for ever, and a limit of time would make
#: the text of a module depend on the machine.
TOO_LONG = 120
#: Steps to a state that satisfies constraints, and what counts as zero there.
ITERATIONS, SATISFIED = 20, 1e-9


class Dependence(Enum):
    """How a value depends on a symbol."""

    NONE = "not"
    REAL = "truly"
    NEARLY = "by less than 1e-12"
    UNDECIDED = "perhaps"


def certain(plain: Plain, findings: Findings, value: Value) -> bool:
    """Return whether all that moves a value in a field truly does, and by no rounding of floats."""
    nodes = map(plain.graph.nodes.__getitem__, plain.graph.reached([value[1]]))
    sums = (node.parts for node in nodes if node.kind == "sum")
    return not findings.opaque(value) and not any(was_float(c) for x in sums for c, _ in x)


class Samples:
    """Points at which slopes are looked at; what was computed there is kept."""

    def __init__(self, plain: Plain) -> None:
        self._plain = plain
        with mpmath.workdps(DIGITS):
            self._known = [_point(plain, sample) for sample in SAMPLES]

    def dependence(self, value: Value, x: int, slope: Value) -> Dependence:
        """Return how a value depends on a symbol that moves it in a field, if that is uncertain.

        ``slope`` is the derivative by the symbol x.
        """
        plain, sizes = self._plain, []
        for k in range(len(SAMPLES)):
            size = self._relative(slope, k)
            if size is not None and size > NEARLY:
                return Dependence.REAL  # most are: one sample shows it
            sizes += [] if size is None else [size]
        if not sizes or _jumps(plain, value, x):
            return Dependence.REAL
        if max(sizes) > NOTHING:
            return Dependence.NEARLY
        if not slope[0]:
            return Dependence.NONE
        if tree_size(plain.graph, slope) > TOO_LONG:
            return Dependence.UNDECIDED
        return Dependence.NONE if vanishes(plain.written(slope)) else Dependence.UNDECIDED

    def _relative(self, slope: Value, sample: int) -> mpmath.mpf | None:
        """Return the size of a slope in units of its largest term; None off the domain."""
        graph = self._plain.graph
        if not slope[0]:
            return mpmath.mpf(0)
        with mpmath.workdps(DIGITS):
            values = evaluated(graph, [slope[1]], self._known[sample], mpmath.mp)
            self._known[sample] = values
            kind, parts, _ = graph.nodes[slope[1]]
            terms = (
                [abs(c.numerator * values[m] / c.denominator) for c, m in parts]
                if kind == "sum"
                else [1]
            )
            size = abs(values[slope[1]]) / (max(terms) or 1)
            return size if mpmath.isfinite(size) else None


def vanishes(expression: sp.Expr) -> bool:
    """Return whether SymPy finds that a short expression is zero."""
    return bool(sp.expand(expression) == 0 or sp.simplify(expression) == 0)


def _jumps(plain: Plain, value: Value, x: int) -> bool:
    """Return whether a value that is constant on both sides of zero is not the same on both."""
    with mpmath.workdps(DIGITS):
        for sample in SAMPLES:
            point = _point(plain, sample)
            ends = []
            for sign in (1, -1):
                at = {**point, x: sign * abs(point[x])}
                ends.append(evaluated(plain.graph, [value[1]], at, mpmath.mp)[value[1]])
            gap = abs(ends[0] - ends[1])
            if mpmath.isfinite(gap) and gap > NEARLY * (1 + abs(ends[0])):
                return True
    return False


def _point(plain: Plain, sample: mpmath.mpf) -> dict[int, mpmath.mpf]:
    """Return a number for each symbol, parameters with their signs."""
    symbols = plain.symbols
    parameters = set(plain.parameters)
    values = {}
    for k, (n, s) in enumerate(zip(plain.numbers(symbols), symbols, strict=True)):
        value = sample + mpmath.mpf(k) / (7 + k)
        values[n] = abs(value) * (-1 if s.is_negative else 1) if s in parameters else value
    return values


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
        phi, n, m = sp.Matrix(self.constraints), len(force), len(self.constraints)
        parts = [*force, *phi, *phi.diff(time), *phi.jacobian(self.coordinates)]
        known = [*self.coordinates, *self.rates, time, *self.others(parts)]
        graph, values = self.read([*known, *parts])
        symbols = [node for _, node in values[: len(known)]]
        state = np.random.default_rng(20).uniform(0.3, 1, len(known))
        for _ in range(ITERATIONS):
            point = dict(zip(symbols, state.tolist(), strict=True))
            numbers = np.array(doubles(graph, values[len(known) :], point))
            force_values, gaps, slopes = np.split(numbers, [n, n + 2 * m])
            slopes = slopes.reshape(m, n)
            inverse = np.linalg.pinv(slopes)
            state[: 2 * n] -= (gaps.reshape(2, m) @ inverse.T).ravel()
        left = force_values - inverse @ slopes @ force_values
        return bool(max(np.abs(gaps).max(), np.abs(left).max()) < SATISFIED)

    def rows(self, equations: Sequence[sp.Expr]) -> tuple[Graph, list[list[Value]]]:
        """Return the coefficients of equations that are linear in the velocities."""
        graph, values = self.read([*self.rates, *equations])
        v = [n for _, n in values[: len(self.rates)]]
        rest = rebuilt(graph, values[len(v) :], dict.fromkeys(v, ZERO))
        slopes = (gradient(graph, value, v) for value in values[len(v) :])
        return graph, [[*row, last] for row, last in zip(slopes, rest, strict=True)]
