"""Unknowns of a step: blocks, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import sympy as sp

from symsimpson.declare.checks import spell
from symsimpson.declare.plain import Plain
from symsimpson.declare.retimed import RetimedSystem
from symsimpson.declare.structure import decay_rates
from symsimpson.declare.system import MechanicalSystem
from symsimpson.discrete.combined_rows import elimination_order
from symsimpson.discrete.jet import Cost, Jet, Key, derive_jet, written_as_jet
from symsimpson.discrete.reductions import (
    Affine,
    Composed,
    Constrained,
    Coupled,
    Part,
    Routh,
    Separable,
    read_exploit,
    reduce,
)
from symsimpson.errors import SchemeError, reject
from symsimpson.graph.nodes import ZERO, Value
from symsimpson.graph.read import Reader
from symsimpson.graph.rebuild import rebuilt
from symsimpson.schemes.composition import Composition
from symsimpson.schemes.scheme import Scheme


@dataclass(frozen=True)
class Unknowns:
    """Blocks of unknowns and their sizes.

    The increments X_1..X_d of the control points come first, a block of ``coordinates`` for each.
    Their sizes are measured with the diagonal of M(q0); what stands behind them, ``others``, is
    not part of the path and not measured: multipliers, for one.

    Examples
    --------
    >>> unknowns = Unknowns(control_points=2, coordinates=3)
    >>> unknowns.size, unknowns.place(2, 0)
    (6, 3)
    """

    control_points: int
    coordinates: int
    others: tuple[int, ...] = ()

    @property
    def measured(self) -> int:
        """Number of increments."""
        return self.control_points * self.coordinates

    @property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.measured + sum(self.others)

    @property
    def behind(self) -> int:
        """Number of unknowns behind the increments."""
        return sum(self.others)

    def place(self, k: int, a: int) -> int:
        """Return the place of X_k of coordinate a, k from 1 on; behind X_d, of the others."""
        if k > self.control_points:
            return self.measured + sum(self.others[: k - self.control_points - 1]) + a
        return (k - 1) * self.coordinates + a


#: Gives an entry of the jet at a node: ``entry(i, "F_q", a, b)``.
Entry = Callable[..., Any]

#: Up to here symmetric compositions for kicks without friction keep their order with it.
LOW_ORDER = 4


@dataclass(frozen=True)
class DiscreteEquations:
    """A system, a scheme, and how jets at the nodes make up the equations of a step.

    Rows and columns are blocks of n. ``rows`` lists the control points whose D_k L_d are the
    equations, ``columns`` those whose increments are the unknowns, both in the order in which
    elimination takes them; an explicit scheme has none. ``parts`` are what is solved in a step.
    Derivatives of a step are taken by q, p and what is ``varied``, plain symbols of parameters and
    inputs; there are none of them if that is None. A running ``cost`` may be integrated, too,
    and rows of a step be differentiated a ``second`` time.
    """

    system: MechanicalSystem
    scheme: Scheme
    exploit: frozenset[str]
    plain: Plain
    h: sp.Symbol
    rows: tuple[int, ...]
    columns: tuple[int, ...]
    parts: tuple[Part, ...]
    varied: tuple[sp.Symbol, ...] | None = None
    cost: Cost | None = None
    second: bool = False

    @cached_property
    def jet(self) -> Jet:
        """Forces, momenta and their derivatives, with the factors that parts need beside them.

        Loops over terms do without.
        """
        more: dict[Key, Value] = {}
        halves: dict[int, None] = {}
        for part in self.parts:
            if isinstance(part, Routh):
                factors, angles = self._factors(part)
                more |= factors
                halves |= dict.fromkeys(angles)
        return derive_jet(self.plain, more, tuple(halves))

    def cyclic_jet(self, part: Routh) -> Jet:
        """Factors of M of cyclic coordinates, and what else their momenta depend on, alone."""
        plain, (entries, angles) = self.plain, self._factors(part)
        for y in part.cyclic:
            entries["a", y] = plain.a[y]
            entries |= {("M", y, x): plain.entry(y, x) for x in part.coordinates}
        return written_as_jet(plain, plain.graph, entries, angles)

    def _factors(self, part: Routh) -> tuple[dict[Key, Value], list[int]]:
        """Return the factors, and the angles of which halves are better."""
        graph, symbols = self.plain.graph, (*self.plain.q, *self.plain.parameters)
        reader = Reader(graph, {symbol: graph.symbol(symbol.name) for symbol in symbols})
        entries: dict[Key, Value] = {
            key: reader(value) for key, value in part.factor_entries().items()
        }
        return entries, [self.plain.q.index(x) for x in part.factors.half_angles]

    @property
    def looked_at(self) -> bool:
        """Whether something is asked of the path of a step that was taken."""
        works = bool(self.rows and self.plain.powers)
        return works or self.varied is not None or self.system.retiming is not None

    @property
    def tables(self) -> Mapping[str, Any]:
        """The scheme's tables; rows for the points at which A v = b is asked for stand behind."""
        tables = dict(self.scheme.tables)
        if tables and self.plain.velocity_constraints:
            places, values, slopes = self.scheme.at_gauss_points
            tables["PLACES"] += places
            tables["BASIS"] += values
            tables["BASIS_SLOPE"] += slopes
        return tables

    @property
    def unknowns(self) -> Unknowns:
        """The unknowns of the equations, where nothing is reduced."""
        held = len(self.plain.held)
        others = (held,) * self.scheme.degree if held else ()
        return Unknowns(self.scheme.degree, len(self.plain.q), others)

    def joined(self, *, dense: bool) -> Composed | Constrained | Coupled | Routh | Separable:
        """Return all coordinates as one part, as loops take them; matrices may be ``dense``."""
        alone = self.exploit & {"constant_mass", "cyclic"}
        (part,) = reduce(self.system.structure, self.scheme, alone)
        assert isinstance(part, (Composed, Constrained, Coupled, Routh, Separable))
        wanted = dense and self.scheme.exact
        if isinstance(part, Routh) and not (wanted and part.pays(self.scheme.stages)):
            return Coupled(tuple(range(self.system.n)), part.rows, part.columns)
        return part

    def at_start(self, i: int) -> bool:
        """Return whether node i lies at q0, so that its position is known before the step."""
        return all(a == 0 for a in self.scheme.A[i][1:])


