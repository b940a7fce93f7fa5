"""The jet of a system at a point: forces, momenta, constraints, with their derivatives."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import NamedTuple

import sympy as sp

from symsimpson.declare.constraints import accelerations
from symsimpson.declare.plain import Plain
from symsimpson.declare.quadratic import quadratic_form
from symsimpson.declare.retimed import Retiming
from symsimpson.discrete.angles import halved, summed
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.findings import merged
from symsimpson.graph.lines import Program
from symsimpson.graph.nodes import ZERO, Graph, Value, scaled
from symsimpson.graph.rebuild import rebuilt
from symsimpson.graph.share import share
from symsimpson.support.derivation import timed

#: Where the first ways give more operations than this, no others are tried.
FEW_OPERATIONS = 300
#: v.M.v/2 with so many times the nodes of T as it is written is not tried: chains of links, whose M
#: has many times the terms.
LONGER = 1.5
Key = tuple[str, *tuple[Hashable, ...]]


class Way(NamedTuple):
    """How a jet is derived.

    ``by_mass``: from L = v.M.v/2 + a.v - V in place of L as it is written; ``reverse``: first
    derivatives in one pass from L down; ``second_reverse``: second ones likewise; ``factored``:
    what all terms of a sum have in common stands before it.
    """

    by_mass: bool
    reverse: bool
    second_reverse: bool
    factored: bool


#: Ways that are always tried: for deep chains, for flat sums, for a few links.
FIRST = (
    Way(by_mass=False, reverse=True, second_reverse=False, factored=False),
    Way(by_mass=False, reverse=True, second_reverse=True, factored=False),
    Way(by_mass=False, reverse=False, second_reverse=False, factored=True),
    Way(by_mass=True, reverse=False, second_reverse=False, factored=True),
)


OTHERS = tuple(way for way in map(Way._make, product((False, True), repeat=4)) if way not in FIRST)


@dataclass(frozen=True)
class Jet:
    """Quantities at a point, as a program."""

    #: Outputs ``("F", i)``, ``("P", i)``, ``("F_q", i, j)``, ``("F_v", i, j)``, ``("P_q", i, j)``,
    #: ``("M", i, j)``, ``("a", i)``, ``("V",)`` and ``("invariant", name)``; where forces depend on
    #: v, ``("f_v", i, j)``, and of what changes the energy ``("power", name)``.
    program: Program
    #: Additions, products, quotients, powers and functions, without those on parameters alone.
    operations: int

    def __getitem__(self, key: Key) -> Value:
        return self.program.outputs[key]

    @property
    def force_operations(self) -> int:
        """Operations of the forces alone."""
        forces = [value for key, value in self.program.outputs.items() if key[0] == "F"]  # type: ignore[index]
        return self.program.operations(forces)

    @property
    def forced(self) -> tuple[int, ...]:
        """The coordinates on which a force acts."""
        forces = (key for key in self.program.outputs if key[0] == "F")  # type: ignore[index]
        return tuple(key[1] for key in forces if self[key][0])  # type: ignore[index]


def derive_jet(
    plain: Plain, more: Mapping[Key, Value] = MappingProxyType({}), half_angles: Sequence[int] = ()
) -> Jet:
    """Derive all that a step may ask for, and ``more`` that will be, by the shortest way.

    The sine and the cosine of ``half_angles`` are written by those of the half, to keep digits.
    """
    with timed("jet"):
        return _shortest(plain, more, half_angles)


def _shortest(plain: Plain, more: Mapping[Key, Value], half_angles: Sequence[int]) -> Jet:
    jets: list[Jet] = []
    by_mass = quadratic_form(plain.graph, plain.M, plain.numbers(plain.v))
    of_mass, of_written = (len(plain.graph.reached([n])) for _, n in (by_mass, plain.T))
    both = by_mass != plain.T and of_mass <= LONGER * of_written
    for ways in (FIRST, OTHERS):
        for way in ways:
            T = by_mass if way.by_mass else plain.T
            if both or not way.by_mass:
                jets.append(_derived(plain, T, way, more, half_angles))
        best = min(jets, key=lambda jet: jet.operations)
        if best.operations > FEW_OPERATIONS:
            break
    return best


def watched(plain: Plain) -> Jet:
    """Write the invariants and what changes the energy, alone."""
    graph = plain.graph
    outputs: dict[Key, Value] = {("invariant", key): x for key, x in plain.invariants.items()}
    outputs |= {("power", name): value for name, value in plain.powers.items()}
    return written_as_jet(plain, graph, outputs)


def _derived(
    plain: Plain, T: Value, way: Way, more: Mapping[Key, Value], half_angles: Sequence[int]
) -> Jet:
    graph, n = Graph(factored=way.factored), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    q, v = places[:n], places[n : 2 * n]
    given: dict[Key, Value] = {**more, ("V",): plain.V}
    given |= {("a", i): a for i, a in enumerate(plain.a)}
    given |= {("invariant", name): value for name, value in plain.invariants.items()}
    given |= {("power", name): value for name, value in plain.powers.items()}
    given |= {("f", i): f for i, f in enumerate(plain.f) if f[0]}
    T, *values = rebuilt(plain.graph, [T, *given.values()], {}, graph)
    outputs: dict[Key, Value] = dict(zip(given, values, strict=True))
    linear = graph.products([outputs["a", i] for i in range(n)], v)
    L = graph.add([T, *linear, scaled(-1, outputs["V",])])
    derivatives = Derivatives(graph)
    f = {i: outputs.pop(("f", i)) for i, (c, _) in enumerate(plain.f) if c}
    drag: dict[Key, Value] = {
        ("f_v", i, j): derivatives(force, x) for i, force in f.items() for j, x in enumerate(v)
    }
    if plain.dragged:
        every = product(range(n), repeat=2)
        outputs |= {("f_v", i, j): drag.get(("f_v", i, j), ZERO) for i, j in every}

    def slopes(value: Value, *, reverse: bool) -> list[Value]:
        if reverse:
            return gradient(graph, value, [*q, *v])
        return [derivatives(value, x) for x in (*q, *v)]

    first = slopes(L, reverse=way.reverse)
    for i in range(n):
        if i in f:
            first[i] = graph.add([first[i], f[i]])
        of_force, of_momentum = (slopes(first[k], reverse=way.second_reverse) for k in (i, n + i))
        outputs["F", i], outputs["P", i] = first[i], first[n + i]
        for j in range(n):
            outputs["F_q", i, j], outputs["F_v", i, j] = of_force[j], of_force[n + j]
            outputs["P_q", i, j], outputs["M", i, j] = of_momentum[j], of_momentum[n + j]
    return written_as_jet(plain, graph, outputs, half_angles)


def written_as_jet(
    plain: Plain, graph: Graph, outputs: Mapping[Key, Value], half_angles: Sequence[int] = ()
) -> Jet:
    """Merge what is equal, and name what is shared."""
    level = plain.level(graph)
    values = list(outputs.values())
    halves = halved(graph, graph.numbers(plain.q[i].name for i in half_angles))
    if halves:
        values = rebuilt(graph, values, halves)
    while sums := summed(graph, [n for _, n in values]):
        values = rebuilt(graph, values, sums)
    values = merged(graph, values, level)
    program = share(Program.of(graph, dict(zip(outputs, values, strict=True)), level))
    return Jet(program, program.operations())


@dataclass(frozen=True)
class Cost:
    """A running cost g(t, q, v, u), in a graph whose symbols have the names of the plain ones."""

    graph: Graph
    value: Value

    def depends(self, symbol: sp.Symbol) -> bool:
        """Return whether a plain symbol stands in it."""
        numbers = self.graph.numbers([symbol.name])
        return not self.graph.nodes[self.value[1]].symbols.isdisjoint(numbers)


def derive_slopes(plain: Plain, varied: Mapping[str, sp.Symbol]) -> Jet:
    """Derive F = L_q + f and P = L_v by parameters and inputs: plain symbols, by their names.

    Outputs are ``("F_a", i, name)`` and ``("P_a", i, name)``; of constraints ``("phi_a", c, name)``
    and ``("pull_a", i, name)``, those of phi and of Phi^T lambda + A^T nu; of velocity constraints
    ``("b_a", c, name)`` and ``("rate_a", c, name)``, those of b and A v - b.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    moving = places[: 2 * n]
    L, *f = rebuilt(plain.graph, [plain.L, *plain.f], {}, graph)
    held = plain.held_rows(graph)
    m, multipliers = len(held.phi), graph.numbers(symbol.name for symbol in plain.multipliers)
    phi = [*held.phi, *(ZERO for _ in held.rows)]
    pulls = held.pulls(graph, moving[:n], multipliers) if phi else []
    moved = {("b", c): row[-1] for c, row in enumerate(held.rows, m)}
    moved |= {("rate", c): rate for c, rate in enumerate(held.rates(graph, moving[n:]), m)}
    derivatives = Derivatives(graph)
    outputs: dict[Key, Value] = {}
    by_size = _BySize(graph, plain, derivatives)
    for name, x in zip(varied, graph.numbers(s.name for s in varied.values()), strict=True):
        if varied[name] == plain.step[0]:
            L_gradient = gradient(graph, L, moving)
            forces = [graph.add([L_gradient[i], f[i]]) for i in range(n)]
            outputs |= {("F_a", i, name): by_size(F, integrated=True) for i, F in enumerate(forces)}
            outputs |= {("P_a", i, name): by_size(P) for i, P in enumerate(L_gradient[n:])}
            outputs |= {("phi_a", c, name): ZERO for c in range(len(phi))}
            outputs |= {(f"{what}_a", c, name): by_size(x) for (what, c), x in moved.items()}
            for i, pull in enumerate(pulls):
                later = by_size.later(pull) if held.rows else ZERO
                outputs["pull_a", i, name] = graph.add([by_size.over(scaled(-1, pull)), later])
            continue
        slopes = gradient(graph, derivatives(L, x), moving)
        for i in range(n):
            outputs["F_a", i, name] = graph.add([slopes[i], derivatives(f[i], x)])
            outputs["P_a", i, name] = slopes[n + i]
        outputs |= {("phi_a", c, name): derivatives(value, x) for c, value in enumerate(phi)}
        outputs |= {(f"{what}_a", c, name): derivatives(y, x) for (what, c), y in moved.items()}
        outputs |= {("pull_a", i, name): derivatives(y, x) for i, y in enumerate(pulls)}
    return written_as_jet(plain, graph, outputs)


