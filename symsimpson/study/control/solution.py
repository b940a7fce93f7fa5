"""The search for a solution of the discretised problem, from an initial guess to a result."""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from symsimpson.errors import ResolutionWarning, reject
from symsimpson.graph.point_functions import PointFunctions
from symsimpson.program.input_values import MOST_STEPS, read_reals
from symsimpson.results.trajectory import Trajectory
from symsimpson.schemes.scheme import Scheme
from symsimpson.study.control.constraint_rows import follows_constraints, project_points
from symsimpson.study.control.layout import Layout
from symsimpson.study.control.optimality import (
    STATUSES,
    find_descent_step,
    is_creeping,
    is_optimal,
    make_result,
)
from symsimpson.study.control.problem_parts import (
    Grid,
    finite_values_at,
    read_function,
    read_grid,
    read_mapping,
    run_to_functions,
)
from symsimpson.study.control.result import FOUND, SAVED, ControlResult, ControlStatus
from symsimpson.study.control.solver import (
    SolverOutcome,
    compute_sizes,
    compute_violations,
    measure_cost,
    run_ipopt,
    scale_program,
)
from symsimpson.study.control.symbolic_problem import SymbolicProblem, read_galerkin_scheme
from symsimpson.support.array_files import read_arrays
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn
from symsimpson.support.interpreter import catch_interrupts
from symsimpson.support.names import did_you_mean
from symsimpson.support.progress import Progress

#: Amplitudes of curved guesses, as fractions of the chord from start to end; the factor with which
#: two waves are as high as one; and the largest violation of an accepted guess. The last one is a
#: fraction of the reduction that the best curved guess achieves.
AMPLITUDES, TWO_WAVES, ACCEPTED_FRACTION = (0.25, 0.5, 1.0, 2.0), 2.6, 0.5
#: Largest numbers of curved guesses and of directions; and the least length of the component of a
#: direction that is orthogonal to the others.
MOST_CURVED, MOST_SIDES, PARALLEL = 6, 6, 0.1


def build_initial_point(layout: Layout, guess: Any) -> Floats:
    """Return the initial values of all variables.

    Coordinates without a guess follow straight lines between the ends. Raises InputError if the
    guess has unknown names or wrong shapes, or if its momenta are not finite.
    """
    problem, grid = layout.problem, layout.grid
    low, high = problem.duration
    given = _read_guess(problem, guess)
    duration = _read_number("duration", given.pop("duration", np.sqrt(low * high)))
    if duration <= 0:
        reject(
            f"guess['duration'] is {duration:g}: not positive.", remedy="Pass a positive number."
        )
    values = []
    for name, i, (a, b) in zip(
        problem.free_names, problem.free_parameters, problem.free_bounds, strict=True
    ):
        middle = np.sqrt(a * b) if 0 < a < b < np.inf else (a + b) / 2
        middle = middle if np.isfinite(middle) else problem.values[i]
        values.append(_read_number(name, given.pop(name, middle)))
    functions = {
        name: read_function(f"guess[{name!r}]", value, duration) for name, value in given.items()
    }
    duration = min(max(duration, low), high)
    x = np.zeros(layout.size)
    sizes = np.full(len(grid.steps), duration / layout.steps)
    if isinstance(guess, ControlResult) and len(guess.layout.grid.steps) == len(grid.steps):
        durations = guess.layout.sizes(guess.x) * guess.layout.grid.steps
        sizes = duration * durations / durations.sum() / grid.steps
    ends_of_steps, h = grid.times(sizes), sizes[grid.phase]
    starts = ends_of_steps[:-1]
    times = starts[:, None] + h[:, None] * layout.places
    at_start, at_end = problem.fixed_values(0), problem.fixed_values(1)
    for a, (name, node) in enumerate(zip(problem.names, problem.q, strict=True)):
        first = at_start.get(node, at_end.get(node, 0.0))
        last = at_end.get(node, first)
        line = functions.get(
            name, lambda t, first=first, last=last: first + (last - first) * t / duration
        )
        x[layout.points[:, :, a]] = finite_values_at(f"guess[{name!r}]", line, times)
    nodes = starts[:, None] + h[:, None] * layout.c
    for k, name in enumerate(problem.inputs):
        if name in functions:
            x[layout.inputs[..., k]] = finite_values_at(f"guess[{name!r}]", functions[name], nodes)
    x[layout.parameters] = values
    x[layout.h] = sizes[: len(layout.h)]
    x = _complete_guess(layout, x)
    if not np.isfinite(x).all():
        reject(
            "guess has momenta that are not finite, or contains NaN.",
            remedy="Pass functions of time along which the energies are finite.",
        )
    return x


