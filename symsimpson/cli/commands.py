"""The commands: each function runs one of them and returns its exit status."""

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
from symsimpson.run.ended import raise_if_interrupted
from symsimpson.support.files import atomic_path, check_folder
from symsimpson.support.names import counted, did_you_mean

if TYPE_CHECKING:
    from symsimpson.api.stepper import Stepper
    from symsimpson.declare.system import MechanicalSystem
    from symsimpson.results.trajectory import Trajectory

#: The schemes of the generated modules in the repository.
SCHEMES = ("midpoint", "simpson")
#: The functions that read robots, by the end of the file's name.
ROBOTS = {".urdf": "from_urdf", ".xml": "from_mjcf"}
#: The default final time of a run.
END = 10.0


def list_systems(options: argparse.Namespace) -> int:
    """Print the catalogue, or the joints of a robot."""
    from symsimpson.declare.robots.robot import Robot
    from symsimpson.systems import EVERY

    if options.robot:
        robot = find(options.robot)
        if not isinstance(robot, Robot):
            reject(
                f"{options.robot} is not a robot.",
                remedy="Pass a .urdf file, or a .xml file of MuJoCo.",
            )
        print(robot.table())
        return 0
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
            "the folder has no generated modules of the catalogue.",
            where=str(directory),
            remedy="This command is for changes of the generator. To use it, "
            "run it in a clone of the repository, or pass a folder with --directory. To verify "
            "your own module, use symsimpson certify FILE.",
        )
    for name in sorted(present - expected.keys()):
        print(f"other    {name}, which is not in the catalogue")
    findings = [f"missing  {name}" for name in sorted(expected.keys() - present)]
    findings += [
        f"stale    {name}"
        for name in sorted(expected.keys() & present)
        if (directory / name).read_bytes() != expected[name].encode()
    ]
    for finding in findings:
        print(finding)
    if findings:
        print("Run symsimpson generate to update them.", file=sys.stderr)
        return 1
    print(f"{len(expected)} generated modules are up to date.")
    return 0


