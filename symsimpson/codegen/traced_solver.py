"""Parts of a step whose iteration and closing are traces of texts of the library."""

from __future__ import annotations

from symsimpson.codegen.constraint_order import Held
from symsimpson.codegen.expression import Expression
from symsimpson.codegen.facts import part_facts, system_facts
from symsimpson.codegen.loop_tables import solve_constants, solve_tables
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.storage import Storage
from symsimpson.codegen.traced_parts import TracedPart
from symsimpson.discrete.reductions import Affine, Constrained, Coupled, Part, Routh, Separable

__all__ = ["TracedSolver", "traced_facts"]


def traced_facts(low: Lowering, part: Part, held: Held | None = None) -> dict[str, object]:
    """Return what texts are told about a part that is traced."""
    plain, degree = low.equations.plain, low.equations.scheme.degree
    return {
        **system_facts(low),
        **part_facts(part),
        "TRACED": True,
        "IN_PAIRS": True,
        "PIVOTS": False,
        "NEWTON_IN_ORDER": False,
        "FOLLOWING": False,
        "HELD": held is not None,
        "ROLLING": held is not None and held.velocities > 0,
        "CARRIED": plain.carried,
        "CLEARED": held.storage.size(degree) if held else 0,
        "WEIGHTED": held is not None and low.stiffened,
    }


#: Texts that a trace begins with.
FUNCTIONS = (
    "correct",
    "update_increments",
    "update_multipliers",
    "solve_linear_step",
    "find_straight_path",
    "find_impulse",
    "find_cyclic_impulse",
    "find_allowed_impulse",
    "measure_prediction",
    "close_step",
    "keep_taken",
    "carry_multipliers",
    "predict",
    "go_to_start",
    "keep_mass",
    "factor_mass",
    "find_pivots",
)


class TracedSolver:
    """A part of coordinates whose increments are unknowns.

    Where M is constant, the equations are combinations of rows, and X_d may follow from the others.
    Linear equations are solved when the step is closed. With constraints, h times the multipliers
    at control points are unknowns, too.
    """

    def __init__(
        self, low: Lowering, part: Affine | Constrained | Coupled | Routh | Separable
    ) -> None:
        self._low, self._part = low, part
        routh = part if isinstance(part, Routh) else None
        every = (*part.coordinates, *(routh.cyclic if routh is not None else ()))
        plain, scheme = low.equations.plain, low.equations.scheme
        count = range(len(plain.held) if isinstance(part, Constrained) else 0)
        #: Number of a unknown's block, and coordinate or constraint.
        self.multipliers = [(scheme.degree + 1 + k, c) for k in range(scheme.degree) for c in count]
        self._solved = [(m, a) for m in part.columns for a in part.coordinates]
        follows = isinstance(part, Separable) and part.last is not None and part.columns
        ends = [(scheme.degree, a) for a in part.coordinates if follows]
        self.increments = [*self._solved, *ends]
        self.unknowns = [*self.increments, *self.multipliers]
        columns = part.solved if isinstance(part, Affine) else part.columns
        held = None
        tables = solve_tables(part, scheme) | {"SOLVE_ENTRIES": len(self._solved) ** 2}
        if isinstance(part, Constrained):
            rolling = len(plain.velocity_constraints)
            held = Held.dense(len(every), len(count), rolling, in_order=True)
            pairs = zip(part.rows, part.columns, strict=True)
            tables["ROW_STIFFNESS"] = tuple(scheme.stiffness[k][m] for k, m in pairs)
            tables["CLEARED"] = held.storage.size(scheme.degree)
        tables = solve_constants(Storage.dense(len(every)), columns, held) | tables
        facts = traced_facts(low, part, held)
        self.traced = TracedPart(low, every, FUNCTIONS, facts, tables, reduction=routh or held)

    def _begin(self) -> TracedPart:
        """Begin a trace; a constant M and its factors are those of the start of a run."""
        traced = self.traced
        traced.begin()
        if isinstance(self._part, Separable):
            traced.run("go_to_start", self._low.t)
            for text in ("mass", "keep_mass", "factor_mass"):
                traced.run(text)
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
        hints = [f"d_{names[a]}_X{m}" for m, a in self._solved]
        hints += [f"d_mu_{k}_{c}" for k, c in self.multipliers]
        traced.rename("RESIDUAL", hints, "elimination")
        traced.run("update_increments")
        if self.multipliers:
            traced.run("update_multipliers")

    def close(self) -> None:
        """Trace the end of the step: q1 = q0 + X_d and p1 = p0 + h sum_i b_i F_i, less damping."""
        traced, low = self._begin(), self._low
        if isinstance(self._part, Separable) and not self._solved:
            traced.run_step("find_straight_path")
        if isinstance(self._part, Affine):
            traced.run_step("solve_linear_step")
        if self.increments:
            traced.run("measure_prediction")
        impulse = "find_allowed_impulse" if self.multipliers else "find_impulse"
        traced.run_step("find_cyclic_impulse" if isinstance(self._part, Routh) else impulse)
        if low.equations.plain.rate is not None:
            for s, a in enumerate(traced.coordinates):
                decayed = low.decayed(low.p[a], traced.row("RESIDUAL", s))
                traced.put("RESIDUAL", s, decayed)
        traced.run("close_step")
        traced.leave_momenta(0)

    def pivots(self) -> list[Expression]:
        """Return the pivots of M, with constraints, that were found with the velocity at q1."""
        traced, low = self.traced, self._low
        if not (low.stiffened or low.equations.system.structure.constant_mass):
            traced.run("find_pivots")
        return traced.diagonal("HELD", low.n + len(low.multipliers))[: low.n]