def _read_guess(problem: SymbolicProblem, guess: Any) -> dict[str, Any]:
    """Return the values of a guess by names of coordinates, inputs, parameters and "duration"."""
    if isinstance(guess, ControlResult):
        functions = guess.functions
        strange = [name for name in functions if name not in (*problem.names, *problem.inputs)]
        if strange:
            reject(
                f"guess is a result of {guess.layout.problem.system.name}, which has "
                f"{', '.join(strange)}.",
                why=f"{problem.system.name} has {', '.join((*problem.names, *problem.inputs))}.",
                remedy="Pass a mapping of corresponding names: {name: result.functions[other]}.",
            )
        unknowns = {name: x for name, x in guess.unknowns.items() if name in problem.free_names}
        return {**functions, **unknowns, "duration": guess.duration}
    how = (
        "a result, a trajectory, or a mapping from names to functions of time, numbers, or arrays "
        "of samples"
    )
    guess = run_to_functions(guess) if isinstance(guess, Trajectory) else guess
    entries = [] if guess is None else read_mapping("guess", guess, how)
    given = {name: value for name, _, value in entries}
    allowed = {*problem.names, *problem.inputs, "duration", *problem.free_names}
    for name in given:
        if name not in allowed:
            reject(
                f"guess contains {name!r}, which is unknown.{did_you_mean(name, sorted(allowed))}",
                remedy=f"Use these names: {', '.join(sorted(allowed))}.",
            )
    return given


def _complete_guess(layout: Layout, x: Floats) -> Floats:
    """Project the path of a guess onto its constraints, and compute its momenta."""
    problem, x, h = layout.problem, x.copy(), layout.sizes(x)[layout.grid.phase]
    x[layout.points] = q = project_points(layout, x)
    # velocities at the ends of steps; the slopes of the Lagrange polynomials add up to 0
    further = np.array(layout.scheme.end_slope, dtype=np.float64)
    at_end = np.array([-further.sum(), *further])
    at_start = -at_end[::-1]
    v = np.concatenate([at_start @ q / h[:, None], (at_end @ q[-1])[None] / h[-1]])
    momenta = PointFunctions(problem.graph, [], problem.momenta)
    x[layout.momenta] = momenta.values(layout.values_at_step_ends(x, v), layout.steps + 1).T
    x[layout.velocities] = v[[0, -1]]
    return np.clip(x, *layout.bounds)


def measure_violation(layout: Layout, x: Floats, among: Any = None) -> float:
    """Return the sum of the scaled violations of a guess, without the equations of steps.

    The violation is infinite if the path jumps to another branch of the constraints, or if a row
    is not finite. ``among`` selects other rows.
    """
    cost, violations = layout.nlp[0].values(x)[0], compute_violations(layout, x)
    if not (np.isfinite([cost, *violations]).all() and follows_constraints(layout, x)):
        return np.inf
    if among is None:
        among = np.setdiff1d(np.arange(len(violations)), layout.step_rows - 1)
    return float(violations[among].sum())


