"""SymPy expressions as Python text, from an allow-list of node types."""

from __future__ import annotations

import sys
from typing import Any

import sympy as sp
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.str import StrPrinter

from symsimpson.errors import GenerationError

__all__ = ["FUNCTIONS", "LARGE", "NAMED_CONSTANTS", "Printer", "count_operations"]

#: SymPy functions and their names in :mod:`math`; every binding supplies these names.
FUNCTIONS = {
    sp.sin: "sin",
    sp.cos: "cos",
    sp.tan: "tan",
    sp.asin: "asin",
    sp.acos: "acos",
    sp.atan: "atan",
    sp.atan2: "atan2",
    sp.sinh: "sinh",
    sp.cosh: "cosh",
    sp.tanh: "tanh",
    sp.asinh: "asinh",
    sp.acosh: "acosh",
    sp.atanh: "atanh",
    sp.exp: "exp",
    sp.log: "log",
    sp.erf: "erf",
    sp.erfc: "erfc",
}
#: Numbers without a formula: their names in a module, where they stand as doubles, and their
#: values; a binding of more digits has its own.
NAMED_CONSTANTS = {
    "EULER_GAMMA": float(sp.EulerGamma.evalf(20)),
    "CATALAN": float(sp.Catalan.evalf(20)),
}


#: Integers from here on are no exact doubles, and soon none that fit into 64 bits.
LARGE = 2**53


class Printer(StrPrinter):
    """Prints arithmetic, powers and the functions of :data:`FUNCTIONS`, and refuses the rest.

    ``used`` collects the functions met, ``constants`` the named numbers. With ``exact`` set,
    integers in quotients become ``real(...)``, so that a constant has the precision of the binding.
    """

    def __init__(self, *, exact: bool = False) -> None:
        super().__init__({"order": "none"})
        self.used: set[str] = set()
        self.constants: set[str] = set()
        self._exact = exact

    def _print_Integer(self, expr: sp.Integer) -> str:
        large = self._exact and abs(expr.p) >= LARGE
        return f"real({_within(expr, expr.p)})" if large else str(expr.p)

    def _print_Rational(self, expr: sp.Rational) -> str:
        p, q = _within(expr, expr.p), _within(expr, expr.q)
        return f"real({p})/{q}" if self._exact else f"{p}/{q}"

    def _print_Float(self, expr: sp.Float) -> str:
        return repr(float(_within(expr, expr)))

    def _print_Pi(self, expr: sp.Expr) -> str:
        self.used.add("pi")
        return "pi"

    def _print_EulerGamma(self, expr: sp.Expr) -> str:
        return self._named("EULER_GAMMA")

    def _print_Catalan(self, expr: sp.Expr) -> str:
        return self._named("CATALAN")

    def _named(self, name: str) -> str:
        self.constants.add(name)
        return name

    def _print_GoldenRatio(self, expr: sp.Expr) -> str:
        return f"({self._print(expr.expand(func=True))})"

    _print_TribonacciConstant = _print_GoldenRatio

    def _print_Exp1(self, expr: sp.Expr) -> str:
        self.used.add("exp")
        return "exp(real(1))"

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:
        base, exponent = expr.as_base_exp()
        if exponent.is_Rational and exponent.q in (2, 4):
            # compilers write loops over square roots as vector code, not those over powers
            self.used.add("sqrt")
            argument = self._print(base)
            whole, rest = divmod(abs(exponent), 1)
            root = f"sqrt(real({argument}))" if base.is_Integer else f"sqrt({argument})"
            roots = {2: [root], 1: [f"sqrt({root})"], 3: [root, f"sqrt({root})"]}[int(4 * rest)]
            factor = self.parenthesize(base**whole, PRECEDENCE["Mul"])
            power = "*".join([*([factor] if whole else []), *roots])
            single = not whole and len(roots) == 1
            if exponent > 0:
                return power if single else f"({power})"
            return f"1/{power}" if single else f"1/({power})"
        if exponent.is_Integer and exponent < 0:
            return f"1/{self.parenthesize(base**-exponent, PRECEDENCE['Pow'])}"
        left = self.parenthesize(base, PRECEDENCE["Pow"], strict=False)
        return f"{left}**{self.parenthesize(exponent, PRECEDENCE['Pow'], strict=False)}"

    def _print_Function(self, expr: sp.Expr) -> str:
        name = FUNCTIONS.get(expr.func)
        if name is None:
            return self.emptyPrinter(expr)
        self.used.add(name)
        return f"{name}({', '.join(self._print(a) for a in expr.args)})"

    _print_sin = _print_cos = _print_exp = _print_log = _print_Function

    def _print_Abs(self, expr: sp.Expr) -> str:
        return f"abs({self._print(expr.args[0])})"

    def _print_ExpBase(self, expr: sp.Expr) -> str:
        return self._print_Function(expr)

    def emptyPrinter(self, expr: Any) -> str:
        """Refuse what no binding can evaluate."""
        raise GenerationError(
            f"cannot write {type(expr).__name__} {expr} as code.\n"
            "Use elementary functions, powers and numbers in T and V."
        )


def _within(number: sp.Expr, part: Any) -> Any:
    """Return a part of a number that has a value in doubles; others are refused."""
    if abs(part) <= sys.float_info.max:
        return part
    raise GenerationError(
        f"cannot write the number {sp.N(number, 3)} as code: it, its numerator or its denominator "
        "is larger than doubles can be.\nChoose other units, or write it as a sympy.Float."
    )


def count_operations(expression: sp.Expr) -> int:
    """Count additions, multiplications, divisions, powers and function calls."""
    return int(sp.count_ops(expression))
