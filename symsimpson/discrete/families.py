"""Terms of L that are equal up to coordinates and coefficients: links, springs, lattice sites.

A family is differentiated once and evaluated in a loop over its members.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import sympy as sp

from symsimpson.mechanics.plain import Plain
from symsimpson.mechanics.terms import Sum

__all__ = ["Family", "families", "neighbours", "ordering"]


@dataclass(frozen=True)
class Family:
    """One term in slots, and the coordinates and coefficients that fill them for each member.

    Attributes
    ----------
    plain : Plain
        The term as the Lagrangian of a system with one coordinate for each slot; its parameters
        are the slots of coefficients, and then those parameters that are the same for all members.
    slots : int
        Number of coefficients that differ among members.
    coordinates : tuple of tuple of int
        Coordinates of each member.
    coefficients : tuple of tuple of expressions
        Coefficients of each member, made of parameters.
    """

    plain: Plain
    slots: int
    coordinates: tuple[tuple[int, ...], ...]
    coefficients: tuple[tuple[sp.Expr, ...], ...]


@dataclass
class _Draft:
    """The members of a family as they are found."""

    coordinates: list[tuple[int, ...]]
    coefficients: list[tuple[sp.Expr, ...]]


def families(plain: Plain) -> tuple[Family, ...]:
    """Sort the terms of L = v.M.v/2 + a.v - V into families.

    What contains no coordinate is one family of its own: a coefficient alone.
    """
    drafts: dict[sp.Expr, _Draft] = {}
    terms = list(_terms(plain))
    constant = sp.Add(*(term for term in terms if not _moves(term, plain)))
    if constant != 0:
        drafts[sp.Symbol("c_0", real=True)] = _Draft([()], [(constant,)])
    for term in terms:
        if not _moves(term, plain):
            continue
        reader = _Reader(plain)
        key = reader.read(term)
        draft = drafts.setdefault(key, _Draft([], []))
        draft.coordinates.append(tuple(reader.coordinates))
        draft.coefficients.append(tuple(reader.coefficients))
    return tuple(_family(plain, key, draft) for key, draft in drafts.items())


def _terms(plain: Plain) -> Iterator[sp.Expr]:
    entries = plain.mass.todok()
    for (i, j), entry in sorted(entries.items(), key=lambda item: item[0]):
        if i >= j:
            half = sp.Rational(1, 2) if i == j else sp.S.One
            for term in Sum(entry, plain.q).terms:
                yield half * term * plain.v[i] * plain.v[j]
    for a, v in zip(plain.gyroscopic, plain.v, strict=True):
        yield from (term * v for term in Sum(a, plain.q).terms if term != 0)
    yield from (-term for term in Sum(plain.potential, plain.q).terms if term != 0)


def _moves(expression: sp.Expr, plain: Plain) -> bool:
    return not expression.free_symbols.isdisjoint((*plain.q, *plain.v))


class _Reader:
    """Writes a term in slots, in an order that does not depend on names."""

    def __init__(self, plain: Plain) -> None:
        self._place = {x: i for i, x in enumerate(plain.q)} | {v: i for i, v in enumerate(plain.v)}
        self._v = set(plain.v)
        self.coordinates: list[int] = []
        self.coefficients: list[sp.Expr] = []

    def read(self, term: sp.Expr) -> sp.Expr:
        """Give the term in slots q_s, v_s, c_s."""
        if term.is_Mul or term.is_Add:
            still: list[sp.Expr] = []
            moving: list[sp.Expr] = []
            for argument in term.args:
                (moving if self._moves(argument) else still).append(argument)
            parts = sorted(moving, key=lambda x: (self._shape(x), self._present(x)))
            read = [self.read(part) for part in parts]
            if still:
                read.append(self._coefficient(term.func(*still)))
            return term.func(*read)
        if term in self._place:
            return self._slot(term)
        if not self._moves(term):
            return term if term.is_Number else self._coefficient(term)
        return term.func(*(self.read(argument) for argument in term.args))

    def _moves(self, expression: sp.Expr) -> bool:
        return not expression.free_symbols.isdisjoint(self._place)

    def _present(self, expression: sp.Expr) -> tuple[int, ...]:
        return tuple(sorted(self._place[s] for s in expression.free_symbols if s in self._place))

    def _shape(self, expression: sp.Expr) -> str:
        """Give what is left of an expression without its names."""
        if expression in self._place:
            return "v" if expression in self._v else "q"
        if not self._moves(expression):
            return str(expression) if expression.is_Number else "c"
        parts = [self._shape(argument) for argument in expression.args]
        if expression.is_Add or expression.is_Mul:
            parts.sort()
        return f"{type(expression).__name__}({','.join(parts)})"

    def _slot(self, symbol: sp.Symbol) -> sp.Symbol:
        place = self._place[symbol]
        if place not in self.coordinates:
            self.coordinates.append(place)
        kind = "v" if symbol in self._v else "q"
        return sp.Symbol(f"{kind}_{self.coordinates.index(place)}", real=True)

    def _coefficient(self, value: sp.Expr) -> sp.Symbol:
        if value not in self.coefficients:
            self.coefficients.append(value)
        return sp.Symbol(f"c_{self.coefficients.index(value)}", real=True)


def _family(system: Plain, key: sp.Expr, draft: _Draft) -> Family:
    """Make a family; a coefficient that all members share stands in the term itself.

    A member without coordinates keeps its coefficient: tables have a column at least.
    """
    count = len(draft.coefficients[0])
    columns = [[row[k] for row in draft.coefficients] for k in range(count)]
    shared = {
        sp.Symbol(f"c_{k}", real=True): column[0]
        for k, column in enumerate(columns)
        if len(set(column)) == 1 and draft.coordinates[0]
    }
    varying = [k for k in range(count) if sp.Symbol(f"c_{k}", real=True) not in shared]
    term = key.xreplace(shared)
    size = len(draft.coordinates[0])
    q = tuple(sp.Symbol(f"q_{s}", real=True) for s in range(size))
    v = tuple(sp.Symbol(f"v_{s}", real=True) for s in range(size))
    rest = dict.fromkeys(v, sp.S.Zero)
    mass = sp.ImmutableDenseMatrix(size, size, lambda a, b: term.diff(v[a], v[b]))
    linear = tuple(term.diff(x).subs(rest) for x in v)
    slots = tuple(sp.Symbol(f"c_{k}", real=True) for k in varying)
    plain = Plain(
        q=q, v=v, p=(), parameters=(*slots, *system.parameters), mass=mass, gyroscopic=linear,
        potential=-term.subs(rest), invariants={},
    )  # fmt: skip
    coefficients = tuple(tuple(row[k] for k in varying) for row in draft.coefficients)
    return Family(plain, len(slots), tuple(draft.coordinates), coefficients)


def neighbours(found: tuple[Family, ...], n: int) -> list[set[int]]:
    """List the coordinates that meet each one in some term."""
    near: list[set[int]] = [set() for _ in range(n)]
    for family in found:
        for member in family.coordinates:
            for i in member:
                near[i].update(member)
    return [others - {i} for i, others in enumerate(near)]


def ordering(near: list[set[int]]) -> tuple[tuple[int, ...], int]:
    """Order coordinates so that those that meet stand close (reverse Cuthill-McKee).

    Returns
    -------
    order : tuple of int
        Coordinates in their new order.
    band : int
        The largest distance of two that meet.

    References
    ----------
    .. [1] E. Cuthill and J. McKee, Reducing the bandwidth of sparse symmetric matrices,
       Proc. 24th ACM National Conference (1969), 157-172.
    """
    left = set(range(len(near)))
    order: list[int] = []

    def degree(i: int) -> tuple[int, int]:
        return len(near[i]), i

    while left:
        start = _periphery(min(left, key=degree), near)
        queue = [start]
        left.discard(start)
        for i in queue:
            following = sorted(near[i] & left, key=degree)
            left.difference_update(following)
            queue += following
        order += queue
    order.reverse()
    place = {i: s for s, i in enumerate(order)}
    band = max(
        (abs(place[i] - place[j]) for i, others in enumerate(near) for j in others), default=0
    )
    return tuple(order), band


def _periphery(start: int, near: list[set[int]]) -> int:
    """Walk to a coordinate far from all others of its group."""
    reach = -1
    while True:
        level, seen, count = {start}, {start}, 0
        while following := {j for i in level for j in near[i]} - seen:
            level, count = following, count + 1
            seen |= following
        if count <= reach:
            return start
        reach = count
        start = min(level, key=lambda i: (len(near[i]), i))
