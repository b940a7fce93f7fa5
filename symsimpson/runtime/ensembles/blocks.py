"""Many trajectories at once: members are lanes of blocks, blocks are spread over threads."""

from __future__ import annotations

import os
import threading
import time
import warnings
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import ConstraintWarning, InputError, ResolutionWarning, StabilityWarning
from symsimpson.interface import ROWS
from symsimpson.runtime.driver.compiled import driver
from symsimpson.runtime.ensembles.ensemble import Ensemble
from symsimpson.runtime.evaluator import evaluate_members, watching
from symsimpson.runtime.kernels.compiled import Kernels
from symsimpson.runtime.kernels.header import Header
from symsimpson.runtime.kernels.observed import KINDS, Reduction, observing_kernel, reduce_values
from symsimpson.runtime.results.status import Status
from symsimpson.runtime.runs.chaos import directions, find_chaos, kept_growth
from symsimpson.runtime.runs.folds import SINGULAR, close, independence_of
from symsimpson.runtime.runs.run import NOTHING_KEPT
from symsimpson.runtime.runs.spec import RunSpec
from symsimpson.runtime.runs.variations import kept_variations

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["Results", "Task", "ensemble_of", "run_blocks"]

#: A thread comes back from compiled code after about so many seconds, so that Ctrl-C is heard.
PATIENCE = 0.02
#: Numbers in a line of the cache.
CACHE_LINE = 8
#: Fast sines and cosines have a value for angles up to here.
FAST_SINES = 5e8
#: So many variations of a motion tell its largest exponent and how two align; they are made
#: orthonormal after so many steps.
PAIR, RENEWAL = 2, 20
#: Steps of a block before their cost is known.
FIRST_BUDGET = 2000

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Task(RunSpec):
    """What an ensemble is asked to compute, checked; arrays have a row for each member."""

    reductions: tuple[Reduction, ...]
    threads: int
    progress: bool | None
    lanes: int

    @property
    def members(self) -> int:
        """Number of members."""
        return len(self.q0)

    def inputs_of(self, member: Any) -> Floats | None:
        """Return the inputs of a member as a run of its own takes them."""
        own = self.inputs[min(member, len(self.inputs) - 1)]
        return np.broadcast_to(own, (self.steps, *own.shape[1:])) if own.size else None

    def carried(self, n: int) -> int:
        """Return how many numbers of variations are stored beside a state."""
        return 0 if self.tangents is None else 2 * n * self.tangents.shape[1]

    @property
    def of_variations(self) -> bool:
        """Whether variations of the motions are asked for."""
        return any(r.of_variations for r in self.reductions)

    @property
    def times(self) -> Floats:
        """Times of the stored states."""
        stride, first = (self.every, 0) if self.every else (self.steps, 1)
        count = np.arange(first, self.stored + first, dtype=np.float64)
        return self.t0 + self.h * count * stride

    def part(self, members: slice | NDArray[np.int64]) -> Task:
        """Return the task of some of the members."""
        return replace(
            self, q0=np.ascontiguousarray(self.q0[members]),
            other0=np.ascontiguousarray(self.other0[members]),
            parameters=np.ascontiguousarray(self.parameters[members]),
            inputs=self.inputs if len(self.inputs) == 1 else self.inputs[members],
        )  # fmt: skip


def lanes_for(header: Header) -> int:
    """Return the number of lanes of a block.

    Where Newton's method is unrolled, members side by side are two to four
    times as fast with it as one after the other with nodes as lanes; where it is not, the other way
    round, by far.
    """
    return 1 if header.by_stages and not header.unrolled else lanes_of_machine()


@cache
def lanes_of_machine() -> int:
    """Return the number of lanes of a block: two vector registers where they are short."""
    import llvmlite.binding as llvm

    return 8 if llvm.get_host_cpu_features().get("avx") else 4


