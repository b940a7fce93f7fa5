"""The kernels of a module, and which of the two forms a system gets."""

from __future__ import annotations

import sympy as sp

from symsimpson.codegen.ir import Kernel, Module, Row, Store
from symsimpson.codegen.layout import layout
from symsimpson.codegen.levels import Level
from symsimpson.codegen.looped import (
    equations_kernel,
    jet_function,
    looped_energy,
    looped_kernels,
    node_functions,
)
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.straight import STATE, lanes, straight_kernels, velocity
from symsimpson.codegen.template import Point
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.reductions import Linear, Part

__all__ = ["UNROLLED_UNKNOWNS", "lower"]

#: Up to so many unknowns a step is emitted as straight lines, beyond as loops.
UNROLLED_UNKNOWNS = 8


def lower(equations: DiscreteEquations) -> Module:
    """Lower the equations of a step to kernels.

    Parameters
    ----------
    equations : DiscreteEquations

    Returns
    -------
    Module
        Kernels, constants, layout of the workspace and the library functions they call.
    """
    low = Lowering(equations)
    straight = max(map(_size, equations.parts)) <= UNROLLED_UNKNOWNS
    kernels: list[Kernel]
    if straight:
        kernels = [*straight_kernels(low), _energy(low)]
        newton_unknowns = sum(part_unknowns(part) for part in equations.parts)
        functions = [jet_function(low)]
    else:
        functions = [jet_function(low), *node_functions(low)]
        kernels = [*looped_kernels(low), looped_energy(low)]
        newton_unknowns = equations.scheme.degree * low.n
    if equations.plain.invariants:
        kernels.append(_invariants(low))
    kernels.append(equations_kernel())
    # the last, because only now it is known what the others want computed once a run
    stores = [Store(row, symbol) for symbol, row in low.hoisted_at(Level.RUN)]
    doc = "What depends on the parameters and h alone."
    kernels.insert(
        0, Kernel("prepare", doc, lanes(low.statements(stores, (Level.RUN,), "constants")))
    )
    first, rows = layout(
        low.n,
        equations.scheme.degree,
        len(low.names.parameters),
        len(low.names.invariants),
        len(low.hoisted),
    )
    return Module(low.names, tuple(functions), tuple(kernels), low.graph.constants, first, rows,
                  newton_unknowns)


def _size(part: Part) -> int:
    """Measure a part by its unknowns, a linear one by its matrices."""
    return 2 * len(part.coordinates) if isinstance(part, Linear) else part_unknowns(part)


def part_unknowns(part: Part) -> int:
    """Count the unknowns that a part solves for together."""
    return 0 if isinstance(part, Linear) else len(part.coordinates) * len(part.columns)


def _energy(low: Lowering) -> Kernel:
    """H = v.(p - a)/2 + V."""
    point, section = low.start_point(), "energy"
    v, _ = velocity(low, point, low.p, "velocity")
    terms = [
        v[i] * (low.p[i] - low.template.entry(point, section, "a", i)) / 2 for i in range(low.n)
    ]
    value = sp.Add(low.template.output(point, section, ("V",)), *terms)
    store = Store(Row("ENERGY", 0), low.graph.define("energy_value", value, section))
    return Kernel("energy", "The Hamiltonian at (q, p).", lanes(low.statements((store,), STATE)))


def _invariants(low: Lowering) -> Kernel:
    """The quantities to watch."""
    point, section = low.start_point(), "invariants"
    v, _ = velocity(low, point, low.p, "velocity")
    point = Point(point.suffix + "_state", point.q, tuple(v))
    stores = [
        Store(Row("INVARIANT", i), low.template.output(point, section, ("invariant", name)))
        for i, name in enumerate(low.equations.plain.invariants)
    ]
    doc = "Quantities that the exact flow conserves, at (q, p)."
    return Kernel("invariants", doc, lanes(low.statements(stores, STATE)))
