"""Energies at states of a run: whether they are real, and whether steps resolved the motion.

A passage that is resolved moves the energy while it lasts and gives it back; one that is not leaves
it at another level. So medians of blocks of states are compared with the energy at the start, in
units of the kinetic energy that the motion has for a while. Few states are enough for that; but
where the energy need not be real, each stored state is looked at. Where forces do work, or the
energy depends on the time, what these explain is no error.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program, new_program
from symsimpson.results.energies import parts_of_work, rough_parts
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.run import KeptStates, Run
from symsimpson.support.array_types import Floats, Ints, Reals
from symsimpson.text.interface import STANDING

#: So many states of a run are looked at, in blocks of which the median counts.
SAMPLES, BLOCKS = 64, 8
#: Shorter runs are not judged.
FEWEST = 16
#: No more states than these are kept to look at.
MOST_LOOKED_AT = 4096
#: The energy may stay so far from where it was, in units of the kinetic energy.
LIMIT = 0.05
#: At the end, where a block is only begun, so many states may stay so far from it.
LAST, LAST_LIMIT = 4, 0.1
#: So many steps are taken again to know the work of forces.
AGAIN = 1_000_000
#: Changes of the energy below this part of it are rounding.
ROUNDING = 1e-9
#: Digits in which energies are evaluated anew, and at most so many positions in Python.
DIGITS, MOST_BY_TEXT = 50, 10_000


def sampling_stride(program: Program, count: int) -> int:
    """Return the steps between the states to keep of a run that stores none.

    None, 0, are kept of a short one, unless its energy need not be real.
    """
    looked_at = count >= FEWEST or not program.header.real_everywhere
    return -(-count // SAMPLES) if looked_at else 0


def finer_stride(every: int, count: int) -> int:
    """Return how many steps stand between states to look at, where few are to be stored.

    It divides ``every``, so that those which are stored are among them; 1 state in so many is.
    """
    if every < 2 or count < FEWEST or count // every + 1 >= FEWEST:
        return every
    least = -(-every * (FEWEST - 1) // count)
    parts = next(k for k in range(least, every + 1) if every % k == 0)
    return every // parts if count * parts // every <= MOST_LOOKED_AT else every


def count_looked_at(last: int) -> int:
    """Return how many of so many states after the first are looked at; none of a short run."""
    return min(last, SAMPLES - 1) if last + 1 >= FEWEST else 0


def each(number: int, q: Reals, p: Reals, iterations: Ints, *rows: Reals) -> tuple[Any, ...]:
    """Leave out states that were stored to be looked at alone; iterations are added up."""
    if number == 1:
        return q, p, iterations, *rows
    last = (len(q) - 1) // number
    counts = iterations[1 : last * number + 1].reshape(last, number).sum(axis=1)
    some = slice(None, last * number + 1, number)
    counts = np.append(iterations[:1], counts)
    return q[some], p[some], counts, *(x[some] for x in rows)


class EnergySamples(NamedTuple):
    """Energies at some of the states that were kept of a run, each of shape (m,)."""

    places: Ints  #: The numbers of these states.
    total: Floats  #: If the system is retimed, this is K = g (H - E0), which does not drift.
    kinetic: Floats
    standing: NDArray[np.bool_]  #: Where dt/dtau has nearly vanished, and the energy is off.

    @property
    def first_not_real(self) -> int | None:
        """The number of the first state at which the energy is no finite number."""
        bad = np.flatnonzero(~np.isfinite(self.total))
        return int(self.places[bad[0]]) if bad.size else None


def real_energies(
    program: Program, states: tuple[Reals, Reals, Reals], values: Reals
) -> NDArray[np.bool_]:
    """Return at which states (t, q, p) the energy is a finite real number."""
    energies = evaluate(program, "energy", "ENERGY", 1, states, values)
    return np.isfinite(np.asarray(energies, dtype=np.float64))[..., 0]


def kept_states(run: Run, kept: KeptStates, steps: int, places: Ints) -> tuple[Reals, Reals, Reals]:
    """Return the times of some of the states that were kept of a run, their q and p."""
    t = run.t0 + run.h * np.minimum(places * kept.every, steps)
    return t, kept.q[places], kept.p[places]


@np.errstate(over="ignore", invalid="ignore")  # of powers that grow without bound
def sample_energies(
    program: Program, run: Run, steps: int, kept: KeptStates
) -> EnergySamples | None:
    """Evaluate the energy at states of a run that is over, after so many steps.

    At all of them if it need not be real, else at some of them, and at none of a short run.
    """
    last = len(kept.q) - 1
    few = count_looked_at(last) if program.header.real_everywhere else last
    if program.header.real_everywhere and not few:
        return None
    places = np.arange(few + 1) * last // max(few, 1)
    about = kept_states(run, kept, steps, places), run.parameters
    energies = evaluate(program, "energy", "ENERGY", 2, *about)
    total, kinetic = np.asarray(energies, dtype=np.float64).T
    standing = np.zeros(len(total), dtype=np.bool_)
    if run.header.retimed:
        rate = np.asarray(evaluate(program, "energy", "RATE", 1, *about), float)[:, 0]
        off = total - total[0]
        standing = (rate < STANDING * rate[0]) & (abs(off) > LIMIT * kinetic)
        total, kinetic = total[0] + rate * off, rate * kinetic
    return EnergySamples(places, total, kinetic, standing)


@np.errstate(over="ignore", invalid="ignore")
def find_level(
    total: Floats, kinetic: Floats, exchanged: Floats | None = None
) -> tuple[int, float] | None:
    """Find from which sample on the energy is at another level, and how far it is off.

    In units of the kinetic energy, the largest median of a block, and of what forces
    ``exchanged`` up to there. Energies after the first that is not known are not looked at. There
    may be no such level.
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
    # an energy that grows without bound must not hide itself in what it is compared with
    floor = ROUNDING * max(abs(start), median(abs(total)))
    unit = max(floor, *(median(kinetic[a:b]) for a, b in pairwise(ends)))
    moved = np.zeros(known) if exchanged is None else exchanged
    for first, behind in pairwise(ends):
        level = abs(median(total[first:behind]) - start)
        # a fall that begins with the damage makes the kinetic energy of later blocks large
        so_far = max(floor, float(kinetic[:behind].max()))
        off = level / (min(unit, so_far) + float(moved[behind - 1]))
        if off > LIMIT:
            return first, off
    end = known - LAST
    unit = max(unit, median(kinetic[end:])) + float(moved[known - 1])
    off = median(change[end:]) / unit
    return (end, off) if off > LAST_LIMIT else None


