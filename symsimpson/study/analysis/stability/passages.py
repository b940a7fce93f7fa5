"""Passages near singular points of the coordinates: whether the steps of a run resolved them.

At a pole, as that of spherical angles, det M vanishes. A motion that passes it closely turns there
within a time that may be a small part of a step, and its energy need not show that. So steps near
a small det M are taken again, much finer.
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
from symsimpson.graph.evaluate import evaluated
from symsimpson.graph.nodes import Value
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.reference.first_order import Lines
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import uninterrupted
from symsimpson.run.requested import run as run_again
from symsimpson.run.verdict import inputs_again
from symsimpson.stepping.request import Request
from symsimpson.study.analysis.stability.kinks import has_kinks
from symsimpson.support.array_types import Floats

#: In larger systems det M is not looked at.
MOST_COORDINATES = 12
#: First so many states are looked at: where det M is nowhere small, no others are.
SAMPLES, LITTLE = 128, 0.3
#: A passage is close where det M falls below this part of its median, and doubles within a step.
CLOSE = 0.05
#: At a singular point det M falls below this part of its median; it is sought in so many
#: iterations, with differences of this size.
VANISHES, ITERATIONS, DIFFERENCE = 1e-8, 40, 1e-6
#: So many states of a box are looked at to tell that there is no pole in it: det M is larger there
#: than where a passage is close, by so much.
IN_BOX, LARGER = 2000, 1.5
#: Around so many of them, where det M is least, so many others are looked at, again and again in
#: boxes so much smaller: it may vanish in a corner alone.
LEAST, AROUND, SMALLER = 8, 50, (0.1, 0.02, 0.004)
#: So many passages are looked at, from so many steps before to so many behind, each so much finer.
PASSAGES, BEFORE, BEHIND, FINER = 3, 2, 3, 16
#: The ends may be so far apart, squared, in units of what a step moves; and so many times as far
#: as where det M is ordinary.
APART, ORDINARY = 1e-3, 100.0

#: Whether steps are taken again to look at a passage.
_looking: ContextVar[bool] = ContextVar("_looking", default=False)


@lru_cache(maxsize=64)
def _mass(system: MechanicalSystem) -> tuple[Callable[..., Any] | None, tuple[int, ...]]:
    """Return a function of q, values and t for the entries of M, and what M depends on."""
    plain, n = system.plain, system.n
    entries: dict[tuple[Hashable, ...], Value] = {
        ("M", i, j): plain.entry(i, j) for i in range(n) for j in range(n)
    }
    names = plain.numbers(plain.q)
    inside = frozenset().union(*(plain.graph.nodes[m].symbols for _, m in entries.values()))
    depends = tuple(i for i, name in enumerate(names) if name in inside)
    if not depends or n > MOST_COORDINATES or system.plain.held:
        return None, ()
    return Lines(plain, entries).function(plain.q, "numpy"), depends


def _masses(system: MechanicalSystem, t: Floats, q: Floats, values: Sequence[float]) -> Floats:
    """Return M at states, shape (N, n, n)."""
    function, n = _mass(system)[0], system.n
    assert function is not None
    with np.errstate(all="ignore"):
        entries = np.broadcast_arrays(q[:, 0], *function(*q.T, *values, t))[1:]
    return np.stack([np.asarray(x, dtype=np.float64) for x in entries], axis=1).reshape(-1, n, n)


def _sizes(system: MechanicalSystem, t: Floats, q: Floats, values: Sequence[float]) -> Floats:
    return np.abs(np.linalg.det(_masses(system, t, q, values)))


def at_pole(system: MechanicalSystem, run: Trajectory) -> tuple[str, bool]:
    """Return where det M vanishes near the last state of a run, or "", and if M is indefinite then.

    If it is not, this is a singular point of the coordinates.
    """
    if _mass(system)[0] is None or len(run) < 2:
        return "", False
    some = np.unique(np.linspace(0, len(run) - 1, SAMPLES).astype(int))
    t, q, values = _states(run)
    sizes = _sizes(system, t[some], q[some], values)
    usual = float(np.median(sizes))
    at = sizes[-1] < CLOSE * usual and _vanishes_near(system, t[-1], q[-1], values, usual)
    every = run.every or 1
    ahead = [x[-1] + k * (x[-1] - x[-2]) / every for k in (1, 2) for x in (t, q)]
    masses = _masses(system, np.array(ahead[::2]), np.array(ahead[1::2]), values)
    known = np.isfinite(masses).all()
    lost = known and np.linalg.eigvalsh(masses).min() < -VANISHES * abs(masses).max()
    return _named(system, run, -1) if at or lost else "", bool(lost)


def unresolved_pole(
    program: Program, system: MechanicalSystem, run: Trajectory, asked: Request | None = None
) -> tuple[float, str, bool] | None:
    """Return when a run passed a small det M unresolved, where, and if it vanishes near there.

    The run has stored all its states, or its steps are taken again as ``asked``. The place is a
    text. The last value is whether the coordinates have a singular point there. The function
    returns None if it finds no such passage.
    """
    if _mass(system)[0] is None or _looking.get():
        return None
    run = run if asked is None else _run_quietly(program, asked)
    t, q, values = _states(run)
    stride = max(1, len(t) // SAMPLES)
    sizes = _sizes(system, t[::stride], q[::stride], values)
    if not sizes.min() < LITTLE * np.median(sizes):
        return None
    sizes = sizes if stride == 1 else _sizes(system, t, q, values)
    inner = sizes[1:-1]
    least = (inner <= sizes[:-2]) & (inner <= sizes[2:])
    close = least & (inner < CLOSE * np.median(sizes))
    close &= np.maximum(sizes[:-2], sizes[2:]) > 2 * inner
    places = np.flatnonzero(close) + 1
    plain = int(np.argsort(sizes)[len(sizes) // 2])
    for place in sorted(places[np.argsort(sizes[places])[:PASSAGES]]):
        apart = _apart(program, system, run, int(place))
        if apart > APART and apart > ORDINARY * _apart(program, system, run, plain):
            singular = _vanishes_near(system, t[place], q[place], values, sizes[plain])
            return float(t[place]), _named(system, run, int(place)), singular
    return None


def unresolved_step(
    program: Program,
    system: MechanicalSystem,
    states: Sequence[tuple[float, Floats, Floats]],
    h: float,
    values: Floats,
    inputs: Floats,
) -> tuple[float, str, bool] | None:
    """Return what :func:`unresolved_pole` does, for steps that begin at the last of two states.

    The run began at the first state, where det M is ordinary. All steps have the same ``inputs``.
    """
    if _mass(system)[0] is None or _looking.get():
        return None
    steps, named = 1 + BEHIND, dict(zip(program.parameters, values, strict=True))
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
                inputs=inputs_again(program, inputs, 0, steps) or None,
                every=1,
            ),
        )
        for t, q, p in states
    ]
    if not all(run.success for run in runs):
        return None
    usual, apart = (_apart(program, system, run, 1) for run in runs)
    if not (apart > APART and apart > ORDINARY * usual):
        return None
    t, q, numbers = _states(runs[1])
    sizes = _sizes(system, t, q, numbers)
    place, ordinary = int(sizes.argmin()), _sizes(system, *_states(runs[0]))[0]
    singular = _vanishes_near(system, t[place], q[place], numbers, ordinary)
    return float(t[place]), _named(system, runs[1], place), singular


def _run_quietly(program: Program, asked: Request) -> Trajectory:
    """Run without warnings; nobody looks at the passages of this run."""
    token = _looking.set(True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return uninterrupted(run_again(program, asked, None, False, "return"))
    finally:
        _looking.reset(token)


def _vanishes_near(
    system: MechanicalSystem, t: float, q: Floats, values: Sequence[float], usual: float
) -> bool:
    """Return whether det M has a zero near q; light bodies, sharp bends make it small alone.

    Newton's method finds it, on the root of det M, which is like a distance from a pole.
    """
    moves = DIFFERENCE * np.vstack([np.zeros(system.n), np.eye(system.n), -np.eye(system.n)])
    for _ in range(ITERATIONS):
        roots = np.sqrt(_sizes(system, np.full(len(moves), t), q + moves, values))
        if not np.isfinite(roots).all() or roots.min() ** 2 < VANISHES * usual:
            return True
        slope = (roots[1 : system.n + 1] - roots[system.n + 1 :]) / (2 * DIFFERENCE)
        if not slope.any():
            break
        q = q - roots[0] * slope / (slope @ slope)
    return False


def regular_box(
    system: MechanicalSystem, values: Sequence[float], low: Floats, high: Floats, t: float
) -> tuple[Floats, Floats] | None:
    """Return a box of positions without singular points; None if there may be some, or kinks.

    It is the box from ``low`` to ``high`` that was asked about, or all of space where M is
    constant. ``values`` are those of parameters, then of inputs.
    """
    depends = list(_mass(system)[1])
    if has_kinks(system):
        return None
    if not depends:
        return np.full(system.n, -np.inf), np.full(system.n, np.inf)
    numbers, width = np.random.default_rng(2), len(depends)

    def sizes_at(places: Floats) -> Floats:
        q = np.tile((low + high) / 2, (len(places), 1))
        q[:, depends] = low[depends] + places * (high - low)[depends]
        return _sizes(system, np.full(len(q), t), q, values)

    places = np.linspace(0, 1, IN_BOX)[:, None]
    if width > 1:
        corners = np.indices((2,) * width).reshape(width, -1).T
        places = np.vstack([numbers.uniform(size=(IN_BOX, width)), corners])
    sizes = sizes_at(places)
    bound = LARGER * CLOSE * sizes.max()
    for part in SMALLER:
        near = np.repeat(places[np.argsort(sizes)[:LEAST]], AROUND, axis=0)
        moved = near + part * numbers.uniform(-1, 1, near.shape)
        places = np.vstack([near[::AROUND], np.clip(moved, 0, 1)])
        sizes = sizes_at(places)
        if not sizes.min() > bound:  # nor where it has no value
            return None
    return low, high


def _states(run: Trajectory) -> tuple[Floats, Floats, list[float]]:
    inputs = np.asarray(run.input_values, dtype=np.float64)[0, 0, 0]
    values = [*map(float, run.parameter_values), *map(float, inputs)]
    return run.t.astype(np.float64), run.q.astype(np.float64), values


def _named(system: MechanicalSystem, run: Trajectory, place: int) -> str:
    names, q = run.program.coordinates, run.q[place]
    return ", ".join(f"{names[i]}={float(q[i]):.6g}" for i in _mass(system)[1])


def _apart(program: Program, system: MechanicalSystem, run: Trajectory, place: int) -> float:
    """Return how far from a run much finer steps past a state lead, in moves of steps, squared."""
    first, last = max(0, place - BEFORE), min(run.steps, place + BEHIND)
    rate = _rate(program, run.q[first], run.p[first], run.parameter_values)
    free = {name: run.parameters[name] for name in program.free_values()}
    try:
        asked = Request(
            run.q[first],
            p0=run.p[first],
            h=run.h * rate / FINER,
            steps=FINER * (last - first),
            t0=run.t[first],
            parameters=free,
            inputs=inputs_again(program, run.input_values, first, last, FINER) or None,
        )
        finer = _run_quietly(program, asked)
    except KeyboardInterrupt:
        raise
    except SymsimpsonError:
        return np.inf
    if not finer.success:
        return np.inf
    angles = _periodic(system)
    gap = _within(np.asarray(run.q[last] - finer.q[-1], dtype=np.float64), angles)
    t, q, values = _states(run)
    masses = _masses(system, t[first:last], q[first:last], values)
    moves = _within(np.diff(q[first : last + 1], axis=0), angles)
    moved = np.einsum("ki,kij,kj->k", moves, masses, moves).max()
    end = _masses(system, t[last : last + 1], q[last : last + 1], values)[0]
    return float(gap @ end @ gap / moved) if moved > 0 else 0.0


def _rate(program: Program, q: Floats, p: Floats, values: Floats) -> float:
    """Return dt/dtau in units of that where a run begins."""
    if not program.header.retimed:
        return 1.0
    here = np.zeros(1), q[None], p[None]
    return float(evaluate(program, "energy", "RATE", 1, here, values).item())


def _within(moves: Floats, angles: Sequence[bool]) -> Floats:
    """Leave whole turns of angles out of moves."""
    turn = 2 * np.pi
    return moves - np.where(angles, turn * np.round(moves / turn), 0.0)


@lru_cache(maxsize=64)
def _periodic(system: MechanicalSystem) -> tuple[bool, ...]:
    """Return which coordinates are angles: L and forces do not change by a turn of them."""
    plain, n = system.plain, system.n
    roots = [plain.L[1], *(m for _, m in plain.f)]
    names = plain.numbers([*plain.q, *plain.v, *plain.parameters, *plain.u, plain.t])
    numbers = np.random.default_rng(1)
    state = numbers.uniform(0.3, 1.2, 2 * n)
    rest = [*map(float, system.parameters.values()), *numbers.uniform(0.3, 1.2, len(plain.u) + 1)]

    def value(turned: int | None) -> Floats:
        q = state.copy()
        if turned is not None:
            q[turned] += 2 * np.pi
        given = dict(zip(names, map(float, (*q, *rest)), strict=True))
        node_values = evaluated(plain.graph, roots, given, mpmath.fp)
        return np.array([node_values[m] for m in roots], dtype=np.float64)

    plainly = value(None)
    return tuple(np.allclose(value(i), plainly, rtol=1e-10, atol=1e-12) for i in range(n))
