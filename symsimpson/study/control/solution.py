"""The search for a solution of the discretised problem, from a first path to a result."""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from symsimpson.errors import ResolutionWarning, reject
from symsimpson.program.input_values import MOST_STEPS, read_reals
from symsimpson.results.trajectory import Trajectory
from symsimpson.schemes.scheme import Scheme
from symsimpson.study.control.constraint_rows import onto, resolved
from symsimpson.study.control.layout import Layout
from symsimpson.study.control.optimality import creeping, downhill, optimal, result_of
from symsimpson.study.control.problem_parts import (
    Grid,
    finite_values_at,
    functions_of,
    read_function,
    read_grid,
    read_mapping,
)
from symsimpson.study.control.reading import Reading, read_family
from symsimpson.study.control.result import FOUND, SAVED, STATUSES, ControlResult, ControlStatus
from symsimpson.study.control.solver import (
    Outcome,
    cost_size,
    run_ipopt,
    scaled,
    sizes_at,
    violations,
)
from symsimpson.study.control.transcription import PointFunctions
from symsimpson.study.control.uses import read_solution
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn
from symsimpson.support.interpreter import listening
from symsimpson.support.names import did_you_mean
from symsimpson.support.progress import Progress

#: How far guesses are bent, as parts of the way from start to end; two waves are as high as one.
#: Of what bends can mend of violations the others mend all but this part.
AMPLITUDES, TWICE, PART = (0.25, 0.5, 1.0, 2.0), 2.6, 0.5
#: Searches begin at so many of them at most, bent to so many sides; sides differ by so much.
MOST_BENT, MOST_SIDES, PARALLEL = 6, 6, 0.1


def initial_point(layout: Layout, guess: Any) -> Floats:
    """Return unknowns to begin with: coordinates, inputs, momenta, steps, parameters.

    Without a guess, straight lines between the ends. Raises InputError if the guess has other names
    or shapes, or momenta are not finite.
    """
    read, grid = layout.read, layout.grid
    low, high = read.duration
    given = _read_guess(read, guess)
    whole = _number("duration", given.pop("duration", np.sqrt(low * high)))
    if whole <= 0:
        reject(f"guess['duration'] is {whole:g}.", remedy="Pass a positive number.")
    values = []
    for name, i, (a, b) in zip(read.found_names, read.found, read.found_bounds, strict=True):
        middle = np.sqrt(a * b) if 0 < a < b < np.inf else (a + b) / 2
        middle = middle if np.isfinite(middle) else read.values[i]
        values.append(_number(name, given.pop(name, middle)))
    functions = {
        name: read_function(f"guess[{name!r}]", value, whole) for name, value in given.items()
    }
    whole = min(max(whole, low), high)
    x = np.zeros(layout.size)
    sizes = np.full(len(grid.steps), whole / layout.steps)
    if isinstance(guess, ControlResult) and len(guess.layout.grid.steps) == len(grid.steps):
        durations = guess.layout.sizes(guess.x) * guess.layout.grid.steps
        sizes = whole * durations / durations.sum() / grid.steps
    ends_of_steps, h = grid.times(sizes), sizes[grid.phase]
    starts = ends_of_steps[:-1]
    times = starts[:, None] + h[:, None] * layout.places
    at_start, at_end = read.fixed(0), read.fixed(1)
    for a, (name, node) in enumerate(zip(read.names, read.q, strict=True)):
        first = at_start.get(node, at_end.get(node, 0.0))
        last = at_end.get(node, first)
        line = functions.get(
            name, lambda t, first=first, last=last: first + (last - first) * t / whole
        )
        x[layout.points[:, :, a]] = finite_values_at(f"guess[{name!r}]", line, times)
    nodes = starts[:, None] + h[:, None] * layout.c
    for k, name in enumerate(read.inputs):
        if name in functions:
            x[layout.inputs[..., k]] = finite_values_at(f"guess[{name!r}]", functions[name], nodes)
    x[layout.parameters] = values
    x[layout.h] = sizes[: len(layout.h)]
    x = _with_momenta(layout, x)
    if not np.isfinite(x).all():
        reject(
            "the guess has no finite momenta, or holds NaN.",
            remedy="Give functions of the time with which "
            "the motion stays where the energies have values.",
        )
    return x


