"""Who takes part: our schemes, and other programs where they are installed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from symsimpson.api.compiling import compile as compile_system
from symsimpson.bench.benchmark_problem import Problem
from symsimpson.bench.contender import Contender, Outcome, Runnable, numbers_of_steps
from symsimpson.bench.programs import PROGRAMS
from symsimpson.errors import InputError
from symsimpson.mechanics.retimed import RetimedSystem
from symsimpson.run.ended import uninterrupted
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.names import in_a_row

__all__ = ["ours", "peers", "read_peers"]


def ours(
    problem: Problem, scheme: str | Scheme, retimed: RetimedSystem | None = None
) -> Contender[Runnable]:
    """Return one of our schemes; it counts Newton iterations.

    In the time of a retimed system, choices are numbers of steps as long as the first.
    """
    stepper = compile_system(retimed or problem.system, scheme)

    def make(steps: float) -> Runnable:
        count = int(steps)
        h = problem.t_end / count
        length = {"steps": count} if retimed is None else {"t_end": problem.t_end}

        def run() -> Any:
            start: dict[str, Any] = {"q0": problem.q0, "p0": problem.p0, "h": h, **length}
            return uninterrupted(stepper.integrate(**start, every=None, on_failure="return"))

        def read(trajectory: Any) -> Outcome:
            failed = np.full(stepper.n, np.nan)
            q, p = (trajectory.q[0], trajectory.p[0]) if trajectory.success else (failed, failed)
            return Outcome(q, p, int(trajectory.newton_iterations.sum()))

        return run, read

    name, choices = stepper.scheme, numbers_of_steps(problem)
    if retimed is not None:  # these adapt: fewer are enough
        coarse = [round(choices[0] * 2 ** (k / 4)) for k in range(-8, 0)]
        name, choices = f"{name} retimed", [count for count in coarse if count >= 4] + choices
    return Contender(name, "steps", choices, make)


def read_peers(names: Any) -> list[str]:
    """Return names of other programs, of which there are such; raises InputError."""
    if names == "installed":
        return list(PROGRAMS)
    wanted = list(in_a_row(names))
    for name in wanted:
        if name not in PROGRAMS:
            raise InputError(
                f"there is no peer {name!r}.\nThere are {', '.join(PROGRAMS)}; () is none of them."
            )
    return wanted


def peers(
    problem: Problem, names: str | Sequence[str] = "installed"
) -> Iterator[Contender[Runnable]]:
    """Return the other programs: those named, or all that are installed.

    Raises InputError if one is unknown, or named and not installed.
    """
    for name in read_peers(names):
        try:
            yield from PROGRAMS[name](problem)
        except ImportError as error:
            if names != "installed":
                raise InputError(
                    f"the peer {name!r} is not installed: {error}.\n"
                    "Install it with pip install 'symsimpson[bench]', or leave it out."
                ) from None
