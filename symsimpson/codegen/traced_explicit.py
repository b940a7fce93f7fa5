"""Parts whose steps are kicks and drifts: traces of texts of the library."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import partial

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Function, Row, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.trace import TracedRows
from symsimpson.codegen.traced_parts import ROWS, TracedPart
from symsimpson.codegen.traced_solver import traced_facts
from symsimpson.discrete.reductions import Composed, Linear
from symsimpson.errors import GenerationError
from symsimpson.mechanics.functions_of_potential import level as of_potential
from symsimpson.mechanics.retimed import energy

__all__ = ["TracedSteps", "explicit_facts", "explicit_tables", "own_time"]

#: Points at which linear forces are evaluated; at the first ones they may have no value.
_POINTS = (0, 1, 2, Fraction(7, 3), Fraction(-5, 11))


def explicit_facts(low: Lowering) -> dict[str, object]:
    """Return what texts of kicks and drifts are told."""
    retimed = low.equations.system.retiming is not None
    return {"FRICTION": any(rate[0] for rate in low.equations.plain.rates), "RETIMED": retimed}


def explicit_tables(low: Lowering, coordinates: Sequence[int]) -> dict[str, object]:
    """Return the tables of kicks and drifts: their times, and which coordinates have friction."""
    plain, parameters = low.equations.plain, [*low.equations.system.parameters]
    tables: dict[str, object] = {}
    if not plain.autonomous:
        tables["PLACES"] = low.equations.scheme.quadrature.nodes
    if plain.rates:
        tables["DECAYS"] = (*(int(plain.rates[a][0] != 0) for a in coordinates),)
    return tables | ({"START_ENERGY": parameters.index(energy)} if energy in parameters else {})


def own_time(low: Lowering) -> Function:
    """Return the function that makes the user's time of a share of a step."""
    level, share = (low.graph.fresh(hint, Level.ITERATION) for hint in ("level", "share"))
    low.rows |= {level: Row("ENERGY", 0), share: Row("RATE", 0)}
    store = Store(Row("RATE", 0), share * _rate(low, level))
    doc = "Make the user's time of a share of a step, at a value of V or of E0 - T."
    return Function("own_time", doc, low.statements([store], (Level.ITERATION,)))


def _rate(low: Lowering, level: Expression) -> Expression:
    """Return dt/dtau as a function of V."""
    retiming = low.equations.system.retiming
    assert retiming is not None
    assert retiming.of_potential is not None
    values = {a: low.parameters[a.name] for a in low.equations.plain.parameters}
    *_, first = values.values()
    return low.graph.read(retiming.of_potential, {**values, of_potential: level}) / first


class TracedSteps(TracedPart):
    """A part whose steps are kicks and drifts, of forces that are linear or not."""

    increments: tuple[tuple[int, int], ...] = ()
    multipliers: tuple[tuple[int, int], ...] = ()
    unknowns: tuple[tuple[int, int], ...] = ()

    patterns = ROWS | {
        "INCREMENT": "dq_{q}_{node}",
        "RESIDUAL": "dp_{q}_{node}",
        "NODE_L_Q": "F_{q}_{node}",
        "NODE_L_V": "p_{q}_{node}",
        "NODE_TIME": "t_{node}",
    }

    def __init__(self, low: Lowering, part: Composed | Linear) -> None:
        tables = explicit_tables(low, part.coordinates)
        if isinstance(part, Linear):
            for table, is_kick in (("KICKS", True), ("DRIFTS", False)):
                tables[table] = (*(pair for kick, pair in part.shears if kick is is_kick),)
        else:
            for table, values in (("KICKS", part.kicks), ("DRIFTS", part.drifts)):
                names = [f"{table}[{values.index(x)}]" for x in values]  # the same for equal ones
                tables[table] = [low.graph.declare(name, Level.RUN) for name in names]
        functions = {name: partial(low.graph.applied, name) for name in ("exp", "sinh")}
        tables |= {**functions, "own_time": self._pass_time}
        facts = traced_facts(low, part) | explicit_facts(low) | {"ALIKE": False}
        self._step = "shear" if isinstance(part, Linear) else "compose"
        self._retimed = facts["RETIMED"] and self._step == "compose"
        super().__init__(low, part.coordinates, (self._step,), facts, tables)

    @property
    def traced(self) -> TracedPart:
        """The rows that a step leaves."""
        return self

    def close(self) -> None:
        """Trace a step: q1, p1, and the time that passes."""
        self._take_step()
        self.leave_momenta(self.low.p_low)

    def _take_step(self) -> None:
        """Execute a step; linear forces are evaluated where they have a value."""
        for point in _POINTS:
            self.trace.names["REST"] = point
            self.begin()
            try:
                return self.run_step(self._step)
            except ZeroDivisionError:
                continue
        raise GenerationError(
            "forces that are linear have no value at any point that was tried.\n"
            "Simplify the potential, or compile with exploit=()."
        )

    def begin(self) -> None:
        """Set the rows of friction, too."""
        super().begin()
        rates = self.low.equations.plain.rates
        for s, a in enumerate(self.coordinates if rates else ()):
            self.trace.rows.values[self._first["DECAY"] + s] = self.low.known(rates[a])

    def _pass_time(self, W: TracedRows, lane: int) -> None:
        """Make the user's time of a share of a step."""
        row, level = self._first["RATE"], W[self._first["ENERGY"], lane]
        time = W.raw(row) * _rate(self.low, level)
        W[row, lane] = self.low.graph.define("share", time, self.trace.section)
