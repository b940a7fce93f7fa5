"""Throughput of many double pendulums, beside heyoka's ensembles if installed."""

from __future__ import annotations

import statistics
import threading
from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

import symsimpson as ss
from symsimpson.study.bench.contenders import Contender, alternate
from symsimpson.study.bench.contenders import to_heyoka
from symsimpson.run.ensemble.lanes import run_blocks
from symsimpson.run.ensemble.members import read_ensemble_spec
from symsimpson.run.ensemble.lanes import choose_lanes
from symsimpson.program.configuration import available_threads, lanes_for
from symsimpson.reference import canonical
from symsimpson.stepping.request import Request
from symsimpson.support.array_types import Floats

MEMBERS = 10_000
T_END = 10.0
REPEATS = 5
LEVELS = (1e-3, 1e-6, 1e-9)
#: Schemes, and the numbers of steps to choose from.
SCHEMES = ("simpson", "lobatto6", "lobatto8", "gauss12", "gauss16")
STEPS = tuple(round(200 * 2 ** (k / 8)) for k in range(53))
TOLERANCES = tuple(10.0 ** (-k / 4) for k in range(8, 61))

Run = Callable[[], Floats]


def report(members: int = MEMBERS) -> Iterator[str]:
    """Run the comparison and give its lines; all runs alternate in one process, warm."""
    threads, system = available_threads(), ss.systems.double_pendulum()
    wide = lanes_for(ss.compile(system).program.header.rows, members)
    angles = np.random.default_rng(1).uniform(-2, 2, (members, 2))

    def rate(seconds: float) -> str:
        return f"{members / seconds:>8,.0f} trajectories/s"

    def ours(scheme: str, steps: int, lanes: int | None = None, threads: int = threads) -> Run:
        program = ss.compile(system, scheme).program
        request = Request(angles, p0=[0, 0], h=T_END / steps, steps=steps)
        task = read_ensemble_spec(program, request, threads, False, on_disk=False)
        task = replace(task, lanes=lanes) if lanes else choose_lanes(program, task)
        return lambda: run_blocks(program, task, lambda done: None)[0].q

    yield f"{members} double pendulums, 500 Simpson steps of h = 0.02"
    shapes = ((wide, threads), (wide, 1), (1, 1))
    medians = _medians({f"{shape}": ours("simpson", 500, *shape) for shape in shapes})
    for (lanes, used), seconds in zip(shapes, medians.values(), strict=True):
        each = seconds * used / (500 * members) * 1e9
        name = f"{lanes} lanes, {used} threads"
        yield f"  {name:<24}{rate(seconds)}, {each:6.1f} ns a step and core"
    ratio = medians["(1, 1)"] / medians[f"({wide}, 1)"]
    yield f"  {wide} lanes give {ratio:.1f} times the throughput of one"

    contenders = [Contender(name, "steps", STEPS, partial(ours, name)) for name in SCHEMES]
    peers = list(_heyoka(angles, threads))
    if not peers:
        yield "heyoka is not installed: pip install 'symsimpson[bench]' for the comparison"
        return
    truth = peers[0].make(0.0)()
    apart = _error(ours("gauss12", 1600)(), truth)
    yield f"truth: heyoka at full accuracy; gauss12 with 1600 steps differs by {apart:.0e}"
    errors = {contender.name: _Errors(contender, truth) for contender in (*contenders, peers[0])}
    for level in LEVELS:
        yield f"median error of the angles at t = {T_END:g} at most {level:g}:"
        chosen = {name: entry.coarsest(level) for name, entry in errors.items()}
        # the same method with the same tolerances: the same errors
        chosen |= {peer.name: chosen[peers[0].name] for peer in peers[1:]}
        chosen = {name: pair for name, pair in chosen.items() if pair[1] <= level}
        medians = _medians(
            {
                contender.name: contender.make(chosen[contender.name][0])
                for contender in (*contenders, *peers)
                if contender.name in chosen
            }
        )
        best = min((name for name in SCHEMES if name in medians), key=medians.__getitem__)
        fastest = medians[best]
        for name, (choice, error) in chosen.items():
            ratio = medians[name] / fastest
            yield (
                f"  {name:<40}{rate(medians[name])}, {ratio:5.2f} of the time of {best}"
                f" ({choice:.3g}: {error:.1e})"
            )


