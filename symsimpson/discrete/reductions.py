"""Mass matrices of cyclic coordinates as L D L^T in symbols, where subtraction costs no digits.

At a pole of spherical angles the block of M that belongs to cyclic coordinates is singular. In
numbers the last pivot of its factorisation is then a small difference of large terms; in symbols
these cancel before any number is rounded.
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
from symsimpson.discrete.combined_rows import Table, annihilating, elimination_order, shear_factors
from symsimpson.errors import GenerationError, reject
from symsimpson.graph.read import tree_size
from symsimpson.schemes.composition import Composition
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.names import did_you_mean

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


#: Mass matrices with entries of more nodes than this are not factorised in symbols.
LONGEST_ENTRY = 500
#: What ``exploit`` can name: "all", which leaves the trajectory what it is, and what changes it.
ALL = ("decoupled", "cyclic", "constant_mass", "linear", "sparse")
EXPLOITABLE = (*ALL, "conformal")


class BasePart:
    """Coordinates that are solved together."""

    coordinates: tuple[int, ...]

    @property
    def mass_order(self) -> tuple[int, ...]:
        """The coordinates of the part's block of M, in the order of its L D L^T."""
        return self.coordinates


@dataclass(frozen=True)
class Coupled(BasePart):
    """Coordinates whose increments X_m, m in ``columns``, solve D_k L_d = 0, k in ``rows``."""

    coordinates: tuple[int, ...]
    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True)
class Separable(BasePart):
    """Coordinates with constant M, whose equations are combinations ``tests`` of the D_k L_d.

    Where X_d is no unknown, it solves D_k L_d = 0 (p0 + D_0 L_d = 0 for k = 0) for k = ``last``.
    """

    coordinates: tuple[int, ...]
    tests: Table
    columns: tuple[int, ...]
    last: int | None

    def last_test(self, degree: int) -> tuple[sp.Expr, ...]:
        """Return the unit vector that selects the row from which X_d follows."""
        return tuple(sp.Integer(k == self.last) for k in range(degree + 1))


