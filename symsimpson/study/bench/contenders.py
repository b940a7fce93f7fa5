"""Contenders of a benchmark: programs that solve a problem with an accuracy that can be chosen.

Solvers that call a right-hand side get one that numba compiled. Programs that compile their own
code do so before the timing starts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import mul
from typing import Any, Generic, TypeVar

import mpmath
import numpy as np
import sympy as sp

from symsimpson.api.compiling import compile as compile_system
from symsimpson.declare.retimed import RetimedSystem
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import reject
from symsimpson.reference import FirstOrder, canonical, second_order, truth
from symsimpson.reference.runge_kutta import compiled_rates, compiled_rk4
from symsimpson.run.ended import raise_if_interrupted
from symsimpson.schemes.scheme import Scheme
from symsimpson.study.analysis.pilot import choose_state
from symsimpson.study.analysis.stability.frequency import largest_frequency
from symsimpson.study.bench.dop853 import PIECE, make_dop853
from symsimpson.support.array_types import Floats
from symsimpson.support.names import as_tuple

#: Decimal digits of the reference solution.
DIGITS = 20
#: The prepared run that a contender makes for a choice.
Prepared = TypeVar("Prepared")

#: Tolerances from coarse to fine.
TOLERANCES = tuple(10.0 ** (-k / 2) for k in range(2, 31))
COARSE = TOLERANCES[::2]
#: A scheme for every system; it converts states, and its runs have no step.
START_SCHEME = "midpoint"
#: The coarsest step is this number divided by the largest angular frequency at the start.
COARSEST = 8.0


@dataclass(frozen=True)
class FinalState:
    """The final state of a run, and the number of its evaluations."""

    q: Floats
    p: Floats
    evaluations: int


@dataclass(frozen=True, eq=False)
class BenchmarkProblem:
    """An initial value problem of a system, with a reference solution at ``t_end``."""

    system: MechanicalSystem
    #: Initial coordinates, velocities and momenta, each of shape (n,).
    q0: Floats
    v0: Floats
    p0: Floats
    t_end: float
    #: The equations of motion in (q, p) and in (q, v), as systems of first order. A general
    #: Lagrangian has none in p, and a Hamiltonian none in v.
    in_momenta: FirstOrder | None
    in_velocities: FirstOrder | None
    solution: Floats  #: q and p at ``t_end``, shape (2 n,).
    solution_error: float  #: Its estimated error, in units of ``scale``.
    #: Errors are divided by these sizes, shape (2 n,). The size of a coordinate is its largest
    #: value, but at least 1, or the largest of all coordinates if that is below 1. The size of
    #: momenta is the largest momentum.
    scale: Floats
    #: The same motion with a time transformation, if schemes shall run in both times.
    retimed: RetimedSystem | None = None

    def error(self, q: Any, p: Any) -> float:
        """Return the largest error of a state at ``t_end``, in units of ``scale``."""
        difference = np.concatenate([q, p]) - self.solution
        largest = float(np.abs(difference / self.scale).max())
        return largest if np.isfinite(largest) else float("inf")

    @property
    def equations(self) -> FirstOrder:
        """The equations that other programs solve: in (q, p) if possible, else in (q, v)."""
        if self.in_momenta is not None:
            return self.in_momenta
        assert self.in_velocities is not None  # one of them exists
        return self.in_velocities

    @property
    def start(self) -> Floats:
        """The initial state of ``equations``."""
        second = self.p0 if self.in_momenta is not None else self.v0
        return np.array(self.equations.state(self.q0, second))

    def final(self, y: Any, evaluations: int) -> FinalState:
        """Return the final state for a state of ``equations``."""
        q, second = np.split(np.asarray(y)[: 2 * self.system.n], 2)
        return FinalState(q, second if self.in_momenta else self.momentum(q, second), evaluations)

    def momentum(self, q: Any, v: Any) -> Floats:
        """Return p for a state (q, v); NaN for a state that is not finite."""
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            return np.full(len(self.q0), np.nan)
        stepper = compile_system(self.system, START_SCHEME)
        momentum: Floats = stepper.integrate(q, v0=v, h=1.0, steps=0).p[0]
        return momentum


def make_problem(
    system: MechanicalSystem, state: Mapping[str, Any] | None, t_end: float
) -> BenchmarkProblem:
    """Compute a reference solution with 20 digits and its estimated error.

    Raises InputError if the initial state is missing or the system has constraints. Raises
    ArithmeticError if the solution has a singularity before ``t_end``.
    """
    retimed = system if isinstance(system, RetimedSystem) else None
    system = system if retimed is None else retimed.original
    stepper = compile_system(system, START_SCHEME)
    q, p = choose_state(stepper, state, stepper.program.named_values())
    if system.constraints:
        reject(
            "the system has constraints.",
            where=system.name,
            why="The other programs do not satisfy them, so their states cannot be compared.",
            remedy="Use coordinates without constraints, or compare schemes with ss.choose.",
        )
    plain, n = system.plain, system.n
    in_momenta = canonical(system) if plain.quadratic or plain.hamiltonian is not None else None
    in_velocities = second_order(system) if plain.hamiltonian is None else None
    v = stepper.integrate(q, p0=p, h=1.0, steps=0).v[0]
    problem = BenchmarkProblem(
        system, q, v, p, float(t_end), in_momenta, in_velocities, p, 0.0, p, retimed
    )
    equations, second = problem.equations, p if in_momenta else v
    start = equations.state([mpmath.mpf(float(x)) for x in (*q, *second)])
    samples = [mpmath.mpf(t_end) * k / 8 for k in range(1, 9)]
    solution = truth(equations, start, samples, digits=DIGITS)
    ends = [problem.final(np.array([float(x) for x in y[: 2 * n]]), 0) for y in solution.y]
    path = np.array([np.concatenate([end.q, end.p]) for end in ends])
    largest = np.abs(np.vstack([np.concatenate([q, p]), path])).max(axis=0)
    least = min(1.0, largest[:n].max() or 1.0)
    scale = np.concatenate([np.maximum(largest[:n], least), np.full(n, largest[n:].max() or 1.0)])
    errors = np.array(solution.errors, dtype=np.float64)[..., : 2 * n]
    return replace(
        problem, solution=path[-1], scale=scale, solution_error=float(np.max(errors / scale))
    )


#: A function that runs, and a function that converts its result to the final state.
Runnable = tuple[Callable[[], Any], Callable[[Any], FinalState]]


@dataclass(frozen=True)
class Contender(Generic[Prepared]):
    """A program that solves a problem with an accuracy that can be chosen."""

    name: str
    what: str  #: "steps" or "tolerance".
    choices: Sequence[float]  #: Numbers of steps or tolerances, from coarse to fine.
    make: Callable[[float], Prepared]  #: Prepares a run for one of the choices.


def choose_step_counts(problem: BenchmarkProblem) -> list[int]:
    """Return numbers of steps from coarse to fine; all of them resolve the fastest oscillation."""
    values = problem.system.parameters.values()
    turns = problem.t_end * largest_frequency(problem.system, problem.q0, values) / COARSEST
    least = max(4, round(problem.t_end / 2), round(turns))
    return [round(least * 2 ** (k / 4)) for k in range(80)]


def alternate(jobs: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, list[float]]:
    """Return the seconds of jobs that run in turns, so that disturbances affect all of them."""
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            begin = time.perf_counter()
            job()
            times[name].append(time.perf_counter() - begin)
    return times


def make_scheme_contender(
    problem: BenchmarkProblem, scheme: str | Scheme, retimed: RetimedSystem | None = None
) -> Contender[Runnable]:
    """Return the contender of a scheme; its evaluations are Newton iterations.

    With a time transformation, a choice is the number of steps that the size of the first step
    corresponds to.
    """
    stepper = compile_system(retimed or problem.system, scheme)

    def make(steps: float) -> Runnable:
        count = int(steps)
        h, end = problem.t_end / count, problem.t_end
        length: Any = {"steps": count} if retimed is None else {"t_end": end}
        function = stepper.function(h=h, **length)

        def run() -> Any:
            return function(problem.q0, problem.p0, full=True)

        def read(result: Any) -> FinalState:
            (q, p), _ = result  # NaN if the run failed
            start = {"q0": problem.q0, "p0": problem.p0, "h": h, **length}
            run = raise_if_interrupted(stepper.integrate(**start, every=None, on_failure="return"))
            return FinalState(q, p, int(run.newton_iterations.sum()))

        return run, read

    name, choices = stepper.scheme, choose_step_counts(problem)
    if retimed is not None:  # adaptive steps: fewer are enough
        coarse = [round(choices[0] * 2 ** (k / 4)) for k in range(-8, 0)]
        name, choices = f"{name} retimed", [count for count in coarse if count >= 4] + choices
    return Contender(name, "steps", choices, make)


MOST_STEPS = 200_000  #: A run of heyoka takes no more steps than this.


def _compile_rates(problem: BenchmarkProblem) -> tuple[Any, Floats, Floats]:
    """Return the compiled right-hand side, the parameters and the initial state."""
    equations = problem.equations
    parameters = np.array(equations.values(None), dtype=np.float64)
    return compiled_rates(equations), parameters, problem.start


def _runge_kutta(problem: BenchmarkProblem) -> Iterator[Contender[Runnable]]:
    """Yield RK4 and DOP853, compiled together with the right-hand side."""
    rates, parameters, start = _compile_rates(problem)

    def make_runner(solve: Callable[[Floats, float], int]) -> Any:
        def make(choice: float) -> Runnable:
            def run() -> Any:
                y = start.copy()
                return y, solve(y, choice)

            return run, lambda result: problem.final(*result)

        return make

    rk4, dop853 = compiled_rk4(problem.equations), make_dop853(rates)
    states = np.empty((2, start.size))

    def fixed(y: Floats, steps: float) -> int:
        count = int(steps)
        for first in range(0, count, PIECE):
            some = min(PIECE, count - first)
            rk4(y, parameters, problem.t_end / count, some, some, states)
        return 4 * count

    def adaptive(y: Floats, tolerance: float) -> int:
        progress = np.zeros(4)
        while not (done := dop853(y, parameters, problem.t_end, tolerance, progress)):
            pass
        return int(done)

    yield Contender("rk4", "steps", choose_step_counts(problem), make_runner(fixed))
    yield Contender("dop853", "tolerance", TOLERANCES, make_runner(adaptive))


def _scipy(problem: BenchmarkProblem) -> Iterator[Contender[Runnable]]:
    """Yield solvers of SciPy with a compiled right-hand side."""
    from scipy.integrate import solve_ivp

    rates, parameters, start = _compile_rates(problem)

    def right(t: float, y: Floats) -> Floats:
        out = np.empty_like(y)
        rates(y, parameters, out)
        return out

    for method in ("DOP853", "LSODA", "Radau"):

        def make(tolerance: float, method: str = method) -> Runnable:
            def run() -> Any:
                return solve_ivp(
                    right,
                    (0.0, problem.t_end),
                    start,
                    method=method,
                    rtol=max(tolerance, 2.3e-14),
                    atol=tolerance,
                )

            def read(solution: Any) -> FinalState:
                end = solution.y[:, -1] if solution.success else np.full(start.size, np.nan)
                return problem.final(end, int(solution.nfev))

            return run, read

        # Radau, of order 5, is too slow for smaller tolerances
        choices = COARSE[:5] if method == "Radau" else COARSE
        yield Contender(f"scipy {method}", "tolerance", choices, make)


def _heyoka(problem: BenchmarkProblem) -> Iterator[Contender[Runnable]]:
    """Yield the Taylor method of heyoka, for both forms of the equations and both compile modes."""
    import heyoka as hy

    n = problem.system.n
    # heyoka has one tolerance for all variables: scale them if their sizes differ much
    units = problem.scale if np.ptp(np.log10(problem.scale)) > 2 else np.ones(2 * n)
    forms = (
        ("q, p", problem.in_momenta, problem.p0, units, lambda q, p: p),
        ("q, v", problem.in_velocities, problem.v0, np.ones(2 * n), problem.momentum),
    )
    for form, equations, other, scale, momentum in forms:
        if equations is None:
            continue
        scale = np.array([*scale, *np.ones(len(equations.unknowns) - 2 * n)])
        system = to_heyoka(hy, equations, scale)
        start = np.array(equations.state(problem.q0, other)) / scale
        for mode in ("", " compact"):

            def make(
                tolerance: float,
                system: Any = system,
                start: Floats = start,
                compact: bool = bool(mode),
                momentum: Callable[..., Any] = momentum,
                scale: Floats = scale,
            ) -> Runnable:
                integrator = hy.taylor_adaptive(
                    system, start.tolist(), tol=max(tolerance, 2.3e-16), compact_mode=compact
                )

                def run() -> Any:
                    integrator.time = 0.0
                    integrator.state[:] = start
                    steps, limit = 0, hy.taylor_outcome.step_limit
                    while steps < MOST_STEPS:
                        outcome, *_, taken = integrator.propagate_until(
                            problem.t_end, max_steps=PIECE
                        )[:4]
                        steps += taken
                        if outcome != limit:
                            break
                    return steps

                def read(steps: Any) -> FinalState:
                    q, second = np.split((integrator.state * scale)[: 2 * n], 2)
                    return FinalState(q, momentum(q, second), int(steps))

                return run, read

            yield Contender(f"heyoka{mode} ({form})", "tolerance", TOLERANCES, make)


def to_heyoka(hy: Any, equations: FirstOrder, scale: Floats | None = None) -> list[tuple[Any, Any]]:
    """Return y' = f(y) in expressions of heyoka, with y in units of ``scale``."""
    variables = [hy.make_vars(f"y_{i}") for i in range(len(equations.unknowns))]
    units = [1.0] * len(variables) if scale is None else [float(x) for x in scale]
    known: dict[Any, Any] = {
        symbol: variable if unit == 1.0 else variable * unit
        for symbol, variable, unit in zip(equations.unknowns, variables, units, strict=True)
    }
    known |= {symbol: hy.expression(float(value)) for symbol, value in equations.parameters.items()}

    def convert(value: sp.Expr) -> Any:
        # heyoka does not accept fractions without an exact binary form
        inexact = {x: sp.Float(x, 17) for x in value.atoms(sp.Rational) if x.q & (x.q - 1)}
        value = value.xreplace(inexact)
        # heyoka divides by the base of powers above 2, and the base may be zero
        for power in sorted(value.atoms(sp.Pow), key=sp.count_ops):
            if power not in named and power.exp.is_Integer and power.exp > 2:
                base = hy.from_sympy(power.base.xreplace(named), known)
                named[power] = sp.Dummy()
                known[named[power]] = reduce(mul, [base] * int(power.exp))
        return hy.from_sympy(value.xreplace(named), known)

    named: dict[sp.Basic, sp.Basic] = {}
    for symbol, value in equations.definitions:
        known[symbol] = convert(value)
    rates = [convert(rate) for rate in equations.rates]
    rates = [rate if unit == 1.0 else rate / unit for rate, unit in zip(rates, units, strict=True)]
    return list(zip(variables, rates, strict=True))


