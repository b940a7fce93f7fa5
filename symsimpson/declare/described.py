"""Consequences of a declaration: Lagrangian, equations of motion, their linear form, LaTeX."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

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
from symsimpson.graph.evaluate import doubles
from symsimpson.graph.nodes import Value, scaled
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explaining
from symsimpson.support.markup import aligned, in_text

#: How far a state may be from one that satisfies the constraints, relative to it.
NEAR = 1e-6
#: Names that SymPy may typeset as they are: letters of any alphabet, or a Greek one by its LaTeX
#: name, with a subscript and primes behind it.
PLAIN = re.compile(r"([^\W\d_]\w*|\\(?P<macro>[A-Za-z]+)(_\w+)?)(_\{\w+\})?'*")
#: Commands of LaTeX that are letters.
LETTERS = greek_letters_set | other_symbols
#: Equations of motion are shown for so many coordinates, with so many operations.
SHOWN, MOST_OPERATIONS = 4, 300
#: What the rest of the package asks a system for, and users do not.
INNER = frozenset({"digest", "large", "mass_checked", "plain", "retimer", "retiming", "seconds"})


def terms(system: Declared, multipliers: list[sp.Symbol]) -> list[tuple[sp.Expr, sp.Expr, sp.Expr]]:
    """Return dL/dv, dL/dq and what else pulls, for each coordinate."""
    back = dict(Symbols(system.coordinates, system.parameters, system.inputs).back)
    lagrangian = system.lagrangian
    m = len(system.constraints)
    phis = zip(multipliers[:m], system.constraints.values(), strict=True)
    held = sum((multiplier * phi for multiplier, phi in phis), sp.S.Zero)
    rates = zip(multipliers[m:], system.velocity_constraints.values(), strict=True)
    rolling = sum((multiplier * rate for multiplier, rate in rates), sp.S.Zero)
    return [
        (
            sp.diff(lagrangian, q.diff(time)),
            sp.diff(lagrangian, q),
            system.plain.written(force).xreplace(back)
            - sp.diff(held, q)
            - sp.diff(rolling, q.diff(time)),
        )
        for q, force in zip(system.coordinates, system.plain.f, strict=True)
    ]


def _residual(plain: Plain) -> tuple[list[Value], tuple[int, ...]]:
    """Write M a + W^T lambda - push and W a + curve, and tell the nodes of a and lambda."""
    graph, q, v = plain.graph, plain.numbers(plain.q), plain.numbers(plain.v)
    places = (q, v, plain.time)
    held = accelerations(graph, plain.L, plain.held_rows(graph), plain.f, places)
    a = graph.numbers(f"acceleration_{i}" for i in range(len(q)))
    pulls = graph.numbers(s.name for s in plain.multipliers)
    residual = []
    for i, push in enumerate(held.push):
        mass = graph.products([plain.entry(i, j) for j in range(len(q))], a)
        turned = graph.products([row[i] for row in held.rows], pulls)
        residual.append(graph.add([*mass, *turned, scaled(-1, push)]))
    # W v stays as it is, which determines the multipliers
    for row, curve in zip(held.rows, held.curve, strict=True):
        residual.append(graph.add([*graph.products(row, a), curve]))
    return residual, (*a, *pulls)


def _check_held(
    system: Declared, q: Floats, v: Floats, parameters: Mapping[Any, float] | None, t: float
) -> None:
    """Refuse a state that the constraints do not allow."""
    if not system.plain.held:
        return
    nearest = consistent(system, q, v, (), parameters, t)
    for name, given, near in zip(("q0", "v0"), (q, v), nearest, strict=True):
        if np.abs(near - given).max() > NEAR * np.abs(near).max():
            reject(
                f"{system.name}: {name} does not satisfy the constraints.",
                remedy="Take the nearest state that does: q0, v0 = system.consistent(q0, v0).",
            )


def _equations(declared: Declared) -> str:
    """Write T, V, M and, for few coordinates, the equations of motion in LaTeX."""
    from sympy.physics.vector import vlatex  # long to import

    safe = _safe(declared)
    kinetic, potential = (
        sp.sympify(x).xreplace(safe) for x in (declared.kinetic, declared.potential)
    )
    lines = [("T", kinetic), ("V", potential)]
    held = (*declared.constraints.values(), *declared.velocity_constraints.values())
    lines += [("0", sp.sympify(expression).xreplace(safe)) for expression in held]
    m = len(held)
    multipliers = [sp.Symbol(f"lambda_{k + 1}" if m > 1 else "lambda") for k in range(m)]
    if declared.n <= SHOWN:
        lines.append(("M", declared.mass_matrix.xreplace(safe)))
        equations = zip(declared.coordinates, terms(declared, multipliers), strict=True)
        for q, (moment, slope, pull) in equations:
            name, moment, force = (x.xreplace(safe) for x in (q, moment, slope + pull))
            if sp.count_ops([moment, force]) > MOST_OPERATIONS:
                break
            label = vlatex(name)
            lines.append((f"p_{{{label}}}", moment))
            lines.append((rf"\dot{{p}}_{{{label}}}", force))
    return aligned([(left, vlatex(right)) for left, right in lines])


def _safe(declared: Declared) -> dict[Any, Any]:
    """Map what is named oddly to plain symbols."""
    replace: dict[Any, Any] = {
        a: sp.Symbol(f"a_{i}") for i, a in enumerate(declared.parameters) if not _is_plain(a.name)
    }
    for i, q in enumerate(declared.coordinates):
        if not _is_plain(q.func.__name__):
            plain = sp.Function(f"q_{i}")(time)
            replace |= {q: plain, q.diff(time): plain.diff(time)}
    return replace


def _is_plain(name: str) -> bool:
    """Return whether a name is typeset as it is: of LaTeX's commands, letters alone."""
    match = PLAIN.fullmatch(name)
    macro = match and match["macro"]
    return match is not None and (macro is None or macro.removeprefix("var").lower() in LETTERS)


