"""Time of Simpson steps on the double pendulum, beside heyoka's Taylor method if installed."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator
from typing import Any

import symsimpson as ss
from symsimpson.study.bench.contenders import alternate
from symsimpson.study.bench.contenders import to_heyoka
from symsimpson.reference import canonical

REPEATS = 15
T_END = 100.0


def report() -> Iterator[str]:
    """Run the measurement and give its lines; everything alternates in one process, warm."""
    system = ss.systems.double_pendulum()
    begin = time.perf_counter()
    stepper = ss.compile(system)
    state = dict(system.reference_state)
    stepper.integrate(**state, h=0.02, steps=1)
    yield f"first result after {time.perf_counter() - begin:.2f} s (derive, compile or load, run)"

    def simpson(h: float) -> Callable[[], Any]:
        return lambda: stepper.integrate(**state, h=h, t_end=T_END)

    jobs: dict[str, Callable[[], Any]] = {f"simpson h={h}": simpson(h) for h in (0.02, 0.005)}
    jobs["simpson h=0.02, last state only"] = lambda: stepper.integrate(
        **state, h=0.02, t_end=T_END, every=None
    )
    jobs["one step"] = lambda: stepper.integrate(**state, h=0.02, steps=1)
    peer = _heyoka()
    if peer is None:
        yield "heyoka is not installed: pip install 'symsimpson[bench]' for the comparison"
    else:
        jobs["heyoka tol=1e-9"] = peer
    times = alternate(jobs, REPEATS)
    medians = {name: statistics.median(values) for name, values in times.items()}
    for name, median in medians.items():
        yield f"{name:<32} median {median * 1e3:9.4f} ms, best {min(times[name]) * 1e3:9.4f} ms"
    for h in (0.02, 0.005):
        run = simpson(h)()
        each = medians[f"simpson h={h}"] / run.steps * 1e9
        mean = run.newton_iterations.sum() / run.steps
        yield f"h={h}: {each:.0f} ns a step, {mean:.2f} Newton iterations a step"
    if peer is not None:
        ratio = medians["simpson h=0.02"] / medians["heyoka tol=1e-9"]
        yield f"5000 Simpson steps take {ratio:.2f} of heyoka's time at tol=1e-9 over {T_END:g} s"


def _heyoka() -> Callable[[], Any] | None:
    try:
        import heyoka as hy
    except ImportError:
        return None
    equations = to_heyoka(hy, canonical(ss.systems.double_pendulum()))
    start = [math.pi / 4, math.pi / 3, 0.0, 0.0]
    integrator = hy.taylor_adaptive(equations, start, tol=1e-9)

    def run() -> None:
        integrator.time = 0.0
        integrator.state[:] = start
        integrator.propagate_until(T_END)

    return run


if __name__ == "__main__":
    for line in report():
        print(line, flush=True)
