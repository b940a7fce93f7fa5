"""The declaration of a mechanical system: kinetic and potential energy, checked and frozen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, ClassVar

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.checks import read_coordinates, read_name, read_parameters
from symsimpson.declare.constraints import name_constraints
from symsimpson.declare.declaration import read_energies, read_units, split_lagrangian
from symsimpson.declare.declared import Declared, Positions, compute_digest
from symsimpson.declare.described import Described
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.forces import read_inputs
from symsimpson.declare.methods import read_method
from symsimpson.declare.plain import Symbols, reduce_frozen
from symsimpson.declare.prescribed import (
    PrescribedMotion,
    prescribed_name,
    read_prescribed,
    substitute,
)
from symsimpson.declare.quadratic import split_by_velocities
from symsimpson.declare.structure import Structure, analyse
from symsimpson.errors import ModelError
from symsimpson.support.calling import explain_methods
from symsimpson.support.derivation import collect_times, time_stage
from symsimpson.support.interpreter import collect_rarely
from symsimpson.support.progress import announce

#: The default of parameters and units: an empty mapping.
NONE: Mapping[Any, Any] = MappingProxyType({})
Constraints = Mapping[str, sp.Expr] | Sequence[sp.Expr]


@contextmanager
def stage(stage: str, name: str) -> Iterator[dict[str, float]]:
    """Show the progress of a stage of a system's derivation, and collect its seconds."""
    with (
        announce(f"{stage}: {name}"),
        collect_rarely(),
        collect_times() as seconds,
        time_stage(stage),
    ):
        yield seconds


