"""Energies as polynomials in the velocities, and the mass matrix they hold."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import mpmath
import sympy as sp

from symsimpson.mechanics.checks import fail, spell

__all__ = ["check_mass_matrix", "gyroscopic_and_potential", "mass_matrix_of"]

Matrix: TypeAlias = sp.ImmutableDenseMatrix

#: Samples at this many digits decide what algebra leaves open; they refuse, they never grant.
DIGITS = 60
SAMPLES = 3


def mass_matrix_of(
    system: str,
    what: str,
    energy: sp.Expr,
    v: Sequence[sp.Symbol],
    back: Mapping[sp.Basic, sp.Basic],
) -> Matrix:
    """Differentiate twice in the velocities; refuse what is not of degree two.

    Raises
    ------
    ModelError
        If the second derivatives still depend on a velocity.
    """
    rows = [[energy.diff(vi, vj) for vj in v] for vi in v]
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            if entry.free_symbols.isdisjoint(v):
                continue
            rest = sp.simplify(entry)
            if not rest.free_symbols.isdisjoint(v):
                raise fail(
                    system,
                    f"the {what} is not quadratic in the velocities: its second derivative by "
                    f"{spell(back[v[i]])} and {spell(back[v[j]])} is "
                    f"{spell(rest.xreplace(dict(back)))}.",
                    "Newton's equations follow from L = v.M(q).v/2 + a(q).v - V(q). "
                    "Write the velocities as a polynomial of degree two, without roots or "
                    "functions of them.",
                )
            rows[i][j] = rest
    return Matrix(rows)


def gyroscopic_and_potential(
    energy: sp.Expr, v: Sequence[sp.Symbol]
) -> tuple[tuple[sp.Expr, ...], sp.Expr]:
    """Split off a(q) and V(q) of L = v.M.v/2 + a.v - V."""
    rest = dict.fromkeys(v, sp.S.Zero)
    linear = tuple(energy.diff(vi).subs(rest) for vi in v)
    return linear, -energy.subs(rest)


def check_mass_matrix(
    system: str,
    mass: Matrix,
    q: Sequence[sp.Symbol],
    v: Sequence[sp.Symbol],
    parameters: Sequence[sp.Symbol],
    back: Mapping[sp.Basic, sp.Basic],
) -> None:
    """Refuse a mass matrix that is singular for all q.

    A zero row is a missing mass. A determinant that vanishes at several random points to 60
    digits vanishes identically.

    Raises
    ------
    ModelError
        With the coordinate that has no mass, where there is one.
    """
    for i, qi in enumerate(q):
        if all(sp.expand(entry) == 0 for entry in mass.row(i)):
            velocity = spell(back[v[i]])
            name = spell(back[qi])
            raise fail(
                system,
                f"the kinetic energy does not depend on {velocity}, so the mass matrix has a "
                "zero row.",
                f"A variational step needs an invertible mass matrix. Give {name} a mass "
                f"(T += m*{velocity}**2/2) or remove {name} from the coordinates.",
            )
    symbols = sorted(mass.free_symbols, key=str)
    evaluate = sp.lambdify(symbols, mass, modules="mpmath", cse=True)
    generator = random.Random(20)
    with mpmath.workdps(DIGITS):
        for _ in range(SAMPLES):
            point = [_sample(generator, s, positive=s in parameters) for s in symbols]
            try:
                value = mpmath.matrix(evaluate(*point))
                size = max(abs(entry) for entry in value)
                determinant = mpmath.det(value / size)
            except (ZeroDivisionError, ValueError, TypeError):
                return  # not a point of the domain: a run checks its own start
            if abs(determinant) > mpmath.mpf(10) ** (-DIGITS // 2):
                return
    names = ", ".join(spell(back[qi]) for qi in q)
    raise fail(
        system,
        "the mass matrix is singular for every configuration: its determinant is zero.",
        "A variational step needs an invertible mass matrix: some combination of the velocities "
        f"of {names} carries no kinetic energy. Give each body its own term, or use fewer "
        "coordinates.",
    )


def _sample(generator: random.Random, symbol: sp.Symbol, *, positive: bool) -> mpmath.mpf:
    value = mpmath.mpf(generator.randint(3 * 10**8, 10**9)) / 10**9
    negative = symbol.is_negative or symbol.is_nonpositive
    return -value if negative and positive else value
