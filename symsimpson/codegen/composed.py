"""Explicit schemes: kicks and drifts, written out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp

from symsimpson.codegen.coupled import Explicit, constant_mass_velocity
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point
from symsimpson.discrete.reductions import Composed

__all__ = ["ComposedSolver"]


class ComposedSolver(Explicit):
    """Adds up the kicks and the drifts of a step, beginning with what rounding has left before.

    A shear by a function of the exact value is symplectic, rounded or not. The force at the last
    kick is that at the first one of the next step.
    """

    def __init__(self, low: Lowering, part: Composed) -> None:
        self._low, self.coordinates = low, part.coordinates
        self._kicks = self._shares("KICKS", part.kicks)
        self._drifts = self._shares("DRIFTS", part.drifts)
        self._forced = [a for a in part.coordinates if a in low.template.forced]
        self._impulse: dict[int, sp.Expr] = {}

    def _shares(self, table: str, values: Sequence[sp.Expr]) -> list[sp.Expr]:
        """Return h times the entries of a table of the module, equal ones by the same name."""
        first = [sp.Symbol(f"{table}[{values.index(value)}]", real=True) for value in values]
        graph = self._low.graph
        return [self._low.equations.h * graph.declare(name, Level.RUN) for name in first]

    def increments(self) -> Mapping[int, sp.Expr]:
        """Return q1 - q0, after all kicks but the last."""
        low, names, define = self._low, self._low.names.coordinates, self._low.graph.define
        moved: dict[int, sp.Expr] = {a: low.q_low[a] for a in self.coordinates}
        self._impulse = {a: low.p_low[a] for a in self._forced}
        point = low.start_point()
        for k, (kick, drift) in enumerate(zip(self._kicks[:-1], self._drifts, strict=True)):
            section = f"kick and drift {k}"
            if k > 0:
                q = list(low.q)
                for a in self.coordinates:
                    q[a] = define(f"{names[a]}_{k}", low.q[a] + moved[a], section)
                point = Point(str(k), tuple(q))
            self._kick(kick, point, section, f"dp_{{}}_{k + 1}")
            momentum = [low.p[a] + self._impulse.get(a, low.p_low[a]) for a in self.coordinates]
            velocity = constant_mass_velocity(low, self.coordinates, momentum, "v", section)
            for a, v in zip(self.coordinates, velocity, strict=True):
                value = moved[a] + drift * v
                moved[a] = define(f"dq_{names[a]}_{k + 1}", value, section)
        # which the sum that closes the step adds anew
        return {a: value - low.q_low[a] for a, value in moved.items()}

    def impulses(self, end: Point) -> Mapping[int, sp.Expr]:
        """Return p1 - p0, the last kick included."""
        self._kick(self._kicks[-1], end, "last kick", "dp_{}_end")
        return {a: value - self._low.p_low[a] for a, value in self._impulse.items()}

    def _kick(self, share: sp.Expr, point: Point, section: str, hint: str) -> None:
        low = self._low
        for a in self._forced:
            force = low.template.entry(point, section, "F", a)
            value = self._impulse[a] + share * force
            name = hint.format(low.names.coordinates[a])
            self._impulse[a] = low.graph.define(name, value, section)
