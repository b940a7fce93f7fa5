"""Properties that follow from a declaration: equations of motion, linearisation, LaTeX."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray
from sympy.printing.latex import greek_letters_set, other_symbols

from symsimpson.declare.consistent import consistent
from symsimpson.declare.constraints import accelerations
from symsimpson.declare.coordinates import time
from symsimpson.declare.declared import Declared, read_values, read_vector
from symsimpson.declare.plain import Plain, Symbols
from symsimpson.errors import ModelError, reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluate_doubles
from symsimpson.graph.nodes import Value, scale
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explain_methods
from symsimpson.support.markup import aligned, in_text

if TYPE_CHECKING:
    from symsimpson.declare.energy_functions import EnergyFunctions

#: Largest relative distance of an accepted state from one that satisfies the constraints.
NEAR = 1e-6
#: Names that SymPy may typeset unchanged: letters of any alphabet, or a Greek letter by its LaTeX
#: name, with a subscript and primes.
PLAIN = re.compile(r"([^\W\d_]\w*|\\(?P<macro>[A-Za-z]+)(_\w+)?)(_\{\w+\})?'*")
#: Commands of LaTeX that are letters.
LETTERS = greek_letters_set | other_symbols
#: Limits for showing equations of motion: number of coordinates, and of operations in each.
SHOWN, MOST_OPERATIONS = 4, 300
#: Attributes for the package, which ``dir`` does not list.
INNER = frozenset(
    {"digest", "mass_checked", "plain", "retimer", "retiming", "seconds", "too_large_for_sympy"}
)


def equation_terms(
    system: Declared, multipliers: list[sp.Symbol]
) -> list[tuple[sp.Expr, sp.Expr, sp.Expr]]:
    """Return dL/dv, dL/dq and the sum of forces and constraint forces, for each coordinate."""
    back = dict(Symbols(system.coordinates, system.parameters, system.inputs).back)
    lagrangian = system.lagrangian
    m = len(system.constraints)
    phis = zip(multipliers[:m], system.constraints.values(), strict=True)
    potential = sum((multiplier * phi for multiplier, phi in phis), sp.S.Zero)
    rates = zip(multipliers[m:], system.velocity_constraints.values(), strict=True)
    rolling = sum((multiplier * rate for multiplier, rate in rates), sp.S.Zero)
    return [
        (
            sp.diff(lagrangian, q.diff(time)),
            sp.diff(lagrangian, q),
            system.plain.to_sympy(force).xreplace(back)
            - sp.diff(potential, q)
            - sp.diff(rolling, q.diff(time)),
        )
        for q, force in zip(system.coordinates, system.plain.f, strict=True)
    ]


def _residual(plain: Plain) -> tuple[list[Value], tuple[int, ...]]:
    """Write M a + W^T lambda - push and W a + curve, and return the nodes of a and lambda."""
    graph, q, v = plain.graph, plain.numbers(plain.q), plain.numbers(plain.v)
    places = (q, v, plain.time)
    terms = accelerations(graph, plain.L, plain.write_constraints(graph), plain.f, places)
    a = graph.numbers(f"acceleration_{i}" for i in range(len(q)))
    pulls = graph.numbers(s.name for s in plain.multipliers)
    residual = []
    for i, push in enumerate(terms.push):
        mass = graph.products([plain.entry(i, j) for j in range(len(q))], a)
        turned = graph.products([row[i] for row in terms.rows], pulls)
        residual.append(graph.add([*mass, *turned, scale(-1, push)]))
    # the rate of change of W v is zero, which determines the multipliers
    for row, curve in zip(terms.rows, terms.curve, strict=True):
        residual.append(graph.add([*graph.products(row, a), curve]))
    return residual, (*a, *pulls)


def read_point(
    system: Declared,
    q0: ArrayLike,
    other: Mapping[str, ArrayLike | None],
    parameters: Mapping[Any, float] | None,
    inputs: Mapping[Any, float] | None,
    t: float,
) -> tuple[Floats, Floats, dict[int, float]]:
    """Read q0, and v0 or p0 by name; return them with the values of all symbols of the graph."""
    plain, ((name, second),) = system.plain, other.items()
    q = read_vector(system, "q0", q0)
    v = np.zeros(system.n) if second is None else read_vector(system, name, second)
    values = read_values("parameters", "parameter", system.parameters, parameters)
    given = read_values("inputs", "input", dict.fromkeys(system.inputs, 0.0), inputs)
    symbols = plain.numbers((*plain.q, *plain.v, *plain.parameters, *plain.u, plain.t))
    known = zip(symbols, (*q.tolist(), *v.tolist(), *values, *given, t), strict=True)
    return q, v, dict(known)


def _check_constraints(
    system: Declared, q: Floats, v: Floats, parameters: Mapping[Any, float] | None, t: float
) -> None:
    """Reject a state that does not satisfy the constraints."""
    if not system.plain.constraint_names:
        return
    nearest = consistent(system, q, v, (), parameters, t)
    for name, given, near in zip(("q0", "v0"), (q, v), nearest, strict=True):
        if np.abs(near - given).max() > NEAR * np.abs(near).max():
            reject(
                f"{name} does not satisfy the constraints.",
                where=system.name,
                remedy="Use the nearest state that does: q0, v0 = system.consistent(q0, v0).",
            )


def _equations(declared: Declared) -> str:
    """Write T, V, M and, for few coordinates, the equations of motion in LaTeX."""
    from sympy.physics.vector import vlatex  # long to import

    safe = _plain_names(declared)
    kinetic, potential = (
        sp.sympify(x).xreplace(safe) for x in (declared.kinetic, declared.potential)
    )
    lines = [("T", kinetic), ("V", potential)]
    held = (*declared.constraints.values(), *declared.velocity_constraints.values())
    lines += [("0", sp.sympify(expression).xreplace(safe)) for expression in held]
    for key, contact in declared.contacts.items():
        lines.append((rf"g_{{\text{{{in_text(key)}}}}}", contact.gap.xreplace(safe)))
    modes = declared.modes
    for key, u in zip(modes.elements, modes.velocities, strict=True) if modes else ():
        lines.append((rf"u_{{\text{{{in_text(key)}}}}}", u.xreplace(safe)))
    if declared.plain.hamiltonian is not None:
        lines = [("H", sp.sympify(getattr(declared, "hamiltonian", 0)).xreplace(safe))]
        for equation in getattr(declared, "equations", ()) if declared.n <= SHOWN else ():
            left, right = (x.xreplace(safe) for x in (equation.lhs, equation.rhs))
            lines.append((vlatex(left), right))
        return aligned([(left, vlatex(right)) for left, right in lines])
    m = len(held)
    multipliers = [sp.Symbol(f"lambda_{k + 1}" if m > 1 else "lambda") for k in range(m)]
    if declared.n <= SHOWN:
        lines.append(("M", declared.mass_matrix.xreplace(safe)))
        equations = zip(declared.coordinates, equation_terms(declared, multipliers), strict=True)
        for q, (moment, slope, pull) in equations:
            name, moment, force = (x.xreplace(safe) for x in (q, moment, slope + pull))
            if sp.count_ops([moment, force]) > MOST_OPERATIONS:
                break
            label = vlatex(name)
            lines.append((f"p_{{{label}}}", moment))
            lines.append((rf"\dot{{p}}_{{{label}}}", force))
    return aligned([(left, vlatex(right)) for left, right in lines])


def _plain_names(declared: Declared) -> dict[Any, Any]:
    """Map symbols whose names SymPy cannot typeset to plain ones."""
    replace: dict[Any, Any] = {
        a: sp.Symbol(f"a_{i}") for i, a in enumerate(declared.parameters) if not _is_plain(a.name)
    }
    for i, q in enumerate(declared.coordinates):
        if not _is_plain(q.func.__name__):
            plain = sp.Function(f"q_{i}")(time)
            replace |= {q: plain, q.diff(time): plain.diff(time)}
    return replace


def _is_plain(name: str) -> bool:
    """Return whether a name can be typeset unchanged; of LaTeX's commands, only letters can."""
    match = PLAIN.fullmatch(name)
    macro = match and match["macro"]
    return match is not None and (macro is None or macro.removeprefix("var").lower() in LETTERS)


