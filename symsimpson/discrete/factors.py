"""Mass matrices of cyclic coordinates as L D L^T in symbols, where subtraction costs no digits.

At a pole of spherical angles the block of M that belongs to cyclic coordinates is singular. In
numbers the last pivot of its factorisation is then a small difference of large terms; in symbols
these cancel before any number is rounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import permutations

import sympy as sp

__all__ = ["Factors", "factorise"]

#: Up to so many coordinates every order of elimination is tried.
FEW = 3
#: Longer expressions are left as they are, and sines and cosines in those that expand to more:
#: SymPy takes seconds for them, and finds little.
LONG, LONG_EXPANDED = 60, 40
#: Factors longer than this are worth less than they cost.
TOO_LONG = 5000


@dataclass(frozen=True)
class Factors:
    """M = L D L^T for the coordinates in ``order``.

    L = 1 + fixed + moving, both strictly lower triangular; ``fixed`` does not depend on q, and
    ``moving`` vanishes where a pivot of D does, as far as that is known. ``half_angles`` lists the
    coordinates x of such places x = 0: sin x and cos x are best made of those of x/2, because
    1 - cos x = 2 sin(x/2)^2 has no subtraction. ``changing`` tells which pivots depend on q.
    """

    order: tuple[int, ...]
    fixed: tuple[tuple[sp.Expr, ...], ...]
    moving: tuple[tuple[sp.Expr, ...], ...]
    pivots: tuple[sp.Expr, ...]
    half_angles: tuple[sp.Symbol, ...]
    changing: tuple[bool, ...]


@cache
def factorise(mass: sp.ImmutableDenseMatrix | None, q: tuple[sp.Symbol, ...]) -> Factors | None:
    """Factorise in the order that gives the shortest factors, the given one if several do.

    None if they are too long to be of use.
    """
    if mass is None:
        return None
    size = mass.rows
    orders = permutations(range(size)) if size <= FEW else [tuple(range(size))]
    tried = [(order, *factors) for order in orders if (factors := _eliminate(mass, order))]
    if not tried:
        return None
    order, lower, pivots = min(tried, key=lambda f: sum(sp.count_ops(x) for x in (*f[1], *f[2])))
    halves = tuple(
        x
        for x in q
        if any(x in pivot.free_symbols and pivot.subs(x, 0) == 0 for pivot in pivots)
        and any(sp.cos(x) in entry.atoms(sp.cos) for entry in lower)
    )
    versed = {sp.cos(x): 1 - 2 * sp.sin(x / 2) ** 2 for x in halves}
    fixed = [[sp.S.Zero] * size for _ in range(size)]
    moving = [[sp.S.Zero] * size for _ in range(size)]
    for i in range(size):
        for j in range(i):
            entry = lower[i, j]
            if versed:
                entry = sp.expand(entry.xreplace(versed))
            still, rest = entry.as_independent(*q, as_Add=True)
            fixed[i][j], moving[i][j] = (still, rest) if versed else (sp.S.Zero, entry)
    return Factors(
        order,
        tuple(map(tuple, fixed)),
        tuple(map(tuple, moving)),
        tuple(pivots),
        halves,
        tuple(not pivot.free_symbols.isdisjoint(q) for pivot in pivots),
    )


def _eliminate(
    mass: sp.ImmutableDenseMatrix, order: tuple[int, ...]
) -> tuple[sp.Matrix, list[sp.Expr]] | None:
    size = len(order)
    lower = sp.eye(size)
    pivots: list[sp.Expr] = []
    for i in range(size):
        for j in range(i):
            rest = mass[order[i], order[j]]
            rest -= sp.Add(*(lower[i, k] * lower[j, k] * pivots[k] for k in range(j)))
            lower[i, j] = _tidy(rest / pivots[j])
        rest = mass[order[i], order[i]]
        rest -= sp.Add(*(lower[i, k] ** 2 * pivots[k] for k in range(i)))
        pivots.append(_tidy(rest))
        if sp.count_ops(pivots[-1]) > TOO_LONG:
            return None
    return lower, pivots


def _tidy(expression: sp.Expr) -> sp.Expr:
    """Return the shortest of a few ways to write an expression."""
    if sp.count_ops(expression) > LONG:
        return expression
    expanded = sp.expand(expression)
    candidates = [expression, expanded, sp.cancel(expression)]
    if sp.count_ops(expanded) <= LONG_EXPANDED:
        candidates.append(sp.trigsimp(expanded))
    return min(candidates, key=sp.count_ops)
