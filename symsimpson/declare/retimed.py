"""Time-transformed systems, dt = g(q) dtau, with fixed steps in tau.

K = g (H - E0) has the orbits of H on K = 0, and t' = g there. Like H, it is quadratic in the
momenta. Its Lagrangian L~ = T(q, q')/g + a.q' - g (V - E0) has the same form and the same momenta.
To differentiate a run, the package uses a system in which E0 is a coordinate and the time is its
momentum. Both systems have the same steps (Marsden and West 2001, section 1.2.3).
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar

import mpmath
import numpy as np
import sympy as sp
from numpy.typing import NDArray

from symsimpson.declare.checks import reject_model, spell
from symsimpson.declare.coordinates import coordinates
from symsimpson.declare.declared import Declared
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.plain import Plain, Symbols
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluate_values
from symsimpson.graph.nodes import Graph, Value
from symsimpson.graph.read import SympyConverter

#: The symbol that replaces V in functions of V.
level = sp.Symbol("level", real=True)
#: Number of points, and digits there, for the search for a power of V.
POINTS, DIGITS = 4, 40
#: Largest denominator of such a power.
LARGEST = 12
#: E0, the energy of the run, in rates and among the parameters of a retimed system.
energy = sp.Symbol("E0", real=True)
#: The rate g at the start of the run, by which rates are divided.
first_rate = sp.Symbol("g_start", positive=True)
#: The factor that keeps the rate finite at rest.
rest = sp.Symbol("c_rest", positive=True)
RUN_PARAMETERS = (energy, first_rate)
#: The energy that keeps the rate finite at rest is c_rest times this part of E0 - V0.
REST, REST_OF_ATTRACTION = sp.Rational(1, 8), sp.Rational(1, 1024)
#: Smaller than the square of any difference of energies.
NOTHING = sp.Rational(1, 2**800)
#: Functions that are finite for all real numbers.
FINITE = (sp.sin, sp.cos, sp.sinh, sp.cosh, sp.tanh, sp.exp, sp.atan, sp.asinh, sp.erf, sp.erfc)
#: First words of the names of derivatives of E0, of the rate, and of p at constant velocities.
E_BY, RATE_BY, MOMENTUM_BY = "E by ", "rate by ", "p by "
#: The mass of E0 as a coordinate: so large that E0 does not move in double precision.
HEAVY = sp.Integer(2) ** 200


def _as_function_of_potential(
    system: Declared, rate: sp.Expr, symbols: Symbols, value: Value
) -> sp.Expr | None:
    """Write a rate as a function of V, with :data:`level` in its place, or return None.

    If the rate is a constant times a power of -V, the function is that power without the
    constant. The ``value`` is the node of the rate in the graph of the symbols.
    """
    V, coordinates = system.potential, system.coordinates
    for sign in (1, -1):
        expression = rate.subs(sign * V, sign * level)
        if not expression.has(*coordinates) and expression.has(level):
            return expression
    power = _power_of_potential(symbols, SympyConverter(symbols.graph, symbols.known)(V), value)
    return None if power is None else (-level) ** power


def _power_of_potential(symbols: Symbols, V: Value, rate: Value) -> sp.Rational | None:
    """Return s if the rate is a constant times (-V)^s, judged by slopes at random points."""
    graph, q = symbols.graph, symbols.numbers(symbols.q)
    inside = sorted(graph.nodes[V[1]].symbols | graph.nodes[rate[1]].symbols | {*q})
    wanted = [V, rate, *gradient(graph, V, q), *gradient(graph, rate, q)]
    numbers, powers = random.Random(1), []
    with mpmath.workdps(DIGITS):
        small = mpmath.mpf(10) ** (DIGITS // -2)
        for _ in range(POINTS):
            point = {n: mpmath.mpf(numbers.uniform(0.3, 1.7)) for n in inside}
            v, u, *d = evaluate_values(graph, wanted, point, mpmath.mp)
            if not v < 0 or u == 0 or not all(map(mpmath.isfinite, (v, u, *d))):
                return None
            for dv, du in zip(d[: len(q)], d[len(q) :], strict=True):
                if abs(dv) > small:
                    powers.append(du * v / (dv * u))
                elif abs(du) > small:
                    return None
        if not powers or max(powers) - min(powers) > small:
            return None
        power = Fraction(float(powers[0])).limit_denominator(LARGEST)
        exact = abs(powers[0] - mpmath.mpf(power.numerator) / power.denominator) < small
    return sp.Rational(power.numerator, power.denominator) if exact and power else None


@dataclass(frozen=True)
class TimeTransformation:
    """The parts of a retimed system that its modules use."""

    plain: Plain  #: The original system, in t.
    graph: Graph
    rate: Value  #: dt/dtau in this graph, as the user declared it.
    #: dt/dtau as a function of :data:`level` in plain symbols; None if it is not one of V.
    of_potential: sp.Expr | None


@dataclass(frozen=True, eq=False, repr=False)
class RetimedSystem(MechanicalSystem):
    """A system with fixed steps in tau, dt = g(q) dtau; ``system.retimed(g)`` returns it.

    Each run sets two additional parameters at its start: the energy E0, and the initial rate, by
    which g is divided. The states of a run are functions of t. They have the
    momenta, velocities and energy of the original system. ``run.tau`` has the values of tau.

    Attributes
    ----------
    original : MechanicalSystem
        The system before the time transformation.
    rate : SymPy expression
        The rate g = dt/dtau as the user declared it, up to a constant factor.
    of_level : SymPy expression or None
        The rate as a function of V, with the symbol ``level`` in place of V. It is None if g is
        not a function of V.

    Notes
    -----
    K = g (H - E0) is a Hamiltonian with the same orbits and momenta as H [1]_. The scheme is
    symplectic for K, and K does not drift. H - E0 = K/g may be large if g is small.

    References
    ----------
    .. [1] E. Hairer, Variable time step integration with symplectic methods, Appl. Numer. Math. 25
       (1997), 219-227.

    Examples
    --------
    >>> import sympy as sp, symsimpson as ss
    >>> x, y = ss.coordinates("x y")
    >>> kepler = ss.MechanicalSystem(
    ...     "kepler_plane", coordinates=(x, y), kinetic=(x.diff()**2 + y.diff()**2)/2,
    ...     potential=-1/sp.sqrt(x**2 + y**2))
    >>> stepper = ss.compile(kepler.retimed("encounters"), "gauss8")
    >>> run = stepper.integrate([1.99, 0.0], v0=[0.0, 0.05], h=0.25, t_end=20.0)
    >>> float(run.t[-1]), bool(abs(run.energy_error[-1]) < 1e-9)
    (20.0, True)
    """

    mass_checked: ClassVar[bool] = True
    original: MechanicalSystem = field(kw_only=True)
    rate: sp.Expr = field(kw_only=True)
    of_level: sp.Expr | None = field(kw_only=True)

    @property
    def reference_state(self) -> Mapping[str, Any] | None:
        """The initial state of a catalogue system, and None for other systems."""
        state: Mapping[str, Any] | None = getattr(self.original, "reference_state", None)
        return state

    def linearise(self, *_: Any, **__: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Raise an error: equations in tau hold for one energy, and nearby states have others.

        Raises
        ------
        InputError
            Always. Use ``system.original.linearise(...)``.
        """
        reject(
            "its equations in tau hold for one energy only, so they have no linear form.",
            where=self.name,
            remedy="Linearise the equations in t: system.original.linearise(...).",
        )

    @cached_property
    def retiming(self) -> TimeTransformation:
        """The parts of this system that its modules use."""
        symbols = Symbols(self.coordinates, self.parameters)
        value = _read_rate(self.original.name, self.rate, symbols)
        known = None if self.of_level is None else self.of_level.xreplace(dict(symbols.replace))
        return TimeTransformation(self.original.plain, symbols.graph, value, known)