def certify(options: argparse.Namespace) -> int:
    """Print the certificate of a stepper: measured order, symplecticity, drift and more."""
    from symsimpson.api.compiling import compile as compile_system
    from symsimpson.api.compiling import load

    path = Path(options.stepper)
    if path.suffix == ".py":
        if options.retimed:
            reject(
                "--retimed cannot be combined with a generated file.",
                remedy="Generate the file from the system with the time transformation.",
            )
        stepper = load(path)
    elif options.save:
        reject(
            f"--save needs a generated file, but {options.stepper} is not one.",
            remedy="Write the file with symsimpson generate.",
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
    from symsimpson.study.analysis.choose import choose as choose_scheme

    system = find(options.system, options.retimed)
    print(
        choose_scheme(
            system,
            **read_state(system, options),
            t_end=options.t_end,
            error=options.error,
            parameters=dict(options.parameters),
        )
    )
    return 0


def stress(options: argparse.Namespace) -> int:
    """Test a system with long runs and large steps."""
    from symsimpson.api.compiling import compile as compile_system
    from symsimpson.study.analysis.stability import stress as run_stress
    from symsimpson.study.analysis.stability import stress_standard

    if options.system is None:
        lines = stress_standard(options.scheme)
    else:
        stepper = compile_system(find(options.system, options.retimed), options.scheme)
        lines = run_stress(stepper, h=options.h, steps=options.steps)
    for line in lines:
        print(line, flush=True)
    return 0


def bench(options: argparse.Namespace) -> int:
    """Measure run time against error."""
    from symsimpson.study.bench.work_precision import WorkPrecision, work_precision

    if options.plot:  # raise errors before long measurements
        check_figure("plot", options.plot)
    if options.out and Path(options.out).suffix != ".json":
        reject(f"--out {options.out}: unknown format.", remedy="Use the extension .json.")
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
    """Integrate a system and print a summary."""
    from symsimpson.results.tables import check_kind

    if options.out:
        check_kind(Path(options.out))
        check_folder(Path(options.out), "file")
    system = find(options.system, options.retimed)  # loads SymPy, before the timing starts
    begin = time.perf_counter()
    stepper, given = _prepare_run(system, options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResolutionWarning)
        # compile and load everything that a run needs
        steps = max(1, min(16, _count_steps(options)))
        brief: dict[str, Any]
        brief = {"t_end": options.h} if stepper.program.header.retimed else {"steps": steps}
        if "inputs" in given:
            brief["inputs"] = {name: x[:steps] for name, x in given["inputs"].items()}
        for _ in range(2):
            raise_if_interrupted(
                stepper.integrate(**given | brief, h=options.h, on_failure="return")
            )
    ready = time.perf_counter()
    trajectory = _integrate(options, stepper, given)
    done = time.perf_counter()
    _print_report(trajectory, given)
    if trajectory.h != options.h:
        print(f"  {trajectory.message}")
    print(f"  derived and compiled in {ready - begin:.2f} s, run in {(done - ready) * 1e3:.2f} ms")
    if options.out:
        trajectory.save(options.out)
        print(f"  written to {options.out}")
    return 0


def plot(options: argparse.Namespace) -> int:
    """Plot a run to a file."""
    check_figure("out", options.out)
    if options.names and options.kind not in ("time", "phase"):
        reject(
            f"--kind {options.kind} does not plot {', '.join(options.names)}.",
            remedy="Leave the names out, or use --kind time or --kind phase.",
        )
    if options.kind == "phase" and len(options.names) > 2:
        reject(
            f"--kind phase plots two quantities, not {', '.join(options.names)}.",
            remedy="Pass two names, or one coordinate to plot its momentum over it.",
        )
    trajectory = _integrate(options, *_prepare_run(find(options.system, options.retimed), options))
    if options.kind == "time":
        ax = trajectory.plot(options.names or None)
    elif options.kind == "phase":
        ax = trajectory.plot_phase(*options.names[:2])
    else:
        ax = trajectory.plot_energy() if options.kind == "energy" else trajectory.plot_path()
    with atomic_path(Path(options.out), "figure") as file:
        ax.figure.savefig(file, bbox_inches="tight", dpi=150)
    print(f"written to {options.out}")
    return 0


def film(options: argparse.Namespace) -> int:
    """Write an animation of a run to a file."""
    check_folder(Path(options.out), "animation")
    trajectory = _integrate(options, *_prepare_run(find(options.system, options.retimed), options))
    animation = trajectory.animate(seconds=options.seconds, fps=options.fps)
    print(f"written to {animation.save(options.out)}")
    return 0


def _prepare_run(
    system: MechanicalSystem, options: argparse.Namespace
) -> tuple[Stepper, dict[str, Any]]:
    """Return the stepper, and the initial state, parameters and inputs of a run."""
    from symsimpson.api.compiling import compile as compile_system

    state = read_state(system, options)
    stepper = compile_system(system, options.scheme)
    given = state | {"parameters": dict(options.parameters)}
    return stepper, given | _read_inputs(options, stepper, _count_steps(options))


def _integrate(options: argparse.Namespace, stepper: Stepper, given: dict[str, Any]) -> Trajectory:
    return stepper.integrate(**given, **_run_length(options), every=options.every)


def _run_length(options: argparse.Namespace) -> dict[str, Any]:
    """Return h, t_end and steps; END is the default if both others are missing."""
    t_end = END if options.t_end is None and options.steps is None else options.t_end
    return {"h": options.h, "t_end": t_end, "steps": options.steps}


def _count_steps(options: argparse.Namespace) -> int:
    """Return the number of steps of a run; raise InputError if the options are invalid."""
    from symsimpson.program.numbers import FLOAT64
    from symsimpson.stepping.inputs import read_steps
    from symsimpson.stepping.request import Request

    return read_steps(Request(None, **_run_length(options)), FLOAT64)[1]


def _read_inputs(options: argparse.Namespace, stepper: Stepper, steps: int) -> dict[str, Any]:
    """Return inputs from the file of --inputs, with one value for each step."""
    if options.inputs is None and stepper.inputs and not stepper.program.default_inputs:
        reject(
            f"--inputs is missing: {stepper.system} has the inputs {', '.join(stepper.inputs)}.",
            remedy="Pass --inputs FILE, a .csv file. Its first line has the names of the inputs. "
            f"Each of the next {steps} lines has their values for one step.",
        )
    if options.inputs is None:
        return {}
    path = Path(options.inputs)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # NumPy warns of an empty file
            table = np.genfromtxt(
                path, delimiter=",", names=True, deletechars="", ndmin=1, encoding="utf-8-sig"
            )
    except (OSError, ValueError, UserWarning) as error:
        why = str(error).rstrip(".")
        reject(
            f"--inputs {path}: the file cannot be read: {why}.",
            remedy="The first line must have the names of the inputs. Each further line has their "
            "values for one step, separated by commas.",
        )
    names = table.dtype.names or ()
    if set(names) != set(stepper.inputs):
        reject(
            f"--inputs {path}: the columns are {', '.join(names) or 'none'}.",
            why=f"The inputs of {stepper.system} are {', '.join(stepper.inputs) or 'none'}.",
            remedy="Write one column for each input.",
        )
    if len(table) < steps:
        reject(
            f"--inputs {path}: the file has {len(table)} rows for {steps} steps.",
            remedy="Write one row for each step.",
        )
    return {"inputs": {name: table[name][:steps] for name in names}}


def _print_report(trajectory: Trajectory, given: dict[str, Any]) -> None:
    from symsimpson.results.html import iterations_a_step

    program, end = trajectory.program, float(trajectory.t[-1])
    if trajectory.every is not None and not program.header.retimed:
        # the final state may not be stored
        end = float(trajectory.t[0] + trajectory.h * trajectory.steps)
    print(f"{program.system}, {program.scheme} (order {program.order}), h = {trajectory.h:g}")
    for name in ("q0", "v0", "p0"):
        if name in given:
            print(f"  {name} = ({', '.join(f'{x:g}' for x in given[name])})")
    for name, value in given["parameters"].items():
        print(f"  {name} = {value:g}")
    iterations = iterations_a_step(trajectory)
    rate = "" if iterations is None else f", {iterations:.2f} Newton iterations a step"
    print(f"  {counted(trajectory.steps, 'step')} to t = {end:g}{rate}")
    if program.header.conservative:
        print(f"  largest relative energy error {np.abs(trajectory.energy_error).max():.2e}")
    else:
        last = trajectory.energy[-1] if trajectory.t[-1] == end else trajectory.at(end).energy[0]
        print(f"  energy {trajectory.energy[0]:.9g} at the start, {last:.9g} at the end")
    for name, values in trajectory.invariants.items():
        print(f"  {name}: {values[0]:.9g}, changed by at most {np.ptp(values):.1e}")


#: File extensions of figures.
FIGURES = (".png", ".pdf", ".svg")


def check_figure(option: str, path: str) -> None:
    """Check the file of a figure before any computation.

    Raises InputError if its format is unknown, and StorageError if its folder does not exist.
    """
    if Path(path).suffix not in FIGURES:
        reject(
            f"--{option} {path}: unknown format.",
            remedy=f"Use the extension {', '.join(FIGURES[:-1])} or {FIGURES[-1]}.",
        )
    check_folder(Path(path), "figure")


def read_state(system: MechanicalSystem, options: argparse.Namespace) -> dict[str, Any]:
    """Return the initial state of the options, or the reference state of the catalogue.

    Raises InputError if there is no complete state.
    """
    given = {k: getattr(options, k) for k in ("q0", "v0", "p0")}
    options_given = {k: x for k, x in given.items() if x is not None}
    state = options_given or dict(getattr(system, "reference_state", {}))
    if "q0" not in state:
        what = f"{' and '.join(f'--{k}' for k in options_given)} without --q0"
        what = what if options_given else f"{system.name} has no reference state"
        reject(f"{what}.", remedy="Pass --q0 and --v0 or --p0.")
    if ("v0" in state) == ("p0" in state):
        reject("--q0 needs exactly one of --v0 and --p0.", remedy="Pass numbers: --v0 0,0.")
    return state


def find(name: str, rate: str | None = None) -> MechanicalSystem:
    """Return a system of the catalogue or a file; ``rate`` is a time transformation."""
    system = _find_by_name(name)
    return system if rate is None else system.retimed(rate)


def _find_by_name(name: str) -> MechanicalSystem:
    from symsimpson.declare.system import MechanicalSystem
    from symsimpson.systems import CATALOGUE, EVERY

    if name in EVERY:
        return EVERY[name]()
    for make in CATALOGUE.values():
        system = make()
        if system.name == name:
            return system
    if (read := ROBOTS.get(Path(name).suffix.lower())) is not None:
        import symsimpson as ss

        return getattr(ss, read)(name)
    path, separator, attribute = name.rpartition(":")
    if not separator:
        if name.endswith(".py") and Path(name).is_file():
            reject(
                f"{name} is a file, but this command needs a system.",
                remedy=f"Name the variable that has the system: {name}:system. Only symsimpson "
                "certify accepts generated modules.",
            )
        reject(
            f"the catalogue has no system {name!r}.{did_you_mean(name, EVERY)}",
            remedy="Run symsimpson list to see the catalogue. For your own system, pass "
            "path/to/file.py:attribute. For a robot, pass path/to/robot.urdf.",
        )
    if not Path(path).is_file():
        reject(f"there is no file {path}.", remedy="Pass path/to/file.py:attribute.")
    with _run_as_script(path):
        remedy = f"Run python {path} to see the error."
        with _report_user_errors(f"{path}: the file cannot be run", remedy):
            spec = importlib.util.spec_from_file_location("symsimpson_user_file", path)
            if spec is None or spec.loader is None:
                raise ImportError("not a Python file")
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module  # dataclasses need this entry
            try:
                spec.loader.exec_module(module)
            except SystemExit as error:
                if error.code:  # None and 0 mean success
                    raise
        candidate = getattr(module, attribute, None)
        if callable(candidate) and not isinstance(candidate, MechanicalSystem):
            remedy = "The function must return a system, and is called without arguments."
            with _report_user_errors(f"{path}: {attribute}() returns no system", remedy):
                candidate = candidate()
    if not isinstance(candidate, MechanicalSystem):
        reject(
            f"{attribute!r} is not a MechanicalSystem.",
            where=path,
            remedy="Pass the name of a system, or of a function that returns one.",
        )
    return candidate


@contextlib.contextmanager
def _run_as_script(path: str) -> Iterator[None]:
    """Set ``sys.path`` and ``sys.argv`` as ``python path`` does, and restore them afterwards."""
    folder, before, arguments = Path(path).resolve().parent, {*sys.modules}, sys.argv
    sys.path.insert(0, str(folder))
    sys.argv = [path]
    try:
        yield
    finally:
        sys.argv = arguments
        with contextlib.suppress(ValueError):
            sys.path.remove(str(folder))
        for name in {*sys.modules} - before:  # another folder may have a module of this name
            if Path(getattr(sys.modules[name], "__file__", None) or "").parent == folder:
                del sys.modules[name]


@contextlib.contextmanager
def _report_user_errors(what: str, remedy: str) -> Iterator[None]:
    """Raise InputError for any exception of the user's code."""
    try:
        yield
    except SymsimpsonError:
        raise
    except SystemExit as error:
        reject(f"{what}: it calls sys.exit({error.code!r}).", remedy=remedy)
    except Exception as error:
        reject(f"{what}: {type(error).__name__}: {error}.", remedy=remedy, cause=error)
