"""The jet of a system at a point: forces, momenta and constraints with their derivatives.

All functions write a derivative by its variable after an underscore: F_q is dF/dq.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import NamedTuple

import sympy as sp

from symsimpson.declare.constraints import accelerations
from symsimpson.declare.plain import Plain
from symsimpson.declare.quadratic import linear_terms, quadratic_form
from symsimpson.declare.retimed import TimeTransformation
from symsimpson.discrete.angles import halve_angles, split_sums
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.findings import merge_equal_nodes
from symsimpson.graph.lines import StraightLineCode
from symsimpson.graph.nodes import ZERO, Graph, Value, scale
from symsimpson.graph.rebuild import rebuild
from symsimpson.graph.share import share
from symsimpson.support.derivation import time_stage

#: Above this number of operations, only the strategies FIRST are tried.
FEW_OPERATIONS = 300
#: v.M.v/2 is not tried if it has this many times the nodes of the declared T, as for long chains of
#: links.
LONGER = 1.5
Key = tuple[str, *tuple[Hashable, ...]]


class DerivativeStrategy(NamedTuple):
    """A strategy to derive a jet."""

    by_mass: bool  #: Use L = v.M.v/2 + a.v - V in place of the declared L.
    reverse: bool  #: Compute first derivatives in reverse mode.
    second_reverse: bool  #: Compute second derivatives in reverse mode.
    factored: bool  #: Extract common factors from sums.


#: Strategies that are always tried: for deep chains, for flat sums, for a few links.
FIRST = (
    DerivativeStrategy(by_mass=False, reverse=True, second_reverse=False, factored=False),
    DerivativeStrategy(by_mass=False, reverse=True, second_reverse=True, factored=False),
    DerivativeStrategy(by_mass=False, reverse=False, second_reverse=False, factored=True),
    DerivativeStrategy(by_mass=True, reverse=False, second_reverse=False, factored=True),
)


_EVERY = map(DerivativeStrategy._make, product((False, True), repeat=4))
OTHERS = tuple(strategy for strategy in _EVERY if strategy not in FIRST)


@dataclass(frozen=True)
class Jet:
    """Quantities at a point as straight-line code."""

    #: The outputs are ``("F", i)``, ``("P", i)``, ``("F_q", i, j)``, ``("F_v", i, j)``,
    #: ``("P_q", i, j)``, ``("M", i, j)``, ``("a", i)``, ``("V",)`` and ``("invariant", name)``.
    #: Systems whose forces depend on v also have ``("f_v", i, j)``, and systems whose energy
    #: changes ``("power", name)``.
    program: StraightLineCode
    #: Number of additions, products, quotients, powers and functions that depend on more than
    #: parameters.
    operations: int

    def __getitem__(self, key: Key) -> Value:
        return self.program.outputs[key]

    @property
    def force_operations(self) -> int:
        """Number of operations of the forces F."""
        forces = [value for key, value in self.program.outputs.items() if key[0] == "F"]  # type: ignore[index]
        return self.program.operations(forces)

    @property
    def forced(self) -> tuple[int, ...]:
        """The coordinates whose F is not zero."""
        forces = (key for key in self.program.outputs if key[0] == "F")  # type: ignore[index]
        return tuple(key[1] for key in forces if self[key][0])  # type: ignore[index]


@time_stage("jet")
def derive_jet(
    plain: Plain, more: Mapping[Key, Value] = MappingProxyType({}), half_angles: Sequence[int] = ()
) -> Jet:
    """Derive the jet of a system by the strategy with the fewest operations.

    ``more`` has further outputs. The sine and cosine of the coordinates ``half_angles`` are
    expressed by half angles, which avoids cancellation.
    """
    if plain.hamiltonian is not None:
        return _derive_phase_jet(plain)
    jets: list[Jet] = []
    by_mass = quadratic_form(plain.graph, plain.M, plain.numbers(plain.v))
    of_mass, of_written = (len(plain.graph.descendants([n])) for _, n in (by_mass, plain.T))
    both = plain.quadratic and by_mass != plain.T and of_mass <= LONGER * of_written
    for strategies in (FIRST, OTHERS):
        for strategy in strategies:
            T = by_mass if strategy.by_mass else plain.T
            if both or not strategy.by_mass:
                jets.append(_derive_by(plain, T, strategy, more, half_angles))
        best = min(jets, key=lambda jet: jet.operations)
        if best.operations > FEW_OPERATIONS:
            break
    return best


def derive_invariants(plain: Plain) -> Jet:
    """Return a jet of only the invariants and the powers that change the energy."""
    graph = plain.graph
    outputs: dict[Key, Value] = {("invariant", key): x for key, x in plain.invariants.items()}
    outputs |= {("power", name): value for name, value in plain.powers.items()}
    return to_jet(plain, graph, outputs)


def _derive_by(
    plain: Plain,
    T: Value,
    strategy: DerivativeStrategy,
    more: Mapping[Key, Value],
    half_angles: Sequence[int],
) -> Jet:
    graph, n = Graph(factored=strategy.factored), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    q, v = places[:n], places[n : 2 * n]
    given: dict[Key, Value] = dict(more)
    if plain.quadratic:
        given |= {("V",): plain.V}
        given |= {("a", i): a for i, a in enumerate(plain.a)}
    given |= {("invariant", name): value for name, value in plain.invariants.items()}
    given |= {("power", name): value for name, value in plain.powers.items()}
    given |= {("f", i): f for i, f in enumerate(plain.f) if f[0]}
    L, *values = rebuild(plain.graph, [plain.lagrangian or T, *given.values()], {}, graph)
    outputs: dict[Key, Value] = dict(zip(given, values, strict=True))
    if plain.quadratic:
        linear = graph.products([outputs["a", i] for i in range(n)], v)
        L = graph.add([L, *linear, scale(-1, outputs["V",])])
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

    first, second = slopes(L, reverse=strategy.reverse), strategy.second_reverse
    for i in range(n):
        if i in f:
            first[i] = graph.add([first[i], f[i]])
        of_force, of_momentum = (slopes(first[k], reverse=second) for k in (i, n + i))
        outputs["F", i], outputs["P", i] = first[i], first[n + i]
        for j in range(n):
            outputs["F_q", i, j], outputs["F_v", i, j] = of_force[j], of_force[n + j]
            outputs["P_q", i, j], outputs["M", i, j] = of_momentum[j], of_momentum[n + j]
    if not plain.quadratic:
        M = {(i, j): outputs["M", i, j] for i in range(n) for j in range(i + 1)}
        M = {place: entry for place, entry in M.items() if entry[0]}
        a, P = linear_terms(graph, first[n:], M, v), graph.products(first[n:], v)
        outputs |= {("a", i): value for i, value in enumerate(a)}
        rest = (scale(-1, value) for value in (L, quadratic_form(graph, M, v)))
        outputs["V",] = graph.add([*P, *rest])
    return to_jet(plain, graph, outputs, half_angles)


def _derive_phase_jet(plain: Plain) -> Jet:
    """Derive F = f - H_q, the velocity H_p as "P", and their derivatives; "V" is H."""
    jets = []
    for reverse in (True, False):
        graph, n = Graph(factored=not reverse), len(plain.q)
        places = graph.numbers(symbol.name for symbol in plain.symbols)
        states = places[: 2 * n]
        given: dict[Key, Value] = {("V",): plain.hamiltonian or ZERO}
        given |= {("invariant", name): value for name, value in plain.invariants.items()}
        given |= {("power", name): value for name, value in plain.powers.items()}
        given |= {("f", i): f for i, f in enumerate(plain.f)}
        values = rebuild(plain.graph, [*given.values()], {}, graph)
        outputs: dict[Key, Value] = dict(zip(given, values, strict=True))
        H, derivatives = outputs["V",], Derivatives(graph)
        first = gradient(graph, H, states) if reverse else [derivatives(H, x) for x in states]
        slopes = [graph.add([outputs.pop(("f", i)), scale(-1, first[i])]) for i in range(n)]
        for i, (F, P) in enumerate(zip(slopes, first[n:], strict=True)):
            outputs["F", i], outputs["P", i] = F, P
            for j, x in enumerate(states):
                by_q, k = j < n, j % n
                outputs["F_q" if by_q else "F_v", i, k] = derivatives(F, x)
                outputs["P_q" if by_q else "M", i, k] = derivatives(P, x)
        M = {(i, j): outputs["M", i, j] for i in range(n) for j in range(i + 1)}
        M = {place: entry for place, entry in M.items() if entry[0]}
        a = linear_terms(graph, first[n:], M, states[n:])
        outputs |= {("a", i): value for i, value in enumerate(a)}
        jets.append(to_jet(plain, graph, outputs))
    return min(jets, key=lambda jet: jet.operations)


def to_jet(
    plain: Plain, graph: Graph, outputs: Mapping[Key, Value], half_angles: Sequence[int] = ()
) -> Jet:
    """Convert values of a graph to a jet: merge equal nodes, and share subexpressions."""
    level = plain.level(graph)
    values = list(outputs.values())
    halves = halve_angles(graph, graph.numbers(plain.q[i].name for i in half_angles))
    if halves:
        values = rebuild(graph, values, halves)
    while sums := split_sums(graph, [n for _, n in values]):
        values = rebuild(graph, values, sums)
    values = merge_equal_nodes(graph, values, level)
    program = share(StraightLineCode.of(graph, dict(zip(outputs, values, strict=True)), level))
    return Jet(program, program.operations())


@dataclass(frozen=True)
class RunningCost:
    """A running cost g(t, q, v, u), as a value of a graph with the plain symbols by name."""

    graph: Graph
    value: Value

    def depends(self, symbol: sp.Symbol) -> bool:
        """Return whether the cost contains a plain symbol."""
        numbers = self.graph.numbers([symbol.name])
        return not self.graph.nodes[self.value[1]].symbols.isdisjoint(numbers)


def derive_slopes(plain: Plain, varied: Mapping[str, sp.Symbol]) -> Jet:
    """Differentiate F = L_q + f and P = L_v with respect to parameters and inputs.

    ``varied`` maps names to plain symbols. The outputs are ``("F_a", i, name)`` and
    ``("P_a", i, name)``. Systems with constraints also have the derivatives ``("phi_a", c, name)``
    of phi, and ``("pull_a", i, name)`` of Phi^T lambda + A^T nu. Systems with velocity constraints
    A v = b have ``("b_a", c, name)`` of b, and ``("rate_a", c, name)`` of A v - b. If constraints
    of positions move, they have ``"b_a"`` of b = -phi_t, too.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    moving = places[: 2 * n]
    whole = plain.L if plain.hamiltonian is None else scale(-1, plain.hamiltonian)
    L, *f = rebuild(plain.graph, [whole, *plain.f], {}, graph)
    # -H has the derivatives F by q, and minus the velocity by p
    sign = 1 if plain.hamiltonian is None else -1
    held = plain.write_constraints(graph)
    m, multipliers = len(held.phi), graph.numbers(symbol.name for symbol in plain.multipliers)
    phi = [*held.phi, *(ZERO for _ in held.rows)]
    pulls = held.pulls(graph, moving[:n], multipliers) if phi else []
    sides = held.sides(graph, graph.symbol(plain.t.name)[1])
    moved = {("b", c): b for c, b in enumerate(sides) if c >= m or plain.moving}
    moved |= {("rate", c): rate for c, rate in enumerate(held.rates(graph, moving[n:]), m)}
    derivatives = Derivatives(graph)
    outputs: dict[Key, Value] = {}
    by_size = _BySize(graph, plain, derivatives)
    for name, x in zip(varied, graph.numbers(s.name for s in varied.values()), strict=True):
        if varied[name] == plain.step[0]:
            L_gradient = gradient(graph, L, moving)
            forces = [graph.add([L_gradient[i], f[i]]) for i in range(n)]
            outputs |= {("F_a", i, name): by_size(F, integrated=True) for i, F in enumerate(forces)}
            momenta = [scale(sign, P) for P in L_gradient[n:]]
            integrated = plain.hamiltonian is not None
            outputs |= {
                ("P_a", i, name): by_size(P, integrated=integrated) for i, P in enumerate(momenta)
            }
            outputs |= {("phi_a", c, name): by_size.later(x) for c, x in enumerate(phi)}
            outputs |= {(f"{what}_a", c, name): by_size(x) for (what, c), x in moved.items()}
            for i, pull in enumerate(pulls):
                later = by_size.later(pull) if held.rows or plain.moving else ZERO
                outputs["pull_a", i, name] = graph.add([by_size.over(scale(-1, pull)), later])
            continue
        slopes = gradient(graph, derivatives(L, x), moving)
        for i in range(n):
            outputs["F_a", i, name] = graph.add([slopes[i], derivatives(f[i], x)])
            outputs["P_a", i, name] = scale(sign, slopes[n + i])
        outputs |= {("phi_a", c, name): derivatives(value, x) for c, value in enumerate(phi)}
        outputs |= {(f"{what}_a", c, name): derivatives(y, x) for (what, c), y in moved.items()}
        outputs |= {("pull_a", i, name): derivatives(y, x) for i, y in enumerate(pulls)}
    return to_jet(plain, graph, outputs)


