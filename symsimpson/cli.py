"""The command line, thin over the public functions."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import re
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symsimpson import __version__
from symsimpson.errors import (
    GenerationError,
    InputError,
    ResolutionWarning,
    StabilityWarning,
    SymsimpsonError,
)
from symsimpson.files import check_folder
from symsimpson.names import did_you_mean

if TYPE_CHECKING:
    from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["main"]

#: The schemes of which generated modules are kept.
SCHEMES = ("midpoint", "simpson")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; give 0, 1 after an error or a finding, 2 for wrong usage, 130 at Ctrl-C."""
    options = _parser().parse_args(_joined(sys.argv[1:] if arguments is None else arguments))
    try:
        with _warnings_in_words():
            return int(options.run(options))
    except SymsimpsonError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 130 if isinstance(error, KeyboardInterrupt) else 1
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 1


@contextlib.contextmanager
def _warnings_in_words() -> Iterator[None]:
    """Print our own warnings as errors are printed, each once, without a place in the code."""
    with warnings.catch_warnings():
        shown: set[str] = set()

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if str(message) not in shown:
                print(f"{category.__name__}: {message}", file=sys.stderr)
            shown.add(str(message))

        warnings.showwarning = show
        for category in (StabilityWarning, ResolutionWarning):
            warnings.simplefilter("always", category)
        yield


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="symsimpson", description="Variational integrators from kinetic and potential energy."
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    system = "name in the catalogue (symsimpson list), or path/to/file.py:attribute"
    another_time = "take steps that adapt, as of system.retimed(...): encounters or kinetic"

    command = commands.add_parser("list", help="list the systems of the catalogue")
    command.set_defaults(run=_list)

    command = commands.add_parser("generate", help="write generated modules")
    command.add_argument("system", nargs="*", help=f"{system}; none for the whole catalogue")
    command.add_argument("--scheme", action="append", help="scheme, may be repeated; default both")
    command.add_argument("--directory", default="generated", help="where (default: %(default)s)")
    command.set_defaults(run=_generate)

    command = commands.add_parser("check", help="compare generated modules with fresh ones")
    command.add_argument("--directory", default="generated", help="where (default: %(default)s)")
    command.set_defaults(run=_check)

    command = commands.add_parser("run", help="integrate a system and report")
    command.add_argument("system", help=system)
    command.add_argument("--retimed", help=another_time)
    command.add_argument("--scheme", default="simpson", help="default: %(default)s")
    command.add_argument("--h", type=float, default=0.01, help="step (default: %(default)s)")
    command.add_argument("--t-end", type=float, default=None, help="final time (default: 10)")
    command.add_argument("--steps", type=_count, default=None, help="number of steps instead")
    command.add_argument("--q0", type=_numbers, help="positions, as 0.8,1.0")
    command.add_argument("--v0", type=_numbers, help="velocities")
    command.add_argument("--p0", type=_numbers, help="momenta")
    command.add_argument("--every", type=int, default=1, help="steps between stored states")
    command.add_argument("--out", help="write t, q, p and energy to this .npz or .csv file")
    command.set_defaults(run=_run)

    command = commands.add_parser("certify", help="verify a stepper by measurement")
    command.add_argument("stepper", help=f"a generated file, or a {system}")
    command.add_argument("--retimed", help=another_time)
    command.add_argument("--scheme", default="simpson", help="of a system (default: %(default)s)")
    command.add_argument("--q0", type=_numbers, help="positions to measure at")
    command.add_argument("--v0", type=_numbers, help="velocities")
    command.add_argument("--p0", type=_numbers, help="momenta")
    command.add_argument("--h", type=float, help="step (default: found by trial)")
    command.add_argument("--save", action="store_true", help="write it beside the generated file")
    command.set_defaults(run=_certify)

    command = commands.add_parser(
        "stress", help="long runs, large steps, poles, chaos, large angles"
    )
    command.add_argument("system", nargs="?", help=f"{system}; none for the standard problems")
    command.add_argument("--retimed", help=another_time)
    command.add_argument("--scheme", default="simpson", help="default: %(default)s")
    command.add_argument("--h", type=float, help="step (default: found by trial)")
    command.add_argument("--steps", type=_count, default=10**6,
                         help="of the long run, as 1e9 (default: 1e6)")  # fmt: skip
    command.set_defaults(run=_stress)

    command = commands.add_parser("bench", help="run time against error, beside other programs")
    command.add_argument("system", nargs="?", help=f"{system}; none for the time of a step")
    command.add_argument("--retimed", help=another_time)
    command.add_argument("--schemes", type=_words, default=["midpoint", "simpson"],
                         help="as midpoint,simpson,gauss6")  # fmt: skip
    command.add_argument("--peers", type=_words,
                         help="as scipy,heyoka (default: all that are installed)")  # fmt: skip
    command.add_argument("--errors", type=_numbers, default=[1e-3, 1e-6, 1e-9, 1e-12])
    command.add_argument("--t-end", type=float, default=10.0, help="default: %(default)s")
    command.add_argument("--repeats", type=int, default=5, help="rounds (default: %(default)s)")
    command.add_argument("--out", help="write the record to this .json file")
    command.add_argument("--against", help="compare with the record in this .json file")
    command.add_argument("--plot", help="draw to this .png, .pdf or .svg file")
    command.add_argument("--ensemble", action="store_true", help="time ensembles instead")
    command.set_defaults(run=_bench)
    return parser


