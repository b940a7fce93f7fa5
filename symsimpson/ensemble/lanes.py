"""Many trajectories at once: members are lanes of blocks, blocks are spread over threads."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np

from symsimpson.derivatives.lyapunov import first_columns, first_part
from symsimpson.ensemble.arrivals import take_last_parts
from symsimpson.ensemble.ensemble import Ensemble
from symsimpson.ensemble.singles import PAIR, RENEWAL, run_singly
from symsimpson.ensemble.task import Results, Task, ensemble_of
from symsimpson.errors import InputError
from symsimpson.program.observed import KINDS
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, driver_layout, growth, with_clock
from symsimpson.stepping.recording import recorders_of
from symsimpson.support.array_types import Floats
from symsimpson.support.interpreter import listening

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
    """Run members in blocks, on threads of our own."""
    work_off = _prepared(program, task, results)
    lanes = task.lanes
    blocks = -(-task.members // lanes)
    queue = _Queue(blocks, task.threads)
    threads = max(1, min(task.threads, blocks))

    def work() -> None:
        while (chunk := queue.next()) is not None:
            work_off(*chunk, queue, lambda done: count(done * lanes))

    _share(work, threads, queue)
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


def _share(work: Callable[[], None], threads: int, queue: _Queue) -> None:
    """Work in so many threads, this one among them, until all is done or Ctrl-C stops it."""
    with listening() as queue.heard, ThreadPoolExecutor(max(1, threads - 1)) as pool:
        others = [pool.submit(work) for _ in range(threads - 1)]
        work()
        while wait(others, timeout=0.1).not_done:
            pass
    for other in others:
        other.result()


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
            raise InputError(
                f"{program.system} has constraints, and ensembles do not tell how variations that "
                "these allow grow.\nAsk for single motions: stepper.lyapunov."
            )
        if task.steps < RENEWAL:
            raise InputError(
                f"a run of {task.steps} steps does not tell how variations grow.\n"
                f"Take {RENEWAL} at least."
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
