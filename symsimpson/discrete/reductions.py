"""Parts of a system, each with its reduced equations, and symbolic L D L^T of cyclic coordinates.

The symbolic factorisation loses no digits. At a pole of spherical angles the block of M for the
cyclic coordinates is singular. A numerical factorisation would compute its last pivot as a small
difference of large terms, but symbolic terms cancel exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import permutations
from typing import ClassVar

import sympy as sp

from symsimpson.declare.plain import Plain
from symsimpson.declare.structure import MOST_AFFINE, Structure, Subsystem
from symsimpson.discrete.combined_rows import (
    Table,
    elimination_order,
    find_annihilators,
    shear_factors,
)
from symsimpson.errors import GenerationError, reject
from symsimpson.graph.read import tree_size
from symsimpson.schemes.composition import Composition
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.names import did_you_mean

#: Up to this number of coordinates, every order of elimination is tried.
FEW = 3
#: Longer expressions are not simplified, and expressions that expand to more than the second limit
#: do not go through trigsimp. SymPy needs seconds for them, and finds little.
LONG, LONG_EXPANDED = 60, 40
#: Longer factors cost more than they save.
TOO_LONG = 5000


@dataclass(frozen=True)
class Factors:
    """The factors of M = L D L^T for the coordinates in ``order``.

    L is 1 + fixed + moving, where ``fixed`` and ``moving`` are strictly lower triangular. ``fixed``
    does not depend on q. ``moving`` vanishes where a pivot of D vanishes, as far as this is known.
    If this place is x = 0, the coordinate x is one of the ``half_angles``. There sin x and cos x
    should be expressed by x/2, because 1 - cos x = 2 sin(x/2)^2 has no subtraction. ``changing``
    tells which pivots depend on q.
    """

    order: tuple[int, ...]
    fixed: tuple[tuple[sp.Expr, ...], ...]
    moving: tuple[tuple[sp.Expr, ...], ...]
    pivots: tuple[sp.Expr, ...]
    half_angles: tuple[sp.Symbol, ...]
    changing: tuple[bool, ...]


@cache
def factorise(mass: sp.ImmutableDenseMatrix | None, q: tuple[sp.Symbol, ...]) -> Factors | None:
    """Factorise M in the order with the shortest factors; the first of several such orders.

    The result is None if ``mass`` is None, or if no order has short factors and regular pivots.
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
            constant, rest = entry.as_independent(*q, as_Add=True)
            fixed[i][j], moving[i][j] = (constant, rest) if versed else (sp.S.Zero, entry)
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
        if pivots[-1].is_zero or sp.count_ops(pivots[-1]) > TOO_LONG:
            return None
    return lower, pivots


def _tidy(expression: sp.Expr) -> sp.Expr:
    """Return the shortest of a few equivalent expressions."""
    if sp.count_ops(expression) > LONG:
        return expression
    expanded = sp.expand(expression)
    candidates = [expression, expanded, sp.cancel(expression)]
    if sp.count_ops(expanded) <= LONG_EXPANDED:
        candidates.append(sp.trigsimp(expanded))
    return min(candidates, key=sp.count_ops)


#: Largest number of nodes of an entry of M for a symbolic factorisation.
LONGEST_ENTRY = 500
#: Names for ``exploit``. "all" stands for ALL, which changes a trajectory only by round-off.
ALL = ("decoupled", "cyclic", "constant_mass", "linear", "sparse")
EXPLOITABLE = (*ALL, "conformal")


class BasePart:
    """A group of coordinates that a step solves together."""

    coordinates: tuple[int, ...]

    @property
    def mass_order(self) -> tuple[int, ...]:
        """The coordinates in the order of the L D L^T of the part's block of M."""
        return self.coordinates


@dataclass(frozen=True)
class Coupled(BasePart):
    """Coordinates with general equations D_k L_d = 0, k in ``rows``, for X_m, m in ``columns``."""

    coordinates: tuple[int, ...]
    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True)
class Canonical(BasePart):
    """All coordinates of a Hamiltonian; the unknowns are rates of q and p at the nodes."""

    coordinates: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True)
class Separable(BasePart):
    """Coordinates with a constant M. The equations are the combinations ``tests`` of the D_k L_d.

    If X_d is not an unknown, it follows from D_k L_d = 0 with k = ``last`` (p0 + D_0 L_d = 0 for
    k = 0).
    """

    coordinates: tuple[int, ...]
    tests: Table
    columns: tuple[int, ...]
    last: int | None

    def last_test(self, degree: int) -> tuple[sp.Expr, ...]:
        """Return the unit vector of the row from which X_d follows."""
        return tuple(sp.Integer(k == self.last) for k in range(degree + 1))


