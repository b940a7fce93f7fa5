"""Kernels of systems in a time of their own: the user's time, and energies there.

t_1 = t_0 + h sum_i b_i g(Q_i) is the momentum of E0 taken as a coordinate, and so has the order of
the scheme. The energy, velocities and momenta of velocities are those of the user's time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Function, Kernel, Row, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.sizes import drifting
from symsimpson.codegen.specialise import kernel_from_text
from symsimpson.codegen.template import JetTemplate, Point
from symsimpson.codegen.traced_kernels import STATE, TracedState, lanes
from symsimpson.discrete.retiming import derive_original_terms, derive_rate
from symsimpson.mechanics.retimed import OWN

__all__ = ["keeping_time"]


def keeping_time(
    low: Lowering, facts: Mapping[str, object], kernels: Sequence[Kernel]
) -> tuple[list[Function], list[Kernel]]:
    """Return functions and kernels, of which some become those of the user's time."""
    retiming = low.equations.system.retiming
    if retiming is None:
        return [], list(kernels)
    retimed = _Retimed(low)
    replacements = {kernel.name: kernel for kernel in (retimed.legendre(), retimed.energy())}
    others = [replacements.get(kernel.name, kernel) for kernel in kernels]
    more = retimed.energy_in_tau(), retimed.retime(), kernel_from_text("clock", facts)
    return [] if drifting(low.equations) else [retimed.rate_function()], [*others, *more]


class _Retimed:
    def __init__(self, low: Lowering) -> None:
        retiming = low.equations.system.retiming
        assert retiming is not None
        self._low = low
        self._users = low.of_all(derive_original_terms(retiming))
        self._rate = derive_rate(low.equations.plain, retiming)
        *_, self._first = low.names.parameters
        self._places = [list(low.equations.system.parameters).index(symbol) for symbol in OWN]

    def _at(self, point: Point, energy: Expression | None = None) -> Expression:
        """Return g at a point, as the user gave it, for an energy of its own."""
        low = self._low
        parameters = dict(low.parameters)
        if energy is not None:
            parameters[low.equations.plain.parameters[self._places[0]].name] = energy
        names, graph = low.names.coordinates, low.graph
        template = JetTemplate(self._rate, graph, names, parameters, momenta=low.p)
        return template.entry(point, "rate", "rate")

    def _divided(self, rate: Expression) -> Expression:
        first = self._low.equations.plain.parameters[self._places[1]]
        return rate / self._low.parameters[first.name]

    def rate_function(self) -> Function:
        """dt/dtau at a node."""
        low = self._low
        point = Point("i", low.node_q)
        store = Store(Row("RATE", 0), self._divided(self._at(point)))
        doc = "dt/dtau at a node."
        return Function("time_rate", doc, low.statements([store], (Level.ITERATION,)))

    def legendre(self) -> Kernel:
        """P = dL/dv for v = dq/dt."""
        return TracedState(self._users).legendre()

    def energy(self) -> Kernel:
        """H, its kinetic part and v = dq/dt, and the rate."""
        rate = self._at(Point("state", self._low.q))
        stores = [*TracedState(self._users).energy(), Store(Row("RATE", 0), self._divided(rate))]
        doc = "The Hamiltonian at (q, p), its kinetic part, dq/dt, and dt/dtau."
        return Kernel("energy", doc, lanes(self._low.statements(stores, STATE)))

    def energy_in_tau(self) -> Kernel:
        """K = g (H - E0), which steps keep, and g times the kinetic part of H."""
        low = self._low
        given = low.parameters[low.equations.plain.parameters[self._places[0]].name]
        total, kinetic, *_ = TracedState(self._users).energy()
        rate = self._divided(self._at(Point("state", low.q)))
        stores = [
            Store(total.row, rate * (total.value - given)),
            Store(kinetic.row, rate * kinetic.value),
            Store(Row("RATE", 0), rate),
        ]
        doc = "K = (H - E0) dt/dtau, the Hamiltonian of tau, its kinetic part, and dt/dtau."
        return Kernel("energy_in_tau", doc, lanes(low.statements(stores, STATE)))

    def retime(self) -> Kernel:
        """E0 and the rate at the start, which are parameters from then on."""
        first = TracedState(self._users).energy()[0].value
        rate = self._at(Point("begin", self._low.q), first)
        values = zip(self._places, (first, rate), strict=True)
        stores = [Store(Row("PARAMETER", place), value) for place, value in values]
        doc = "E0 and the rate at (q, p), where a run begins."
        return Kernel("retime", doc, lanes(self._low.statements(stores, STATE)))
