"""Energies as quadratic polynomials in the velocities, and checks of the mass matrix."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import sympy as sp
from sympy.utilities.iterables import connected_components

from symsimpson.declare.checks import reject_model, spell
from symsimpson.declare.plain import Symbols
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.evaluate import evaluate_doubles
from symsimpson.graph.field import Element, PrimeField
from symsimpson.graph.findings import IdentityTest
from symsimpson.graph.nodes import ZERO, Graph, Value, scale
from symsimpson.graph.read import SympyConverter, tree_size
from symsimpson.graph.rebuild import fix_symbols, rebuild

#: Second derivatives with more nodes than this are neither simplified nor shown.
TOO_LONG = 400
#: Eigenvalues of M, scaled to rows of size 1, have no sign if they are smaller than this.
SMALL_EIGENVALUE = 1e-8


@dataclass(frozen=True)
class QuadraticInVelocities:
    """An energy v.M.v/2 + a.v + rest, with the nonzero entries M_ij, i >= j.

    If the energy is not ``quadratic`` in the velocities, M, a and the rest depend on them, too. M
    then is the matrix of second derivatives by the velocities, and M v + a are the first ones.
    """

    M: Mapping[tuple[int, int], Value]
    a: tuple[Value, ...]
    rest: Value
    quadratic: bool = True


def quadratic_form(graph: Graph, M: Mapping[tuple[int, int], Value], v: Sequence[int]) -> Value:
    """Write v.M.v/2 from the entries of M on and below its diagonal."""
    half = Fraction(1, 2)
    return graph.add(
        graph.multiply([value, (half if i == j else 1, v[i]), (1, v[j])])
        for (i, j), value in M.items()
    )


def split_by_velocities(
    system: str, what: str, energy: Value, symbols: Symbols
) -> QuadraticInVelocities:
    """Split an energy by its powers of the velocities.

    Reject an energy that divides by zero everywhere.
    """
    graph, v = symbols.graph, symbols.numbers(symbols.v)
    momenta = gradient(graph, energy, v)
    try:
        findings = IdentityTest(graph, [energy, *momenta])
    except ZeroDivisionError:
        reject_model(
            system,
            f"the {what} divides by zero at every tested point.",
            "Look for a denominator that vanishes identically.",
        )
    derivatives = Derivatives(graph)
    affine = findings.affine(momenta, v)
    entries: dict[tuple[int, int], Value] = {}
    quadratic = True
    for i, momentum in enumerate(momenta):
        for j in range(i + 1):
            if v[j] not in graph.nodes[momentum[1]].symbols:
                continue
            entry = derivatives(momentum, v[j])
            moving = sorted(graph.nodes[entry[1]].symbols & set(v))
            if moving and affine[i]:
                entry = fix_symbols(graph, entry, moving) or entry
            elif moving:
                without = _remove_velocities(entry, symbols)
                quadratic = quadratic and without is not None
                entry = without or entry
            entries[i, j] = entry
    if entries:
        findings = IdentityTest(graph, list(entries.values()))
        entries = {place: entry for place, entry in entries.items() if not findings.vanishes(entry)}
    if quadratic:
        try:
            *a, constant = rebuild(graph, [*momenta, energy], dict.fromkeys(v, ZERO))
            return QuadraticInVelocities(entries, tuple(a), constant)
        except ZeroDivisionError:  # it divides by velocities, and has no value at rest
            pass
    a = linear_terms(graph, momenta, entries, v)
    terms = [quadratic_form(graph, entries, v), *graph.products(a, v)]
    constant = graph.add([energy, *(scale(-1, term) for term in terms)])
    return QuadraticInVelocities(entries, tuple(a), constant, quadratic=False)


def linear_terms(
    graph: Graph, momenta: Sequence[Value], M: Mapping[tuple[int, int], Value], v: Sequence[int]
) -> list[Value]:
    """Return a = L_v - M v."""
    rows: list[list[Value]] = [[momentum] for momentum in momenta]
    for (i, j), entry in M.items():
        for row, column in {(i, j), (j, i)}:
            rows[row].append(graph.multiply([scale(-1, entry), (1, v[column])]))
    return [graph.add(row) for row in rows]


def _remove_velocities(entry: Value, symbols: Symbols) -> Value | None:
    """Remove velocities that cancel in a second derivative, with SymPy; None if they do not."""
    graph, moving = symbols.graph, set(symbols.numbers(symbols.v))
    if tree_size(graph, entry) > TOO_LONG:
        return None
    value = SympyConverter(graph, symbols.known)(sp.simplify(symbols.to_user(entry)))
    return value if graph.nodes[value[1]].symbols.isdisjoint(moving) else None


def check_degenerate(system: str, lagrangian: QuadraticInVelocities, symbols: Symbols) -> None:
    """Reject a coordinate without mass that L couples to velocities.

    The velocity of such a coordinate is linear in L, or is absent while the coordinate itself
    multiplies other velocities. Then the equations of motion are of first order.
    """
    graph = symbols.graph
    coupled = frozenset().union(*(graph.nodes[n].symbols for c, n in lagrangian.a if c))
    massive = {i for place in lagrangian.M for i in place}
    for i, x in enumerate(symbols.numbers(symbols.q)):
        if i not in massive and (lagrangian.a[i][0] or x in coupled):
            name = spell(symbols.back[symbols.q[i]])
            reject_model(
                system,
                f"the Lagrangian is degenerate: it has no term quadratic in {name}', only terms "
                "linear in the velocities. Its equations of motion are of first order (point "
                "vortices, Lotka-Volterra equations, guiding centres): L_vv is singular.",
                f"If {name} has a mass, add its kinetic energy. Otherwise give H(q, p): "
                "symsimpson.HamiltonianSystem.",
            )


def check_homogeneous(system: str, energy: Value, symbols: Symbols) -> None:
    """Reject a Lagrangian of degree one in the velocities: v.L_v = L, so L_vv v = 0."""
    graph, v = symbols.graph, symbols.numbers(symbols.v)
    moved = graph.add(graph.products(gradient(graph, energy, v), v))
    if energy[0] and IdentityTest(graph, [energy, moved]).equal(energy, moved):
        reject_model(
            system,
            "the Lagrangian F is of degree one in the velocities, so its second derivatives by the "
            "velocities form a singular matrix. The motion then has no unique time.",
            "Use F**2/2, whose motion has the same orbits, or a symsimpson.HamiltonianSystem.",
        )


def is_indefinite(
    symbols: Symbols, M: Mapping[tuple[int, int], Value], parameters: Iterable[float]
) -> bool:
    """Return whether M has eigenvalues of both signs at all random points that were tried."""
    known = dict(zip(symbols.numbers(symbols.a), map(float, parameters), strict=True))
    values, n = list(M.values()), len(symbols.q)
    if not values:
        return False
    tried = 0
    for point in symbols.points:
        matrix = np.zeros((n, n))
        for (i, j), value in zip(
            M, evaluate_doubles(symbols.graph, values, point | known), strict=True
        ):
            matrix[i, j] = matrix[j, i] = value
        with np.errstate(all="ignore"):  # rows of size 1 make signs independent of units
            size = 1 / np.sqrt(abs(matrix).sum(axis=1))
            matrix = size[:, None] * matrix * size
        if not np.isfinite(matrix).all():
            continue
        tried += 1
        signs = np.linalg.eigvalsh(matrix)
        if signs[0] >= -SMALL_EIGENVALUE or signs[-1] <= SMALL_EIGENVALUE:
            return False
    return tried > 0


def check_mass_matrix(
    system: str,
    M: Mapping[tuple[int, int], Value],
    symbols: Symbols,
    parameters: Sequence[float] | None = None,
) -> None:
    """Reject a mass matrix that is singular for all q, or has a negative constant entry M_ii.

    Entries may be negative if ``parameters`` is None. ``parameters`` has their default values if M
    is indefinite. A run checks M at its initial state, because it depends on q.
    """
    reject_here = partial(reject_model, system)
    massive = {i for place in M for i in place}
    for i, (q, v) in enumerate(zip(symbols.q, symbols.v, strict=True)):
        name, velocity = spell(symbols.back[q]), spell(symbols.back[v])
        if i not in massive:
            reject_here(
                f"the kinetic energy does not depend on {velocity}, so the mass matrix has a "
                "zero row. A variational step needs an invertible mass matrix.",
                f"Give {name} a mass (T += m*{velocity}**2/2), or remove {name} from the "
                "coordinates. Write the velocity as "
                f"{name}.diff() or {name}.diff(symsimpson.time). The derivative by any other "
                "symbol is 0, even if its name is t.",
            )
        entry = M.get((i, i), ZERO)
        if parameters is not None and _is_negative(symbols, entry, parameters):
            reject_here(
                f"the kinetic energy is negative for every {velocity}, so M is not positive "
                "definite. Masses are positive.",
                "Check the sign of that term in T, and the declared sign of its symbols. If M has "
                "to be indefinite, as for geodesics of space-time, pass indefinite=True.",
            )
    blocks = connected_groups(len(symbols.q), M)
    if all(has_full_rank(symbols, mass_rows(M, block)) for block in blocks):
        return
    names = ", ".join(spell(symbols.back[q]) for q in symbols.q)
    reject_here(
        "the mass matrix is singular for every configuration: its determinant is zero. "
        f"Some combination of the velocities of {names} carries no kinetic energy.",
        "A variational step needs an invertible mass matrix. Give each body its own kinetic "
        "energy, or use fewer coordinates.",
    )


def _is_negative(symbols: Symbols, entry: Value, parameters: Sequence[float]) -> bool:
    """Return whether an entry of M is negative for all q."""
    known = symbols.numbers(symbols.a)
    if symbols.signs(entry) == (-1, True):
        return True
    if not (parameters and entry[0]) or not symbols.graph.nodes[entry[1]].symbols.issubset(known):
        return False
    point = dict(zip(known, map(float, parameters), strict=True))
    return evaluate_doubles(symbols.graph, [entry], point)[0] < 0


def mass_rows(M: Mapping[tuple[int, int], Value], block: Sequence[int]) -> list[list[Value]]:
    """Return a block of M as full rows, from its entries on and below the diagonal."""
    return [[M.get((max(i, j), min(i, j)), ZERO) for j in block] for i in block]


def connected_groups(size: int, pairs: Iterable[tuple[int, int]]) -> list[list[int]]:
    """Group 0..size-1 into connected components, in the order of their least members."""
    return sorted(map(sorted, connected_components((range(size), pairs))))


def sample(symbols: Symbols, values: Sequence[Value]) -> Iterator[list[float]]:
    """Evaluate values at a few random points, in doubles."""
    return (evaluate_doubles(symbols.graph, values, point) for point in symbols.points)


def is_well_conditioned(matrix: Any) -> bool:
    """Return whether a matrix in doubles has full rank, with a condition number below 1e8."""
    # at condition numbers near 1e16, round-off hides a zero determinant
    return bool(np.isfinite(matrix).all() and np.linalg.cond(matrix) < 1e8)


def has_full_rank(symbols: Symbols, rows: Sequence[Sequence[Value]]) -> bool:
    """Return whether rows are independent, by a test in doubles or else in a prime field."""
    values, shape = [value for row in rows for value in row], (len(rows), len(rows[0]))
    beyond_doubt = (is_well_conditioned(np.reshape(x, shape)) for x in sample(symbols, values))
    return any(beyond_doubt) or rank(symbols.graph, rows) == len(rows)


def rank(graph: Graph, matrix: Sequence[Sequence[Value]]) -> int:
    """Return the largest rank of a matrix over all points, from random points of a prime field."""
    values = [value for row in matrix for value in row]
    return max(
        _rank([[at[value] for value in row] for row in matrix], at.arithmetic)
        for at in IdentityTest(graph, values).points
    )


def _rank(rows: list[list[Element]], field: PrimeField) -> int:
    """Return the rank of a matrix over a prime field, by Gaussian elimination."""
    minus, done = field.prime - 1, 0
    for k in range(len(rows[0])):
        pivot = next((i for i in range(done, len(rows)) if rows[i][k]), None)
        if pivot is None:
            continue
        rows[done], rows[pivot] = rows[pivot], rows[done]
        over = field.times(minus, field.inverse(rows[done][k]))
        for row in rows[done + 1 :]:
            if row[k]:
                factor = field.times(row[k], over)
                for j in range(k, len(row)):
                    row[j] = field.plus(row[j], field.times(factor, rows[done][j]))
        done += 1
        if done == len(rows):
            break
    return done
