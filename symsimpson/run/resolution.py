"""Judgement of a run by its energy: whether it was real, and whether steps resolved the motion.

A passage that is resolved moves the energy while it lasts and gives it back; one that is not leaves
it at another level. So medians of blocks of states are held against the energy at the start, in
units of the kinetic energy that the motion has for a while. Few states are enough for that; but
where the energy need not be real, each stored state is looked at. Where forces do work, or the
energy depends on the time, what these explain is no error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.module.interface import STANDING
from symsimpson.program.evaluating import evaluate, evaluate_in
from symsimpson.program.program import Program, new_program
from symsimpson.results.energies import parts_of_work, rough_parts
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.kept import KeptStates
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, Ints, Reals

__all__ = [
    "Sampled",
    "check_forces",
    "check_start",
    "count_looked_at",
    "each",
    "energies_at",
    "finer_stride",
    "has_energy",
    "look_at_energy",
    "sampling_stride",
]

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


def each(number: int, q: Reals, p: Reals, iterations: Ints, *rows: Reals) -> tuple[Any, ...]:
    """Leave out states that were stored to be looked at alone; iterations are added up."""
    if number == 1:
        return q, p, iterations, *rows
    last = (len(q) - 1) // number
    counts = iterations[1 : last * number + 1].reshape(last, number).sum(axis=1)
    some = slice(None, last * number + 1, number)
    counts = np.append(iterations[:1], counts)
    return q[some], p[some], counts, *(x[some] for x in rows)


@dataclass(frozen=True)
class Sampled:
    """Energies at some states of a run: total and kinetic, shape (m,), and which states.

    ``work`` is what was done up to there; NaN behind a step of which that is not known.
    ``exchanged`` is how much went in and out meanwhile, of which a part may be in error.
    ``standing`` tells where a rate dt/dtau has nearly vanished, and the energy is off.
    """

    total: Floats
    kinetic: Floats
    places: Ints
    work: Floats
    exchanged: Floats
    standing: NDArray[np.bool_]

    def at(self, chosen: NDArray[np.bool_]) -> Sampled:
        """Return those at some of the states."""
        return Sampled(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def with_work(self, parts: Floats) -> Sampled:
        """Return them with the work that each force did up to each stored state, shape (states, f).

        Exactly, or what is known of it: then nothing is said of what went in and out.
        """
        return replace(self, work=parts.sum(axis=1)[self.places])

    @property
    def first_not_real(self) -> int | None:
        """The place of the first state at which the energy is no finite number."""
        bad = np.flatnonzero(~np.isfinite(self.total))
        return int(self.places[bad[0]]) if bad.size else None

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # what grows without bound has no finite work
    def left_at(self) -> tuple[int, float] | None:
        """Where a level of the energy begins that is another one, and how far it is off.

        In units of the kinetic energy, the largest median of a block, and of what forces exchanged;
        None if there is no such level.
        """
        total = self.total - self.work
        known = int(np.argmin(np.append(np.isfinite(total), False)))
        if known < FEWEST:
            return None
        total, kinetic = total[:known], self.kinetic[:known]
        start, change = total[0], abs(total - total[0])
        size, more = divmod(known, BLOCKS)
        ends = [k * size + min(k, more) for k in range(BLOCKS + 1)]
        # an energy that grows without bound must not hide itself in what it is compared with
        floor = ROUNDING * max(abs(start), median(abs(total)))
        unit = max(floor, *(median(kinetic[a:b]) for a, b in pairwise(ends)))
        moved = self.exchanged
        for first, behind in pairwise(ends):
            level = abs(median(total[first:behind]) - start)
            # a fall that begins with the damage makes the kinetic energy of later blocks large
            so_far = max(floor, float(kinetic[:behind].max()))
            off = level / (min(unit, so_far) + float(moved[behind - 1]))
            if off > LIMIT:
                return int(self.places[first]), off
        end = known - LAST
        unit = max(unit, median(kinetic[end:])) + float(moved[known - 1])
        off = median(change[end:]) / unit
        return (int(self.places[end]), off) if off > LAST_LIMIT else None


def median(values: Floats) -> float:
    """Return the median of a few numbers, in a tenth of the time that NumPy takes."""
    ordered = np.sort(values)
    half, odd = divmod(len(ordered), 2)
    return float(ordered[half] if odd else (ordered[half - 1] + ordered[half]) / 2)


def energies_at(program: Program, run: Run, steps: int, kept: KeptStates, places: Ints) -> Sampled:
    """Evaluate the energy at some states in the workspace of a run that is over."""
    t = run.t0 + run.h * np.minimum(places * kept.every, steps)
    states = t, kept.q[places], kept.p[places]
    energies = evaluate_in(run.W, program, "energy", "ENERGY", 2, states)
    total, kinetic = np.asarray(energies, dtype=np.float64).T
    standing = np.zeros(len(total), dtype=np.bool_)
    if run.header.retimed:  # K = g (H - E0) is what does not drift
        rate = np.asarray(evaluate_in(run.W, program, "energy", "RATE", 1, states), float)[:, 0]
        off = total - total[0]
        standing = (rate < STANDING * rate[0]) & (abs(off) > LIMIT * kinetic)
        total, kinetic = total[0] + rate * off, rate * kinetic
    nothing = np.zeros(len(total))
    return Sampled(total, kinetic, places, nothing, nothing, standing)


def has_energy(program: Program, t: Reals, q: Reals, p: Reals, values: Reals) -> bool:
    """Return whether the energy is a finite real number at all of some states."""
    energies = evaluate(program, "energy", "ENERGY", 1, (t, q, p), values)
    return bool(np.isfinite(np.asarray(energies, dtype=np.float64)).all())


def check_start(program: Program, t: Any, q: Reals, p: Reals, values: Reals) -> None:
    """Refuse a state at which the energy is not a finite real number; raises InputError."""
    times = np.full(1, t, dtype=q.dtype)
    if not has_energy(program, times, q[None], p[None], values):
        raise InputError(
            f"{program.system}: the energy is not a finite real number at q0 = "
            f"({', '.join(f'{float(x):g}' for x in q)}): T or V has no value there "
            "(the logarithm or the root of a negative number, a root of zero, or a division by "
            "zero, for example).\n"
            "Start from a state at which both are defined, or check the formulas."
        )


def check_forces(program: Program, spec: RunSpec) -> None:
    """Refuse a start at which a force has no value, behind a first step that has none.

    Raises InputError.
    """
    tools, system = program.tools, program.declared
    if tools is None or system is None:
        return
    values = [*map(float, spec.parameters), *map(float, spec.inputs[0, 0, 0])]
    q = list(map(float, spec.q0))
    terms = tools.force_terms(system, q, values, float(spec.t0))
    bad = np.flatnonzero(~np.isfinite(terms))
    if bad.size:
        name = program.coordinates[bad[0]]
        raise InputError(
            f"{program.system}: the force on {name} has no finite value at q0 = "
            f"({', '.join(f'{x:g}' for x in q)}), though T and V have.\nA derivative of a root at "
            "zero or a quotient 0/0 makes it so. Start beside it, or write V and forces in a form "
            "that is smooth there."
        )
    v = spec.other0
    if not spec.velocities:
        start = np.array([spec.t0]), spec.q0[None], spec.other0[None]
        v = evaluate(program, "energy", "VELOCITY", program.n, start, spec.parameters)[0]
    bad = np.flatnonzero(~np.isfinite(tools.force_terms(system, q, values, float(spec.t0), v)))
    if bad.size:
        raise InputError(
            f"{program.system}: the force on {program.coordinates[bad[0]]} has a value at the "
            f"velocities of the start, ({', '.join(f'{x:g}' for x in v.tolist())}), but no slope.\n"
            "A root that is 0 makes it so, as sqrt(v) at v = 0. Begin with another velocity, or "
            "write a force that is smooth there, as sqrt(v**2 + eps**2) with a small eps."
        )


def count_looked_at(last: int) -> int:
    """Return how many of so many states behind the first are looked at; none of a short run."""
    return min(last, SAMPLES - 1) if last + 1 >= FEWEST else 0


@np.errstate(over="ignore", invalid="ignore")  # of powers that grow without bound
def look_at_energy(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates
) -> Sampled | None:
    """Evaluate the energy at states of a run that is over, and came to a trajectory.

    At all of them if it need not be real, else at some of them, and at none of a short run.
    """
    last, steps = len(kept.q) - 1, trajectory.steps
    if not program.header.real_everywhere:
        energies = energies_at(program, run, steps, kept, np.arange(last + 1))
        return _explained(energies, program, run, trajectory, kept)
    few = count_looked_at(last)
    if not few:
        return None
    if kept.q.base is not None and kept.q.base is run.q.base:
        steady = program.numbers.driver("steady")
        energy, header = program.kernels.address("energy"), run.header
        rate = header.layout["RATE"] if header.retimed else 0
        setting = run.h, run.t0, run.W, header.driver_layout
        if steady(energy, setting, (run.q, run.p), (last, few, LIMIT), rate):
            return None
    places = np.arange(few + 1) * last // few
    energies = energies_at(program, run, steps, kept, places)
    return _explained(energies, program, run, trajectory, kept)


def _explained(
    seen: Sampled, program: Program, run: Run, trajectory: Trajectory, kept: KeptStates
) -> Sampled:
    """Take out of energies that change the work that was done, and what is rounding of V."""
    if seen.left_at is None or not trajectory.success:
        return seen
    if not program.header.conservative:
        seen = _without_work(seen, program, run, trajectory, kept)
    return seen if seen.left_at is None else _unrounded(seen, program, run, trajectory, kept)


def _without_work(
    seen: Sampled, program: Program, run: Run, trajectory: Trajectory, kept: KeptStates
) -> Sampled:
    """Take out the work that was done, first roughly, then exactly.

    Powers at states are enough for most motions; where they leave something, all steps between
    stored states are taken again, where the scheme has nodes.
    """
    q, p, *_, stride = kept
    whole = len(q) if stride * (len(q) - 1) <= trajectory.steps else len(q) - 1
    every = np.arange(whole) * stride
    result, t = program.numbers.result, run.t0 + run.h * every
    states = replace(
        trajectory,
        t=result(t),
        q=result(q[:whole]),
        p=result(p[:whole]),
        every=stride,
        steps=int(every[-1]),
        newton_iterations=np.zeros(whole, dtype=np.int64),
        variations=None,
        recorded_values=(),
    )
    seen = seen.at(seen.places < whole)
    parts = rough_parts(states)
    if "work" in program.header.functions and states.steps <= AGAIN:
        if seen.with_work(parts).left_at is not None:
            parts = parts_of_work(states)
    elif stride > 1:  # what is done between states far apart is not known
        parts = np.nan * parts
    moved = abs(np.diff(parts, axis=0, prepend=0)).sum(axis=1).cumsum()  # went in and out
    return replace(seen.with_work(parts), exchanged=moved[seen.places])


def _unrounded(
    seen: Sampled, program: Program, run: Run, trajectory: Trajectory, kept: KeptStates
) -> Sampled:
    """Evaluate V anew in many digits: where its terms cancel, a small motion is below rounding.

    At x = 1e-8, g (1 - cos x) is zero in doubles, and the energy seems to come and go.
    """
    tools, system, values = program.tools, program.declared, trajectory.parameter_values
    if run.W.dtype != np.float64 or run.header.retimed:
        return seen
    t = run.t0 + run.h * np.minimum(seen.places * kept.every, trajectory.steps)
    q, p = kept.q[seen.places], kept.p[seen.places]
    if tools is None or system is None:
        changes = _changes_by_text(program, (t, q, p), values)
    else:
        changes = tools.changes_of_potential(system, t, q, values.tolist())
        if changes is not None:
            changes += seen.kinetic - seen.kinetic[0]
    if changes is None:
        return seen
    total = seen.total[0] + changes
    return replace(seen, total=np.where(np.isfinite(total), total, seen.total))


def _changes_by_text(
    program: Program, states: tuple[Reals, Reals, Reals], values: Reals
) -> Floats | None:
    """Return the energy at states less that at the first, by a module's text in many digits.

    None where Python would take long.
    """
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