class _BySize:
    """Derivatives of what stands at a node by the size of the step, its path being held.

    There v goes with 1/h and t moves by its place; what is integrated has a factor h before it,
    and is divided by that.
    """

    def __init__(self, graph: Graph, plain: Plain, derivatives: Derivatives) -> None:
        self._graph, self._derivatives = graph, derivatives
        self._v = graph.numbers(s.name for s in plain.v)
        self._h, self._place, self._moving = graph.numbers(s.name for s in plain.step)
        (self._t,) = graph.numbers([plain.t.name])

    def __call__(self, value: Value, *, integrated: bool = False) -> Value:
        """Return the derivative of a value."""
        graph = self._graph
        along = [
            graph.multiply([self._derivatives(value, v), (-1, v)])
            for v in self._v
            if self._derivatives(value, v) != ZERO
        ]
        terms = [self.over(graph.add(along)), self.later(value)]
        if integrated:
            terms.append(graph.multiply([value, graph.power((1, self._h), -1)]))
        return graph.add(terms)

    def later(self, value: Value) -> Value:
        """Return the derivative of a value through the time, which moves by its place."""
        return self._graph.multiply([self._derivatives(value, self._t), (1, self._place)])

    def over(self, value: Value) -> Value:
        """Return a value divided by h, where v goes with 1/h."""
        inverse = self._graph.power((1, self._h), -1)
        return self._graph.multiply([value, inverse, (1, self._moving)])


