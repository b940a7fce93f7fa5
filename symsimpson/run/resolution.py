"""Energy checks of a run: whether energies are real, and whether steps resolved the motion.

A fast passage that the steps resolve changes the energy only while it lasts. A passage that they do
not resolve shifts the energy permanently. The check therefore compares medians of blocks of states
with the initial energy, in units of the kinetic energy. A few states are enough. If the energy may
become complex, the check uses each stored state. It subtracts the work of forces, and the change of
the energy by an explicit time dependence.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from symsimpson.program.evaluation import evaluate
from symsimpson.program.program import Program, new_program
from symsimpson.results.energies import approximate_work, exact_work
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.run import Run, StoredStates
from symsimpson.support.array_types import Floats, Ints, Reals
from symsimpson.text.interface import STANDING

#: Number of states that the check uses, and number of blocks with a median each.
SAMPLES, BLOCKS = 64, 8
#: Smallest number of states that can be judged.
FEWEST = 16
#: Largest number of states that are stored only for the check.
MOST_SAMPLES = 4096
#: Largest accepted shift of the energy, in units of the kinetic energy.
LIMIT = 0.05
#: Number of states at the end that count as a block of their own, and their limit.
LAST, LAST_LIMIT = 4, 0.1
#: Largest number of steps that the check repeats to compute the work of forces.
MOST_REPEATED_STEPS = 1_000_000
#: Relative changes of the energy below this are round-off.
ROUNDING = 1e-9
#: Digits of the multiprecision energies, and the largest number of coordinates in Python.
DIGITS, MOST_BY_TEXT = 50, 10_000


def sampling_stride(program: Program, count: int) -> int:
    """Return the number of steps between sampled states of a run that stores none.

    It is 0 (no samples) for a short run whose energy is always real.
    """
    looked_at = count >= FEWEST or not program.header.real_everywhere
    return -(-count // SAMPLES) if looked_at else 0


def finer_stride(every: int, count: int) -> int:
    """Return a smaller stride than ``every`` if a run would store too few states for the check.

    It divides ``every``, so the samples include the states to store.
    """
    if every < 2 or count < FEWEST or count // every + 1 >= FEWEST:
        return every
    least = -(-every * (FEWEST - 1) // count)
    parts = next(k for k in range(least, every + 1) if every % k == 0)
    return every // parts if count * parts // every <= MOST_SAMPLES else every


def count_samples(last: int) -> int:
    """Return how many of ``last`` states after the first the check uses; 0 for a short run."""
    return min(last, SAMPLES - 1) if last + 1 >= FEWEST else 0


def thin_states(number: int, q: Reals, p: Reals, iterations: Ints, *rows: Reals) -> tuple[Any, ...]:
    """Select each ``number``-th state; sum the iterations between the selected states."""
    if number == 1:
        return q, p, iterations, *rows
    last = (len(q) - 1) // number
    counts = iterations[1 : last * number + 1].reshape(last, number).sum(axis=1)
    some = slice(None, last * number + 1, number)
    counts = np.append(iterations[:1], counts)
    return q[some], p[some], counts, *(x[some] for x in rows)


class EnergySamples(NamedTuple):
    """Energies at m of the stored states of a run, each of shape (m,)."""

    places: Ints  #: Indices of these states.
    total: Floats  #: Energy; for a retimed system K = g (H - E0) plus a constant.
    kinetic: Floats  #: Kinetic energy; for a retimed system g T.
    standing: NDArray[np.bool_]  #: Whether dt/dtau nearly vanishes and the energy has an error.

    @property
    def first_not_real(self) -> int | None:
        """Index of the first stored state whose energy is not finite, or None."""
        bad = np.flatnonzero(~np.isfinite(self.total))
        return int(self.places[bad[0]]) if bad.size else None


def real_energies(
    program: Program, states: tuple[Reals, Reals, Reals], values: Reals
) -> NDArray[np.bool_]:
    """Return for each state (t, q, p) whether its energy is a finite real number."""
    energies = evaluate(program, "energy", "ENERGY", 1, states, values)
    return np.isfinite(np.asarray(energies, dtype=np.float64))[..., 0]


def select_states(
    run: Run, stored: StoredStates, steps: int, places: Ints
) -> tuple[Reals, Reals, Reals]:
    """Return t, q and p of the stored states with indices ``places``."""
    t = run.t0 + run.h * np.minimum(places * stored.every, steps)
    return t, stored.q[places], stored.p[places]


@np.errstate(over="ignore", invalid="ignore")  # of powers that grow without bound
def sample_energies(
    program: Program, run: Run, steps: int, stored: StoredStates
) -> EnergySamples | None:
    """Evaluate the energy at stored states of a finished run of ``steps`` steps.

    Use all states if the energy may become complex, else a sample. Return None for a short run.
    """
    last = len(stored.q) - 1
    few = count_samples(last) if program.header.real_everywhere else last
    if program.header.real_everywhere and not few:
        return None
    places = np.arange(few + 1) * last // max(few, 1)
    about = select_states(run, stored, steps, places), run.parameters
    energies = evaluate(program, "energy", "ENERGY", 2, *about)
    total, kinetic = np.asarray(energies, dtype=np.float64).T
    if program.header.indefinite or program.header.general:  # v.M.v may vanish or be negative
        velocities = np.asarray(evaluate(program, "energy", "VELOCITY", program.n, *about), float)
        kinetic = abs(np.asarray(about[0][2], float) * velocities).sum(axis=1) / 2
    standing = np.zeros(len(total), dtype=np.bool_)
    if run.header.retimed:
        rate = np.asarray(evaluate(program, "energy", "RATE", 1, *about), float)[:, 0]
        off = total - total[0]
        standing = (rate < STANDING * rate[0]) & (abs(off) > LIMIT * kinetic)
        total, kinetic = total[0] + rate * off, rate * kinetic
    return EnergySamples(places, total, kinetic, standing)


@np.errstate(over="ignore", invalid="ignore")
def find_energy_shift(
    total: Floats, kinetic: Floats, exchanged: Floats | None = None
) -> tuple[int, float] | None:
    """Find the first sample after which the energy is shifted; return its index and the shift.

    The unit of the shift is the largest median of the kinetic energy in a block, plus the energy
    that forces have ``exchanged`` so far. The search stops at the first energy that is not finite.
    Return None if there is no shift.
    """
    known = int(np.argmin(np.append(np.isfinite(total), False)))
    if known < FEWEST:
        return None
    total, kinetic = total[:known], kinetic[:known]
    start, change = total[0], abs(total - total[0])
    if change.max() <= LIMIT * min(median(kinetic), kinetic[: known // BLOCKS].max()):
        return None
    size, more = divmod(known, BLOCKS)
    ends = [k * size + min(k, more) for k in range(BLOCKS + 1)]
    # an energy that grows without bound must not increase its own unit of comparison
    floor = ROUNDING * max(abs(start), median(abs(total)))
    unit = max(floor, *(median(kinetic[a:b]) for a, b in pairwise(ends)))
    exchange = np.zeros(known) if exchanged is None else exchanged
    for first, end_of_block in pairwise(ends):
        level = abs(median(total[first:end_of_block]) - start)
        # after a wrong passage the kinetic energy of later blocks may be too large
        so_far = max(floor, float(kinetic[:end_of_block].max()))
        off = level / (min(unit, so_far) + float(exchange[end_of_block - 1]))
        if off > LIMIT:
            return first, off
    end = known - LAST
    unit = max(unit, median(kinetic[end:])) + float(exchange[known - 1])
    off = median(change[end:]) / unit
    return (end, off) if off > LAST_LIMIT else None


def median(values: Floats) -> float:
    """Return the median of a few numbers, 10 times faster than NumPy."""
    ordered = np.sort(values)
    half, odd = divmod(len(ordered), 2)
    return float(ordered[half] if odd else (ordered[half - 1] + ordered[half]) / 2)


@np.errstate(over="ignore", invalid="ignore")
def find_unexplained_shift(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates, samples: EnergySamples
) -> tuple[int, float] | None:
    """Find the first stored state after which the energy is shifted; return index and shift.

    The work of forces and the round-off of V are not counted as a shift. Return None without one.
    """
    shift, work, exchanged = find_energy_shift(samples.total, samples.kinetic), np.zeros(1), None
    if shift is not None and not program.header.conservative:
        parts = _compute_work(program, run, trajectory, stored, samples)
        work = parts.sum(axis=1)[samples.places]
        # the energy that forces took and gave: both count
        exchange = abs(np.diff(parts, axis=0, prepend=0)).sum(axis=1).cumsum()
        exchanged = exchange[samples.places]
        shift = find_energy_shift(samples.total - work, samples.kinetic, exchanged)
    if shift is not None:
        total = _evaluate_precisely(program, run, trajectory, stored, samples)
        shift = find_energy_shift(total - work, samples.kinetic, exchanged)
    return None if shift is None else (int(samples.places[shift[0]]), shift[1])


def _compute_work(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates, samples: EnergySamples
) -> Floats:
    """Return the work of each force up to each stored state, shape (N, f).

    First integrate the powers at the stored states. If that does not explain a shift of the energy,
    repeat all steps to compute the work exactly; this needs a scheme with nodes. Unknown work is
    NaN, for example at a final state after a shorter interval.
    """
    stride, last = stored.every, len(stored.q) - 1
    whole = last + 1 if stride * last <= trajectory.steps else last
    t, q, p = map(
        program.numbers.result, select_states(run, stored, trajectory.steps, np.arange(whole))
    )
    states = replace(
        trajectory,
        t=t,
        q=q,
        p=p,
        every=stride,
        steps=(whole - 1) * stride,
        newton_iterations=np.zeros(whole, dtype=np.int64),
        variations=None,
        recorded_values=(),
    )
    parts = np.full((last + 1, program.header.powers), np.nan)
    parts[:whole] = approximate_work(states)
    if "work" in program.header.functions and states.steps <= MOST_REPEATED_STEPS:
        rough = parts.sum(axis=1)[samples.places]
        if find_energy_shift(samples.total - rough, samples.kinetic) is not None:
            parts[:whole] = exact_work(states)
    elif stride > 1:  # the powers at distant states do not determine the work between them
        parts[:] = np.nan
    return parts


def _evaluate_precisely(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates, samples: EnergySamples
) -> Floats:
    """Evaluate the energy in multiprecision, because V has a large round-off if its terms cancel.

    Example: at x = 1e-8, g (1 - cos x) is zero in double precision, so the energy seems to vary.
    """
    tools, system, values = program.tools, program.declared, trajectory.parameter_values
    if run.W.dtype != np.float64 or run.header.retimed:
        return samples.total
    states = select_states(run, stored, trajectory.steps, samples.places)
    if tools is None or system is None or program.header.general:
        changes = _energies_in_python(program, states, values)
    else:
        changes = tools.changes_of_potential(system, *states[:2], values.tolist())
        if changes is not None:
            changes += samples.kinetic - samples.kinetic[0]
    if changes is None:
        return samples.total
    total = samples.total[0] + changes
    return np.where(np.isfinite(total), total, samples.total)


def _energies_in_python(
    program: Program, states: tuple[Reals, Reals, Reals], values: Reals
) -> Floats | None:
    """Return multiprecision energies relative to the first; None if Python would be too slow."""
    from symsimpson.program.digits import read_precision  # loads mpmath

    if states[1].size > MOST_BY_TEXT:
        return None
    precise = new_program(
        program.source,
        program.system,
        numbers=read_precision(DIGITS, "mpmath"),
        names=program.names,
    )
    energies = evaluate(precise, "energy", "ENERGY", 1, states, values)[:, 0]
    return (energies - energies[0]).astype(np.float64)