def median(values: Floats) -> float:
    """Return the median of a few numbers, in a tenth of the time that NumPy takes."""
    ordered = np.sort(values)
    half, odd = divmod(len(ordered), 2)
    return float(ordered[half] if odd else (ordered[half - 1] + ordered[half]) / 2)


@np.errstate(over="ignore", invalid="ignore")
def level_left(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates, seen: EnergySamples
) -> tuple[int, float] | None:
    """Find from which kept state on the energy is at another level, and how far it is off.

    The work that was done explains a part of it, and so does the rounding of V.
    """
    left, work, exchanged = find_level(seen.total, seen.kinetic), np.zeros(1), None
    if left is not None and not program.header.conservative:
        parts = _work(program, run, trajectory, kept, seen)
        work = parts.sum(axis=1)[seen.places]
        moved = abs(np.diff(parts, axis=0, prepend=0)).sum(axis=1).cumsum()  # went in and out
        exchanged = moved[seen.places]
        left = find_level(seen.total - work, seen.kinetic, exchanged)
    if left is not None:
        total = _unrounded(program, run, trajectory, kept, seen)
        left = find_level(total - work, seen.kinetic, exchanged)
    return None if left is None else (int(seen.places[left[0]]), left[1])


def _work(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates, seen: EnergySamples
) -> Floats:
    """Return the work of each force up to each kept state, first roughly, then exactly.

    Powers at states are enough for most motions; where they leave something, all steps between
    stored states are taken again, where the scheme has nodes. The work is NaN where it is not
    known, as at a state after a part of a stride.
    """
    stride, last = kept.every, len(kept.q) - 1
    whole = last + 1 if stride * last <= trajectory.steps else last
    t, q, p = map(
        program.numbers.result, kept_states(run, kept, trajectory.steps, np.arange(whole))
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
    parts[:whole] = rough_parts(states)
    if "work" in program.header.functions and states.steps <= AGAIN:
        rough = parts.sum(axis=1)[seen.places]
        if find_level(seen.total - rough, seen.kinetic) is not None:
            parts[:whole] = parts_of_work(states)
    elif stride > 1:  # what is done between states far apart is not known
        parts[:] = np.nan
    return parts


def _unrounded(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates, seen: EnergySamples
) -> Floats:
    """Evaluate V anew in many digits: where its terms cancel, a small motion is below rounding.

    At x = 1e-8, g (1 - cos x) is zero in doubles, and the energy seems to come and go.
    """
    tools, system, values = program.tools, program.declared, trajectory.parameter_values
    if run.W.dtype != np.float64 or run.header.retimed:
        return seen.total
    states = kept_states(run, kept, trajectory.steps, seen.places)
    if tools is None or system is None:
        changes = _changes_by_text(program, states, values)
    else:
        changes = tools.changes_of_potential(system, *states[:2], values.tolist())
        if changes is not None:
            changes += seen.kinetic - seen.kinetic[0]
    if changes is None:
        return seen.total
    total = seen.total[0] + changes
    return np.where(np.isfinite(total), total, seen.total)


def _changes_by_text(
    program: Program, states: tuple[Reals, Reals, Reals], values: Reals
) -> Floats | None:
    """Return energies relative to the first, in many digits; None if Python would take long."""
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