@dataclass(frozen=True)
class Routh(BasePart):
    """Coordinates that remain after the elimination of cyclic coordinates (Routh reduction).

    ``cyclic`` has the cyclic coordinates in the order of ``factors``, the factors of their mass
    matrix. ``annihilator`` is the matrix C of the functionals that vanish for velocities of the
    path. The basis of the multipliers diagonalises the mass matrix of the cyclic coordinates at the
    node ``reference``.
    """

    coordinates: tuple[int, ...]
    rows: tuple[int, ...]
    columns: tuple[int, ...]
    cyclic: tuple[int, ...]
    annihilator: Table
    reference: int
    factors: Factors

    @property
    def mass_order(self) -> tuple[int, ...]:
        """The coordinates in the order of the L D L^T of the part's block of M, cyclic ones first.

        Back substitution yields the last coordinates first, so it can stop before the cyclic ones.
        """
        return (*self.cyclic, *self.coordinates)

    @property
    def multipliers(self) -> int:
        """Number of multipliers."""
        return len(self.annihilator) * len(self.cyclic)

    def pays(self, stages: int) -> bool:
        """Return whether the reduction saves operations in an iteration of a module with loops."""
        x, y, m = len(self.coordinates), len(self.cyclic), self.multipliers
        d, n = len(self.columns), x + y
        more = stages * (5 * y * x**2 + 12 * n) + m * (2 * d * x + 4 * stages * (d + 1)) * x
        more += m**2 * (m + 2 * d * x)
        return more < 2 * d**3 * (n**3 - x**3) / 3 + 3 * stages * d**2 * (n**2 - x**2)

    def factor_entries(self) -> dict[tuple[str, *tuple[int, ...]], sp.Expr]:
        """Map ("D", i), ("L", i, j), ("L0", i, j) to the pivots, ``moving`` and ``fixed``."""
        entries: dict[tuple[str, *tuple[int, ...]], sp.Expr] = {}
        for r, row in enumerate(self.cyclic):
            entries["D", row] = self.factors.pivots[r]
            for c, column in enumerate(self.cyclic[:r]):
                entries["L", row, column] = self.factors.moving[r][c]
                entries["L0", row, column] = self.factors.fixed[r][c]
        return entries


@dataclass(frozen=True)
class Linear(BasePart):
    """Coordinates of a linear oscillator, whose step is a product of shears.

    A shear is a pair of a flag, whether it is a kick, and two coefficients. With z = h^2 M^-1 K, a
    kick (c1, c2) is p += (M/h) (c1 z + c2 z^2) q. A drift (b, e) is q += b (M/h + e h K)^-1 p.
    """

    columns: ClassVar[tuple[int, ...]] = ()
    coordinates: tuple[int, ...]
    shears: tuple[tuple[bool, tuple[sp.Expr, sp.Expr]], ...]


@dataclass(frozen=True)
class Affine(BasePart):
    """Coordinates with D_k L_d = 0, k in ``rows``, linear in X_m, m in ``solved``."""

    columns: ClassVar[tuple[int, ...]] = ()
    coordinates: tuple[int, ...]
    rows: tuple[int, ...]
    solved: tuple[int, ...]


@dataclass(frozen=True)
class Constrained(BasePart):
    """Coordinates with constraints. The unknowns are X_m, m in ``columns``, and multipliers.

    The equations are D_k L_d = Phi(q_0 + X_k)^T mu_k, k in ``rows``, and phi(q_0 + X_m) = 0. The
    control points are Lobatto points, so constraints do not reduce the order.
    """

    coordinates: tuple[int, ...]
    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True)
class Composed(BasePart):
    """Coordinates of a composition: kicks p += h b_k L_q(q), and drifts q += h a_k M^-1 p."""

    columns: ClassVar[tuple[int, ...]] = ()
    coordinates: tuple[int, ...]
    kicks: tuple[sp.Expr, ...]
    drifts: tuple[sp.Expr, ...]


Part = Canonical | Coupled | Separable | Routh | Linear | Affine | Constrained | Composed


def read_exploit(exploit: str | Iterable[str]) -> frozenset[str]:
    """Read the argument ``exploit``: names of :data:`EXPLOITABLE`; "all" means ALL.

    Raises GenerationError for any other name.
    """
    if isinstance(exploit, str):
        exploit = (exploit,)
    wanted = tuple(exploit) if isinstance(exploit, Iterable) else (exploit,)
    for name in wanted:
        if not isinstance(name, str) or name not in ("all", *EXPLOITABLE):
            choices = ", ".join(repr(choice) for choice in EXPLOITABLE)
            reject(
                f"exploit contains {name!r}, which is unknown.{did_you_mean(name, EXPLOITABLE)}",
                remedy=f"Choose 'all', () for the general equations, or some of {choices}.",
                error=GenerationError,
            )
    return frozenset(wanted) - {"all"} | frozenset(ALL if "all" in wanted else ())


def kicks_of(scheme: Scheme) -> tuple[tuple[sp.Expr, ...], tuple[sp.Expr, ...]] | None:
    """Return kicks and drifts of a scheme: of a composition, or of straight paths between nodes.

    A straight path with nodes at its ends is a kick, a drift and a kick (Stoermer and Verlet).
    """
    if isinstance(scheme, Composition):
        return scheme.kicks, scheme.drifts
    if scheme.degree == 1 and tuple(scheme.quadrature.nodes) == (0, 1):
        return tuple(scheme.quadrature.weights), (sp.S.One,)
    return None


