"""Vectorised ensembles: members are SIMD lanes of blocks, and threads share the blocks."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.evaluation import evaluate
from symsimpson.program.observed import KINDS
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, driver_layout, growth, with_clock
from symsimpson.program.status import Status
from symsimpson.run.ensemble.ensemble import Ensemble
from symsimpson.run.ensemble.members import EnsembleSpec, MemberResults, make_ensemble
from symsimpson.run.ensemble.singles import PAIR, RENEWAL, run_singly
from symsimpson.run.lyapunov import initial_variations, spec_of_first_part
from symsimpson.stepping.parts import compute_states_at, update_reductions
from symsimpson.stepping.spec import make_recorders
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.interpreter import catch_interrupts
from symsimpson.text.interface import ARRIVED


def take_last_parts(program: Program, task: EnsembleSpec, results: MemberResults) -> None:
    """Take the partial steps of members up to ``t_end``, if only final states are stored."""
    arrived = np.flatnonzero(results.codes[:, 0] == ARRIVED)
    results.codes[arrived, 0] = Status.SUCCESS
    if task.every or not arrived.size:
        return
    states = tuple(np.ascontiguousarray(x[arrived, 0]) for x in (results.q, results.p))
    part, q, p, fine = compute_states_at(
        program,
        task.parameters[arrived],
        task.h,
        (results.recorded[arrived, 0, 0], *states),
        np.arange(arrived.size),
        np.full(arrived.size, task.t_end),
        1,
    )
    if task.reductions:
        ended, count = arrived[fine], 2 * len(task.reductions)
        before = (results.recorded[ended, 0, 0], *(x[fine] for x in states))
        ends = np.full(len(ended), task.t_end), q[fine], p[fine]
        seen = results.seen[ended, :count:2]
        given = program, task.reductions, task.parameters[ended]
        results.seen[ended, :count:2] = update_reductions(*given, before, ends, seen)
    results.q[arrived, 0], results.p[arrived, 0] = q, p
    results.recorded[arrived, 0, 0], results.part[arrived] = task.t_end, part
    results.codes[arrived[~fine], 0] = Status.NOT_CONVERGED


def append_ends(ensemble: Ensemble, ends: Ensemble, every: int) -> Ensemble:
    """Append the final states of members to their stored states, ``every`` steps apart.

    A member that did not reach its end keeps the states before its failure, and its status.
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


#: Approximate duration of one call of compiled code in seconds, between checks for Ctrl-C.
PATIENCE = 0.02
#: Number of doubles in a cache line.
CACHE_LINE = 8
#: Number of steps of the first call, whose duration is unknown.
FIRST_BUDGET = 2000


def run_blocks(
    program: Program, task: EnsembleSpec, count: Callable[[int], None]
) -> tuple[Ensemble, bool]:
    """Run members in vector blocks on threads; return also whether Ctrl-C stopped it."""
    results = MemberResults(task, program.header)
    if program.modes is not None:  # members change their modes at different times
        stopped = run_singly(program, task, results)
        return make_ensemble(program, task, **results.columns()), stopped
    order = order_by_energy(program, task)
    if order is None:
        queue = _run_all_blocks(program, task, results, count)
    else:
        ordered = task.part(order)
        by_energy = MemberResults(ordered, program.header)
        queue = _run_all_blocks(program, ordered, by_energy, count)
        results.take(by_energy, order)
    if task.t_end is not None:
        take_last_parts(program, task, results)
    stopped = bool(queue.heard) or run_singly(program, task, results)
    return make_ensemble(program, task, **results.columns()), stopped


#: Smallest number of blocks for which members are ordered.
FEWEST_ORDERED_BLOCKS = 4


def order_by_energy(program: Program, task: EnsembleSpec) -> Ints | None:
    """Return the order of members by their energy at the start; None if the order does not matter.

    A block iterates until its slowest member has converged. Members of similar energies need
    similar numbers of iterations. Tasks that store states on the way keep their order, because a
    second copy of the states would need memory.
    """
    few = task.members < FEWEST_ORDERED_BLOCKS * task.lanes or task.lanes == 1
    if few or task.every or task.retimed or not program.kernels_for(task.lanes).by_stages:
        return None
    n, p, t = program.n, task.other0, np.array([task.t0])
    if task.velocities:
        start = t, task.q0, p
        p = evaluate(program, "legendre", "MOMENTUM", n, start, task.parameters)
    energy = evaluate(program, "energy", "ENERGY", 1, (t, task.q0, p), task.parameters)
    return np.argsort(energy[:, 0], kind="stable")


