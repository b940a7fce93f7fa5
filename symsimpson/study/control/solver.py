"""A programme as the solver sees it, which is Ipopt, as casadi's wheel brings it.

Solvers compare with 1. Unknowns and rows are divided by their sizes. The size of a coordinate is
how far it moves, by the guess, by given velocities, or else by bounds. The size of the time is the
duration. Masses, and with them momenta, inputs, multipliers and the cost, follow from the
equations at the guess. So neither the way to a solution nor the solution depends on units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from scipy import sparse

from symsimpson.study.control.layout import Layout
from symsimpson.study.control.transcription import Programme
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import library

#: A coordinate that moves by less than this part of what others do, at equal energies, is small
#: beside them. Motions by less than FINE of the positions are lost in rounding.
NEGLIGIBLE, FINE = 1e-4, 1e-6
#: Units of the cost, and of momenta, beside what follows from lengths, times and masses. Measured
#: on golden problems and swing-ups: 6 to 16 iterations, from half to twice of this.
COST, MOMENTUM = 2.0**-7, 2.0**-3
#: Costs are nothing below this part of that of the largest motions and inputs.
NOTHING = 1e-9


@dataclass(frozen=True)
class Outcome:
    """The last iterate of a solver, its multipliers, and how it ended, in the solver's words."""

    x: Floats
    multipliers: Floats
    ipopt_status: str
    iterations: int
    seconds: float
    in_functions: float
    history: dict[str, list[float]]


