"""Tests whether expressions vanish identically or depend on each other.

If a finite field leaves a question open, evaluation in 60 digits may disprove the identity, or
SymPy may prove it.
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
from symsimpson.graph.evaluate import evaluate_doubles, evaluate_nodes
from symsimpson.graph.findings import IdentityTest
from symsimpson.graph.nodes import ZERO, Graph, Value
from symsimpson.graph.read import tree_size, was_float
from symsimpson.graph.rebuild import rebuild

DIGITS = 60
#: Largest value of a sum of terms of size one that counts as zero.
NOTHING = mpmath.mpf("1e-45")
#: Smaller slopes, relative to their terms, are reported: they may come from rounded floats.
NEARLY = mpmath.mpf("1e-12")
#: Points of the samples. There are several, of both signs, because one may be a zero by chance.
SAMPLES = (mpmath.mpf(37) / 53, mpmath.mpf(29) / 23, -mpmath.mpf(37) / 53, -mpmath.mpf(29) / 23)
#: Longest expression to simplify: SymPy may not terminate on longer ones. A limit of time would
#: make the generated code depend on the machine.
TOO_LONG = 120
#: Newton iterations to a state that satisfies constraints, and the largest error there.
ITERATIONS, SATISFIED = 20, 1e-9


class Dependence(Enum):
    """How a value depends on a symbol."""

    NONE = "not"
    REAL = "truly"
    NEARLY = "by less than 1e-12"
    UNDECIDED = "perhaps"


def is_certain(plain: Plain, findings: IdentityTest, value: Value) -> bool:
    """Return whether the finite field is conclusive: no opaque nodes and no floats in sums."""
    nodes = map(plain.graph.nodes.__getitem__, plain.graph.descendants([value[1]]))
    sums = (node.parts for node in nodes if node.kind == "sum")
    return not findings.opaque(value) and not any(was_float(c) for x in sums for c, _ in x)


class SlopeSamples:
    """Values of slopes at sample points in 60 digits, each computed once."""

    def __init__(self, plain: Plain) -> None:
        self._plain = plain
        with mpmath.workdps(DIGITS):
            self._known = [_sample_point(plain, sample) for sample in SAMPLES]

    def dependence(self, value: Value, x: int, slope: Value) -> Dependence:
        """Return how a value depends on x, if it changes with x in a finite field.

        The ``slope`` is the derivative of the value by x.
        """
        plain, sizes = self._plain, []
        for k in range(len(SAMPLES)):
            size = self._relative_size(slope, k)
            if size is not None and size > NEARLY:
                return Dependence.REAL  # the common case: one sample is enough
            sizes += [] if size is None else [size]
        if not sizes or _is_discontinuous(plain, value, x):
            return Dependence.REAL
        if max(sizes) > NOTHING:
            return Dependence.NEARLY
        if not slope[0]:
            return Dependence.NONE
        if tree_size(plain.graph, slope) > TOO_LONG:
            return Dependence.UNDECIDED
        return Dependence.NONE if vanishes(plain.to_sympy(slope)) else Dependence.UNDECIDED

    def _relative_size(self, slope: Value, sample: int) -> mpmath.mpf | None:
        """Return the size of a slope relative to its largest term; None outside the domain."""
        graph = self._plain.graph
        if not slope[0]:
            return mpmath.mpf(0)
        with mpmath.workdps(DIGITS):
            values = evaluate_nodes(graph, [slope[1]], self._known[sample], mpmath.mp)
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
    """Return whether SymPy proves that a short expression is zero."""
    return bool(sp.expand(expression) == 0 or sp.simplify(expression) == 0)


def _is_discontinuous(plain: Plain, value: Value, x: int) -> bool:
    """Return whether a value with zero slopes differs between x and -x."""
    with mpmath.workdps(DIGITS):
        for sample in SAMPLES:
            point = _sample_point(plain, sample)
            ends = []
            for sign in (1, -1):
                at = {**point, x: sign * abs(point[x])}
                ends.append(evaluate_nodes(plain.graph, [value[1]], at, mpmath.mp)[value[1]])
            gap = abs(ends[0] - ends[1])
            if mpmath.isfinite(gap) and gap > NEARLY * (1 + abs(ends[0])):
                return True
    return False


def _sample_point(plain: Plain, sample: mpmath.mpf) -> dict[int, mpmath.mpf]:
    """Return a number for each symbol; parameters have their signs."""
    symbols = plain.symbols
    parameters = set(plain.parameters)
    values = {}
    for k, (n, s) in enumerate(zip(plain.numbers(symbols), symbols, strict=True)):
        value = sample + mpmath.mpf(k) / (7 + k)
        values[n] = abs(value) * (-1 if s.is_negative else 1) if s in parameters else value
    return values


class Identities:
    """Tests of expressions in coordinates and velocities, with constraints of positions.

    Messages contain the ``name`` of the system and the ``source`` of the expressions. The
    constraints are expressions of positions that vanish during the motion.
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

    def other_symbols(self, expressions: Iterable[sp.Expr]) -> list[sp.Expr]:
        """Return the symbols and functions other than coordinates, velocities and t."""
        kinds = (sp.Symbol, AppliedUndef, sp.Derivative)
        atoms = set().union(*(x.atoms(*kinds) for x in expressions))
        return sorted(atoms - {time, *self.coordinates, *self.rates}, key=sp.default_sort_key)

    def read(self, expressions: Iterable[sp.Expr]) -> tuple[Graph, list[Value]]:
        """Read expressions into a graph, with all other symbols as parameters."""
        expressions = list(map(sp.sympify, expressions))
        symbols = Symbols(self.coordinates, dict.fromkeys(self.other_symbols(expressions), 0.0))
        allowed = (*symbols.q, *symbols.v, *symbols.a, symbols.t)
        return symbols.graph, [
            read_expression(self.name, self.source, x, symbols, symbols.known, allowed)
            for x in expressions
        ]

    def vanish(self, expressions: Iterable[sp.Expr]) -> bool:
        """Return whether all expressions are zero identically."""
        expressions = list(expressions)
        graph, values = self.read(expressions)
        known = IdentityTest(graph, values)
        return all(
            known.vanishes(value)  # SymPy knows identities such as roots of squares
            or (known.opaque(value) and sp.count_ops(x) < TOO_LONG and vanishes(x))
            for x, value in zip(expressions, values, strict=True)
        )

    def does_no_work(self, force: Sequence[sp.Expr]) -> bool:
        """Return whether a force is zero along all displacements that the constraints allow.

        With constraints, the test evaluates the force in doubles at one allowed state.
        """
        if self.vanish(force):
            return True
        if not self.constraints:
            return False
        phi, n, m = sp.Matrix(self.constraints), len(force), len(self.constraints)
        parts = [*force, *phi, *phi.diff(time), *phi.jacobian(self.coordinates)]
        known = [*self.coordinates, *self.rates, time, *self.other_symbols(parts)]
        graph, values = self.read([*known, *parts])
        symbols = [node for _, node in values[: len(known)]]
        state = np.random.default_rng(20).uniform(0.3, 1, len(known))
        for _ in range(ITERATIONS):
            point = dict(zip(symbols, state.tolist(), strict=True))
            numbers = np.array(evaluate_doubles(graph, values[len(known) :], point))
            force_values, gaps, slopes = np.split(numbers, [n, n + 2 * m])
            slopes = slopes.reshape(m, n)
            inverse = np.linalg.pinv(slopes)
            state[: 2 * n] -= (gaps.reshape(2, m) @ inverse.T).ravel()
        left = force_values - inverse @ slopes @ force_values
        return bool(max(np.abs(gaps).max(), np.abs(left).max()) < SATISFIED)

    def rows(self, equations: Sequence[sp.Expr]) -> tuple[Graph, list[list[Value]]]:
        """Return the rows (A, rest) of equations that are linear in the velocities."""
        graph, values = self.read([*self.rates, *equations])
        v = [n for _, n in values[: len(self.rates)]]
        rest = rebuild(graph, values[len(v) :], dict.fromkeys(v, ZERO))
        slopes = (gradient(graph, value, v) for value in values[len(v) :])
        return graph, [[*row, last] for row, last in zip(slopes, rest, strict=True)]