def _numbalsoda(problem: BenchmarkProblem) -> Iterator[Contender[Runnable]]:
    """Yield LSODA and DOP853 of numbalsoda with a compiled right-hand side."""
    import numbalsoda
    from numba import carray, cfunc  # type: ignore[attr-defined]

    rates, parameters, start = _compile_rates(problem)
    size, count = len(start), len(parameters)

    @cfunc(numbalsoda.lsoda_sig)
    def right(t, y, out, data):  # type: ignore[no-untyped-def]  # numba infers them
        known = carray(data, (count + 1,))
        known[count] += 1.0
        rates(carray(y, (size,)), known, carray(out, (size,)))

    address = right.address
    times = np.array([0.0, problem.t_end])
    for method in ("lsoda", "dop853"):
        solve = getattr(numbalsoda, method)

        def make(tolerance: float, solve: Any = solve) -> Runnable:
            def run() -> Any:
                data = np.array([*parameters, 0.0])
                states, success = solve(
                    address, start, times, data, max(tolerance, 1e-13), tolerance
                )
                return states[-1] if success else np.full(size, np.nan), data[count]

            return run, lambda result: problem.final(result[0], int(result[1]))

        yield Contender(f"numbalsoda {method}", "tolerance", COARSE, make)


def _diffrax(problem: BenchmarkProblem) -> Iterator[Contender[Runnable]]:
    """Yield the explicit method of order 8 of diffrax, compiled once for all tolerances."""
    import diffrax
    import jax

    rates, values = problem.equations.function("jax"), problem.equations.values(None)
    start = problem.start

    def solve(y: Any, tolerance: Any) -> Any:
        term = diffrax.ODETerm(lambda t, y, _: jax.numpy.stack(rates(*y, *values)))
        return diffrax.diffeqsolve(
            term,
            diffrax.Dopri8(),
            0.0,
            problem.t_end,
            None,
            y,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            saveat=diffrax.SaveAt(t1=True),
            max_steps=None,
            throw=False,
            adjoint=diffrax.ForwardMode(),
        )

    with jax.enable_x64(True):
        compiled = jax.jit(solve).lower(start, 1.0).compile()

    def make(tolerance: float) -> Runnable:
        with jax.enable_x64(True):
            given = jax.numpy.asarray(start), jax.numpy.asarray(tolerance)

        def run() -> Any:
            solution = compiled(*given)
            solution.ys.block_until_ready()
            return solution

        def read(solution: Any) -> FinalState:
            end = np.asarray(solution.ys)[0]
            return problem.final(end, 13 * int(solution.stats["num_steps"]))

        return run, read

    yield Contender("diffrax Dopri8", "tolerance", COARSE, make)


