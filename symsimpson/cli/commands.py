"""Commands about systems, modules and measurements."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from symsimpson.cli.find import check_figure, find, state_of
from symsimpson.errors import InputError
from symsimpson.support.files import check_folder

#: The schemes of which generated modules are kept.
SCHEMES = ("midpoint", "simpson")


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
        raise InputError(
            f"{directory}: there are no modules of the catalogue to compare.\nThis command is for "
            "changes of the generator: run it in a clone of the repository, or name a folder by "
            "--directory. symsimpson certify FILE measures a module of your own."
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
            raise InputError(
                "--retimed does not go with a generated file.\n"
                "Generate the file from the retimed system."
            )
        stepper = load(path)
    elif options.save:
        raise InputError(
            f"--save: {options.stepper} is no generated file.\nWrite it with symsimpson generate."
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
    from symsimpson.study.bench.record import WorkPrecision
    from symsimpson.study.bench.work_precision import work_precision

    if options.plot:  # before hours of measurements
        check_figure("plot", options.plot)
    if options.out and Path(options.out).suffix != ".json":
        raise InputError(f"--out {options.out}: unknown format.\nUse a name in .json.")
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
