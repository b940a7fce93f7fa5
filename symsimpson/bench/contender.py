"""Who is compared: one program on one problem, with choices from coarse to fine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from symsimpson.analysis.stability.frequency import largest_frequency
from symsimpson.bench.benchmark_problem import Problem
from symsimpson.support.array_types import Floats

__all__ = [
    "COARSE",
    "TOLERANCES",
    "Contender",
    "Outcome",
    "Runnable",
    "alternate",
    "numbers_of_steps",
]

#: What a contender makes of a choice.
Made = TypeVar("Made")

#: Tolerances from coarse to fine.
TOLERANCES = tuple(10.0 ** (-k / 2) for k in range(2, 31))
COARSE = TOLERANCES[::2]
#: Steps begin at this, times the fastest oscillation at the start.
COARSEST = 8.0


@dataclass(frozen=True)
class Outcome:
    """The state at the end of one run, and the work that it took."""

    q: Floats
    p: Floats
    evaluations: int


@dataclass(frozen=True)
class Contender(Generic[Made]):
    """A program that solves a problem to an accuracy that can be chosen."""

    name: str
    what: str
    choices: Sequence[float]  #: From coarse to fine; ``what`` says of what.
    make: Callable[[float], Made]  #: Gives for a choice what runs it.


#: A function without arguments that runs, and one that reads the outcome of what it returns.
Runnable = tuple[Callable[[], Any], Callable[[Any], Outcome]]


def numbers_of_steps(problem: Problem) -> list[int]:
    """Return numbers of steps from coarse to fine; none leaves out an oscillation."""
    values = problem.system.parameters.values()
    turns = problem.t_end * largest_frequency(problem.system, problem.q0, values) / COARSEST
    least = max(4, round(problem.t_end / 2), round(turns))
    return [round(least * 2 ** (k / 4)) for k in range(80)]


def alternate(jobs: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, list[float]]:
    """Return seconds of jobs that run in turns: what disturbs the machine disturbs all of them."""
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            begin = time.perf_counter()
            job()
            times[name].append(time.perf_counter() - begin)
    return times