def discretise(
    system: MechanicalSystem,
    scheme: Scheme,
    exploit: str | Iterable[str] = "all",
    varied: tuple[sp.Symbol, ...] | None = None,
    cost: Cost | None = None,
    *,
    second: bool = False,
) -> DiscreteEquations:
    """Derive the equations of one step.

    They are d n equations for d n unknowns, with their exact Jacobian and the momenta; and the
    parts that these come down to. Of findings about the system those named in ``exploit`` may
    shorten them. A step is differentiated by plain symbols that are ``varied``, beside q and p,
    twice for ``second``; a cost is integrated along the path, and steps carry its derivatives back,
    too. Raises SchemeError if the scheme is explicit, but no step of the system is.
    """
    wanted = read_exploit(exploit)
    if isinstance(scheme, Composition) and isinstance(system, RetimedSystem):
        return _composed_in_time(system, scheme, wanted, varied)
    structure = system.structure
    plain = structure.plain if wanted else system.plain
    _check_explicit(system, scheme)
    if varied is not None:
        check_differentiable(scheme)
    if second and plain.velocity_constraints:
        reject(
            f"{system.name} has velocity constraints, of whose steps there are no second "
            "derivatives yet.",
            remedy="Take differences of the first ones, as of stepper.gradient.",
            error=SchemeError,
        )
    parts = reduce(structure, scheme, wanted)
    explicit = any(isinstance(part, Composed) for part in parts)
    if explicit and plain.dragged:
        rates = decay_rates(plain)
        assert rates is not None
        at_rest = rebuilt(plain.graph, plain.f, dict.fromkeys(plain.numbers(plain.v), ZERO))
        plain = replace(plain, rates=rates, acting=tuple(at_rest))
    free = not (explicit or plain.held)
    # weights are not differentiated: where what is varied stands in them, damping is a force
    still = _free_of(plain, structure.damping, varied or ()) and plain.step[0] not in (varied or ())
    if "conformal" in wanted and structure.damping is not None and free and still:
        # nodes have weights of their own, so that M is not the same at all of them
        plain = replace(plain, rate=structure.damping, acting=(ZERO,) * system.n)
        parts = tuple(
            part
            if isinstance(part, Affine)
            else Coupled(part.coordinates, *elimination_order(scheme.degree))
            for part in reduce(structure, scheme, wanted & {"decoupled", "linear"})
        )
    rows, columns = ((), ()) if explicit else elimination_order(scheme.degree)
    h = sp.Symbol("h", positive=True)
    return DiscreteEquations(
        system, scheme, wanted, plain, h, rows, columns, parts, varied, cost, second
    )


