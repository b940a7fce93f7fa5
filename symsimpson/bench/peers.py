"""Who is compared: our schemes, and other programs where they are installed.

Each contender solves one problem, for choices from coarse to fine (a number of steps, a tolerance).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.api import compile as compile_system
from symsimpson.bench.explicit import make_dop853
from symsimpson.bench.problem import Problem
from symsimpson.errors import InputError
from symsimpson.reference import FirstOrder
from symsimpson.reference.runge_kutta import compiled_rates, compiled_rk4
from symsimpson.schemes.scheme import Scheme

__all__ = ["PEERS", "Contender", "double_pendulum", "ours", "peers"]

Floats = NDArray[np.float64]

#: Tolerances from coarse to fine.
TOLERANCES = tuple(10.0 ** (-k / 2) for k in range(2, 31))
COARSE = TOLERANCES[::2]


@dataclass(frozen=True)
class Outcome:
    """What one run came to: the state at the end, and how much it took."""

    q: Floats
    p: Floats
    evaluations: int


@dataclass(frozen=True)
class Contender:
    """A program that solves a problem.

    Attributes
    ----------
    name : str
    choices : sequence of float
        From coarse to fine; ``what`` says of what.
    make : callable
        Gives for a choice a function without arguments that runs, and one that reads its outcome.
    """

    name: str
    what: str
    choices: Sequence[float]
    make: Callable[[float], tuple[Callable[[], Any], Callable[[Any], Outcome]]]


def _steps(problem: Problem) -> list[int]:
    """Give numbers of steps from coarse to fine."""
    return [round(max(4, round(problem.t_end / 2)) * 2 ** (k / 4)) for k in range(80)]


def ours(problem: Problem, scheme: str | Scheme) -> Contender:
    """Give one of our schemes; it counts Newton iterations."""
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

    return Contender(stepper.scheme, "steps", _steps(problem), make)


def peers(problem: Problem, names: str | Sequence[str] = "installed") -> Iterator[Contender]:
    """Give the other programs: those named, or all that are installed.

    Raises
    ------
    InputError
        If one is unknown, or named and not installed.
    """
    wanted = list(PEERS) if names == "installed" else [names] if isinstance(names, str) else names
    for name in wanted:
        if name not in PEERS:
            raise InputError(f"there is no peer {name!r}.\nThere are {', '.join(PEERS)}.")
        try:
            yield from PEERS[name](problem)
        except ImportError as error:
            if names != "installed":
                raise InputError(
                    f"the peer {name!r} is not installed: {error}.\n"
                    "Install it with pip install 'symsimpson[bench]', or leave it out."
                ) from None


def _runge_kutta(problem: Problem) -> Iterator[Contender]:
    """Explicit methods of our own, compiled with the right-hand side."""
    rates = compiled_rates(problem.canonical)
    parameters = np.array(problem.canonical.values(None), dtype=np.float64)
    start, n = np.concatenate([problem.q0, problem.p0]), problem.system.n

    def making(solve: Callable[[Floats, float], int]) -> Any:
        def make(choice: float) -> tuple[Callable[[], Any], Callable[[Any], Outcome]]:
            def run() -> Any:
                y = start.copy()
                return y, solve(y, choice)

            return run, lambda found: Outcome(found[0][:n], found[0][n:], found[1])

        return make

    rk4, dop853 = compiled_rk4(problem.canonical), make_dop853(rates)
    kept = np.empty((2, start.size))

    def fixed(y: Floats, steps: float) -> int:
        count = int(steps)
        rk4(y, parameters, problem.t_end / count, count, count, kept)
        return 4 * count

    def adaptive(y: Floats, tolerance: float) -> int:
        return int(dop853(y, parameters, problem.t_end, tolerance))

    yield Contender("rk4", "steps", _steps(problem), making(fixed))
    yield Contender("dop853", "tolerance", TOLERANCES, making(adaptive))


def _scipy(problem: Problem) -> Iterator[Contender]:
    """SciPy's solvers with a compiled right-hand side."""
    from scipy.integrate import solve_ivp

    rates = compiled_rates(problem.canonical)
    parameters = np.array(problem.canonical.values(None), dtype=np.float64)
    start, n = np.concatenate([problem.q0, problem.p0]), problem.system.n

    def right(t: float, y: Floats) -> Floats:
        out = np.empty_like(y)
        rates(y, parameters, out)
        return out

    for method in ("DOP853", "LSODA", "Radau"):

        def make(
            tolerance: float, method: str = method
        ) -> tuple[Callable[[], Any], Callable[[Any], Outcome]]:
            def run() -> Any:
                return solve_ivp(
                    right, (0.0, problem.t_end), start, method=method,
                    rtol=max(tolerance, 2.3e-14), atol=tolerance,
                )  # fmt: skip

            def read(found: Any) -> Outcome:
                end = found.y[:, -1] if found.success else np.full(2 * n, np.nan)
                return Outcome(end[:n], end[n:], int(found.nfev))

            return run, read

        choices = COARSE[:5] if method == "Radau" else COARSE  # of order five: too slow beyond
        yield Contender(f"scipy {method}", "tolerance", choices, make)


