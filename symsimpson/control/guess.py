"""Where a search begins: at a guess of the user's, at a straight line, or at a bent one."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from symsimpson.control.constraint_rows import onto, resolved
from symsimpson.control.functions_of_time import finite_values_at, functions_of, read_function
from symsimpson.control.layout import Layout
from symsimpson.control.point_functions import PointFunctions
from symsimpson.control.problem_parts import read_mapping
from symsimpson.control.reading import Reading
from symsimpson.control.result import ControlResult
from symsimpson.control.scaling import sizes_at, violations
from symsimpson.errors import InputError
from symsimpson.program.input_values import read_reals
from symsimpson.results.trajectory import Trajectory
from symsimpson.support.array_types import Floats
from symsimpson.support.names import did_you_mean

__all__ = ["bent", "initial_point", "violation"]

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
        raise InputError(f"guess['duration'] is {whole:g}.\nPass a positive number.")
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
        raise InputError(
            "the guess has no finite momenta, or holds NaN.\nGive functions of the time with which "
            "the motion stays where the energies have values."
        )
    return x


def _read_guess(read: Reading, guess: Any) -> dict[str, Any]:
    """Return what a guess gives, by names of coordinates, inputs, parameters, and "duration"."""
    if isinstance(guess, ControlResult):
        functions = guess.functions
        strange = [name for name in functions if name not in (*read.names, *read.inputs)]
        if strange:
            raise InputError(
                f"guess is a result of {guess.layout.read.system.name}, with {', '.join(strange)}; "
                f"{read.system.name} has {', '.join((*read.names, *read.inputs))}.\nPass those "
                "that belong to one another by name: {name: result.functions[other]}."
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
            raise InputError(
                f"guess names {name!r}.{did_you_mean(name, sorted(allowed))}\n"
                f"It has values of {', '.join(sorted(allowed))}."
            )
    return given


def _with_momenta(layout: Layout, x: Floats) -> Floats:
    """Put the path of a guess onto its constraints, and give it its own momenta."""
    read, x, known, sizes = layout.read, x.copy(), layout.parameter_values(x), layout.sizes(x)
    x[layout.points] = q = onto(layout, x[layout.points], known)
    h = sizes[layout.grid.phase]
    # momenta of the path at the ends of steps; slopes of a step's polynomials add up to 0
    further = np.array(layout.scheme.end_slope, dtype=np.float64)
    at_end = np.array([-further.sum(), *further])
    at_start = -at_end[::-1]
    v = np.concatenate([at_start @ q / h[:, None], (at_end @ q[-1])[None] / h[-1]])
    at = np.concatenate([q[:, 0], q[-1:, -1]])
    momenta = PointFunctions(read.graph, [], read.momenta)
    state: dict[int, Any] = dict(zip([*read.q, *read.v], [*at.T, *v.T], strict=True))
    state |= {**known, read.t: layout.grid.times(sizes)}
    x[layout.momenta] = momenta.values(state, layout.steps + 1).T
    x[layout.velocities] = v[[0, -1]]
    return np.clip(x, *layout.bounds)


def violation(layout: Layout, x: Floats, among: Any = None) -> float:
    """Return how far a guess is from what holds beside the equations of steps, by rows' slopes.

    It is infinite where the path jumps to another branch of the constraints, or something has no
    value. ``among`` chooses rows.
    """
    cost, off = layout.programme[0].values(x)[0], violations(layout, x)
    if not (np.isfinite([cost, *off]).all() and resolved(layout, x, layout.parameter_values(x))):
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
        raise InputError(f"guess[{name!r}] is {given!r}, no finite number.\n{how}")
    return float(number)
