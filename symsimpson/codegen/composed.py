"""Explicit schemes: kicks and drifts, written out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from symsimpson.codegen.coupled import Closing, Explicit, constant_mass_velocity, end_point
from symsimpson.codegen.expression import Expression, Number
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.discrete.reductions import Composed
from symsimpson.mechanics.functions_of_potential import level as of_potential

__all__ = ["ComposedSolver"]


class ComposedSolver(Explicit):
    """Adds up the kicks and the drifts of a step, beginning with what rounding has left before.

    A shear by a function of the exact value is symplectic, rounded or not. The force at the last
    kick is that at the first one of the next step.

    In a time of its own, dt = g(V) dtau, kicks are those of V with g(V), and drifts those of T with
    g(E0 - T): both parts of K = f(E0 - V) - f(T), f' = g, solved exactly.
    """

    def __init__(self, low: Lowering, part: Composed) -> None:
        self._low, self._part, self.coordinates = low, part, part.coordinates
        self._kicks = self._shares("KICKS", part.kicks)
        self._drifts = self._shares("DRIFTS", part.drifts)
        plain, retiming = low.equations.plain, low.equations.system.retiming
        #: dt/dtau as a function of V, which a step in another time takes of E0 - T, too.
        self._rate: Callable[[Expression], Expression] | None = None
        if retiming is not None and retiming.of_potential is not None:
            rate, symbols = retiming.of_potential, plain.parameters
            *_, self._energy, first = (low.parameters[a.name] for a in symbols)
            values = {a: low.parameters[a.name] for a in symbols}
            self._rate = lambda level: low.graph.read(rate, {**values, of_potential: level}) / first
        damped = {a: low.known(rate) for a, rate in enumerate(plain.rates) if rate[0]}
        self._damped = {a: rate for a, rate in damped.items() if a in part.coordinates}
        forced = {*low.template.forced, *self._damped}
        self._forced = [a for a in part.coordinates if a in forced]

    def _shares(self, table: str, values: Sequence[Number]) -> list[Expression]:
        """Return h times the entries of a table of the module, equal ones by the same name."""
        first = [f"{table}[{values.index(value)}]" for value in values]
        return [self._low.h * self._low.graph.declare(name, Level.RUN) for name in first]

    def close(self) -> Closing:
        """Return q1 - q0, and p1 - p0 with the force at q1 as the last kick."""
        low, names, define = self._low, self._low.names.coordinates, self._low.graph.define
        moved: dict[int, Expression] = {a: low.q_low[a] for a in self.coordinates}
        impulse: dict[int, Expression] = {a: low.p_low[a] for a in self._forced}
        point, passed = low.start_point(), []
        for k, (kick, drift) in enumerate(zip(self._kicks[:-1], self._drifts, strict=True)):
            section = f"kick and drift {k}"
            if k > 0:
                q = list(low.q)
                for a in self.coordinates:
                    q[a] = define(f"{names[a]}_{k}", low.q[a] + moved[a], section)
                # time goes with the drifts
                t = low.time(low.graph.total(self._part.drifts[:k]), str(k))
                point = Point(str(k), tuple(q), t=t, u=low.inputs(k))
            impulse = self._kicked(impulse, kick, point, section, f"dp_{{}}_{k + 1}")
            momentum = [low.p[a] + impulse.get(a, low.p_low[a]) for a in self.coordinates]
            velocity = constant_mass_velocity(low, self.coordinates, momentum, "v", section)
            if self._rate is not None:
                pairs = zip(momentum, velocity, strict=True)
                kinetic = define("kinetic", low.graph.total(p * v for p, v in pairs) / 2, section)
                drift = define("drift", drift * self._rate(self._energy - kinetic), section)
                passed.append(drift)
            for a, v in zip(self.coordinates, velocity, strict=True):
                value = moved[a] + drift * v
                moved[a] = define(f"dq_{names[a]}_{k + 1}", value, section)
        # the low parts, which the sums that close the step add anew
        dq = {a: value - low.q_low[a] for a, value in moved.items()}
        end = end_point(low, dq)
        impulse = self._kicked(impulse, self._kicks[-1], end, "last kick", "dp_{}_end")
        dp = {a: value - low.p_low[a] for a, value in impulse.items()}
        time = define("passed", low.graph.total(passed), "time") if passed else None
        return Closing(dq, dp, passed=time)

    def _kicked(
        self,
        impulse: Mapping[int, Expression],
        share: Expression,
        point: Point,
        section: str,
        hint: str,
    ) -> dict[int, Expression]:
        """Return impulses with that of the forces at a point added.

        Friction of the rate G makes of p in a kick exp(-G share) p + (1 - exp(-G share))/G F.
        """
        low, added = self._low, {}
        if self._rate is not None:
            V = low.template.entry(point, section, "V")
            share = low.graph.define("kick", share * self._rate(V), section)
        for a in self._forced:
            force = low.template.entry(point, section, "F", a)
            if a in self._damped:
                rate = self._damped[a]
                lost = low.lost(rate * share)
                value = impulse[a] + lost * (low.p[a] + impulse[a]) - lost / rate * force
            else:
                value = impulse[a] + share * force
            added[a] = low.graph.define(hint.format(low.names.coordinates[a]), value, section)
        return added
