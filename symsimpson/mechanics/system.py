"""The declaration of a mechanical system: kinetic and potential energy, checked and frozen."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, TypeAlias

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.errors import ModelError
from symsimpson.mechanics.checks import (
    check_names,
    fail,
    read_coordinates,
    read_name,
    read_parameters,
    spell,
)
from symsimpson.mechanics.coordinates import momenta
from symsimpson.mechanics.expressions import read_expression, same_number
from symsimpson.mechanics.plain import Plain, Symbols, unfrozen
from symsimpson.mechanics.quadratic import (
    check_degenerate,
    check_mass_matrix,
    gyroscopic_and_potential,
    mass_matrix_of,
)
from symsimpson.mechanics.structure import Structure, analyse
from symsimpson.mechanics.terms import Sum
from symsimpson.progress import waiting

__all__ = ["MechanicalSystem"]

Matrix: TypeAlias = sp.ImmutableDenseMatrix
#: No parameters.
NONE: Mapping[sp.Symbol, float] = MappingProxyType({})
Positions = Mapping[str, Sequence[Any]]


@dataclass(frozen=True, eq=False, repr=False)
class MechanicalSystem:
    """A mechanical system, declared by its kinetic and its potential energy.

    Parameters
    ----------
    name : str
        Up to 64 ASCII letters, digits and underscores; names files and messages.
    coordinates : sequence of functions of time
        As made by :func:`symsimpson.coordinates`; velocities are their ``.diff()``.
    kinetic : sympy expression
        Quadratic in the velocities, T = v.M(q).v/2 with any M(q).
    potential : sympy expression
        V(q), without velocities.
    parameters : mapping from symbol to number, optional
        Every other symbol of T and V, with its default value; none if there are no others. Values
        are changed at run time without compiling anew.
    positions : mapping from str to sequence of expressions, optional
        What to draw: name to the Cartesian components of a point, one to three of them; or of a
        body, to a list of points, the corners of a closed line.
    invariants : mapping from str to expression, optional
        Quantities to watch, in coordinates, velocities and momenta (:func:`symsimpson.momenta`).
    gyroscopic : sympy expression, optional
        Terms linear in the velocities, a(q).v, as a magnetic field or a rotating frame gives.

    Raises
    ------
    ModelError
        If the declaration is not one that a variational step can integrate.

    Notes
    -----
    The Lagrangian is L = T + a.v - V [1]_.

    References
    ----------
    .. [1] J. E. Marsden and M. West, Discrete mechanics and variational integrators,
       Acta Numerica 10 (2001), 357-514.

    Examples
    --------
    >>> import sympy as sp, symsimpson as ss
    >>> (x,) = ss.coordinates("x")
    >>> m, k = sp.symbols("m k", positive=True)
    >>> spring = ss.MechanicalSystem("spring", coordinates=(x,), kinetic=m*x.diff()**2/2,
    ...                              potential=k*x**2/2, parameters={m: 1.0, k: 2.0})
    >>> spring.n, spring.mass_matrix
    (1, Matrix([[m]]))
    """

    name: str
    coordinates: tuple[AppliedUndef, ...] = field(kw_only=True)
    kinetic: sp.Expr = field(kw_only=True)
    potential: sp.Expr = field(kw_only=True)
    parameters: Mapping[sp.Symbol, float] = field(kw_only=True, default_factory=dict)
    positions: Positions | None = field(kw_only=True, default=None)
    invariants: Mapping[str, sp.Expr] | None = field(kw_only=True, default=None)
    gyroscopic: sp.Expr = field(kw_only=True, default=sp.S.Zero)
    plain: Plain = field(init=False)

    def __post_init__(self) -> None:
        name = read_name(self.name)
        coordinates = read_coordinates(name, self.coordinates)
        parameters = read_parameters(name, self.parameters, coordinates)
        with waiting(f"reading {name}"):
            plain, positions, invariants = _read(name, coordinates, parameters, self)
        for key, value in {
            "coordinates": coordinates,
            "kinetic": sp.sympify(self.kinetic),
            "potential": sp.sympify(self.potential),
            "gyroscopic": sp.sympify(self.gyroscopic),
            "parameters": MappingProxyType(parameters),
            "positions": positions,
            "invariants": invariants,
            "plain": plain,
        }.items():
            object.__setattr__(self, key, value)

    @classmethod
    def from_lagrangian(
        cls,
        name: str,
        lagrangian: sp.Expr,
        coordinates: Sequence[AppliedUndef],
        parameters: Mapping[sp.Symbol, float] = NONE,
        *,
        positions: Positions | None = None,
        invariants: Mapping[str, sp.Expr] | None = None,
    ) -> MechanicalSystem:
        """Declare a system by its Lagrangian.

        Parameters
        ----------
        name, coordinates, parameters, positions, invariants
            As for :class:`MechanicalSystem`.
        lagrangian : sympy expression
            Quadratic in the velocities; linear terms are allowed.

        Raises
        ------
        ModelError
            If L is not a polynomial of degree two in the velocities, or as above.

        Examples
        --------
        >>> import symsimpson as ss
        >>> x, y = ss.coordinates("x y")
        >>> L = (x.diff()**2 + y.diff()**2)/2 + x*y.diff() - x**2
        >>> ss.MechanicalSystem.from_lagrangian("in_a_field", L, (x, y), {}).gyroscopic
        x(t)*Derivative(y(t), t)
        """
        name = read_name(name)
        functions = read_coordinates(name, coordinates)
        symbols = Symbols(functions, read_parameters(name, parameters, functions))
        allowed = (*symbols.q, *symbols.v, *symbols.a)
        with waiting(f"reading {name}"):
            plain = read_expression(name, "Lagrangian", lagrangian, symbols.replace, allowed)
            mass = mass_matrix_of(name, "Lagrangian", plain, symbols.v, symbols.back)
            linear, potential = gyroscopic_and_potential(plain, symbols.v)
        n = len(symbols.v)
        pairs = ((i, j) for i in range(n) for j in range(n))
        kinetic = sp.Add(*(mass[i, j] * symbols.v[i] * symbols.v[j] for i, j in pairs)) / 2
        return cls(
            name,
            coordinates=functions,
            kinetic=symbols.restore(kinetic),
            potential=symbols.restore(potential),
            parameters=parameters,
            positions=positions,
            invariants=invariants,
            gyroscopic=symbols.restore(
                sum((a * v for a, v in zip(linear, symbols.v, strict=True)), sp.S.Zero)
            ),
        )

    @classmethod
    def from_lagranges_method(
        cls, name: str, lm: Any, parameters: Mapping[sp.Symbol, float] = NONE
    ) -> MechanicalSystem:
        """Declare a system by a :class:`sympy.physics.mechanics.LagrangesMethod`.

        Parameters
        ----------
        name, parameters
            As for :class:`MechanicalSystem`.
        lm : sympy.physics.mechanics.LagrangesMethod
            Without forces and constraints: potential forces belong to its Lagrangian.

        Raises
        ------
        ModelError
            If ``lm`` has forces or constraints, or as above.

        Examples
        --------
        >>> import symsimpson as ss
        >>> from sympy.physics.mechanics import LagrangesMethod
        >>> (x,) = ss.coordinates("x")
        >>> method = LagrangesMethod(x.diff()**2/2 - x**4, [x])
        >>> ss.MechanicalSystem.from_lagranges_method("quartic", method, {}).potential
        x(t)**4
        """
        name = read_name(name)
        try:
            lagrangian, coordinates = lm._L[0], tuple(lm.q)
            extras = {"forces": list(lm.forcelist or []), "constraints": list(lm.coneqs)}
        except (AttributeError, TypeError, IndexError):
            kane = type(lm).__name__ == "KanesMethod"
            raise fail(
                name,
                f"{type(lm).__name__} is not a sympy.physics.mechanics.LagrangesMethod.",
                "Kane's equations come without a Lagrangian, and a variational step is made of "
                "one. Write L = sympy.physics.mechanics.Lagrangian(frame, *bodies), with the "
                "bodies' potential_energy, and use from_lagrangian(name, L, coordinates, "
                "parameters)."
                if kane
                else "Pass the LagrangesMethod itself, or use from_lagrangian(name, L, ...).",
            ) from None
        for what, items in extras.items():
            if items:
                raise fail(
                    name,
                    f"the LagrangesMethod has {what}: {spell(items)}.",
                    f"They would be ignored: {what} are not part of a Lagrangian system. "
                    "Put potential forces into the Lagrangian (RigidBody.potential_energy), choose "
                    "coordinates that satisfy the constraints, and drop the rest.",
                )
        return cls.from_lagrangian(name, lagrangian, coordinates, parameters)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @cached_property
    def mass_matrix(self) -> Matrix:
        """M(q), n by n, in the user's own symbols: the Hessian of T in the velocities."""
        back = Symbols(self.coordinates, self.parameters).back
        return Matrix(self.plain.mass.xreplace(dict(back)))

    @property
    def lagrangian(self) -> sp.Expr:
        """L = T + a.v - V in the user's own symbols."""
        return self.kinetic + self.gyroscopic - self.potential

    @cached_property
    def structure(self) -> Structure:
        """What the system has and lacks, and what the generator therefore skips."""
        with waiting(f"analysing {self.name}"):
            return analyse(self)

    @cached_property
    def digest(self) -> str:
        """SHA-256 over names and equations, not over the parameters' values."""
        plain = self.plain
        content = [
            self.name,
            [str(q) for q in self.coordinates],
            [sp.srepr(a) for a in self.parameters],
            sorted((place, sp.srepr(m)) for place, m in plain.mass.todok().items()),
            [sp.srepr(a) for a in plain.gyroscopic],
            sp.srepr(plain.potential),
            {key: sp.srepr(value) for key, value in plain.invariants.items()},
        ]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MechanicalSystem):
            return NotImplemented
        return self.digest == other.digest and dict(self.parameters) == dict(other.parameters)

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> tuple[Any, ...]:
        return unfrozen(self)

    def __repr__(self) -> str:
        names = ", ".join(q.func.__name__ for q in self.coordinates)
        return f"MechanicalSystem({self.name!r}, coordinates=({names}))"

    def _repr_latex_(self) -> str:
        from symsimpson.display.symbolic import system

        return system(self)


