"""Many trajectories at once: members are lanes of blocks, blocks are spread over threads."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.observed import KINDS
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, driver_layout, growth, with_clock
from symsimpson.program.status import Status
from symsimpson.run.ensemble.ensemble import Ensemble
from symsimpson.run.ensemble.members import Results, Task, ensemble_of
from symsimpson.run.ensemble.singles import PAIR, RENEWAL, run_singly
from symsimpson.run.lyapunov import first_columns, first_part
from symsimpson.stepping.parts import reduced_at_ends, states_at
from symsimpson.stepping.spec import recorders_of
from symsimpson.support.array_types import Floats
from symsimpson.support.interpreter import listening
from symsimpson.text.interface import ARRIVED


def take_last_parts(program: Program, task: Task, results: Results) -> None:
    """Take the parts of steps up to the ends of members, unless states before are stored."""
    arrived = np.flatnonzero(results.codes[:, 0] == ARRIVED)
    results.codes[arrived, 0] = Status.SUCCESS
    if task.every or not arrived.size:
        return
    states = tuple(np.ascontiguousarray(x[arrived, 0]) for x in (results.q, results.p))
    part, q, p, fine = states_at(
        program,
        task.parameters[arrived],
        task.h,
        (results.recorded[arrived, 0, 0], *states),
        np.arange(arrived.size),
        np.full(arrived.size, task.t_end),
        1,
    )
    if task.reductions:
        fine_ones, count = arrived[fine], 2 * len(task.reductions)
        before = (results.recorded[fine_ones, 0, 0], *(x[fine] for x in states))
        ends = np.full(len(fine_ones), task.t_end), q[fine], p[fine]
        seen = results.seen[fine_ones, :count:2]
        given = program, task.reductions, task.parameters[fine_ones]
        results.seen[fine_ones, :count:2] = reduced_at_ends(*given, before, ends, seen)
    results.q[arrived, 0], results.p[arrived, 0] = q, p
    results.recorded[arrived, 0, 0], results.part[arrived] = task.t_end, part
    results.codes[arrived[~fine], 0] = Status.NOT_CONVERGED


def with_ends(ensemble: Ensemble, ends: Ensemble, every: int) -> Ensemble:
    """Return members that have every so-many-th state with the state at the end behind them.

    One that did not reach its ``ends`` has the states before that and its status.
    """
    steps = np.minimum(ensemble.steps, ends.steps)
    status = np.where(ends.status == Status.SUCCESS, ensemble.status, ends.status)
    place = steps // every + 1
    last = np.take_along_axis(ensemble.t, place[:, None] - 1, axis=1)[:, 0]
    some = np.flatnonzero((status == Status.SUCCESS) & (last != ends.t))
    stored = int(max(place.max(), 1 + place[some].max(initial=0)))
    columns: dict[str, Any] = {}
    for name in ("t", "tau", "q", "p"):
        column = getattr(ensemble, name)
        columns[name] = np.full((len(column), stored, *column.shape[2:]), np.nan)
        room = min(stored, column.shape[1])
        columns[name][:, :room] = column[:, :room]
        columns[name][np.arange(stored) >= place[:, None]] = np.nan
        columns[name][some, place[some]] = getattr(ends, name)[some]
    return replace(ensemble, **columns, status=status, steps=steps, reduced=ends.reduced)


#: A thread comes back from compiled code after about so many seconds, so that Ctrl-C is heard.
PATIENCE = 0.02
#: Numbers in a line of the cache.
CACHE_LINE = 8
#: Steps of a block before their cost is known.
FIRST_BUDGET = 2000


def run_blocks(program: Program, task: Task, count: Callable[[int], None]) -> tuple[Ensemble, bool]:
    """Run members in blocks, on threads of our own; tells whether Ctrl-C stopped it."""
    results = Results(task, program.header)
    queue = _work_off(program, task, results, count)
    if task.t_end is not None:
        take_last_parts(program, task, results)
    stopped = bool(queue.heard) or run_singly(program, task, results)
    return ensemble_of(program, task, **results.columns()), stopped


def _work_off(
    program: Program, task: Task, results: Results, count: Callable[[int], None]
) -> _Queue:
    """Run members in blocks, in so many threads, this one among them; Ctrl-C stops it."""
    work_off, lanes = _prepared(program, task, results), task.lanes
    blocks = -(-task.members // lanes)
    queue, more = _Queue(blocks, task.threads), max(1, min(task.threads, blocks)) - 1

    def work() -> None:
        while (chunk := queue.next()) is not None:
            work_off(*chunk, queue, lambda done: count(done * lanes))

    with listening() as queue.heard, ThreadPoolExecutor(max(1, more)) as pool:
        others = [pool.submit(work) for _ in range(more)]
        work()
        while wait(others, timeout=0.1).not_done:
            pass
    for other in others:
        other.result()
    return queue


class _Queue:
    """Hands out chunks of blocks, larger ones first, until Ctrl-C is heard."""

    def __init__(self, blocks: int, threads: int) -> None:
        self._lock, self._first, self._last = threading.Lock(), 0, blocks
        self._threads = threads
        self.heard: list[int] = []

    def next(self) -> tuple[int, int] | None:
        """Return the first and the last block of a chunk, None if there are none left."""
        with self._lock:
            left = self._last - self._first
            if left <= 0 or self.heard:
                return None
            size = max(1, min(1024, left // (4 * self._threads)))
            self._first += size
            return self._first - size, self._first


def _prepared(program: Program, task: Task, results: Results) -> Callable[..., None]:
    """Compile what is needed, and give a function that works off a chunk of blocks."""
    header, lanes = program.header, task.lanes
    kernels = program.kernels_for(lanes)
    columns, slopes, count = np.zeros((0, 0)), 0, None
    growing: tuple[Recorder, ...] = ()
    if task.tangents is not None:
        columns, count = task.tangents, task.tangents.shape[1]
        changed = header.varied_by and task.velocities
        slopes = kernels.address("momentum_slopes") if changed else 0
    if task.of_variations:
        if header.constraints:
            reject(
                f"{program.system} has constraints, and ensembles do not tell how variations that "
                "these allow grow.",
                remedy="Ask for single motions: stepper.lyapunov.",
            )
        if task.steps < RENEWAL:
            reject(
                f"a run of {task.steps} steps does not tell how variations grow.",
                remedy=f"Take {RENEWAL} at least.",
            )
        begun = Results(first_part(task), header)
        if _work_off(program, first_part(task), begun, lambda _: None).heard:
            raise KeyboardInterrupt
        derivatives = begun.columns()["variations"]
        columns = first_columns(derivatives, task.h, PAIR).reshape(-1, PAIR + 1)
        growing = (replace(growth(header, PAIR, RENEWAL), rows=0),)
    asked = recorders_of(header, count, task.record, task.reductions, growing)
    if task.run_events is not None:  # a member stops where an event is, and is run by itself
        asked += task.run_events.watchers(
            header, header.rows + sum(recorder.room for recorder in asked), values=True
        )
    called = with_clock(header, asked)
    rows = {
        recorder.kernel: (recorder.first, recorder.room) for recorder in called if recorder.room
    }
    observed, watched = (rows.get(kernel, (0, 0)) for kernel in ("observe", "watch"))
    legendre = kernels.address("legendre") if task.velocities else 0
    retime = kernels.address("retime") if header.retimed else 0
    more = np.array([legendre, slopes, retime, *observed, *watched], dtype=np.int64)
    kinds = np.array([KINDS.index(r.kind) for r in task.reductions], dtype=np.float64)
    step, at = kernels.set(kernels.fallbacks[0], called), driver_layout(header, called)
    advance_blocks = program.numbers.driver("advance_blocks", lanes, renewing=task.of_variations)
    width, room = results.recorded.shape[2], sum(recorder.room for recorder in called)

    def work(first: int, last: int, queue: _Queue, done: Callable[[int], None]) -> None:
        W = _aligned(header.rows + room + 1, lanes)  # the last is the driver's
        if len(columns):
            W[header.layout["TANGENTS"]] = PAIR if growing else columns.shape[1]
        if task.t_end is not None:
            W[header.layout["TIME_END"]], W[header.layout["TIME_END"] + 1] = 1.0, task.t_end
        cursor = np.array([first, 0, 0], dtype=np.int64)
        buffer_q, buffer_p = (np.empty((task.stored, header.n, lanes)) for _ in "qp")
        recorded = np.empty((task.stored, width, lanes))
        counted = np.zeros((task.stored, lanes), dtype=np.int64)
        lost = np.zeros(2 * lanes, dtype=np.int64)
        budget = FIRST_BUDGET
        while cursor[0] < last and not queue.heard:
            before, start = cursor[0], time.perf_counter()
            advance_blocks(
                step,
                more,
                (task.h, task.t0, W, at),
                cursor,
                (last, budget, task.steps, task.every),
                (task.q0, task.other0, task.parameters, task.inputs, columns),
                (buffer_q, buffer_p, recorded, counted, lost),
                (results.q, results.p, results.codes, results.recorded, kinds, results.seen),
            )
            spent = time.perf_counter() - start
            budget = max(1, int(budget * min(4.0, PATIENCE / max(spent, 1e-6))))
            done(int(cursor[0] - before))

    return work


def _aligned(rows: int, lanes: int) -> Floats:
    """Return rows of zeros that begin with a line of the cache: no vector lies across two.

    It is worth its microseconds for many trajectories, not for one.
    """
    room = np.zeros(rows * lanes + CACHE_LINE)
    first = -(room.__array_interface__["data"][0] // room.itemsize) % CACHE_LINE
    return room[first : first + rows * lanes].reshape(rows, lanes)


#: A trial takes no more steps.
TRIAL_STEPS = 2000
#: Tasks of fewer steps of members are over before a trial pays; of others it takes this part.
WORTH_IT, PART = 200_000, 0.2
#: One by one must take so much less time, so that noise does not choose.
CLEARLY = 0.9
#: Members of a trial, and rounds of it.
FEW, ROUNDS = 16, 3


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
        tasks = (replace(short, lanes=lanes) for lanes in (task.lanes, 1))
        beside, single = (seconds_of_member(program, trial, ROUNDS) for trial in tasks)
        known[task.lanes] = 1 if single < CLEARLY * beside else task.lanes
    return replace(task, lanes=known[task.lanes])


def seconds_of_member(program: Program, task: Task, rounds: int = 1) -> float:
    """Estimate the time of one member on one thread, by the best of some rounds with a block.

    Raises KeyboardInterrupt.
    """
    members = min(max(task.lanes, FEW), task.members)
    some = np.linspace(0, task.members - 1, members).astype(np.int64)
    steps = min(task.steps, TRIAL_STEPS)
    trial = replace(
        task.part(some), steps=steps, every=0, threads=1, reductions=(), run_events=None
    )
    seconds = []
    for _ in range(1 + rounds):  # the first compiles
        begin = time.perf_counter()
        if run_blocks(program, trial, lambda done: None)[1]:  # which heard Ctrl-C
            raise KeyboardInterrupt
        seconds.append(time.perf_counter() - begin)
    parts = task.steps / steps if steps else 1.0  # as many as would take its time
    return max(min(seconds[1:]), 1e-9) * parts / members