@explain_methods(ModelError)
class Described(Declared):
    """Properties that follow from the declaration of a system, in the user's symbols."""

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates minus the number of constraints of positions."""
        return self.n - len(self.constraints)

    @property
    def velocity_degrees_of_freedom(self) -> int:
        """Number of free velocities: coordinates minus all constraints."""
        return self.degrees_of_freedom - len(self.velocity_constraints)

    @property
    def energies(self) -> EnergyFunctions:
        """The energies as functions for other libraries: ``system.energies.to_jax()``."""
        from symsimpson.declare.energy_functions import EnergyFunctions  # few programs need it

        return EnergyFunctions(self)

    @cached_property
    def equations(self) -> tuple[sp.Eq, ...]:
        """The Euler-Lagrange equations d/dt dL/dv - dL/dq = f, one for each coordinate, in SymPy.

        With constraints, -Phi^T lambda is added to the right side, and the equations phi = 0
        follow. With velocity constraints, -A^T lambda is added, and A v - b = 0 follows.

        Raises
        ------
        ModelError
            If T and V are too long for SymPy expressions.

        Examples
        --------
        >>> import symsimpson as ss
        >>> ss.systems.henon_heiles().equations[0]
        Eq(2*x(t)*y(t) + x(t) + Derivative(x(t), (t, 2)), 0)
        """
        if self.too_large_for_sympy:
            reject(
                "T and V are too long for equations in SymPy.",
                where=f"system '{self.name}'",
                remedy="Evaluate them as numbers with stepper.residual and stepper.jacobian.",
                error=ModelError,
            )
        multipliers = [sp.Symbol(f"lambda_{name}") for name in self.plain.constraint_names]
        written = [
            sp.Eq(sp.diff(moment, time) - force, pull)
            for moment, force, pull in equation_terms(self, multipliers)
        ]
        held = (*self.constraints.values(), *self.velocity_constraints.values())
        return (*written, *(sp.Eq(expression, 0) for expression in held))

    def mode(self, states: Mapping[str, Any]) -> Declared:
        """Return the system of one mode of contacts and dry friction.

        Parameters
        ----------
        states : mapping from str to state
            "open" or "rest" for a contact; 0 (sticks), 1 or -1 (slides in this direction) for
            friction. Contacts that you omit are open, and friction that you omit slides with 1.

        Returns
        -------
        MechanicalSystem
            A system with constraints in place of what rests and sticks. The directions of sliding
            are its last parameters.

        Raises
        ------
        ModelError
            If the system has no such contact or friction element, or no such state.

        Examples
        --------
        >>> import symsimpson as ss
        >>> (x,) = ss.coordinates("x")
        >>> brake = ss.MechanicalSystem("brake", coordinates=(x,), kinetic=x.diff()**2/2,
        ...                             potential=0*x, friction=[ss.Friction(x.diff(), limit=2)])
        >>> list(brake.mode({"1": 0}).velocity_constraints)
        ['1']
        """
        if self.modes is None:
            reject(
                "it has neither contacts nor dry friction, so it has no modes.",
                where=f"system '{self.name}'",
                remedy="Declare contacts={...} or friction={...}.",
                error=ModelError,
            )
        mode: Declared = self.modes.system_of(self.modes.read(states))
        return mode

    def linearise(
        self,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        parameters: Mapping[Any, float] | None = None,
        inputs: Mapping[Any, float] | None = None,
        t: float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Linearise the equations of motion about a state: x' = A x + B u with x = (q, v).

        The linear equations respect the constraints, so multipliers vary with the state. A has
        the eigenvalues of the motion, and in addition the eigenvalue 0: twice for each constraint
        of positions, once for each velocity constraint.

        Parameters
        ----------
        q0 : array_like, shape (n,)
            Positions.
        v0 : array_like, shape (n,), optional
            Velocities. The default is zero.
        parameters : mapping, optional
            Values of parameters by symbol or name. The default is the system's own values.
        inputs : mapping, optional
            Values of inputs by symbol or name. The default is 0.
        t : float, default 0.0
            The time, if the equations depend on it.

        Returns
        -------
        A : ndarray, shape (2 n, 2 n)
            Derivatives of the rates of (q, v) by (q, v).
        B : ndarray, shape (2 n, m)
            Derivatives of the rates of (q, v) by the m inputs.

        Raises
        ------
        InputError
            If the state is invalid or does not satisfy the constraints, or if a derivative is
            not finite there.

        Examples
        --------
        >>> import numpy as np
        >>> import symsimpson as ss
        >>> A, B = ss.systems.pendulum().linearise([0.0])
        >>> bool(abs(np.linalg.eigvals(A).imag).max() ** 2 == 9.81)
        True
        """
        n, m, plain = self.n, len(self.inputs), self.plain
        q, v, known = read_point(self, q0, {"v0": v0}, parameters, inputs, t)
        _check_constraints(self, q, v, parameters, t)
        residual, unknowns = _residual(plain)
        moved = (*unknowns, *plain.numbers((*plain.q, *plain.v, *plain.u)))
        slopes = [gradient(plain.graph, row, moved) for row in residual]

        def at(there: Sequence[float], wanted: Sequence[Sequence[Value]]) -> Floats:
            point = known | dict(zip(unknowns, there, strict=True))
            flat = evaluate_doubles(plain.graph, [value for row in wanted for value in row], point)
            return np.reshape(flat, (len(wanted), -1))

        size = len(unknowns)
        try:
            mass, rest = (
                at([0.0] * size, wanted)
                for wanted in ([row[:size] for row in slopes], [[row] for row in residual])
            )
            there = -np.linalg.solve(mass, rest)[:, 0]  # accelerations and multipliers
            changes = -np.linalg.solve(mass, at(there.tolist(), [row[size:] for row in slopes]))[:n]
        except np.linalg.LinAlgError:
            changes = np.full((n, 2 * n + m), np.nan)
        A = np.vstack([np.eye(n, 2 * n, n), changes[:, : 2 * n]])
        B = np.vstack([np.zeros((n, m)), changes[:, 2 * n :]])
        if not (np.isfinite(A).all() and np.isfinite(B).all()):
            reject(
                "the linear equations have no finite values at this state.",
                where=self.name,
                remedy="Choose a state at which T, V and forces are smooth.",
            )
        return A, B

    def consistent(
        self,
        q0: ArrayLike,
        v0: ArrayLike,
        fixed: Iterable[Any] = (),
        parameters: Mapping[Any, Any] | None = None,
        t: float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the nearest state that satisfies the constraints.

        Parameters
        ----------
        q0, v0 : array_like, shape (n,)
            Approximate positions and velocities.
        fixed : sequence of coordinates or their names, optional
            Coordinates whose positions and velocities do not change. The default is none.
        parameters : mapping, optional
            Values of parameters by symbol or name. The default is the system's own values.
        t : float, default 0.0
            The time, if velocity constraints depend on it.

        Returns
        -------
        q0, v0 : ndarray, shape (n,)
            A state with phi(q) = 0, dphi/dq.v = 0 and A v = b up to round-off. It is a local
            minimum of the distance to the state that you pass, in the norm of M(q0).

        Raises
        ------
        InputError
            If there is no such state nearby, or an argument is invalid.

        Examples
        --------
        >>> import symsimpson as ss
        >>> x, y = ss.coordinates("x y")
        >>> rod = ss.MechanicalSystem(
        ...     "rod", coordinates=(x, y), kinetic=(x.diff()**2 + y.diff()**2)/2, potential=y,
        ...     constraints={"length": x**2 + y**2 - 1})
        >>> q, v = rod.consistent([0.6, -0.7], [1.0, 0.0], fixed=["x"])
        >>> q.round(12).tolist(), v.round(12).tolist()
        ([0.6, -0.8], [1.0, 0.75])
        """
        return consistent(self, q0, v0, fixed, parameters, t)

    def __repr__(self) -> str:
        names = ", ".join(q.func.__name__ for q in self.coordinates)
        return f"MechanicalSystem({self.name!r}, coordinates=({names}))"

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name not in INNER]

    def _repr_latex_(self) -> str:
        try:
            if not self.too_large_for_sympy:
                return _equations(self)
        except RecursionError:
            pass
        text = rf"{in_text(self.name)}: {self.n} coordinates, T and V too long to be shown"
        return rf"$\text{{{text}}}$"
