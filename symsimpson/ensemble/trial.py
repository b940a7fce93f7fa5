"""Trials with a few members of a task: how long one takes, and side by side or one by one."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from symsimpson.ensemble.lanes import run_blocks
from symsimpson.ensemble.task import Task
from symsimpson.program.program import Program

#: A trial takes no more steps.
TRIAL_STEPS = 2000
#: Tasks of fewer steps of members are over before a trial pays; of others it takes this part.
WORTH_IT, PART = 200_000, 0.2
#: One by one must take so much less time, so that noise does not choose.
CLEARLY = 0.9
#: Members of a trial, and rounds of it.
FEW, ROUNDS = 16, 3


def seconds_of_member(program: Program, task: Task) -> float:
    """Estimate the time of one member on one thread, by a trial with a block of them.

    Raises KeyboardInterrupt.
    """
    return _seconds(program, task, task.lanes, rounds=1)


def with_fastest_lanes(program: Program, task: Task) -> Task:
    """Return a task whose members run one by one, if that is faster on this machine.

    Where steps are solved by stages, the nodes of one member fill a vector, too. Members side by
    side wait for each other, and need more of the cache; one by one, each waits for itself. Both
    leave the same bits.

    Raises KeyboardInterrupt at Ctrl-C; no member has been run by then.
    """
    small = task.members * task.steps < WORTH_IT or task.lanes == 1
    if small or task.retimed or not program.kernels_for(task.lanes).by_stages:
        return task
    known = program.findings.lanes
    if task.lanes not in known:
        whole = task.members * task.steps
        steps = int(PART * whole / (2 * (1 + ROUNDS) * max(task.lanes, FEW)))
        short = replace(task, steps=min(task.steps, max(1, steps)))
        beside, single = (_seconds(program, short, lanes, ROUNDS) for lanes in (task.lanes, 1))
        known[task.lanes] = 1 if single < CLEARLY * beside else task.lanes
    return replace(task, lanes=known[task.lanes])


def _seconds(program: Program, task: Task, lanes: int, rounds: int) -> float:
    """Estimate the time of a member in blocks of so many lanes, by the best of some rounds."""
    members = min(max(lanes, FEW), task.members)
    some = np.linspace(0, task.members - 1, members).astype(np.int64)
    steps = min(task.steps, TRIAL_STEPS)
    trial = replace(
        task.part(some),
        steps=steps,
        every=0,
        threads=1,
        lanes=lanes,
        reductions=(),
        run_events=None,
    )
    seconds = []
    for _ in range(1 + rounds):  # the first compiles
        begin = time.perf_counter()
        if run_blocks(program, trial, lambda done: None)[1]:  # which heard Ctrl-C
            raise KeyboardInterrupt
        seconds.append(time.perf_counter() - begin)
    parts = task.steps / steps if steps else 1.0  # as many as would take its time
    return max(min(seconds[1:]), 1e-9) * parts / members
