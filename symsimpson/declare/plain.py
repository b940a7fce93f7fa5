"""A system as a graph, whose symbols do not depend on the user's names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from random import Random
from typing import Any, NamedTuple, TypeAlias

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import time
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import ZERO, Graph, Value, scale
from symsimpson.graph.read import to_sympy
from symsimpson.graph.rebuild import rebuild
from symsimpson.graph.roots import Signs

Matrix: TypeAlias = sp.ImmutableDenseMatrix
#: Assumptions of SymPy, the strongest last: a sign, and whether zero is excluded.
SIGNS = {
    "nonpositive": (-1, False),
    "nonnegative": (1, False),
    "negative": (-1, True),
    "positive": (1, True),
}
#: Number of random points at which values are evaluated in doubles.
SAMPLES = 3
#: The plain symbol of the time.
TIME = sp.Symbol("t_0", real=True)


class ConstraintRows(NamedTuple):
    """The values phi of constraints of positions, and the rows (A, b) of A v = b."""

    phi: tuple[Value, ...]
    rows: tuple[tuple[Value, ...], ...] = ()

    def sides(self, graph: Graph, time: int) -> list[Value]:
        """Write the right-hand sides of Phi v = -phi_t and A v = b."""
        still = [gradient(graph, phi, [time])[0] for phi in self.phi]
        return [*(scale(-1, slope) for slope in still), *(row[-1] for row in self.rows)]

    def rates(self, graph: Graph, v: Sequence[int]) -> list[Value]:
        """Write A v - b of each velocity constraint."""
        return [graph.add([*graph.products(row, v), scale(-1, b)]) for *row, b in self.rows]

    def pulls(self, graph: Graph, q: Sequence[int], multipliers: Sequence[int]) -> list[Value]:
        """Write Phi^T lambda + A^T nu, one entry for each coordinate."""
        m = len(self.phi)
        slopes = gradient(graph, graph.add(graph.products(self.phi, multipliers[:m])), q)
        turned = (
            graph.products([row[a] for row in self.rows], multipliers[m:]) for a in range(len(q))
        )
        return [graph.add([slope, *more]) for slope, more in zip(slopes, turned, strict=True)]


@dataclass(frozen=True)
class Plain:
    """A system in a graph: L = T + a(q).v - V(q), T = v.M(q).v/2, and forces f(t, q, v, u).

    A ``lagrangian`` that is not quadratic in the velocities is a value of its own. Then M = L_vv,
    a = L_v - M v and V = v.L_v - L - T depend on v, and L = T + a.v - V holds at each v.

    ``q``, ``v``, ``p``, ``t``, ``u`` and ``parameters`` are real symbols with plain names, and
    are symbols of the graph, too. ``M`` has the nonzero entries on and below the diagonal. M, a
    and V may depend on t as well. ``forces`` has the components of each named force, and ``u``
    their inputs. ``constraints`` are phi(t, q) = 0. ``velocity_constraints`` are rows of
    A(t, q) v = b(t, q), each followed by b.

    A step may treat linear damping exactly. Then -2 ``rate`` L_v enters its weights, or
    ``rates`` times M v enters its kicks, and ``acting`` are the remaining forces.
    """

    graph: Graph
    q: tuple[sp.Symbol, ...]
    v: tuple[sp.Symbol, ...]
    p: tuple[sp.Symbol, ...]
    parameters: tuple[sp.Symbol, ...]
    T: Value
    M: Mapping[tuple[int, int], Value]
    a: tuple[Value, ...]
    V: Value
    invariants: Mapping[str, Value]
    t: sp.Symbol = TIME
    forces: Mapping[str, tuple[Value, ...]] = field(default_factory=dict)
    u: tuple[sp.Symbol, ...] = ()
    constraints: Mapping[str, Value] = field(default_factory=dict)
    velocity_constraints: Mapping[str, tuple[Value, ...]] = field(default_factory=dict)
    rate: Value | None = None
    rates: tuple[Value, ...] = ()
    acting: tuple[Value, ...] | None = None
    lagrangian: Value | None = None
    definite: bool = True  #: False if M has eigenvalues of both signs.
    #: H(q, p) of a system that has no Lagrangian; the symbols v then stand for the momenta.
    hamiltonian: Value | None = None

    @property
    def quadratic(self) -> bool:
        """Whether L is quadratic in the velocities."""
        return self.lagrangian is None

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        """All symbols: q, v, p, the parameters, the inputs and t."""
        return (*self.q, *self.v, *self.p, *self.parameters, *self.u, self.t)

    @property
    def constraint_names(self) -> tuple[str, ...]:
        """Names of the constraints of positions, then of the velocity constraints."""
        return (*self.constraints, *self.velocity_constraints)

    @property
    def multipliers(self) -> tuple[sp.Symbol, ...]:
        """One symbol for the multiplier of each constraint."""
        return tuple(sp.Symbol(f"l_{c}", real=True) for c in range(len(self.constraint_names)))

    def write_constraints(self, graph: Graph) -> ConstraintRows:
        """Write the constraints in another graph that has symbols of the same names."""
        values = rebuild(self.graph, self.constraint_values, {}, graph)
        m, width = len(self.constraints), len(self.q) + 1
        rows = (tuple(values[k : k + width]) for k in range(m, len(values), width))
        return ConstraintRows(tuple(values[:m]), tuple(rows))

    @property
    def constraint_values(self) -> list[Value]:
        """The phi of each constraint of positions, then the rows of A, each followed by b."""
        rows = self.velocity_constraints.values()
        return [*self.constraints.values(), *(value for row in rows for value in row)]

    @property
    def constrained_coordinates(self) -> list[frozenset[int]]:
        """For each velocity constraint, the coordinates in its row and in its coefficients."""
        nodes, place = self.graph.nodes, {x: i for i, x in enumerate(self.numbers(self.q))}
        return [
            frozenset(i for i, (c, _) in enumerate(row[:-1]) if c)
            | {place[x] for _, n in row for x in nodes[n].symbols & place.keys()}
            for row in self.velocity_constraints.values()
        ]

    @property
    def step(self) -> tuple[sp.Symbol, sp.Symbol, sp.Symbol]:
        """Symbols for h, for a node's place in the step, and for 1 if v scales with 1/h."""
        h, place, moving = (sp.Symbol(f"s_{k}", real=True) for k in range(3))
        return h, place, moving

    @property
    def weights(self) -> tuple[sp.Symbol, ...]:
        """Symbols for weights of F, P and a cost, or of momenta and constraints."""
        return tuple(sp.Symbol(f"w_{k}", real=True) for k in range(2 * len(self.q) + 1))

    def numbers(self, symbols: Iterable[sp.Symbol]) -> tuple[int, ...]:
        """Return the node of each symbol."""
        return self.graph.numbers(s.name for s in symbols)

    @property
    def L(self) -> Value:
        """The Lagrangian."""
        if self.lagrangian is not None:
            return self.lagrangian
        if self.hamiltonian is not None:  # p.v - H
            pairs = self.graph.products(self.velocities, self.numbers(self.v))
            return self.graph.add([*pairs, scale(-1, self.hamiltonian)])
        linear = self.graph.products(self.a, self.numbers(self.v))
        return self.graph.add([self.T, *linear, scale(-1, self.V)])

    @cached_property
    def velocities(self) -> tuple[Value, ...]:
        """The velocities H_p of a Hamiltonian, by coordinate."""
        assert self.hamiltonian is not None
        return tuple(gradient(self.graph, self.hamiltonian, self.numbers(self.v)))

    @cached_property
    def resting(self) -> Plain:
        """The system with M, a and V at v = 0 if L is not quadratic; they are 0 if undefined."""
        if self.quadratic:
            return self
        try:
            values = rebuild(self.graph, self.energies, dict.fromkeys(self.numbers(self.v), ZERO))
        except ZeroDivisionError:
            values = [ZERO] * len(self.energies)
        *values, V = values
        M, a = values[: len(self.M)], values[len(self.M) :]
        of_places = dict(zip(self.M, M, strict=True))
        return replace(self, lagrangian=None, M=of_places, a=tuple(a), V=V)

    @property
    def linear(self) -> Value:
        """The term of L that is linear in the velocities, a.v."""
        return self.graph.add(self.graph.products(self.a, self.numbers(self.v)))

    @property
    def energies(self) -> tuple[Value, ...]:
        """The entries of M and a, and V; or H."""
        if self.hamiltonian is not None:
            return (self.hamiltonian,)
        return (*self.M.values(), *self.a, self.V)

    @cached_property
    def f(self) -> tuple[Value, ...]:
        """The sum of all forces in the equations of motion, by coordinate."""
        if self.acting is not None:
            return self.acting
        size, forces = range(len(self.q)), self.forces.values()
        return tuple(self.graph.add(force[i] for force in forces) for i in size)

    @cached_property
    def right_sides(self) -> tuple[Value, ...]:
        """dL/dq + f, the right sides of Lagrange's equations, by coordinate."""
        if self.hamiltonian is not None:
            slopes = [
                scale(-1, x) for x in gradient(self.graph, self.hamiltonian, self.numbers(self.q))
            ]
        else:
            slopes = gradient(self.graph, self.L, self.numbers(self.q))
        return tuple(map(self.graph.add, zip(slopes, self.f, strict=True)))

    @cached_property
    def time(self) -> int:
        """The node of t."""
        return self.graph.symbol(self.t.name)[1]

    @cached_property
    def autonomous(self) -> bool:
        """True if neither L, nor a force, nor a constraint depends on t."""
        written = (*self.energies, *self.f, *self.constraint_values)
        return all(self.time not in self.graph.nodes[n].symbols for _, n in written)

    @cached_property
    def dragged(self) -> bool:
        """True if a force contains a velocity."""
        nodes, v = self.graph.nodes, set(self.numbers(self.v))
        return any(not nodes[n].symbols.isdisjoint(v) for _, n in self.f)

    @cached_property
    def conservative(self) -> bool:
        """True if the energy is constant: no force, no t, and no constraint that does work."""
        return not self.forces and self.autonomous and not self.carried

    @property
    def carried(self) -> bool:
        """True if a constraint moves, and so does work: A v = b with a nonzero b, or phi(t, q)."""
        return self.moving or any(row[-1][0] for row in self.velocity_constraints.values())

    @property
    def first_side(self) -> int:
        """The first constraint with a right-hand side: the first of all, if positions move."""
        return 0 if self.moving else len(self.constraints)

    @cached_property
    def moving(self) -> bool:
        """True if a constraint of positions contains the time."""
        nodes = self.graph.nodes
        return any(self.time in nodes[n].symbols for _, n in self.constraints.values())

    @cached_property
    def powers(self) -> dict[str, Value]:
        """The power f.v of each force, and dL/dt if L or a force contains t.

        Constraints that move have the power 0 here: they do work between nodes only.
        """
        graph, v = self.graph, self.numbers(self.v)
        powers = {
            f"of {name}": graph.add(
                graph.products(force, v)
                if self.hamiltonian is None
                else (graph.multiply(pair) for pair in zip(force, self.velocities, strict=True))
            )
            for name, force in self.forces.items()
        }
        if self.carried:
            powers["of constraints"] = ZERO
        if not self.autonomous:
            minus_H = None if self.hamiltonian is None else scale(-1, self.hamiltonian)
            (powers["dL_dt"],) = gradient(graph, minus_H or self.L, [self.time])
        return powers

    def entry(self, i: int, j: int) -> Value:
        """Return an entry of M."""
        return self.M.get((max(i, j), min(i, j)), (0, 0))

    @cached_property
    def signs(self) -> Signs:
        """Signs of expressions of parameters, as far as they follow from assumptions."""
        return _signs(self.graph, self.parameters)

    def level(self, graph: Graph) -> Callable[[int], int]:
        """Return a function that classifies a node by the symbols that it depends on.

        The levels are 0 for parameters only, 1 for t, u and q, and 2 for v, p, multipliers or
        weights. The graph may be another one that has symbols of the same names.
        """
        positions = set(graph.numbers(s.name for s in (*self.q, *self.u, self.t)))
        others = (*self.v, *self.p, *self.multipliers, *self.weights, *self.step)
        moving = set(graph.numbers(s.name for s in others))

        def level(n: int) -> int:
            symbols = graph.nodes[n].symbols
            if symbols.isdisjoint(moving):
                return 0 if symbols.isdisjoint(positions) else 1
            return 2

        return level

    def __reduce__(self) -> tuple[Any, ...]:
        return reduce_frozen(self)

    # SymPy trees are made on request only, because those of large systems are huge.

    def to_sympy(self, value: Value) -> sp.Expr:
        """Write a value as an expression of the plain symbols."""
        known = dict(zip(self.numbers(self.symbols), self.symbols, strict=True))
        return to_sympy(self.graph, value, {**known, self.graph.constant("Tiny")[1]: sp.S.Zero})

    @property
    def mass(self) -> Matrix:
        """M(q) as an n by n matrix of the plain symbols."""
        n = len(self.q)
        entries = {place: self.to_sympy(value) for place, value in self.M.items()}
        entries |= {(j, i): entry for (i, j), entry in entries.items()}
        return Matrix(n, n, lambda i, j: entries.get((i, j), sp.S.Zero))


