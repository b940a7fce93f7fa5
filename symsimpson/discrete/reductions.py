r"""Reductions of the equations of a step, by what a system lacks.

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
from functools import cache
from typing import ClassVar

import sympy as sp

from symsimpson.discrete.factors import Factors, factorise
from symsimpson.errors import GenerationError
from symsimpson.graph.read import tree_size
from symsimpson.mechanics.plain import Plain
from symsimpson.mechanics.structure import MOST_AFFINE, Structure, Subsystem
from symsimpson.schemes.composition import Composition
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.names import did_you_mean

__all__ = [
    "EXPLOITABLE", "Affine", "BasePart", "Composed", "Constrained", "Coupled", "Linear", "Part",
    "Routh", "Separable", "elimination_order", "force_factor", "inertia_factor", "read_exploit",
    "reduce",
]  # fmt: skip

Table = tuple[tuple[sp.Expr, ...], ...]

#: Mass matrices with entries of more nodes than this are not factorised in symbols.
LONGEST_ENTRY = 500
#: What ``exploit`` can name.
EXPLOITABLE = ("decoupled", "cyclic", "constant_mass", "linear", "sparse", "conformal")


class BasePart:
    """Coordinates that are solved together."""

    coordinates: tuple[int, ...]

    @property
    def coupled_by_mass(self) -> tuple[int, ...]:
        """The coordinates that M couples."""
        return self.coordinates


@dataclass(frozen=True)
class Coupled(BasePart):
    """Coordinates whose increments X_m, m in ``columns``, solve D_k L_d = 0, k in ``rows``."""

    coordinates: tuple[int, ...]
    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True)
class Separable(BasePart):
    """Coordinates with constant M: ``tests`` combine the D_k L_d to as many rows as unknowns.

    Where X_d is no unknown, it solves D_k L_d = 0 (p0 + D_0 L_d = 0 for k = 0) for k = ``last``.
    """

    coordinates: tuple[int, ...]
    tests: Table
    columns: tuple[int, ...]
    last: int | None

    def last_test(self, degree: int) -> tuple[sp.Expr, ...]:
        """Return the combination that picks the row of X_d where it is no unknown."""
        return tuple(sp.Integer(k == self.last) for k in range(degree + 1))


@dataclass(frozen=True)
class Routh(BasePart):
    """Coordinates, and cyclic ones that are eliminated by their momenta.

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
    def coupled_by_mass(self) -> tuple[int, ...]:
        """The coordinates that M couples, cyclic ones first.

        In L D L^T what comes last is found first, and nothing else is computed.
        """
        return (*self.cyclic, *self.coordinates)

    def outputs(self) -> dict[tuple[str, *tuple[int, ...]], sp.Expr]:
        """List the factors L and D of the mass matrix of the cyclic coordinates, by these."""
        found: dict[tuple[str, *tuple[int, ...]], sp.Expr] = {}
        for r, row in enumerate(self.cyclic):
            found["D", row] = self.factors.pivots[r]
            for c, column in enumerate(self.cyclic[:r]):
                found["L", row, column] = self.factors.moving[r][c]
                found["L0", row, column] = self.factors.fixed[r][c]
        return found


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
    """Read what is to be exploited: "all", or some of :data:`EXPLOITABLE`.

    Raises
    ------
    GenerationError
        If something else is named.
    """
    if isinstance(exploit, str):
        exploit = EXPLOITABLE if exploit == "all" else (exploit,)
    wanted = tuple(exploit) if isinstance(exploit, Iterable) else (exploit,)
    for name in wanted:
        if name not in EXPLOITABLE:
            choices = ", ".join(repr(choice) for choice in EXPLOITABLE)
            raise GenerationError(
                f"exploit names {name!r}, which is nothing that can be exploited."
                f"{did_you_mean(name, EXPLOITABLE)}\n"
                f"Choose 'all', () for the general path, or some of {choices}."
            )
    return frozenset(wanted)


def reduce(structure: Structure, scheme: Scheme, exploit: frozenset[str]) -> tuple[Part, ...]:
    """Sort the coordinates into parts, each with the smallest solve that its structure allows.

    Parameters
    ----------
    structure : Structure
    scheme : Scheme
    exploit : frozenset of str
        The findings that may be made use of.

    Returns
    -------
    tuple of Part
    """
    if structure.plain.constraints:
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
    reducible = subsystem.cyclic and others and _still(plain, subsystem.cyclic)
    if reducible and "cyclic" in exploit and (scheme.exact or scheme.by_stages):
        factors = factorise(_cyclic_mass(plain, subsystem.cyclic), plain.q)
        if factors is not None:
            cyclic = tuple(subsystem.cyclic[i] for i in factors.order)
            middle = scheme.stages // 2
            return Routh(others, rows, columns, cyclic, annihilating(scheme), middle, factors)
    return Coupled(coordinates, rows, columns)


