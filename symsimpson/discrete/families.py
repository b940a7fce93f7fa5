"""Terms that are equal up to coordinates and coefficients: links, springs, dampers, lattice sites.

A family is differentiated once and evaluated in a loop over its members. Its terms are those of L,
or of one component of a force, which is written as the work of a virtual displacement, f_i d_i.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import sympy as sp

from symsimpson.declare.plain import Plain
from symsimpson.declare.quadratic import quadratic_form
from symsimpson.graph.derive import Derivatives
from symsimpson.graph.nodes import ONE, ZERO, Exact, Graph, Value, exact, scaled
from symsimpson.graph.read import tree_size
from symsimpson.graph.rebuild import rebuilt

#: Terms of more nodes than this, written as trees, are written with what they share.
LARGE_TREE = 10_000
#: Sums of sums are split into so many terms at least.
MANY_TERMS = 10_000


@dataclass(frozen=True)
class Family:
    """One term in slots, and the coordinates and coefficients that fill them for each member."""

    #: The term as the Lagrangian, or a force, of a system with one coordinate for each slot; its
    #: parameters are the slots of coefficients, and then those parameters that are the same for all
    #: members.
    plain: Plain
    slots: int  #: Number of coefficients that differ among members.
    coordinates: tuple[tuple[int, ...], ...]  #: Coordinates of each member.
    #: Coefficients of each member in the system's graph, made of parameters.
    coefficients: tuple[tuple[Value, ...], ...]
    constraints: tuple[int, ...] = ()  #: The constraint that each member is, where the term is one.


@dataclass
class _Draft:
    """The members of a family as they are found, and the term in slots that the first one gives."""

    term: Value
    coordinates: list[tuple[int, ...]] = field(default_factory=list)
    coefficients: list[tuple[Value, ...]] = field(default_factory=list)
    constraints: list[int] = field(default_factory=list)


def families(plain: Plain) -> tuple[Family, ...]:
    """Sort the terms of L = v.M.v/2 + a.v - V, and of forces, into families.

    What contains no coordinate, nor t or an input, is one family of its own: a coefficient alone.
    """
    reader = _Reader(plain)
    still: list[Value] = []
    for term in _terms(plain):
        if reader.moves(term[1]):
            reader.draft(term)
        else:
            still.append(term)
    constant, drafts = plain.graph.add(still), [*reader.drafts.values()]
    if constant[0]:
        drafts.insert(0, _Draft(reader.graph.symbol("c_0"), [()], [(constant,)]))
    return tuple(_family(plain, reader.graph, draft) for draft in drafts)


def constraint_families(plain: Plain) -> tuple[Family, ...]:
    """Sort the constraints into families; each stands in the system of its family as its own."""
    reader = _Reader(plain)
    for c, phi in enumerate(plain.constraints.values()):
        reader.draft(phi).constraints.append(c)
    phi_families = []
    for draft in reader.drafts.values():
        family = _family(plain, reader.graph, draft)
        alone = family.plain
        phi = scaled(-1, alone.V)  # the term as it was read, which has no velocities
        constrained = replace(alone, V=ZERO, constraints={"phi": phi})
        phi_families.append(replace(family, plain=constrained))
    return tuple(phi_families)


def _terms(plain: Plain) -> Iterator[Value]:
    """Return the terms of L and of forces; those of the same coordinates in an entry together."""
    graph, v = plain.graph, plain.numbers(plain.v)
    moving = frozenset((*plain.numbers(plain.q), *v))
    for (i, j), entry in sorted(plain.M.items()):
        half = Fraction(1, 2) if i == j else 1
        for term in _collected(graph, entry, moving):
            yield graph.multiply([(half, v[i]), (1, v[j]), term])
    for a, x in zip(plain.a, v, strict=True):
        for term in _collected(graph, a, moving):
            yield graph.multiply([term, (1, x)])
    for term in _collected(graph, plain.V, moving):
        yield scaled(-1, term)
    for i, force in enumerate(plain.f):
        displaced = graph.symbol(f"d_{i}")
        for term in _collected(graph, force, moving):
            yield graph.multiply([term, displaced])


def _collected(graph: Graph, value: Value, moving: frozenset[int]) -> list[Value]:
    """Split a sum by the coordinates that its terms stand for."""
    groups: dict[frozenset[int], list[Value]] = {}
    for term in _split(graph, value, moving):
        groups.setdefault(graph.nodes[term[1]].symbols & moving, []).append(term)
    return [term for terms in groups.values() if (term := graph.add(terms))[0]]


def _split(graph: Graph, value: Value, moving: frozenset[int]) -> Iterator[Value]:
    """Return the terms of a sum, and of sums that only constants are multiplied with."""
    work = [value]
    if _too_many(graph, value[1]):
        if value[0]:
            yield value
        return
    while work:
        c, n = work.pop()
        kind, parts, _ = graph.nodes[n]
        if kind == "sum" and len({graph.nodes[m].symbols & moving for _, m in parts}) > 1:
            work += [(exact(c * d), m) for d, m in reversed(parts)]
            continue
        if kind == "product":
            late = [(m, e) for m, e in parts if not graph.nodes[m].symbols.isdisjoint(moving)]
            if len(late) == 1 and late[0][1] == 1 and graph.nodes[late[0][0]].kind == "sum":
                inner = list(_split(graph, (1, late[0][0]), moving))
                if len(inner) > 1:
                    rest = [(1, m, e) for m, e in parts if m != late[0][0]]
                    for term in inner:
                        yield graph.multiply([(c, 0), *rest, term])
                    continue
        if c:
            yield c, n


def _too_many(graph: Graph, n: int) -> bool:
    """Return whether sums of sums have far more terms than nodes, as what is shared is repeated."""
    terms: dict[int, int] = {}
    for m in graph.reached([n]):
        kind = graph.nodes[m].kind
        below = [terms[k] for k in graph.arguments(m)] if kind in ("sum", "product") else [1]
        terms[m] = sum(below) if kind == "sum" else max(below)
    return terms[n] > max(MANY_TERMS, 4 * len(terms))


class _Reader:
    """Writes terms in slots, in an order that does not depend on names."""

    def __init__(self, plain: Plain) -> None:
        self.graph = Graph()
        self._plain, self._source = plain, plain.graph
        q, v = plain.numbers(plain.q), plain.numbers(plain.v)
        displaced = self._source.numbers(f"d_{i}" for i in range(len(q)))
        self._place = {x: i for group in (q, v, displaced) for i, x in enumerate(group)}
        self._kind = {x: kind for kind, xs in (("q", q), ("v", v), ("d", displaced)) for x in xs}
        #: The time and inputs, which are the same for all members of a family.
        self._common = {x: s.name for s in (*plain.u, plain.t) for x in plain.numbers([s])}
        self._moving = self._place.keys() | self._common.keys()
        self._shapes: dict[int, tuple[int, tuple[int, ...]]] = {}
        self._numbers: dict[Any, int] = {}
        self._coordinates: list[int] = []
        self._coefficients: list[Value] = []
        self.drafts: dict[Value, _Draft] = {}
        self._written: dict[tuple[int, bool], Value] | None = None

    def moves(self, n: int) -> bool:
        """Return whether a node contains a coordinate or a velocity, the time or an input."""
        return not self._source.nodes[n].symbols.isdisjoint(self._moving)

    def draft(self, term: Value) -> _Draft:
        """Put a term beside those that are the same in slots; return the draft of all of them."""
        read = self._read(term)
        draft = self.drafts.setdefault(read, _Draft(read))
        draft.coordinates.append(tuple(self._coordinates))
        draft.coefficients.append(tuple(self._coefficients))
        return draft

    def _read(self, term: Value) -> Value:
        """Write a term in slots q_s, v_s, c_s."""
        self._coordinates, self._coefficients = [], []
        c, n = term
        large = tree_size(self._source, term) > LARGE_TREE
        self._written = {} if large else None
        kind, parts, _ = self._source.nodes[n]
        still = [(1, m, e) for m, e in parts if not self.moves(m)] if kind == "product" else []
        sign, body = self._node(n, without_constants=True)
        # the number in front is always a coefficient
        front = self._coefficient(self._source.multiply([(exact(c * sign), 0), *still]))
        return self.graph.multiply([front, (1, body)])

    def _shape(self, n: int) -> tuple[int, tuple[int, ...]]:
        """Return a number for what is left of a node without its names, and its coordinates."""
        for m in self._source.reached([n]) if n not in self._shapes else ():
            if m not in self._shapes:
                self._shapes[m] = self._new_shape(m)
        return self._shapes[n]

    def _new_shape(self, n: int) -> tuple[int, tuple[int, ...]]:
        kind, parts, symbols = self._source.nodes[n]
        places = tuple(sorted({self._place[x] for x in symbols if x in self._place}))
        key: Any
        if n in self._kind:
            key = self._kind[n]
        elif n in self._common:
            key = ("common", self._common[n])
        elif not self.moves(n):
            key = "c"
        elif kind == "sum":
            key = (kind, *sorted((_number(c), self._shapes[m][0]) for c, m in parts))
        elif kind == "product":
            key = (kind, *sorted((str(e), self._shapes[m][0]) for m, e in parts))
        else:
            key = (parts[0], *((_number(c), self._shapes[m][0]) for c, m in parts[1:]))
        return self._numbers.setdefault(key, len(self._numbers)), places

    def _node(self, n: int, *, without_constants: bool = False) -> Value:
        """Write a node in slots; of large terms once, with the same coefficients everywhere."""
        if self._written is None:
            return self._new_node(n, without_constants)
        key = n, without_constants
        if key not in self._written:
            self._written[key] = self._new_node(n, without_constants)
        return self._written[key]

    def _new_node(self, n: int, without_constants: bool) -> Value:
        kind, parts, _ = self._source.nodes[n]
        if n in self._place:
            return self._slot(n)
        if n in self._common:
            return self.graph.symbol(self._common[n])
        if not self.moves(n):
            return ONE if n == 0 else self._coefficient((1, n))
        if kind == "sum":
            order = sorted(parts, key=lambda term: (self._shape(term[1]), _number(term[0])))
            return self.graph.add([self._value(c, m) for c, m in order])
        if kind == "product":
            moving = [(m, e) for m, e in parts if self.moves(m)]
            moving.sort(key=lambda factor: (self._shape(factor[0]), str(factor[1])))
            still = [(1, m, e) for m, e in parts if not self.moves(m)]
            factors = [self.graph.power(self._node(m), e) for m, e in moving]
            if still and not without_constants:
                factors.append(self._coefficient(self._source.multiply(still)))
            return self.graph.multiply(factors)
        name, *arguments = parts
        return self.graph.function(name, *(self._value(c, m) for c, m in arguments))

    def _value(self, c: Exact, m: int) -> Value:
        """Write a multiple of a node: its sign as it is, other numbers as coefficients."""
        if not self.moves(m):
            return (c, m) if m == 0 and _number(c) != "c" else self._coefficient((c, m))
        if _number(c) == "c":
            kind, parts, _ = self._source.nodes[m]
            still = [(1, k, e) for k, e in parts if not self.moves(k)] if kind == "product" else []
            front = self._coefficient(self._source.multiply([(c, 0), *still]))
            return self.graph.multiply([front, self._node(m, without_constants=True)])
        d, n = self._node(m)
        return exact(c * d), n

    def _slot(self, n: int) -> Value:
        place = self._place[n]
        if place not in self._coordinates:
            self._coordinates.append(place)
        return self.graph.symbol(f"{self._kind[n]}_{self._coordinates.index(place)}")

    def _coefficient(self, value: Value) -> Value:
        self._coefficients.append(value)
        return self.graph.symbol(f"c_{len(self._coefficients) - 1}")


def _number(c: Exact) -> str:
    """Return one and minus one as they stand, any other number as a coefficient."""
    return str(c) if abs(c) == 1 else "c"


def _family(system: Plain, read: Graph, draft: _Draft) -> Family:
    """Make a family; a coefficient that all members share stands in the term itself.

    A member without coordinates keeps its coefficient: tables have a column at least.
    """
    count, size = len(draft.coefficients[0]), len(draft.coordinates[0])
    columns = [[row[k] for row in draft.coefficients] for k in range(count)]
    varying = [k for k in range(count) if len(set(columns[k])) > 1 or not size]
    q, v, displaced = ([f"{kind}_{s}" for s in range(size)] for kind in "qvd")
    slots = [f"c_{k}" for k in varying]
    graph = Graph()
    numbers = {name: graph.symbol(name) for name in (*q, *v, *displaced, *slots)}
    shared = {
        read.symbol(f"c_{k}")[1]: rebuilt(system.graph, [columns[k][0]], {}, graph)[0]
        for k in range(count)
        if k not in varying
    }
    (term,) = rebuilt(read, [draft.term], shared, graph)
    places = [numbers[name][1] for name in v]
    rest = dict.fromkeys(places, ZERO)
    derivatives = Derivatives(graph)
    force = tuple(derivatives(term, numbers[name][1]) for name in displaced)
    forced = any(f[0] for f in force)
    term = ZERO if forced else term
    slopes = [derivatives(term, x) for x in places]
    M = {
        (a, b): entry
        for a, slope in enumerate(slopes)
        for b, x in enumerate(places[: a + 1])
        if (entry := derivatives(slope, x))[0]
    }
    *linear, potential = rebuilt(graph, [*slopes, term], rest) if rest else [term]
    plain = Plain(
        graph=graph,
        q=_symbols(q),
        v=_symbols(v),
        p=(),
        T=quadratic_form(graph, M, places),
        M=M,
        parameters=(*_symbols(slots), *system.parameters),
        a=tuple(linear),
        V=scaled(-1, potential),
        invariants={},
        t=system.t,
        u=system.u,
        forces={"of a member": force} if forced else {},
    )
    coefficients = tuple(tuple(row[k] for k in varying) for row in draft.coefficients)
    members = tuple(draft.coordinates), coefficients, tuple(draft.constraints)
    return Family(plain, len(slots), *members)


def _symbols(names: Sequence[str]) -> tuple[sp.Symbol, ...]:
    return tuple(sp.Symbol(name, real=True) for name in names)
