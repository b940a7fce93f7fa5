"""Solve the discretised problem of optimal control, from a guess to a result."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.control.condensed import Condensed, at_start, moved
from symsimpson.control.control_status import STATUSES, ControlStatus
from symsimpson.control.grid import Grid, read_grid
from symsimpson.control.guess import bent, initial_point, violation
from symsimpson.control.ipopt import Outcome, run_ipopt
from symsimpson.control.judged import result_of
from symsimpson.control.layout import Layout
from symsimpson.control.optimality import creeping, downhill, optimal
from symsimpson.control.reading import Reading, read_family
from symsimpson.control.result import FOUND, SAVED, ControlResult
from symsimpson.control.scaling import Scaled, cost_size, scaled, sizes_at, violations
from symsimpson.control.solution_files import read_solution
from symsimpson.errors import InputError, ResolutionWarning
from symsimpson.program.input_values import MOST_STEPS
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn
from symsimpson.support.progress import Progress
from symsimpson.support.signals import listening

__all__ = ["opened", "solve"]

#: Measured on several problems and meshes: 12 to 33 iterations, where larger barriers fall into
#: other optima; relaxed bounds would move a minimum time by 1e-8.
OPTIONS = {"mu_init": 1e-3, "bound_relax_factor": 0.0, "sb": "yes"}
#: So often steps are halved to make the error small; so often while no solution is resolved, which
#: one that is too coarse may come to.
MOST_REFINEMENTS, MOST_UNRESOLVED = 6, 3
#: So many searches begin again beside a saddle or a maximum.
MOST_RESTARTS = 3
#: A guess that violates what is bounded on the way by more than NEAR, in units of rows, has so many
#: iterations at first, and bent ones so many. From these barriers of 1e-3 took up to 100 iterations
#: and more, of 0.1 at most 49.
NEAR, SHORT, BENT = 1e-6, 60, 100
#: A solution is found once more if it moves so many times more, or less, than its guess.
FAR = 1e4
#: Costs below the first are scaled to 1, by no more than the second allows.
SMALL, SMALLEST = 0.1, 1e-12
#: The cost of a solution in a file is computed again, and may differ by so much, relatively.
ROUNDED = 1e-9


def solve(
    read: Reading,
    scheme: Scheme,
    grid: Grid,
    guess: Any,
    error: float | None,
    options: dict[str, Any],
    progress: bool | None,
    condensed: bool = False,
) -> ControlResult:
    """Solve a problem; halve the steps until the relative error of the cost is at most ``error``.

    Raises InputError if the guess does not fit, conditions are too many, or casadi is not
    installed.
    """
    _warn_of_undetermined_inputs(read, scheme)

    def result_from(layout: Layout, guess: Any) -> tuple[ControlResult, Floats]:
        """Return the result from a guess, and the guess."""
        x0, how = initial_point(layout, guess), (options, progress, condensed)
        result, lengths = _solved(layout, x0, *how, straight=guess is None), layout.points.ravel()
        sizes = (sizes_at(layout, x)[0][lengths] for x in (x0, result.x))
        far = np.abs(np.log(np.divide(*sizes))).max() > np.log(FAR)
        if far and result.violation < NEAR and result.status is not ControlStatus.INTERRUPTED:
            again = _solved(layout, result.x, *how, straight=False)
            if again.success:  # in units of its own
                result = _with_sums(again, [result, again])
        return result, x0

    result, x0 = result_from(Layout(read, scheme, grid), guess)
    size = cost_size(result.layout, x0) if error is not None else 0.0
    for refinements in range(MOST_REFINEMENTS if error is not None else 0):
        unresolved = result.status is ControlStatus.NOT_RESOLVED
        if not result.success and not (unresolved and refinements < MOST_UNRESOLVED):
            break
        finer, _ = result_from(Layout(read, scheme, result.layout.grid.halved), result)
        # an error of order 2 is a third of this change; where inputs jump, the order is no higher
        off = abs(finer.cost - result.cost) / (3 * (max(abs(finer.cost), size) or 1.0))
        result = replace(finer, error=off)
        if result.success and off <= (error or 0.0):
            return result
    if error is not None and result.success:
        warn(
            f"{read.system.name}: with {result.layout.steps} steps the relative error of the cost "
            f"is about {result.error:.1e}, not {error:g}.\nBegin with more steps, or with phases= "
            "that end where inputs jump.",
            ResolutionWarning,
        )
    return result


def _solved(
    layout: Layout,
    x0: Floats,
    options: dict[str, Any],
    progress: bool | None,
    condensed: bool,
    straight: bool,
) -> ControlResult:
    """Solve a problem with one number of steps, from a guess, and from bent ones where it fails.

    One that is ``straight`` tells no side on which to pass what it runs into: all are tried.
    """
    programme, low, high = layout.programme
    fixed = sum(pair[0] == pair[1] for pair in layout.read.found_bounds)
    equations, size = int((low == high).sum()), layout.size - fixed
    if equations > size:
        raise InputError(
            f"{layout.read.system.name}: {equations} equations for {size} unknowns: there are more "
            "conditions than inputs can satisfy.\nLeave conditions out, or add inputs or steps."
        )
    scaled_form = scaled(programme, layout, x0)
    x0 = moved(layout, at_start(layout, x0)) if condensed else x0
    bounds: Any = [*map(scaled_form.inside, layout.bounds)]
    limits: Any = [x / scaled_form.of_rows for x in (low, high)]
    form: Scaled | Condensed = scaled_form
    begun = scaled_form.inside(x0)
    if condensed:
        form = Condensed(scaled_form, layout, begun, bounds)
        begun = form.inside(begun)
        bounds, limits = form.bounds(bounds, limits)

    def escape_step(outcome: Outcome) -> Floats | None:
        """Return a step along which the cost falls, where a search ended at no minimum."""
        ended = STATUSES.get(outcome.ipopt_status) in FOUND or creeping(outcome)
        return downhill(form, outcome, bounds, limits) if ended else None

    def to_result(outcome: Outcome, step: Floats | None) -> ControlResult:
        """Return the result, judged by its conditions of optimality unless the cost still falls."""
        best = step is None and optimal(form, outcome, bounds, limits, options["tol"])
        outcome = form.outcome(outcome) if isinstance(form, Condensed) else outcome
        return result_of(layout, scaled_form.outcome(outcome), best)

    name = f"{layout.read.system.name}, {layout.steps} steps"
    bar = Progress(options["max_iter"] + 1, progress, look="{desc}, {elapsed}", what=name)
    with listening() as heard, bar:

        def stopped(cost: float) -> bool:
            """Show the cost of an iterate, and return whether Ctrl-C was pressed."""
            bar.say(f"{name}: cost {cost * scaled_form.of_cost:.6g}, {bar.count} iterations")
            bar.add(1)
            return bool(heard)

        def run(x: Floats, **more: Any) -> Outcome:
            return run_ipopt(form, x, bounds, limits, {**OPTIONS, **options, **more}, stopped)

        outcomes: list[Outcome] = []

        def search(begin: Floats, most: int, **more: Any) -> ControlResult:
            """Search from a point; begin again beside points that are no minima."""
            outcomes.append(run(begin, max_iter=most, **more))
            step, restarts = escape_step(outcomes[-1]), 0
            while step is not None and restarts < MOST_RESTARTS:
                outcomes.append(run(outcomes[-1].x + step))
                step, restarts = escape_step(outcomes[-1]), restarts + 1
            result = to_result(outcomes[-1], step)
            # the solver compares with 1: small costs are found once more, in a unit of their own
            size = max(abs(form.values(begin)[0]), abs(result.cost) / scaled_form.of_cost)
            if outcomes[-1].ipopt_status == "Solve_Succeeded" and 0 < size < SMALL:
                outcomes.append(run(outcomes[-1].x, obj_scaling_factor=1 / max(size, SMALLEST)))
                again = to_result(outcomes[-1], escape_step(outcomes[-1]))
                result = again if again.success else result
            return result

        most = options["max_iter"]
        off = 0.0 if condensed else violation(layout, x0, layout.path_rows)
        first = 0 if off == np.inf else min(most, SHORT) if off > NEAR else most
        result = search(begun, first)
        if not condensed and (not result.success or (straight and off > NEAR)):
            end, results = outcomes[-1].x, [result]
            for trial in bent(layout, x0):
                if not heard:
                    results.append(search(scaled_form.inside(trial), min(most, BENT), mu_init=0.1))
            result = min(results, key=lambda trial: trial.cost if trial.success else np.inf)
            if first < most and result.status is ControlStatus.ITERATION_LIMIT:
                result = search(end, most - first)
    return _with_sums(result, outcomes)


def _with_sums(result: ControlResult, parts: Any) -> ControlResult:
    """Return a result with the iterations and seconds of all searches."""
    sums = ("iterations", "seconds", "in_functions")
    return replace(result, **{name: sum(getattr(part, name) for part in parts) for name in sums})


def opened(read: Reading, path: str | os.PathLike[str], scheme: Any) -> ControlResult:
    """Read a solution of a problem from a file; its cost and conditions are computed again.

    Raises StorageError if the file holds no solution, or is damaged; InputError if it is the
    solution of another problem.
    """
    place, saved, x, multipliers = read_solution(path, {**SAVED, "scheme": str, "steps": _as_grid})
    name, grid = saved.pop("scheme"), saved.pop("steps")
    galerkin_scheme, fits = read_family(scheme or name), 0
    # a damaged number of steps must not ask for more memory than the file has numbers
    if len(grid.steps) == len(read.phases) and grid.count <= len(x):
        layout = Layout(read, galerkin_scheme, grid)
        programme, *_ = layout.programme
        fits = (len(multipliers), len(x)) == programme.shape
    if fits:
        cost, (low, high) = programme.values(x)[0], layout.bounds
        outside = np.maximum(low - x, x - high) / sizes_at(layout, x)[0]
        largest = max(violations(layout, x).max(initial=0.0), outside.max(initial=0.0))
        if np.isfinite([cost, largest]).all():
            off = abs(cost - saved["cost"]) / (abs(cost) or 1.0)
            fits = off <= ROUNDED and largest <= saved["violation"] + ROUNDED
        else:  # where the search ended, something had no value
            fits = not np.isfinite(saved["violation"])
    if not fits:
        raise InputError(
            f"{place}: the file holds the solution of another problem, of {grid.count} steps of "
            f"{name}."
            f"\nOf {read.system.name} as it is written down it has another cost, or conditions or "
            "equations are not satisfied. Write down the problem as it was, with the same "
            "parameters."
        )
    return ControlResult(layout, x, multipliers, **saved)


def _as_grid(steps: Any) -> Grid:
    """Return the grid of the numbers of steps that a file holds."""
    return read_grid(steps, len(steps) if isinstance(steps, list) else 1, most=MOST_STEPS)


def _warn_of_undetermined_inputs(read: Reading, scheme: Scheme) -> None:
    """Warn of schemes that have more nodes in a step than its motion can tell apart."""
    nodes, degree = scheme.stages, scheme.degree
    shared = scheme.quadrature.nodes[0] == 0 and scheme.quadrature.nodes[-1] == 1
    if read.inputs and nodes > degree + shared:
        warn(
            f"{scheme.name} has {nodes} nodes in a step of degree {degree}: some inputs act only "
            "in sums, and are found only where the cost is convex in them.\nTake a scheme with "
            "fewer nodes, as 'lobatto6' or 'gauss6'.",
            ResolutionWarning,
        )
