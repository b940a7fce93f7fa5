"""The declaration of a mechanical system: kinetic and potential energy, checked and frozen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.checks import read_coordinates, read_name, read_parameters
from symsimpson.declare.constraints import names_of
from symsimpson.declare.declaration import energies, read_energies, read_units
from symsimpson.declare.declared import Positions, fingerprint
from symsimpson.declare.described import Described
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.forces import read_inputs
from symsimpson.declare.methods import read_method
from symsimpson.declare.plain import Symbols, unfrozen
from symsimpson.declare.quadratic import polynomial
from symsimpson.declare.structure import Structure, analyse
from symsimpson.errors import ModelError
from symsimpson.support.calling import explaining
from symsimpson.support.derivation import collecting, timed
from symsimpson.support.interpreter import rarely_collected
from symsimpson.support.progress import waiting

#: No parameters, or no units.
NONE: Mapping[Any, Any] = MappingProxyType({})
Constraints = Mapping[str, sp.Expr] | Sequence[sp.Expr]


@contextmanager
def _stage(stage: str, name: str) -> Iterator[dict[str, float]]:
    """Say that a stage of a system's derivation takes a while, and collect its seconds."""
    with waiting(f"{stage}: {name}"), rarely_collected(), collecting() as seconds, timed(stage):
        yield seconds


