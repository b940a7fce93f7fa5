"""Commands that integrate a system."""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.cli.find import check_figure, find, state_of
from symsimpson.errors import InputError, ResolutionWarning
from symsimpson.run.ended import uninterrupted
from symsimpson.support.files import check_folder, written_beside
from symsimpson.support.names import counted

if TYPE_CHECKING:
    from symsimpson.api.stepper import Stepper
    from symsimpson.declare.system import MechanicalSystem
    from symsimpson.results.trajectory import Trajectory


#: Where a run ends for which nothing is asked.
END = 10.0


def run(options: argparse.Namespace) -> int:
    """Integrate, and tell what came of it."""
    from symsimpson.results.tables import check_kind

    if options.out:
        check_kind(Path(options.out))
        check_folder(Path(options.out), "file")
    system = find(options.system, options.retimed)  # loads SymPy, which is not what is timed
    begin = time.perf_counter()
    stepper, given = _made(system, options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResolutionWarning)
        # compiles and loads all that a run needs
        steps = max(1, min(16, _steps(options)))
        brief: dict[str, Any]
        brief = {"t_end": options.h} if stepper.program.header.retimed else {"steps": steps}
        if "inputs" in given:
            brief["inputs"] = {name: x[:steps] for name, x in given["inputs"].items()}
        for _ in range(2):
            uninterrupted(stepper.integrate(**given | brief, h=options.h, on_failure="return"))
    ready = time.perf_counter()
    trajectory = _integrated(options, stepper, given)
    done = time.perf_counter()
    _report(trajectory, given)
    if trajectory.h != options.h:
        print(f"  {trajectory.message}")
    print(f"  derived and compiled in {ready - begin:.2f} s, run in {(done - ready) * 1e3:.2f} ms")
    if options.out:
        trajectory.save(options.out)
        print(f"  written to {options.out}")
    return 0


def plot(options: argparse.Namespace) -> int:
    """Draw a run to a file."""
    check_figure("out", options.out)
    if options.names and options.kind not in ("time", "phase"):
        raise InputError(
            f"--kind {options.kind} draws no {', '.join(options.names)}.\nLeave the names out, or "
            "draw them by --kind time or --kind phase."
        )
    if options.kind == "phase" and len(options.names) > 2:
        raise InputError(
            f"--kind phase draws one quantity over another, not {', '.join(options.names)}.\n"
            "Name two, x and y, or one to draw its momentum over it."
        )
    trajectory = _integrated(options, *_made(find(options.system, options.retimed), options))
    if options.kind == "time":
        ax = trajectory.plot(options.names or None)
    elif options.kind == "phase":
        ax = trajectory.plot_phase(*options.names[:2])
    else:
        ax = trajectory.plot_energy() if options.kind == "energy" else trajectory.plot_path()
    with written_beside(Path(options.out), "figure") as whole:
        ax.figure.savefig(whole, bbox_inches="tight", dpi=150)
    print(f"written to {options.out}")
    return 0


def film(options: argparse.Namespace) -> int:
    """Film a run to a file."""
    check_folder(Path(options.out), "animation")
    trajectory = _integrated(options, *_made(find(options.system, options.retimed), options))
    print(
        "written to "
        f"{trajectory.animate(seconds=options.seconds, fps=options.fps).save(options.out)}"
    )
    return 0


def _made(system: MechanicalSystem, options: argparse.Namespace) -> tuple[Stepper, dict[str, Any]]:
    """Return the stepper that is asked for, its state and the values of parameters."""
    from symsimpson.api.compiling import compile as compile_system

    state = state_of(system, options)
    stepper = compile_system(system, options.scheme)
    given = state | {"parameters": dict(options.parameters)}
    return stepper, given | _inputs(options, stepper, _steps(options))


def _integrated(options: argparse.Namespace, stepper: Stepper, given: dict[str, Any]) -> Trajectory:
    t_end = END if options.t_end is None and options.steps is None else options.t_end
    return stepper.integrate(
        **given, h=options.h, t_end=t_end, steps=options.steps, every=options.every
    )


def _steps(options: argparse.Namespace) -> int:
    """Return how many steps are requested; raises InputError if they make no sense."""
    from symsimpson.program.numbers import FLOAT64
    from symsimpson.stepping.inputs import read_steps
    from symsimpson.stepping.request import Request

    end = END if options.t_end is None and options.steps is None else options.t_end
    return read_steps(Request(None, h=options.h, t_end=end, steps=options.steps), FLOAT64)[1]


def _inputs(options: argparse.Namespace, stepper: Stepper, steps: int) -> dict[str, Any]:
    """Read inputs that are held over each of so many steps."""
    if options.inputs is None and stepper.inputs:
        raise InputError(
            f"{stepper.system} has the inputs {', '.join(stepper.inputs)}, of which no values are "
            "given.\nPass --inputs FILE: a .csv file whose first line names the inputs, and each "
            f"further line has their values over a step; {steps} lines here."
        )
    if options.inputs is None:
        return {}
    path = Path(options.inputs)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # of a file in which there is nothing
            table = np.genfromtxt(
                path, delimiter=",", names=True, deletechars="", ndmin=1, encoding="utf-8-sig"
            )
    except (OSError, ValueError, UserWarning) as error:
        why = str(error).rstrip(".")
        raise InputError(
            f"--inputs {path}: it cannot be read: {why}.\nThe first line names the inputs, "
            "each further line has their values over a step, with commas between."
        ) from None
    names = table.dtype.names or ()
    if set(names) != set(stepper.inputs):
        raise InputError(
            f"--inputs {path}: its columns are {', '.join(names) or 'none'}; the inputs of "
            f"{stepper.system} are {', '.join(stepper.inputs) or 'none'}.\nName each once."
        )
    if len(table) < steps:
        raise InputError(
            f"--inputs {path}: it has {len(table)} rows for {steps} steps.\nGive a row for each."
        )
    return {"inputs": {name: table[name][:steps] for name in names}}


def _report(trajectory: Trajectory, given: dict[str, Any]) -> None:
    from symsimpson.results.outcome import iterations_a_step

    program, end = trajectory.program, float(trajectory.t[-1])
    if trajectory.every is not None and not program.header.retimed:
        end = float(trajectory.t[0] + trajectory.h * trajectory.steps)  # its state may be missing
    print(f"{program.system}, {program.scheme} (order {program.order}), h = {trajectory.h:g}")
    for name in ("q0", "v0", "p0"):
        if name in given:
            print(f"  {name} = ({', '.join(f'{x:g}' for x in given[name])})")
    for name, value in given["parameters"].items():
        print(f"  {name} = {value:g}")
    iterations = iterations_a_step(trajectory)
    said = "" if iterations is None else f", {iterations:.2f} Newton iterations a step"
    print(f"  {counted(trajectory.steps, 'step')} to t = {end:g}{said}")
    if program.header.conservative:
        print(f"  largest relative energy error {np.abs(trajectory.energy_error).max():.2e}")
    else:
        last = trajectory.energy[-1] if trajectory.t[-1] == end else trajectory.at(end).energy[0]
        print(f"  energy {trajectory.energy[0]:.9g} at the start, {last:.9g} at the end")
    for name, values in trajectory.invariants.items():
        print(f"  {name}: {values[0]:.9g}, changed by at most {np.ptp(values):.1e}")