def _joined(arguments: Sequence[str]) -> list[str]:
    """Join options with values that begin with a minus, which would look like options."""
    found: list[str] = []
    for argument in arguments:
        if re.match(r"-[\d.]", argument) and found and found[-1].startswith("--"):
            found[-1] += f"={argument}"
        else:
            found.append(argument)
    return found


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no list of numbers, as 0.8,1.0") from None


def _count(text: str) -> int:
    try:
        number = float(text)
        if number >= 1 and number == int(number):
            return int(number)
    except (ValueError, OverflowError):
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 on, as 1000 or 1e6")


def _words(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _list(options: argparse.Namespace) -> int:
    from symsimpson.systems import EVERY

    for name, make in EVERY.items():
        system = make()
        first = (make.__doc__ or "").splitlines()[0]
        print(f"{name:<20} n = {system.n:<4} {first}")
    return 0


def _generate(options: argparse.Namespace) -> int:
    from symsimpson.api import generate
    from symsimpson.systems import CATALOGUE

    for name in options.system or CATALOGUE:
        system = _find(name)
        for scheme in options.scheme or SCHEMES:
            print(generate(system, scheme, options.directory))
    return 0


def _check(options: argparse.Namespace) -> int:
    from symsimpson.codegen.pipeline import source
    from symsimpson.systems import CATALOGUE

    directory = Path(options.directory)
    expected = {}
    for make in CATALOGUE.values():
        system = make()
        for scheme in SCHEMES:
            expected[f"{system.name}__{scheme}.py"] = source(system, scheme)
    present = {path.name for path in directory.glob("*.py")}
    findings = [f"missing  {name}" for name in sorted(expected.keys() - present)]
    findings += [f"extra    {name}" for name in sorted(present - expected.keys())]
    findings += [
        f"stale    {name}"
        for name in sorted(expected.keys() & present)
        if (directory / name).read_bytes() != expected[name].encode()
    ]
    for finding in findings:
        print(finding)
    if findings:
        print("Run symsimpson generate, and delete what is extra.", file=sys.stderr)
        return 1
    print(f"{len(expected)} generated modules are up to date.")
    return 0


def _run(options: argparse.Namespace) -> int:
    import numpy as np

    from symsimpson.api import compile as compile_system

    system = _find(options.system, options.retimed)
    state = {k: getattr(options, k) for k in ("q0", "v0", "p0") if getattr(options, k) is not None}
    if not state:
        state = dict(getattr(system, "reference_state", {}))
    if "q0" not in state:
        raise InputError(f"{system.name} has no reference state.\nPass --q0 and --v0 or --p0.")
    if options.out and Path(options.out).suffix not in (".npz", ".csv"):
        raise InputError(f"--out {options.out}: unknown format.\nUse a name in .npz or .csv.")
    if options.out:
        check_folder(Path(options.out), "table")
    t_end = 10.0 if options.t_end is None and options.steps is None else options.t_end
    begin = time.perf_counter()
    stepper = compile_system(system, options.scheme)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResolutionWarning)
        # compiles all that a run needs
        brief = {"t_end": options.h} if stepper._module.header.retimed else {"steps": 16}
        stepper.integrate(**state, h=options.h, **brief, on_failure="return")
    ready = time.perf_counter()
    run = stepper.integrate(
        **state, h=options.h, t_end=t_end, steps=options.steps, every=options.every
    )
    done = time.perf_counter()
    steps = max(run.steps, 1)
    print(f"{system.name}, {stepper.scheme} (order {stepper.order}), h = {run.h:g}")
    for name, value in state.items():
        print(f"  {name} = ({', '.join(f'{x:g}' for x in value)})")
    last = run.newton_iterations.sum() / steps
    print(f"  {run.steps} steps to t = {run.t[-1]:g}, {last:.2f} Newton iterations a step")
    if stepper._module.header.conservative:
        print(f"  largest relative energy error {np.abs(run.energy_error).max():.2e}")
    else:
        print(f"  energy {run.energy[0]:.9g} at the start, {run.energy[-1]:.9g} at the end")
    for name, values in run.invariants.items():
        print(f"  {name}: {values[0]:.9g}, changed by at most {np.ptp(values):.1e}")
    print(f"  derived and compiled in {ready - begin:.2f} s, run in {(done - ready) * 1e3:.2f} ms")
    if options.out:
        _write(Path(options.out), run, stepper.coordinates)
        print(f"  written to {options.out}")
    return 0


