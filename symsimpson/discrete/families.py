"""Families of terms that differ only in coordinates and coefficients, such as springs and links.

A family is differentiated once and evaluated in a loop over its members. The terms belong to L, or
to one component of a force. A force component is represented by its virtual work f_i d_i.
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
from symsimpson.graph.nodes import ONE, ZERO, Exact, Graph, Value, exact, scale
from symsimpson.graph.read import tree_size
from symsimpson.graph.rebuild import rebuild

#: Terms with more nodes than this as a tree retain their shared subexpressions.
LARGE_TREE = 10_000
#: Up to this number of terms, nested sums are always split.
MANY_TERMS = 10_000


@dataclass(frozen=True)
class Family:
    """A template term with slots, and the coordinates and coefficients of each member."""

    #: The template as the Lagrangian or the force of a system with one coordinate for each slot.
    #: Its parameters are the slots of coefficients, and then the parameters of the system.
    plain: Plain
    slots: int  #: Number of coefficients that differ among members.
    coordinates: tuple[tuple[int, ...], ...]  #: Coordinates of each member.
    #: Coefficients of each member in the system's graph, as functions of parameters.
    coefficients: tuple[tuple[Value, ...], ...]
    constraints: tuple[int, ...] = ()  #: The constraint of each member, for a template phi.


@dataclass
class _Draft:
    """A family during the search: the template of its first member, and all members so far."""

    term: Value
    coordinates: list[tuple[int, ...]] = field(default_factory=list)
    coefficients: list[tuple[Value, ...]] = field(default_factory=list)
    constraints: list[int] = field(default_factory=list)


def find_families(plain: Plain) -> tuple[Family, ...]:
    """Sort the terms of L = v.M.v/2 + a.v - V, and of the forces, into families.

    The terms without coordinates, velocities, t and inputs form one family of a coefficient.
    """
    matcher = _TermMatcher(plain)
    constants: list[Value] = []
    for term in _terms(plain):
        if matcher.is_variable(term[1]):
            matcher.match(term)
        else:
            constants.append(term)
    constant, drafts = plain.graph.add(constants), [*matcher.drafts.values()]
    if constant[0]:
        drafts.insert(0, _Draft(matcher.graph.symbol("c_0"), [()], [(constant,)]))
    return tuple(_family(plain, matcher.graph, draft) for draft in drafts)


def find_constraint_families(plain: Plain) -> tuple[Family, ...]:
    """Sort the constraints into families. The template of a family is its constraint "phi"."""
    matcher = _TermMatcher(plain)
    for c, phi in enumerate(plain.constraints.values()):
        matcher.match(phi).constraints.append(c)
    phi_families = []
    for draft in matcher.drafts.values():
        family = _family(plain, matcher.graph, draft)
        phi = scale(-1, family.plain.V)  # a term without velocities became -V
        constrained = replace(family.plain, V=ZERO, constraints={"phi": phi})
        phi_families.append(replace(family, plain=constrained))
    return tuple(phi_families)


def _terms(plain: Plain) -> Iterator[Value]:
    """Yield the terms of L and of the forces; adds terms of an entry with equal coordinates."""
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
        yield scale(-1, term)
    for i, force in enumerate(plain.f):
        displaced = graph.symbol(f"d_{i}")
        for term in _collected(graph, force, moving):
            yield graph.multiply([term, displaced])


def _collected(graph: Graph, value: Value, moving: frozenset[int]) -> list[Value]:
    """Split a sum into one term for each set of coordinates and velocities."""
    groups: dict[frozenset[int], list[Value]] = {}
    for term in _split(graph, value, moving):
        groups.setdefault(graph.nodes[term[1]].symbols & moving, []).append(term)
    return [term for terms in groups.values() if (term := graph.add(terms))[0]]


def _split(graph: Graph, value: Value, moving: frozenset[int]) -> Iterator[Value]:
    """Yield the terms of a sum. Expand products of a sum with constants."""
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
    """Return whether nested sums have far more terms than nodes, because they share nodes."""
    terms: dict[int, int] = {}
    for m in graph.descendants([n]):
        kind = graph.nodes[m].kind
        below = [terms[k] for k in graph.arguments(m)] if kind in ("sum", "product") else [1]
        terms[m] = sum(below) if kind == "sum" else max(below)
    return terms[n] > max(MANY_TERMS, 4 * len(terms))


class _TermMatcher:
    """Converts terms to templates with slots, in an order that does not depend on names."""

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

    def is_variable(self, n: int) -> bool:
        """Return whether a node contains a coordinate, a velocity, the time or an input."""
        return not self._source.nodes[n].symbols.isdisjoint(self._moving)

    def match(self, term: Value) -> _Draft:
        """Add a term to the draft with the same template, and return this draft."""
        template = self._to_template(term)
        draft = self.drafts.setdefault(template, _Draft(template))
        draft.coordinates.append(tuple(self._coordinates))
        draft.coefficients.append(tuple(self._coefficients))
        return draft

    def _to_template(self, term: Value) -> Value:
        """Convert a term to a template in the slots q_s, v_s, d_s and c_s."""
        self._coordinates, self._coefficients = [], []
        c, n = term
        large = tree_size(self._source, term) > LARGE_TREE
        self._written = {} if large else None
        sign, body = self._node(n, without_constants=True)
        # the numerical factor of a term is always a coefficient
        c = exact(c * sign)
        front = self._coefficient(self._source.multiply([(c, 0), *self._constant_factors(n)]))
        return self.graph.multiply([front, (1, body)])

    def _constant_factors(self, n: int) -> list[tuple[int, int, Exact]]:
        """List the constant factors of a product as (1, node, exponent); [] for other nodes."""
        kind, parts, _ = self._source.nodes[n]
        factors = parts if kind == "product" else ()
        return [(1, m, e) for m, e in factors if not self.is_variable(m)]

    def _shape(self, n: int) -> tuple[int, tuple[int, ...]]:
        """Return a number for the structure of a node without names, and its coordinates."""
        for m in self._source.descendants([n]) if n not in self._shapes else ():
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
        elif not self.is_variable(n):
            key = "c"
        elif kind == "sum":
            key = (kind, *sorted((_number(c), self._shapes[m][0]) for c, m in parts))
        elif kind == "product":
            key = (kind, *sorted((str(e), self._shapes[m][0]) for m, e in parts))
        else:
            key = (parts[0], *((_number(c), self._shapes[m][0]) for c, m in parts[1:]))
        return self._numbers.setdefault(key, len(self._numbers)), places

    def _node(self, n: int, *, without_constants: bool = False) -> Value:
        """Convert a node to slots. Nodes of large terms are converted once and shared."""
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
        if not self.is_variable(n):
            return ONE if n == 0 else self._coefficient((1, n))
        if kind == "sum":
            order = sorted(parts, key=lambda term: (self._shape(term[1]), _number(term[0])))
            return self.graph.add([self._value(c, m) for c, m in order])
        if kind == "product":
            moving = [(m, e) for m, e in parts if self.is_variable(m)]
            moving.sort(key=lambda factor: (self._shape(factor[0]), str(factor[1])))
            constants = self._constant_factors(n)
            factors = [self.graph.power(self._node(m), e) for m, e in moving]
            if constants and not without_constants:
                factors.append(self._coefficient(self._source.multiply(constants)))
            return self.graph.multiply(factors)
        name, *arguments = parts
        return self.graph.function(name, *(self._value(c, m) for c, m in arguments))

    def _value(self, c: Exact, m: int) -> Value:
        """Convert a multiple of a node. Factors other than 1 and -1 become coefficients."""
        if not self.is_variable(m):
            return (c, m) if m == 0 and _number(c) != "c" else self._coefficient((c, m))
        if _number(c) == "c":
            front = self._coefficient(self._source.multiply([(c, 0), *self._constant_factors(m)]))
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
    """Return the text of 1 and -1, and "c" for any other number, which is a coefficient."""
    return str(c) if abs(c) == 1 else "c"


def _family(system: Plain, read: Graph, draft: _Draft) -> Family:
    """Convert a draft to a family. Coefficients that all members share enter the template.

    A family without coordinates retains its coefficient, because tables need at least one column.
    """
    count, size = len(draft.coefficients[0]), len(draft.coordinates[0])
    columns = [[row[k] for row in draft.coefficients] for k in range(count)]
    varying = [k for k in range(count) if len(set(columns[k])) > 1 or not size]
    q, v, displaced = ([f"{kind}_{s}" for s in range(size)] for kind in "qvd")
    slots = [f"c_{k}" for k in varying]
    graph = Graph()
    numbers = {name: graph.symbol(name) for name in (*q, *v, *displaced, *slots)}
    shared = {
        read.symbol(f"c_{k}")[1]: rebuild(system.graph, [columns[k][0]], {}, graph)[0]
        for k in range(count)
        if k not in varying
    }
    (term,) = rebuild(read, [draft.term], shared, graph)
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
    *linear, potential = rebuild(graph, [*slopes, term], rest) if rest else [term]
    plain = Plain(
        graph=graph,
        q=_symbols(q),
        v=_symbols(v),
        p=(),
        T=quadratic_form(graph, M, places),
        M=M,
        parameters=(*_symbols(slots), *system.parameters),
        a=tuple(linear),
        V=scale(-1, potential),
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