def derive_cost(plain: Plain, varied: Mapping[str, sp.Symbol], cost: Cost) -> Jet:
    """Derive a running cost g(t, q, v, u) by q, by v, and by parameters and inputs.

    Outputs are ``("g",)``, ``("g_q", i)``, ``("g_v", i)`` and ``("g_a", name)``.
    """
    graph, n = Graph(), len(plain.q)
    (value,) = rebuilt(cost.graph, [cost.value], {}, graph)
    moving = graph.numbers(s.name for s in (*plain.q, *plain.v, *varied.values()))
    slopes = gradient(graph, value, moving)
    outputs: dict[Key, Value] = {("g",): value}
    outputs |= {("g_q", i): slopes[i] for i in range(n)}
    outputs |= {("g_v", i): slopes[n + i] for i in range(n)}
    outputs |= {("g_a", name): slopes[2 * n + j] for j, name in enumerate(varied)}
    by_size = _BySize(graph, plain, Derivatives(graph))
    outputs |= {
        ("g_a", name): by_size(value, integrated=True)
        for name, symbol in varied.items()
        if symbol == plain.step[0]
    }
    return written_as_jet(plain, graph, outputs)


def derive_original_terms(retiming: Retiming) -> Jet:
    """Derive M, a, V and P = dL/dv of the original system, with v = dq/dt.

    Outputs are ``("M", i, j)``, ``("a", i)``, ``("V",)`` and ``("P", i)``.
    """
    plain, graph = retiming.plain, Graph()
    n = len(plain.q)
    every = [(i, j) for i in range(n) for j in range(n)]
    given = [plain.L, plain.V, *plain.a, *(plain.entry(i, j) for i, j in every)]
    L, V, *values = rebuilt(plain.graph, given, {}, graph)
    momenta = gradient(graph, L, graph.numbers(s.name for s in plain.v))
    outputs: dict[Key, Value] = {("V",): V}
    outputs |= {("a", i): values[i] for i in range(n)}
    outputs |= {("M", i, j): value for (i, j), value in zip(every, values[n:], strict=True)}
    outputs |= {("P", i): momentum for i, momentum in enumerate(momenta)}
    return written_as_jet(plain, graph, outputs)