def _read_guess(read: Reading, guess: Any) -> dict[str, Any]:
    """Return what a guess gives, by names of coordinates, inputs, parameters, and "duration"."""
    if isinstance(guess, ControlResult):
        functions = guess.functions
        strange = [name for name in functions if name not in (*read.names, *read.inputs)]
        if strange:
            reject(
                f"guess is a result of {guess.layout.read.system.name}, with {', '.join(strange)}; "
                f"{read.system.name} has {', '.join((*read.names, *read.inputs))}.",
                remedy="Pass those "
                "that belong to one another by name: {name: result.functions[other]}.",
            )
        unknowns = {name: x for name, x in guess.unknowns.items() if name in read.found_names}
        return {**functions, **unknowns, "duration": guess.duration}
    how = (
        "another result, a run, or a mapping from names to functions of the time, numbers, or "
        "arrays over equal times"
    )
    guess = functions_of(guess) if isinstance(guess, Trajectory) else {} if guess is None else guess
    given = {name: value for name, _, value in read_mapping("guess", guess, how)}
    allowed = {*read.names, *read.inputs, "duration", *read.found_names}
    for name in given:
        if name not in allowed:
            reject(
                f"guess names {name!r}.{did_you_mean(name, sorted(allowed))}",
                remedy=f"It has values of {', '.join(sorted(allowed))}.",
            )
    return given


def _with_momenta(layout: Layout, x: Floats) -> Floats:
    """Put the path of a guess onto its constraints, and give it its own momenta."""
    read, x, h = layout.read, x.copy(), layout.sizes(x)[layout.grid.phase]
    x[layout.points] = q = onto(layout, x)
    # momenta of the path at the ends of steps; slopes of a step's polynomials add up to 0
    further = np.array(layout.scheme.end_slope, dtype=np.float64)
    at_end = np.array([-further.sum(), *further])
    at_start = -at_end[::-1]
    v = np.concatenate([at_start @ q / h[:, None], (at_end @ q[-1])[None] / h[-1]])
    momenta = PointFunctions(read.graph, [], read.momenta)
    x[layout.momenta] = momenta.values(layout.at_ends(x, v), layout.steps + 1).T
    x[layout.velocities] = v[[0, -1]]
    return np.clip(x, *layout.bounds)


def violation(layout: Layout, x: Floats, among: Any = None) -> float:
    """Return how far a guess is from what holds beside the equations of steps, by rows' slopes.

    It is infinite where the path jumps to another branch of the constraints, or something has no
    value. ``among`` chooses rows.
    """
    cost, off = layout.programme[0].values(x)[0], violations(layout, x)
    if not (np.isfinite([cost, *off]).all() and resolved(layout, x)):
        return np.inf
    beside = np.setdiff1d(np.arange(len(off)), layout.step_rows - 1) if among is None else among
    return float(off[beside].sum())


def bent(layout: Layout, x: Floats) -> list[Floats]:
    """Return bent guesses that violate the rows less; the guess that violates least comes first.

    The guesses bend to both sides, across the line from start to end, in one wave or two.
    Coordinates that are free at an end move there.
    """
    read, q, ends = layout.read, x[layout.points], layout.grid.times(layout.sizes(x))
    off, lengths = violation(layout, x), sizes_at(layout, x)[0][layout.points[0, 0]]
    s = (ends[:-1, None] + np.diff(ends)[:, None] * layout.places)[..., None] / ends[-1] * np.pi
    first, last = (np.array([node in read.fixed(end) for node in read.q]) for end in (0, 1))
    turn = np.where(first & last, np.cos(s), np.where(last, np.sin(s / 2), np.cos(s / 2)))
    wave = np.where(first | last, 1 - turn**2, 1.0)
    shapes = [wave, wave * np.cos(s) * TWICE]
    shapes += [] if (first & last).all() else [np.where(first & last, 0.0, 1 - turn)]
    way = (q[-1, -1] - q[0, 0]) / lengths
    reach = float(np.linalg.norm(way))
    across = [way / reach] if reach else []
    for side in np.eye(layout.n):
        for other in across:
            side = side - side @ other * other
        if np.linalg.norm(side) > PARALLEL:
            across.append(side / np.linalg.norm(side))
    guesses: list[tuple[float, int, float, Floats]] = []
    sides = across[bool(reach) :][:MOST_SIDES]
    for side, shape, sign in product(sides, shapes, (1.0, -1.0)):
        trials = []
        for far in AMPLITUDES:
            trial = x.copy()
            trial[layout.points] += sign * far * (reach or 1.0) * lengths * side * shape
            trial = _with_momenta(layout, trial)
            trials.append((violation(layout, trial), len(guesses), far, trial))
        guesses.append(min(trials, key=lambda trial: trial[:3]))
    guesses.sort(key=lambda trial: trial[:2])
    least = guesses[0][0] if guesses else off
    most = least + PART * (off - least)
    return [trial for left, *_, trial in guesses[:MOST_BENT] if left < off and left <= most]