@explaining(ModelError)
class Described(Declared):
    """Properties that follow from the declaration of a system, in the user's own symbols."""

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates, less that of constraints of positions."""
        return self.n - len(self.constraints)

    @property
    def velocity_degrees_of_freedom(self) -> int:
        """Number of coordinates, less that of all constraints: velocities that are free."""
        return self.degrees_of_freedom - len(self.velocity_constraints)

    @cached_property
    def equations(self) -> tuple[sp.Eq, ...]:
        """The Euler-Lagrange equations d/dt dL/dv - dL/dq = f, one for each coordinate, in SymPy.

        Of a system with constraints, with -Phi^T lambda on the right, and phi = 0 after them; of
        those of velocities, with -A^T lambda, and A v - b = 0.

        Raises
        ------
        ModelError
            If T and V are too long for expressions of SymPy.

        Examples
        --------
        >>> import symsimpson as ss
        >>> ss.systems.henon_heiles().equations[0]
        Eq(2*x(t)*y(t) + x(t) + Derivative(x(t), (t, 2)), 0)
        """
        if self.too_large_for_sympy:
            reject(
                f"system {self.name!r}: T and V are too long for equations in SymPy.",
                remedy="Use stepper.residual and stepper.jacobian, which evaluate them as numbers.",
                error=ModelError,
            )
        multipliers = [sp.Symbol(f"lambda_{name}") for name in self.plain.held]
        written = [
            sp.Eq(sp.diff(moment, time) - force, pull)
            for moment, force, pull in terms(self, multipliers)
        ]
        held = (*self.constraints.values(), *self.velocity_constraints.values())
        return (*written, *(sp.Eq(expression, 0) for expression in held))

    def linearise(
        self,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        parameters: Mapping[Any, float] | None = None,
        inputs: Mapping[Any, float] | None = None,
        t: float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the linear equations of motion about a state, x' = A x + B u.

        Constraints hold on, so multipliers change with the state. The eigenvalues of A are those of
        the motion, and zeros: two for a constraint of positions, one for one of velocities.

        Parameters
        ----------
        q0, v0 : array_like, shape (n,)
            Positions and velocities; at rest unless v0 is given.
        parameters, inputs : mapping, optional
            Values; the system's own for parameters, 0 for inputs, unless given.
        t : float
            The time, where something depends on it.

        Returns
        -------
        A : ndarray, shape (2 n, 2 n)
            How the rates of (q, v) change with (q, v).
        B : ndarray, shape (2 n, m)
            How they change with the inputs.

        Raises
        ------
        InputError
            If the state makes no sense or does not satisfy the constraints, or nothing is
            smooth there.
        ModelError
            If the system is too large.

        Examples
        --------
        >>> import numpy as np
        >>> import symsimpson as ss
        >>> A, B = ss.systems.pendulum().linearise([0.0])
        >>> bool(abs(np.linalg.eigvals(A).imag).max() ** 2 == 9.81)
        True
        """
        n, m, plain = self.n, len(self.inputs), self.plain
        q = read_vector(self, "q0", q0)
        v = np.zeros(n) if v0 is None else read_vector(self, "v0", v0)
        values = read_values("parameters", "parameter", self.parameters, parameters)
        given = read_values("inputs", "input", dict.fromkeys(self.inputs, 0.0), inputs)
        _check_held(self, q, v, parameters, t)
        symbols = plain.numbers((*plain.q, *plain.v, *plain.parameters, *plain.u, plain.t))
        known = dict(zip(symbols, (*q.tolist(), *v.tolist(), *values, *given, t), strict=True))
        residual, unknowns = _residual(plain)
        moved = (*unknowns, *plain.numbers((*plain.q, *plain.v, *plain.u)))
        slopes = [gradient(plain.graph, row, moved) for row in residual]

        def at(there: Sequence[float], wanted: Sequence[Sequence[Value]]) -> Floats:
            point = known | dict(zip(unknowns, there, strict=True))
            flat = doubles(plain.graph, [value for row in wanted for value in row], point)
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
                f"{self.name}: the linear equations have no finite values there.",
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
        fixed : sequence of coordinates or their names, optional
            Those that stay as they are.
        parameters : mapping, optional
            Values other than the defaults.
        t : float
            The time, where velocity constraints depend on it.

        Returns
        -------
        q0, v0 : ndarray, shape (n,)
            They satisfy phi(q) = 0, dphi/dq.v = 0 and A v = b to rounding. No state near
            them is nearer to the given ones, in the norm of M(q0).

        Raises
        ------
        InputError
            If there is no such state nearby, or the arguments make no sense.

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
