"""The parser of all commands and their options."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from symsimpson import __version__
from symsimpson.cli import commands
from symsimpson.support.extras import import_library
from symsimpson.support.names import did_you_mean

SYSTEM = "name in the catalogue (symsimpson list), path/to/file.py:attribute, or robot.urdf"
#: A function that adds an argument to a command.
Add = Callable[..., Any]
SHELLS = ("bash", "zsh")


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = _Parser(
        prog="symsimpson", description="Variational integrators from kinetic and potential energy."
    )
    top.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    top.add_argument(
        "--print-completion",
        choices=SHELLS,
        action=_Completion,
        help="print the completion script of this shell",
    )
    given = top.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Any, words: str, *parents: Any) -> Add:
        command_parser = given.add_parser(
            name,
            help=words,
            description=words,
            parents=list(parents),
            allow_abbrev=False,  # --h is not --help
        )
        command_parser.set_defaults(run=run, parser=command_parser)
        return command_parser.add_argument

    add = command("list", commands.list_systems, "list the catalogue, or the joints of a robot")
    add("robot", nargs="?", help="a .urdf file, or a .xml file of MuJoCo")

    add = command(
        "run", commands.run, "integrate a system and report", _build_state(), _build_run()
    )
    add("--out", help="write the run to this .nc, .zarr, .npz, .csv or .parquet file")

    add = command("plot", commands.plot, "plot a run", _build_state(), _build_run())
    add("names", nargs="*", help="quantities over time, as q1 energy; or x y: points")
    add(
        "--kind",
        choices=("time", "phase", "energy", "path"),
        default="time",
        help="kind of figure (default: %(default)s)",
    )
    add("--out", required=True, help="write to this .png, .pdf or .svg file")

    add = command("film", commands.film, "animate a system", _build_state(), _build_run())
    add("--seconds", type=float, help="length of the animation, in seconds")
    add("--fps", type=int, default=20, help="frames per second (default: %(default)s)")
    add("--out", required=True, help="write to this .html, .gif, .mp4 or .png file")

    add = command("choose", commands.choose, "choose a scheme and a step size", _build_state())
    add("--t-end", type=float, default=10.0, help="final time (default: %(default)s)")
    add("--error", type=float, required=True, help="error of the final state, for example 1e-6")

    add = command("certify", commands.certify, "verify a stepper by numerical tests")
    add("stepper", help=f"a generated file, or a {SYSTEM}")
    _add_state(add)
    add("--scheme", default="simpson", help="scheme of a system (default: %(default)s)")
    add("--h", type=float, help="step (default: found by trial)")
    add("--save", action="store_true", help="save the certificate next to the generated file")

    add = command("generate", commands.generate, "write generated modules")
    add("system", nargs="*", help=f"{SYSTEM} (default: the whole catalogue)")
    add("--scheme", action="append", help="scheme, may be repeated (default: midpoint and simpson)")
    add("--directory", default="generated", help="where (default: %(default)s)")

    add = command(
        "check",
        commands.check,
        "check that the generated modules of the catalogue match the generator",
    )
    add("--directory", default="generated", help="where (default: %(default)s)")

    add = command("export", commands.export, "export the steps of a system to another language")
    add("system", help=SYSTEM)
    add("--scheme", default="simpson", help="default: %(default)s")
    add("--language", choices=("c",), default="c", help="default: %(default)s, C99")
    add("--out", required=True, help="path of the files without extension")

    add = command("stress", commands.stress, "test long runs and large steps")
    add("system", nargs="?", help=f"{SYSTEM} (default: the standard problems)")
    _add_time(add)
    add("--scheme", default="simpson", help="default: %(default)s")
    add("--h", type=float, help="step (default: found by trial)")
    add("--steps", type=count, default=10**6, help="number of steps of the long run (default: 1e6)")

    add = command("bench", commands.bench, "measure run time against error, also of other programs")
    add("system", help=SYSTEM)
    _add_time(add)
    add("--schemes", type=words, default=["midpoint", "simpson"], help="as midpoint,simpson,gauss6")
    add("--peers", type=words, help="programs, for example scipy,heyoka (default: all installed)")
    add(
        "--errors",
        type=numbers,
        default=[1e-3, 1e-6, 1e-9, 1e-12],
        help="error levels (default: 1e-3,1e-6,1e-9,1e-12)",
    )
    add("--t-end", type=float, default=10.0, help="final time (default: %(default)s)")
    add("--repeats", type=int, default=5, help="rounds of timings (default: %(default)s)")
    add("--out", help="write the record to this .json file")
    add("--against", help="compare with the record in this .json file")
    add("--plot", help="draw to this .png, .pdf or .svg file")
    return top


def _build_state() -> argparse.ArgumentParser:
    """Return a parser for a system, its parameters and its initial state."""
    parent = argparse.ArgumentParser(add_help=False)
    parent.add_argument("system", help=SYSTEM)
    _add_state(parent.add_argument)
    return parent


def _add_state(add: Add) -> None:
    add(
        "--set",
        type=value,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="parameters",
        help="value of a parameter, may be repeated",
    )
    add("--q0", type=numbers, help="initial coordinates, for example 0.8,1.0")
    add("--v0", type=numbers, help="initial velocities")
    add("--p0", type=numbers, help="initial momenta")
    _add_time(add)


def _add_time(add: Add) -> None:
    add(
        "--retimed",
        metavar="RATE",
        help="time transformation of system.retimed(...): encounters or kinetic",
    )


def _build_run() -> argparse.ArgumentParser:
    """Return a parser for a scheme, a step size, the length of a run, and inputs."""
    parent = argparse.ArgumentParser(add_help=False)
    add = parent.add_argument
    add("--scheme", default="simpson", help="default: %(default)s")
    add("--h", type=float, default=0.01, help="step (default: %(default)s)")
    add("--t-end", type=float, default=None, help="final time (default: 10)")
    add("--steps", type=count, default=None, help="number of steps, in place of --t-end")
    add("--every", type=int, default=1, help="steps between stored states")
    add("--inputs", help=".csv file with a column for each input and a row for each step")
    return parent


class _Parser(argparse.ArgumentParser):
    """A parser whose errors suggest a valid choice."""

    def error(self, message: str) -> NoReturn:
        wrong = re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message)
        hint = did_you_mean(wrong[1], re.findall(r"[\w-]+", wrong[2])) if wrong else ""
        super().error(message + hint)


class _Completion(argparse.Action):
    """Print the completion script that shtab makes, and exit."""

    def __call__(self, top: Any, options: Any, shell: Any, option: Any = None) -> None:
        shtab = import_library("shtab", "completion", "completion")
        print(shtab.complete(top, shell=shell))
        top.exit()


def numbers(text: str) -> list[float]:
    """Return the numbers of a comma-separated list."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        what = f"{text!r} is not a list of numbers like 0.8,1.0"
        raise argparse.ArgumentTypeError(what) from None


def value(text: str) -> tuple[str, float]:
    """Return the name and the value of a parameter."""
    name, separator, number = text.partition("=")
    try:
        if separator and name.strip():
            return name.strip(), float(number)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is not a parameter with a value like R=0.4")


def count(text: str) -> int:
    """Return a number of steps, which may be written as 1e6."""
    try:
        number = float(text)
        if number >= 1 and number == int(number):
            return int(number)
    except (ValueError, OverflowError):
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is not a positive whole number like 1000 or 1e6")


def words(text: str) -> Sequence[str]:
    """Return the names of a comma-separated list."""
    return [part.strip() for part in text.split(",") if part.strip()]
