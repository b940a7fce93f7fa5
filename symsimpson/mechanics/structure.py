"""What a system has and lacks, found by exact algebra."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import sympy as sp

from symsimpson.mechanics.independence import Simplifier, fix, vanishes
from symsimpson.mechanics.terms import Sum, connected

if TYPE_CHECKING:
    from symsimpson.mechanics.plain import Plain
    from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["Structure", "Subsystem", "analyse"]

Matrix: TypeAlias = sp.ImmutableDenseMatrix


@dataclass(frozen=True)
class Subsystem:
    """Coordinates that move by themselves, by their places in the system.

    Attributes
    ----------
    coordinates : tuple of int
        Those of the subsystem.
    cyclic : tuple of int
        Those among them that L does not depend on.
    constant_mass : bool
        Its block of M does not depend on q.
    separable : bool
        L = T(v) - V(q): M is constant and there are no terms linear in v.
    linear : bool
        Separable, and V is quadratic: the forces are linear in q.
    """

    coordinates: tuple[int, ...]
    cyclic: tuple[int, ...]
    constant_mass: bool
    separable: bool
    linear: bool


@dataclass(frozen=True, repr=False)
class Structure:
    """Findings about a system; each holds for every value of q and of the parameters.

    Attributes
    ----------
    n : int
        Number of coordinates.
    constant_mass, diagonal_mass : bool
        M does not depend on q; M has no entries off its diagonal.
    constant_rows : tuple of str
        Coordinates whose whole row of M does not depend on q.
    gyroscopic : bool
        L has terms linear in the velocities.
    separable, linear : bool
        L = T(v) - V(q), and V is quadratic beyond that.
    cyclic : tuple of str
        Coordinates that L does not depend on: their momenta are constant.
    periodic : tuple of str
        Coordinates that enter L through sines and cosines of whole multiples only: angles.
    subsystems : tuple of Subsystem
        Groups of coordinates that nothing in L couples.
    zeros : mapping from str to (int, int)
        For M, its derivatives by q and the Hessian of V: entries that vanish, and all entries.
    undecided : tuple of str
        What algebra could neither prove nor samples refuse; it counts as not there.
    plain : Plain
        The system in plain symbols, without what it was proved not to depend on.
    """

    n: int
    constant_mass: bool
    diagonal_mass: bool
    constant_rows: tuple[str, ...]
    gyroscopic: bool
    separable: bool
    linear: bool
    cyclic: tuple[str, ...]
    periodic: tuple[str, ...]
    subsystems: tuple[Subsystem, ...]
    zeros: dict[str, tuple[int, int]]
    undecided: tuple[str, ...]
    plain: Plain = field(compare=False)
    system: MechanicalSystem = field(compare=False)

    def __repr__(self) -> str:
        from symsimpson.display.structure import as_text

        return as_text(self)

    def _repr_html_(self) -> str:
        from symsimpson.display.structure import as_html

        return as_html(self)


def analyse(system: MechanicalSystem) -> Structure:
    """Find out what a system has and lacks.

    Parameters
    ----------
    system : MechanicalSystem

    Returns
    -------
    Structure
        A finding is granted by algebra alone; samples at 60 digits may refuse it.
    """
    given = system.plain
    q, n = given.q, system.n
    names = [user.func.__name__ for user in system.coordinates]
    simplify = Simplifier(q)
    mass = _simplified_mass(given.mass, simplify)
    gyroscopic = tuple(
        simplify(f"a_{name}", a) for name, a in zip(names, given.gyroscopic, strict=True)
    )
    potential = simplify("V", given.potential)
    groups, potential = _groups(mass, gyroscopic, potential, q)
    plain = replace(given, mass=mass, gyroscopic=gyroscopic, potential=potential)
    entries = {place: entry for place, entry in mass.todok().items() if place[0] >= place[1]}
    terms = Sum(potential, q)
    present = set(potential.free_symbols).union(
        *(entry.free_symbols for entry in (*entries.values(), *gyroscopic))
    )
    subsystems = tuple(_subsystem(plain, entries, terms, group, present) for group in groups)
    open_questions = {
        f"whether {what} depends on {names[q.index(x)]}" for what, x in simplify.open_questions
    }
    places = {(max(i, j), min(i, j)) for i, j in entries}
    derivatives = sum((1 + (i != j)) * len(entries[i, j].free_symbols & set(q)) for i, j in places)
    hessian = sum(1 + (i != j) for i, j in terms.pairs(q) if terms.diff(q[i], q[j]) != 0)
    return Structure(
        n=n,
        constant_mass=all(s.constant_mass for s in subsystems),
        diagonal_mass=all(i == j for i, j in entries),
        constant_rows=_constant_rows(entries, q, names),
        gyroscopic=any(a != 0 for a in gyroscopic),
        separable=all(s.separable for s in subsystems),
        linear=all(s.linear for s in subsystems),
        cyclic=tuple(names[i] for s in subsystems for i in s.cyclic),
        periodic=tuple(names[i] for i in range(n) if q[i] in present and _angle(plain, q[i])),
        subsystems=subsystems,
        zeros={
            "M": (n * n - sum(1 + (i != j) for i, j in places), n * n),
            "dM/dq": (n**3 - derivatives, n**3),
            "Hess V": (n * n - hessian, n * n),
        },
        undecided=tuple(sorted(open_questions)),
        plain=plain,
        system=system,
    )


def _simplified_mass(mass: Matrix, simplify: Simplifier) -> Matrix:
    size = mass.rows
    found = sp.MutableDenseMatrix.zeros(size, size)
    for (i, j), entry in mass.todok().items():
        if i >= j:
            found[i, j] = found[j, i] = simplify(f"M[{i},{j}]", entry)
    return Matrix(found)


def _constant_rows(
    entries: dict[tuple[int, int], sp.Expr], q: Sequence[sp.Symbol], names: Sequence[str]
) -> tuple[str, ...]:
    moving = {
        i for place, entry in entries.items() if not entry.free_symbols.isdisjoint(q)
        for i in place
    }  # fmt: skip
    return tuple(name for i, name in enumerate(names) if i not in moving)


def _groups(
    mass: Matrix, gyroscopic: Sequence[sp.Expr], potential: sp.Expr, q: Sequence[sp.Symbol]
) -> tuple[list[list[int]], sp.Expr]:
    """Find the groups of coordinates that nothing couples, and V as a sum over them."""
    place = {x: i for i, x in enumerate(q)}

    def among(expression: sp.Expr) -> list[int]:
        return [place[s] for s in expression.free_symbols if s in place]

    joined = [
        (i, k)
        for (i, j), entry in mass.todok().items()
        for k in (j, *among(entry))
    ]  # fmt: skip
    joined += [(i, k) for i, a in enumerate(gyroscopic) for k in among(a)]
    as_written = connected(len(q), [*joined, *Sum(potential, q).pairs(q)])
    # only where terms stand for the same pair of groups can they cancel
    terms = Sum(potential, q)
    exact = [(i, j) for i, j in terms.pairs(q) if i != j]
    if len(exact) > len(q) * 4:
        return as_written, potential
    coupled = [(i, j) for i, j in exact if vanishes(terms.diff(q[i], q[j])) is not True]
    groups = connected(len(q), [*joined, *coupled])
    if len(groups) == len(as_written):
        return as_written, potential
    split = _split(potential, [[q[i] for i in group] for group in groups])
    return (as_written, potential) if split is None else (groups, split)


def _split(potential: sp.Expr, groups: Sequence[Sequence[sp.Symbol]]) -> sp.Expr | None:
    """Write V, whose mixed derivatives vanish, as a sum over groups: the others stand still."""
    parts = []
    for k, group in enumerate(groups):
        part: sp.Expr | None = potential
        for other in (x for rest in groups if rest is not group for x in rest):
            part = None if part is None else fix(part, other)
        if part is None:
            return None
        parts.append(part)
        if k:
            for x in group:
                fixed = fix(part, x)
                if fixed is None:
                    return None
                part = fixed
            parts.append(-part)
    return sp.expand(sp.Add(*parts))


def _subsystem(
    plain: Plain,
    mass: dict[tuple[int, int], sp.Expr],
    potential: Sum,
    group: Sequence[int],
    present: set[sp.Basic],
) -> Subsystem:
    q = plain.q
    inside = set(group)
    own = [entry for (i, _), entry in mass.items() if i in inside]
    constant = all(entry.free_symbols.isdisjoint(q) for entry in own)
    free_of_v = constant and all(plain.gyroscopic[i].free_symbols.isdisjoint(q) for i in group)
    separable = free_of_v and all(plain.gyroscopic[i] == 0 for i in group)
    return Subsystem(
        coordinates=tuple(group),
        cyclic=tuple(i for i in group if q[i] not in present),
        constant_mass=constant,
        separable=separable,
        linear=separable and _quadratic(potential, [q[i] for i in group]),
    )


def _quadratic(potential: Sum, q: Sequence[sp.Symbol]) -> bool:
    """Tell whether the second derivatives of V are proved not to depend on q."""
    return all(
        potential.diff(q[i], q[j]).free_symbols.isdisjoint(q)
        or sp.expand(potential.diff(q[i], q[j])).free_symbols.isdisjoint(q)
        for i, j in potential.pairs(q)
    )


def _angle(plain: Plain, x: sp.Symbol) -> bool:
    """Tell whether x stands in sines and cosines alone, by whole multiples."""

    def walk(expression: sp.Expr) -> Iterator[bool]:
        if x not in expression.free_symbols:
            return
        if isinstance(expression, (sp.sin, sp.cos, sp.tan)):
            slope = expression.args[0].diff(x)
            yield bool(slope.is_Integer)
        elif expression == x:
            yield False
        else:
            for argument in expression.args:
                yield from walk(argument)

    entries: list[sp.Expr] = [*plain.mass.todok().values(), *plain.gyroscopic, plain.potential]
    return all(answer for entry in entries for answer in walk(entry))
