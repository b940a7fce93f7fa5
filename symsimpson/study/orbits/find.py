"""The arguments of searches for periodic orbits and for paths between boundaries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
import sympy as sp

from symsimpson.api.stepper import Stepper
from symsimpson.errors import SymsimpsonError, reject
from symsimpson.program.input_values import read_count, whole_number
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.inputs import program_with_derivatives
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.study.orbits.boundary_path import Path
from symsimpson.study.orbits.conditions import read_closing, read_conditions
from symsimpson.study.orbits.flow import Flow, PeriodOfParameters, scale_of
from symsimpson.study.orbits.integrals import Integrals, find_integrals
from symsimpson.study.orbits.orbit import Orbit
from symsimpson.study.orbits.search import Search
from symsimpson.study.orbits.shooting import OrbitUnknowns, Shooting
from symsimpson.support.array_types import Floats
from symsimpson.support.contact_values import reject_contacts
from symsimpson.support.names import as_tuple, did_you_mean, spelled

#: Segments of searches that begin with states along the whole path.
SEGMENTS = 8
#: The time, in periods over 2 pi, after which a position that is no equilibrium has moved.
SOON = 0.01
#: The most steps to an event without a guess of the period, and the most periods with one.
STEPS_TO_EVENT, PERIODS_TO_EVENT = 1000, 4
#: Relative damping of an oscillation, and difference of two steps, that count as none.
UNDAMPED, SAME = 1e-9, 1e-9


@dataclass(frozen=True)
class OrbitArguments:
    """Arguments of :meth:`Stepper.periodic`."""

    q0: Any = None
    v0: Any = None
    p0: Any = None
    guess: Any = None
    mode: Any = None
    size: float = 0.01
    period: Any = None
    steps: Any = None
    h: Any = None
    fixed: Any = None
    middle: Any = None
    conditions: Any = None
    unknowns: Any = ()
    parameters: Any = None
    events: Any = None
    t0: Any = 0.0
    error: Any = None


def find_periodic(tools: Any, stepper: Stepper, **arguments: Any) -> Orbit:
    """Search for a periodic orbit; see :meth:`Stepper.periodic`."""
    given = OrbitArguments(**arguments)
    search, start = read_search(stepper, given, tools)
    orbit, error = search.orbit(search.shooting.solve(start)), given.error
    return orbit if error is None else search.refined_to(orbit, _read_number("error", error))


def read_search(
    stepper: Stepper, given: OrbitArguments, tools: Any, integrals: Integrals | None = None
) -> tuple[Search, OrbitUnknowns]:
    """Read the arguments; return the equations and the first values of the unknowns.

    The first ``integrals`` of the system are searched for if they are not known.
    """
    _check_system(stepper)
    header, to_event = stepper.program.header, given.events is not None
    unknowns = _read_unknowns(stepper, given.unknowns)
    given = _with_defaults(stepper, given)
    period, period_of = _read_period(stepper, given, unknowns)
    states = _read_guess(stepper, given, period)
    parts, segments, steps = 2 if given.middle else 1, 1, STEPS_TO_EVENT
    if to_event and given.period is not None:
        steps = int(np.ceil(PERIODS_TO_EVENT * period / abs(_read_number("h", abs(given.h)))))
    if not (to_event or header.retimed):
        steps = read_count("steps", 64 if given.steps is None else given.steps, least=1)
        segments = 1 if states is None or steps < SEGMENTS else SEGMENTS
        if steps % segments:
            reject(
                f"steps={steps} is not divisible by {segments}.",
                where=stepper.system,
                why=f"A guess along the whole orbit is used in {segments} segments.",
                remedy=f"Pass a multiple of {segments}.",
            )
        if steps % parts:
            reject(f"steps={steps} is odd, but middle= divides the orbit.", where=stepper.system)
    if states is not None:
        given = replace(given, q0=states[0, : stepper.n], v0=None, p0=states[0, stepper.n :])
    flow = _make_flow(stepper, given, unknowns, steps // parts, period_of, period / parts)
    closing = read_closing(stepper.program, given.conditions, unknowns)
    values, z = flow.spec.parameters, np.concatenate([flow.spec.q0, flow.spec.other0])
    scale = scale_of(_states_ahead(flow, z, period / parts) if states is None else states)
    table = z[None] if states is None else states[:segments].copy()
    flow = replace(flow, segments=segments, parts=parts)
    conditions = read_conditions(flow, "fixed", given.fixed)
    middle = read_conditions(flow, "middle", given.middle)
    if segments > 1 and conditions and header.autonomous:  # begin where the conditions hold best
        off = [[abs(c.row(flow, x, period, values)[0]) for c in conditions] for x in table]
        table = np.roll(table, -int(np.max(off, axis=1).argmin()), axis=0)
    integrals = integrals or find_integrals(stepper, flow, closing, z)
    ends = None if middle else closing
    extra = np.zeros(len(closing.symbols) if ends else 0)
    # a value of 0 has the scale of the state
    sizes = np.array([abs(x) or scale[0] for x in (*values[list(flow.places)], *extra)])
    length = period / parts
    shooting = Shooting(flow, ends, conditions, integrals, scale, length, sizes, middle)
    _check_freedom(stepper, shooting)
    symplectic = header.conservative and not to_event and header.autonomous
    mirror = _reversal(stepper, given.middle) if middle else None
    search = Search(stepper, shooting, given, symplectic, tools, mirror)
    length = length if period_of is None else period_of(values)[0]
    return search, OrbitUnknowns(table, length, values, extra, np.zeros(shooting.unfolded))


def _check_system(stepper: Stepper) -> None:
    """Reject steppers whose orbits cannot be searched for."""
    program = stepper.program
    reject_contacts(program.modes, program.system, "a search for orbits")
    if program.declared is None:
        reject(
            "a search for orbits needs T and V, which a generated file lacks.",
            where=stepper.system,
            remedy="Make the stepper with symsimpson.compile.",
        )
    if program.header.constraints:
        reject(
            "orbits of systems with constraints are not available.",
            where=stepper.system,
            remedy="Use coordinates that satisfy the constraints.",
        )
    if not program.numbers.compiled:
        reject("a search for orbits needs double precision.", remedy="Compile without precision=.")
    if program.inputs and program.default_inputs is None:
        reject(
            "orbits of systems with inputs are not available.",
            where=stepper.system,
            remedy="Write the input as a parameter, or as a function of symsimpson.time.",
        )


def _read_unknowns(stepper: Stepper, given: Any) -> tuple[sp.Symbol, ...]:
    """Read the symbols to solve for: parameters by symbol or name, and other symbols."""
    assert stepper.program.declared is not None
    declared = {str(x): x for x in stepper.program.declared.parameters}
    symbols = [declared.get(spelled(x), x) for x in as_tuple(given)]
    for x in symbols:
        if not isinstance(x, sp.Symbol):
            reject(
                f"unknowns contains {x!r}, which is no parameter."
                f"{did_you_mean(spelled(x), [*declared])}",
                remedy="Pass parameters, or symbols of conditions=.",
            )
    # parameters come first
    return tuple(sorted(symbols, key=lambda x: x not in declared.values()))


def _with_defaults(stepper: Stepper, given: OrbitArguments) -> OrbitArguments:
    """Fill in what a guess or a mode determines."""
    if isinstance(given.guess, Path):
        orbit = given.guess
        given = replace(
            given,
            period=orbit.period if given.period is None else given.period,
            steps=orbit.steps if given.steps is None else given.steps,
            parameters={**orbit.parameters, **(given.parameters or {})},
            guess=orbit.trajectory,
        )
    elif isinstance(given.guess, Trajectory) and given.period is None:
        given = replace(given, period=float(given.guess.t[-1] - given.guess.t[0]))
    if given.mode is not None:
        given = _states_of_mode(stepper, given)
    if given.q0 is None and given.guess is None:
        reject(
            "a search needs a guess.",
            where=stepper.system,
            remedy="Pass q0 and v0 (or p0=), guess=, or mode=.",
        )
    return given


def _states_of_mode(stepper: Stepper, given: OrbitArguments) -> OrbitArguments:
    """Return the arguments with the states of a linear mode as the guess."""
    if not (isinstance(given.mode, (tuple, list)) and len(given.mode) == 2):
        reject(f"mode is {given.mode!r}.", remedy="Pass (position of the equilibrium, number).")
    (place, number), n = given.mode, stepper.n
    rest = stepper.integrate(place, v0=np.zeros(n), h=1.0, steps=0, parameters=given.parameters)
    system, canonical = stepper.program.declared, stepper.program.header.canonical
    assert system is not None
    second = rest.p[0] if canonical else np.zeros(n)
    A, _ = system.linearise(rest.q[0], second, parameters=given.parameters)
    values, vectors = np.linalg.eig(A)
    order = np.argsort(values.imag)
    undamped = (values.imag > 0) & (abs(values.real) < UNDAMPED * values.imag)
    turning = order[undamped[order]]
    number = whole_number(number)
    if number is None or not 0 <= number < len(turning):
        reject(
            f"mode has the number {number!r}, but the equilibrium has {len(turning)} oscillations.",
            where=stepper.system,
            remedy="Count from 0, the slowest one.",
        )
    frequency = values[turning[number]].imag
    _check_equilibrium(stepper, rest, given, frequency)
    vector = vectors[:, turning[number]]
    vector = vector / vector[:n][abs(vector[:n]).argmax()]  # one coordinate starts at its extreme
    turns = np.exp(2j * np.pi * np.arange(SEGMENTS) / SEGMENTS)
    states = np.concatenate([rest.q[0], second]) + given.size * np.real(turns[:, None] * vector)
    q, p = states[:, :n], states[:, n:]
    if not canonical:
        p = _momenta(stepper, q, p, given)
    return replace(given, period=2 * np.pi / frequency, guess=(q, p), mode=None)


def _check_equilibrium(
    stepper: Stepper, rest: Any, given: OrbitArguments, frequency: float
) -> None:
    """Reject a position whose equilibrium is farther away than the amplitude of the guess."""
    options = {"parameters": given.parameters, "t0": given.t0, "steps": 1}
    after = stepper.integrate(rest.q[0], p0=rest.p[0], h=SOON / frequency, **options)
    away = 2 * (after.q[1] - rest.q[0]) / SOON**2  # the acceleration, divided by the frequency^2
    if not abs(away).max() <= given.size:
        worst = stepper.coordinates[int(abs(away).argmax())]
        reject(
            f"mode= needs an equilibrium, but forces move this position, most of all {worst}.",
            where=stepper.system,
            remedy="Pass the position at which all forces are zero, or a larger size=.",
        )


def _momenta(stepper: Stepper, q: Floats, v: Floats, given: OrbitArguments) -> Floats:
    """Return the momenta at rows of positions and velocities."""
    options = {"h": 1.0, "steps": 0, "parameters": given.parameters, "t0": given.t0}
    return np.array([stepper.integrate(a, v0=b, **options).p[0] for a, b in zip(q, v, strict=True)])


def _read_number(name: str, given: Any) -> float:
    """Read a positive number."""
    known = isinstance(given, Real) or getattr(given, "is_number", False)
    number = float(given) if known else np.nan
    if not 0 < number < np.inf:
        reject(f"{name} is {given!r}.", remedy="Pass a positive number.")
    return number


def _read_period(
    stepper: Stepper, given: OrbitArguments, unknowns: Sequence[sp.Symbol]
) -> tuple[float, PeriodOfParameters | None]:
    """Return the period, and how it follows from the parameters if the system is driven."""
    program = stepper.program
    assert program.declared is not None
    if given.events is not None:
        if given.h is None:
            reject("an orbit that ends at an event needs h=.", where=stepper.system)
        return float(given.period or 1.0), None
    if given.period is None:
        reject("a search needs the period, or a guess of it.", remedy="Pass period=.")
    if isinstance(given.period, str):
        reject(f"period is {given.period!r}, a text.", remedy="Pass a number or an expression.")
    symbols, whole = tuple(program.declared.parameters), sp.sympify(given.period)
    strange = [str(x) for x in whole.free_symbols if x not in symbols]
    if strange:
        reject(
            f"the period contains {strange[0]}.", remedy="Write it with parameters of the system."
        )
    slopes = [whole.diff(x) for x in symbols if x in unknowns]
    if not whole.free_symbols:
        period, none = _read_number("period", given.period), np.zeros(len(slopes))
        if program.header.autonomous:
            return period, None
        _check_drive(stepper, given, period)
        return period, lambda _: (period, none)
    evaluate = sp.lambdify(symbols, [whole, *slopes], "math")

    def period_of(at: Floats) -> tuple[float, Floats]:
        length, *by_unknown = evaluate(*at.tolist())
        return float(length), np.array(by_unknown, dtype=np.float64)

    period = _read_number("period", period_of(program.values(given.parameters))[0])
    return period, None if program.header.autonomous else period_of


def _check_drive(stepper: Stepper, given: OrbitArguments, period: float) -> None:
    """Reject a number that is no period of the drive."""
    rng = np.random.default_rng(3)
    q, p = rng.normal(size=(2, stepper.n))
    for t in float(given.t0) + period * np.array([0.0, 0.237, 0.71]):
        try:
            ends = [
                np.hstack(stepper.step(q, p=p, h=period / 256, t=s, parameters=given.parameters))
                for s in (t, t + period)
            ]
        except SymsimpsonError:
            continue
        if abs(ends[1] - ends[0]).max() > SAME * abs(ends[0]).max():
            reject(
                f"period={period:g} is no period of the drive: the forces at t and t + {period:g} "
                "differ.",
                where=stepper.system,
                remedy="Write it with parameters, such as 2*sympy.pi/w.",
            )


def _read_guess(stepper: Stepper, given: OrbitArguments, period: float) -> Floats | None:
    """Return states along the whole orbit, shape (m, 2 n), or None for a single initial state."""
    guess, n = given.guess, stepper.n
    if guess is None:
        return None
    if isinstance(guess, Trajectory):
        t = guess.t[0] + period * np.arange(SEGMENTS) / SEGMENTS
        t = np.minimum(t, guess.t[-1]) if guess.h > 0 else np.maximum(t, guess.t[-1])
        return np.asarray(guess.sol(t).T)
    try:
        q, p = (np.atleast_2d(np.asarray(x, dtype=np.float64)) for x in guess)
    except (TypeError, ValueError):
        q = p = np.zeros((0, 0))
    if q.shape != p.shape or q.ndim != 2 or q.shape[1] != n or not np.isfinite([q, p]).all():
        reject(
            "guess is neither a run, nor an orbit, nor a pair of finite arrays q and p of shape "
            f"(m, {n}).",
            where=stepper.system,
            remedy="Pass stepper.integrate(...), another orbit, or (q, p) at equal intervals.",
        )
    # trigonometric interpolation between the states of the table
    states = np.concatenate([q, p], axis=1)
    waves, count = np.fft.rfft(states, axis=0), max(len(states), SEGMENTS) * SEGMENTS
    if len(states) % 2 == 0:  # the highest frequency of the table is a positive and a negative one
        waves[-1] /= 2
    whole = np.fft.irfft(waves, n=count, axis=0) * (count / len(states))
    return np.asarray(whole[:: count // SEGMENTS])


def _make_flow(
    stepper: Stepper,
    given: OrbitArguments,
    unknowns: Sequence[sp.Symbol],
    steps: int,
    period_of: PeriodOfParameters | None,
    period: float,
) -> Flow:
    """Return the runs of a search, with one segment."""
    program, retimed = stepper.program, stepper.program.header.retimed
    assert program.declared is not None
    places = tuple(k for k, x in enumerate(program.declared.parameters) if x in unknowns)
    names = tuple(program.header.parameters[k] for k in places)
    sized = given.events is None and not retimed
    if not retimed:
        program = program_with_derivatives(program, ("h", *names) if sized else names)
    h = period / steps if sized else given.h
    if h is None:
        reject("a retimed system needs h=, its step in tau.", where=stepper.system)
    end = {"t_end": float(given.t0) + period} if retimed else {"steps": steps}
    options = {"t0": given.t0, "parameters": given.parameters, "events": given.events, **end}
    request = Request(given.q0, given.v0, given.p0, h, tangents=2 * stepper.n, **options)
    spec: RunSpec = read_run(program, request)
    if spec.velocities:  # the unknowns are momenta
        p = _momenta(stepper, spec.q0[None], spec.other0[None], given)[0]
        spec = replace(spec, other0=p, given="p0")
    return Flow(program, replace(spec, every=0), places, steps, period_of=period_of)


def _states_ahead(flow: Flow, z: Floats, period: float) -> Floats:
    """Return states along a run from the guess, up to a failure."""
    states = [z]
    if flow.free_period or flow.period_of is not None:
        count = 1 if flow.retimed else SEGMENTS
        flow = replace(flow, segments=count, steps=-(-flow.steps // count) * count)
        for k in range(count):
            leg = flow.leg(k, states[-1], period, flow.spec.parameters)
            if not np.isfinite(leg.end).all():
                break
            states.append(leg.end)
    return np.array(states)


def _check_freedom(stepper: Stepper, shooting: Shooting) -> None:
    """Reject more conditions than an orbit can satisfy."""
    excess = shooting.rows - shooting.columns
    if excess <= 0:
        return
    count = len(shooting.conditions) + len(shooting.last)
    reject(
        f"there are {count} conditions, but at most {count - excess} can hold.",
        where=stepper.system,
        why="Each first integral and each unknown admits one, and a free period another one.",
        remedy="Remove conditions, or add unknowns.",
    )


def _reversal(stepper: Stepper, middle: Any) -> Floats:
    """Return the reversal of (q, p) whose fixed points satisfy the conditions."""
    places = [stepper.program.names.coordinates.place(key) for key in middle]
    signs = np.ones(stepper.n)
    signs[[k for k in places if k is not None]] = -1.0
    return np.diag([*signs, *-signs])


def find_path(
    tools: Any, stepper: Stepper, ends: tuple[Any, Any], duration: Any, steps: Any, run: Any
) -> Path:
    """Search for a path between two boundaries; see :meth:`Stepper.boundary`."""
    _check_system(stepper)
    if stepper.program.header.retimed:
        reject(
            "boundaries of retimed systems are not available.",
            where=stepper.system,
            remedy="Use the system without the time transformation.",
        )
    given, none = OrbitArguments(parameters=run[0], t0=run[1]), np.zeros(0)
    steps = read_count("steps", 64 if steps is None else steps, least=1)
    (left, first), (right, final) = (_read_end(stepper, x) for x in ends)
    free = duration is None
    period = _time_scale(stepper, first, given) if free else _read_number("duration", duration)
    segments = SEGMENTS if steps % SEGMENTS == 0 else 1
    q = first + np.arange(SEGMENTS)[:, None] / SEGMENTS * (final - first)
    p = _momenta(stepper, q, np.tile((final - first) / period, (SEGMENTS, 1)), given)
    given, states = replace(given, q0=q[0], p0=p[0]), np.concatenate([q, p], axis=1)
    constant = None if free else (lambda _: (period, none))
    flow = replace(_make_flow(stepper, given, (), steps, constant, period), segments=segments)
    conditions, last = read_conditions(flow, "q0", left), read_conditions(flow, "q1", right)
    integrals, scale = Integrals(False, (), timeless=False), scale_of(states)
    shooting = Shooting(flow, None, conditions, integrals, scale, period, none, last)
    _check_freedom(stepper, shooting)
    search = Search(stepper, shooting, given, symplectic=False, tools=tools)
    start = OrbitUnknowns(states[:segments], period, flow.spec.parameters, none, none)
    return search.path(shooting.solve(start))


def _time_scale(stepper: Stepper, q: Floats, given: OrbitArguments) -> float:
    """Return 1 over the fastest rate of the motion near a position at rest."""
    system, at_rest = stepper.program.declared, np.zeros(stepper.n)
    assert system is not None
    try:
        A, _ = system.linearise(q, at_rest, parameters=given.parameters, t=float(given.t0))
        rate = float(abs(np.linalg.eigvals(A)).max())
    except SymsimpsonError:
        rate = 0.0
    if not rate > 0:
        reject(
            "nothing determines a guess of the duration.",
            where=stepper.system,
            remedy="Pass duration=, and vary it.",
        )
    return 1 / rate


def _read_end(stepper: Stepper, given: Any) -> tuple[Mapping[Any, Any], Floats]:
    """Return the conditions at an end as a mapping, and its coordinates; unknown ones are 0."""
    names, values = stepper.program.names.coordinates, np.zeros(stepper.n)
    if not isinstance(given, Mapping):
        numbers = np.asarray(given, dtype=np.float64)
        if numbers.shape != values.shape:
            reject(
                f"a boundary has shape {numbers.shape}, expected ({stepper.n},).",
                where=stepper.system,
                remedy="Pass a number for each coordinate, or a mapping.",
            )
        given = dict(zip(stepper.coordinates, numbers.tolist(), strict=True))
    for key, x in given.items():
        if isinstance(x, Real) and names.place(key) is not None:
            values[names.place(key)] = x
    return given, values