class _BySize:
    """Derivatives of values at a node with respect to the step size h, for a fixed path.

    The velocity v is proportional to 1/h, and the time of the node is t0 + c h. An integrand has
    a factor h in the equations. The derivative of h times the integrand is divided by h.
    """

    def __init__(self, graph: Graph, plain: Plain, derivatives: Derivatives) -> None:
        self._graph, self._derivatives = graph, derivatives
        # momenta at the nodes of a Hamiltonian do not depend on h
        moving = plain.v if plain.hamiltonian is None else ()
        self._v = graph.numbers(s.name for s in moving)
        self._h, self._place, self._moving = graph.numbers(s.name for s in plain.step)
        (self._t,) = graph.numbers([plain.t.name])

    def __call__(self, value: Value, *, integrated: bool = False) -> Value:
        """Return the total derivative of a value with respect to h."""
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
        """Return the derivative of a value through the time t0 + c h of the node."""
        return self._graph.multiply([self._derivatives(value, self._t), (1, self._place)])

    def over(self, value: Value) -> Value:
        """Return value/h where the velocity is proportional to 1/h (the symbol is 1), else 0."""
        inverse = self._graph.power((1, self._h), -1)
        return self._graph.multiply([value, inverse, (1, self._moving)])


def derive_cost(plain: Plain, varied: Mapping[str, sp.Symbol], cost: RunningCost) -> Jet:
    """Differentiate a running cost g(t, q, v, u) with respect to q, v, parameters and inputs.

    The outputs are ``("g",)``, ``("g_q", i)``, ``("g_v", i)`` and ``("g_a", name)``.
    """
    graph, n = Graph(), len(plain.q)
    (value,) = rebuild(cost.graph, [cost.value], {}, graph)
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
    return to_jet(plain, graph, outputs)


