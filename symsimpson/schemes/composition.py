"""Explicit schemes: compositions of kicks and drifts, for constant M and forces f(q)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import accumulate, pairwise

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from symsimpson.errors import SchemeError, reject
from symsimpson.schemes.quadrature import Quadrature
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.markup import aligned
from symsimpson.support.names import did_you_mean

Coefficients = tuple[tuple[sp.Expr, ...], tuple[sp.Expr, ...]]


@dataclass(frozen=True, repr=False)
class Composition(Scheme):
    r"""A symmetric composition of kicks p += h b_k L_q(q) and drifts q += h a_k M^-1 p.

    A composition is a variational integrator. Its path consists of straight lines through
    X_0 = q0, X_1, ..., X_m = q1, each with a fraction a_k of the step. The discrete Lagrangian is

    .. math:: L_d = h \sum_{k=1}^m a_k T\Bigl(\frac{X_k - X_{k-1}}{a_k h}\Bigr)
        - h \sum_{k=0}^m b_k V(X_k).

    Attributes
    ----------
    name : str
        The name of the scheme for ``compile``.
    quadrature : Quadrature
        The times c_k = a_1 + ... + a_k of the kicks, and their weights b_k.
    degree : int
        The degree of each part of the path, 1.
    drifts : tuple of sympy numbers
        The fractions a_k of the step.
    source : str
        The publication of the coefficients.

    References
    ----------
    .. [1] E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), sections II.4,
       V.3 and VI.6.2.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.composition("suzuki4").order, len(ss.composition("suzuki4").kicks)
    (4, 6)
    """

    drifts: tuple[sp.Expr, ...] = field(repr=False)
    source: str = field(repr=False)

    @property
    def kicks(self) -> tuple[sp.Expr, ...]:
        """The weights b_k."""
        return self.quadrature.weights

    @property
    def of_verlet(self) -> bool:
        """True if the scheme is a composition of Verlet steps.

        If it is, any flow may replace the kicks.
        """
        between = zip((0, *self.drifts), (*self.drifts, 0), strict=True)
        return all(
            sp.simplify(kick - (a + b) / 2) == 0
            for kick, (a, b) in zip(self.kicks, between, strict=True)
        )

    @property
    def order(self) -> int:
        """Order of consistency."""
        return self.quadrature.order

    @property
    def unbounded(self) -> bool:
        """False: a linear oscillator is unstable at large steps."""
        return False

    @property
    def formula(self) -> Sequence[str]:
        """The discrete Lagrangian, as lines of text."""
        m = len(self.drifts)
        return (
            "    L_d(X_0, ..., X_m) = h sum_k a_k T((X_k - X_k-1)/(h a_k)) - h sum_k b_k V(X_k),",
            f"    m = {m}, X_0 = q0, X_m = q1: {m + 1} kicks p += h b_k L_q(X_k), and between them",
            f"    {m} drifts X_k = X_k-1 + h a_k M^-1 p",
        )

    @property
    def legend(self) -> str:
        """The legend of the tables."""
        return "weights b_k of the kicks, shares a_k of the drifts"

    @property
    def references(self) -> Sequence[str]:
        """The publication, as lines of text."""
        return (f"{self.source}.",)

    @cached_property
    def tables(self) -> Mapping[str, tuple[sp.Expr, ...]]:
        """The coefficients by their names in modules."""
        return {"KICKS": self.kicks, "DRIFTS": self.drifts}

    def oscillator(self, x: float) -> NDArray[np.float64]:
        """Return the matrix of a step with h = x of the oscillator q'' = -q.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> round(float(np.linalg.det(ss.composition("kahan_li8").oscillator(0.5))), 12)
        1.0
        """
        matrix = np.eye(2)
        for k, kick in enumerate(self.kicks):
            matrix = np.array([[1.0, 0.0], [-x * float(kick), 1.0]]) @ matrix
            if k < len(self.drifts):
                matrix = np.array([[1.0, x * float(self.drifts[k])], [0.0, 1.0]]) @ matrix
        return matrix

    def _repr_latex_(self) -> str:
        tables = ("b_k", self.kicks), ("a_k", self.drifts)
        rows = [(name, sp.latex(sp.Matrix([table]).evalf(6))) for name, table in tables]
        return aligned([self._title(f"{len(self.drifts)} drifts"), *rows])

    def __repr__(self) -> str:
        return f"Composition({self.name!r}: {len(self.drifts)} drifts, order {self.order})"


def composition(name: str) -> Composition:
    """Return an explicit scheme by its name.

    Explicit schemes are for systems with constant M and forces that depend on positions only.

    Parameters
    ----------
    name : {"suzuki4", "blanes_moan4", "blanes_moan6", "kahan_li6", "kahan_li8"}
        The name, which ends with the order. The explicit scheme of order 2 is "lobatto2".

    Returns
    -------
    Composition

    Raises
    ------
    SchemeError
        If no composition has this name.

    Notes
    -----
    The coefficients of Blanes and Moan have 15 digits, those by Kahan and Li have 26. More digits
    do not reduce errors further.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.composition("kahan_li8")
    Composition('kahan_li8': 17 drifts, order 8)
    """
    if not isinstance(name, str) or name not in COMPOSITIONS:
        choices = ", ".join(repr(choice) for choice in COMPOSITIONS)
        hint = did_you_mean(name, COMPOSITIONS)
        reject(
            f"there is no composition {name!r}.{hint}",
            remedy=f"Choose one of {choices}.",
            error=SchemeError,
        )
    return _composition(name)


@cache
def _composition(name: str) -> Composition:
    """Make each composition once."""
    order, source, make = COMPOSITIONS[name]
    kicks, drifts = make()
    times = tuple(accumulate(drifts, initial=sp.S.Zero))
    return Composition(name, Quadrature("composition", times, kicks, order), 1, drifts, source)


def _palindrome(text: str, middle: int) -> tuple[sp.Expr, ...]:
    """Read half of a palindrome, and add one or two middle numbers so that the sum is 1."""
    half = [sp.Rational(number) for number in text.split()]
    return (*half, *[(1 - 2 * sp.Add(*half)) / middle] * middle, *reversed(half))


def _of_verlet(steps: Sequence[sp.Expr]) -> Coefficients:
    """Return the coefficients of a composition of Stoermer-Verlet steps."""
    kicks = [(a + b) / 2 for a, b in pairwise((sp.S.Zero, *steps, sp.S.Zero))]
    return tuple(kicks), tuple(steps)


def _suzuki4() -> Coefficients:
    outer = sp.radsimp(1 / (4 - sp.cbrt(4)))
    return _of_verlet((outer, outer, 1 - 4 * outer, outer, outer))


def _kahan_li6() -> Coefficients:
    steps = """
        0.39216144400731413927925056  0.33259913678935943859974864
        -0.70624617255763935980996482 0.08221359629355080023149045
        """
    return _of_verlet(_palindrome(steps, 1))


def _kahan_li8() -> Coefficients:
    steps = """
        0.13020248308889008087881763  0.56116298177510838456196441
        -0.38947496264484728640807860 0.15884190655515560089621075
        -0.39590389413323757733623154 0.18453964097831570709183254
        0.25837438768632204729397911  0.29501172360931029887096624
        """
    return _of_verlet(_palindrome(steps, 1))


def _blanes_moan4() -> Coefficients:
    kicks = "0.0829844064174052 0.396309801498368 -0.0390563049223486"
    drifts = "0.245298957184271 0.604872665711080"
    return _palindrome(kicks, 1), _palindrome(drifts, 2)


def _blanes_moan6() -> Coefficients:
    kicks = """
        0.0414649985182624 0.198128671918067 -0.0400061921041533 0.0752539843015807
        -0.0115113874206879
        """
    drifts = """
        0.123229775946271 0.290553797799558 -0.127049212625417 -0.246331761062075
        0.357208872795928
        """
    return _palindrome(kicks, 2), _palindrome(drifts, 1)


_KAHAN_LI = "W. Kahan, R.-C. Li, Mathematics of Computation 66 (1997) 1089-1099"
_BLANES_MOAN = "S. Blanes, P. C. Moan, J. Comput. Appl. Math. 142 (2002) 313-330"
#: Order, source and coefficients. The schemes of Blanes and Moan are Runge-Kutta-Nystroem methods.
COMPOSITIONS: dict[str, tuple[int, str, Callable[[], Coefficients]]] = {
    "suzuki4": (4, "M. Suzuki, Physics Letters A 146 (1990) 319-323", _suzuki4),
    "blanes_moan4": (4, f"{_BLANES_MOAN}, SRKN6b", _blanes_moan4),
    "blanes_moan6": (6, f"{_BLANES_MOAN}, SRKN11b", _blanes_moan6),
    "kahan_li6": (6, f"{_KAHAN_LI}, s9odr6a", _kahan_li6),
    "kahan_li8": (8, f"{_KAHAN_LI}, s17odr8a", _kahan_li8),
}
