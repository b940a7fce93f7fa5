"""The jet of a system: forces, momenta and their derivatives at one point (t, q, v).

F = L_q + f and P = L_v, with F_q, F_v, P_q and P_v = M as four separate things: nothing is taken
for symmetric, what is equal is found to be. There are several ways to derive them, of which none is
always the shortest; each is tried, and the one with the fewest operations is taken.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import NamedTuple

from symsimpson.discrete.angles import halved, summed
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.merge import merged
from symsimpson.graph.nodes import ZERO, Graph, Value, scaled
from symsimpson.graph.rebuild import rebuilt
from symsimpson.graph.share import share
from symsimpson.graph.shared_lines import Program
from symsimpson.mechanics.plain import Plain
from symsimpson.mechanics.structure import kinetic
from symsimpson.support.stopwatch import timed

__all__ = ["Jet", "derive_jet", "watched", "written_as_jet"]

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
    by_mass = kinetic(plain)
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
