r"""Reductions of the equations of a step, by the structure of the system.

Each reduction is an exact transformation of the same scheme. Coordinates fall into parts that are
solved one by one:

- :class:`Coupled`: all increments X_1..X_d are unknowns.
- :class:`Separable` (M constant, L = T(v) - V(q)): with the stiffness matrix
  S_km = sum_i b_i B_ik B_im the rows are
  D_k L_d = sum_m S_km M X_m / h + h sum_i b_i A_ik L_q(q_i), and if no row contains a force that
  depends on X_d, this one is no unknown.
- :class:`Routh`: cyclic coordinates y are eliminated by their momenta. D_k L_d = 0 for y says that
  p_y = L_vy(q_i) against all polynomials of degree d - 1, so that
  L_vy(q_i) = p_y + sum_r C_ri / b_i lambda_r, where the rows of C annihilate these polynomials at
  the nodes. That the velocities of y are such a polynomial, sum_i C_ri v_y(q_i) = 0, is a linear,
  symmetric and positive definite system for the multipliers lambda (s - d of them for each
  coordinate; Simpson has one, a Gauss scheme of full degree none).
- :class:`Constrained`: multipliers are unknowns, too.
- :class:`Composed` (constant M, forces of q alone, an explicit scheme): kicks and drifts.
- :class:`Linear` (forces linear in q): the step is a product of shears
  p += kick(q), q += drift(p), ..., exact for whatever rounding leaves of their coefficients.
- :class:`Affine` (forces and momenta affine in q and v, beside what depends on t and inputs): the
  equations are linear in all X_k, with a matrix that is factorised once a run.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import sympy as sp

from symsimpson.discrete.combined_rows import Table, annihilating, elimination_order, shear_factors
from symsimpson.discrete.factors import Factors, factorise
from symsimpson.errors import GenerationError
from symsimpson.graph.read import tree_size
from symsimpson.mechanics.plain import Plain
from symsimpson.mechanics.structure import MOST_AFFINE, Structure, Subsystem
from symsimpson.schemes.composition import Composition
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.names import did_you_mean

__all__ = [
    "EXPLOITABLE",
    "Affine",
    "BasePart",
    "Composed",
    "Constrained",
    "Coupled",
    "Linear",
    "Part",
    "Routh",
    "Separable",
    "read_exploit",
    "reduce",
]

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
            raise GenerationError(
                f"exploit names {name!r}, which is nothing that can be exploited."
                f"{did_you_mean(name, EXPLOITABLE)}\n"
                f"Choose 'all', () for the general path, or some of {choices}."
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
