"""Names in emitted code: the user's where they are safe, our own where they are not."""

from __future__ import annotations

import builtins
import keyword
import re
import unicodedata
from collections.abc import Iterable
from functools import cache

import sympy as sp

from symsimpson.codegen.library import library_sources
from symsimpson.mechanics.plain import Plain
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.module.interface import KERNELS
from symsimpson.module.workspace_layout import BLOCKS

__all__ = ["NameTable"]

#: What an emitted module defines or imports; no symbol may take these names.
RESERVED = frozenset(BLOCKS) | frozenset(
    [
        "math",
        "numpy",
        "np",
        "numba",
        "carray",
        "cfunc",
        "njit",
        "real",
        "pi",
        "sincos",
        "compiled",
        "W",
        "h",
        "t",
        "workspace",
        "lane",
        "step",
        "int",
        "node",
        "KICKS",
        "DRIFTS",
        "STRAIGHT",
        "STRIDE",
        "MANY",
        "FRESH",
        "TURN",
        "LOST",
        "ROUNDING",
        "smooth",
        "DIGITS",
        "STAGE_TABLE",
        "REACHED_BY_MOVES",
        "sum",
        "len",
        "zip",
        "tuple",
        "LANES",
        "ROWS",
        "OPTIONS",
        "SIGNATURE",
        "INTERFACE",
        "FACTS",
        "INFINITE",
        "NEGLIGIBLE",
        "QUADRATIC",
        "STAGNATION",
        "ROUNDED",
        "MOST_CORRECTIONS",
        "FAR",
        "UNRESOLVED",
        "LARGE_CHANGE",
        "DEGREE",
        "NODES",
        "DIMENSION",
        "UNKNOWNS",
        "NEWTON_UNKNOWNS",
        "POINTS",
        "array",
        "term",
        "max",
        "min",
        "abs",
        "range",
        "VARIED",
        "VARIED_FROM",
        "HESSIAN_SIZE",
        "CURVATURE_ROW",
        "CURVATURE_COLUMN",
        "POINT_ROW",
        "POINT_COLUMN",
        "variation",
        "TANGENT_UNKNOWNS",
        "TANGENT_LOWER",
        "TANGENT_UPPER",
        "TANGENT_STRIDE",
        "TANGENT_OFFSET",
        "F_A_FROM",
        "F_A_PLACE",
        "P_A_FROM",
        "P_A_PLACE",
        "CONSTRAINTS",
        "INPUTS",
        "INPUT_STRIDE",
        "EULER_GAMMA",
        "CATALAN",
        "erf",
        "erfc",
        "ROW_ORDER",
        "COLUMN_ORDER",
        "WEIGHTS",
        "BASIS",
        "BASIS_SLOPE",
        "EXTRAPOLATION",
        "END_SLOPE",
        "START_SLOPE",
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "atan2",
        "sinh",
        "cosh",
        "tanh",
        "asinh",
        "acosh",
        "atanh",
        "exp",
        "log",
        "sqrt",
    ]
)


#: Functions that loops over nodes call.
NODE_FUNCTIONS = frozenset(
    [
        "jet",
        "forces",
        "gradient",
        "mass",
        "gyroscopic",
        "potential",
        "constraint_slopes",
        "constrain",
        "constraint_values",
        "pushes",
        "parameter_slopes",
        "cost_slopes",
        "node_curvature",
        "point_curvature",
        "constraint_parameter_slopes",
        "time_rate",
    ]
)


@cache
def library_names() -> frozenset[str]:
    """Return the names of functions of the module."""
    return NODE_FUNCTIONS | frozenset(KERNELS) | frozenset(library_sources())


def _written_out(name: str) -> str:
    """Write Greek letters as words, and what TeX has around indices not at all."""
    letters = []
    for letter in name:
        greek = re.fullmatch("GREEK (SMALL|CAPITAL) LETTER ([A-Z]+)", unicodedata.name(letter, ""))
        if greek:
            letter = greek[2].lower() if greek[1] == "SMALL" else greek[2].capitalize()
        letters.append(letter)
    return "".join(letters).replace("_{", "_").replace("}", "").replace("'", "_prime")


def _shown(names: Iterable[str], kind: str) -> tuple[str, ...]:
    """Return names as modules write them, a number where one is no plain text."""
    plain = re.compile(r"[A-Za-z][A-Za-z0-9_ ]{0,63}")
    return tuple(name if plain.fullmatch(name) else f"{kind} {i}" for i, name in enumerate(names))


class NameTable:
    """Gives every symbol of a module its own identifier.

    A SymPy symbol's name is untrusted text. It is used only where it is a plain ASCII identifier
    of moderate length that clashes with nothing. Greek letters are written out, and an underscore
    goes behind words that mean something in a module; for other names ``q0``, ``a0``, ... stand.
    """

    def __init__(self, system: MechanicalSystem) -> None:
        self._taken: set[str] = set()
        self.coordinates = tuple(
            self._user(q.func.__name__, f"q{i}") for i, q in enumerate(system.coordinates)
        )
        self.parameters = tuple(
            self._user(a.name, f"a{i}") for i, a in enumerate(system.parameters)
        )
        self.inputs = tuple(
            self._user(str(u).partition("(")[0], f"u{i}") for i, u in enumerate(system.inputs)
        )
        self.invariants = _shown(system.plain.invariants, "invariant")
        self.forces = _shown(system.plain.forces, "force")
        self.constraints = _shown(system.plain.held, "constraint")

    def of(self, plain: Plain, symbols: Iterable[sp.Symbol]) -> tuple[str, ...]:
        """Return the names of plain symbols of parameters and inputs, of h and t."""
        names = (*self.parameters, *self.inputs)
        name_of = dict(zip((*plain.parameters, *plain.u), names, strict=True))
        name_of |= {plain.step[0]: "h", plain.t: "t"}
        return tuple(name_of[symbol] for symbol in symbols)

    def _user(self, name: str, substitute: str) -> str:
        plain = _written_out(name)
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,31}", plain):
            plain = substitute
        elif (
            keyword.iskeyword(plain)
            or keyword.issoftkeyword(plain)
            or hasattr(builtins, plain)
            or plain in RESERVED
            or plain in library_names()
        ):
            plain += "_"
        if re.fullmatch(r"[A-Z][A-Z_0-9]*_[A-Z_0-9]*", plain):
            plain = substitute
        return self.fresh(plain)

    def fresh(self, hint: str) -> str:
        """Return the name that is hinted at, or that and a number."""
        name, count = hint, 1
        while name in self._taken or name in RESERVED or name in library_names():
            count += 1
            name = f"{hint}_{count}"
        self._taken.add(name)
        return name
