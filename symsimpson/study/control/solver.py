"""Scaling of nonlinear programs, and the call of Ipopt, which the wheel of casadi contains.

Solvers compare residuals with 1, so variables and rows are divided by their sizes. The size of a
coordinate is its displacement: in the guess, at prescribed velocities, or else within bounds. The
size of time is the duration. The equations at the guess give sizes of masses, momenta, inputs,
multipliers and the cost. The iterations and the solution then do not depend on the user's units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from scipy import sparse

from symsimpson.study.control.layout import Layout
from symsimpson.study.control.transcription import NonlinearProgram
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import import_library

#: A coordinate that moves by less than NEGLIGIBLE times the others, at equal energies, gets their
#: size. Motions below the fraction FINE of the positions are round-off errors.
NEGLIGIBLE, FINE = 1e-4, 1e-6
#: Factors of the sizes of the cost and of momenta, which follow from lengths, times and masses.
#: Golden problems and swing-ups need 6 to 16 iterations, also with half or twice these factors.
COST_UNIT, MOMENTUM_UNIT = 2.0**-7, 2.0**-3
#: Costs are negligible below this fraction of the cost of the largest motions and inputs.
NEGLIGIBLE_COST = 1e-9


@dataclass(frozen=True)
class SolverOutcome:
    """The last iterate of Ipopt with its multipliers, and the status in Ipopt's words."""

    x: Floats
    multipliers: Floats
    ipopt_status: str
    iterations: int
    seconds: float
    in_functions: float
    history: dict[str, list[float]]