def _still(plain: Plain, cyclic: Sequence[int]) -> bool:
    """Return whether no force depends on the velocities of cyclic coordinates, nor their M on t.

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


def elimination_order(degree: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Order the block rows and columns so that elimination meets no singular pivot.

    Every inner row names an inner control point, and eliminating X_m through its own row is
    natural for small steps but breaks down at a finite one (x^2 = 8 for Simpson, x = h omega).
    Pairing row k with column k + 1 shifts the pivots to the couplings between neighbours; for
    Simpson the remaining pivot is (M + h^2 K/24) (2/h), never singular for K >= 0. The row
    p0 + D_0 L_d comes last.
    """
    inner = tuple(range(1, degree))
    return (*inner, 0), (*(k + 1 for k in inner), 1)


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


def force_factor(test: Sequence[sp.Expr], scheme: Scheme, i: int) -> sp.Expr:
    """Return b_i sum_k test_k A_ik: how often the force at node i enters a combined row."""
    combined = sp.Add(*(c * x for c, x in zip(test, scheme.A[i], strict=True)))
    return sp.radsimp(scheme.quadrature.weights[i] * combined)


def inertia_factor(test: Sequence[sp.Expr], scheme: Scheme, m: int) -> sp.Expr:
    """Return sum_k test_k S_km: how much of M X_m is in a combined row."""
    terms = (c * scheme.stiffness[k][m] for k, c in enumerate(test))
    return sp.radsimp(sp.expand(sp.Add(*terms)))


def annihilating(scheme: Scheme) -> Table:
    """Return a basis of the combinations of nodal values that vanish for degree d - 1."""
    nodes, d = scheme.quadrature.nodes, scheme.degree
    basis = []
    for first in range(len(nodes) - d):  # divided differences of d + 1 neighbours
        group = range(first, first + d + 1)
        row = [
            1 / sp.Mul(*(nodes[i] - nodes[j] for j in group if j != i)) if i in group else sp.S.Zero
            for i in range(len(nodes))
        ]
        basis.append(tuple(sp.radsimp(sp.expand(value / row[first + d])) for value in row))
    return tuple(basis)


@cache
def shear_factors(scheme: Scheme) -> tuple[tuple[bool, tuple[sp.Expr, sp.Expr]], ...] | None:
    """Write the step of a linear oscillator as shears without a pole at any z = (h omega)^2 > 0.

    With q1 = A(z) q + B(z) p (M = h = 1) two symmetric products are tried: kick, drift, kick, and
    two such in a row whose outer kicks are -z/4. None if neither has a drift b / (1 + e z),
    e >= 0, and kicks that are polynomials in z of degree two.
    """
    # the denominators have this degree, and the products below are symmetric
    if scheme.degree > 2 or not scheme.symmetric:
        return None
    z = sp.Symbol("z", positive=True)
    A, B = _oscillator(scheme, z)
    products = (
        [(True, (A - 1) / B), (False, B), (True, (A - 1) / B)],
        [(True, -z / 4), (False, B / (2 + (E := A - 1 + B * z / 4))),
         (True, E * (2 + E) / B), (False, B / (2 + E)), (True, -z / 4)],
    )  # fmt: skip
    for product in products:
        shears = []
        for is_kick, factor in product:
            numerator, denominator = sp.fraction(sp.cancel(sp.radsimp(sp.together(factor))))
            top, bottom = sp.Poly(numerator, z), sp.Poly(denominator, z)
            if is_kick and bottom.degree() == 0 and top.degree() <= 2 and top.eval(0) == 0:
                scale = bottom.eval(0)
                kick = (top.coeff_monomial(z) / scale, top.coeff_monomial(z**2) / scale)
                shears.append((True, kick))
            elif not is_kick and top.degree() == 0 and bottom.degree() <= 1:
                start = bottom.eval(0)
                slope = bottom.coeff_monomial(z) / start
                if not slope.is_nonnegative:
                    break
                shears.append((False, (top.eval(0) / start, slope)))
            else:
                break
        else:
            return tuple(shears)
    return None


def _oscillator(scheme: Scheme, z: sp.Symbol) -> tuple[sp.Expr, sp.Expr]:
    """Solve one step of q'' = -z q with h = 1: q1 = A q + B p."""
    d, b, T = scheme.degree, scheme.quadrature.weights, scheme.A
    X = (sp.S.One, *sp.symbols(f"X1:{d + 1}"))
    q, p = sp.symbols("q p")
    path = (q, *X[1:])
    rows = []
    for k in range(d):
        inertia = sum((scheme.stiffness[k][m] * path[m] for m in range(d + 1)), sp.S.Zero)
        mass = [sum(b[i] * T[i][k] * T[i][m] for i in range(scheme.stages)) for m in range(d + 1)]
        force = sum((c * x for c, x in zip(mass, path, strict=True)), sp.S.Zero)
        rows.append(inertia - z * force + (p if k == 0 else 0))
    solution = sp.solve(rows, X[1:], dict=True)[0][X[d]]
    return tuple(sp.cancel(sp.radsimp(sp.together(solution.diff(s)))) for s in (q, p))