@explaining(ModelError, also=("__init__",))
@dataclass(frozen=True, eq=False, repr=False)
class MechanicalSystem(Described):
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
        Every other symbol of T and V, with its default value. Values can be changed at run time
        without recompiling.
    positions : mapping from str to sequence of expressions, optional
        Points to draw, by name: one to three Cartesian components. For the outline of a body, a
        list of points, which are the corners of a closed polygon.
    invariants : mapping from str to expression, optional
        Quantities to watch, in coordinates, velocities and momenta (:func:`symsimpson.momenta`).
    gyroscopic : sympy expression, optional
        Terms linear in the velocities, a(q).v, as a magnetic field or a rotating frame gives.
    forces : mapping, optional
        Generalised forces f(t, q, v, u) by coordinate, ``{q: -c*q.diff()}``; or with names of their
        own, ``{"motor": {q1: ...}, "drag": {q1: ..., q2: ...}}``. A force has the power f.v.
    dissipation : sympy expression, optional
        Rayleigh's dissipation function R(t, q, v), which adds the forces -dR/dv.
    inputs : sequence of symbols, optional
        Symbols in forces whose values are given to each run, step by step:
        ``integrate(..., inputs={"u": values})``.
    constraints : mapping from str to expression, or sequence of expressions, optional
        Holonomic constraints phi(q) = 0 in coordinates and parameters, fewer than coordinates:
        ``{"rod": x**2 + y**2 - l**2}``. M must be positive definite only for velocities with
        dphi/dq.v = 0.
    velocity_constraints : mapping from str to expression, or sequence of expressions, optional
        Expressions linear in the velocities that vanish, A(q, t) v - b(q, t), as of wheels that
        roll and of blades, ``{"blade": cos(a)*y.diff() - sin(a)*x.diff()}``. They pull by -A^T nu.
    units : mapping from str or symbol to str, optional
        Units by quantity, ``{"x": "m", "theta": "rad", "t": "s"}``: labels of figures and data, by
        which figures draw angles and lengths on axes of their own. Nothing is converted.

    Raises
    ------
    ModelError
        If the declaration is invalid, or no variational step can integrate the system.

    Notes
    -----
    The Lagrangian is L = T + a.v - V [1]_. The time :data:`symsimpson.time` may appear in every
    term. If T contains a prescribed motion, its terms of degree 0 and 1 in the velocities are
    sorted into V and a.v automatically.

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

    #: Makes a system in another time: a function of the module that extends this one.
    retimer: ClassVar[Callable[..., MechanicalSystem]]

    def __post_init__(self) -> None:
        name = read_name(self.name)
        coordinates = read_coordinates(name, self.coordinates)
        parameters = read_parameters(name, self.parameters, coordinates)
        inputs = read_inputs(name, self.inputs, coordinates, parameters)
        object.__setattr__(self, "inputs", inputs)
        constraints = names_of(name, self.constraints)
        rolling = names_of(name, self.velocity_constraints, tuple(constraints))
        object.__setattr__(self, "constraints", MappingProxyType(constraints))
        object.__setattr__(self, "velocity_constraints", MappingProxyType(rolling))
        with _stage("reading", name) as seconds:
            plain, positions, invariants = read_energies(name, coordinates, parameters, self)
        others = [*parameters, *inputs, *invariants, *positions]
        for key, value in {
            "coordinates": coordinates,
            "units": MappingProxyType(read_units(name, self.units, coordinates, others)),
            "kinetic": sp.sympify(self.kinetic),
            "potential": sp.sympify(self.potential),
            "gyroscopic": sp.sympify(self.gyroscopic),
            "forces": MappingProxyType(dict(self.forces or {})),
            "parameters": MappingProxyType(parameters),
            "positions": positions,
            "invariants": invariants,
            "plain": plain,
            "seconds": seconds,
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
        forces: Mapping[Any, Any] | None = None,
        dissipation: sp.Expr | None = None,
        inputs: Sequence[sp.Expr] = (),
        constraints: Constraints = (),
        velocity_constraints: Constraints = (),
        units: Mapping[Any, str] = NONE,
    ) -> MechanicalSystem:
        """Declare a system by its Lagrangian.

        Parameters
        ----------
        name, coordinates, parameters, positions, invariants, forces, dissipation, inputs, units
            As for :class:`MechanicalSystem`.
        lagrangian : sympy expression
            Quadratic in the velocities; linear terms are allowed.
        constraints, velocity_constraints
            As for :class:`MechanicalSystem`.

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
        values, held = read_parameters(name, parameters, functions), names_of(name, constraints)
        given = read_inputs(name, inputs, functions, values)
        symbols = Symbols(functions, values, given)
        allowed = (*symbols.q, *symbols.v, *symbols.a, symbols.t)
        with waiting(f"reading {name}"):
            value = read_expression(name, "Lagrangian", lagrangian, symbols, symbols.known, allowed)
            parts = polynomial(name, "Lagrangian", value, symbols)
            kinetic, gyroscopic, potential = energies(sp.sympify(lagrangian), parts, symbols)
        return cls(
            name,
            coordinates=functions,
            kinetic=kinetic,
            potential=potential,
            parameters=parameters,
            positions=positions,
            invariants=invariants,
            gyroscopic=gyroscopic,
            forces=forces,
            dissipation=dissipation,
            inputs=tuple(given),
            constraints=held,
            velocity_constraints=names_of(name, velocity_constraints, tuple(held)),
            units=units,
        )

    @classmethod
    def from_lagranges_method(
        cls,
        name: str,
        lm: Any,
        parameters: Mapping[sp.Symbol, float] = NONE,
        *,
        positions: Positions | None = None,
        invariants: Mapping[str, sp.Expr] | None = None,
        forces: Mapping[Any, Any] | None = None,
        dissipation: sp.Expr | None = None,
        inputs: Sequence[sp.Expr] = (),
        constraints: Constraints = (),
        velocity_constraints: Constraints = (),
        units: Mapping[Any, str] = NONE,
    ) -> MechanicalSystem:
        """Declare a system by a :class:`sympy.physics.mechanics.LagrangesMethod`.

        Parameters
        ----------
        name, parameters, positions, invariants, forces, dissipation, inputs, units
            As for :class:`MechanicalSystem`.
        constraints, velocity_constraints
            As for :class:`MechanicalSystem`; they stand beside those of ``lm``.
        lm : sympy.physics.mechanics.LagrangesMethod
            Each pair of its ``forcelist`` is a point with a force, or a frame with a torque. The
            part of them that has a potential, as gravity and springs have, belongs to V, which is
            found by integration and holds as an identity; the rest is the generalised force named
            "forcelist". Its constraints get the names "1", "2", ..., in its order.

        Raises
        ------
        ModelError
            If ``lm`` is none, or as above.

        Examples
        --------
        >>> import symsimpson as ss
        >>> from sympy.physics.mechanics import LagrangesMethod
        >>> (x,) = ss.coordinates("x")
        >>> method = LagrangesMethod(x.diff()**2/2 - x**4, [x])
        >>> ss.MechanicalSystem.from_lagranges_method("quartic", method, {}).potential
        x(t)**4
        """
        lagrangian, coordinates, loads, held, rolling = read_method(name, lm, inputs)
        return cls.from_lagrangian(
            name,
            lagrangian,
            coordinates,
            parameters,
            positions=positions,
            invariants=invariants,
            forces={**(forces or {}), **loads} if loads else forces,
            dissipation=dissipation,
            inputs=inputs,
            constraints={**names_of(name, constraints), **names_of(name, held)},
            velocity_constraints={
                **names_of(name, velocity_constraints, ()),
                **names_of(name, rolling, tuple(names_of(name, held))),
            },
            units=units,
        )

    @classmethod
    def from_kanes_method(
        cls, name: str, kane: Any, parameters: Mapping[sp.Symbol, float] = NONE, **others: Any
    ) -> MechanicalSystem:
        """Declare a system by a :class:`sympy.physics.mechanics.KanesMethod`.

        Parameters
        ----------
        name, parameters, others
            As for :meth:`from_lagranges_method`.
        kane : sympy.physics.mechanics.KanesMethod
            Its ``kanes_equations`` were called. T is that of its bodies, and speeds are written in
            velocities; one in no kinematical equation becomes that of a coordinate of its own,
            ``u_integral``. The part of loads that has a potential is V; a ``potential_energy`` of
            bodies that is not theirs is left out. The rest is the force "loads". If bodies roll,
            and their places are no coordinates, there is a force "rolling" without power, by which
            equations are Kane's. Velocity constraints that follow from configuration constraints
            are left out.

        Raises
        ------
        ModelError
            If it has auxiliary speeds, does not determine its speeds, or as above.

        Examples
        --------
        >>> import symsimpson as ss
        >>> from sympy.physics.mechanics import KanesMethod, Particle, Point, ReferenceFrame
        >>> (x, u), frame, point = ss.coordinates("x u"), ReferenceFrame("N"), Point("P")
        >>> point.set_vel(frame, u * frame.x)
        >>> kane = KanesMethod(frame, [x], [u], [x.diff() - u])
        >>> _ = kane.kanes_equations([Particle("body", point, 1)], [(point, -4 * x**3 * frame.x)])
        >>> ss.MechanicalSystem.from_kanes_method("quartic", kane).potential
        x(t)**4
        """
        return cls.from_lagranges_method(name, kane, parameters, **others)

    @property
    def retiming(self) -> Any:
        """Data of the time transformation of a retimed system; None for all others."""
        return None

    def retimed(self, rate: Any) -> MechanicalSystem:
        """Return the time-transformed system, dt = g(q) dtau; see :class:`RetimedSystem`.

        Steps of constant size in tau are small in t where g is small, and remain symplectic.

        Parameters
        ----------
        rate : SymPy expression, "encounters" or "kinetic"
            g > 0, of coordinates, parameters and the energy of the run, :data:`symsimpson.energy`.
            It is scaled so that dt = dtau at the start. "encounters" is U**(-3/2), for V = -U with
            U a sum of inverse distances. "kinetic" is (c_rest S + T)**(-1/2). The new parameter
            c_rest has no unit. S is a part of E0 - V0: 1/1024 if all poles of V attract, else 1/8.
            V0 is V where all coordinates are 0, without terms that have a pole if V is infinite
            there. A constant added to V changes nothing. If E0 = V0, S is the change of V from
            there to where all coordinates are 1, or 1 if V does not change.

        Returns
        -------
        RetimedSystem

        Raises
        ------
        ModelError
            If g is nowhere positive, or the system has constraints or an energy that changes.
        """
        return self.retimer(rate)

    @cached_property
    def structure(self) -> Structure:
        """Structure found in L and the forces, which the generator exploits."""
        with _stage("structure", self.name) as seconds:
            structure = analyse(self)
        self.seconds.update(seconds)
        return structure

    @cached_property
    def digest(self) -> str:
        """SHA-256 over names and equations, not over the parameters' values."""
        return fingerprint(self)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MechanicalSystem):
            return NotImplemented
        return self.digest == other.digest and dict(self.parameters) == dict(other.parameters)

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> tuple[Any, ...]:
        return unfrozen(self)