class _Errors:
    """Errors of a contender by its choices, each measured once and when it is asked for."""

    def __init__(self, contender: Contender[Run], truth: Floats) -> None:
        self.one = contender
        self.of = cache(lambda k: _error(contender.make(contender.choices[k])(), truth))

    def coarsest(self, level: float) -> tuple[float, float]:
        """Find the coarsest choice that reaches an error, by bisection; return it and its error."""
        last = len(self.one.choices) - 1
        place = bisect_left(range(last), True, key=lambda k: self.of(k) <= level)
        return self.one.choices[place], self.of(place)


def _error(angles: Floats, truth: Floats) -> float:
    return float(np.median(np.abs(angles - truth).max(axis=1)))


def _medians(jobs: dict[str, Run]) -> dict[str, float]:
    times = alternate(jobs, REPEATS + 1)  # the first round warms up
    return {name: statistics.median(values[1:]) for name, values in times.items()}


def _heyoka(angles: Floats, threads: int) -> list[Contender[Run]]:
    """Return heyoka's batches as wide as it recommends, and as wide as is faster on some machines.

    It recommends the vectors that compilers prefer, which are half as wide as some machines have.
    """
    try:
        import heyoka as hy
    except ImportError:
        return []
    widths = sorted({hy.recommended_simd_size(), 8, 16})
    return [batch for lanes in widths for batch in _batches(hy, angles, lanes, threads)]


def _batches(hy: Any, angles: Floats, lanes: int, threads: int) -> list[Contender[Run]]:
    """Return heyoka's batches of so many lanes, in a loop of threads and by its own function."""
    equations = to_heyoka(hy, canonical(ss.systems.double_pendulum()))
    blocks = [
        np.vstack([part.T, np.zeros((2, lanes))])
        for part in angles[: len(angles) // lanes * lanes].reshape(-1, lanes, 2)
    ]

    def integrator(tolerance: float) -> Any:
        options = {"tol": tolerance} if tolerance else {}
        return hy.taylor_adaptive_batch(equations, blocks[0].copy(), **options)

    def ensemble(tolerance: float) -> Run:
        template = integrator(tolerance)

        def begin(ta: Any, k: int) -> Any:
            ta.set_time(0.0)
            ta.state[:] = blocks[k]
            return ta

        def run() -> Floats:
            done = hy.ensemble_propagate_until_batch(
                template, T_END, len(blocks), begin, max_workers=threads
            )
            return np.concatenate([result[0].state[:2].T for result in done])

        return run

    def by_hand(tolerance: float) -> Run:
        integrators = [integrator(tolerance) for _ in range(threads)]
        end_angles = np.empty((len(blocks), lanes, 2))

        def work(first: int) -> None:
            ta = integrators[first]
            for k in range(first, len(blocks), threads):
                ta.set_time(0.0)
                ta.state[:] = blocks[k]
                ta.propagate_until(T_END)
                end_angles[k] = ta.state[:2].T

        def run() -> Floats:
            workers = [
                threading.Thread(target=work, args=(k,), daemon=True) for k in range(threads)
            ]
            for worker in workers:
                worker.start()
            for worker in workers:
                worker.join()
            return end_angles.reshape(-1, 2).copy()

        return run

    forms = {f"{threads} threads by hand": by_hand, "its ensemble_propagate": ensemble}
    return [
        Contender(f"heyoka, {lanes} lanes, {name}", "tolerance", TOLERANCES, form)
        for name, form in forms.items()
        if form is by_hand or lanes == hy.recommended_simd_size()  # slow, and no faster if wider
    ]


if __name__ == "__main__":
    for line in report():
        print(line, flush=True)