def curve_guess(layout: Layout, x: Floats) -> list[Floats]:
    """Return curved guesses that reduce the violation, in ascending order of violation.

    They deviate to both sides of the line from start to end, in one or two waves. Coordinates that
    are free at an end move there.
    """
    problem, q, ends = layout.problem, x[layout.points], layout.grid.times(layout.sizes(x))
    violation = measure_violation(layout, x)
    lengths = compute_sizes(layout, x)[0][layout.points[0, 0]]
    s = (ends[:-1, None] + np.diff(ends)[:, None] * layout.places)[..., None] / ends[-1] * np.pi
    fixed = problem.fixed_values(0), problem.fixed_values(1)
    first, last = (np.array([node in values for node in problem.q]) for values in fixed)
    turn = np.where(first & last, np.cos(s), np.where(last, np.sin(s / 2), np.cos(s / 2)))
    wave = np.where(first | last, 1 - turn**2, 1.0)
    shapes = [wave, wave * np.cos(s) * TWO_WAVES]
    shapes += [] if (first & last).all() else [np.where(first & last, 0.0, 1 - turn)]
    chord = (q[-1, -1] - q[0, 0]) / lengths
    reach = float(np.linalg.norm(chord))
    across = [chord / reach] if reach else []
    for side in np.eye(layout.n):
        for other in across:
            side = side - side @ other * other
        if np.linalg.norm(side) > PARALLEL:
            across.append(side / np.linalg.norm(side))
    guesses: list[tuple[float, int, float, Floats]] = []
    sides = across[bool(reach) :][:MOST_SIDES]
    for side, shape, sign in product(sides, shapes, (1.0, -1.0)):
        trials = []
        for amplitude in AMPLITUDES:
            trial = x.copy()
            trial[layout.points] += sign * amplitude * (reach or 1.0) * lengths * side * shape
            trial = _complete_guess(layout, trial)
            trials.append((measure_violation(layout, trial), len(guesses), amplitude, trial))
        guesses.append(min(trials, key=lambda trial: trial[:3]))
    guesses.sort(key=lambda trial: trial[:2])
    least = guesses[0][0] if guesses else violation
    most = least + ACCEPTED_FRACTION * (violation - least)
    return [trial for v, *_, trial in guesses[:MOST_CURVED] if v < violation and v <= most]


def _read_number(name: str, given: Any) -> float:
    """Return a finite number of a guess."""
    how = "Pass a finite number."
    number = read_reals(f"guess[{name!r}]", given, how)
    if number.ndim or not np.isfinite(number):
        reject(f"guess[{name!r}] is {given!r}, which is not a finite number.", remedy=how)
    return float(number)


#: On several problems and meshes, this initial barrier needs 12 to 33 iterations. Larger barriers
#: converge to other optima. Relaxed bounds would change a minimum time by 1e-8.
OPTIONS = {"mu_init": 1e-3, "bound_relax_factor": 0.0, "sb": "yes"}
#: How often steps are halved for ``error=``; and how often if no solution is resolved yet, since a
#: coarse grid may have only such solutions.
MOST_REFINEMENTS, MOST_UNRESOLVED = 6, 3
#: Restarts next to saddle points or maxima.
MOST_RESTARTS = 3
#: A guess that violates path limits by more than FEASIBLE, relative to the sizes of rows, gets
#: FIRST_ITERATIONS at first. Curved guesses get CURVED_ITERATIONS. From these, a barrier of 1e-3
#: took 100 iterations and more, and a barrier of 0.1 at most 49.
FEASIBLE, FIRST_ITERATIONS, CURVED_ITERATIONS = 1e-6, 60, 100
#: A solution is computed again, with new sizes, if its displacements differ by this factor from the
#: guess.
LARGEST_RATIO = 1e4
#: Scaled costs below SMALL are scaled again to 1, except those below SMALLEST.
SMALL, SMALLEST = 0.1, 1e-12
#: Relative difference by which the cost in a file may differ from the computed cost.
SAVED_TOLERANCE = 1e-9


def solve(
    problem: SymbolicProblem,
    scheme: Scheme,
    grid: Grid,
    guess: Any,
    error: float | None,
    options: dict[str, Any],
    progress: bool | None,
) -> ControlResult:
    """Solve a problem; halve the steps until the relative error of the cost is at most ``error``.

    Raises InputError if the guess does not fit, if there are too many conditions, or if casadi is
    not installed.
    """
    _warn_of_undetermined_inputs(problem, scheme)

    def result_from(layout: Layout, guess: Any) -> tuple[ControlResult, Floats]:
        """Return the result of a search, and its initial point."""
        x0, how = build_initial_point(layout, guess), (options, progress)
        result = _solve_on_grid(layout, x0, *how, straight=guess is None)
        lengths = layout.points.ravel()
        sizes = (compute_sizes(layout, x)[0][lengths] for x in (x0, result.x))
        moved = np.abs(np.log(np.divide(*sizes))).max() > np.log(LARGEST_RATIO)
        feasible = result.violation < FEASIBLE
        if moved and feasible and result.status is not ControlStatus.INTERRUPTED:
            again = _solve_on_grid(layout, result.x, *how, straight=False)
            if again.success:  # with sizes of the solution
                result = _sum_searches(again, [result, again])
        return result, x0

    result, x0 = result_from(Layout(problem, scheme, grid), guess)
    size = measure_cost(result.layout, x0) if error is not None else 0.0
    for refinements in range(MOST_REFINEMENTS if error is not None else 0):
        unresolved = result.status is ControlStatus.NOT_RESOLVED
        if not result.success and not (unresolved and refinements < MOST_UNRESOLVED):
            break
        finer, _ = result_from(Layout(problem, scheme, result.layout.grid.halved), result)
        # the error is a third of the change at order 2, which is the order if inputs jump
        estimate = abs(finer.cost - result.cost) / (3 * (max(abs(finer.cost), size) or 1.0))
        result = replace(finer, error=estimate)
        if result.success and estimate <= (error or 0.0):
            return result
    if error is not None and result.success:
        warn(
            f"{problem.system.name}: with {result.layout.steps} steps the relative error of the "
            f"cost is about {result.error:.1e}, above {error:g}.\nStart with more steps, or use "
            "phases= that end where inputs jump.",
            ResolutionWarning,
        )
    return result