#: Other programs by their names.
PROGRAMS: dict[str, Callable[[BenchmarkProblem], Iterator[Contender[Runnable]]]] = {
    "runge-kutta": _runge_kutta,
    "scipy": _scipy,
    "heyoka": _heyoka,
    "numbalsoda": _numbalsoda,
    "diffrax": _diffrax,
}


def read_peers(names: Any) -> list[str]:
    """Return the names of other programs; raise InputError if one is unknown."""
    if names == "installed":
        return list(PROGRAMS)
    wanted = list(as_tuple(names))
    for name in wanted:
        if name not in PROGRAMS:
            reject(
                f"peers contains {name!r}, which is unknown.",
                remedy=f"Use names among {', '.join(PROGRAMS)}, or () for no other program.",
            )
    return wanted


def make_peer_contenders(
    problem: BenchmarkProblem, names: str | Sequence[str] = "installed"
) -> Iterator[Contender[Runnable]]:
    """Yield the contenders of named programs, or of all installed programs.

    Raises InputError if a named program is unknown or not installed.
    """
    for name in read_peers(names):
        try:
            yield from PROGRAMS[name](problem)
        except ImportError as error:
            if names != "installed":
                reject(
                    f"the peer {name!r} is not installed: {error}.",
                    remedy="Install it with pip install 'symsimpson[bench]', or leave it out.",
                )