def retime(system: MechanicalSystem, rate: Any) -> RetimedSystem:
    """Return the time-transformed system; see :meth:`MechanicalSystem.retimed`."""
    name = system.name
    if why := retiming_obstacle(system):
        reject_model(
            name,
            f"it cannot be retimed, because {why}.",
            "Integrate it with a fixed step in t that resolves the fastest motion.",
        )
    parameters, V = dict(system.parameters), system.potential
    of_level: sp.Expr | None = None
    g = rate
    if isinstance(rate, str):
        g, of_level, more = _rate_by_name(system, rate)
        parameters |= more
    for symbol in RUN_PARAMETERS:
        if str(symbol) in map(str, parameters):
            reject_model(
                name,
                f"its parameter {symbol} has the name of a parameter that retiming adds.",
                "Rename your parameter. E0 is the energy of a run, symsimpson.energy.",
            )
    parameters |= {energy: 0.0, first_rate: 1.0}
    symbols = Symbols(system.coordinates, parameters)
    value, g = _read_rate(name, g, symbols), sp.sympify(g)
    of_level = of_level or _as_function_of_potential(system, g, symbols, value)
    g = g if of_level is None else of_level.subs(level, V)
    pace = g / first_rate
    velocities = {q.diff(): q.diff() / pace for q in system.coordinates}
    invariants = {
        key: sp.sympify(value).xreplace(velocities)
        for key, value in (system.invariants or {}).items()
    }
    kinetic = system.kinetic / pace
    if not system.plain.quadratic:
        kinetic = pace * system.kinetic.xreplace(velocities)
    return RetimedSystem(
        f"{name[:56]}_retimed",
        coordinates=system.coordinates,
        kinetic=kinetic,
        indefinite=True,
        potential=pace * (system.potential - energy),
        gyroscopic=system.gyroscopic,
        parameters=parameters,
        positions=system.positions or None,
        units=system.units,
        invariants=invariants or None,
        original=system,
        rate=g,
        of_level=of_level,
    )