def _solve_on_grid(
    layout: Layout, x0: Floats, options: dict[str, Any], progress: bool | None, straight: bool
) -> ControlResult:
    """Solve a problem on one grid, from a guess, and from curved guesses if that fails.

    A guess that is ``straight`` does not choose a side of an obstacle. If it violates path limits,
    curved guesses on all sides are tried, too.
    """
    nlp, low, high = layout.nlp
    fixed = sum(pair[0] == pair[1] for pair in layout.problem.free_bounds)
    equations, size = int((low == high).sum()), layout.size - fixed
    if equations > size:
        reject(
            f"there are {equations} equations for {size} variables.",
            where=layout.problem.system.name,
            why="These are more conditions than inputs can satisfy.",
            remedy="Remove conditions, or add inputs or steps.",
        )
    scaled_nlp = scale_program(nlp, layout, x0)
    bounds: Any = [*map(scaled_nlp.scale, layout.bounds)]
    limits: Any = [x / scaled_nlp.row_sizes for x in (low, high)]

    def escape_step(outcome: SolverOutcome) -> Floats | None:
        """Return a step of decreasing cost if a search ended at a saddle point or a maximum."""
        ended = STATUSES.get(outcome.ipopt_status) in FOUND or is_creeping(outcome)
        return find_descent_step(scaled_nlp, outcome, bounds, limits) if ended else None

    def to_result(outcome: SolverOutcome, step: Floats | None) -> ControlResult:
        """Return the result; a point with a descent ``step`` is not optimal."""
        best = step is None and is_optimal(scaled_nlp, outcome, bounds, limits, options["tol"])
        return make_result(layout, scaled_nlp.unscale(outcome), best)

    name = f"{layout.problem.system.name}, {layout.steps} steps"
    bar = Progress(options["max_iter"] + 1, progress, look="{desc}, {elapsed}", what=name)
    with catch_interrupts() as interrupts, bar:

        def stopped(cost: float) -> bool:
            """Show the cost of an iterate, and return whether the user pressed Ctrl-C."""
            bar.say(f"{name}: cost {cost * scaled_nlp.cost_size:.6g}, {bar.count} iterations")
            bar.add(1)
            return bool(interrupts)

        def run(x: Floats, **changes: Any) -> SolverOutcome:
            settings = {**OPTIONS, **options, **changes}
            return run_ipopt(scaled_nlp, x, bounds, limits, settings, stopped)

        outcomes: list[SolverOutcome] = []

        def search(begin: Floats, most: int, **changes: Any) -> ControlResult:
            """Search from a point, and restart next to points that are not minima."""
            outcomes.append(run(begin, max_iter=most, **changes))
            step, restarts = escape_step(outcomes[-1]), 0
            while step is not None and restarts < MOST_RESTARTS:
                outcomes.append(run(outcomes[-1].x + step))
                step, restarts = escape_step(outcomes[-1]), restarts + 1
            result = to_result(outcomes[-1], step)
            # the solver's tolerance is relative to 1: search again with small costs scaled to 1
            size = max(abs(scaled_nlp.values(begin)[0]), abs(result.cost) / scaled_nlp.cost_size)
            if outcomes[-1].ipopt_status == "Solve_Succeeded" and 0 < size < SMALL:
                outcomes.append(run(outcomes[-1].x, obj_scaling_factor=1 / max(size, SMALLEST)))
                again = to_result(outcomes[-1], escape_step(outcomes[-1]))
                result = again if again.success else result
            return result

        most = options["max_iter"]
        violation = measure_violation(layout, x0, layout.path_rows)
        first = most if violation <= FEASIBLE else min(most, FIRST_ITERATIONS)
        first = 0 if violation == np.inf else first
        result = search(scaled_nlp.scale(x0), first)
        if not result.success or (straight and violation > FEASIBLE):
            end, results = outcomes[-1].x, [result]
            for trial in curve_guess(layout, x0):
                if not interrupts:
                    begin, limit = scaled_nlp.scale(trial), min(most, CURVED_ITERATIONS)
                    results.append(search(begin, limit, mu_init=0.1))
            result = min(results, key=lambda trial: trial.cost if trial.success else np.inf)
            if first < most and result.status is ControlStatus.ITERATION_LIMIT:
                result = search(end, most - first)
    return _sum_searches(result, outcomes)


