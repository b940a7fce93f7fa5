"""The equations of a step: jets at the nodes, blocks of unknowns, and parts."""

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
from symsimpson.discrete.jet import Jet, Key, RunningCost, derive_jet, to_jet
from symsimpson.discrete.reductions import (
    Affine,
    Composed,
    Constrained,
    Coupled,
    Part,
    Routh,
    Separable,
    kicks_of,
    read_exploit,
    reduce,
)
from symsimpson.errors import SchemeError, reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import ZERO, Value
from symsimpson.graph.read import SympyConverter
from symsimpson.graph.rebuild import rebuild
from symsimpson.schemes.composition import Composition
from symsimpson.schemes.scheme import Scheme


@dataclass(frozen=True)
class Unknowns:
    """The blocks of unknowns of a step, and their sizes.

    The increments X_1..X_d of the control points come first, each a block with the size
    ``coordinates``. Newton's method measures them with the diagonal of M(q0). ``others`` has the
    sizes of further blocks such as multipliers, which are not part of the path and not measured.

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
    def others_size(self) -> int:
        """Number of unknowns after the increments."""
        return sum(self.others)

    def place(self, k: int, a: int) -> int:
        """Return the place of coordinate a in block k, from 1 on: X_1..X_d, then ``others``."""
        if k > self.control_points:
            return self.measured + sum(self.others[: k - self.control_points - 1]) + a
        return (k - 1) * self.coordinates + a


#: A function that returns an entry of the jet at a node: ``entry(i, "F_q", a, b)``.
Entry = Callable[..., Any]

#: Highest order that friction does not reduce in symmetric compositions.
LOW_ORDER = 4


@dataclass(frozen=True)
class DiscreteEquations:
    """The discrete Euler-Lagrange equations of a system and a scheme, and their parts."""

    system: MechanicalSystem
    scheme: Scheme
    exploit: frozenset[str]  #: The properties of the system that the reduction uses.
    plain: Plain
    h: sp.Symbol
    #: Control points k of the equations D_k L_d, in the order of elimination. Each is a block
    #: of n rows. An explicit scheme has none.
    rows: tuple[int, ...]
    #: Control points whose increments are the unknowns, in the order of elimination.
    columns: tuple[int, ...]
    parts: tuple[Part, ...]  #: Groups of coordinates that are solved separately.
    #: Plain symbols of parameters and inputs for derivatives of a step, in addition to q and p.
    #: None if the module has no derivatives.
    varied: tuple[sp.Symbol, ...] | None = None
    cost: RunningCost | None = None  #: A running cost to integrate.
    second: bool = False  #: Whether the module also has second derivatives of a step.

    @cached_property
    def jet(self) -> Jet:
        """Forces, momenta and their derivatives, with the factors of M that parts need.

        Modules with loops over families of terms do not use it.
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
        """Return a jet of only M and a of cyclic coordinates, and the factors of their M."""
        plain, (entries, angles) = self.plain, self._factors(part)
        for y in part.cyclic:
            entries["a", y] = plain.a[y]
            entries |= {("M", y, x): plain.entry(y, x) for x in part.coordinates}
        return to_jet(plain, plain.graph, entries, angles)

    def _factors(self, part: Routh) -> tuple[dict[Key, Value], list[int]]:
        """Return the factors of M of cyclic coordinates, and the places of half angles."""
        graph, symbols = self.plain.graph, (*self.plain.q, *self.plain.parameters)
        reader = SympyConverter(graph, {symbol: graph.symbol(symbol.name) for symbol in symbols})
        entries: dict[Key, Value] = {
            key: reader(value) for key, value in part.factor_entries().items()
        }
        return entries, [self.plain.q.index(x) for x in part.factors.half_angles]

    @property
    def needs_path(self) -> bool:
        """True if results need the path of a step: work, derivatives, or transformed time."""
        works = bool(self.rows and self.plain.powers)
        return works or self.varied is not None or self.system.retiming is not None

    @property
    def tables(self) -> Mapping[str, Any]:
        """The tables of the scheme; rows of the Gauss points for A v = b come after the nodes."""
        tables = dict(self.scheme.tables)
        if tables and self.plain.velocity_constraints:
            places, values, slopes = self.scheme.at_gauss_points
            tables["PLACES"] += places
            tables["BASIS"] += values
            tables["BASIS_SLOPE"] += slopes
        return tables

    @property
    def unknowns(self) -> Unknowns:
        """The unknowns of the equations without reductions."""
        constraints = len(self.plain.constraint_names)
        others = (constraints,) * self.scheme.degree if constraints else ()
        if self.plain.hamiltonian is not None:  # the rates of momenta at the nodes
            others = (len(self.plain.q),) * self.scheme.degree
        return Unknowns(self.scheme.degree, len(self.plain.q), others)

    def as_single_part(
        self, *, dense: bool
    ) -> Composed | Constrained | Coupled | Routh | Separable:
        """Return all coordinates as one part, for modules with loops.

        A Routh reduction needs ``dense`` matrices.
        """
        (part,) = reduce(
            self.system.structure, self.scheme, self.exploit & {"constant_mass", "cyclic"}
        )
        assert isinstance(part, (Composed, Constrained, Coupled, Routh, Separable))
        reducible = dense and self.scheme.exact
        if isinstance(part, Routh) and not (reducible and part.pays(self.scheme.stages)):
            return Coupled(tuple(range(self.system.n)), part.rows, part.columns)
        return part

    def at_start(self, i: int) -> bool:
        """Return whether node i is at q0, so that its position is known before the step."""
        return all(a == 0 for a in self.scheme.A[i][1:])


