"""The parser of all commands, and of what they take."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from symsimpson import __version__
from symsimpson.cli import commands
from symsimpson.support.extras import library
from symsimpson.support.names import did_you_mean

SYSTEM = "name in the catalogue (symsimpson list), or path/to/file.py:attribute"
#: Adds an argument to a command.
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
        help="print what completes commands in this shell",
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

    command("list", commands.list_systems, "list the systems of the catalogue")

    add = command("run", commands.run, "integrate a system and report", _state(), _length())
    add("--out", help="write the run to this .nc, .zarr, .npz, .csv or .parquet file")

    add = command("plot", commands.plot, "draw a run", _state(), _length())
    add("names", nargs="*", help="quantities over time, as q1 energy; or x y: points")
    add(
        "--kind",
        choices=("time", "phase", "energy", "path"),
        default="time",
        help="what is drawn (default: %(default)s)",
    )
    add("--out", required=True, help="write to this .png, .pdf or .svg file")

    add = command("film", commands.film, "film the points of a system", _state(), _length())
    add("--seconds", type=float, help="length of the film")
    add("--fps", type=int, default=20, help="frames a second (default: %(default)s)")
    add("--out", required=True, help="write to this .html, .gif, .mp4 or .png file")

    add = command("choose", commands.choose, "find a scheme and a step for an error", _state())
    add("--t-end", type=float, default=10.0, help="final time (default: %(default)s)")
    add("--error", type=float, required=True, help="of the end state, as 1e-6")

    add = command("certify", commands.certify, "verify a stepper by measurement")
    add("stepper", help=f"a generated file, or a {SYSTEM}")
    _add_state(add)
    add("--scheme", default="simpson", help="of a system (default: %(default)s)")
    add("--h", type=float, help="step (default: found by trial)")
    add("--save", action="store_true", help="write it beside the generated file")

    add = command("generate", commands.generate, "write generated modules")
    add("system", nargs="*", help=f"{SYSTEM}; none for the whole catalogue")
    add("--scheme", action="append", help="scheme, may be repeated; default both")
    add("--directory", default="generated", help="where (default: %(default)s)")

    add = command(
        "check",
        commands.check,
        "compare the catalogue's generated modules with fresh ones, where the generator is changed",
    )
    add("--directory", default="generated", help="where (default: %(default)s)")

    add = command("export", commands.export, "write the steps in another language")
    add("system", help=SYSTEM)
    add("--scheme", default="simpson", help="default: %(default)s")
    add("--language", choices=("c",), default="c", help="default: %(default)s, C99")
    add("--out", required=True, help="the files, without an ending: firmware/top")

    add = command("stress", commands.stress, "long runs, large steps, poles, chaos, large angles")
    add("system", nargs="?", help=f"{SYSTEM}; none for the standard problems")
    _add_time(add)
    add("--scheme", default="simpson", help="default: %(default)s")
    add("--h", type=float, help="step (default: found by trial)")
    add("--steps", type=count, default=10**6, help="of the long run, as 1e9 (default: 1e6)")

    add = command("bench", commands.bench, "run time against error, beside other programs")
    add("system", help=SYSTEM)
    _add_time(add)
    add("--schemes", type=words, default=["midpoint", "simpson"], help="as midpoint,simpson,gauss6")
    add("--peers", type=words, help="as scipy,heyoka (default: all installed)")
    add(
        "--errors",
        type=numbers,
        default=[1e-3, 1e-6, 1e-9, 1e-12],
        help="levels of the table (default: 1e-3,1e-6,1e-9,1e-12)",
    )
    add("--t-end", type=float, default=10.0, help="default: %(default)s")
    add("--repeats", type=int, default=5, help="rounds (default: %(default)s)")
    add("--out", help="write the record to this .json file")
    add("--against", help="compare with the record in this .json file")
    add("--plot", help="draw to this .png, .pdf or .svg file")
    return top


def _state() -> argparse.ArgumentParser:
    """Return the options of a system, its parameters and its state."""
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
    add("--q0", type=numbers, help="positions, as 0.8,1.0")
    add("--v0", type=numbers, help="velocities")
    add("--p0", type=numbers, help="momenta")
    _add_time(add)


def _add_time(add: Add) -> None:
    add(
        "--retimed",
        metavar="RATE",
        help="take steps that adapt, as of system.retimed(...): encounters or kinetic",
    )


def _length() -> argparse.ArgumentParser:
    """Return the options of a scheme, steps and inputs."""
    parent = argparse.ArgumentParser(add_help=False)
    add = parent.add_argument
    add("--scheme", default="simpson", help="default: %(default)s")
    add("--h", type=float, default=0.01, help="step (default: %(default)s)")
    add("--t-end", type=float, default=None, help="final time (default: 10)")
    add("--steps", type=count, default=None, help="number of steps instead")
    add("--every", type=int, default=1, help="steps between stored states")
    add("--inputs", help="a .csv file with a column for each input, a row for a step")
    return parent


class _Parser(argparse.ArgumentParser):
    """A parser whose errors name what a wrong choice may mean."""

    def error(self, message: str) -> NoReturn:
        wrong = re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message)
        hint = did_you_mean(wrong[1], re.findall(r"[\w-]+", wrong[2])) if wrong else ""
        super().error(message + hint)


class _Completion(argparse.Action):
    """Print what completes commands, by shtab, and end."""

    def __call__(self, top: Any, options: Any, shell: Any, option: Any = None) -> None:
        shtab = library("shtab", "completion", "completion")
        print(shtab.complete(top, shell=shell))
        top.exit()


def numbers(text: str) -> list[float]:
    """Read numbers between commas."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no list of numbers, as 0.8,1.0") from None


def value(text: str) -> tuple[str, float]:
    """Read the value of a parameter."""
    name, separator, number = text.partition("=")
    try:
        if separator and name.strip():
            return name.strip(), float(number)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is no value of a parameter, as R=0.4")


def count(text: str) -> int:
    """Read a number of steps."""
    try:
        number = float(text)
        if number >= 1 and number == int(number):
            return int(number)
    except (ValueError, OverflowError):
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 on, as 1000 or 1e6")


def words(text: str) -> Sequence[str]:
    """Read names between commas."""
    return [part.strip() for part in text.split(",") if part.strip()]