MechanicalSystem.retimer = retime


def retiming_obstacle(system: MechanicalSystem) -> str:
    """Return why a system cannot be retimed, and an empty string if it can."""
    plain = system.plain
    if isinstance(system, RetimedSystem):
        return "it is already retimed"
    if plain.hamiltonian is not None:
        return "it is declared by its Hamiltonian: declare g (H + p_t) with t as a coordinate"
    if system.modes is not None:
        return "it has contacts or dry friction"
    if plain.velocity_constraints:
        return "with velocity constraints its flow is not symplectic, in t or in tau"
    if plain.constraints:
        return "it has constraints, for which steps in tau are not proved to be correct"
    if plain.forces:
        return "forces act on it, so its energy is not constant"
    return "" if plain.autonomous else "it depends on the time, so its energy is not constant"


def _read_rate(name: str, rate: Any, symbols: Symbols) -> Value:
    """Read g, a positive expression of positions, parameters and E0."""
    value = read_expression(
        name, "rate dt/dtau", rate, symbols, symbols.known, (*symbols.q, *symbols.a)
    )
    if not value[0] or symbols.signs(value)[0] < 0:
        reject_model(
            name,
            f"the rate dt/dtau is {spell(rate)}, which is nowhere positive. Time must increase.",
            "Pass a positive g, such as r**(3/2) for bodies that attract each other.",
        )
    return value


def _rate_by_name(
    system: MechanicalSystem, rate: str
) -> tuple[sp.Expr, sp.Expr | None, Mapping[sp.Symbol, float]]:
    """Return the rate, the rate as a function of V or None, and the parameters that it adds."""
    V = system.potential
    if rate == "encounters":
        near = _attracting_terms(system)
        of_near = (-level) ** sp.Rational(-3, 2)
        return of_near.subs(level, near), of_near if near == V else None, {}
    if rate == "kinetic":
        of_level = 1 / sp.sqrt(rest * _energy_at_rest(system) + energy - level)
        return of_level.subs(level, V), of_level, {rest: 1.0}
    reject_model(
        system.name,
        f"there is no rate named {rate!r}.",
        'Pass an expression of positions, or "encounters" or "kinetic".',
    )


def _energy_at_rest(system: MechanicalSystem) -> sp.Expr:
    """Return the part of E0 - V0 that keeps the rate finite; see :meth:`MechanicalSystem.retimed`.

    If E0 = V0, the result is the change of V from q = 0 to q = 1 in all coordinates.
    """
    near, smooth, wrong = _sort_terms(system)
    V0, V1 = (_evaluate_at(number, system.potential, system) for number in (0, 1))
    if V0 is None:  # infinite
        V0, V1 = (_evaluate_at(number, sp.Add(*smooth), system) for number in (0, 1))
    change = sp.S.Zero if V0 is None or V1 is None else V1 - V0
    part = REST
    if near and not wrong:
        part = REST_OF_ATTRACTION
    elif not change:
        change = sp.S.One
    size = _smooth_abs(energy - (V0 or 0))
    return part * size + _smooth_abs(change) * NOTHING / (size**2 + NOTHING)


def _smooth_abs(value: sp.Expr) -> sp.Expr:
    """Return the absolute value in a form that has a derivative at 0."""
    return abs(value) if value.is_number else value**2 / sp.sqrt(value**2 + NOTHING)


def _evaluate_at(number: int, V: sp.Expr, system: MechanicalSystem) -> sp.Expr | None:
    """Return V with this number in place of all coordinates, or None if it is not finite."""
    try:
        value = V.subs(dict.fromkeys(system.coordinates, number))
    except (ArithmeticError, ValueError):
        return None
    if value.has(sp.nan, sp.zoo, sp.oo, -sp.oo):
        return None
    return value.replace(sp.Abs, _smooth_abs)


