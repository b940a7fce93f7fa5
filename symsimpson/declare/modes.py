"""The modes of a system with contacts and dry friction: smooth systems with other constraints.

A contact that rests is a constraint gap = 0, and an element that sticks a velocity constraint
u = 0. An element that slides exerts the force -s F A^T, where s is its direction, a parameter of
the mode. The normal force of Coulomb's law is a function of q, v and t at the nodes: the
multiplier that keeps the gap at zero. With the multipliers of the steps, the order would be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import Any

import sympy as sp

from symsimpson.declare.checks import reject_model, spell
from symsimpson.declare.constraints import accelerations, split_row
from symsimpson.declare.contacts import Contact, slip
from symsimpson.declare.declared import Declared
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.forces import OTHERS
from symsimpson.declare.index_one import IndexOneFunction
from symsimpson.declare.plain import ConstraintRows, Symbols
from symsimpson.graph.findings import IdentityTest
from symsimpson.graph.nodes import ONE, UNIT, ZERO, Graph, Value, scale
from symsimpson.graph.read import to_sympy, tree_size
from symsimpson.graph.rebuild import rebuild
from symsimpson.support.contact_values import OF_CONTACT, Mode
from symsimpson.support.literals import float_literals
from symsimpson.support.names import did_you_mean, spelled

#: A sliding contact has no normal force if the determinant of its equations, relative to the one
#: without friction, is below this.
PARADOX = Fraction(1, 10**9)
#: Longest text of an expression that a run evaluates after each step.
LONGEST = 100_000


class Modes:
    """The contacts and friction elements of a system, as values of a graph, and its modes.

    ``make`` makes the system of a mode from its fields.
    """

    def __init__(self, system: Declared, make: Callable[..., Declared]) -> None:
        self._system, self._make_system = system, make
        self._symbols = symbols = Symbols(system.coordinates, system.parameters, system.inputs)
        graph = symbols.graph
        self._speed = sp.Symbol("slip", real=True)
        speed = symbols.add(self._speed)
        q, v, a = symbols.q, symbols.v, symbols.a
        #: Names of the contacts, and their restitutions.
        self.contacts = tuple(system.contacts)
        self.restitutions = tuple(x.restitution for x in system.contacts.values())
        declared: list[tuple[str, Any, Any, Any, int | None]] = [
            (f"{key}{OF_CONTACT}", x.slip, x.friction, x.static, k)
            for k, (key, x) in enumerate(system.contacts.items())
            if x.friction is not None
        ]
        declared += [
            (key, x.velocity, x.limit, x.static, None) for key, x in system.friction.items()
        ]
        #: Names of the friction elements, and the number of the contact of each, or None.
        self.elements = tuple(key for key, *_ in declared)
        self.contact_of = tuple(contact for *_, contact in declared)
        self.velocities = tuple(sp.sympify(x) for _, x, *_ in declared)
        self._check_names()
        if system.plain.hamiltonian is not None or not system.plain.quadratic:
            self._reject(
                "it has contacts or dry friction, but its Lagrangian is not quadratic in the "
                "velocities.",
                "Declare T and V: normal forces need a positive definite mass matrix.",
            )
        self.gaps = [
            self._read_gap(key, contact, symbols) for key, contact in system.contacts.items()
        ]
        known = {**symbols.known, slip: speed}
        self.rows: list[tuple[Value, ...]] = []
        self.limits: list[Value] = []
        self.statics: list[Value] = []
        for key, velocity, limit, static, _ in declared:
            what = f"velocity of {key!r}"
            places = (*q, *v, *a, symbols.t)
            value = read_expression(system.name, what, velocity, symbols, symbols.known, places)
            self.rows.append(split_row(system.name, key, velocity, value, symbols))
            places = (*q, *a, *symbols.u, symbols.t, self._speed)
            numbers = [
                read_expression(system.name, f"limit of {key!r}", x, symbols, known, places)
                for x in (limit, *(() if static is None else (static,)))
            ]
            self.limits.append(numbers[0])
            self.statics += rebuild(graph, numbers[-1:], {speed[1]: ZERO})

    @property
    def works(self) -> bool:
        """Whether friction, or contacts that move, do work."""
        nodes, (time,) = self._symbols.graph.nodes, self._symbols.numbers([self._symbols.t])
        return bool(self.elements) or any(time in nodes[n].symbols for _, n in self.gaps)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the contacts, then of the friction elements."""
        return (*self.contacts, *self.elements)

    def _reject(self, what: str, remedy: str) -> None:
        reject_model(self._system.name, what, remedy)

    def _check_names(self) -> None:
        system = self._system
        taken: dict[str, str] = {spelled(x): "a coordinate" for x in system.coordinates}
        taken |= dict.fromkeys(system.plain.constraint_names, "a constraint")
        taken |= dict.fromkeys((*system.plain.forces, *OTHERS), "a force")
        for key in self.names:
            if key in taken:
                self._reject(
                    f"{key!r} is the name of a contact or a friction element, and of {taken[key]}.",
                    "Give each its own name.",
                )
            taken[key] = "another element"

    def _read_gap(self, key: str, contact: Contact, symbols: Symbols) -> Value:
        name, graph = self._system.name, symbols.graph
        moving = contact.gap.atoms(sp.Derivative)
        if moving:
            self._reject(
                f"the gap {key!r} contains the velocity {spell(moving.pop())}.",
                "A gap is a distance: an expression of coordinates and the time.",
            )
        places = (*symbols.q, *symbols.a, symbols.t)
        value = read_expression(name, f"gap {key!r}", contact.gap, symbols, symbols.known, places)
        present = graph.nodes[value[1]].symbols & set(symbols.numbers(symbols.q))
        findings = IdentityTest(graph, [value])
        if not any(findings.depends(value, x) for x in present):
            self._reject(
                f"the gap {key!r}, {spell(contact.gap)}, depends on no coordinate.",
                "Write a distance that is positive where the bodies are apart.",
            )
        return value

    @cached_property
    def index_one(self) -> IndexOneFunction:
        """Evaluates accelerations, gaps, velocities of sliding and limits at states."""
        plain, limits = self._system.plain, [*self.limits, *self.statics]
        return IndexOneFunction(
            plain, self._symbols.graph, self.gaps, self.rows, limits, self._speed
        )

    @cached_property
    def _made(self) -> dict[Mode, Declared]:
        return {}

    def system_of(self, key: Mode) -> Declared:
        """Return the system of a mode; directions of sliding are its last parameters."""
        if key not in self._made:
            self._made[key] = self._make(key)
        return self._made[key]

    def read(self, given: Mapping[str, Any]) -> Mode:
        """Read a mode as users write it: ``{"floor": "rest", "belt": 0}``."""
        wanted: dict[str, Any] = dict.fromkeys(self.contacts, "open")
        wanted |= {
            x: 1 if c is None else None for x, c in zip(self.elements, self.contact_of, strict=True)
        }
        states: dict[str, tuple[Any, ...]] = dict.fromkeys(self.contacts, ("open", "rest"))
        states |= dict.fromkeys(self.elements, (0, 1, -1, None))
        for key, state in given.items():
            if key not in wanted or not any(state is x or state == x for x in states[key]):
                hint = did_you_mean(key, self.names)
                self._reject(
                    f"a mode has no {key!r} in the state {state!r}.{hint}",
                    'Contacts are "open" or "rest", and friction is 0, 1, -1, or None at a '
                    f"contact that is open. The names are {', '.join(self.names)}.",
                )
            wanted[key] = state
        contacts = tuple(wanted[x] == "rest" for x in self.contacts)
        elements = tuple(
            None if c is not None and not contacts[c] else 1 if wanted[x] is None else wanted[x]
            for x, c in zip(self.elements, self.contact_of, strict=True)
        )
        return Mode(contacts, elements)

    def _make(self, key: Mode) -> Declared:
        system = self._system
        pairs = [*zip(self.elements, key.elements, range(len(self.elements)), strict=True)]
        sliding = [(name, k) for name, x, k in pairs if x]
        sticking = [(name, k) for name, x, k in pairs if x == 0]
        resting = [k for k, rests in enumerate(key.contacts) if rests]
        gaps = {self.contacts[k]: system.contacts[self.contacts[k]].gap for k in resting}
        signs = {sp.Symbol(f"sign_{name}", real=True): float(x) for name, x, _ in pairs if x}
        given = {f.name: getattr(system, f.name) for f in fields(Declared) if f.init}
        given |= {
            "positions": None,
            "invariants": None,
            "contacts": {},
            "friction": {},
            "parameters": {**system.parameters, **signs},
            "constraints": {**system.constraints, **gaps},
            "velocity_constraints": {
                **system.velocity_constraints,
                **{name: self.velocities[k] for name, k in sticking},
            },
        }
        mode = self._make_system(**given)
        forces, texts = self._write(mode, key, resting, sticking, sliding)
        plain = replace(mode.plain, forces=MappingProxyType({**mode.plain.forces, **forces}))
        for name, value in {"plain": plain, "base": system, "key": key, "texts": texts}.items():
            object.__setattr__(mode, name, value)
        return mode

    def _write(
        self,
        mode: Declared,
        key: Mode,
        resting: Sequence[int],
        sticking: Sequence[tuple[str, int]],
        sliding: Sequence[tuple[str, int]],
    ) -> tuple[dict[str, tuple[Value, ...]], dict[str, str]]:
        """Return the forces of sliding elements by name, and the texts for events."""
        plain, ours = mode.plain, self._symbols.graph
        graph, v, first = plain.graph, plain.numbers(plain.v), len(self._system.parameters)
        signs = plain.numbers(plain.parameters[first:])
        (speed,) = ours.numbers([self._speed.name])
        texts: dict[str, Value] = {}
        rows: dict[int, list[Value]] = {}
        limits: dict[int, Value] = {}
        for (name, k), sign in zip(sliding, signs, strict=True):
            *row, b = rebuild(ours, self.rows[k], {}, graph)
            u = graph.add([*graph.products(row, v), scale(-1, b)])
            texts[name] = graph.multiply([u, (1, sign)])
            rows[k] = graph.products(row, [sign] * len(row))
            (limits[k],) = rebuild(ours, [self.limits[k]], {speed: texts[name]}, graph)
        for name, k in sticking:
            (texts[name],) = rebuild(ours, [self.statics[k]], {}, graph)
        alone = {k: limits[k] for _, k in sliding if self.contact_of[k] is None}
        normal: dict[int, Value] = {}
        at_contacts = [k for _, k in sliding if self.contact_of[k] is not None]
        if at_contacts:
            try:
                normal, texts["margin"] = self._normal_forces(mode, resting, rows, limits, alone)
            except ZeroDivisionError:
                self._reject(
                    "the mass matrix is singular without the constraints, so the normal force of a "
                    "contact with friction cannot be written.",
                    "Use coordinates without quaternions, or contacts without friction.",
                )
        forces = {}
        for name, k in sliding:
            contact = self.contact_of[k]
            size = limits[k] if contact is None else graph.multiply([limits[k], normal[contact]])
            forces[name] = tuple(scale(-1, graph.multiply([size, x])) for x in rows[k])
        return forces, self._written(mode, texts)

    def _normal_forces(
        self,
        mode: Declared,
        resting: Sequence[int],
        rows: Mapping[int, list[Value]],
        limits: Mapping[int, Value],
        alone: Mapping[int, Value],
    ) -> tuple[dict[int, Value], Value]:
        """Return the normal forces of sliding contacts, and how far they are from a paradox.

        M v' = push + P x and W v' = -curve are solved by elimination. P has the column n - mu A of
        a sliding contact, with A in the direction of sliding, and columns of W for all others.
        """
        plain, n = mode.plain, len(mode.plain.q)
        graph = plain.graph
        f = [*plain.f]
        for k, size in alone.items():
            f = [
                graph.add([x, scale(-1, graph.multiply([size, y]))])
                for x, y in zip(f, rows[k], strict=True)
            ]
        places = plain.numbers(plain.q), plain.numbers(plain.v), plain.time
        held: ConstraintRows = plain.write_constraints(graph)
        terms = accelerations(graph, plain.L, held, f, places)
        begin = len(self._system.constraints)
        of_contact = {begin + i: c for i, c in enumerate(resting)}
        columns = [list(row) for row in terms.rows]
        for k, row in rows.items():
            c = self.contact_of[k]
            if c is not None:
                place = begin + resting.index(c)
                pulls = [graph.multiply([limits[k], x]) for x in row]
                columns[place] = [
                    graph.add([x, scale(-1, y)]) for x, y in zip(columns[place], pulls, strict=True)
                ]
        oblique = [i for i, c in of_contact.items() if any(self.contact_of[k] == c for k in rows)]
        order = [i for i in range(len(columns)) if i not in oblique] + oblique
        M = [[plain.entry(i, j) for j in range(n)] for i in range(n)]
        lower = [terms.rows[i] for i in order]
        solved, pivots = _eliminate(
            graph,
            M,
            lower,
            [columns[i] for i in order],
            terms.push,
            [scale(-1, terms.curve[i]) for i in order],
        )
        _, straight = _eliminate(graph, M, lower, lower, terms.push, [ZERO] * len(order))
        margin = ONE
        for pivot, usual in zip(pivots[-len(oblique) :], straight[-len(oblique) :], strict=True):
            margin = graph.multiply([margin, pivot, graph.power(usual, -1)])
        normal = {of_contact[i]: solved[order.index(i)] for i in oblique}
        return normal, graph.add([margin, (-PARADOX, UNIT)])

    def _written(self, mode: Declared, texts: Mapping[str, Value]) -> dict[str, str]:
        """Write values in the plain symbols of kernels; long margins are left out."""
        plain = mode.plain
        changing = set(plain.numbers((*plain.q, *plain.v, plain.t)))
        if changing.isdisjoint(plain.graph.nodes[texts.get("margin", ZERO)[1]].symbols):
            texts = {key: x for key, x in texts.items() if key != "margin"}
        symbols = {x: x for x in plain.symbols} | {plain.t: sp.Symbol("t")}
        known = {plain.graph.symbol(x.name)[1]: y for x, y in symbols.items()}
        known[plain.graph.constant("Tiny")[1]] = sp.S.Zero
        if tree_size(plain.graph, texts.get("margin", ZERO)) > LONGEST:
            texts = {key: x for key, x in texts.items() if key != "margin"}
        written = {
            name: str(float_literals(to_sympy(plain.graph, value, known)))
            for name, value in texts.items()
        }
        return {name: text for name, text in written.items() if len(text) <= LONGEST}