def derive_original_terms(retiming: TimeTransformation) -> Jet:
    """Derive M, a, V and P = dL/dv of the system before the time transformation, with v = dq/dt.

    The outputs are ``("M", i, j)``, ``("a", i)``, ``("V",)`` and ``("P", i)``.
    """
    plain, graph = retiming.plain, Graph()
    n = len(plain.q)
    every = [(i, j) for i in range(n) for j in range(n)]
    given = [plain.L, plain.V, *plain.a, *(plain.entry(i, j) for i, j in every)]
    L, V, *values = rebuild(plain.graph, given, {}, graph)
    momenta = gradient(graph, L, graph.numbers(s.name for s in plain.v))
    outputs: dict[Key, Value] = {("V",): V}
    outputs |= {("a", i): values[i] for i in range(n)}
    outputs |= {("M", i, j): value for (i, j), value in zip(every, values[n:], strict=True)}
    outputs |= {("P", i): momentum for i, momentum in enumerate(momenta)}
    return to_jet(plain, graph, outputs)


def derive_rate(plain: Plain, retiming: TimeTransformation) -> Jet:
    """Return the rate g = dt/dtau of a time transformation, not normalised at the initial state.

    ``plain`` is the system in tau. The output is ``("rate",)``.
    """
    graph = Graph()
    (rate,) = rebuild(retiming.graph, [retiming.rate], {}, graph)
    return to_jet(plain, graph, {("rate",): rate})


