"""Steps of the parts of a system, as traces of texts of the library."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import partial

from symsimpson.declare.retimed import energy
from symsimpson.declare.retimed import level as of_potential
from symsimpson.discrete.reductions import (
    Affine,
    Composed,
    Constrained,
    Coupled,
    Linear,
    Part,
    Routh,
    Separable,
)
from symsimpson.errors import GenerationError, reject
from symsimpson.lower.expression import Expression
from symsimpson.lower.facts import facts, solve_constants, solve_tables
from symsimpson.lower.ir import Function, Row, Store
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.storage import Border, Storage
from symsimpson.lower.trace import TracedRows
from symsimpson.lower.traced_parts import ROWS, TracedPart


def traced_facts(low: Lowering, part: Part, held: Border | None = None) -> dict[str, object]:
    """Return the facts of a traced part."""
    true = dict.fromkeys(("TRACED", "CONSTANT_MASS", "IN_PAIRS"), True)
    others = {
        "PIVOTS": False,
        "NEWTON_IN_ORDER": False,
        "WEIGHTED": bool(held) and low.singular_mass,
    }
    return {**facts(low, part, Storage.dense(low.n), held), **true, **others}


#: Texts that a trace begins with.
FUNCTIONS = """
    correct update_increments solve_linear_step find_straight_path find_impulse find_cyclic_impulse
    find_allowed_impulse measure_prediction close_step predict factor_at_start find_pivots end_slope
