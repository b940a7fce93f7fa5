"""A system in a graph, so that nothing derived depends on what a user calls things."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from random import Random
from typing import Any, NamedTuple, TypeAlias

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import time
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import ZERO, Graph, Value, scaled
from symsimpson.graph.read import written
from symsimpson.graph.rebuild import rebuilt
from symsimpson.graph.roots import Signs

Matrix: TypeAlias = sp.ImmutableDenseMatrix
#: Assumptions of SymPy, the strongest last: a sign, and whether zero is excluded.
SIGNS = {
    "nonpositive": (-1, False),
    "nonnegative": (1, False),
    "negative": (-1, True),
    "positive": (1, True),
}
#: Points at which values are looked at in doubles.
SAMPLES = 3
#: Stands for the time.
TIME = sp.Symbol("t_0", real=True)


class Held(NamedTuple):
    """Constraints: phi of those of positions; of A v = b the rows of A, each with b behind it."""

    phi: tuple[Value, ...]
    rows: tuple[tuple[Value, ...], ...] = ()

    def rates(self, graph: Graph, v: Sequence[int]) -> list[Value]:
        """Write A v - b of each velocity constraint."""
        return [graph.add([*graph.products(row, v), scaled(-1, b)]) for *row, b in self.rows]

    def pulls(self, graph: Graph, q: Sequence[int], multipliers: Sequence[int]) -> list[Value]:
        """Write Phi^T lambda + A^T nu, by coordinate."""
        m = len(self.phi)
        slopes = gradient(graph, graph.add(graph.products(self.phi, multipliers[:m])), q)
        turned = (
            graph.products([row[a] for row in self.rows], multipliers[m:]) for a in range(len(q))
        )
        return [graph.add([slope, *more]) for slope, more in zip(slopes, turned, strict=True)]


@dataclass(frozen=True)
class Plain:
    """A system in a graph: L = T + a(q).v - V(q), T = v.M(q).v/2, and forces f(t, q, v, u).

    ``q``, ``v``, ``p``, ``t``, ``u`` and ``parameters`` are real symbols with names of our own,
    which the graph's symbols bear, too. ``M`` holds the entries on and below the diagonal that are
    not zero. M, a and V may depend on t as well. ``forces`` has the components of each named force,
    ``u`` the inputs of them; ``constraints`` are phi(q) = 0, ``velocity_constraints`` the rows of
    A(t, q) v = b(t, q), each with b behind it. A step may take damping into account by itself:
    -2 ``rate`` L_v by its weights, ``rates`` times M v in its kicks. Then ``acting`` are the forces
    that are left.
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

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        """All symbols: q, v, p, the parameters, the inputs and t."""
        return (*self.q, *self.v, *self.p, *self.parameters, *self.u, self.t)

    @property
    def held(self) -> tuple[str, ...]:
        """Names of all constraints, those of velocities behind those of positions."""
        return (*self.constraints, *self.velocity_constraints)

    @property
    def multipliers(self) -> tuple[sp.Symbol, ...]:
        """A symbol for the multiplier of each constraint."""
        return tuple(sp.Symbol(f"l_{c}", real=True) for c in range(len(self.held)))

    def held_rows(self, graph: Graph) -> Held:
        """Write the constraints in another graph, whose symbols have the names of these."""
        values = rebuilt(self.graph, self.held_values, {}, graph)
        m, width = len(self.constraints), len(self.q) + 1
        rows = (tuple(values[k : k + width]) for k in range(m, len(values), width))
        return Held(tuple(values[:m]), tuple(rows))

    @property
    def held_values(self) -> list[Value]:
        """Values that constraints are made of: phi, then the rows of A, each with b behind it."""
        rows = self.velocity_constraints.values()
        return [*self.constraints.values(), *(value for row in rows for value in row)]

    @property
    def bound(self) -> list[frozenset[int]]:
        """The coordinates that each velocity constraint binds, or depends on."""
        nodes, place = self.graph.nodes, {x: i for i, x in enumerate(self.numbers(self.q))}
        return [
            frozenset(i for i, (c, _) in enumerate(row[:-1]) if c)
            | {place[x] for _, n in row for x in nodes[n].symbols & place.keys()}
            for row in self.velocity_constraints.values()
        ]

    @property
    def step(self) -> tuple[sp.Symbol, sp.Symbol, sp.Symbol]:
        """Symbols for h, for a node's place in the step, and for 1 if v there goes with 1/h."""
        h, place, moving = (sp.Symbol(f"s_{k}", real=True) for k in range(3))
        return h, place, moving

    @property
    def weights(self) -> tuple[sp.Symbol, ...]:
        """Symbols for weights of F, of P and of a cost, or of momenta and constraints."""
        return tuple(sp.Symbol(f"w_{k}", real=True) for k in range(2 * len(self.q) + 1))

    def numbers(self, symbols: Iterable[sp.Symbol]) -> tuple[int, ...]:
        """Return the nodes of symbols."""
        return self.graph.numbers(s.name for s in symbols)

    @property
    def L(self) -> Value:
        """The Lagrangian."""
        linear = self.graph.products(self.a, self.numbers(self.v))
        return self.graph.add([self.T, *linear, scaled(-1, self.V)])

    @property
    def linear(self) -> Value:
        """The term of L that is linear in the velocities, a.v."""
        return self.graph.add(self.graph.products(self.a, self.numbers(self.v)))

    @property
    def energies(self) -> tuple[Value, ...]:
        """The entries of M and of a, and V, of which the Lagrangian is made."""
        return (*self.M.values(), *self.a, self.V)

    @cached_property
    def f(self) -> tuple[Value, ...]:
        """The sum of all forces in the equations, by coordinate."""
        if self.acting is not None:
            return self.acting
        size, forces = range(len(self.q)), self.forces.values()
        return tuple(self.graph.add(force[i] for force in forces) for i in size)

    @cached_property
    def right_sides(self) -> tuple[Value, ...]:
        """dL/dq + f, the right sides of the equations of Lagrange, by coordinate."""
        slopes = gradient(self.graph, self.L, self.numbers(self.q))
        return tuple(map(self.graph.add, zip(slopes, self.f, strict=True)))

    @cached_property
    def time(self) -> int:
        """The node of t."""
        return self.graph.symbol(self.t.name)[1]

    @cached_property
    def autonomous(self) -> bool:
        """Whether neither L, nor a force, nor a constraint depends on t."""
        written = (*self.energies, *self.f, *self.held_values)
        return all(self.time not in self.graph.nodes[n].symbols for _, n in written)

    @cached_property
    def dragged(self) -> bool:
        """Whether a velocity stands in a force."""
        nodes, v = self.graph.nodes, set(self.numbers(self.v))
        return any(not nodes[n].symbols.isdisjoint(v) for _, n in self.f)

    @cached_property
    def conservative(self) -> bool:
        """Whether the energy is constant: no force, no t, and no constraint that does work."""
        return not self.forces and self.autonomous and not self.carried

    @property
    def carried(self) -> bool:
        """Whether a velocity constraint A v = b has a b, by which it does work."""
        return any(row[-1][0] for row in self.velocity_constraints.values())

    @cached_property
    def powers(self) -> dict[str, Value]:
        """The power f.v of each force and, where t stands in L or a force, dL/dt behind them.

        Between them that of velocity constraints that move, which act where no node is.
        """
        graph, v = self.graph, self.numbers(self.v)
        powers = {
            f"of {name}": graph.add(graph.products(force, v)) for name, force in self.forces.items()
        }
        if self.carried:
            powers["of constraints"] = ZERO
        if not self.autonomous:
            (powers["dL_dt"],) = gradient(graph, self.L, [self.time])
        return powers

    def entry(self, i: int, j: int) -> Value:
        """Return an entry of M."""
        return self.M.get((max(i, j), min(i, j)), (0, 0))

    @cached_property
    def signs(self) -> Signs:
        """The signs of what is made of parameters of known sign."""
        return _signs(self.graph, self.parameters)

    def level(self, graph: Graph) -> Callable[[int], int]:
        """Return a function that tells of nodes what they depend on.

        0 for parameters alone, 1 for t, u and q, 2 for v, p, multipliers or weights. The graph may
        be another one with symbols of these names.
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
        return unfrozen(self)

    # Trees of SymPy, made on request: not for large systems.

    def written(self, value: Value) -> sp.Expr:
        """Write a value in the plain symbols."""
        known = dict(zip(self.numbers(self.symbols), self.symbols, strict=True))
        return written(self.graph, value, {**known, self.graph.constant("Tiny")[1]: sp.S.Zero})

    @property
    def mass(self) -> Matrix:
        """M(q), n by n."""
        n = len(self.q)
        entries = {place: self.written(value) for place, value in self.M.items()}
        entries |= {(j, i): entry for (i, j), entry in entries.items()}
        return Matrix(n, n, lambda i, j: entries.get((i, j), sp.S.Zero))


def unfrozen(value: Any) -> tuple[Any, ...]:
    """Tell pickle to call the constructor again; what is read-only is handed over as a dict."""
    given = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
    plain = {k: dict(x) if isinstance(x, Mapping) else x for k, x in given.items()}
    kind: Any = type(value)
    return partial(kind, **plain), ()


class Symbols:
    """The user's symbols, the plain ones that stand for them, and a graph that has these."""

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

    def numbers(self, symbols: Iterable[sp.Symbol]) -> tuple[int, ...]:
        """Return the nodes of plain symbols."""
        return tuple(self._nodes[symbol] for symbol in symbols)

    @cached_property
    def points(self) -> list[dict[int, float]]:
        """A few random points in doubles, the same each time; parameters have their signs."""
        random = Random(20)
        return [
            {
                self._nodes[s]: random.uniform(0.3, 1) * (-1 if s.is_nonpositive else 1)
                for s in (*self.q, *self.v, *self.a, self.t, *self.u)
            }
            for _ in range(SAMPLES)
        ]

    def restored(self, value: Value) -> sp.Expr:
        """Write a value in the user's symbols: a tree, for messages and short expressions."""
        names = {n: user for user, (_, n) in self.known.items()}
        return written(self.graph, value, names)


def _real(name: str, user: sp.Symbol) -> sp.Symbol:
    """Return a real symbol with the sign that the user's symbol is assumed to have."""
    assumed = {sign: True for sign in (*SIGNS, "nonzero") if getattr(user, f"is_{sign}")}
    return sp.Symbol(name, real=True, **assumed)


def _signs(graph: Graph, parameters: Iterable[sp.Symbol]) -> Signs:
    known = {
        graph.symbol(a.name)[1]: sign
        for a in parameters
        for word, sign in SIGNS.items()
        if getattr(a, f"is_{word}")
    }
    return Signs(graph, known)