def derive_rate(plain: Plain, retiming: Retiming) -> Jet:
    """Return g = dt/dtau before its division by the value at the start; ``plain`` is in tau.

    The output is ``("rate",)``.
    """
    graph = Graph()
    (rate,) = rebuilt(retiming.graph, [retiming.rate], {}, graph)
    return written_as_jet(plain, graph, {("rate",): rate})


def derive_constraints(plain: Plain) -> Jet:
    """Derive all that a step and its results ask of constraints, and of L beside them.

    Outputs are ``("phi", c)``, ``("Phi", c, a)``, Phi and behind it A, ``("pull", a, b)``, the
    derivatives of Phi^T lambda + A^T nu by q; of velocity constraints ``("b", c)``, ``("rate",
    c)``, A v - b, with ``("b_q", c, a)`` and ``("rate_q", c, a)``; and of a state ``("curve", c)``,
    v.phi_qq.v or the like of A v - b, and ``("push", a)``, L_q + f - (d L_v/dq) v - d L_v/dt, which
    is M v' + Phi^T lambda + A^T nu. Symbols l_c stand for the multipliers.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    q, v = places[:n], places[n : 2 * n]
    multipliers = graph.numbers(symbol.name for symbol in plain.multipliers)
    held = plain.held_rows(graph)
    L, *f = rebuilt(plain.graph, [plain.L, *plain.f], {}, graph)
    derivatives, time = Derivatives(graph), graph.symbol(plain.t.name)[1]
    rows, push, curve, rates = accelerations(graph, L, held, f, (q, v, time))
    m = len(held.phi)
    outputs: dict[Key, Value] = {("phi", c): value for c, value in enumerate(held.phi)}
    outputs |= {("Phi", c, a): x for c, row in enumerate(rows) for a, x in enumerate(row)}
    outputs |= {("curve", c): value for c, value in enumerate(curve)}
    outputs |= {("push", a): value for a, value in enumerate(push)}
    for c, (*_, b) in enumerate(held.rows, m):
        outputs |= {("phi", c): ZERO, ("b", c): b, ("rate", c): rates[c]}
        outputs |= {("rate_q", c, a): derivatives(rates[c], x) for a, x in enumerate(q)}
        outputs |= {("b_q", c, a): derivatives(b, x) for a, x in enumerate(q)}
    for a, pull in enumerate(held.pulls(graph, q, multipliers)):
        outputs |= {("pull", a, b): derivatives(pull, x) for b, x in enumerate(q)}
    return written_as_jet(plain, graph, outputs)


def derive_curvatures(plain: Plain, varied: Sequence[sp.Symbol], cost: Cost | None) -> Jet:
    """Derive second derivatives of h alpha.F + beta.P + h gamma g, and of nu.phi - alpha.Phi^T mu.

    They are by q and w = h v at a node, which do not depend on h: the time t does, which ends up c
    h behind the one that is given. The symbols of v and t stand for w and for the start of the
    step, the weights of ``plain`` for alpha, beta and gamma at a node, for alpha and nu at a
    control point; g is the running cost. Outputs are ``("node", i, j)``, j <= i, by (q, w, varied),
    and ``("point", i, j)`` by (q, mu, varied); those that vanish are left out.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    moving = places[: 2 * n]
    h, place, _ = graph.numbers(symbol.name for symbol in plain.step)
    phi = rebuilt(plain.graph, list(plain.constraints.values()), {}, graph)
    L, *f = rebuilt(plain.graph, [plain.L, *plain.f], {}, graph)
    weights = graph.numbers(symbol.name for symbol in plain.weights)
    of = graph.numbers(symbol.name for symbol in varied)
    slopes = gradient(graph, L, moving)
    forces = [graph.add([slopes[i], f[i]]) for i in range(n)]
    if cost is not None:
        (g,) = rebuilt(cost.graph, [cost.value], {}, graph)
        forces.append(g)
    integrated = graph.add(graph.products(forces, [*weights[:n], *weights[2 * n :]][: len(forces)]))
    momenta = graph.products(slopes[n:], weights[n : 2 * n])
    value = graph.add([graph.multiply([integrated, (1, h)]), *momenta])
    (t,) = graph.numbers([plain.t.name])
    inverse = graph.power((1, h), -1)
    moved = {v: graph.multiply([(1, v), inverse]) for v in moving[n:]}
    if plain.step[0] in varied:
        moved[t] = graph.add([(1, t), graph.multiply([(1, place), (1, h)])])
    (value,) = rebuilt(graph, [value], moved)
    outputs = _second(graph, "node", value, [*moving, *of])
    if phi:
        multipliers = graph.numbers(symbol.name for symbol in plain.multipliers)
        pulls = gradient(graph, graph.add(graph.products(phi, multipliers)), moving[:n])
        pulled = [scaled(-1, pull) for pull in pulls]
        value = graph.add(graph.products([*pulled, *phi], weights[: n + len(phi)]))
        outputs |= _second(graph, "point", value, [*moving[:n], *multipliers, *of])
    return written_as_jet(plain, graph, outputs)


def _second(graph: Graph, what: str, value: Value, symbols: Sequence[int]) -> dict[Key, Value]:
    """Differentiate a value twice; of two equal entries one is kept."""
    entries: dict[Key, Value] = {}
    for i, slope in enumerate(gradient(graph, value, symbols)):
        row = gradient(graph, slope, symbols[: i + 1])
        entries |= {(what, i, j): entry for j, entry in enumerate(row) if entry[0]}
    return entries
