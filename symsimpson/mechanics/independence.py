"""What a field leaves open: sixty digits refuse, SymPy may grant, the rest is undecided."""

from __future__ import annotations

from enum import Enum

import mpmath
import sympy as sp

from symsimpson.graph.derive import Derivatives
from symsimpson.graph.evaluate import evaluated
from symsimpson.graph.findings import Findings
from symsimpson.graph.nodes import Value
from symsimpson.graph.read import FLOAT, tree_size
from symsimpson.mechanics.plain import Plain

__all__ = ["Dependence", "certain", "dependence", "vanishes"]

DIGITS = 60
#: Where sums of terms of size one end that vanish identically.
NOTHING = mpmath.mpf("1e-45")
#: Slopes below this, in units of their terms, are reported: floats are taken as they are.
NEARLY = mpmath.mpf("1e-12")
#: Points of the samples; two, because one may be a zero by chance.
SAMPLES = (mpmath.mpf(37) / 53, mpmath.mpf(29) / 23)
#: Longer expressions are not simplified: SymPy may take for ever, and a limit of time would make
#: the text of a module depend on the machine.
TOO_LONG = 120


class Dependence(Enum):
    """How a value depends on a symbol."""

    NONE = "not"
    REAL = "truly"
    NEARLY = "by less than 1e-12"
    UNDECIDED = "perhaps"


def certain(plain: Plain, findings: Findings, value: Value) -> bool:
    """Tell whether all that moves a value in a field truly does, and by no rounding of floats."""
    return not findings.opaque(value) and not _has_floats(plain, value)


def dependence(plain: Plain, value: Value, x: int) -> Dependence:
    """Tell how a value depends on a symbol that moves it in a field, where that is not certain.

    Parameters
    ----------
    plain : Plain
    value : Value
    x : int
        The symbol.
    """
    graph = plain.graph
    slope = Derivatives(graph)(value, x)
    sizes = [_relative(plain, slope, sample) for sample in SAMPLES]
    if any(size is not None and size > NEARLY for size in sizes) or None in sizes:
        return Dependence.REAL
    if any(size is not None and size > NOTHING for size in sizes):
        return Dependence.NEARLY
    if tree_size(graph, slope) > TOO_LONG:
        return Dependence.UNDECIDED
    return Dependence.NONE if vanishes(plain.written(slope)) else Dependence.UNDECIDED


def vanishes(expression: sp.Expr) -> bool:
    """Tell whether SymPy finds that a short expression is zero."""
    return bool(sp.expand(expression) == 0 or sp.simplify(expression) == 0)


def _has_floats(plain: Plain, value: Value) -> bool:
    """Tell whether a value holds numbers that were floats, and no round ones."""
    graph = plain.graph

    def is_float(c: object) -> bool:
        q = c.denominator  # type: ignore[attr-defined]
        return bool(q > FLOAT and q & (q - 1) == 0)

    return any(
        is_float(c)
        for n in graph.reached([value[1]])
        if graph.nodes[n].kind == "sum"
        for c, _ in graph.nodes[n].parts
    )


def _relative(plain: Plain, slope: Value, sample: mpmath.mpf) -> mpmath.mpf | None:
    """Give the size of a slope in units of its largest term; None off the domain."""
    graph = plain.graph
    symbols = (*plain.q, *plain.v, *plain.p, *plain.parameters)
    with mpmath.workdps(DIGITS):
        point = {
            n: (sample + mpmath.mpf(k) / (7 + k)) * (-1 if s.is_negative else 1)
            for k, (n, s) in enumerate(zip(plain.numbers(symbols), symbols, strict=True))
        }
        values = evaluated(graph, [slope[1]], point, mpmath.mp)
        kind, parts, _ = graph.nodes[slope[1]]
        terms = (
            [abs(c.numerator * values[m] / c.denominator) for c, m in parts]
            if kind == "sum"
            else [1]
        )
        size = abs(values[slope[1]]) / (max(terms) or 1)
        return size if mpmath.isfinite(size) else None