def _read(
    name: str,
    coordinates: tuple[AppliedUndef, ...],
    parameters: Mapping[sp.Symbol, float],
    given: MechanicalSystem,
) -> tuple[Plain, Positions, Mapping[str, sp.Expr]]:
    """Check the energies and write them in plain symbols."""
    s = Symbols(coordinates, parameters)
    read = read_expression
    kinetic = read(name, "kinetic energy", given.kinetic, s.replace, (*s.q, *s.v, *s.a))
    potential = read(name, "potential", given.potential, s.replace, (*s.q, *s.a))
    linear = read(name, "gyroscopic term", given.gyroscopic, s.replace, (*s.q, *s.v, *s.a))
    mass = mass_matrix_of(name, "kinetic energy", kinetic, s.v, s.back)
    rest = gyroscopic_and_potential(kinetic, s.v)
    if any(rest[0]) or rest[1] != 0:
        leftover = sum((a * v for a, v in zip(rest[0], s.v, strict=True)), -rest[1])
        raise fail(
            name,
            f"the kinetic energy is not a quadratic form in the velocities: it contains "
            f"{spell(s.restore(leftover))}.",
            "Move terms without velocities to the potential (with the opposite sign) and linear "
            "ones to a Lagrangian: MechanicalSystem.from_lagrangian(name, L, ...).",
        )
    gyroscopic, constant = gyroscopic_and_potential(linear, s.v)
    check_degenerate(name, mass, gyroscopic, s.q, s.back)
    check_mass_matrix(name, mass, s.q, s.v, s.a, s.back)
    terms = Sum(linear)
    if constant != 0 or any(terms.diff(s.v[i], s.v[j]) != 0 for i, j in terms.pairs(s.v)):
        raise fail(
            name,
            f"the gyroscopic term {spell(given.gyroscopic)} is not linear in the velocities.",
            "It must have the form a(q).v; put the rest into T or V.",
        )
    positions: dict[str, tuple[Any, ...]] = {}
    for key, point in (given.positions or {}).items():
        nested = isinstance(point, (tuple, list))
        body = nested and all(isinstance(x, (tuple, list, sp.MatrixBase)) for x in point)
        corners = point if body else [point]
        found: list[tuple[sp.Expr, ...]] = []
        for corner in corners:
            single = not isinstance(corner, (tuple, list, sp.MatrixBase))
            components = (corner,) if single else tuple(corner)
            if not 1 <= len(components) <= 3:
                raise fail(
                    name, f"position {key!r} has {len(components)} components.",
                    "A point has one to three Cartesian components.",
                )  # fmt: skip
            for component in components:
                read(name, f"position {key!r}", component, s.replace, (*s.q, *s.a))
            found.append(tuple(sp.sympify(c) for c in components))
        positions[str(key)] = tuple(found) if body else found[0]
    watch = {**s.replace, **dict(zip(momenta(*coordinates), s.p, strict=True))}
    invariants: dict[str, sp.Expr] = {}
    plain_invariants: dict[str, sp.Expr] = {}
    for key, quantity in (given.invariants or {}).items():
        if not isinstance(key, str):
            raise ModelError(f"system '{name}': the invariant's name {key!r} is not a string.\n"
                             "Write invariants={'angular momentum': ...}.")  # fmt: skip
        plain_invariants[key] = read(
            name, f"invariant {key!r}", quantity, watch, (*s.q, *s.v, *s.p, *s.a)
        )
        invariants[key] = sp.sympify(quantity)
    names = [q.func.__name__ for q in coordinates]
    momentum = [a + row for a, row in zip(gyroscopic, mass * sp.Matrix(s.v), strict=True)]
    written_out = {
        f"p_{x}" for x, p, value in zip(names, s.p, momentum, strict=True)
        if f"p_{x}" in invariants and same_number(plain_invariants[f"p_{x}"], p, value)
    }  # fmt: skip
    check_names(name, names, [key for key in invariants if key not in written_out])
    plain = Plain(
        q=s.q, v=s.v, p=s.p, parameters=s.a, mass=mass, gyroscopic=gyroscopic,
        potential=potential, invariants=MappingProxyType(plain_invariants),
    )  # fmt: skip
    return plain, MappingProxyType(positions), MappingProxyType(invariants)