class Scaled:
    """A programme in units of the sizes of its unknowns, rows and cost."""

    def __init__(
        self, programme: Programme, of_unknowns: Floats, of_rows: Floats, of_cost: float = 1.0
    ) -> None:
        self.programme, self.shape = programme, programme.shape
        self.of_unknowns, self.of_rows, self.of_cost = of_unknowns, of_rows, of_cost
        self.jacobian_places = programme.jacobian_places
        self.hessian_places = programme.hessian_places

    def values(self, x: Floats) -> tuple[float, Floats]:
        """Return the cost and the rows."""
        cost, rows = self.programme.values(x * self.of_unknowns)
        return cost / self.of_cost, rows / self.of_rows

    def slopes(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the gradient of the cost, and the entries of the Jacobian."""
        gradient, entries = self.programme.slopes(x * self.of_unknowns)
        rows, columns = self.jacobian_places
        sizes = self.of_unknowns[columns] / self.of_rows[rows]
        return gradient * self.of_unknowns / self.of_cost, entries * sizes

    def curvatures(self, x: Floats, cost: float, multipliers: Floats) -> Floats:
        """Return entries of the Hessian of cost times the cost, and multipliers times the rows."""
        entries = self.programme.curvatures(
            x * self.of_unknowns, cost / self.of_cost, multipliers / self.of_rows
        )
        rows, columns = self.hessian_places
        return entries * self.of_unknowns[rows] * self.of_unknowns[columns]

    def inside(self, x: Floats) -> Floats:
        """Return unknowns in these units."""
        return x / self.of_unknowns

    def outcome(self, outcome: Outcome) -> Outcome:
        """Return what a solver came to in the units of the programme."""
        costs = [x * self.of_cost for x in outcome.history.get("obj", [])]
        return replace(
            outcome,
            x=outcome.x * self.of_unknowns,
            multipliers=outcome.multipliers * self.of_cost / self.of_rows,
            history={**outcome.history, "obj": costs} if costs else outcome.history,
        )


def scaled(programme: Programme, layout: Layout, x: Floats) -> Scaled:
    """Return the programme of a layout in units of its sizes at a guess."""
    columns, lines = _sizes(programme, layout, x)
    # a cost that is square in inputs has no slope where they are 0
    curved = Scaled(programme, columns, lines).curvatures(x / columns, 1.0, np.zeros(len(lines)))
    parts = np.concatenate([programme.slopes(x)[0] * columns, curved])
    whole = np.abs(parts[np.isfinite(parts)]).sum()
    return Scaled(programme, columns, lines, float(_rounded(whole) * COST))


def cost_size(layout: Layout, x: Floats) -> float:
    """Return the size of costs at a guess: the cost there, or at least more than nothing."""
    programme, *_ = layout.programme
    cost, unit = abs(programme.values(x)[0]), scaled(programme, layout, x).of_cost / COST
    return max(cost if cost < np.inf else 0.0, NOTHING * unit)


def sizes_at(layout: Layout, x: Floats) -> tuple[Floats, Floats]:
    """Return the sizes of unknowns, and the sizes of rows in their scales."""
    of_unknowns, of_rows = _sizes(layout.programme[0], layout, x)
    scales = layout.scales.copy()
    scales[layout.step_rows - 1] /= _rounded(layout.scale * layout.steps)  # which are times
    return of_unknowns, scales * of_rows


def violations(layout: Layout, x: Floats) -> Floats:
    """Return how far rows are outside of their bounds, in units of their sizes."""
    programme, low, high = layout.programme
    rows = programme.values(x)[1]
    outside = np.maximum(np.maximum(low - rows, rows - high), 0.0)
    return np.asarray(outside / sizes_at(layout, x)[1])


@np.errstate(all="ignore")  # a search may end far away
def _sizes(programme: Programme, layout: Layout, x: Floats) -> tuple[Floats, Floats]:
    """Return the sizes of unknowns and of rows."""
    entries = programme.slopes(x)[1]
    entries = np.where(np.isfinite(entries), np.abs(entries), 0.0)
    matrix = sparse.csc_matrix((entries, programme.jacobian_places), shape=programme.shape)
    columns = _unknowns(layout, matrix, x)
    rows = _largest(matrix @ sparse.diags(columns), 1)
    names, kinds = np.unique(layout.names, return_inverse=True)
    of_kinds = np.zeros(len(names))
    np.maximum.at(of_kinds, kinds, rows)
    # rows of a bound or a constraint have one unit, and some may be without a slope
    mixed = np.array([name == "step" or name.startswith("momentum at") for name in names])
    return columns, _rounded(np.where(mixed[kinds], rows, of_kinds[kinds]))


def _lengths(layout: Layout, masses: Floats, x: Floats, pushed: Floats) -> Floats:
    """Return how far coordinates move: on the path, at velocities that are given, else in bounds.

    Bounds count only if nothing else is known: bounds of coordinates, or else ``pushed``, how far
    the largest inputs push.
    """
    q, (given, rates, bounds) = x[layout.points].reshape(-1, layout.n), layout.read.extents
    places = np.abs(q).max(axis=0)
    lengths = np.maximum(np.ptp(q, axis=0), rates)
    lengths = np.where(lengths > 0, np.maximum(lengths, FINE * places), places)
    for further in (given, bounds, pushed):
        lengths = lengths if lengths.any() else further
    at_equal_energies = (lengths * np.sqrt(masses)).max() / np.sqrt(masses)
    return np.where(lengths > NEGLIGIBLE * at_equal_energies, lengths, at_equal_energies)


def _unknowns(layout: Layout, matrix: Any, x: Floats) -> Floats:
    """Return the sizes of unknowns: those of lengths, times and masses, and what follows."""
    sizes, steps, whole = np.ones(layout.size), layout.step_rows - 1, layout.scale * layout.steps
    time, inputs = _rounded(whole), np.moveaxis(layout.inputs, -1, 0)
    blocks = [(steps[..., a].ravel(), layout.points[..., a].ravel()) for a in range(layout.n)]
    masses = _rounded([matrix[rows][:, points].max() for rows, points in blocks])
    # how far an input moves coordinates that is 1 for the whole time, times their masses
    effects = [np.asarray(matrix[:, np.unique(u)].sum(axis=1)).ravel() for u in inputs]
    done = [x[steps[:, -1]].sum(axis=0) * whole / layout.end_scale for x in effects]
    of_inputs = layout.read.of_inputs
    most = [max(map(abs, of_inputs.get(j, (np.inf,)))) for j in range(len(done))]
    pushed = [x * bound / masses for x, bound in zip(done, most, strict=True) if bound < np.inf]
    lengths = _rounded(_lengths(layout, masses, x, np.max([0 * masses, *pushed], axis=0)))
    sizes[layout.points], sizes[layout.velocities] = lengths, lengths / time
    moved = masses * lengths
    sizes[layout.momenta] = MOMENTUM * moved / time
    widest = [np.abs(pair).max() for pair in layout.read.found_bounds]
    values = np.abs(x[layout.parameters])
    sizes[layout.parameters] = _rounded(np.where(values > 0, values, widest))
    sizes[layout.h] = time
    for places, effect, bound in zip(inputs, done, most, strict=True):
        enough = (moved[effect > 0] / effect[effect > 0]).min(initial=np.inf)
        sizes[places] = _rounded(min(bound, enough))
    held = (*np.moveaxis(layout.multipliers, -1, 0), *layout.at_end[:, None])
    if held:
        sizes[np.concatenate([*map(np.ravel, held)])] = 0.0
        of_rows = _rounded(_largest(matrix @ sparse.diags(sizes), 1))
        turned = _largest(sparse.diags(1 / of_rows) @ matrix, 0)
    for places in held:
        sizes[places] = 1 / _rounded(turned[places].max(initial=0.0))
    return sizes


def _largest(matrix: Any, axis: int) -> Floats:
    """Return the largest entry of each row (axis 1) or column (0)."""
    return np.asarray(matrix.max(axis=axis).todense()).ravel()


def _rounded(sizes: Any) -> Any:
    """Return the nearest powers of 2; 1 of what has no size."""
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.round(np.log2(sizes))
    return 2.0 ** np.where(np.isfinite(power), power, 0.0)


def run_ipopt(
    programme: Scaled,
    x0: Floats,
    bounds: tuple[Floats, Floats],
    limits: tuple[Floats, Floats],
    options: dict[str, Any],
    stopped: Callable[[float], bool],
) -> Outcome:
    """Solve a programme from a guess; ``stopped`` gets the cost of each iterate.

    Raises InputError if casadi is not installed.
    """
    ca = library("casadi", "optimal control", "control")
    rows, size = programme.shape
    spent = 0.0

    def pattern(places: Any, shape: tuple[int, int]) -> Any:
        return ca.Sparsity.triplet(*shape, *(x.tolist() for x in places))

    of_x, of_g, scalar = (ca.Sparsity.dense(k, 1) for k in (size, rows, 1))
    none = ca.Sparsity.dense(0, 1)
    jacobian = pattern(programme.jacobian_places, (rows, size))
    hessian = pattern(programme.hessian_places, (size, size))

    class Part(ca.Callback):  # type: ignore[name-defined]
        """A function of casadi that calls one of ours."""

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
            return True  # memory of casadi's, in place of lists of numbers

        def eval_buffer(self, given: Any, results: Any) -> int:
            nonlocal spent
            begin = perf_counter()
            arguments = (np.frombuffer(x if x else b"", dtype=np.float64) for x in given)
            for place, value in zip(results, self.function(*arguments), strict=True):
                if place:  # what is not asked for has none
                    np.frombuffer(place, dtype=np.float64)[:] = value
            spent += perf_counter() - begin
            return 0

    def values_and_slopes(x: Floats, k: int) -> tuple[Any, Any]:
        return programme.values(x)[k], programme.slopes(x)[k]

    def curved(x: Floats, p: Floats, cost: Floats, multipliers: Floats) -> tuple[Any, ...]:
        return (programme.curvatures(x, float(cost[0]), multipliers),)

    class Watch(ca.Callback):  # type: ignore[name-defined]
        """A function that casadi calls behind each iteration."""

        def __init__(self) -> None:
            super().__init__()
            self.of_cost = ca.nlpsol_out().index("f")
            self.construct("watch", {})

        def get_n_in(self) -> int:
            return int(ca.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, i: int) -> Any:
            kinds = {"f": scalar, "x": of_x, "lam_x": of_x, "g": of_g, "lam_g": of_g}
            return kinds.get(ca.nlpsol_out(i), none)

        def eval(self, given: Any) -> Any:
            return [int(stopped(float(given[self.of_cost])))]

    x = ca.MX.sym("x", size)
    at = [of_x, none]
    nlp = Part("nlp", at, [scalar, of_g], lambda x, p: programme.values(x))
    parts = {
        "grad_f": Part("grad_f", at, [scalar, of_x], lambda x, p: values_and_slopes(x, 0)),
        "jac_g": Part("jac_g", at, [of_g, jacobian], lambda x, p: values_and_slopes(x, 1)),
        "hess_lag": Part("hess_lag", [*at, scalar, of_g], [hessian], curved),
    }
    watching = Watch()
    f, g = nlp(x, ca.MX(0, 1))
    solver = ca.nlpsol(
        "solver",
        "ipopt",
        {"x": x, "f": f, "g": g},
        {
            "ipopt": options,
            "print_time": False,
            "show_eval_warnings": False,
            "error_on_fail": False,
            "inputs_check": False,  # it prints a line where inputs are fixed and rows repeat
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
    return Outcome(
        np.array(solution["x"]).ravel(),
        np.array(solution["lam_g"]).ravel(),
        str(stats["return_status"]),
        int(stats.get("iter_count", 0)),
        seconds,
        spent,
        {name: list(map(float, values)) for name, values in stats.get("iterations", {}).items()},
    )