def _number(name: str, given: Any) -> float:
    """Read a number of a guess."""
    how = "Pass a finite number."
    number = read_reals(f"guess[{name!r}]", given, how)
    if number.ndim or not np.isfinite(number):
        reject(f"guess[{name!r}] is {given!r}, no finite number.", remedy=f"{how}")
    return float(number)


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
) -> ControlResult:
    """Solve a problem; halve the steps until the relative error of the cost is at most ``error``.

    Raises InputError if the guess does not fit, conditions are too many, or casadi is not
    installed.
    """
    _warn_of_undetermined_inputs(read, scheme)

    def result_from(layout: Layout, guess: Any) -> tuple[ControlResult, Floats]:
        """Return the result from a guess, and the guess."""
        x0, how = initial_point(layout, guess), (options, progress)
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
    layout: Layout, x0: Floats, options: dict[str, Any], progress: bool | None, straight: bool
) -> ControlResult:
    """Solve a problem with one number of steps, from a guess, and from bent ones where it fails.

    One that is ``straight`` tells no side on which to pass what it runs into: all are tried.
    """
    programme, low, high = layout.programme
    fixed = sum(pair[0] == pair[1] for pair in layout.read.found_bounds)
    equations, size = int((low == high).sum()), layout.size - fixed
    if equations > size:
        reject(
            f"{layout.read.system.name}: {equations} equations for {size} unknowns: there are more "
            "conditions than inputs can satisfy.",
            remedy="Leave conditions out, or add inputs or steps.",
        )
    form = scaled(programme, layout, x0)
    bounds: Any = [*map(form.inside, layout.bounds)]
    limits: Any = [x / form.of_rows for x in (low, high)]

    def escape_step(outcome: Outcome) -> Floats | None:
        """Return a step along which the cost falls, where a search ended at no minimum."""
        ended = STATUSES.get(outcome.ipopt_status) in FOUND or creeping(outcome)
        return downhill(form, outcome, bounds, limits) if ended else None

    def to_result(outcome: Outcome, step: Floats | None) -> ControlResult:
        """Return the result, judged by its conditions of optimality unless the cost still falls."""
        best = step is None and optimal(form, outcome, bounds, limits, options["tol"])
        return result_of(layout, form.outcome(outcome), best)

    name = f"{layout.read.system.name}, {layout.steps} steps"
    bar = Progress(options["max_iter"] + 1, progress, look="{desc}, {elapsed}", what=name)
    with listening() as heard, bar:

        def stopped(cost: float) -> bool:
            """Show the cost of an iterate, and return whether Ctrl-C was pressed."""
            bar.say(f"{name}: cost {cost * form.of_cost:.6g}, {bar.count} iterations")
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
            size = max(abs(form.values(begin)[0]), abs(result.cost) / form.of_cost)
            if outcomes[-1].ipopt_status == "Solve_Succeeded" and 0 < size < SMALL:
                outcomes.append(run(outcomes[-1].x, obj_scaling_factor=1 / max(size, SMALLEST)))
                again = to_result(outcomes[-1], escape_step(outcomes[-1]))
                result = again if again.success else result
            return result

        most = options["max_iter"]
        off = violation(layout, x0, layout.path_rows)
        first = 0 if off == np.inf else min(most, SHORT) if off > NEAR else most
        result = search(form.inside(x0), first)
        if not result.success or (straight and off > NEAR):
            end, results = outcomes[-1].x, [result]
            for trial in bent(layout, x0):
                if not heard:
                    results.append(search(form.inside(trial), min(most, BENT), mu_init=0.1))
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
        reject(
            f"{place}: the file holds the solution of another problem, of {grid.count} steps of "
            f"{name}.",
            remedy=f"Of {read.system.name} as it is written down it has another cost, or "
            "conditions or "
            "equations are not satisfied. Write down the problem as it was, with the same "
            "parameters.",
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