def _certify(options: argparse.Namespace) -> int:
    from symsimpson.api import compile as compile_system
    from symsimpson.api import load

    path = Path(options.stepper)
    if path.suffix == ".py" and options.retimed:
        raise InputError("--retimed is for systems.\nA generated file is what it is.")
    if path.suffix == ".py":
        stepper = load(path)
    elif options.save:
        raise InputError(
            f"--save: {options.stepper} is no generated file.\nWrite it with symsimpson generate."
        )
    else:
        stepper = compile_system(_find(options.stepper, options.retimed), options.scheme)
    found = stepper.certify(options.q0, options.v0, p0=options.p0, h=options.h)
    print(found)
    if options.save:
        print(f"  written to {found.save(path.with_suffix('.certificate.json'))}")
    return 0 if found.passed else 1


def _stress(options: argparse.Namespace) -> int:
    from symsimpson.analysis.stability import stress, stress_standard
    from symsimpson.api import compile as compile_system

    if options.system is None:
        lines = stress_standard(options.scheme)
    else:
        stepper = compile_system(_find(options.system, options.retimed), options.scheme)
        lines = stress(stepper, h=options.h, steps=options.steps)
    for line in lines:
        print(line, flush=True)
    return 0


def _write(path: Path, run: object, coordinates: tuple[str, ...]) -> None:
    import numpy as np

    columns = {name: getattr(run, name) for name in ("t", "q", "p", "energy")}
    try:
        if path.suffix == ".npz":
            np.savez(path, **columns)
        else:
            head = ["t", *coordinates, *(f"p_{q}" for q in coordinates), "energy"]
            table = np.column_stack(list(columns.values()))
            np.savetxt(path, table, delimiter=",", header=",".join(head), comments="", fmt="%.17g")
    except OSError as error:
        raise GenerationError(
            f"{path}: cannot be written: {error.strerror}.\nChoose another file."
        ) from error


def _bench(options: argparse.Namespace) -> int:
    from symsimpson.bench import ensembles, speed

    if options.system is None:
        for line in (ensembles if options.ensemble else speed).report():
            print(line, flush=True)
        return 0
    from symsimpson.bench.record import WorkPrecision
    from symsimpson.bench.work_precision import work_precision

    for name, known in (("plot", (".png", ".pdf", ".svg")), ("out", (".json",))):
        path = getattr(options, name)
        if path and Path(path).suffix not in known:  # before hours of measurements
            raise InputError(
                f"--{name} {path}: unknown format.\nUse a name in {' or '.join(known)}."
            )
        if path:
            check_folder(Path(path), "record" if name == "out" else "figure")
    before = WorkPrecision.load(options.against) if options.against else None
    found = work_precision(
        _find(options.system, options.retimed), options.schemes, options.peers or "installed",
        options.errors,
        t_end=options.t_end, repeats=options.repeats,
    )  # fmt: skip
    print(found)
    if before is not None:
        print(found.compare(before))
    if options.out:
        print(f"written to {found.save(options.out)}")
    if options.plot:
        found.plot().figure.savefig(options.plot)
    return 0


def _find(name: str, rate: str | None = None) -> MechanicalSystem:
    """Find a system by its name in the catalogue or by file and attribute; in another time."""
    found = _named(name)
    return found if rate is None else found.retimed(rate)


def _named(name: str) -> MechanicalSystem:
    from symsimpson.mechanics.system import MechanicalSystem
    from symsimpson.systems import CATALOGUE, EVERY

    if name in EVERY:
        return EVERY[name]()
    for make in CATALOGUE.values():
        system = make()
        if system.name == name:
            return system
    path, separator, attribute = name.rpartition(":")
    if not separator:
        raise InputError(
            f"there is no system {name!r} in the catalogue.{did_you_mean(name, EVERY)}\n"
            "symsimpson list shows it. For your own system give path/to/file.py:attribute."
        )
    try:
        spec = importlib.util.spec_from_file_location("symsimpson_user_file", path)
        if spec is None or spec.loader is None:
            raise ImportError("not a Python file")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    except SymsimpsonError:
        raise
    except Exception as error:  # the user's file may raise anything
        raise InputError(
            f"{path}: the file cannot be run: {type(error).__name__}: {error}"
        ) from error
    found = getattr(module, attribute, None)
    found = found() if callable(found) and not isinstance(found, MechanicalSystem) else found
    if not isinstance(found, MechanicalSystem):
        raise InputError(
            f"{path}: {attribute!r} is no MechanicalSystem.\n"
            "Give the name of a variable that holds one, or of a function that makes one."
        )
    return found