def _composed_in_time(
    system: RetimedSystem,
    scheme: Composition,
    exploit: frozenset[str],
    varied: tuple[sp.Symbol, ...] | None,
) -> DiscreteEquations:
    """Return kicks of f(c - V) and drifts of f(T + c - E0), f' = g: both are solved exactly.

    Raises SchemeError if g is no function of V, M is not constant, or the order rests on a
    quadratic T.
    """
    original, every = system.original, tuple(range(system.n))
    if varied is not None:
        check_differentiable(scheme)
    _check_explicit(original, scheme)
    if system.retiming.of_potential is None:
        reject(
            f"{system.name}: kicks and drifts in another time take a rate that is a function of V, "
            f"and {spell(system.rate)} is none.",
            remedy="Give one, as (-V)**(-3/2), which is "
            "'encounters', or choose a scheme of the family, as 'gauss8'.",
            error=SchemeError,
        )
    if not scheme.of_verlet:
        reject(
            f"the order {scheme.order} of {scheme.name} rests on a kinetic energy that is quadratic"
            ", which f(T) is not.",
            remedy="Choose a composition of steps of Verlet, as 'kahan_li8', or a "
            "scheme of the family, as 'gauss8'.",
            error=SchemeError,
        )
    plain = replace(original.plain, parameters=system.plain.parameters)
    part = Composed(every, scheme.kicks, scheme.drifts)
    h = sp.Symbol("h", positive=True)
    return DiscreteEquations(system, scheme, exploit, plain, h, (), (), (part,))


def _free_of(plain: Plain, value: Value | None, symbols: Iterable[sp.Symbol]) -> bool:
    """Return whether none of the symbols stand in a value."""
    if value is None:
        return True
    return plain.graph.nodes[value[1]].symbols.isdisjoint(plain.numbers(symbols))


def check_differentiable(scheme: Scheme) -> None:
    """Refuse derivatives of steps that are none of the equations of a scheme of the family."""
    if isinstance(scheme, Composition):
        reject(
            f"steps of {scheme.name} are kicks and drifts, of which no derivatives are taken yet.",
            remedy="Choose a scheme of the family, as 'simpson' or 'gauss8'.",
            error=SchemeError,
        )


def _check_explicit(system: MechanicalSystem, scheme: Scheme) -> None:
    """Refuse kicks and drifts where M is not constant or forces depend on velocities."""
    if not isinstance(scheme, Composition):
        return
    names, plain = [q.func.__name__ for q in system.coordinates], system.plain
    if plain.velocity_constraints:
        reject(
            f"{scheme.name} has drifts that leave the velocity constraints "
            f"{', '.join(map(repr, plain.velocity_constraints))}.",
            remedy="Choose a scheme of the family, as 'simpson' or 'gauss8'.",
            error=SchemeError,
        )
    if plain.constraints and (plain.dragged or not scheme.of_verlet):
        why = (
            "friction in its kicks is not held by them"
            if plain.dragged
            else (f"the order {scheme.order} of {scheme.name} rests on drifts along straight lines")
        )
        reject(
            f"a drift of a system with constraints follows them, and {why}.\nChoose "
            + ("a" if plain.dragged else "a composition of steps of RATTLE, as 'kahan_li8', or a")
            + " scheme of the family, as 'simpson' or 'gauss8'.",
            error=SchemeError,
        )
    structure = system.structure
    linear = plain.dragged and structure.constant_mass and not structure.gyroscopic
    if linear and decay_rates(structure.plain):
        if scheme.order > LOW_ORDER and not scheme.of_verlet:
            reject(
                f"{scheme.name} has order {scheme.order} for forces of positions alone; with "
                f"friction it would fall to order {LOW_ORDER}.",
                remedy="Choose a composition of steps of "
                "Verlet, as 'kahan_li6', or a scheme of the family, as 'gauss8'.",
                error=SchemeError,
            )
        return
    for subsystem in structure.subsystems:
        if not subsystem.separable:
            subsystem_names = ", ".join(names[i] for i in subsystem.coordinates)
            moving = plain.mass.free_symbols & {*plain.q, plain.t}
            on = "the time" if moving == {plain.t} else "positions"
            what = f"mass matrix depends on {on}" if moving else "force depends on velocities"
            reject(
                f"{scheme.name} is explicit: it takes a constant mass matrix and forces that "
                f"depend on positions alone, beside friction in proportion to each momentum by a "
                f"positive rate, but the {what} in {subsystem_names}.",
                remedy="Choose a scheme of the family, as 'simpson' or 'gauss8'.",
                error=SchemeError,
            )