def discretise(
    system: MechanicalSystem,
    scheme: Scheme,
    exploit: str | Iterable[str] = "all",
    varied: tuple[sp.Symbol, ...] | None = None,
    cost: RunningCost | None = None,
    *,
    second: bool = False,
) -> DiscreteEquations:
    """Derive the equations of one step, and their reduction to parts.

    The general equations are d n equations for d n unknowns, with the exact Jacobian and the
    momenta. ``exploit`` names properties of the system that may shorten them. With ``varied``,
    plain symbols, a step is also differentiated with respect to q, p and these symbols, and twice
    if ``second``. A running ``cost`` is integrated along the path, with its derivatives. Raises
    SchemeError if the scheme is explicit, but the system has no explicit steps.
    """
    wanted = read_exploit(exploit)
    if isinstance(scheme, Composition) and isinstance(system, RetimedSystem):
        return _composed_in_time(system, scheme, wanted, varied)
    structure = system.structure
    plain = structure.plain if wanted else system.plain
    _check_explicit(system, scheme)
    if plain.hamiltonian is not None:
        _check_canonical(system, scheme, second=second)
    if varied is not None:
        check_differentiable(scheme)
    if second and (plain.velocity_constraints or plain.moving):
        what = "velocity constraints" if plain.velocity_constraints else "constraints that move"
        reject(
            f"{system.name} has {what}.",
            why="Second derivatives of their steps are not implemented.",
            remedy="Use differences of first derivatives, for example of stepper.gradient.",
            error=SchemeError,
        )
    parts = reduce(structure, scheme, wanted)
    explicit = any(isinstance(part, Composed) for part in parts)
    if explicit and plain.dragged:
        rates = decay_rates(plain)
        assert rates is not None
        at_rest = rebuild(plain.graph, plain.f, dict.fromkeys(plain.numbers(plain.v), ZERO))
        plain = replace(plain, rates=rates, acting=tuple(at_rest))
    free = not (explicit or plain.constraint_names)
    # the weights of conformal damping have no derivatives, so a varied rate needs damping forces
    fixed_rate = _is_free_of(plain, structure.damping, varied or ())
    fixed_rate = fixed_rate and plain.step[0] not in (varied or ())
    if "conformal" in wanted and structure.damping is not None and free and fixed_rate:
        # each node has its own weight, so M differs among the nodes
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


def _check_canonical(system: MechanicalSystem, scheme: Scheme, *, second: bool) -> None:
    """Raise SchemeError if a scheme cannot integrate a Hamiltonian."""
    if second:
        reject(
            "second derivatives of steps of a HamiltonianSystem are not implemented.",
            where=system.name,
            remedy="Use differences of first derivatives, for example of stepper.gradient.",
            error=SchemeError,
        )
    separable = system.structure.separable
    if scheme.degree == scheme.stages or (separable and kicks_of(scheme) is not None):
        return
    plain, n = system.plain, system.n
    curves = [gradient(plain.graph, x, plain.numbers(plain.v)) for x in plain.velocities]
    singular = system.structure.momentum_rank != n
    flat = [
        str(p)
        for p, row in zip(getattr(system, "momenta", ()), curves, strict=True)
        if not any(c for c, _ in row)
    ]
    why = "It needs as many nodes as degrees."
    if singular:
        which = f" H is linear in {', '.join(flat)}." if flat else ""
        rank = f"rank {system.structure.momentum_rank} of {n}"
        why = f"Its steps need a regular matrix H_pp, which has {rank}.{which}"
    same = {2: "midpoint", 4: "gauss4 or lobatto_3_3", 6: "gauss6 or lobatto_4_4"}
    named = same.get(scheme.order, f"gauss{scheme.order}")
    reject(
        f"{scheme.name} does not integrate a HamiltonianSystem.",
        where=system.name,
        why=why,
        remedy=f"Choose {named}, of the same order.",
        error=SchemeError,
    )