def _run_all_blocks(
    program: Program, task: EnsembleSpec, results: MemberResults, count: Callable[[int], None]
) -> _BlockQueue:
    """Run all blocks on the threads of a task, including this thread; Ctrl-C stops them."""
    work_off, lanes = _prepare_blocks(program, task, results), task.lanes
    blocks = -(-task.members // lanes)
    queue, more = _BlockQueue(blocks, task.threads), max(1, min(task.threads, blocks)) - 1

    def work() -> None:
        while (chunk := queue.next()) is not None:
            work_off(*chunk, queue, lambda done: count(done * lanes))

    with catch_interrupts() as queue.heard, ThreadPoolExecutor(max(1, more)) as pool:
        others = [pool.submit(work) for _ in range(more)]
        work()
        while wait(others, timeout=0.1).not_done:
            pass
    for other in others:
        other.result()
    return queue


class _BlockQueue:
    """Queue of ranges of blocks for threads: large ranges first, none after Ctrl-C."""

    def __init__(self, blocks: int, threads: int) -> None:
        self._lock, self._first, self._last = threading.Lock(), 0, blocks
        self._threads = threads
        self.heard: list[int] = []

    def next(self) -> tuple[int, int] | None:
        """Return the next range (first, end) of blocks, or None if no block remains."""
        with self._lock:
            count = self._last - self._first
            if count <= 0 or self.heard:
                return None
            size = max(1, min(1024, count // (4 * self._threads)))
            self._first += size
            return self._first - size, self._first


def _prepare_blocks(
    program: Program, task: EnsembleSpec, results: MemberResults
) -> Callable[..., None]:
    """Compile the kernels for a task; return a function that runs a range of blocks."""
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
                "reductions of variations (lyapunov, megno, sali) do not support constraints.",
                where=program.system,
                remedy="Use stepper.lyapunov for single runs.",
            )
        if task.steps < RENEWAL:
            reject(
                f"a run of {task.steps} steps is too short for reductions of variations.",
                remedy=f"Take at least {RENEWAL} steps.",
            )
        first_step = MemberResults(spec_of_first_part(task), header)
        if _run_all_blocks(program, spec_of_first_part(task), first_step, lambda _: None).heard:
            raise KeyboardInterrupt
        derivatives = first_step.columns()["variations"]
        columns = initial_variations(derivatives, task.h, PAIR).reshape(-1, PAIR + 1)
        growing = (replace(growth(header, PAIR, RENEWAL), rows=0),)
    attached = make_recorders(header, count, task.record, task.reductions, growing)
    if task.run_events is not None:  # a member stops at an event, and runs again singly
        attached += task.run_events.watchers(
            header, header.rows + sum(recorder.room for recorder in attached), values=True
        )
    called = with_clock(header, attached)
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

    def work(first: int, last: int, queue: _BlockQueue, done: Callable[[int], None]) -> None:
        W = _aligned_zeros(header.rows + room + 1, lanes)  # the driver needs the last row
        if len(columns):
            W[header.layout["TANGENTS"]] = PAIR if growing else columns.shape[1]
            if "TIME_GRID" in header.layout:
                W[header.layout["TIME_GRID"]], W[header.layout["TIME_GRID"] + 1] = 1.0, task.t0
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


def _aligned_zeros(rows: int, lanes: int) -> Floats:
    """Return zeros, shape (rows, lanes), aligned to a cache line so that no vector crosses one.

    The allocation takes microseconds more, which pays for many trajectories only.
    """
    room = np.zeros(rows * lanes + CACHE_LINE)
    first = -(room.__array_interface__["data"][0] // room.itemsize) % CACHE_LINE
    return room[first : first + rows * lanes].reshape(rows, lanes)


#: Largest number of steps of a trial.
TRIAL_STEPS = 2000
#: Smallest number of steps of all members for which a trial pays, and the fraction of the steps
#: that the trial takes.
FEWEST_STEPS_OF_TRIAL, TRIAL_PART = 200_000, 0.2
#: Members run singly if this takes less than this fraction of the time, so that noise is harmless.
CLEAR_GAIN = 0.9
#: Number of members in a trial, and number of rounds.
FEW, ROUNDS = 16, 3


def choose_lanes(program: Program, task: EnsembleSpec) -> EnsembleSpec:
    """Return a task whose members run one after another, if that is faster on this machine.

    If a step is solved by stages, the nodes of a single member can fill a vector. Members in the
    lanes of one block wait for each other and need more of the cache. Both ways are bitwise
    identical. Raises KeyboardInterrupt at Ctrl-C, before any member has run.
    """
    small = task.members * task.steps < FEWEST_STEPS_OF_TRIAL or task.lanes == 1
    if small or task.retimed or not program.kernels_for(task.lanes).by_stages:
        return task
    known = program.findings.lanes
    if task.lanes not in known:
        whole = task.members * task.steps
        steps = int(TRIAL_PART * whole / (2 * (1 + ROUNDS) * max(task.lanes, FEW)))
        short = replace(task, steps=min(task.steps, max(1, steps)))
        tasks = (replace(short, lanes=lanes) for lanes in (task.lanes, 1))
        block, single = (measure_member_time(program, trial, ROUNDS) for trial in tasks)
        known[task.lanes] = 1 if single < CLEAR_GAIN * block else task.lanes
    return replace(task, lanes=known[task.lanes])


def measure_member_time(program: Program, task: EnsembleSpec, rounds: int = 1) -> float:
    """Measure the time of one member on one thread in seconds: the best of ``rounds`` trials.

    Raises KeyboardInterrupt.
    """
    members = min(max(task.lanes, FEW), task.members)
    some = np.linspace(0, task.members - 1, members).astype(np.int64)
    steps = min(task.steps, TRIAL_STEPS)
    trial = replace(
        task.part(some), steps=steps, every=0, threads=1, reductions=(), run_events=None
    )
    seconds = []
    for _ in range(1 + rounds):  # the first round compiles
        begin = time.perf_counter()
        if run_blocks(program, trial, lambda done: None)[1]:  # Ctrl-C
            raise KeyboardInterrupt
        seconds.append(time.perf_counter() - begin)
    factor = task.steps / steps if steps else 1.0
    return max(min(seconds[1:]), 1e-9) * factor / members