"""


class TracedSolver:
    """The trace of a part whose increments are unknowns.

    If M is constant, the equations are combinations of rows, and X_d may follow from the other
    increments. Linear equations are solved when the step is closed. With constraints, h times the
    multipliers at control points are unknowns, too.
    """

    def __init__(
        self, low: Lowering, part: Affine | Constrained | Coupled | Routh | Separable
    ) -> None:
        self._low, self._part = low, part
        routh = part if isinstance(part, Routh) else None
        every = (*part.coordinates, *(routh.cyclic if routh is not None else ()))
        plain, scheme = low.equations.plain, low.equations.scheme
        count = range(len(plain.constraint_names) if isinstance(part, Constrained) else 0)
        #: Number of a unknown's block, and coordinate or constraint.
        self.multipliers = [(scheme.degree + 1 + k, c) for k in range(scheme.degree) for c in count]
        self._solved_unknowns = [(m, a) for m in part.columns for a in part.coordinates]
        follows = isinstance(part, Separable) and part.last is not None and part.columns
        ends = [(scheme.degree, a) for a in part.coordinates if follows]
        self.increments = [*self._solved_unknowns, *ends]
        self.unknowns = [*self.increments, *self.multipliers]
        columns = part.solved if isinstance(part, Affine) else part.columns
        rolling = len(plain.velocity_constraints)
        held = Border.dense(len(every), len(count), rolling, in_order=True)
        tables = solve_tables(part, scheme) | {"SOLVE_ENTRIES": len(self._solved_unknowns) ** 2}
        if isinstance(part, Constrained):
            pairs = zip(part.rows, part.columns, strict=True)
            tables["FIRST_SIDE"] = plain.first_side
            tables["ROW_STIFFNESS"] = tuple(scheme.stiffness[k][m] for k, m in pairs)
        tables = solve_constants(Storage.dense(len(every)), columns, held) | tables
        known = traced_facts(low, part, held)
        self.traced = TracedPart(
            low, every, FUNCTIONS.split(), known, tables, reduction=routh or held
        )

    def _begin(self) -> TracedPart:
        """Begin a trace; a constant M is factorised at the start of a run."""
        traced = self.traced
        traced.begin()
        if isinstance(self._part, Separable):
            traced.run("factor_at_start", self._low.t)
        return traced

    def equations(self) -> TracedPart:
        """Trace residual and Jacobian of the step."""
        traced = self._begin()
        traced.run_step("step_equations")
        return traced

    def iterate(self) -> None:
        """Trace one Newton iteration for the increments, and for the multipliers."""
        traced, names = self._begin(), self._low.names.coordinates
        traced.run_step("correct")
        hints = [f"d_{names[a]}_X{m}" for m, a in self._solved_unknowns]
        hints += [f"d_mu_{k}_{c}" for k, c in self.multipliers]
        traced.set_rows("RESIDUAL", traced.name_rows("RESIDUAL", len(hints), hints, "elimination"))
        traced.run("update_increments")

    def close(self) -> None:
        """Trace the end of the step: q1 = q0 + X_d and p1 = p0 + h sum_i b_i F_i, less damping."""
        traced, low = self._begin(), self._low
        if isinstance(self._part, Separable) and not self._solved_unknowns:
            traced.run_step("find_straight_path")
        if isinstance(self._part, Affine):
            traced.run_step("solve_linear_step")
        if self.increments:
            traced.run("measure_prediction")
        impulse = "find_allowed_impulse" if self.multipliers else "find_impulse"
        traced.run_step("find_cyclic_impulse" if isinstance(self._part, Routh) else impulse)
        if low.equations.plain.rate is not None:
            for s, a in enumerate(traced.coordinates):
                decayed = low.damp(low.p[a], traced.row("RESIDUAL", s))
                traced.set_row("RESIDUAL", s, decayed)
        traced.run("close_step")
        traced.restore_momenta(0)

    def pivots(self) -> list[Expression]:
        """Return the pivots of M, with constraints, that were found with the velocity at q1."""
        traced, low = self.traced, self._low
        if not (low.singular_mass or low.equations.system.structure.constant_mass):
            traced.run("find_pivots")
        return traced.diagonal("HELD", low.n + len(low.multipliers))[: low.n]


#: Points at which linear forces are evaluated; at the first ones they may have no value.
_POINTS = (0, 1, 2, Fraction(7, 3), Fraction(-5, 11))


def explicit_facts(low: Lowering) -> dict[str, object]:
    """Return the facts of steps by kicks and drifts."""
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


def time_function(low: Lowering) -> Function:
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
    """The trace of a part whose steps are kicks and drifts."""

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
        functions = {name: partial(low.graph.apply, name) for name in ("exp", "sinh")}
        tables |= {**functions, "own_time": self._pass_time}
        known = traced_facts(low, part) | explicit_facts(low) | {"ALIKE": False}
        self._step = "shear" if isinstance(part, Linear) else "compose"
        self._retimed = known["RETIMED"] and self._step == "compose"
        super().__init__(low, part.coordinates, (self._step,), known, tables)

    @property
    def traced(self) -> TracedPart:
        """The traced rows of the step: this part."""
        return self

    def close(self) -> None:
        """Trace a step: q1, p1, and the time that passes."""
        self._take_step()
        self.restore_momenta(self.low.p_low)

    def _take_step(self) -> None:
        """Execute a step; linear forces are evaluated where they have a value."""
        for point in _POINTS:
            self.trace.names["REST"] = point
            self.begin()
            try:
                return self.run_step(self._step)
            except ZeroDivisionError:
                continue
        reject(
            "the linear forces have no value at any of the points that were tried.",
            where=self.low.equations.system.name,
            remedy="Simplify the potential, or compile with exploit=().",
            error=GenerationError,
        )

    def begin(self) -> None:
        """Set the rows of friction, too."""
        super().begin()
        if rates := self.low.equations.plain.rates:
            self.set_rows("DECAY", (self.low.import_value(rates[a]) for a in self.coordinates))

    def _pass_time(self, W: TracedRows, lane: int) -> None:
        """Make the user's time of a share of a step."""
        row, level = self._first["RATE"], W[self._first["ENERGY"], lane]
        time = W.raw(row) * _rate(self.low, level)
        W[row, lane] = self.low.graph.define("share", time, self.trace.section)
