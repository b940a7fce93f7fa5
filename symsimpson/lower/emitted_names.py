"""Names in emitted code: the user's where they are safe, our own where they are not."""

from __future__ import annotations

import builtins
import keyword
import re
import unicodedata
from collections.abc import Iterable
from functools import cache

import sympy as sp

from symsimpson.declare.plain import Plain
from symsimpson.declare.system import MechanicalSystem
from symsimpson.text.interface import KERNELS
from symsimpson.text.library import kernel_sources, library_sources
from symsimpson.text.workspace_layout import BLOCKS

#: What a module imports, names in its kernels, and defines beside what its library knows of: words,
#: constants, and functions of the system that kernels call. No symbol takes one of these names.
OWN = """
    math numpy np numba carray cfunc njit array real int sum len zip tuple max min abs range pi
    sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp log sqrt erf erfc sincos
    compiled W h t workspace lane step node smooth term variation
    SIGNATURE INTERFACE OPTIONS FACTS ROWS NEWTON_UNKNOWNS STRAIGHT FRESH EULER_GAMMA CATALAN TINY
    step_equations jet forces gradient mass gyroscopic potential pushes parameter_slopes cost_slopes
    time_rate constrain constraint_slopes constraint_values constraint_parameter_slopes
    node_curvature point_curvature node_power hold_velocities rates rate_parameter_slopes
    carried_slopes carried_parameter_slopes differentiate_end move_variation
"""


@cache
def reserved_names() -> frozenset[str]:
    """Return the names that have a meaning in a module."""
    sources = library_sources()
    texts = (*sources.values(), *kernel_sources().values())
    constants = re.findall(r"\b[A-Z][A-Z_0-9]+\b", "\n".join(texts))
    return frozenset([*OWN.split(), *KERNELS, *sources, *BLOCKS, *constants])


def _spell_out(name: str) -> str:
    """Write Greek letters as words, and remove the TeX marks of indices."""
    letters = []
    for letter in name:
        greek = re.fullmatch("GREEK (SMALL|CAPITAL) LETTER ([A-Z]+)", unicodedata.name(letter, ""))
        if greek:
            letter = greek[2].lower() if greek[1] == "SMALL" else greek[2].capitalize()
        letters.append(letter)
    return "".join(letters).replace("_{", "_").replace("}", "").replace("'", "_prime")


def _plain_names(names: Iterable[str], kind: str) -> tuple[str, ...]:
    """Return names for a module; names that are not plain text become numbers."""
    plain = re.compile(r"[A-Za-z][A-Za-z0-9_ ]{0,63}")
    return tuple(name if plain.fullmatch(name) else f"{kind} {i}" for i, name in enumerate(names))


class NameTable:
    """Gives every symbol of a module its own identifier.

    A SymPy symbol's name is untrusted text. It is used only if it is a plain ASCII identifier of
    moderate length that clashes with nothing. Greek letters are written out. Reserved words get an
    underscore at the end. All other names are replaced by ``q0``, ``a0`` and so on.
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
        self.invariants = _plain_names(system.plain.invariants, "invariant")
        self.forces = _plain_names(system.plain.forces, "force")
        self.constraints = _plain_names(system.plain.constraint_names, "constraint")

    def of(self, plain: Plain, symbols: Iterable[sp.Symbol]) -> tuple[str, ...]:
        """Return the names of plain symbols of parameters and inputs, of h and t."""
        names = (*self.parameters, *self.inputs)
        name_of = dict(zip((*plain.parameters, *plain.u), names, strict=True))
        name_of |= {plain.step[0]: "h", plain.t: "t"}
        return tuple(name_of[symbol] for symbol in symbols)

    def _user(self, name: str, substitute: str) -> str:
        plain = _spell_out(name)
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,31}", plain):
            plain = substitute
        elif (
            keyword.iskeyword(plain)
            or keyword.issoftkeyword(plain)
            or hasattr(builtins, plain)
            or plain in reserved_names()
        ):
            plain += "_"
        if re.fullmatch(r"[A-Z][A-Z_0-9]*_[A-Z_0-9]*", plain):
            plain = substitute
        return self.fresh(plain)

    def fresh(self, hint: str) -> str:
        """Return an unused name: the hint, or the hint and a number."""
        name, count = hint, 1
        while name in self._taken or name in reserved_names():
            count += 1
            name = f"{hint}_{count}"
        self._taken.add(name)
        return name