def reduce(structure: Structure, scheme: Scheme, exploit: frozenset[str]) -> tuple[Part, ...]:
    """Split the coordinates into parts, each with the smallest equations that its structure allows.

    ``exploit`` has the names of the properties that the reduction may use.
    """
    every = tuple(range(structure.n))
    if structure.plain.hamiltonian is not None:
        kicks = kicks_of(scheme)
        if kicks is not None and structure.separable:
            return (Composed(every, *kicks),)
        return (Canonical(every, tuple(range(1, scheme.degree + 1))),)
    if structure.plain.constraint_names:
        if isinstance(scheme, Composition):
            return (Composed(every, scheme.kicks, scheme.drifts),)
        return (Constrained(every, *elimination_order(scheme.degree)),)
    subsystems: tuple[Subsystem, ...] = structure.subsystems
    if "decoupled" not in exploit and len(subsystems) > 1:
        subsystems = (_joined(subsystems),)
    return tuple(_part(subsystem, structure.plain, scheme, exploit) for subsystem in subsystems)


def _joined(subsystems: Sequence[Subsystem]) -> Subsystem:
    return Subsystem(
        coordinates=tuple(sorted(i for s in subsystems for i in s.coordinates)),
        cyclic=tuple(sorted(i for s in subsystems for i in s.cyclic)),
        constant_mass=all(s.constant_mass for s in subsystems),
        separable=all(s.separable for s in subsystems),
        linear=all(s.linear for s in subsystems),
        affine=all(s.affine or s.linear for s in subsystems) and any(s.affine for s in subsystems),
    )


def _part(subsystem: Subsystem, plain: Plain, scheme: Scheme, exploit: frozenset[str]) -> Part:
    coordinates = subsystem.coordinates
    if isinstance(scheme, Composition):
        return Composed(coordinates, scheme.kicks, scheme.drifts)
    if subsystem.linear and "linear" in exploit and scheme.exact:
        shears = shear_factors(scheme)
        if shears is not None:
            return Linear(coordinates, shears)
    rows, columns = elimination_order(scheme.degree)
    few = len(coordinates) * scheme.degree <= MOST_AFFINE
    if subsystem.affine and "linear" in exploit and scheme.exact and few:
        return Affine(coordinates, rows, columns)
    if subsystem.separable and "constant_mass" in exploit and scheme.exact:
        return _separable(coordinates, scheme)
    others = tuple(i for i in coordinates if i not in subsystem.cyclic)
    reducible = subsystem.cyclic and others and _routh_applies(plain, subsystem.cyclic)
    if reducible and "cyclic" in exploit and (scheme.exact or scheme.by_stages):
        factors = factorise(_cyclic_mass(plain, subsystem.cyclic), plain.q)
        if factors is not None:
            cyclic = tuple(subsystem.cyclic[i] for i in factors.order)
            middle = scheme.stages // 2
            return Routh(others, rows, columns, cyclic, find_annihilators(scheme), middle, factors)
    return Coupled(coordinates, rows, columns)


def _routh_applies(plain: Plain, cyclic: Sequence[int]) -> bool:
    """Return whether no force depends on cyclic velocities, and no cyclic row of M on t or v.

    Otherwise the elimination of the cyclic velocities is not valid.
    """
    if not plain.quadratic:
        return False
    nodes = plain.graph.nodes
    v = set(plain.numbers(plain.v[i] for i in cyclic))
    masses = [plain.entry(i, j) for i in cyclic for j in range(len(plain.q))]
    return all(nodes[n].symbols.isdisjoint(v) for _, n in plain.f) and not any(
        plain.time in nodes[n].symbols for _, n in masses
    )


def _cyclic_mass(plain: Plain, cyclic: Sequence[int]) -> sp.ImmutableDenseMatrix | None:
    """Return the block of M of cyclic coordinates; None if its entries are too long."""
    entries = [plain.entry(i, j) for i in cyclic for j in cyclic]
    if any(tree_size(plain.graph, value) > LONGEST_ENTRY for value in entries):
        return None
    return sp.ImmutableDenseMatrix(len(cyclic), len(cyclic), list(map(plain.to_sympy, entries)))


def _separable(coordinates: tuple[int, ...], scheme: Scheme) -> Separable:
    d, stages = scheme.degree, range(scheme.stages)
    rows, columns = elimination_order(d)

    def unit(k: int) -> list[sp.Expr]:
        return [sp.Integer(m == k) for m in range(d + 1)]

    A, b, S = scheme.A, scheme.quadrature.weights, scheme.stiffness
    if any(b[i] * A[i][k] * A[i][d] != 0 for i in stages for k in range(d)):
        return Separable(coordinates, tuple(tuple(unit(k)) for k in rows), columns, None)
    last = d - 1  # elimination_order pairs this row with the column of X_d
    tests = []
    for k in rows:
        if k != last:
            test = unit(k)
            test[last] = sp.radsimp(-S[k][d] / S[last][d])
            tests.append(tuple(test))
    return Separable(coordinates, tuple(tests), tuple(m for m in columns if m != d), last)