def attracts(system: MechanicalSystem) -> bool:
    """Return whether V is a sum of negative multiples of inverse distances."""
    near, _, wrong = _sort_terms(system)
    return not wrong and bool(near) and sp.Add(*near) == system.potential


def _attracting_terms(system: MechanicalSystem) -> sp.Expr:
    """Return the terms -(positive number)/distance of V; reject other terms that have a pole."""
    near, _, wrong = _sort_terms(system)
    if near and not wrong:
        return sp.Add(*near)
    why = f"{spell(wrong[0], 300)} is neither" if wrong else "it has no term of the first kind"
    reject_model(
        system.name,
        "V is not a sum of terms -(positive number)/distance and terms without a pole, which "
        f'retimed("encounters") needs: {why}.',
        "Pass g as an expression that is positive, and small during fast motion.",
    )


def _sort_terms(system: MechanicalSystem) -> tuple[list[sp.Expr], list[sp.Expr], list[sp.Expr]]:
    """Sort terms of V: negative multiples of inverse distances, without a pole, and others."""
    coordinates = set(system.coordinates)
    near: list[sp.Expr] = []
    smooth: list[sp.Expr] = []
    wrong: list[sp.Expr] = []
    work = list(reversed(sp.Add.make_args(system.potential)))
    while work:
        term = work.pop()
        constant, moving = term.as_independent(*coordinates, as_Add=False)
        base, exponent = moving.as_base_exp()
        distance = exponent == -1 and base in coordinates
        distance |= exponent == -sp.S.Half and not base.could_extract_minus_sign()
        if distance and not constant.is_nonnegative:
            near.append(term)
        elif _without_pole(moving, coordinates):
            smooth.append(term)
        elif term.is_Mul and (several := sp.expand_mul(term, deep=False)).is_Add:
            work += reversed(several.args)
        else:
            wrong.append(term)
    return near, smooth, wrong


def _without_pole(term: sp.Expr, coordinates: Set[sp.Expr]) -> bool:
    """Return whether the form of a term shows that it is finite for all coordinates."""
    work, seen = [term], {term}
    while work:
        part = work.pop()
        if part in coordinates or not part.has(*coordinates):
            continue
        power = part.is_Pow and part.exp.is_nonnegative and not part.exp.has(*coordinates)
        if not (part.is_Add or part.is_Mul or power or isinstance(part, FINITE)):
            return False
        work += [x for x in part.args if x not in seen]
        seen.update(part.args)
    return True


def extend_by_energy(
    system: RetimedSystem, varied: Sequence[sp.Symbol]
) -> tuple[MechanicalSystem, tuple[str, ...]]:
    """Return a retimed system with E0 as its last coordinate, and names of parameters.

    The steps of the new system are differentiated by the parameters with these names.
    L = T/g - g (V - e) + M e'^2/2 has so large an M that e is constant. Then p_e' = g, and each
    scheme sums up the time as in the retimed system. The invariants are derivatives by the
    initial state and the varied parameters: of H, of the rate, and of p at constant velocities.
    """
    original, parameters = system.original, dict(system.parameters)
    (e,) = coordinates("E0_of_run")
    pace = system.rate / first_rate
    in_rate = system.rate.has(energy)
    parameters = {a: value for a, value in parameters.items() if a != energy or in_rate}
    in_tau = {q.diff(): q.diff() / pace for q in original.coordinates}
    L, watched = original.lagrangian, {}
    for i, q in enumerate(original.coordinates):
        watched[f"{E_BY}q{i}"] = -L.diff(q)
        watched[f"{E_BY}p{i}"] = q.diff()
        watched[f"{RATE_BY}q{i}"] = system.rate.diff(q)
    for j, a in enumerate(varied):
        watched[f"{E_BY}a{j}"] = -L.diff(a)
        watched[f"{RATE_BY}a{j}"] = system.rate.diff(a)
        for i, q in enumerate(original.coordinates):
            watched[f"{MOMENTUM_BY}{i} a{j}"] = L.diff(q.diff()).diff(a)
    watched[f"{RATE_BY}E"] = system.rate.diff(energy)
    watched["rate"] = system.rate
    augmented = MechanicalSystem(
        f"{original.name[:50]}_extended",
        coordinates=(*original.coordinates, e),
        kinetic=original.kinetic / pace + HEAVY * e.diff() ** 2 / 2,
        potential=pace * (original.potential - e),
        gyroscopic=original.gyroscopic,
        parameters=parameters,
        invariants={name: sp.sympify(x).xreplace(in_tau) for name, x in watched.items()},
    )
    more = (energy, first_rate) if in_rate else (first_rate,)
    return augmented, tuple(map(str, (*varied, *more)))