class ScaledProgram:
    """A nonlinear program whose variables, rows and cost are divided by their sizes."""

    def __init__(
        self,
        nlp: NonlinearProgram,
        variable_sizes: Floats,
        row_sizes: Floats,
        cost_size: float = 1.0,
    ) -> None:
        self.nlp, self.shape = nlp, nlp.shape
        self.variable_sizes, self.row_sizes, self.cost_size = variable_sizes, row_sizes, cost_size
        self.jacobian_places = nlp.jacobian_places
        self.hessian_places = nlp.hessian_places

    def values(self, x: Floats) -> tuple[float, Floats]:
        """Return the cost and the rows."""
        cost, rows = self.nlp.values(x * self.variable_sizes)
        return cost / self.cost_size, rows / self.row_sizes

    def slopes(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the gradient of the cost, and the entries of the Jacobian."""
        gradient, entries = self.nlp.slopes(x * self.variable_sizes)
        rows, columns = self.jacobian_places
        sizes = self.variable_sizes[columns] / self.row_sizes[rows]
        return gradient * self.variable_sizes / self.cost_size, entries * sizes

    def curvatures(self, x: Floats, cost: float, multipliers: Floats) -> Floats:
        """Return entries of the Hessian of cost times the cost, and multipliers times the rows."""
        entries = self.nlp.curvatures(
            x * self.variable_sizes, cost / self.cost_size, multipliers / self.row_sizes
        )
        rows, columns = self.hessian_places
        return entries * self.variable_sizes[rows] * self.variable_sizes[columns]

    def scale(self, x: Floats) -> Floats:
        """Return variables divided by their sizes."""
        return x / self.variable_sizes

    def unscale(self, outcome: SolverOutcome) -> SolverOutcome:
        """Return an outcome of the solver in the units of the original program."""
        costs = [x * self.cost_size for x in outcome.history.get("obj", [])]
        return replace(
            outcome,
            x=outcome.x * self.variable_sizes,
            multipliers=outcome.multipliers * self.cost_size / self.row_sizes,
            history={**outcome.history, "obj": costs} if costs else outcome.history,
        )


def scale_program(nlp: NonlinearProgram, layout: Layout, x: Floats) -> ScaledProgram:
    """Return a program scaled by the sizes of its variables, rows and cost at a guess."""
    columns, lines = _measure_sizes(nlp, layout, x)
    # include second derivatives: a quadratic cost has no gradient where inputs are 0
    curved = ScaledProgram(nlp, columns, lines).curvatures(x / columns, 1.0, np.zeros(len(lines)))
    parts = np.concatenate([nlp.slopes(x)[0] * columns, curved])
    total = np.abs(parts[np.isfinite(parts)]).sum()
    return ScaledProgram(nlp, columns, lines, float(_round_to_power_of_two(total) * COST_UNIT))


def measure_cost(layout: Layout, x: Floats) -> float:
    """Return the absolute cost at a guess, or the negligible cost if that is larger."""
    nlp, *_ = layout.nlp
    cost, unit = abs(nlp.values(x)[0]), scale_program(nlp, layout, x).cost_size / COST_UNIT
    return max(cost if cost < np.inf else 0.0, NEGLIGIBLE_COST * unit)


def compute_sizes(layout: Layout, x: Floats) -> tuple[Floats, Floats]:
    """Return the sizes of variables, and the sizes of rows times their scales."""
    variable_sizes, row_sizes = _measure_sizes(layout.nlp[0], layout, x)
    scales = layout.scales.copy()
    # the scales of steps are times
    scales[layout.step_rows - 1] /= _round_to_power_of_two(layout.scale * layout.steps)
    return variable_sizes, scales * row_sizes


def compute_violations(layout: Layout, x: Floats) -> Floats:
    """Return the violations of the bounds of rows, divided by the sizes of the rows."""
    nlp, low, high = layout.nlp
    rows = nlp.values(x)[1]
    outside = np.maximum(np.maximum(low - rows, rows - high), 0.0)
    return np.asarray(outside / compute_sizes(layout, x)[1])


@np.errstate(all="ignore")  # iterates may overflow
def _measure_sizes(nlp: NonlinearProgram, layout: Layout, x: Floats) -> tuple[Floats, Floats]:
    """Return the sizes of variables and of rows, which are powers of 2."""
    entries = nlp.slopes(x)[1]
    entries = np.where(np.isfinite(entries), np.abs(entries), 0.0)
    matrix = sparse.csc_matrix((entries, nlp.jacobian_places), shape=nlp.shape)
    columns = _measure_variables(layout, matrix, x)
    rows = _find_largest(matrix @ sparse.diags(columns), 1)
    names, kinds = np.unique(layout.names, return_inverse=True)
    of_kinds = np.zeros(len(names))
    np.maximum.at(of_kinds, kinds, rows)
    # all rows of a bound or a constraint share a unit, and some of them may have no slope
    mixed = np.array([name == "step" or name.startswith("momentum at") for name in names])
    return columns, _round_to_power_of_two(np.where(mixed[kinds], rows, of_kinds[kinds]))


def _measure_lengths(layout: Layout, masses: Floats, x: Floats, pushed: Floats) -> Floats:
    """Return the displacement of each coordinate on the path or at prescribed velocities.

    If all of these are 0, use prescribed coordinates, or else their bounds. The last choice is
    ``pushed``, the displacements that the largest inputs cause.
    """
    q, (given, rates, bounds) = x[layout.points].reshape(-1, layout.n), layout.problem.extents
    positions = np.abs(q).max(axis=0)
    lengths = np.maximum(np.ptp(q, axis=0), rates)
    lengths = np.where(lengths > 0, np.maximum(lengths, FINE * positions), positions)
    for further in (given, bounds, pushed):
        lengths = lengths if lengths.any() else further
    at_equal_energies = (lengths * np.sqrt(masses)).max() / np.sqrt(masses)
    return np.where(lengths > NEGLIGIBLE * at_equal_energies, lengths, at_equal_energies)


def _measure_variables(layout: Layout, matrix: Any, x: Floats) -> Floats:
    """Return the sizes of variables, which follow from lengths, times and masses."""
    sizes, steps, duration = np.ones(layout.size), layout.step_rows - 1, layout.scale * layout.steps
    time, inputs = _round_to_power_of_two(duration), np.moveaxis(layout.inputs, -1, 0)
    blocks = [(steps[..., a].ravel(), layout.points[..., a].ravel()) for a in range(layout.n)]
    masses = _round_to_power_of_two([matrix[rows][:, points].max() for rows, points in blocks])
    # displacements times masses that an input of 1 for the whole duration causes
    effects = [np.asarray(matrix[:, np.unique(u)].sum(axis=1)).ravel() for u in inputs]
    responses = [x[steps[:, -1]].sum(axis=0) * duration / layout.end_scale for x in effects]
    input_bounds = layout.problem.input_bounds
    most = [max(map(abs, input_bounds.get(j, (np.inf,)))) for j in range(len(responses))]
    pushed = [
        x * bound / masses for x, bound in zip(responses, most, strict=True) if bound < np.inf
    ]
    lengths = _round_to_power_of_two(
        _measure_lengths(layout, masses, x, np.max([0 * masses, *pushed], axis=0))
    )
    sizes[layout.points], sizes[layout.velocities] = lengths, lengths / time
    moments = masses * lengths
    sizes[layout.momenta] = MOMENTUM_UNIT * moments / time
    largest_bounds = [np.abs(pair).max() for pair in layout.problem.free_bounds]
    values = np.abs(x[layout.parameters])
    sizes[layout.parameters] = _round_to_power_of_two(np.where(values > 0, values, largest_bounds))
    sizes[layout.h] = time
    for numbers, effect, bound in zip(inputs, responses, most, strict=True):
        enough = (moments[effect > 0] / effect[effect > 0]).min(initial=np.inf)
        sizes[numbers] = _round_to_power_of_two(min(bound, enough))
    multipliers = (*np.moveaxis(layout.multipliers, -1, 0), *layout.end_multipliers[:, None])
    if multipliers:
        sizes[np.concatenate([*map(np.ravel, multipliers)])] = 0.0
        row_sizes = _round_to_power_of_two(_find_largest(matrix @ sparse.diags(sizes), 1))
        slopes = _find_largest(sparse.diags(1 / row_sizes) @ matrix, 0)
    for numbers in multipliers:
        sizes[numbers] = 1 / _round_to_power_of_two(slopes[numbers].max(initial=0.0))
    return sizes


def _find_largest(matrix: Any, axis: int) -> Floats:
    """Return the largest entry of each row (axis 1) or column (0)."""
    return np.asarray(matrix.max(axis=axis).todense()).ravel()


def _round_to_power_of_two(sizes: Any) -> Any:
    """Return the nearest powers of 2; 1 in place of 0, infinity and NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.round(np.log2(sizes))
    return 2.0 ** np.where(np.isfinite(power), power, 0.0)


def run_ipopt(
    nlp: ScaledProgram,
    x0: Floats,
    bounds: tuple[Floats, Floats],
    limits: tuple[Floats, Floats],
    options: dict[str, Any],
    stopped: Callable[[float], bool],
) -> SolverOutcome:
    """Solve a nonlinear program with Ipopt from a guess.

    ``stopped`` receives the cost of each iterate, and returns True to stop. Raises InputError if
    casadi is not installed.
    """
    ca = import_library("casadi", "optimal control", "control")
    rows, size = nlp.shape
    spent = 0.0

    def pattern(entries: Any, shape: tuple[int, int]) -> Any:
        return ca.Sparsity.triplet(*shape, *(x.tolist() for x in entries))

    of_x, of_g, scalar = (ca.Sparsity.dense(k, 1) for k in (size, rows, 1))
    none = ca.Sparsity.dense(0, 1)
    jacobian = pattern(nlp.jacobian_places, (rows, size))
    hessian = pattern(nlp.hessian_places, (size, size))

    class ArrayCallback(ca.Callback):  # type: ignore[name-defined]
        """A casadi function that calls a Python function of arrays."""

        def __init__(self, name: str, takes: Any, gives: Any, function: Any) -> None:
            super().__init__()
            self.takes, self.gives, self.function = takes, gives, function
            self.construct(name, {})

        def get_n_in(self) -> int:
            return len(self.takes)

        def get_n_out(self) -> int:
            return len(self.gives)

        def get_sparsity_in(self, i: int) -> Any:
            return self.takes[i]

        def get_sparsity_out(self, i: int) -> Any:
            return self.gives[i]

        def has_eval_buffer(self) -> bool:
            return True  # casadi passes buffers, not lists of numbers

        def eval_buffer(self, given: Any, results: Any) -> int:
            nonlocal spent
            begin = perf_counter()
            arguments = (np.frombuffer(x if x else b"", dtype=np.float64) for x in given)
            for place, value in zip(results, self.function(*arguments), strict=True):
                if place:  # None if casadi does not need this result
                    np.frombuffer(place, dtype=np.float64)[:] = value
            spent += perf_counter() - begin
            return 0

    def values_and_slopes(x: Floats, k: int) -> tuple[Any, Any]:
        return nlp.values(x)[k], nlp.slopes(x)[k]

    def curved(x: Floats, p: Floats, cost: Floats, multipliers: Floats) -> tuple[Any, ...]:
        return (nlp.curvatures(x, float(cost[0]), multipliers),)

    class IterationCallback(ca.Callback):  # type: ignore[name-defined]
        """A function that casadi calls after each iteration."""

        def __init__(self) -> None:
            super().__init__()
            self.cost_index = ca.nlpsol_out().index("f")
            self.construct("watch", {})

        def get_n_in(self) -> int:
            return int(ca.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, i: int) -> Any:
            kinds = {"f": scalar, "x": of_x, "lam_x": of_x, "g": of_g, "lam_g": of_g}
            return kinds.get(ca.nlpsol_out(i), none)

        def eval(self, given: Any) -> Any:
            return [int(stopped(float(given[self.cost_index])))]

    x = ca.MX.sym("x", size)
    at = [of_x, none]
    functions = ArrayCallback("nlp", at, [scalar, of_g], lambda x, p: nlp.values(x))
    parts = {
        "grad_f": ArrayCallback("grad_f", at, [scalar, of_x], lambda x, p: values_and_slopes(x, 0)),
        "jac_g": ArrayCallback("jac_g", at, [of_g, jacobian], lambda x, p: values_and_slopes(x, 1)),
        "hess_lag": ArrayCallback("hess_lag", [*at, scalar, of_g], [hessian], curved),
    }
    watching = IterationCallback()
    f, g = functions(x, ca.MX(0, 1))
    solver = ca.nlpsol(
        "solver",
        "ipopt",
        {"x": x, "f": f, "g": g},
        {
            "ipopt": options,
            "print_time": False,
            "show_eval_warnings": False,
            "error_on_fail": False,
            "inputs_check": False,  # avoids a printed line for fixed inputs with redundant rows
            "no_nlp_grad": True,
            "iteration_callback": watching,
            "iteration_callback_ignore_errors": False,
            **parts,
        },
    )
    begin = perf_counter()
    solution = solver(x0=x0, lbx=bounds[0], ubx=bounds[1], lbg=limits[0], ubg=limits[1])
    seconds = perf_counter() - begin
    stats = solver.stats()
    return SolverOutcome(
        np.array(solution["x"]).ravel(),
        np.array(solution["lam_g"]).ravel(),
        str(stats["return_status"]),
        int(stats.get("iter_count", 0)),
        seconds,
        spent,
        {name: list(map(float, values)) for name, values in stats.get("iterations", {}).items()},
    )
