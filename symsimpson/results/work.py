"""The work of forces along a run, and what the energy differs by from it."""

from __future__ import annotations

import numpy as np

from symsimpson.errors import InputError
from symsimpson.program.evaluating import evaluate
from symsimpson.program.program import Program
from symsimpson.program.recorders import driver_layout, work
from symsimpson.program.workspace import workspace
from symsimpson.results.stored import Stored
from symsimpson.stepping.driving import inputs_there, since
from symsimpson.stepping.run import FALLBACK_STRETCH
from symsimpson.support.array_types import Reals

__all__ = ["TOTAL", "WORK", "integrals", "named_parts", "parts_of_work", "powers", "rough_parts"]

#: The name of the sum of all forces, and of what a run may record.
TOTAL, WORK = "total", "work"
#: The name of what velocity constraints that move do.
CONSTRAINTS = "constraints"


def powers(run: Stored) -> dict[str, Reals]:
    """Return the power of each force at the stored states, and of all."""
    header = run.program.header
    if header.conservative:
        return {TOTAL: 0 * run.t}
    return named_parts(run.program, _powers_at(run))


def _powers_at(run: Stored, *, arriving: bool = False) -> Reals:
    """Evaluate the power of each force, then dL/dt where something depends on t.

    With the inputs of the step that begins at a state, or of the one that arrives there.
    """
    program, states, values = run.program, (run.t, run.q, run.p), run.parameter_values
    inputs = inputs_there(program, run.driven, run.t, arriving=arriving)
    return evaluate(program, "power", "POWER", program.header.powers, states, values, inputs)


def named_parts(program: Program, parts: Reals) -> dict[str, Reals]:
    """Name the columns of forces, and add them up."""
    names = [*program.names.forces.shown, *([CONSTRAINTS] if program.header.carried else [])]
    by_force = {name: parts[..., k] for k, name in enumerate(names)}
    return by_force | {TOTAL: sum(by_force.values(), np.zeros(parts.shape[:-1], dtype=parts.dtype))}


def integrals(run: Stored) -> tuple[dict[str, Reals], Reals]:
    """Return the work of each force and of all, and the integral of dL/dt, up to stored states.

    Each step is taken again: work is the integral h sum_i b_i f_i.v_i of the scheme, of its order.
    Behind a step that cannot be taken again they are NaN. Raises InputError if only the last state
    is stored, or the scheme is explicit.
    """
    program, header = run.program, run.program.header
    if header.conservative:
        return {TOTAL: 0 * run.t}, 0 * run.t
    if run.records and WORK not in run.recorded:
        raise InputError(
            "the work of a run in which events acted is not known: its steps are not taken again "
            "with their parts.\nRecord it: record='work'."
        )
    if run.every is None and WORK not in run.recorded:
        raise InputError(
            "a run that keeps its last state alone (every=None) does not tell what work was done."
            "\nRecord it: record='work'; or store states on the way: every=1, or every=100."
        )
    work(header)  # refuses explicit steps
    parts = _integrated(run)
    lost = 0 * run.t if header.autonomous else parts[:, -1]
    return named_parts(program, parts), lost


def rough_parts(run: Stored) -> Reals:
    """Integrate the powers at stored states by the trapezoidal rule: of forces, then of -dL/dt."""
    begins = _powers_at(run)
    ends = _powers_at(run, arriving=True) if run.input_values.size else begins
    spans = np.diff(np.asarray(run.t, dtype=np.float64))[:, None]
    means = np.asarray(begins[:-1] + ends[1:], dtype=np.float64) / 2
    return _signed(run, np.concatenate([0 * means[:1], (spans * means).cumsum(axis=0)]))


def parts_of_work(run: Stored) -> Reals:
    """Return what each force did up to stored states, then the integral of -dL/dt."""
    return _signed(run, np.asarray(_integrated(run), dtype=np.float64))


def _signed(run: Stored, parts: Reals) -> Reals:
    """Give dL/dt, the last of powers, the sign by which H follows it."""
    if not run.program.header.autonomous:
        parts[:, -1] *= -1
    return parts


def _integrated(run: Stored) -> Reals:
    """Return the integrals of powers up to stored states, by steps taken again unless recorded."""
    if WORK in run.recorded:
        return run.recorded[WORK]
    numbers, header = run.program.numbers, run.program.header
    with numbers.working():
        return np.asarray(numbers.result(_added_up(run, header.powers)))


def _added_up(run: Stored, count: int) -> Reals:
    """Take steps again, and add up so many integrals; NaN behind one that cannot be taken so.

    Steps that the run took with more robust kernels are taken with these.
    """
    program, every = run.program, run.every
    assert every is not None
    numbers, header, kernels = program.numbers, program.header, program.kernels
    W = workspace(header, numbers, numbers.read(run.parameter_values))
    t, q, p, h = map(numbers.read, (run.t, run.q, run.p, run.h))
    out, inputs = numbers.zeros((len(run), count)), numbers.read(run.input_values)
    recorder, sets = work(header), kernels.fallbacks
    assert recorder is not None
    at = driver_layout(header, (recorder,))
    done, number = 0, 0
    while done < len(run) - 1:
        last = len(run) if number == 0 else min(len(run), done + 1 + FALLBACK_STRETCH)
        some = slice(done, last)
        reached: int = numbers.driver("replay")(
            kernels.set(sets[number], (recorder,), again=True),
            (h.item(), t[some], W, at),
            (q[some], p[some]),
            every,
            False,
            out[some],
            since(inputs, done * every),
        )
        if reached > 1:
            done, number = done + reached - 1, int(done + reached < last)
        else:
            number += 1
        if number == len(sets):
            out[done + 1 :] = numbers.read(np.nan)
            break
    return out
