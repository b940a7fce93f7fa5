"""Solve the discretised problem of optimal control, from a guess to a result."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.control.condensed import Condensed, at_start, moved
from symsimpson.control.constraint_rows import onto
from symsimpson.control.control_status import STATUSES, ControlStatus
from symsimpson.control.functions_of_time import read_function, values_at
from symsimpson.control.grid import Grid, read_grid
from symsimpson.control.ipopt import Outcome, run_ipopt
from symsimpson.control.judged import result_of
from symsimpson.control.layout import Layout
from symsimpson.control.optimality import creeping, downhill, optimal
from symsimpson.control.point_functions import PointFunctions
from symsimpson.control.problem_parts import read_mapping, read_reals
from symsimpson.control.reading import Reading, read_family
from symsimpson.control.result import FOUND, SAVED, ControlResult
from symsimpson.control.scaling import Scaled, scaled, sizes_at
from symsimpson.control.solution_files import read_solution
from symsimpson.errors import InputError, ResolutionWarning
from symsimpson.program.input_values import MOST_STEPS
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn
from symsimpson.support.names import did_you_mean
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
    result = _solved(Layout(read, scheme, grid), guess, options, progress, condensed)
    for refinements in range(MOST_REFINEMENTS if error is not None else 0):
        unresolved = result.status is ControlStatus.NOT_RESOLVED
        if not result.success and not (unresolved and refinements < MOST_UNRESOLVED):
            break
        layout = Layout(read, scheme, result.layout.grid.halved)
        finer = _solved(layout, result, options, progress, condensed)
        off = abs(finer.cost - result.cost) / (abs(finer.cost) or 1.0)
        # an error of order 2 is a third of this change; where inputs jump, the order is no higher
        result = replace(finer, error=off / 3)
        if result.success and off / 3 <= (error or 0.0):
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
    layout: Layout, guess: Any, options: dict[str, Any], progress: bool | None, condensed: bool
) -> ControlResult:
    """Solve a problem with one number of steps; begin again beside points that are no minima."""
    programme, low, high = layout.programme
    fixed = sum(pair[0] == pair[1] for pair in layout.read.found_bounds)
    equations, size = int((low == high).sum()), layout.size - fixed
    if equations > size:
        raise InputError(
            f"{layout.read.system.name}: {equations} equations for {size} unknowns: there are more "
            "conditions than inputs can satisfy.\nLeave conditions out, or add inputs or steps."
        )
    x0 = np.clip(initial_point(layout, guess), *layout.bounds)
    scaled_form = scaled(programme, layout, x0)
    x0 = moved(layout, at_start(layout, x0)) if condensed else x0
    bounds, limits = scaled_form.bounds(layout.bounds, (low, high))
    form: Scaled | Condensed = scaled_form
    begun = scaled_form.inside(x0)
    if condensed:

        def motion(x: Floats) -> Floats:
            return scaled_form.inside(moved(layout, scaled_form.outside(x)))

        form = Condensed(scaled_form, layout, motion, begun, bounds)
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

        outcomes = [run(begun)]
        step = escape_step(outcomes[-1])
        while step is not None and len(outcomes) <= MOST_RESTARTS:
            outcomes.append(run(outcomes[-1].x + step))
            step = escape_step(outcomes[-1])
        result = to_result(outcomes[-1], step)
        # the solver compares with 1: small costs are found once more, in a unit of their own
        size = max(abs(form.values(begun)[0]), abs(result.cost) / scaled_form.of_cost)
        if outcomes[-1].ipopt_status == "Solve_Succeeded" and 0 < size < SMALL:
            outcomes.append(run(outcomes[-1].x, obj_scaling_factor=1 / max(size, SMALLEST)))
            again = to_result(outcomes[-1], escape_step(outcomes[-1]))
            result = again if again.success else result
    return replace(
        result,
        iterations=sum(outcome.iterations for outcome in outcomes),
        seconds=sum(outcome.seconds for outcome in outcomes),
        in_functions=sum(outcome.in_functions for outcome in outcomes),
    )


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
        programme, low, high = layout.programme
        fits = (len(multipliers), len(x)) == programme.shape
    if fits:
        cost, rows = programme.values(x)
        of_unknowns, of_rows = sizes_at(layout, x)
        violations = [
            (np.maximum(a - y, y - b) / size).max(initial=0.0)
            for a, y, b, size in (
                (low, rows, high, of_rows),
                (layout.bounds[0], x, layout.bounds[1], of_unknowns),
            )
        ]
        if np.isfinite([cost, *violations]).all():
            off = abs(cost - saved["cost"]) / (abs(cost) or 1.0)
            fits = off <= ROUNDED and max(violations) <= saved["violation"] + ROUNDED
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
    """Return the grid of the numbers of steps that a file holds; raises ValueError."""
    try:
        return read_grid(steps, len(steps) if isinstance(steps, list) else 1, most=MOST_STEPS)
    except InputError as error:
        raise ValueError(str(error)) from None


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


def initial_point(layout: Layout, guess: Any) -> Floats:
    """Return unknowns to begin with: coordinates, inputs, momenta, steps, parameters.

    Without a guess, straight lines between the ends. Raises InputError if the guess has other names
    or shapes, or momenta are not finite.
    """
    read, N = layout.read, layout.steps
    low, high = read.duration
    functions: dict[str, Any] = {}
    whole = float(np.sqrt(low * high))
    values = [np.sqrt(a * b) if 0 < a < b < np.inf else (a + b) / 2 for a, b in read.found_bounds]
    values = [
        x if np.isfinite(x) else read.values[i] for x, i in zip(values, read.found, strict=True)
    ]
    if isinstance(guess, ControlResult):
        functions = guess.functions
        strange = [name for name in functions if name not in (*read.names, *read.inputs)]
        if strange:
            raise InputError(
                f"guess is a result of {guess.layout.read.system.name}, with {', '.join(strange)}; "
                f"{read.system.name} has {', '.join((*read.names, *read.inputs))}.\nPass those "
                "that belong to one another by name: {name: result.functions[other]}."
            )
        whole = guess.duration
        unknowns = guess.unknowns
        values = [unknowns.get(name, x) for name, x in zip(read.found_names, values, strict=True)]
    elif guess is not None:
        how = (
            "another result, or a mapping from names to functions of the time, numbers, or arrays "
            "over equal times"
        )
        given = {name: value for name, _, value in read_mapping("guess", guess, how)}
        allowed = {*read.names, *read.inputs, "duration", *read.found_names}
        for name in given:
            if name not in allowed:
                raise InputError(
                    f"guess names {name!r}.{did_you_mean(name, sorted(allowed))}\n"
                    f"It has values of {', '.join(sorted(allowed))}."
                )
        whole = _number("duration", given.pop("duration", whole))
        if whole <= 0:
            raise InputError(f"guess['duration'] is {whole:g}.\nPass a positive number.")
        pairs = zip(read.found_names, values, strict=True)
        values = [_number(name, given.pop(name, x)) for name, x in pairs]
        functions = {
            name: read_function(f"guess[{name!r}]", value, whole) for name, value in given.items()
        }
    whole = min(max(whole, low), high)
    x = np.zeros(layout.size)
    grid = layout.grid
    sizes = np.full(len(grid.steps), whole / N)
    if isinstance(guess, ControlResult) and len(guess.layout.grid.steps) == len(grid.steps):
        durations = guess.layout.sizes(guess.x) * guess.layout.grid.steps
        sizes = whole * durations / durations.sum() / grid.steps
    ends_of_steps, h = grid.times(sizes), sizes[grid.phase]
    starts = ends_of_steps[:-1]
    times = starts[:, None] + h[:, None] * layout.places
    ends = [_fixed_coordinates(limits, read) for limits in read.ends]
    for a, name in enumerate(read.names):
        first = ends[0].get(name, ends[1].get(name, 0.0))
        last = ends[1].get(name, first)
        line = functions.get(
            name, lambda t, first=first, last=last: first + (last - first) * t / whole
        )
        x[layout.points[:, :, a]] = values_at(f"guess[{name!r}]", line, times)
    nodes = starts[:, None] + h[:, None] * layout.c
    for k, name in enumerate(read.inputs):
        if name in functions:
            x[layout.inputs[..., k]] = values_at(f"guess[{name!r}]", functions[name], nodes)
    x[layout.parameters] = values
    x[layout.h] = sizes[: len(layout.h)]
    known = layout.parameter_values(x)
    x[layout.points] = onto(layout, x[layout.points], known)
    # momenta of the path at the ends of steps
    q = x[layout.points]
    at_start, at_end = (np.array(row, dtype=np.float64) for row in layout.end_slopes)
    v = np.concatenate([at_start @ q / h[:, None], (at_end @ q[-1])[None] / h[-1]])
    at = np.concatenate([q[:, 0], q[-1:, -1]])
    momenta = PointFunctions(read.graph, read.q, read.momenta)
    state: dict[int, Any] = dict(zip([*read.q, *read.v], [*at.T, *v.T], strict=True))
    state |= {**known, read.t: ends_of_steps}
    x[layout.momenta] = momenta.values(state, N + 1).T
    x[layout.velocities] = v[[0, -1]]
    if not np.isfinite(x).all():
        raise InputError(
            "the guess has no finite momenta, or holds NaN.\nGive functions of the time with which "
            "the motion stays where the energies have values."
        )
    return x


def _fixed_coordinates(limits: Any, read: Any) -> dict[str, float]:
    """Return the coordinates that conditions factor * q = value fix at an end, by name."""
    return {
        read.names[read.q.index(node)]: limit.low / float(factor)
        for limit in limits
        for factor, node in [limit.value]
        if limit.low == limit.high and node in read.q
    }


def _number(name: str, given: Any) -> float:
    """Read a number of a guess."""
    how = "Pass a finite number."
    number = read_reals(f"guess[{name!r}]", given, how)
    if number.ndim or not np.isfinite(number):
        raise InputError(f"guess[{name!r}] is {given!r}, no finite number.\n{how}")
    return float(number)