def derive_constraints(plain: Plain) -> Jet:
    """Derive the quantities of constraints phi = 0 and of velocity constraints A v = b.

    The symbols of the multipliers are l_c. The outputs are:

    - ``("phi", c)`` and ``("Phi", c, a)``: the constraints, and the rows of Phi and then of A;
    - ``("pull", a, b)``: the derivatives of Phi^T lambda + A^T nu with respect to q;
    - ``("b", c)``, ``("rate", c)``: b and A v - b, with derivatives ``("b_q", c, a)`` and
      ``("rate_q", c, a)``; b is -phi_t for constraints of positions, if one of them moves;
    - ``("curve", c)``: the terms without v' in d(Phi v + phi_t)/dt or d(A v - b)/dt, at a state;
    - ``("push", a)``: L_q + f - (d L_v/dq) v - d L_v/dt = M v' + Phi^T lambda + A^T nu at a state.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    q, v = places[:n], places[n : 2 * n]
    multipliers = graph.numbers(symbol.name for symbol in plain.multipliers)
    held = plain.write_constraints(graph)
    L, *f = rebuild(plain.graph, [plain.L, *plain.f], {}, graph)
    derivatives, time = Derivatives(graph), graph.symbol(plain.t.name)[1]
    rows, push, curve, rates = accelerations(graph, L, held, f, (q, v, time))
    m = len(held.phi)
    outputs: dict[Key, Value] = {("phi", c): value for c, value in enumerate(held.phi)}
    outputs |= {("Phi", c, a): x for c, row in enumerate(rows) for a, x in enumerate(row)}
    outputs |= {("curve", c): value for c, value in enumerate(curve)}
    outputs |= {("push", a): value for a, value in enumerate(push)}
    for c, b in enumerate(held.sides(graph, time)):
        if c >= m:
            outputs |= {("phi", c): ZERO, ("rate", c): rates[c]}
            outputs |= {("rate_q", c, a): derivatives(rates[c], x) for a, x in enumerate(q)}
        if c >= m or plain.moving:
            outputs |= {("b", c): b}
            outputs |= {("b_q", c, a): derivatives(b, x) for a, x in enumerate(q)}
    for a, pull in enumerate(held.pulls(graph, q, multipliers)):
        outputs |= {("pull", a, b): derivatives(pull, x) for b, x in enumerate(q)}
    return to_jet(plain, graph, outputs)


def derive_curvatures(plain: Plain, varied: Sequence[sp.Symbol], cost: RunningCost | None) -> Jet:
    """Derive second derivatives of h alpha.F + beta.P + h gamma g, and of nu.phi - alpha.Phi^T mu.

    The first function belongs to a node, with the running cost g. Its variables are q, w = h v and
    ``varied``. q and w do not depend on h, but the time t0 + c h of the node does. The symbols of v
    and t mean w and t0 here. The second function belongs to a control point, with the variables q,
    mu and ``varied``. The weights of ``plain`` are alpha, beta and gamma at a node, and alpha and
    nu at a control point. The outputs are ``("node", i, j)`` and ``("point", i, j)`` with j <= i,
    except those that vanish.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    moving = places[: 2 * n]
    h, place, _ = graph.numbers(symbol.name for symbol in plain.step)
    phi = rebuild(plain.graph, list(plain.constraints.values()), {}, graph)
    L, *f = rebuild(plain.graph, [plain.L, *plain.f], {}, graph)
    weights = graph.numbers(symbol.name for symbol in plain.weights)
    of = graph.numbers(symbol.name for symbol in varied)
    slopes = gradient(graph, L, moving)
    forces = [graph.add([slopes[i], f[i]]) for i in range(n)]
    if cost is not None:
        (g,) = rebuild(cost.graph, [cost.value], {}, graph)
        forces.append(g)
    integrated = graph.add(graph.products(forces, [*weights[:n], *weights[2 * n :]][: len(forces)]))
    momenta = graph.products(slopes[n:], weights[n : 2 * n])
    value = graph.add([graph.multiply([integrated, (1, h)]), *momenta])
    (t,) = graph.numbers([plain.t.name])
    inverse = graph.power((1, h), -1)
    moved = {v: graph.multiply([(1, v), inverse]) for v in moving[n:]}
    if plain.step[0] in varied:
        moved[t] = graph.add([(1, t), graph.multiply([(1, place), (1, h)])])
    (value,) = rebuild(graph, [value], moved)
    outputs = _second(graph, "node", value, [*moving, *of])
    if phi:
        multipliers = graph.numbers(symbol.name for symbol in plain.multipliers)
        pulls = gradient(graph, graph.add(graph.products(phi, multipliers)), moving[:n])
        pulled = [scale(-1, pull) for pull in pulls]
        value = graph.add(graph.products([*pulled, *phi], weights[: n + len(phi)]))
        outputs |= _second(graph, "point", value, [*moving[:n], *multipliers, *of])
    return to_jet(plain, graph, outputs)


def _second(graph: Graph, what: str, value: Value, symbols: Sequence[int]) -> dict[Key, Value]:
    """Return the lower triangle of the Hessian of a value, without zero entries."""
    entries: dict[Key, Value] = {}
    for i, slope in enumerate(gradient(graph, value, symbols)):
        row = gradient(graph, slope, symbols[: i + 1])
        entries |= {(what, i, j): entry for j, entry in enumerate(row) if entry[0]}
    return entries
