"""Systems that are declared by a Hamiltonian H(q, p, t).

In the graph of such a system, the symbols of velocities are the momenta.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray
from sympy.core.function import AppliedUndef

from symsimpson.declare.checks import (
    check_names,
    read_coordinates,
    read_name,
    read_parameters,
    reject_model,
    spell,
)
from symsimpson.declare.coordinates import time
from symsimpson.declare.declaration import read_invariants, read_positions, read_units, sympified
from symsimpson.declare.described import read_point
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.forces import check_used, read_forces, read_inputs
from symsimpson.declare.hamiltonian_structure import analyse_hamiltonian
from symsimpson.declare.plain import Plain, Symbols
from symsimpson.declare.structure import Structure
from symsimpson.declare.system import MechanicalSystem, stage
from symsimpson.errors import reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluate_doubles
from symsimpson.graph.nodes import ZERO, Value


@dataclass(frozen=True, eq=False, repr=False)
class HamiltonianSystem(MechanicalSystem):
    """A system that is declared by its Hamiltonian H(q, p, t).

    Use it where no Lagrangian exists, for example for point vortices, or where H is what you have.
    The equations are q' = H_p and p' = f - H_q.

    Parameters
    ----------
    name : str
        The name of the system in files and messages: up to 64 ASCII letters, digits and
        underscores.
    coordinates : sequence of functions of time
        The n coordinates, from :func:`symsimpson.coordinates`.
    momenta : sequence of symbols
        One symbol for the momentum of each coordinate, in the same order.
    hamiltonian : sympy expression
        H of coordinates, momenta, parameters and the time :data:`symsimpson.time`.
    parameters : mapping from symbol to number, optional
        Default values of all other symbols of H. A run may change the values without compiling
        again.
    forces : mapping, optional
        Forces f(t, q, p, v, u) by coordinate, or by name and coordinate. Velocities ``q.diff()``
        mean H_p. The power of a force is f.v.
    inputs : sequence of symbols, optional
        Symbols in forces whose values each run receives step by step.
    invariants : mapping from str to expression, optional
        Quantities that runs record, as expressions of coordinates, momenta and velocities.
    positions : mapping from str to sequence of expressions, optional
        Points to draw, by name, with one to three Cartesian components.
    units : mapping from str or symbol to str, optional
        Units by quantity, as labels of figures and data.

    Raises
    ------
    ModelError
        If the declaration is invalid.

    Notes
    -----
    Schemes with as many nodes as degrees are symplectic for every H: "midpoint", "gauss4" to
    "gauss16", "lobatto_3_3" and "lobatto_4_4" (also called "lobatto_iiiab4" and "lobatto_iiiab6")
    and "radau3", "radau5". They are partitioned Runge-Kutta methods [1]_. Explicit schemes such as
    "lobatto2" and "kahan_li8" need H = T(p) + V(q).

    References
    ----------
    .. [1] E. Hairer, C. Lubich and G. Wanner, Geometric Numerical Integration, Springer 2006,
       sections II.2 and VI.4.

    Examples
    --------
    >>> import sympy as sp, symsimpson as ss
    >>> (x,), p = ss.coordinates("x"), sp.Symbol("p")
    >>> rotor = ss.HamiltonianSystem("rotor", coordinates=(x,), momenta=(p,),
    ...                              hamiltonian=p**2/2 - sp.cos(x - ss.time))
    >>> run = ss.compile(rotor, "gauss8").integrate([0.5], p0=[1.0], h=0.1, t_end=1.0)
    >>> run.p.shape
    (11, 1)
    """

    momenta: tuple[sp.Symbol, ...] = field(kw_only=True)
    hamiltonian: sp.Expr = field(kw_only=True)
    kinetic: sp.Expr = field(init=False, default=sp.S.Zero)
    potential: sp.Expr = field(init=False, default=sp.S.Zero)
    gyroscopic: sp.Expr = field(init=False, default=sp.S.Zero)
    indefinite: bool = field(init=False, default=True)
    dissipation: sp.Expr | None = field(init=False, default=None)
    constraints: Mapping[str, sp.Expr] = field(init=False, default_factory=dict)
    velocity_constraints: Mapping[str, sp.Expr] = field(init=False, default_factory=dict)
    prescribed: Mapping[Any, sp.Expr] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        name = read_name(self.name)
        coordinates = read_coordinates(name, self.coordinates)
        parameters = read_parameters(name, self.parameters, coordinates)
        inputs = read_inputs(name, self.inputs, coordinates, parameters)
        momenta = _read_momenta(name, self.momenta, coordinates, (*parameters, *inputs))
        with stage("reading", name) as seconds:
            plain, positions, invariants = _read(
                self, name, coordinates, momenta, parameters, inputs
            )
        others = [*parameters, *inputs, *invariants, *positions]
        for key, value in {
            "coordinates": coordinates,
            "momenta": momenta,
            "inputs": inputs,
            "units": MappingProxyType(read_units(name, self.units, coordinates, others)),
            "hamiltonian": sp.sympify(self.hamiltonian),
            "forces": MappingProxyType(dict(self.forces or {})),
            "parameters": MappingProxyType(parameters),
            "constraints": MappingProxyType({}),
            "velocity_constraints": MappingProxyType({}),
            "positions": positions,
            "invariants": invariants,
            "plain": plain,
            "seconds": seconds,
        }.items():
            object.__setattr__(self, key, value)

    @cached_property
    def structure(self) -> Structure:
        """The structure of H and the forces."""
        with stage("structure", self.name) as seconds:
            structure = analyse_hamiltonian(self)
        self.seconds.update(seconds)
        return structure

    @cached_property
    def equations(self) -> tuple[sp.Eq, ...]:
        """Hamilton's equations q' = H_p and p' = f - H_q, in SymPy; p are functions of time.

        Raises
        ------
        ModelError
            If H is too long for SymPy expressions.
        """
        if self.too_large_for_sympy:
            reject_model(
                self.name,
                "H is too long for equations in SymPy.",
                "Evaluate it as numbers with stepper.step.",
            )
        moving = {p: sp.Function(p.name)(time) for p in self.momenta}
        H, n = self.hamiltonian, self.n
        rates = [sp.diff(H, p) for p in self.momenta]
        forces: list[sp.Expr] = [sp.S.Zero] * n
        back = dict(Symbols(self.coordinates, self.parameters, self.inputs).back)
        back |= dict(zip(self.plain.v, self.momenta, strict=True))
        for i, force in enumerate(self.plain.f):
            forces[i] = self.plain.to_sympy(force).xreplace(back)
        return (
            *(
                sp.Eq(q.diff(time), rate.xreplace(moving))
                for q, rate in zip(self.coordinates, rates, strict=True)
            ),
            *(
                sp.Eq(moving[p].diff(time), (force - sp.diff(H, q)).xreplace(moving))
                for q, p, force in zip(self.coordinates, self.momenta, forces, strict=True)
            ),
        )

    def linearise(
        self,
        q0: ArrayLike,
        p0: ArrayLike | None = None,
        *,
        parameters: Mapping[Any, float] | None = None,
        inputs: Mapping[Any, float] | None = None,
        t: float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Linearise Hamilton's equations about a state: x' = A x + B u with x = (q, p).

        Parameters
        ----------
        q0 : array_like, shape (n,)
            Positions.
        p0 : array_like, shape (n,), optional
            Momenta. The default is zero.
        parameters : mapping, optional
            Values of parameters by symbol or name. The default is the system's own values.
        inputs : mapping, optional
            Values of inputs by symbol or name. The default is 0.
        t : float, default 0.0
            The time, if the equations depend on it.

        Returns
        -------
        A : ndarray, shape (2 n, 2 n)
            Derivatives of the rates of (q, p) by (q, p).
        B : ndarray, shape (2 n, m)
            Derivatives of the rates of (q, p) by the m inputs.

        Raises
        ------
        InputError
            If the state is invalid, or if a derivative is not finite there.
        """
        plain, n, m = self.plain, self.n, len(self.inputs)
        _, _, point = read_point(self, q0, {"p0": p0}, parameters, inputs, t)
        states = plain.numbers((*plain.q, *plain.v, *plain.u))
        rates = [*plain.velocities, *plain.right_sides]
        slopes = [x for rate in rates for x in gradient(plain.graph, rate, states)]
        matrix = np.reshape(evaluate_doubles(plain.graph, slopes, point), (2 * n, 2 * n + m))
        if not np.isfinite(matrix).all():
            reject(
                "the linear equations have no finite values at this state.",
                where=self.name,
                remedy="Choose a state at which H and forces are smooth.",
            )
        return matrix[:, : 2 * n], matrix[:, 2 * n :]

    @property
    def lagrangian(self) -> sp.Expr:
        """A Hamiltonian system has no Lagrangian in its declaration; this raises ModelError."""
        reject_model(
            self.name,
            "it is declared by its Hamiltonian, so it has no Lagrangian.",
            "Use system.hamiltonian.",
        )

    @property
    def mass_matrix(self) -> Any:
        """A Hamiltonian system has no mass matrix; this raises ModelError."""
        reject_model(
            self.name,
            "it is declared by its Hamiltonian, so it has no mass matrix.",
            "Use system.hamiltonian.",
        )

    def __repr__(self) -> str:
        names = ", ".join(q.func.__name__ for q in self.coordinates)
        return f"HamiltonianSystem({self.name!r}, coordinates=({names}))"