class Results:
    """Arrays that threads fill, each its own rows; until then members count as interrupted."""

    def __init__(self, task: Task, n: int) -> None:
        shape = (task.members, task.stored, n)
        self.q, self.p = np.full(shape, np.nan), np.full(shape, np.nan)
        # status, steps, iterations
        self.codes = np.zeros((task.members, 3), dtype=np.int64)
        self.codes[:, 0] = Status.INTERRUPTED
        self.kept = np.full((task.members, task.stored, task.carried(n)), np.nan)
        self.seen = np.full((task.members, max(1, 2 * len(task.reductions))), np.nan)
        self._task = task

    def columns(self) -> dict[str, Any]:
        """Return the arrays as an ensemble has them."""
        task = self._task
        status, steps, iterations = (column.copy() for column in self.codes.T)
        q, p = (self.q, self.p) if task.every else (self.q[:, 0], self.p[:, 0])
        reduced = {r.name: self.seen[:, 2 * k] for k, r in enumerate(task.reductions)}
        tangents = None
        if task.tangents is not None:
            size = 2 * q.shape[-1]
            tangents = self.kept.reshape(*self.kept.shape[:2], -1, size).swapaxes(2, 3)
            tangents = tangents if task.every else tangents[:, 0]
        return {
            "q": q, "p": p, "status": status, "steps": steps, "newton_iterations": iterations,
            "reduced": reduced, "_tangents": tangents,
        }  # fmt: skip


