"""The command line, thin over the public functions."""

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
    """Run a command; give 0, 1 after an error or a finding, 2 for wrong usage, 130 at Ctrl-C."""
    os.environ.setdefault(LATE, "late")  # a command takes a run or two
    try:
        options = _read(_joined(sys.argv[1:] if arguments is None else arguments))
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


def _read(arguments: list[str]) -> argparse.Namespace:
    """Read a command; names of quantities may stand behind options, too."""
    options, others = parser().parse_known_args(arguments)
    strange = [x.partition("=")[0] for x in others if x.startswith("-")]
    if strange:
        known = re.findall(r"--[\w-]+", options.parser.format_usage())
        options.parser.error(
            f"there is no option {strange[0]}.{did_you_mean(strange[0], known)}\n"
            f"{options.parser.prog} takes {', '.join(known) or 'none'}"
        )
    if others and "names" not in options:
        options.parser.error(f"unrecognized arguments: {' '.join(others)}")
    if others:
        options.names += others
    return options


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
        for category in (ModelWarning, StabilityWarning, ResolutionWarning):
            warnings.simplefilter("always", category)
        yield


def _joined(arguments: Sequence[str]) -> list[str]:
    """Join options with values that begin with a minus, which would look like options."""
    joined: list[str] = []
    for argument in arguments:
        if re.match(r"-[\d.]", argument) and joined and joined[-1].startswith("--"):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined
