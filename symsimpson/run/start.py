"""How a run begins: room for its states, the state that it begins with, and a look at its step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder
from symsimpson.run.resolution import real_energies
from symsimpson.stepping.inputs import refused_start
from symsimpson.stepping.recording import recorders_of
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec
from symsimpson.stepping.variations import begin_variations
from symsimpson.support.array_types import Reals


def started(
    program: Program,
    spec: RunSpec,
    stride: int,
    stored: int,
    inputs: Reals | None = None,
    recorders: Sequence[Recorder] = (),
) -> Run:
    """Make a run at its start; warn of its step.

    There is room for ``stored`` states, ``stride`` steps apart, 0 for none. Inputs and recorders
    are those of the request unless given. Raises InputError if the states do not fit into memory,
    M(q0) is not positive definite, the energy has no value there, or time does not advance.
    """
    given = spec.inputs if inputs is None else inputs
    asked = tuple(recorders) or recorders_for(program, spec)
    try:
        if spec.run_events is not None:
            from symsimpson.run.event_run import EventRun  # few runs need it

            run: Run = EventRun(program, spec, spec.run_events, stride, stored, given, asked)
        else:
            how = spec.parameters, spec.h, spec.t0, stride, stored, program.kernels.fallbacks
            run = Run(program, *how, given, asked)
    except InputError:
        raise
    except (MemoryError, ValueError):
        raise InputError(
            f"{stored} stored states of {2 * program.n} numbers do not fit into memory.\n"
            "Store fewer: every=1000, or every=None for the last state only; or keep them on disk: "
            "checkpoint='run.ckpt'."
        ) from None
    _begin(program, run, spec)
    if spec.steps:
        _warn_of_step(program, run, spec)
    return run


def recorders_for(program: Program, spec: RunSpec) -> tuple[Recorder, ...]:
    """Return the recorders that a run is asked for."""
    header, count = program.header, None
    if spec.tangents is not None:
        count = spec.tangents.shape[1] + len(header.varied_by or ())
    return recorders_of(header, count, spec.record, spec.reductions)


def _begin(program: Program, run: Run, spec: RunSpec) -> None:
    """Put the initial state, and the variations that are asked for, into a run."""
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
        zero = [name for name, value in named.items() if value == 0]
        finite, everywhere = numbers.all_finite(q), pivot == 0 and _singular_elsewhere(run, spec)
        raise refused_start(program.system, where, pivot, finite, zero=zero if everywhere else None)
    if run.header.retimed and not run.parameters[-1] > 0:
        raise InputError(
            f"{program.system}: the rate dt/dtau is {float(run.parameters[-1]):g} at "
            f"q0={q.tolist()}.\nTime must advance: start where it is positive, or change the rate."
        )
    run.apply("energy")
    # no value may mean an angle that is too large for fast sines: check_start takes others
    position, momentum = (run.rows(name, program.n) for name in ("POSITION", "MOMENTUM"))
    if not numbers.all_finite(run.rows("ENERGY", 1)):
        check_start(program, spec.t0, position, momentum, spec.parameters)
    run.begun = run.t0, np.array([position, momentum])
    if spec.tangents is not None:
        begin_variations(program, run, spec.tangents, velocity=spec.velocities)
    run.look()


def _singular_elsewhere(run: Run, spec: RunSpec) -> bool:
    """Return whether M is singular at another position, too; the state of the run is lost."""
    # irrational distances from the start, so that no symmetry keeps M singular; h gives the kind of
    # number, which has many digits as well
    elsewhere = spec.q0 + run.h * 0 + np.sqrt(np.arange(2.0, run.header.n + 2)) / 7
    run.begin(elsewhere, spec.other0, velocity=spec.velocities, any_angle=True, t_end=spec.t_end)
    return not np.isfinite(run.rows("VELOCITY", run.header.n).astype(np.float64)).all()


def _warn_of_step(program: Program, run: Run, spec: RunSpec) -> None:
    """Warn once of a step beyond the limit of linear stability."""
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
    """Refuse a state at which the energy is not a finite real number; raises InputError."""
    if not real_energies(program, (t, q, p), values):
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
    tools, system, t0 = program.tools, program.declared, float(spec.t0)
    if tools is None or system is None:
        return
    values = [*map(float, spec.parameters), *map(float, spec.inputs[0, 0, 0])]
    q = list(map(float, spec.q0))
    bad = np.flatnonzero(~np.isfinite(tools.force_terms(system, q, values, t0)))
    if bad.size:
        raise InputError(
            f"{program.system}: the force on {program.coordinates[bad[0]]} has no finite value at "
            f"q0 = ({', '.join(f'{x:g}' for x in q)}), though T and V have.\n"
            "A derivative of a root at zero or a quotient 0/0 makes it so. Start beside it, or "
            "write V and forces in a form that is smooth there."
        )
    v = spec.other0
    if not spec.velocities:
        start = spec.t0, spec.q0, spec.other0
        v = evaluate(program, "energy", "VELOCITY", program.n, start, spec.parameters)
    bad = np.flatnonzero(~np.isfinite(tools.force_terms(system, q, values, t0, v)))
    if bad.size:
        raise InputError(
            f"{program.system}: the force on {program.coordinates[bad[0]]} has a value at the "
            f"velocities of the start, ({', '.join(f'{x:g}' for x in v.tolist())}), but no slope.\n"
            "A root that is 0 makes it so, as sqrt(v) at v = 0. Begin with another velocity, or "
            "write a force that is smooth there, as sqrt(v**2 + eps**2) with a small eps."
        )
