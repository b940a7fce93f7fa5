"""Systems in LaTeX. Names of symbols are untrusted: odd ones are replaced."""

from __future__ import annotations

import re
from typing import Any

import sympy as sp
from sympy.printing.latex import greek_letters_set, other_symbols

from symsimpson.mechanics.coordinates import time
from symsimpson.mechanics.equations_of_motion import terms
from symsimpson.support.markup import aligned, in_text

__all__ = ["system"]

#: Names that SymPy may typeset as they are: letters of any alphabet, or a Greek one by its LaTeX
#: name, with a subscript and primes behind it.
PLAIN = re.compile(r"([^\W\d_]\w*|\\(?P<macro>[A-Za-z]+)(_\w+)?)(_\{\w+\})?'*")
#: Commands of LaTeX that are letters.
LETTERS = greek_letters_set | other_symbols
#: Equations of motion are shown for so many coordinates, with so many operations.
SHOWN, MOST_OPERATIONS = 4, 300


def system(declared: Any) -> str:
    """Return T, V, M and, for few coordinates, the equations of motion."""
    try:
        return _equations(declared)
    except RecursionError:
        return _too_long(declared)


def _too_long(declared: Any) -> str:
    text = rf"{in_text(declared.name)}: {declared.n} coordinates, T and V too long to be shown"
    return rf"$\text{{{text}}}$"


def _equations(declared: Any) -> str:
    if declared.too_large_for_sympy:
        return _too_long(declared)
    from sympy.physics.vector import vlatex  # long to import

    safe = _safe(declared)
    kinetic, potential = (
        sp.sympify(x).xreplace(safe) for x in (declared.kinetic, declared.potential)
    )
    lines = [("T", kinetic), ("V", potential)]
    held = (*declared.constraints.values(), *declared.velocity_constraints.values())
    lines += [("0", sp.sympify(expression).xreplace(safe)) for expression in held]
    m = len(held)
    multipliers = [sp.Symbol(f"lambda_{k + 1}" if m > 1 else "lambda") for k in range(m)]
    if declared.n <= SHOWN:
        lines.append(("M", declared.mass_matrix.xreplace(safe)))
        equations = zip(declared.coordinates, terms(declared, multipliers), strict=True)
        for q, (moment, slope, pull) in equations:
            name, moment, force = (x.xreplace(safe) for x in (q, moment, slope + pull))
            if sp.count_ops([moment, force]) > MOST_OPERATIONS:
                break
            label = vlatex(name)
            lines.append((f"p_{{{label}}}", moment))
            lines.append((rf"\dot{{p}}_{{{label}}}", force))
    return aligned([(left, vlatex(right)) for left, right in lines])


def _safe(declared: Any) -> dict[Any, Any]:
    """Map what is named oddly to plain symbols."""
    replace: dict[Any, Any] = {
        a: sp.Symbol(f"a_{i}") for i, a in enumerate(declared.parameters) if not _is_plain(a.name)
    }
    for i, q in enumerate(declared.coordinates):
        if not _is_plain(q.func.__name__):
            plain = sp.Function(f"q_{i}")(time)
            replace |= {q: plain, q.diff(time): plain.diff(time)}
    return replace


def _is_plain(name: str) -> bool:
    """Return whether a name is typeset as it is: of LaTeX's commands, letters alone."""
    match = PLAIN.fullmatch(name)
    macro = match and match["macro"]
    return match is not None and (macro is None or macro.removeprefix("var").lower() in LETTERS)