def _eliminate(
    graph: Graph,
    M: Sequence[Sequence[Value]],
    rows: Sequence[Sequence[Value]],
    columns: Sequence[Sequence[Value]],
    push: Sequence[Value],
    right: Sequence[Value],
) -> tuple[list[Value], list[Value]]:
    """Solve M a - P x = push, W a = right for x; return x and the pivots of x.

    Elimination has no row exchanges, because M and W M^-1 W^T are positive definite.
    """
    n, m = len(M), len(rows)
    size = n + m
    matrix = [[*M[i], *(scale(-1, columns[c][i]) for c in range(m)), push[i]] for i in range(n)]
    matrix += [[*rows[c], *[ZERO] * m, right[c]] for c in range(m)]
    for k in range(size):
        inverse = graph.power(matrix[k][k], -1)
        for i in range(k + 1, size):
            if not matrix[i][k][0]:
                continue
            factor = graph.multiply([matrix[i][k], inverse])
            for j in range(k + 1, size + 1):
                if matrix[k][j][0]:
                    taken = scale(-1, graph.multiply([factor, matrix[k][j]]))
                    matrix[i][j] = graph.add([matrix[i][j], taken])
    x: list[Value] = [ZERO] * m
    for c in reversed(range(m)):
        k = n + c
        others = [scale(-1, graph.multiply([matrix[k][n + d], x[d]])) for d in range(c + 1, m)]
        left = graph.add([matrix[k][size], *others])
        x[c] = graph.multiply([left, graph.power(matrix[k][k], -1)])
    return x, [matrix[n + c][n + c] for c in range(m)]
