"""Commands: each reads what its words name, and does it."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.errors import ResolutionWarning, SymsimpsonError, reject
from symsimpson.run.ended import uninterrupted
from symsimpson.support.files import check_folder, written_beside
from symsimpson.support.names import counted, did_you_mean

if TYPE_CHECKING:
    from symsimpson.api.stepper import Stepper
    from symsimpson.declare.system import MechanicalSystem
    from symsimpson.results.trajectory import Trajectory

#: The schemes of which generated modules are kept.
SCHEMES = ("midpoint", "simpson")
#: Where a run ends for which nothing is asked.
END = 10.0


def list_systems(options: argparse.Namespace) -> int:
    """Print the catalogue."""
    from symsimpson.systems import EVERY

    for name, make in EVERY.items():
        system = make()
        first = (make.__doc__ or "").splitlines()[0]
        print(f"{name:<20} n = {system.n:<4} {first}")
    return 0


def generate(options: argparse.Namespace) -> int:
    """Write generated modules."""
    from symsimpson.api.compiling import generate as write
    from symsimpson.systems import CATALOGUE

    for name in options.system or CATALOGUE:
        system = find(name)
        for scheme in options.scheme or SCHEMES:
            print(write(system, scheme, options.directory))
    return 0


def export(options: argparse.Namespace) -> int:
    """Write the steps of a system in another language."""
    from symsimpson.api.compiling import compile as compile_system

    stepper = compile_system(find(options.system), options.scheme)
    for path in stepper.export_c(options.out):
        print(path)
    return 0


def check(options: argparse.Namespace) -> int:
    """Compare generated modules of the catalogue with fresh ones."""
    from symsimpson.lower.pipeline import source
    from symsimpson.systems import CATALOGUE

    directory = Path(options.directory)
    expected = {}
    for make in CATALOGUE.values():
        system = make()
        for scheme in SCHEMES:
            expected[f"{system.name}__{scheme}.py"] = source(system, scheme)
    present = {path.name for path in directory.glob("*.py")}
    if not expected.keys() & present:
        reject(
            f"{directory}: there are no modules of the catalogue to compare.",
            remedy="This command is for "
            "changes of the generator: run it in a clone of the repository, or name a folder by "
            "--directory. symsimpson certify FILE measures a module of your own.",
        )
    for name in sorted(present - expected.keys()):
        print(f"other    {name}, which is not of the catalogue")
    findings = [f"missing  {name}" for name in sorted(expected.keys() - present)]
    findings += [
        f"stale    {name}"
        for name in sorted(expected.keys() & present)
        if (directory / name).read_bytes() != expected[name].encode()
    ]
    for finding in findings:
        print(finding)
    if findings:
        print("Run symsimpson generate to write them.", file=sys.stderr)
        return 1
    print(f"{len(expected)} generated modules are up to date.")
    return 0


def certify(options: argparse.Namespace) -> int:
    """Print a certificate of a stepper: measured order, symplecticity, drift and other rows."""
    from symsimpson.api.compiling import compile as compile_system
    from symsimpson.api.compiling import load

    path = Path(options.stepper)
    if path.suffix == ".py":
        if options.retimed:
            reject(
                "--retimed does not go with a generated file.",
                remedy="Generate the file from the retimed system.",
            )
        stepper = load(path)
    elif options.save:
        reject(
            f"--save: {options.stepper} is no generated file.",
            remedy="Write it with symsimpson generate.",
        )
    else:
        stepper = compile_system(find(options.stepper, options.retimed), options.scheme)
    certificate = stepper.certify(
        options.q0, options.v0, p0=options.p0, h=options.h, parameters=dict(options.parameters)
    )
    print(certificate)
    if options.save:
        print(f"  written to {certificate.save(path.with_suffix('.certificate.json'))}")
    return 0 if certificate.passed else 1


def choose(options: argparse.Namespace) -> int:
    """Print the fastest scheme and step size for a given error."""
    from symsimpson.study.analysis.choose import choose as chosen

    system = find(options.system, options.retimed)
    print(
        chosen(
            system,
            **state_of(system, options),
            t_end=options.t_end,
            error=options.error,
            parameters=dict(options.parameters),
        )
    )
    return 0


def stress(options: argparse.Namespace) -> int:
    """Run a system for long, and at large steps."""
    from symsimpson.api.compiling import compile as compile_system
    from symsimpson.study.analysis.stability import stress as stressed
    from symsimpson.study.analysis.stability import stress_standard

    if options.system is None:
        lines = stress_standard(options.scheme)
    else:
        stepper = compile_system(find(options.system, options.retimed), options.scheme)
        lines = stressed(stepper, h=options.h, steps=options.steps)
    for line in lines:
        print(line, flush=True)
    return 0


def bench(options: argparse.Namespace) -> int:
    """Measure run time against error."""
    from symsimpson.study.bench.work_precision import WorkPrecision, work_precision

    if options.plot:  # before hours of measurements
        check_figure("plot", options.plot)
    if options.out and Path(options.out).suffix != ".json":
        reject(f"--out {options.out}: unknown format.", remedy="Use a name in .json.")
    if options.out:
        check_folder(Path(options.out), "record")
    before = WorkPrecision.load(options.against) if options.against else None
    record = work_precision(
        find(options.system, options.retimed),
        options.schemes,
        options.peers or "installed",
        options.errors,
        t_end=options.t_end,
        repeats=options.repeats,
    )
    print(record)
    if before is not None:
        print(record.compare(before))
    if options.out:
        print(f"written to {record.save(options.out)}")
    if options.plot:
        record.plot().figure.savefig(options.plot)
    return 0


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
        reject(
            f"--kind {options.kind} draws no {', '.join(options.names)}.",
            remedy="Leave the names out, or draw them by --kind time or --kind phase.",
        )
    if options.kind == "phase" and len(options.names) > 2:
        reject(
            f"--kind phase draws one quantity over another, not {', '.join(options.names)}.",
            remedy="Name two, x and y, or one to draw its momentum over it.",
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
        reject(
            f"{stepper.system} has the inputs {', '.join(stepper.inputs)}, of which no values are "
            "given.",
            remedy="Pass --inputs FILE: a .csv file whose first line names the inputs, and each "
            f"further line has their values over a step; {steps} lines here.",
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
        reject(
            f"--inputs {path}: it cannot be read: {why}.",
            remedy="The first line names the inputs, "
            "each further line has their values over a step, with commas between.",
        )
    names = table.dtype.names or ()
    if set(names) != set(stepper.inputs):
        reject(
            f"--inputs {path}: its columns are {', '.join(names) or 'none'}; the inputs of "
            f"{stepper.system} are {', '.join(stepper.inputs) or 'none'}.",
            remedy="Name each once.",
        )
    if len(table) < steps:
        reject(
            f"--inputs {path}: it has {len(table)} rows for {steps} steps.",
            remedy="Give a row for each.",
        )
    return {"inputs": {name: table[name][:steps] for name in names}}


def _report(trajectory: Trajectory, given: dict[str, Any]) -> None:
    from symsimpson.results.html import iterations_a_step

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


#: Kinds of files that figures go to.
FIGURES = (".png", ".pdf", ".svg")


def check_figure(option: str, path: str) -> None:
    """Refuse a figure's file that has an unknown format or no folder, before any computation.

    Raises InputError or StorageError.
    """
    if Path(path).suffix not in FIGURES:
        reject(
            f"--{option} {path}: unknown format.",
            remedy=f"Use a name in {', '.join(FIGURES[:-1])} or {FIGURES[-1]}.",
        )
    check_folder(Path(path), "figure")


def state_of(system: MechanicalSystem, options: argparse.Namespace) -> dict[str, Any]:
    """Return the state that is asked for, or the one that the catalogue names.

    Raises InputError if there is none.
    """
    given = {k: getattr(options, k) for k in ("q0", "v0", "p0")}
    asked = {k: x for k, x in given.items() if x is not None}
    state = asked or dict(getattr(system, "reference_state", {}))
    if "q0" not in state:
        what = f"{' and '.join(f'--{k}' for k in asked)} without --q0"
        what = what if asked else f"{system.name} has no reference state"
        reject(f"{what}.", remedy="Pass --q0 and --v0 or --p0.")
    if ("v0" in state) == ("p0" in state):
        reject("--q0 needs exactly one of --v0 and --p0.", remedy="Pass numbers, as --v0 0,0.")
    return state


def find(name: str, rate: str | None = None) -> MechanicalSystem:
    """Return a system of the catalogue or of file:attribute, retimed if a rate is given."""
    system = _named(name)
    return system if rate is None else system.retimed(rate)


def _named(name: str) -> MechanicalSystem:
    from symsimpson.declare.system import MechanicalSystem
    from symsimpson.systems import CATALOGUE, EVERY

    if name in EVERY:
        return EVERY[name]()
    for make in CATALOGUE.values():
        system = make()
        if system.name == name:
            return system
    path, separator, attribute = name.rpartition(":")
    if not separator:
        if name.endswith(".py") and Path(name).is_file():
            reject(
                f"{name} is a file, of which this command needs a system.",
                remedy="Name the variable that "
                f"holds it: {name}:system. Generated modules are taken by symsimpson "
                "certify alone.",
            )
        reject(
            f"there is no system {name!r} in the catalogue.{did_you_mean(name, EVERY)}",
            remedy="Run symsimpson list to see the catalogue. For your own system give "
            "path/to/file.py:attribute.",
        )
    if not Path(path).is_file():
        reject(f"there is no file {path}.", remedy="Give path/to/file.py:attribute.")
    with _as_a_script(path):
        remedy = f"python {path} runs it by itself."
        with _of_the_user(f"{path}: the file cannot be run", remedy):
            spec = importlib.util.spec_from_file_location("symsimpson_user_file", path)
            if spec is None or spec.loader is None:
                raise ImportError("not a Python file")
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module  # dataclasses look there
            try:
                spec.loader.exec_module(module)
            except SystemExit as error:
                if error.code:  # neither None nor 0: the file says that it failed
                    raise
        candidate = getattr(module, attribute, None)
        if callable(candidate) and not isinstance(candidate, MechanicalSystem):
            called = "The function that makes a system is called without arguments."
            with _of_the_user(f"{path}: {attribute}() makes no system", called):
                candidate = candidate()
    if not isinstance(candidate, MechanicalSystem):
        reject(
            f"{path}: {attribute!r} is no MechanicalSystem.",
            remedy="Give the name of a variable that holds one, or of a function that makes one.",
        )
    return candidate


@contextlib.contextmanager
def _as_a_script(path: str) -> Iterator[None]:
    """Let a file find its neighbours, and no arguments of the command, as ``python path`` does."""
    folder, before, arguments = Path(path).resolve().parent, {*sys.modules}, sys.argv
    sys.path.insert(0, str(folder))
    sys.argv = [path]
    try:
        yield
    finally:
        sys.argv = arguments
        with contextlib.suppress(ValueError):
            sys.path.remove(str(folder))
        for name in {*sys.modules} - before:  # another file may have a neighbour of that name
            if Path(getattr(sys.modules[name], "__file__", None) or "").parent == folder:
                del sys.modules[name]


@contextlib.contextmanager
def _of_the_user(what: str, remedy: str) -> Iterator[None]:
    """Tell what a user's own code raises, whatever it may be, in words."""
    try:
        yield
    except SymsimpsonError:
        raise
    except SystemExit as error:
        reject(f"{what}: it calls sys.exit({error.code!r}).", remedy=f"{remedy}")
    except Exception as error:
        reject(f"{what}: {type(error).__name__}: {error}.", remedy=f"{remedy}", cause=error)
