"""Systems in a time of their own: dt = g(q) dtau, with fixed steps in tau.

K = g (H - E0) has on K = 0 the orbits of H, at the rate t' = g, and is quadratic in the momenta as
H is: L~ = T(q, q')/g + a.q' - g (V - E0) is a system of the same kind, with the same momenta.
Derivatives of retimed runs are taken of a system with E0 as a coordinate, of which the time is the
momentum: its steps are the same (Marsden and West 2001, section 1.2.3).
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

from symsimpson.declare.checks import fail, spell
from symsimpson.declare.coordinates import coordinates
from symsimpson.declare.declared import Declared
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.plain import Plain, Symbols
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import numbers_of
from symsimpson.graph.nodes import Graph, Value
from symsimpson.graph.read import Reader

#: Stands for V in functions of it.
level = sp.Symbol("level", real=True)
#: Where a power of V is looked for, and with how many digits.
POINTS, DIGITS = 4, 40
#: Powers have denominators up to this.
LARGEST = 12
#: E0, the energy of the run, in rates and among the parameters of a retimed system.
energy = sp.Symbol("E0", real=True)
#: g at the start of the run: rates are divided by it.
first_rate = sp.Symbol("g_start", positive=True)
#: Keeps the rate finite at rest.
rest = sp.Symbol("c_rest", positive=True)
OWN = (energy, first_rate)
#: The energy that keeps the rate finite at rest is c_rest times this part of E0 - V0.
REST, REST_OF_ATTRACTION = sp.Rational(1, 8), sp.Rational(1, 1024)
#: Smaller than the square of any difference of energies.
NOTHING = sp.Rational(1, 2**800)
#: Functions that are finite for all real numbers.
FINITE = (sp.sin, sp.cos, sp.sinh, sp.cosh, sp.tanh, sp.exp, sp.atan, sp.asinh, sp.erf, sp.erfc)
#: What names of the derivatives of E0, of the rate and of p at given velocities begin with.
E_BY, RATE_BY, MOMENTUM_BY = "E by ", "rate by ", "p by "
#: So heavy is E0 that it does not move, by less than any rounding.
HEAVY = sp.Integer(2) ** 200


def function_of_level(
    system: Declared, rate: sp.Expr, symbols: Symbols, value: Value
) -> sp.Expr | None:
    """Return a rate, a function of positions, as one of V, with :data:`level` in its place.

    Return None if V is not in the rate as a whole, unless the rate is a constant times a power of
    -V: that power is returned. The ``value`` is that of the rate in the graph of the symbols.
    """
    V, coordinates = system.potential, system.coordinates
    for sign in (1, -1):
        expression = rate.subs(sign * V, sign * level)
        if not expression.has(*coordinates) and expression.has(level):
            return expression
    power = _power(symbols, Reader(symbols.graph, symbols.known)(V), value)
    return None if power is None else (-level) ** power


def _power(symbols: Symbols, V: Value, rate: Value) -> sp.Rational | None:
    """Return the power s of a constant times (-V)^s, from slopes at some points; None if none."""
    graph, q = symbols.graph, symbols.numbers(symbols.q)
    inside = sorted(graph.nodes[V[1]].symbols | graph.nodes[rate[1]].symbols | {*q})
    wanted = [V, rate, *gradient(graph, V, q), *gradient(graph, rate, q)]
    numbers, powers = random.Random(1), []
    with mpmath.workdps(DIGITS):
        small = mpmath.mpf(10) ** (DIGITS // -2)
        for _ in range(POINTS):
            point = {n: mpmath.mpf(numbers.uniform(0.3, 1.7)) for n in inside}
            v, u, *d = numbers_of(graph, wanted, point, mpmath.mp)
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
class Retiming:
    """The parts of a retimed system."""

    plain: Plain  #: The system in the user's time.
    graph: Graph
    rate: Value  #: dt/dtau in this graph, as the user gave it.
    #: The same as a function of :data:`level` in place of V, in plain symbols, if it is one.
    of_potential: sp.Expr | None


@dataclass(frozen=True, eq=False, repr=False)
class RetimedSystem(MechanicalSystem):
    """A system whose steps are fixed in tau, dt = g(q) dtau; made by ``system.retimed(g)``.

    Each run sets two more parameters at its start: the energy E0, and the rate there, by which g
    is divided. Its states are given over t, with the momenta, velocities and energy of the user's
    system; ``run.tau`` is the variable tau.

    Attributes
    ----------
    original : MechanicalSystem
    rate : SymPy expression
        g, as it was given, but for a constant factor.
    of_level : SymPy expression or None
        g as a function of V, with the symbol ``level`` in its place, if it is one.

    Notes
    -----
    K = g (H - E0) is a Hamiltonian with the same orbits and momenta as H [1]_, and its scheme is
    symplectic. H - E0 = K/g is not small where g is; K does not drift.

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
        """The state to start from, if the system is of the catalogue."""
        state: Mapping[str, Any] | None = getattr(self.original, "reference_state", None)
        return state

    def linearise(self, *_: Any, **__: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Refuse: equations in tau are those of one energy, and states nearby have another.

        Raises
        ------
        InputError
        """
        reject(
            f"{self.name} keeps a time of its own, in which its equations hold for one energy.",
            remedy="Linearise those in t: system.original.linearise(...).",
        )

    @cached_property
    def retiming(self) -> Retiming:
        """The parts of this system."""
        symbols = Symbols(self.coordinates, self.parameters)
        value = _read_rate(self.original.name, self.rate, symbols)
        known = None if self.of_level is None else self.of_level.xreplace(dict(symbols.replace))
        return Retiming(self.original.plain, symbols.graph, value, known)


def retimed(system: MechanicalSystem, rate: Any) -> RetimedSystem:
    """Return the system in another time; see :meth:`MechanicalSystem.retimed`."""
    name = system.name
    if why := not_retimed(system):
        raise fail(
            name,
            f"it cannot be retimed: {why}.",
            "Integrate it with a fixed step in t, small enough for what is fastest.",
        )
    parameters, V = dict(system.parameters), system.potential
    of_level: sp.Expr | None = None
    g = rate
    if isinstance(rate, str):
        g, of_level, more = _named(system, rate)
        parameters |= more
    for symbol in OWN:
        if str(symbol) in map(str, parameters):
            raise fail(
                name,
                f"its parameter {symbol} has the name of one that retiming adds.",
                "E0 is the energy of a run, symsimpson.energy. Call your parameter otherwise.",
            )
    parameters |= {energy: 0.0, first_rate: 1.0}
    symbols = Symbols(system.coordinates, parameters)
    value, g = _read_rate(name, g, symbols), sp.sympify(g)
    of_level = of_level or function_of_level(system, g, symbols, value)
    g = g if of_level is None else of_level.subs(level, V)
    pace = g / first_rate
    velocities = {q.diff(): q.diff() / pace for q in system.coordinates}
    invariants = {
        key: sp.sympify(value).xreplace(velocities)
        for key, value in (system.invariants or {}).items()
    }
    return RetimedSystem(
        f"{name[:56]}_retimed",
        coordinates=system.coordinates,
        kinetic=system.kinetic / pace,
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


MechanicalSystem.retimer = retimed


def not_retimed(system: MechanicalSystem) -> str:
    """Return why a system cannot be retimed; nothing if it can."""
    plain = system.plain
    if isinstance(system, RetimedSystem):
        return "it is retimed already"
    if plain.velocity_constraints:
        return "velocity constraints make a flow that is not symplectic, in no time"
    if plain.constraints:
        return "constraints hold it, whose steps in another time are not proved to be right"
    if plain.forces:
        return "forces act on it, so that its energy is not constant"
    return "" if plain.autonomous else "it depends on the time, so that its energy is not constant"


def _read_rate(name: str, rate: Any, symbols: Symbols) -> Value:
    """Read g: an expression of positions, parameters and E0."""
    value = read_expression(
        name, "rate dt/dtau", rate, symbols, symbols.known, (*symbols.q, *symbols.a)
    )
    if not value[0] or symbols.signs(value)[0] < 0:
        raise fail(
            name,
            f"the rate dt/dtau is {spell(rate)}, which is nowhere positive.",
            "Time must go on: give a positive g, as r**(3/2) for bodies that attract each other.",
        )
    return value


def _named(
    system: MechanicalSystem, rate: str
) -> tuple[sp.Expr, sp.Expr | None, Mapping[sp.Symbol, float]]:
    """Return the rate of a name, the same as a function of V, and the parameters that it adds."""
    V = system.potential
    if rate == "encounters":
        near = _encounters(system)
        of_near = (-level) ** sp.Rational(-3, 2)
        return of_near.subs(level, near), of_near if near == V else None, {}
    if rate == "kinetic":
        of_level = 1 / sp.sqrt(rest * _energy_at_rest(system) + energy - level)
        return of_level.subs(level, V), of_level, {rest: 1.0}
    raise fail(
        system.name,
        f"there is no rate named {rate!r}.",
        'Give an expression of positions, or "encounters" or "kinetic".',
    )


def _energy_at_rest(system: MechanicalSystem) -> sp.Expr:
    """Return the part of E0 - V0 that keeps the rate finite; see :meth:`MechanicalSystem.retimed`.

    If the difference is 0, the change of V to where all coordinates are 1 takes its place.
    """
    near, smooth, wrong = _parted(system)
    V0, V1 = (_where_all_are(number, system.potential, system) for number in (0, 1))
    if V0 is None:  # infinite
        V0, V1 = (_where_all_are(number, sp.Add(*smooth), system) for number in (0, 1))
    change = sp.S.Zero if V0 is None or V1 is None else V1 - V0
    part = REST
    if near and not wrong:
        part = REST_OF_ATTRACTION
    elif not change:
        change = sp.S.One
    size = _size(energy - (V0 or 0))
    return part * size + _size(change) * NOTHING / (size**2 + NOTHING)


def _size(value: sp.Expr) -> sp.Expr:
    """Return the absolute value as compiled code has it, with a derivative at 0."""
    return abs(value) if value.is_number else value**2 / sp.sqrt(value**2 + NOTHING)


def _where_all_are(number: int, V: sp.Expr, system: MechanicalSystem) -> sp.Expr | None:
    """Return V where all coordinates have this value; None if it is not finite."""
    try:
        value = V.subs(dict.fromkeys(system.coordinates, number))
    except (ArithmeticError, ValueError):
        return None
    return None if value.has(sp.nan, sp.zoo, sp.oo, -sp.oo) else value.replace(sp.Abs, _size)


def attracts(system: MechanicalSystem) -> bool:
    """Return whether V is a sum of negative multiples of inverse distances."""
    near, _, wrong = _parted(system)
    return not wrong and bool(near) and sp.Add(*near) == system.potential


def _encounters(system: MechanicalSystem) -> sp.Expr:
    """Return the terms of V that are -(positive number)/distance; others must have no pole."""
    near, _, wrong = _parted(system)
    if near and not wrong:
        return sp.Add(*near)
    why = f"{spell(wrong[0], 300)} is neither" if wrong else "no term of it is the first"
    raise fail(
        system.name,
        "V is not a sum of -(positive number)/distance and of terms without a pole, as "
        f'retimed("encounters") takes it: {why}.',
        "Give g as an expression: positive, and small where the motion is fast.",
    )


def _parted(system: MechanicalSystem) -> tuple[list[sp.Expr], list[sp.Expr], list[sp.Expr]]:
    """Part V into negative multiples of inverse distances, terms without a pole, and others."""
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
    """Return whether a term is finite wherever the coordinates are, as far as its form tells."""
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


def extended(
    system: RetimedSystem, varied: Sequence[sp.Symbol]
) -> tuple[MechanicalSystem, tuple[str, ...]]:
    """Return a retimed system with E0 as its last coordinate, and what to differentiate it by.

    L = T/g - g (V - e) + M e'^2/2 with so large an M that e stays what it is; then p_e' = g, and
    each scheme of the family adds up the time as the retimed system does. Its invariants are the
    derivatives of H and of the rate, and of p at given velocities, by what may change at the start.
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