def run_blocks(stepper: Stepper, task: Task, count: Callable[[int], None]) -> tuple[Ensemble, bool]:
    """Run members in blocks, on threads of our own; tells whether Ctrl-C stopped it."""
    results = Results(task, stepper.n)
    work_off = _prepared(stepper, task, results)
    lanes = task.lanes
    blocks = -(-task.members // lanes)
    queue = _Queue(blocks, task.threads)
    threads = max(1, min(task.threads, blocks))

    def work() -> None:
        while (chunk := queue.next()) is not None:
            work_off(*chunk, queue, lambda done: count(done * lanes))

    _wait([work] * threads, queue)
    if not queue.stopped:
        _again(stepper, task, results, queue)
    return ensemble_of(stepper, task, **results.columns()), queue.stopped


class _Queue:
    """Hands out chunks of blocks, larger ones first; stopped by Ctrl-C."""

    def __init__(self, blocks: int, threads: int) -> None:
        self._lock, self._first, self._last = threading.Lock(), 0, blocks
        self._threads = threads
        self.stopped = False

    def next(self) -> tuple[int, int] | None:
        """Return the first and the last block of a chunk, None if there are none left."""
        with self._lock:
            left = self._last - self._first
            if left <= 0 or self.stopped:
                return None
            size = max(1, min(1024, left // (4 * self._threads)))
            self._first += size
            return self._first - size, self._first


def _wait(work: list[Callable[[], None]], queue: _Queue) -> None:
    """Run functions in threads until they are done or stopped by Ctrl-C."""
    with ThreadPoolExecutor(len(work)) as pool:
        running: list[Future[None]] = []
        try:
            for one in work:
                running.append(pool.submit(one))
            while wait(running, timeout=0.1).not_done:
                pass
        except KeyboardInterrupt:
            queue.stopped = True
            wait(running)
        for future in running:
            future.result()


def _prepared(stepper: Stepper, task: Task, results: Results) -> Callable[..., None]:
    """Compile what is needed, and give a function that works off a chunk of blocks."""
    header, lanes = stepper._module.header, task.lanes
    kernels = Kernels(stepper.source, header, lanes)
    kept, columns, told = NOTHING_KEPT, np.zeros((0, 0)), header.told.copy()
    watched, observing, slopes = 0, 0, 0
    if task.tangents is not None:
        columns = task.tangents
        kept = kept_variations(header, columns.shape[1])
        changed = header.varied_by and task.velocities
        slopes = kernels.address("momentum_slopes") if changed else 0
    if task.of_variations:
        if header.constraints:
            raise InputError(
                f"{stepper.system} has constraints, and ensembles do not tell how variations that "
                "these allow grow.\nAsk for single motions: stepper.lyapunov."
            )
        if task.steps < RENEWAL:
            raise InputError(
                f"a run of {task.steps} steps does not tell how variations grow.\n"
                f"Take {RENEWAL} at least."
            )
        kept, columns = kept_growth(stepper, PAIR, RENEWAL), directions(2 * header.n, PAIR)
        told = header.told_to_renew(PAIR, RENEWAL)
    if not all(r.of_variations for r in task.reductions):
        watched = len(task.reductions)
        told[ROWS] += kept.room  # what is observed stands behind all else
        text = observing_kernel(header, task.reductions, told[ROWS])
        observing = kernels.observing(text, watched)
    energy = kernels.address("energy") if any(r.energetic for r in task.reductions) else 0
    legendre = kernels.address("legendre") if task.velocities else 0
    more = np.array([legendre, observing, energy, slopes], dtype=np.int64)
    kinds = np.array([KINDS.index(r.kind) for r in task.reductions], dtype=np.float64)
    step = kernels.set(kernels.fallbacks[0], kept.kernel)
    advance_blocks = driver("advance_blocks", lanes, renewing=task.of_variations)

    def work(first: int, last: int, queue: _Queue, done: Callable[[int], None]) -> None:
        W = _aligned(header.rows + watched + kept.room, lanes)
        if kept.kernel:
            W[header.layout["TANGENTS"]] = columns.shape[1]
        cursor = np.array([first, 0, 0], dtype=np.int64)
        buffer_q, buffer_p = (np.empty((task.stored, header.n, lanes)) for _ in "qp")
        rows = max(1, kept.rows) if kept.kernel else 0
        buffer_kept = np.empty((task.stored, rows, lanes))
        counted = np.zeros((task.stored, lanes), dtype=np.int64)
        lost = np.zeros(lanes, dtype=np.int64)
        budget = FIRST_BUDGET
        while cursor[0] < last and not queue.stopped:
            before, start = cursor[0], time.perf_counter()
            advance_blocks(
                step, more, task.h, task.t0, W, told, cursor, last, budget,
                task.steps, task.every, task.q0, task.other0, task.parameters, buffer_q, buffer_p,
                buffer_kept, counted, results.q, results.p, results.codes, lost, results.seen,
                kinds, task.inputs, columns, results.kept,
            )  # fmt: skip
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


def _again(stepper: Stepper, task: Task, results: Results, queue: _Queue) -> None:
    """Run members that failed once more, each by itself, where robust kernels may help it.

    What a member comes to then is what a single run of it comes to. So are those at whose stored
    states the energy is not real, or constraints follow from one another.
    """
    status, small = results.codes[:, 0], (np.abs(task.q0) < FAST_SINES).all(axis=1)
    good = status == Status.SUCCESS
    if not stepper._module.header.real_everywhere:
        good &= _real(stepper, task, results)
    if len(stepper._module.header.constraints) > 1 and task.every:
        good &= _unfolded(stepper, task, results)
    good |= (status == Status.BAD_INPUT) & small
    for member in np.flatnonzero(~good):
        given = {task.given: task.other0[member]}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ResolutionWarning)
                warnings.simplefilter("ignore", StabilityWarning)  # not one for each member
                warnings.simplefilter("ignore", ConstraintWarning)
                run = stepper.integrate(
                    task.q0[member], **given, h=task.h, steps=task.steps, t0=task.t0,
                    parameters=dict(zip(stepper.parameters, task.parameters[member], strict=True)),
                    inputs=task.inputs_of(member),
                    every=1 if task.reductions else task.every or None, on_failure="return",
                    **_carrying(stepper, task),
                )  # fmt: skip
        except InputError:
            for array in (results.q, results.p, results.kept, results.seen):
                array[member] = np.nan
            results.codes[member] = Status.BAD_INPUT, 0, 0
            continue
        except KeyboardInterrupt:
            queue.stopped = True
            return
        if run.status is Status.INTERRUPTED:
            queue.stopped = True
            return
        q, p, kept = run.q, run.p, np.zeros((len(run), 0))
        if run._tangents is not None:
            kept = run._tangents.swapaxes(1, 2).reshape(len(run), -1)
        if task.reductions:
            seen = watching(stepper, task.reductions, task.parameters[member])(run.t, run.q, run.p)
            values = reduce_values(task.reductions, run.t, seen)
            if task.of_variations and run.success:
                values = _of_variations(stepper, task, member, values)
            results.seen[member, : 2 * len(values) : 2] = values
            q, p, kept = (x[:: task.every] if task.every else x[-1:] for x in (q, p, kept))
        for array, found in ((results.q, q), (results.p, p), (results.kept, kept)):
            array[member, : len(found)], array[member, len(found) :] = found, np.nan
        results.codes[member] = run.status, run.steps, run.newton_iterations.sum()


def _carrying(stepper: Stepper, task: Task) -> dict[str, Any]:
    """Return what a single run is asked to carry along."""
    if task.tangents is None:
        return {}
    names = stepper._module.header.varied_by or ()
    given = task.tangents[:, : task.tangents.shape[1] - len(names)]
    return {"tangents": given, "sensitivities": names}


def _of_variations(stepper: Stepper, task: Task, member: Any, values: list[float]) -> list[float]:
    """Return what reductions of a member come to, with those of its variations."""
    own = replace(
        task, q0=task.q0[member], other0=task.other0[member], parameters=task.parameters[member],
        inputs=task.inputs[min(member, len(task.inputs) - 1)][None],
    )  # fmt: skip
    chaos = find_chaos(stepper, own, PAIR, RENEWAL, progress=False)
    told = {"lyapunov": chaos.exponents[0], "megno": chaos.megno[-1], "sali": chaos.sali[-1]}
    pairs = zip(task.reductions, values, strict=True)
    return [float(told.get(reduction.kind, value)) for reduction, value in pairs]


def _real(stepper: Stepper, task: Task, results: Results) -> NDArray[np.bool_]:
    """Return which members have a real energy where they begin, and at all stored states."""
    # a momentum of zero where velocities were given: V has its value all the same
    first = 0 * task.other0 if task.velocities else task.other0
    q = np.concatenate([task.q0[:, None], results.q], axis=1)
    p = np.concatenate([first[:, None], results.p], axis=1)
    t = np.concatenate([[task.t0], np.atleast_1d(task.times)])
    energies = evaluate_members(stepper, "energy", "ENERGY", 1, t, q, p, task.parameters)
    return np.asarray(np.isfinite(energies).all(axis=(1, 2)))


def _unfolded(stepper: Stepper, task: Task, results: Results) -> NDArray[np.bool_]:
    """Return at whose stored states all constraints are independent; warn of those nearly not."""
    count = len(stepper._module.header.constraints)
    pivots = evaluate_members(
        stepper, "multipliers", "HELD_PIVOT", count, task.times, results.q, results.p,
        task.parameters,
    )  # fmt: skip
    with np.errstate(invalid="ignore"):  # of members that failed
        independence = independence_of(pivots)
    folded = (independence < SINGULAR).any(axis=1)
    near = np.flatnonzero(close(independence).any(axis=1) & ~folded)
    if near.size and task.every == 1:
        warnings.warn(
            f"{stepper.system}, {stepper.scheme}: in {near.size} of {task.members} members, the "
            f"first of them {near[0]}, constraints may follow from one another between two steps, "
            f"as where bars of a linkage fold into a line. From there it may go on either "
            f"way, and h={task.h:g} does not resolve which.\nTake a smaller h, or lengths at which "
            "it does not fold.",
            ConstraintWarning,
            stacklevel=6,  # where ensemble is called
        )
    return np.asarray(~folded)


def ensemble_of(stepper: Stepper, task: Task, **found: Any) -> Ensemble:
    """Return what a task came to as an ensemble, with what it was asked for."""
    return Ensemble(
        t=task.times, parameters=dict(zip(stepper.parameters, task.parameters.T, strict=True)),
        initial={"q0": task.q0, task.given: task.other0}, _stepper=stepper, **found,
    )  # fmt: skip


def available_threads() -> int:
    """Count the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
