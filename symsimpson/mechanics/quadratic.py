"""Energies as polynomials in the velocities, and the mass matrix they hold."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import mpmath
import numpy as np
import sympy as sp

from symsimpson.mechanics.checks import fail, spell
from symsimpson.mechanics.terms import Sum, connected

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
    terms = Sum(energy, v)
    rows = [[sp.S.Zero] * len(v) for _ in v]
    for i, j in terms.pairs(v):
        entry = terms.diff(v[i], v[j])
        if not entry.free_symbols.isdisjoint(v):
            rest = sp.simplify(entry)
            if not rest.free_symbols.isdisjoint(v):
                raise fail(
                    system,
                    f"the {what} is not quadratic in the velocities: its second derivative by "
                    f"{spell(back[v[j]])} and {spell(back[v[i]])} is "
                    f"{spell(rest.xreplace(dict(back)))}.",
                    "Newton's equations follow from L = v.M(q).v/2 + a(q).v - V(q). "
                    "Write the velocities as a polynomial of degree two, without roots or "
                    "functions of them.",
                )
            entry = rest
        rows[i][j] = rows[j][i] = entry
    return Matrix(rows)


def gyroscopic_and_potential(
    energy: sp.Expr, v: Sequence[sp.Symbol]
) -> tuple[tuple[sp.Expr, ...], sp.Expr]:
    """Split off a(q) and V(q) of L = v.M.v/2 + a.v - V."""
    terms = Sum(energy)
    moving = set(v)

    def at_rest(expression: sp.Expr) -> sp.Expr:
        present = expression.free_symbols & moving
        return expression.subs(dict.fromkeys(present, sp.S.Zero)) if present else expression

    linear = tuple(sp.Add(*(at_rest(t.diff(vi)) for t in terms.having(vi))) for vi in v)
    return linear, -sp.Add(*map(at_rest, terms.terms))


def check_degenerate(
    system: str,
    mass: Matrix,
    gyroscopic: Sequence[sp.Expr],
    q: Sequence[sp.Symbol],
    back: Mapping[sp.Basic, sp.Basic],
) -> None:
    """Refuse coordinates whose velocities enter L linearly alone, or not at all beside others'.

    Raises
    ------
    ModelError
    """
    coupled = set().union(*(a.free_symbols for a in gyroscopic))
    entries = mass.todok()
    for i, x in enumerate(q):
        massless = not any(i in place for place in entries)
        if massless and (gyroscopic[i] != 0 or x in coupled):
            name = spell(back[x])
            raise fail(
                system,
                f"the Lagrangian is degenerate: it has no term quadratic in {name}', only ones "
                "linear in the velocities.",
                "Its equations of motion are of first order (point vortices, Lotka and Volterra's "
                "equations, guiding centres), and such systems are not integrated here: they need "
                f"another kind of step. If {name} has a mass, add its kinetic energy.",
            )


def check_mass_matrix(
    system: str,
    mass: Matrix,
    q: Sequence[sp.Symbol],
    v: Sequence[sp.Symbol],
    parameters: Sequence[sp.Symbol],
    back: Mapping[sp.Basic, sp.Basic],
) -> None:
    """Refuse a mass matrix that is singular for all q, or negative for some velocity.

    A zero row is a missing mass. A determinant that vanishes at several random points to 60
    digits vanishes identically.

    Raises
    ------
    ModelError
        With the coordinate that has no mass, where there is one.
    """
    blocks = _blocks(mass)
    for i, *others in blocks:
        if not others and sp.expand(mass[i, i]) == 0:
            velocity = spell(back[v[i]])
            name = spell(back[q[i]])
            raise fail(
                system,
                f"the kinetic energy does not depend on {velocity}, so the mass matrix has a "
                "zero row.",
                f"A variational step needs an invertible mass matrix. Give {name} a mass "
                f"(T += m*{velocity}**2/2) or remove {name} from the coordinates.",
            )
    for i in range(mass.rows):
        if sp.expand(mass[i, i]).is_negative:
            raise fail(
                system,
                f"the kinetic energy is negative for every {spell(back[v[i]])}: M is not positive "
                "definite.",
                "Masses are positive. Look at the sign of that term in T, or at the sign that a "
                "symbol was declared with.",
            )
    if all(_regular(mass, block, parameters) for block in blocks):
        return
    names = ", ".join(spell(back[qi]) for qi in q)
    raise fail(
        system,
        "the mass matrix is singular for every configuration: its determinant is zero.",
        "A variational step needs an invertible mass matrix: some combination of the velocities "
        f"of {names} carries no kinetic energy. Give each body its own term, or use fewer "
        "coordinates.",
    )


def _blocks(mass: Matrix) -> list[list[int]]:
    """Split the coordinates into groups that no entry of M couples."""
    size = mass.rows
    entries = mass.todok()  # the nonzero ones
    return connected(size, ((i, j) for (i, j), entry in entries.items() if sp.expand(entry) != 0))


def _regular(mass: Matrix, block: Sequence[int], parameters: Sequence[sp.Symbol]) -> bool:
    """Tell whether a block of M is regular at some point; an unclear one counts as regular."""
    places = [(i, j) for i in block for j in block if mass[i, j] != 0]
    symbols = sorted(set().union(*(mass[place].free_symbols for place in places)), key=str)
    evaluate = sp.lambdify(symbols, [mass[place] for place in places], modules="mpmath")
    generator = random.Random(20)
    number = {i: k for k, i in enumerate(block)}
    with mpmath.workdps(DIGITS):
        for _ in range(SAMPLES):
            point = [_sample(generator, s, positive=s in parameters) for s in symbols]
            try:
                values = evaluate(*point)
                size = max(abs(value) for value in values)
                scaled = mpmath.matrix(len(block))
                for (i, j), value in zip(places, values, strict=True):
                    scaled[number[i], number[j]] = value / size
                if _clearly_regular(scaled):
                    return True
                determinant = mpmath.det(scaled)
            except (ZeroDivisionError, ValueError, TypeError):
                return True  # not a point of the domain: a run checks its own start
            if abs(determinant) > mpmath.mpf(10) ** (-DIGITS // 2):
                return True
    return False


def _clearly_regular(matrix: mpmath.matrix) -> bool:
    """Tell it from the singular values in ordinary precision, where that suffices."""
    ordinary = np.array([[float(mpmath.re(x)) for x in row] for row in matrix.tolist()])
    return bool(np.isfinite(ordinary).all() and np.linalg.cond(ordinary) < 1e8)


def _sample(generator: random.Random, symbol: sp.Symbol, *, positive: bool) -> mpmath.mpf:
    value = mpmath.mpf(generator.randint(3 * 10**8, 10**9)) / 10**9
    negative = symbol.is_negative or symbol.is_nonpositive
    return -value if negative and positive else value