def _heyoka(problem: Problem) -> Iterator[Contender]:
    """The Taylor method of heyoka, in both forms of the equations and both modes of compilation."""
    import heyoka as hy

    stepper, n = compile_system(problem.system, "simpson"), problem.system.n
    forms = (
        ("q, p", problem.canonical, problem.p0, lambda q, p: p),
        ("q, v", problem.second_order, problem.v0, lambda q, v: problem.momentum(stepper, q, v)),
    )
    for form, equations, other, momentum in forms:
        written = _in_heyoka(hy, equations)
        start = np.concatenate([problem.q0, other])
        for mode in ("", " compact"):

            def make(
                tolerance: float, written: Any = written, start: Floats = start,
                compact: bool = bool(mode), momentum: Callable[..., Any] = momentum,
            ) -> tuple[Callable[[], Any], Callable[[Any], Outcome]]:  # fmt: skip
                integrator = hy.taylor_adaptive(
                    written, start.tolist(), tol=max(tolerance, 2.3e-16), compact_mode=compact
                )

                def run() -> Any:
                    integrator.time = 0.0
                    integrator.state[:] = start
                    return integrator.propagate_until(problem.t_end)[3]

                def read(steps: Any) -> Outcome:
                    q, second = integrator.state[:n].copy(), integrator.state[n:].copy()
                    return Outcome(q, momentum(q, second), int(steps))

                return run, read

            yield Contender(f"heyoka{mode} ({form})", "tolerance", TOLERANCES, make)


def _in_heyoka(hy: Any, equations: FirstOrder) -> list[tuple[Any, Any]]:
    """Write y' = f(y) in heyoka's expressions, parameters as numbers."""
    known: dict[Any, Any] = {
        symbol: hy.make_vars(f"y_{i}") for i, symbol in enumerate(equations.unknowns)
    }
    variables = list(known.values())
    known |= {symbol: hy.expression(float(value)) for symbol, value in equations.parameters.items()}
    for symbol, value in equations.definitions:
        known[symbol] = hy.from_sympy(value, known)
    rates = [hy.from_sympy(rate, known) for rate in equations.rates]
    return list(zip(variables, rates, strict=True))


#: Other programs by name.
PEERS: dict[str, Callable[[Problem], Iterator[Contender]]] = {
    "runge-kutta": _runge_kutta,
    "scipy": _scipy,
    "heyoka": _heyoka,
}


def double_pendulum(hy: Any) -> Any:
    """Give heyoka's equations of motion of the catalogue's double pendulum."""
    q1, q2, v1, v2 = hy.make_vars("q1", "q2", "v1", "v2")
    g = 9.81
    l = g / (2 * math.pi) ** 2
    lagrangian = (
        l**2 * (v1**2 + v2**2 / 2.0 + v1 * v2 * hy.cos(q1 - q2))
        + g * l * (2.0 * hy.cos(q1) + hy.cos(q2))
    )  # fmt: skip
    return hy.lagrangian(lagrangian, [q1, q2], [v1, v2])
