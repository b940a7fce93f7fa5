"""A single run: from the initial state to the trajectory and its verdict."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import InputError, StorageError, reject
from symsimpson.program.evaluation import evaluate
from symsimpson.program.input_values import read_count
from symsimpson.program.numbers import NOTHING
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.checkpoint import Checkpoint, count_buffered, describe_run
from symsimpson.run.ended import Sink, StateCollector, StateSampler, make_trajectory, raise_failure
from symsimpson.run.resolution import finer_stride, real_energies, sampling_stride, thin_states
from symsimpson.run.short_runs import compile_all
from symsimpson.run.verdict import judge_run
from symsimpson.stepping.inputs import check_on_failure, make_start_error
from symsimpson.stepping.parts import STRIDE
from symsimpson.stepping.run import Run, StoredStates
from symsimpson.stepping.spec import RunSpec, make_recorders
from symsimpson.support.array_types import Reals
from symsimpson.support.files import check_folder, read_path
from symsimpson.support.progress import silence


def start_run(
    program: Program,
    spec: RunSpec,
    stride: int,
    stored: int,
    inputs: Reals | None = None,
    recorders: Sequence[Recorder] = (),
) -> Run:
    """Make a run at its initial state; warn if its step size is beyond linear stability.

    The run has arrays for ``stored`` states, ``stride`` steps apart; with stride 0 it stores none.
    By default, inputs and recorders follow from ``spec``. Raises InputError if the states do not
    fit into memory, or if the time does not advance. Raises InputError also if M(q0) is not
    positive definite, or if the energy at q0 is not finite.
    """
    given = spec.inputs if inputs is None else inputs
    attached = tuple(recorders) or make_run_recorders(program, spec)
    try:
        if program.modes is not None:
            from symsimpson.run.mode_run import ModeRun  # few systems need it

            run: Run = ModeRun(program, spec, (stride, stored), given)
        elif spec.run_events is not None:
            from symsimpson.run.event_run import EventRun  # few runs need it

            run = EventRun(program, spec, spec.run_events, (stride, stored), given, attached)
        else:
            size = spec.parameters, spec.h, spec.t0, (stride, stored)
            run = Run(program, *size, inputs=given, recorders=attached)
    except InputError:
        raise
    except (MemoryError, ValueError):
        reject(
            f"{stored} states of {2 * program.n} numbers do not fit into memory.",
            remedy="Store fewer states: every=1000, or every=None for the last state only. Or "
            "store them on disk: checkpoint='run.ckpt'.",
        )
    _set_initial_state(program, run, spec)
    if spec.steps and not spec.checked:
        _warn_of_step(program, run, spec)
    return run


def make_run_recorders(program: Program, spec: RunSpec) -> tuple[Recorder, ...]:
    """Return the recorders for the variations, sums and reductions of a run."""
    header, count = program.header, None
    if spec.tangents is not None:
        count = spec.tangents.shape[1] + len(header.varied_by or ())
    return make_recorders(header, count, spec.record, spec.reductions)


def _set_initial_state(program: Program, run: Run, spec: RunSpec) -> None:
    """Set the initial state and variations of a run; check mass matrix, rate and energy there."""
    numbers, q = program.numbers, spec.q0
    run.begin(q, spec.other0, velocity=spec.velocities, t_end=spec.t_end)
    pivot, velocities = float(run.value("MASS_PIVOT")), run.rows("VELOCITY", program.n)
    if program.header.fast_sines and not numbers.all_finite(velocities):
        run.begin(q, spec.other0, velocity=spec.velocities, any_angle=True, t_end=spec.t_end)
        pivot = float(run.value("MASS_PIVOT"))
    if pivot < 0 or not numbers.all_finite(velocities):
        values = map(float, run.rows("PARAMETER", len(program.parameters)))
        named = dict(zip(program.parameters, values, strict=True))
        where = f"q0={q.tolist()} with the parameters {named}"
        _explain_momentum(program, spec, where)
        zero = [name for name, value in named.items() if value == 0]
        finite, everywhere = numbers.all_finite(q), pivot == 0 and _is_singular_elsewhere(run, spec)
        raise make_start_error(
            program.system, where, pivot, finite, zero=zero if everywhere else None
        )
    if run.header.retimed and not run.parameters[-1] > 0:
        reject(
            f"the rate dt/dtau is {float(run.parameters[-1]):g} at q0={q.tolist()}.",
            where=program.system,
            why="Time must advance, so the rate must be positive.",
            remedy="Start from another position, or change the rate.",
        )
    run.apply("energy")
    # an angle may only be too large for fast sines: check_start uses sines for any angle
    position, momentum = (run.rows(name, program.n) for name in ("POSITION", "MOMENTUM"))
    if not numbers.all_finite(run.rows("ENERGY", 1)):
        check_start(program, spec.t0, position, momentum, spec.parameters)
    run.begun = run.t0, np.array([position, momentum])
    if spec.tangents is not None:
        _set_initial_variations(program, run, spec.tangents, velocity=spec.velocities)
    run.observe_start()


def _explain_momentum(program: Program, spec: RunSpec, where: str) -> None:
    """Reject a start at which the map between v and p has no solution, if that may be the cause."""
    header, other = program.header, spec.other0.tolist()
    why = "There a momentum does not determine the velocity."
    if header.canonical and spec.velocities:
        what, remedy = f"no momentum has the velocity v0={other}", "Give p0."
        why = "The matrix H_pp is singular, or Newton's method found no momentum."
    elif header.canonical:
        what, remedy, why = f"H has no value at p0={other}", "Start from another state.", ""
    elif header.general and spec.velocities:
        what = f"L has no value at v0={other}, or L_vv is singular there"
        remedy, why = "Start with another velocity.", ""
    elif header.general:
        what, remedy = f"no velocity has the momentum p0={other}", "Give v0."
        why = "Newton's method for L_v(q, v) = p found none from v = 0 and from v = p."
    elif header.indefinite:
        what, remedy = "the mass matrix is singular", "Start from another position."
    else:
        return
    reject(f"{what}, at {where}.", where=program.system, why=why, remedy=remedy)


def _set_initial_variations(program: Program, run: Run, tangents: Reals, *, velocity: bool) -> None:
    """Set the initial variations: ``tangents``, as (dq0, dp0), then those by parameters.

    A parameter changes neither q0 nor the given p0 or v0. With v0, the momentum
    p0 = L_v(q0, v0) changes with the parameter.
    """
    n, given = program.n, tangents.shape[1]
    if "TIME_GRID" in program.header.layout:
        run.rows("TIME_GRID", 2)[:] = 1, run.t0
    varied = len(program.header.varied_by or ())
    count = given + varied
    run.rows("TANGENTS", 1)[:] = count
    run.rows("TANGENT", 2 * n * given)[:] = tangents.T.ravel()
    if velocity and varied:
        run.apply("momentum_slopes")
    run.store(0)


def _is_singular_elsewhere(run: Run, spec: RunSpec) -> bool:
    """Return whether M is singular at another position too; overwrite the state of the run."""
    # irrational distances from q0, so that no symmetry keeps M singular; the term with h gives the
    # array the number type of the run
    elsewhere = spec.q0 + run.h * 0 + np.sqrt(np.arange(2.0, run.header.n + 2)) / 7
    run.begin(elsewhere, spec.other0, velocity=spec.velocities, any_angle=True, t_end=spec.t_end)
    return not np.isfinite(run.rows("VELOCITY", run.header.n).astype(np.float64)).all()


def _warn_of_step(program: Program, run: Run, spec: RunSpec) -> None:
    """Warn if h is beyond the limit of linear stability, once for each h and parameters."""
    key = spec.h, spec.parameters.tobytes()
    plain = run.W.dtype == np.float64
    if not plain or key in program.findings.checked_steps:
        return
    program.findings.checked_steps.add(key)
    system, tools = program.declared, program.tools
    if system is not None and tools is not None:
        q, v = (run.rows(name, program.n) for name in ("POSITION", "VELOCITY"))
        values = np.concatenate([run.parameters, spec.inputs[0, 0, 0]])
        tools.check_step(program, system, q, v, values, run.h, run.t0)


def check_start(program: Program, t: Any, q: Reals, p: Reals, values: Reals) -> None:
    """Raise InputError if the energy at a state is not a finite real number."""
    if not real_energies(program, (t, q, p), values):
        reject(
            "the energy is not a finite real number at q0 = "
            f"({', '.join(f'{float(x):g}' for x in q)}).",
            where=program.system,
            why="T or V is undefined there. Typical causes are a division by zero, a root of zero, "
            "or the logarithm or root of a negative number.",
            remedy="Start from a state at which T and V are defined, or check their formulas.",
        )


def check_forces(program: Program, spec: RunSpec) -> None:
    """Raise InputError if a force or its derivative is not finite at the initial state."""
    tools, system, t0 = program.tools, program.declared, float(spec.t0)
    if tools is None or system is None:
        return
    values = [*map(float, spec.parameters), *map(float, spec.inputs[0, 0, 0])]
    q = list(map(float, spec.q0))
    bad = np.flatnonzero(~np.isfinite(tools.force_terms(system, q, values, t0)))
    if bad.size:
        reject(
            f"the force on {program.coordinates[bad[0]]} is not finite at "
            f"q0 = ({', '.join(f'{x:g}' for x in q)}), although T and V are.",
            where=program.system,
            why="The cause is the derivative of a root at zero, or a quotient 0/0.",
            remedy="Start from a nearby position, or write V and forces in a form that is smooth "
            "there.",
        )
    v = spec.other0
    if not spec.velocities:
        start = spec.t0, spec.q0, spec.other0
        v = evaluate(program, "energy", "VELOCITY", program.n, start, spec.parameters)
    bad = np.flatnonzero(~np.isfinite(tools.force_terms(system, q, values, t0, v)))
    if bad.size:
        reject(
            f"the force on {program.coordinates[bad[0]]} is not differentiable at the initial "
            f"velocities ({', '.join(f'{x:g}' for x in v.tolist())}).",
            where=program.system,
            why="The cause is a root of zero, such as sqrt(v) at v = 0.",
            remedy="Start with another velocity, or write a smooth force, such as "
            "sqrt(v**2 + eps**2) with a small eps.",
        )


#: Runs of fewer steps are over before a progress bar would appear, so they do not prepare one.
BRIEF = 10_000


def follow_run(
    program: Program,
    run: Run,
    spec: RunSpec,
    keeper: Sink,
    sinks: Sequence[Sink] = (),
    progress: bool | None = None,
) -> tuple[Trajectory, StorageError | None]:
    """Take the steps of a run; judge its energy from the states that ``keeper`` stored.

    All ``sinks`` receive the states as well. The trajectory has one state every ``spec.every``
    steps, or only the final one for 0. Return it and the error of a sink that ended the run, or
    None. Raises InputError if a force is not finite at the initial state.
    """
    count, problem = spec.steps, None
    shown = progress if count > BRIEF and spec.t_end is None else bool(progress)
    with run.watched(count, shown):
        try:
            _take_pieces(run, count, (keeper, *sinks))
        except StorageError as error:
            problem = error
    status = run.status if problem is None else Status.FILE_ERROR
    if status is Status.NOT_FINITE and run.step == 0:
        check_forces(program, spec)
    stored = keeper.states()
    selected, left_out = stored, 0
    if spec.every not in (0, stored.every):
        q, p, iterations, recorded = thin_states(spec.every // stored.every, *stored[:-1])
        selected = StoredStates(q, p, iterations, recorded, spec.every)
        left_out = int(stored.iterations.sum() - iterations.sum())
    count = run.step if run.has_arrived else count
    trajectory = make_trajectory(program, run, count, status, spec, selected, spec.every, left_out)
    judged = program.modes is None  # contacts and friction change the energy
    if count and judged and status is not Status.INTERRUPTED and problem is None:
        try:
            trajectory = judge_run(program, run, trajectory, stored)
        except KeyboardInterrupt:  # the states are complete, but not judged
            stopped = Status.INTERRUPTED
            trajectory = replace(trajectory, status=stopped, message=stopped.message)
    return trajectory, problem


def _take_pieces(run: Run, count: int, sinks: Sequence[Sink]) -> None:
    """Take steps; pass states to all sinks when one is due or the arrays are full."""
    while True:
        stop = min(count, run.room)
        try:
            run.advance(min(sink.next_stop(stop) for sink in sinks))
        finally:  # also after Ctrl-C
            for sink in sinks:
                sink.take()
        if run.step >= count or not run.alive:
            return
        run.discard_stored()


#: Number of states in the arrays of a run whose number of steps is unknown: few enough to need
#: little memory, and enough that copying takes little time.
ROOM = 4096


def integrate(
    program: Program,
    spec: RunSpec,
    progress: bool | None = None,
    on_failure: str = "raise",
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_every: int | None = None,
) -> Trajectory:
    """Run, and return the trajectory.

    Raises InputError. With ``on_failure="raise"``, raises StorageError, ConvergenceError or
    Interrupted; with "return", the status of the trajectory tells the failure.
    """
    check_on_failure(on_failure)
    with program.numbers.working(), silence() if progress is False else NOTHING:
        stride = _choose_stride(program, spec, to_disk=checkpoint is not None)
        run = start_run(
            program,
            spec,
            stride,
            _count_array_states(program, spec, stride, checkpoint is not None),
        )
        if spec.steps:
            compile_all(program)
        if checkpoint is not None:
            keeper: Sink = _make_checkpoint(checkpoint, checkpoint_every, program, run, spec)
        elif spec.t_end is not None:
            keeper = StateCollector(run) if spec.every else StateSampler(run, stride)
        else:
            keeper = Sink(run)
        trajectory, problem = follow_run(program, run, spec, keeper, progress=progress)
        if isinstance(keeper, Checkpoint) and trajectory.status is Status.INTERRUPTED:
            resume = f"symsimpson.resume({str(keeper.path)!r})"
            message = f"{trajectory.message} Continue the run with {resume}."
            trajectory = replace(trajectory, message=message)
        if problem is not None and on_failure == "raise":
            problem.trajectory = trajectory
            raise problem
        if not trajectory.success and on_failure == "raise":
            raise_failure(run, trajectory, trajectory)
    return trajectory


def _choose_stride(program: Program, spec: RunSpec, *, to_disk: bool) -> int:
    """Return the number of steps between states to store, including states for the verdict only."""
    count, header = spec.steps, program.header
    if not spec.every:
        return sampling_stride(program, count) if spec.t_end is None else STRIDE
    free = not to_disk and spec.t_end is None and spec.tangents is None
    if free and header.real_everywhere and not header.constraints:
        return finer_stride(spec.every, count)
    return spec.every


def _count_array_states(program: Program, spec: RunSpec, stride: int, to_disk: bool) -> int:
    """Return the number of states that the arrays of a run need to hold at a time."""
    stored = spec.steps // stride + 1 if stride else 1
    if spec.t_end is not None:
        stored = min(stored, ROOM + 1)
    if to_disk:
        width = sum(recorder.rows for recorder in make_run_recorders(program, spec))
        stored = count_buffered(stride, stored, 2 * program.n + width)
    return stored


def _make_checkpoint(
    path: str | os.PathLike[str], every: int | None, program: Program, run: Run, spec: RunSpec
) -> Checkpoint:
    """Make the sink for a checkpoint file; raise InputError or StorageError."""
    place = read_path("checkpoint", path)
    check_folder(place, "checkpoint")
    if run.W.dtype != np.float64:
        reject(
            "checkpoint= cannot be combined with multiprecision.",
            remedy="Remove checkpoint, or compile without precision=.",
        )
    steps = None if every is None else read_count("checkpoint_every", every, least=1)
    return Checkpoint(place, describe_run(program, run, spec), run, steps)