def _read_momenta(
    name: str, momenta: Any, coordinates: Sequence[AppliedUndef], others: Sequence[Any]
) -> tuple[sp.Symbol, ...]:
    """Check that the momenta are distinct symbols, one for each coordinate."""
    reject_here = partial(reject_model, name)
    given = (momenta,) if isinstance(momenta, sp.Symbol) else momenta
    if isinstance(given, (str, Mapping, set)) or not hasattr(given, "__iter__"):
        reject_here(
            f"the momenta are {spell(given)!r}, not a tuple of symbols.",
            "Make them first: p1, p2 = sympy.symbols('p1 p2', real=True).",
        )
    symbols = tuple(given)
    if len(symbols) != len(coordinates):
        reject_here(
            f"there are {len(coordinates)} coordinates and {len(symbols)} momenta.",
            "Give one momentum for each coordinate, in the same order.",
        )
    taken = {q.func.__name__: "a coordinate" for q in coordinates}
    taken |= {str(x): "a parameter or input" for x in others}
    for p in symbols:
        if not isinstance(p, sp.Symbol) or p == time:
            reject_here(
                f"the momentum {spell(p)!r} is not a SymPy symbol.",
                "Make it with sympy.Symbol('p', real=True).",
            )
        if (
            p.is_real is False
            or p.is_integer
            or any(getattr(p, f"is_{sign}") for sign in ("positive", "negative", "nonzero"))
        ):
            reject_here(
                f"the momentum {p} has assumptions that the motion may violate.",
                "Make it with sympy.Symbol(name, real=True).",
            )
        if p.name in taken:
            reject_here(
                f"two symbols have the name '{p.name}': a momentum and {taken[p.name]}.",
                "Rename one of them.",
            )
        taken[p.name] = "another momentum"
    return symbols