@explain_methods(ModelError, also=("__init__",))
@dataclass(frozen=True, eq=False, repr=False)
class MechanicalSystem(Described):
    """A mechanical system, declared by its kinetic and its potential energy.

    Parameters
    ----------
    name : str
        The name of the system in files and messages: up to 64 ASCII letters, digits and
        underscores.
    coordinates : sequence of functions of time
        The n coordinates, from :func:`symsimpson.coordinates`. Their velocities are ``.diff()``.
    kinetic : sympy expression
        The kinetic energy T, usually v.M(q).v/2. T may be any function of the velocities whose
        second derivatives by them form a regular matrix M.
    potential : sympy expression
        The potential energy V(q), without velocities.
    parameters : mapping from symbol to number, optional
        Default values of all other symbols of T and V. A run may change the values without
        compiling again.
    positions : mapping from str to sequence of expressions, optional
        Points to draw, by name, with one to three Cartesian components. The outline of a body
        is a list of points, the corners of a closed polygon.
    invariants : mapping from str to expression, optional
        Quantities that runs record, as expressions of coordinates, velocities and momenta
        (:func:`symsimpson.momenta`).
    gyroscopic : sympy expression, optional
        Terms a(q).v of L that are linear in the velocities, for example of a magnetic field or
        a rotating frame. The default is 0.
    indefinite : bool, default False
        Whether constant diagonal entries of M may be negative, as for geodesics of space-time.
        ``from_lagrangian`` always allows this.
    forces : mapping, optional
        Generalised forces f(t, q, v, u) by coordinate, ``{q: -c*q.diff()}``. Or forces with
        names: ``{"motor": {q1: ...}, "drag": {q1: ..., q2: ...}}``. The power of a force is f.v.
    dissipation : sympy expression, optional
        Rayleigh's dissipation function R(t, q, v), which adds the forces -dR/dv.
    inputs : sequence of symbols, optional
        Symbols in forces whose values each run receives step by step:
        ``integrate(..., inputs={"u": values})``.
    constraints : mapping from str to expression, or sequence of expressions, optional
        Holonomic constraints phi(t, q) = 0, fewer than coordinates:
        ``{"rod": x**2 + y**2 - l**2}``. They contain coordinates, parameters, and perhaps the
        time: ``x - sin(symsimpson.time)`` moves x. M must be positive definite only for velocities
        with dphi/dq.v = 0.
    velocity_constraints : mapping from str to expression, or sequence of expressions, optional
        Constraints A(q, t) v - b(q, t) = 0 of rolling wheels or blades:
        ``{"blade": cos(a)*y.diff() - sin(a)*x.diff()}``. They exert the force -A^T nu.
    units : mapping from str or symbol to str, optional
        Units by quantity, ``{"x": "m", "theta": "rad", "t": "s"}``. They label figures and
        data, and figures draw quantities of different units on separate axes. No value is
        converted.
    contacts, friction : mapping from str to Contact or Friction, or sequence, optional
        Contacts that collide, rest and leave (:class:`Contact`), and dry friction that sticks and
        slides (:class:`Friction`).
    prescribed : mapping from coordinate to expression, optional
        Motions of some coordinates as functions of the time and of parameters,
        ``{x: A*sin(w*symsimpson.time)}``. The system then has the other coordinates only. Runs
        have ``run["x"]``, ``run["v_x"]``, and ``run["force_x"]``, the force that moves x.

    Raises
    ------
    ModelError
        If the declaration is invalid, or no variational step can integrate the system.

    Notes
    -----
    The Lagrangian is L = T + a.v - V [1]_. All terms may contain the time
    :data:`symsimpson.time`. If T contains a prescribed motion, its terms of degree 0 and 1 in
    the velocities move to V and a.v automatically.

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

    #: Returns a time-transformed system. The module of RetimedSystem sets it.
    retimer: ClassVar[Callable[..., MechanicalSystem]]

    def __post_init__(self) -> None:
        name = read_name(self.name)
        coordinates = read_coordinates(name, self.coordinates)
        parameters = read_parameters(name, self.parameters, coordinates)
        inputs = read_inputs(name, self.inputs, coordinates, parameters)
        object.__setattr__(self, "inputs", inputs)
        touching: dict[str, Any] = {}
        rubbing: dict[str, Any] = {}
        if self.contacts or self.friction:
            from symsimpson.declare.contacts import read_elements  # few systems have them

            touching, rubbing = read_elements(name, self.contacts, self.friction)
        object.__setattr__(self, "contacts", touching)
        object.__setattr__(self, "friction", rubbing)
        if self.prescribed:
            coordinates = self._prescribe(name, coordinates, parameters)
        constraints = name_constraints(name, self.constraints)
        rolling = name_constraints(name, self.velocity_constraints, tuple(constraints))
        object.__setattr__(self, "constraints", MappingProxyType(constraints))
        object.__setattr__(self, "velocity_constraints", MappingProxyType(rolling))
        with stage("reading", name) as seconds:
            plain, positions, invariants = read_energies(name, coordinates, parameters, self)
        others = [*parameters, *inputs, *invariants, *positions]
        others += self.motion.names if self.motion else ()
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
            "contacts": MappingProxyType(dict(self.contacts)),
            "friction": MappingProxyType(dict(self.friction)),
            "plain": plain,
            "seconds": seconds,
        }.items():
            object.__setattr__(self, key, value)
        if touching or rubbing:
            from symsimpson.declare.modes import Modes  # few systems have modes

            object.__setattr__(self, "modes", Modes(self, ModeSystem))

    def _prescribe(
        self,
        name: str,
        coordinates: tuple[AppliedUndef, ...],
        parameters: Mapping[sp.Symbol, float],
    ) -> tuple[AppliedUndef, ...]:
        """Replace prescribed coordinates in all fields; return the others."""
        motions = read_prescribed(name, self.prescribed, coordinates, parameters)
        given = {f.name: getattr(self, f.name) for f in fields(Declared) if f.init}
        constraints = {prescribed_name(q): q - x for q, x in motions.items()}
        constraints |= name_constraints(name, self.constraints)
        whole = given | {"constraints": constraints, "prescribed": {}}
        whole |= dict.fromkeys(("positions", "invariants", "contacts", "friction"))
        every = partial(MechanicalSystem, **whole)
        motion = PrescribedMotion(every, partial(type(self), **given), motions)
        object.__setattr__(self, "motion", motion)
        for key, x in given.items():
            if key not in ("name", "coordinates", "parameters", "units", "prescribed"):
                object.__setattr__(self, key, substitute(x, motions))
        return tuple(q for q in coordinates if q not in motions)

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
        prescribed: Mapping[Any, sp.Expr] = NONE,
        contacts: Any = NONE,
        friction: Any = NONE,
    ) -> MechanicalSystem:
        """Declare a system by its Lagrangian.

        Parameters
        ----------
        name, coordinates, parameters, positions, invariants, forces, dissipation, inputs, units
            See :class:`MechanicalSystem`.
        lagrangian : sympy expression
            The Lagrangian L(q, v, t). The second derivatives of L by the velocities must form a
            regular matrix M = L_vv. L may be any function of the velocities. M may be indefinite.
        constraints, velocity_constraints, prescribed, contacts, friction
            See :class:`MechanicalSystem`.

        Returns
        -------
        MechanicalSystem

        Raises
        ------
        ModelError
            If L_vv is singular everywhere, or the declaration is invalid.

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
        values, phi = (
            read_parameters(name, parameters, functions),
            name_constraints(name, constraints),
        )
        given = read_inputs(name, inputs, functions, values)
        symbols = Symbols(functions, values, given)
        allowed = (*symbols.q, *symbols.v, *symbols.a, symbols.t)
        with announce(f"reading {name}"):
            value = read_expression(name, "Lagrangian", lagrangian, symbols, symbols.known, allowed)
            parts = split_by_velocities(name, "Lagrangian", value, symbols)
            kinetic, gyroscopic, potential = split_lagrangian(
                sp.sympify(lagrangian), parts, symbols
            )
        return cls(
            name,
            coordinates=functions,
            kinetic=kinetic,
            potential=potential,
            parameters=parameters,
            positions=positions,
            invariants=invariants,
            gyroscopic=gyroscopic,
            indefinite=True,
            forces=forces,
            dissipation=dissipation,
            inputs=tuple(given),
            constraints=phi,
            velocity_constraints=name_constraints(name, velocity_constraints, tuple(phi)),
            units=units,
            prescribed=prescribed,
            contacts=contacts,
            friction=friction,
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
            See :class:`MechanicalSystem`.
        constraints, velocity_constraints
            Constraints in addition to those of ``lm``; see :class:`MechanicalSystem`.
        lm : sympy.physics.mechanics.LagrangesMethod
            The Lagrangian, coordinates, loads and constraints. Constraints are named "1", "2", ...,
            in the order of ``lm``.

        Returns
        -------
        MechanicalSystem

        Raises
        ------
        ModelError
            If ``lm`` is not a LagrangesMethod, or the declaration is invalid.

        Notes
        -----
        An entry of ``lm.forcelist`` is a point with a force, or a frame with a torque. Loads with a
        potential, such as gravity and springs, become a part of V. V is found by integration, and
        -dV/dq is verified as an identity. The other loads form the force named "forcelist".

        Examples
        --------
        >>> import symsimpson as ss
        >>> from sympy.physics.mechanics import LagrangesMethod
        >>> (x,) = ss.coordinates("x")
        >>> method = LagrangesMethod(x.diff()**2/2 - x**4, [x])
        >>> ss.MechanicalSystem.from_lagranges_method("quartic", method, {}).potential
        x(t)**4
        """
        lagrangian, coordinates, loads, phi, rolling = read_method(name, lm, inputs)
        configuration = name_constraints(name, phi)
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
            constraints={**name_constraints(name, constraints), **configuration},
            velocity_constraints={
                **name_constraints(name, velocity_constraints, ()),
                **name_constraints(name, rolling, tuple(configuration)),
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
            See :meth:`from_lagranges_method`.
        kane : sympy.physics.mechanics.KanesMethod
            The method, after a call of ``kanes_equations(bodies, loads)``.

        Returns
        -------
        MechanicalSystem

        Raises
        ------
        ModelError
            If ``kane`` has auxiliary speeds or does not determine its speeds, or the declaration is
            invalid.

        Notes
        -----
        T is the kinetic energy of the bodies, with speeds written in velocities. A speed in no
        kinematical equation becomes the velocity of a new coordinate ``u_integral``.

        Loads with a potential become V. The other loads form the force "loads". A
        ``potential_energy`` of bodies that differs from V is ignored, with a warning.

        If the position of a rolling body is not among the coordinates, the system gets a force
        "rolling", which does no work. With it, the equations equal Kane's. Velocity constraints
        that follow from configuration constraints are removed.

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
        """The parts of a time-transformed system that its modules use; None for other systems."""
        return None

    def retimed(self, rate: Any) -> MechanicalSystem:
        """Return the time-transformed system, dt = g(q) dtau; see :class:`RetimedSystem`.

        Steps of constant size in tau are small in t if g is small. The scheme remains symplectic.

        Parameters
        ----------
        rate : SymPy expression, "encounters" or "kinetic"
            The rate g > 0, an expression of coordinates, parameters and the energy of the run,
            :data:`symsimpson.energy`. It is scaled so that dt = dtau at the start.

        Returns
        -------
        RetimedSystem

        Raises
        ------
        ModelError
            If g is nowhere positive, or the system has constraints or an energy that changes.

        Notes
        -----
        "encounters" is g = U**(-3/2), for V = -U where U is a sum of inverse distances.

        "kinetic" is g = (c_rest S + T)**(-1/2) with a new parameter c_rest, which has no unit. S is
        a part of E0 - V0: 1/1024 if all poles of V attract, and 1/8 otherwise. V0 is V at q = 0. If
        V is infinite there, V0 omits the terms with a pole. If E0 = V0, S is the change of V from
        q = 0 to q = 1 in all coordinates, or 1 if V does not change. A constant that is added to V
        does not change S.
        """
        return self.retimer(rate)

    @cached_property
    def structure(self) -> Structure:
        """The structure of L and the forces that the generator exploits."""
        with stage("structure", self.name) as seconds:
            structure = analyse(self)
        self.seconds.update(seconds)
        return structure

    @cached_property
    def digest(self) -> str:
        """The SHA-256 of the names and equations, without parameter values."""
        return compute_digest(self)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MechanicalSystem):
            return NotImplemented
        return self.digest == other.digest and dict(self.parameters) == dict(other.parameters)

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> tuple[Any, ...]:
        return reduce_frozen(self) if self.motion is None else (self.motion.again, ())


class ModeSystem(MechanicalSystem):
    """The system of one mode of contacts and friction; its directions are the last parameters.

    ``texts`` are expressions for the events that end the mode, in plain symbols.
    """

    in_mode: ClassVar[bool] = True
    base: MechanicalSystem
    key: Any
    texts: Mapping[str, str]

    def __reduce__(self) -> tuple[Any, ...]:
        return mode_of, (self.base, self.key)


def mode_of(base: MechanicalSystem, key: Any) -> MechanicalSystem:
    """Return the system of a mode of another system."""
    mode: MechanicalSystem = base.modes.system_of(key)
    return mode
