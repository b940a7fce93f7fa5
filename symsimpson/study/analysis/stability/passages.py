"""Passages near singular points of the coordinates, and whether the steps of a run resolve them.

At a pole, for example of spherical angles, det M vanishes. A motion close to a pole changes
its angles within a small part of a step, and the energy may not show this error. Steps near a small
det M are therefore repeated with much smaller steps, and the results are compared.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Sequence
from contextvars import ContextVar
from functools import lru_cache
from typing import Any

import mpmath
import numpy as np

from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import SymsimpsonError
from symsimpson.graph.evaluate import evaluate_nodes
from symsimpson.graph.nodes import Value
from symsimpson.program.evaluation import evaluate
from symsimpson.program.program import Program
from symsimpson.reference.first_order import SystemOutputs
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import raise_if_interrupted
from symsimpson.run.requested import run as run_again
from symsimpson.run.verdict import inputs_for_repetition
from symsimpson.stepping.request import Request
from symsimpson.study.analysis.stability.kinks import has_kinks
from symsimpson.support.array_types import Floats

#: For systems with more coordinates, det M is not evaluated.
MAX_COORDINATES = 12
#: Number of states at which det M is evaluated first. The other states are skipped if its minimum
#: is at least this part of its median.
SAMPLES, SMALL = 128, 0.3
#: In a close passage det M falls below this part of its median, and doubles within a step.
CLOSE = 0.05
#: At a singular point det M falls below this part of its median. The other numbers are those of the
#: search for it: the iterations, and the displacement for differences.
ZERO, ITERATIONS, DISPLACEMENT = 1e-8, 40, 1e-6
#: Number of states at which det M is evaluated in a box. A box without singular points has a det M
#: that is larger by this factor than in a close passage.
BOX_SAMPLES, MARGIN = 2000, 1.5
#: The search for a small det M continues around this many states of the box, with this many new
#: states each, in smaller and smaller neighbourhoods: det M may be small only in a corner.
CENTRES, NEIGHBOURS, NEIGHBOURHOODS = 8, 50, (0.1, 0.02, 0.004)
#: Number of passages to examine, of steps before and after each passage, and of parts of a step.
PASSAGES, STEPS_BEFORE, STEPS_AFTER, FINER = 3, 2, 3, 16
#: Largest squared error of a resolved passage, in units of the largest step. It is also compared
#: with the squared error at a state of median det M, multiplied by this factor.
MAX_ERROR, MAX_ERROR_RATIO = 1e-3, 100.0

#: Whether the current run is a repetition to examine a passage.
_examining: ContextVar[bool] = ContextVar("_examining", default=False)


@lru_cache(maxsize=64)
def _mass_function(system: MechanicalSystem) -> tuple[Callable[..., Any] | None, tuple[int, ...]]:
    """Return a function of q, values and t for the entries of M, and the coordinates in M.

    The function is None if M is constant, depends on velocities or is indefinite, or if the system
    is too large or has constraints.
    """
    plain, n = system.plain, system.n
    if not (plain.quadratic and plain.definite):
        return None, ()
    entries: dict[tuple[Hashable, ...], Value] = {
        ("M", i, j): plain.entry(i, j) for i in range(n) for j in range(n)
    }
    names = plain.numbers(plain.q)
    symbols = frozenset().union(*(plain.graph.nodes[m].symbols for _, m in entries.values()))
    coordinates = tuple(i for i, name in enumerate(names) if name in symbols)
    if not coordinates or n > MAX_COORDINATES or system.plain.constraint_names:
        return None, ()
    return SystemOutputs(plain, entries).function(plain.q, "numpy"), coordinates


def _masses(system: MechanicalSystem, t: Floats, q: Floats, values: Sequence[float]) -> Floats:
    """Return M at N states, shape (N, n, n)."""
    function, n = _mass_function(system)[0], system.n
    assert function is not None
    with np.errstate(all="ignore"):
        entries = np.broadcast_arrays(q[:, 0], *function(*q.T, *values, t))[1:]
    return np.stack([np.asarray(x, dtype=np.float64) for x in entries], axis=1).reshape(-1, n, n)


def _determinants(
    system: MechanicalSystem, t: Floats, q: Floats, values: Sequence[float]
) -> Floats:
    """Return |det M| at N states, shape (N,)."""
    return np.abs(np.linalg.det(_masses(system, t, q, values)))


def at_pole(system: MechanicalSystem, run: Trajectory) -> tuple[str, bool]:
    """Return the place of a zero of det M near the last state, and whether M is indefinite there.

    The place is a text such as "theta=0.1", and empty if there is none. The second value is True if
    M is indefinite at an extrapolated state, and False at a singular point of the coordinates.
    """
    if _mass_function(system)[0] is None or len(run) < 2:
        return "", False
    some = np.unique(np.linspace(0, len(run) - 1, SAMPLES).astype(int))
    t, q, values = _states(run)
    sizes = _determinants(system, t[some], q[some], values)
    median = float(np.median(sizes))
    singular = sizes[-1] < CLOSE * median and _vanishes_near(system, t[-1], q[-1], values, median)
    every = run.every or 1
    next_states = [x[-1] + k * (x[-1] - x[-2]) / every for k in (1, 2) for x in (t, q)]
    masses = _masses(system, np.array(next_states[::2]), np.array(next_states[1::2]), values)
    finite = np.isfinite(masses).all()
    indefinite = finite and np.linalg.eigvalsh(masses).min() < -ZERO * abs(masses).max()
    return _name_place(system, run, -1) if singular or indefinite else "", bool(indefinite)


def unresolved_pole(
    program: Program, system: MechanicalSystem, run: Trajectory, request: Request | None = None
) -> tuple[float, str, bool] | None:
    """Find a passage of a run near a small det M that its steps do not resolve.

    The run has stored all its states. With a ``request``, the function repeats the run with all
    states. The result is the time, the place as a text, and whether the coordinates have a singular
    point near it. It is None if there is no such passage.
    """
    if _mass_function(system)[0] is None or _examining.get():
        return None
    run = run if request is None else _run_quietly(program, request)
    t, q, values = _states(run)
    stride = max(1, len(t) // SAMPLES)
    sizes = _determinants(system, t[::stride], q[::stride], values)
    if not sizes.min() < SMALL * np.median(sizes):
        return None
    sizes = sizes if stride == 1 else _determinants(system, t, q, values)
    inner = sizes[1:-1]
    least = (inner <= sizes[:-2]) & (inner <= sizes[2:])
    close = least & (inner < CLOSE * np.median(sizes))
    close &= np.maximum(sizes[:-2], sizes[2:]) > 2 * inner
    passages = np.flatnonzero(close) + 1
    ordinary = int(np.argsort(sizes)[len(sizes) // 2])
    for index in sorted(passages[np.argsort(sizes[passages])[:PASSAGES]]):
        error = _squared_error(program, system, run, int(index))
        if error > MAX_ERROR and error > MAX_ERROR_RATIO * _squared_error(
            program, system, run, ordinary
        ):
            singular = _vanishes_near(system, t[index], q[index], values, sizes[ordinary])
            return float(t[index]), _name_place(system, run, int(index)), singular
    return None


def unresolved_step(
    program: Program,
    system: MechanicalSystem,
    states: Sequence[tuple[float, Floats, Floats]],
    h: float,
    values: Floats,
    inputs: Floats,
) -> tuple[float, str, bool] | None:
    """Find a passage near a small det M in the first steps from the second of two states (t, q, p).

    The first state is the initial state of the run, at which det M is not small. The inputs have
    the same values in all steps. The result has the form of :func:`unresolved_pole`.
    """
    if _mass_function(system)[0] is None or _examining.get():
        return None
    steps, named = 1 + STEPS_AFTER, dict(zip(program.parameters, values, strict=True))
    runs = [
        _run_quietly(
            program,
            Request(
                q,
                p0=p,
                h=h * _rate(program, q, p, values),
                steps=steps,
                t0=t,
                parameters={name: named[name] for name in program.free_values()},
                inputs=inputs_for_repetition(program, inputs, 0, steps) or None,
                every=1,
            ),
        )
        for t, q, p in states
    ]
    if not all(run.success for run in runs):
        return None
    ordinary_error, error = (_squared_error(program, system, run, 1) for run in runs)
    if not (error > MAX_ERROR and error > MAX_ERROR_RATIO * ordinary_error):
        return None
    t, q, numbers = _states(runs[1])
    sizes = _determinants(system, t, q, numbers)
    index, ordinary = int(sizes.argmin()), _determinants(system, *_states(runs[0]))[0]
    singular = _vanishes_near(system, t[index], q[index], numbers, ordinary)
    return float(t[index]), _name_place(system, runs[1], index), singular


def _run_quietly(program: Program, request: Request) -> Trajectory:
    """Run without warnings, and without an examination of its passages."""
    token = _examining.set(True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return raise_if_interrupted(run_again(program, request, None, False, "return"))
    finally:
        _examining.reset(token)


def _vanishes_near(
    system: MechanicalSystem, t: float, q: Floats, values: Sequence[float], ordinary: float
) -> bool:
    """Return whether det M has a zero near q, relative to its ``ordinary`` size.

    Light bodies or sharp bends make det M small without a zero. Newton's method searches the zero
    of sqrt(det M), which is proportional to the distance from a pole.
    """
    moves = DISPLACEMENT * np.vstack([np.zeros(system.n), np.eye(system.n), -np.eye(system.n)])
    for _ in range(ITERATIONS):
        roots = np.sqrt(_determinants(system, np.full(len(moves), t), q + moves, values))
        if not np.isfinite(roots).all() or roots.min() ** 2 < ZERO * ordinary:
            return True
        slope = (roots[1 : system.n + 1] - roots[system.n + 1 :]) / (2 * DISPLACEMENT)
        if not slope.any():
            break
        q = q - roots[0] * slope / (slope @ slope)
    return False


def regular_box(
    system: MechanicalSystem, values: Sequence[float], low: Floats, high: Floats, t: float
) -> tuple[Floats, Floats] | None:
    """Return the box from ``low`` to ``high`` if it has neither singular points nor kinks.

    The box has two corners of shape (n,). The result is all of space if M is constant, and None if
    a singular point or a kink is possible. ``values`` are the values of parameters, and then of
    inputs.
    """
    coordinates = list(_mass_function(system)[1])
    if has_kinks(system):
        return None
    if not coordinates:
        return np.full(system.n, -np.inf), np.full(system.n, np.inf)
    random, width = np.random.default_rng(2), len(coordinates)

    def determinants_at(points: Floats) -> Floats:
        q = np.tile((low + high) / 2, (len(points), 1))
        q[:, coordinates] = low[coordinates] + points * (high - low)[coordinates]
        return _determinants(system, np.full(len(q), t), q, values)

    points = np.linspace(0, 1, BOX_SAMPLES)[:, None]  # in units of the box
    if width > 1:
        corners = np.indices((2,) * width).reshape(width, -1).T
        points = np.vstack([random.uniform(size=(BOX_SAMPLES, width)), corners])
    sizes = determinants_at(points)
    bound = MARGIN * CLOSE * sizes.max()
    for part in NEIGHBOURHOODS:
        centres = np.repeat(points[np.argsort(sizes)[:CENTRES]], NEIGHBOURS, axis=0)
        neighbours = centres + part * random.uniform(-1, 1, centres.shape)
        points = np.vstack([centres[::NEIGHBOURS], np.clip(neighbours, 0, 1)])
        sizes = determinants_at(points)
        if not sizes.min() > bound:  # also if det M is NaN
            return None
    return low, high


def _states(run: Trajectory) -> tuple[Floats, Floats, list[float]]:
    """Return t, q, and the values of parameters and then of inputs, in double precision."""
    inputs = np.asarray(run.input_values, dtype=np.float64)[0, 0, 0]
    values = [*map(float, run.parameter_values), *map(float, inputs)]
    return run.t.astype(np.float64), run.q.astype(np.float64), values


def _name_place(system: MechanicalSystem, run: Trajectory, index: int) -> str:
    """Return the coordinates in M at a state as text, for example "theta=0.1"."""
    names, q = run.program.coordinates, run.q[index]
    return ", ".join(f"{names[i]}={float(q[i]):.6g}" for i in _mass_function(system)[1])


def _squared_error(
    program: Program, system: MechanicalSystem, run: Trajectory, index: int
) -> float:
    """Return the squared error of the steps around a state, in units of the largest step.

    The reference is a run with steps of h / ``FINER``. M is the metric. The error is infinite if
    that run fails.
    """
    first, last = max(0, index - STEPS_BEFORE), min(run.steps, index + STEPS_AFTER)
    rate = _rate(program, run.q[first], run.p[first], run.parameter_values)
    free = {name: run.parameters[name] for name in program.free_values()}
    try:
        request = Request(
            run.q[first],
            p0=run.p[first],
            h=run.h * rate / FINER,
            steps=FINER * (last - first),
            t0=run.t[first],
            parameters=free,
            inputs=inputs_for_repetition(program, run.input_values, first, last, FINER) or None,
        )
        finer = _run_quietly(program, request)
    except KeyboardInterrupt:
        raise
    except SymsimpsonError:
        return np.inf
    if not finer.success:
        return np.inf
    angles = _find_angles(system)
    gap = _remove_turns(np.asarray(run.q[last] - finer.q[-1], dtype=np.float64), angles)
    t, q, values = _states(run)
    masses = _masses(system, t[first:last], q[first:last], values)
    steps = _remove_turns(np.diff(q[first : last + 1], axis=0), angles)
    longest = np.einsum("ki,kij,kj->k", steps, masses, steps).max()
    end = _masses(system, t[last : last + 1], q[last : last + 1], values)[0]
    return float(gap @ end @ gap / longest) if longest > 0 else 0.0


def _rate(program: Program, q: Floats, p: Floats, values: Floats) -> float:
    """Return dt/dtau at a state relative to its initial value; 1 without a time transformation."""
    if not program.header.retimed:
        return 1.0
    state = np.zeros(1), q[None], p[None]
    return float(evaluate(program, "energy", "RATE", 1, state, values).item())


def _remove_turns(moves: Floats, angles: Sequence[bool]) -> Floats:
    """Subtract whole turns from the changes of angles."""
    turn = 2 * np.pi
    return moves - np.where(angles, turn * np.round(moves / turn), 0.0)


@lru_cache(maxsize=64)
def _find_angles(system: MechanicalSystem) -> tuple[bool, ...]:
    """Return for each coordinate whether L and the forces are periodic in it, with period 2 pi."""
    plain, n = system.plain, system.n
    roots = [plain.L[1], *(m for _, m in plain.f)]
    names = plain.numbers([*plain.q, *plain.v, *plain.parameters, *plain.u, plain.t])
    random = np.random.default_rng(1)
    state = random.uniform(0.3, 1.2, 2 * n)
    rest = [*map(float, system.parameters.values()), *random.uniform(0.3, 1.2, len(plain.u) + 1)]

    def values_after_turn(coordinate: int | None) -> Floats:
        q = state.copy()
        if coordinate is not None:
            q[coordinate] += 2 * np.pi
        numbers = dict(zip(names, map(float, (*q, *rest)), strict=True))
        node_values = evaluate_nodes(plain.graph, roots, numbers, mpmath.fp)
        return np.array([node_values[m] for m in roots], dtype=np.float64)

    values = values_after_turn(None)
    return tuple(
        np.allclose(values_after_turn(i), values, rtol=1e-10, atol=1e-12) for i in range(n)
    )