@dataclass(frozen=True)
class Routh(BasePart):
    """Coordinates that stay after others, the cyclic ones, are eliminated by their momenta.

    The latter stand in the order of ``factors``, those of their mass matrix. ``annihilator`` is
    C. The multipliers are written in the basis in which the mass matrix of the cyclic coordinates
    is diagonal at node ``reference``.
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
        """The coordinates of the part's block of M, cyclic ones first: the order of its L D L^T.

        In L D L^T what comes last is found first, and nothing else is computed.
        """
        return (*self.cyclic, *self.coordinates)

    @property
    def multipliers(self) -> int:
        """Number of multipliers."""
        return len(self.annihilator) * len(self.cyclic)

    def pays(self, stages: int) -> bool:
        """Return whether an iteration of loops takes fewer operations than for all coordinates."""
        x, y, m = len(self.coordinates), len(self.cyclic), self.multipliers
        d, n = len(self.columns), x + y
        more = stages * (5 * y * x**2 + 12 * n) + m * (2 * d * x + 4 * stages * (d + 1)) * x
        more += m**2 * (m + 2 * d * x)
        return more < 2 * d**3 * (n**3 - x**3) / 3 + 3 * stages * d**2 * (n**2 - x**2)

    def factor_entries(self) -> dict[tuple[str, *tuple[int, ...]], sp.Expr]:
        """Map ("D", i), ("L", i, j), ("L0", i, j) to factors of the mass matrix of ``cyclic``."""
        entries: dict[tuple[str, *tuple[int, ...]], sp.Expr] = {}
        for r, row in enumerate(self.cyclic):
            entries["D", row] = self.factors.pivots[r]
            for c, column in enumerate(self.cyclic[:r]):
                entries["L", row, column] = self.factors.moving[r][c]
                entries["L0", row, column] = self.factors.fixed[r][c]
        return entries


@dataclass(frozen=True)
class Linear(BasePart):
    """Coordinates moved by shears, each a pair (kick?, coefficients).

    With z = h^2 M^-1 K, a kick (c1, c2) is p += (M/h) (c1 z + c2 z^2) q and a drift (b, e) is
    q += b (M/h + e h K)^-1 p.
    """

    columns: ClassVar[tuple[int, ...]] = ()
    coordinates: tuple[int, ...]
    shears: tuple[tuple[bool, tuple[sp.Expr, sp.Expr]], ...]


@dataclass(frozen=True)
class Affine(BasePart):
    """Coordinates whose D_k L_d = 0, k in ``rows``, are linear in X_m, m in ``solved``."""

    columns: ClassVar[tuple[int, ...]] = ()
    coordinates: tuple[int, ...]
    rows: tuple[int, ...]
    solved: tuple[int, ...]


@dataclass(frozen=True)
class Constrained(BasePart):
    """Coordinates whose increments X_m, m in ``columns``, are held by constraints.

    D_k L_d = Phi(q_0 + X_k)^T mu_k, k in ``rows``, and phi(q_0 + X_m) = 0: at the control points,
    which are Lobatto's, so that the order is that without constraints.
    """

    coordinates: tuple[int, ...]
    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True)
class Composed(BasePart):
    """Coordinates moved by kicks p += h b_k L_q(q), and drifts q += h a_k M^-1 p between them."""

    columns: ClassVar[tuple[int, ...]] = ()
    coordinates: tuple[int, ...]
    kicks: tuple[sp.Expr, ...]
    drifts: tuple[sp.Expr, ...]


Part = Coupled | Separable | Routh | Linear | Affine | Constrained | Composed


def read_exploit(exploit: str | Iterable[str]) -> frozenset[str]:
    """Read what is to be exploited: some of :data:`EXPLOITABLE`; "all" stands for those of ALL.

    Raises GenerationError if something else is named.
    """
    if isinstance(exploit, str):
        exploit = (exploit,)
    wanted = tuple(exploit) if isinstance(exploit, Iterable) else (exploit,)
    for name in wanted:
        if not isinstance(name, str) or name not in ("all", *EXPLOITABLE):
            choices = ", ".join(repr(choice) for choice in EXPLOITABLE)
            reject(
                f"exploit names {name!r}, which is nothing that can be exploited."
                f"{did_you_mean(name, EXPLOITABLE)}",
                remedy=f"Choose 'all', () for the general path, or some of {choices}.",
                error=GenerationError,
            )
    return frozenset(wanted) - {"all"} | frozenset(ALL if "all" in wanted else ())


def reduce(structure: Structure, scheme: Scheme, exploit: frozenset[str]) -> tuple[Part, ...]:
    """Sort the coordinates into parts, each with the smallest solve that its structure allows.

    Of the findings those named in ``exploit`` may be made use of.
    """
    if structure.plain.held:
        every = tuple(range(structure.n))
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
            return Routh(others, rows, columns, cyclic, annihilating(scheme), middle, factors)
    return Coupled(coordinates, rows, columns)


def _routh_applies(plain: Plain, cyclic: Sequence[int]) -> bool:
    """Return whether no force depends on cyclic velocities, and no cyclic row of M on t.

    Then their velocities enter the other equations as they enter L.
    """
    nodes = plain.graph.nodes
    v = set(plain.numbers(plain.v[i] for i in cyclic))
    masses = [plain.entry(i, j) for i in cyclic for j in range(len(plain.q))]
    return all(nodes[n].symbols.isdisjoint(v) for _, n in plain.f) and not any(
        plain.time in nodes[n].symbols for _, n in masses
    )


def _cyclic_mass(plain: Plain, cyclic: Sequence[int]) -> sp.ImmutableDenseMatrix | None:
    """Return the block of M of cyclic coordinates; None if it is too long for symbols."""
    entries = [plain.entry(i, j) for i in cyclic for j in cyclic]
    if any(tree_size(plain.graph, value) > LONGEST_ENTRY for value in entries):
        return None
    return sp.ImmutableDenseMatrix(len(cyclic), len(cyclic), list(map(plain.written, entries)))


def _separable(coordinates: tuple[int, ...], scheme: Scheme) -> Separable:
    d, stages = scheme.degree, range(scheme.stages)
    rows, columns = elimination_order(d)

    def unit(k: int) -> list[sp.Expr]:
        return [sp.Integer(m == k) for m in range(d + 1)]

    A, b, S = scheme.A, scheme.quadrature.weights, scheme.stiffness
    if any(b[i] * A[i][k] * A[i][d] != 0 for i in stages for k in range(d)):
        return Separable(coordinates, tuple(tuple(unit(k)) for k in rows), columns, None)
    last = d - 1  # its row is paired with the column of X_d
    tests = []
    for k in rows:
        if k != last:
            test = unit(k)
            test[last] = sp.radsimp(-S[k][d] / S[last][d])
            tests.append(tuple(test))
    return Separable(coordinates, tuple(tests), tuple(m for m in columns if m != d), last)