def _composed_in_time(
    system: RetimedSystem,
    scheme: Composition,
    exploit: frozenset[str],
    varied: tuple[sp.Symbol, ...] | None,
) -> DiscreteEquations:
    """Return the kicks and drifts of a composition for a time transformation g that depends on V.

    Kicks follow f(c - V) and drifts follow f(T + c - E0) with f' = g, both exactly. Raises
    SchemeError if g is no function of V, if M is not constant, or if the order of the scheme needs
    a quadratic T.
    """
    original, every = system.original, tuple(range(system.n))
    if varied is not None:
        check_differentiable(scheme)
    _check_explicit(original, scheme)
    if system.retiming.of_potential is None:
        reject(
            f"the rate {spell(system.rate)} is not a function of V, as kicks and drifts need.",
            where=system.name,
            remedy="Choose such a rate, for example (-V)**(-3/2), which is 'encounters'. Or choose "
            "a scheme of the family, such as 'gauss8'.",
            error=SchemeError,
        )
    if not scheme.of_verlet:
        reject(
            f"{scheme.name} has order {scheme.order} only for a quadratic kinetic energy.",
            where=system.name,
            why="The time transformation makes the kinetic energy f(T), which is not quadratic.",
            remedy="Choose a composition of Verlet steps, such as 'kahan_li8', or a scheme of the "
            "family, such as 'gauss8'.",
            error=SchemeError,
        )
    plain = replace(original.plain, parameters=system.plain.parameters)
    part = Composed(every, scheme.kicks, scheme.drifts)
    h = sp.Symbol("h", positive=True)
    return DiscreteEquations(system, scheme, exploit, plain, h, (), (), (part,))


def _is_free_of(plain: Plain, value: Value | None, symbols: Iterable[sp.Symbol]) -> bool:
    """Return whether a value contains none of the symbols."""
    if value is None:
        return True
    return plain.graph.nodes[value[1]].symbols.isdisjoint(plain.numbers(symbols))


def check_differentiable(scheme: Scheme) -> None:
    """Raise SchemeError for a composition, whose steps have no derivatives."""
    if isinstance(scheme, Composition):
        reject(
            f"{scheme.name} has no derivatives of steps.",
            why="They are not implemented for kicks and drifts.",
            remedy="Choose a scheme of the family, such as 'simpson' or 'gauss8'.",
            error=SchemeError,
        )


def _check_explicit(system: MechanicalSystem, scheme: Scheme) -> None:
    """Raise SchemeError if a composition cannot integrate the system by kicks and drifts."""
    if not isinstance(scheme, Composition):
        return
    names, plain = [q.func.__name__ for q in system.coordinates], system.plain
    if plain.velocity_constraints or plain.moving:
        violated = ", ".join(map(repr, plain.velocity_constraints or plain.constraints))
        what = "velocity constraints" if plain.velocity_constraints else "moving constraints"
        reject(
            f"drifts of {scheme.name} violate the {what} {violated}.",
            where=system.name,
            remedy="Choose a scheme of the family, such as 'simpson' or 'gauss8'.",
            error=SchemeError,
        )
    if plain.constraints and plain.dragged:
        reject(
            f"{scheme.name} cannot combine constraints with friction.",
            where=system.name,
            why="Its drifts follow the constraints, but friction in its kicks violates them.",
            remedy="Choose a scheme of the family, such as 'simpson' or 'gauss8'.",
            error=SchemeError,
        )
    if plain.constraints and not scheme.of_verlet:
        reject(
            f"{scheme.name} has order {scheme.order} only for drifts along straight lines.",
            where=system.name,
            why="With constraints, drifts follow the constraints.",
            remedy="Choose a composition of RATTLE steps, such as 'kahan_li8', or a scheme of the "
            "family, such as 'simpson' or 'gauss8'.",
            error=SchemeError,
        )
    structure = system.structure
    if plain.hamiltonian is not None:
        if not structure.separable:
            reject(
                f"{scheme.name} is explicit, but H is not T(p) + V(q).",
                where=system.name,
                why="Its kicks and drifts are the motions of V alone and of T alone.",
                remedy="Choose a scheme of the family, such as 'gauss8'.",
                error=SchemeError,
            )
        if not scheme.of_verlet:
            reject(
                f"{scheme.name} has order {scheme.order} only for a quadratic T(p).",
                where=system.name,
                remedy="Choose a composition of Verlet steps, such as 'kahan_li8', or a scheme of "
                "the family, such as 'gauss8'.",
                error=SchemeError,
            )
        return
    linear = plain.dragged and structure.constant_mass and not structure.gyroscopic
    if linear and decay_rates(structure.plain):
        if scheme.order > LOW_ORDER and not scheme.of_verlet:
            reject(
                f"{scheme.name} has order {scheme.order} only for forces that depend on positions.",
                where=system.name,
                why=f"With friction the order would be {LOW_ORDER}.",
                remedy="Choose a composition of Verlet steps, such as 'kahan_li6', or a scheme of "
                "the family, such as 'gauss8'.",
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
                f"{scheme.name} is explicit, but the {what} in {subsystem_names}.",
                where=system.name,
                why="Explicit schemes need a constant mass matrix, and forces that depend only on "
                "positions. Friction may be proportional to each momentum, with a positive rate.",
                remedy="Choose a scheme of the family, such as 'simpson' or 'gauss8'.",
                error=SchemeError,
            )
