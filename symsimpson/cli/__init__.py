"""The command line, a thin layer over the public functions."""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

from symsimpson.cli.parser import parser
from symsimpson.errors import ModelWarning, ResolutionWarning, StabilityWarning, SymsimpsonError
from symsimpson.support.interpreter import LATE
from symsimpson.support.names import did_you_mean

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status.

    The status is 0 for success, 1 for an error or a failed check, 2 for wrong usage, and 130 for
    Ctrl-C.
    """
    os.environ.setdefault(LATE, "late")  # a command does one or two runs only
    try:
        words = sys.argv[1:] if arguments is None else arguments
        options = _parse_arguments(_join_negative_values(words))
        with _print_warnings():
            return int(options.run(options))
    except SymsimpsonError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 130 if isinstance(error, KeyboardInterrupt) else 1
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 1


def _parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Parse a command; names of quantities may follow options, too."""
    options, others = parser().parse_known_args(arguments)
    unknown = [x.partition("=")[0] for x in others if x.startswith("-")]
    if unknown:
        known = re.findall(r"--[\w-]+", options.parser.format_usage())
        options.parser.error(
            f"there is no option {unknown[0]}.{did_you_mean(unknown[0], known)}\n"
            f"{options.parser.prog} takes {', '.join(known) or 'none'}"
        )
    if others and "names" not in options:
        options.parser.error(f"unrecognized arguments: {' '.join(others)}")
    if others:
        options.names += others
    return options


@contextlib.contextmanager
def _print_warnings() -> Iterator[None]:
    """Print each warning of symsimpson once, in the format of errors and without a code line."""
    with warnings.catch_warnings():
        printed: set[str] = set()

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if str(message) not in printed:
                print(f"{category.__name__}: {message}", file=sys.stderr)
            printed.add(str(message))

        warnings.showwarning = show
        for category in (ModelWarning, StabilityWarning, ResolutionWarning):
            warnings.simplefilter("always", category)
        yield


def _join_negative_values(arguments: Sequence[str]) -> list[str]:
    """Join options with negative values, which argparse would take for options."""
    words: list[str] = []
    for argument in arguments:
        if re.match(r"-[\d.]", argument) and words and words[-1].startswith("--"):
            words[-1] += f"={argument}"
        else:
            words.append(argument)
    return words
