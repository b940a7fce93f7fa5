"""Who takes part: our schemes, and other programs where they are installed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from symsimpson.api import compile as compile_system
from symsimpson.bench.contender import Contender, Outcome, Runnable, numbers_of_steps
from symsimpson.bench.problem import Problem
from symsimpson.bench.programs import PROGRAMS
from symsimpson.errors import InputError
from symsimpson.schemes.scheme import Scheme

__all__ = ["adapting", "ours", "peers"]


def ours(problem: Problem, scheme: str | Scheme) -> Contender[Runnable]:
    """Return one of our schemes; it counts Newton iterations."""
    stepper = compile_system(problem.system, scheme)

    def make(steps: float) -> tuple[Callable[[], Any], Callable[[Any], Outcome]]:
        count = int(steps)
        h = problem.t_end / count

        def run() -> Any:
            return stepper.integrate(
                problem.q0, p0=problem.p0, h=h, steps=count, every=None, on_failure="return"
            )

        def read(found: Any) -> Outcome:
            failed = np.full(stepper.n, np.nan)
            good = found.steps == count
            q, p = (found.q[0], found.p[0]) if good else (failed, failed)
            return Outcome(q, p, int(found.newton_iterations.sum()))

        return run, read

    return Contender(stepper.scheme, "steps", numbers_of_steps(problem), make)


def adapting(problem: Problem, scheme: str | Scheme) -> Contender[Runnable]:
    """Return one of our schemes in the time of a retimed system; counts steps of the first size."""
    assert problem.retimed is not None
    stepper = compile_system(problem.retimed, scheme)

    def make(parts: float) -> tuple[Callable[[], Any], Callable[[Any], Outcome]]:
        h = problem.t_end / int(parts)

        def run() -> Any:
            return stepper.integrate(
                problem.q0, p0=problem.p0, h=h, t_end=problem.t_end, every=None,
                on_failure="return",
            )  # fmt: skip

        def read(found: Any) -> Outcome:
            failed = np.full(stepper.n, np.nan)
            q, p = (found.q[0], found.p[0]) if found.success else (failed, failed)
            return Outcome(q, p, int(found.newton_iterations.sum()))

        return run, read

    fixed = numbers_of_steps(problem)
    coarse = [round(fixed[0] * 2 ** (k / 4)) for k in range(-8, 0)]  # these adapt
    choices = [count for count in coarse if count >= 4] + fixed
    return Contender(f"{stepper.scheme} retimed", "steps", choices, make)


def peers(
    problem: Problem, names: str | Sequence[str] = "installed"
) -> Iterator[Contender[Runnable]]:
    """Return the other programs: those named, or all that are installed.

    Raises
    ------
    InputError
        If one is unknown, or named and not installed.
    """
    wanted = (
        list(PROGRAMS) if names == "installed" else [names] if isinstance(names, str) else names
    )
    for name in wanted:
        if name not in PROGRAMS:
            raise InputError(f"there is no peer {name!r}.\nThere are {', '.join(PROGRAMS)}.")
        try:
            yield from PROGRAMS[name](problem)
        except ImportError as error:
            if names != "installed":
                raise InputError(
                    f"the peer {name!r} is not installed: {error}.\n"
                    "Install it with pip install 'symsimpson[bench]', or leave it out."
                ) from None