def _sum_searches(result: ControlResult, parts: Any) -> ControlResult:
    """Return the result with the total iterations and seconds of all searches."""
    sums = ("iterations", "seconds", "in_functions")
    return replace(result, **{name: sum(getattr(part, name) for part in parts) for name in sums})


def open_solution(
    problem: SymbolicProblem, path: str | os.PathLike[str], scheme: Any
) -> ControlResult:
    """Read a solution from a file, and compare its cost and violations with the problem.

    Raises StorageError if the file does not contain a solution, or is damaged. Raises InputError
    if it contains the solution of another problem.
    """
    kinds = {**SAVED, "scheme": str, "steps": _read_saved_grid}
    sizes = {"x": 1, "multipliers": 1}
    place, saved, (x, multipliers) = read_arrays(path, "solution", kinds, sizes)
    name, grid = saved.pop("scheme"), saved.pop("steps")
    galerkin_scheme, fits = read_galerkin_scheme(scheme or name), 0
    # do not allocate memory for a damaged number of steps
    if len(grid.steps) == len(problem.phases) and grid.count <= len(x):
        layout = Layout(problem, galerkin_scheme, grid)
        nlp, *_ = layout.nlp
        fits = (len(multipliers), len(x)) == nlp.shape
    if fits:
        cost, (low, high) = nlp.values(x)[0], layout.bounds
        outside = np.maximum(low - x, x - high) / compute_sizes(layout, x)[0]
        largest = max(compute_violations(layout, x).max(initial=0.0), outside.max(initial=0.0))
        if np.isfinite([cost, largest]).all():
            difference = abs(cost - saved["cost"]) / (abs(cost) or 1.0)
            fits = difference <= SAVED_TOLERANCE and largest <= saved["violation"] + SAVED_TOLERANCE
        else:  # the saved iterate was not finite
            fits = not np.isfinite(saved["violation"])
    if not fits:
        reject(
            f"the file has the solution of another problem, with {grid.count} steps of {name}.",
            where=str(place),
            why=f"For {problem.system.name}, its cost or its constraint violations are different.",
            remedy="Define the same problem as before, with the same parameters.",
        )
    return ControlResult(layout, x, multipliers, **saved)


def _read_saved_grid(steps: Any) -> Grid:
    """Return the grid of the numbers of steps in a file."""
    return read_grid(steps, len(steps) if isinstance(steps, list) else 1, most=MOST_STEPS)


def _warn_of_undetermined_inputs(problem: SymbolicProblem, scheme: Scheme) -> None:
    """Warn if a scheme has more nodes than its motion can distinguish."""
    nodes, degree = scheme.stages, scheme.degree
    shared = scheme.quadrature.nodes[0] == 0 and scheme.quadrature.nodes[-1] == 1
    if problem.inputs and nodes > degree + shared:
        warn(
            f"{scheme.name} has {nodes} nodes in a step of degree {degree}. Some inputs act only "
            "in sums, and are unique only if the cost is convex in them.\nUse a scheme with fewer "
            "nodes, such as 'lobatto6' or 'gauss6'.",
            ResolutionWarning,
        )