def _read(
    given: HamiltonianSystem,
    name: str,
    coordinates: tuple[AppliedUndef, ...],
    momenta: tuple[sp.Symbol, ...],
    parameters: Mapping[sp.Symbol, float],
    inputs: tuple[sp.Expr, ...],
) -> tuple[Plain, Mapping[str, Any], Mapping[str, sp.Expr]]:
    """Check a declaration, and return its graph, its positions and its invariants."""
    reject_here = partial(reject_model, name)
    s = Symbols(coordinates, parameters, inputs)
    velocities = [q.diff(time) for q in coordinates]
    for velocity, p, plain in zip(velocities, momenta, s.v, strict=True):
        s.known[p] = s.known.pop(velocity)
        s.replace[p] = s.replace.pop(velocity)
        s.back[plain] = p

    def read(what: str, expression: Any, *allowed: Sequence[sp.Symbol]) -> Value:
        places = [symbol for group in (*allowed, s.q, s.a, (s.t,)) for symbol in group]
        return read_expression(name, what, expression, s, s.known, places)

    written = given.hamiltonian
    if isinstance(written, sp.Basic) and (moved := written.atoms(sp.Derivative) & {*velocities}):
        velocity = min(moved, key=str)
        reject_here(
            f"the Hamiltonian contains the velocity {spell(velocity)}. H depends on coordinates "
            "and momenta.",
            "Write it with the momenta, or declare the Lagrangian: "
            "MechanicalSystem.from_lagrangian(name, L, ...).",
        )
    hamiltonian = read("Hamiltonian", written, s.v)
    rates = gradient(s.graph, hamiltonian, s.numbers(s.v))
    if not any(c for c, _ in rates):
        reject_here(
            f"the Hamiltonian {spell(written)} contains no momentum, so nothing moves.",
            f"Write it with the symbols {', '.join(map(str, momenta))}.",
        )
    s.known |= dict(zip(velocities, rates, strict=True))

    def read_moving(what: str, expression: Any) -> Value:
        return read(what, expression, s.v, s.u)

    forces = read_forces(name, coordinates, given.forces, None, s, read_moving)
    check_used(name, inputs, s, forces)
    positions = read_positions(name, given, s, read)
    invariants = read_invariants(name, given.invariants)
    values = {key: read(f"invariant {key!r}", x, s.v) for key, x in invariants.items()}
    plain_system = Plain(
        graph=s.graph,
        q=s.q,
        v=s.v,
        p=s.p,
        parameters=s.a,
        T=ZERO,
        M={},
        a=(ZERO,) * len(s.q),
        V=ZERO,
        invariants=MappingProxyType(values),
        t=s.t,
        forces=forces,
        u=s.u,
        hamiltonian=hamiltonian,
    )
    check_names(name, [q.func.__name__ for q in coordinates], invariants)
    return plain_system, MappingProxyType(positions), sympified(invariants)