def reduce_frozen(value: Any) -> tuple[Any, ...]:
    """Return what pickle needs: the constructor and its arguments, read-only mappings as dicts."""
    given = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
    plain = {k: dict(x) if isinstance(x, Mapping) else x for k, x in given.items()}
    kind: Any = type(value)
    return partial(kind, **plain), ()


class Symbols:
    """The user's symbols, the plain symbols that replace them, and a graph of these."""

    def __init__(
        self,
        coordinates: Sequence[AppliedUndef],
        parameters: Mapping[sp.Symbol, float],
        inputs: Sequence[sp.Expr] = (),
    ) -> None:
        n = len(coordinates)
        self.q = tuple(sp.Symbol(f"q_{i}", real=True) for i in range(n))
        self.v = tuple(sp.Symbol(f"v_{i}", real=True) for i in range(n))
        self.p = tuple(sp.Symbol(f"p_{i}", real=True) for i in range(n))
        self.a = tuple(_real(f"a_{i}", a) for i, a in enumerate(parameters))
        self.u = tuple(sp.Symbol(f"u_{i}", real=True) for i in range(len(inputs)))
        self.replace: dict[sp.Basic, sp.Symbol] = {
            **{q.diff(time): v for q, v in zip(coordinates, self.v, strict=True)},
            **dict(zip(coordinates, self.q, strict=True)),
            **dict(zip(parameters, self.a, strict=True)),
            time: TIME,
            **dict(zip(inputs, self.u, strict=True)),
        }
        self.back: dict[sp.Basic, sp.Basic] = {x: user for user, x in self.replace.items()}
        self.t = TIME
        self.graph = Graph()  #: Its first nodes are q, v, p, a, t and u, in this order.
        every = (*self.q, *self.v, *self.p, *self.a, TIME, *self.u)
        self._nodes = {symbol: self.graph.symbol(symbol.name)[1] for symbol in every}
        self.known = {user: (1, self._nodes[symbol]) for user, symbol in self.replace.items()}
        self.signs = _signs(self.graph, self.a)

    def add(self, symbol: sp.Symbol) -> Value:
        """Add a plain symbol, and return its value."""
        value = self.graph.symbol(symbol.name)
        self._nodes[symbol] = value[1]
        return value

    def numbers(self, symbols: Iterable[sp.Symbol]) -> tuple[int, ...]:
        """Return the nodes of plain symbols."""
        return tuple(self._nodes[symbol] for symbol in symbols)

    @cached_property
    def points(self) -> list[dict[int, float]]:
        """A few random points in doubles, always the same; parameters have their signs."""
        random = Random(20)
        return [
            {
                self._nodes[s]: random.uniform(0.3, 1) * (-1 if s.is_nonpositive else 1)
                for s in (*self.q, *self.v, *self.a, self.t, *self.u)
            }
            for _ in range(SAMPLES)
        ]

    def to_user(self, value: Value) -> sp.Expr:
        """Write a value as an expression of the user's symbols; only short ones are affordable."""
        names = {n: user for user, (_, n) in self.known.items()}
        return to_sympy(self.graph, value, names)


def _real(name: str, user: sp.Symbol) -> sp.Symbol:
    """Return a real symbol with the sign that the user's symbol has by assumption."""
    assumed = {sign: True for sign in (*SIGNS, "nonzero") if getattr(user, f"is_{sign}")}
    return sp.Symbol(name, real=True, **assumed)


def _signs(graph: Graph, parameters: Iterable[sp.Symbol]) -> Signs:
    """Return the signs of expressions of these parameters."""
    known = {
        graph.symbol(a.name)[1]: sign
        for a in parameters
        for word, sign in SIGNS.items()
        if getattr(a, f"is_{word}")
    }
    return Signs(graph, known)
