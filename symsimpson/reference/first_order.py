"""First-order differential equations y' = f(y) of a mechanical system, as in textbooks."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from symsimpson.declare.constraints import accelerations
from symsimpson.declare.plain import Plain
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import ModelError, reject
from symsimpson.graph.lines import StraightLineCode
from symsimpson.graph.nodes import UNIT, ZERO, Value
from symsimpson.graph.read import line_to_sympy, number
from symsimpson.graph.share import share
from symsimpson.support.literals import float_literals

Definition = tuple[sp.Symbol, sp.Expr]
Key = tuple[Hashable, ...]


@dataclass(frozen=True)
class FirstOrder:
    """Ordinary differential equations y' = f(y).

    :func:`canonical`, :func:`second_order` and :func:`reduced_top` return it.

    Attributes
    ----------
    name : str
        The name of the system and of its form.
    unknowns : tuple of sympy symbols, length m
        The components of y.
    definitions : tuple of (symbol, expression)
        Intermediate values. Each may contain unknowns, parameters and earlier definitions.
    rates : tuple of sympy expressions, length m
        The components of f. They may contain unknowns, parameters and definitions.
    parameters : mapping from sympy symbol to float
        The parameters with their default values.
    names : tuple of str
        The names of the parameters, in the same order.

    Examples
    --------
    >>> import symsimpson as ss
    >>> from symsimpson.reference import canonical
    >>> equations = canonical(ss.systems.harmonic_oscillator())
    >>> f = equations.function("math")
    >>> [float(x) for x in f(2.0, 3.0, *equations.parameters.values())]
    [3.0, -2.0]
    """

    name: str
    unknowns: tuple[sp.Symbol, ...]
    definitions: tuple[Definition, ...]
    rates: tuple[sp.Expr, ...]
    parameters: Mapping[sp.Symbol, float]
    names: tuple[str, ...]

    def function(self, modules: str) -> Callable[..., Any]:
        """Return f as a Python function of the unknowns and the parameters.

        Each unknown and each parameter is one positional argument. The result is a list of length
        m.

        Parameters
        ----------
        modules : {"math", "mpmath", "jax"}
            The library whose functions f calls.
        """
        arguments = [*self.unknowns, *self.parameters]
        return lambdify_definitions(arguments, self.definitions, self.rates, modules)

    def state(self, *parts: Any) -> list[Any]:
        """Join q and p, or q and v, to a state y at t = 0; append the time if y contains it."""
        joined = [x for part in parts for x in part]
        return joined + [0 * joined[0]] * (len(self.unknowns) - len(joined))

    def values(self, parameters: Mapping[Any, Any] | None) -> list[Any]:
        """Return the values of all parameters: ``parameters`` by name, and defaults otherwise."""
        values = dict(zip(self.names, self.parameters.values(), strict=True))
        for key, value in (parameters or {}).items():
            if str(key) not in values:
                raise ValueError(
                    f"{self.name} has no parameter {str(key)!r}. It has {', '.join(values)}."
                )
            values[str(key)] = value
        return list(values.values())


def canonical(system: MechanicalSystem) -> FirstOrder:
    """Return Hamilton's equations of a system in (q, p).

    They are q' = v with M v = p - a, and p' = dL/dq + f at (t, q, v). With constraints they are
    M v + Phi^T nu = p - a, Phi v = 0, and p' = dL/dq + f - Phi^T lambda. A velocity constraint
    replaces Phi v = 0 by A v = b. If L or f depends on t, the last unknown is t with the rate 1.

    Parameters
    ----------
    system : MechanicalSystem
        The system. Its inputs become parameters with the default 0.

    Returns
    -------
    FirstOrder
        The equations of the 2 n unknowns (q, p), or of the 2 n + 1 unknowns (q, p, t).
    """
    plain = system.plain
    n = len(plain.q)
    if plain.hamiltonian is not None:
        values = [*plain.velocities, *plain.right_sides]
        lines = SystemOutputs(plain, {("rate", i): rate for i, rate in enumerate(values)})
        definitions = (*lines.of_positions, *lines.of_velocities)
        rates = [lines.value("rate", i) for i in range(2 * n)]
        return _first_order(system, "canonical", (*plain.q, *plain.v), definitions, rates)
    if not plain.quadratic:
        reject(
            "its momenta are not linear in the velocities, so H has no closed form.",
            where=f"system '{system.name}'",
            remedy="Use symsimpson.reference.second_order.",
            error=ModelError,
        )
    p = sp.symbols(f"p_:{n}", real=True)
    outputs = _momentum_outputs(plain) | {("F", i): f for i, f in enumerate(plain.right_sides)}
    m = len(plain.constraint_names)
    if m:
        outputs |= _acceleration_outputs(plain)
    lines = SystemOutputs(plain, outputs)
    momenta = [x - lines.value("a", i) for i, x in enumerate(p)]
    b = [lines.value("b", c) for c in range(m)]
    solution, unknowns = _solve_symmetric(lines.bordered_mass(), [*momenta, *b], "v")
    v = unknowns[:n]
    velocities = dict(zip(plain.v, v, strict=True))
    rates = [lines.value("F", i).xreplace(velocities) for i in range(n)]
    of_velocities = [(name, value.xreplace(velocities)) for name, value in lines.of_velocities]
    definitions = (*lines.of_positions, *solution, *of_velocities)
    if m:
        right = [value.xreplace(velocities) for value in lines.right_sides()]
        solution, unknowns = _solve_symmetric(lines.bordered_mass(), right, "a")
        definitions = (*definitions, *solution)
        rates = [
            rate - sp.Add(*(lines.value("Phi", c, i) * unknowns[n + c] for c in range(m)))
            for i, rate in enumerate(rates)
        ]
    return _first_order(system, "canonical", (*plain.q, *p), definitions, (*v, *rates))


def second_order(system: MechanicalSystem) -> FirstOrder:
    """Return the Euler-Lagrange equations of a system in (q, v).

    They are q' = v and M v' = dL/dq + f - (dp/dq) v - dp/dt. With constraints, -Phi^T lambda is
    added, and lambda satisfies the second derivative of the constraints. If L or f depends on t,
    the last unknown is t with the rate 1.

    Parameters
    ----------
    system : MechanicalSystem
        The system. Its inputs become parameters with the default 0.

    Returns
    -------
    FirstOrder
        The equations of the 2 n unknowns (q, v), or of the 2 n + 1 unknowns (q, v, t).
    """
    plain = system.plain
    if plain.hamiltonian is not None:
        reject(
            "it is declared by its Hamiltonian.",
            where=f"system '{system.name}'",
            remedy="Use symsimpson.reference.canonical.",
            error=ModelError,
        )
    lines = SystemOutputs(plain, {**_momentum_outputs(plain), **_acceleration_outputs(plain)})
    solution, unknowns = _solve_symmetric(lines.bordered_mass(), lines.right_sides(), "a")
    definitions = (*lines.of_positions, *lines.of_velocities, *solution)
    rates = (*plain.v, *unknowns[: system.n])
    return _first_order(system, "second order", (*plain.q, *plain.v), definitions, rates)


def reduced_top(p_phi: Any, p_psi: Any, *, inertia: float = 1.0, A: Any = None) -> FirstOrder:
    """Return the equations of the nutation and precession of a Lagrange top with known momenta.

    The unknowns are y = (phi, theta, xi). The equations are
    phi' = (p_phi - p_psi cos theta)/(I sin^2 theta), theta' = xi and
    xi' = (A + phi'^2 cos theta - p_psi phi'/I) sin theta.

    Parameters
    ----------
    p_phi, p_psi : number
        The constant momenta, in kg m^2/s.
    inertia : float, default 1.0
        The moment of inertia I about an axis through the tip perpendicular to the symmetry axis, in
        kg m^2.
    A : number, optional
        The constant m g l/I, in 1/s^2. The default is (2 pi)^2.

    Returns
    -------
    FirstOrder
        The equations of three unknowns.
    """
    phi, theta, xi = sp.symbols("phi theta xi", real=True)
    symbols = sp.symbols("p_phi p_psi I A", real=True)
    P_phi, P_psi, moment, constant = symbols
    turn = sp.Symbol("turn", real=True)
    precession = (P_phi - P_psi * sp.cos(theta)) / (moment * sp.sin(theta) ** 2)
    acceleration = (constant + turn**2 * sp.cos(theta) - P_psi / moment * turn) * sp.sin(theta)
    values = (p_phi, p_psi, inertia, float(4 * sp.pi**2) if A is None else A)
    return FirstOrder(
        "reduced_top",
        (phi, theta, xi),
        ((turn, precession),),
        (turn, xi, acceleration),
        dict(zip(symbols, values, strict=True)),
        ("p_phi", "p_psi", "I", "A"),
    )


def _first_order(
    system: MechanicalSystem,
    form: str,
    unknowns: tuple[sp.Symbol, ...],
    definitions: Sequence[Definition],
    rates: Sequence[sp.Expr],
) -> FirstOrder:
    """Return the equations with the parameters of a system, and with t' = 1 if they depend on t."""
    values = dict(zip(system.plain.parameters, system.parameters.values(), strict=True))
    values |= dict.fromkeys(system.plain.u, 0.0)  # inputs become constant parameters
    names = tuple(map(str, (*system.parameters, *system.inputs)))
    if not system.plain.autonomous:
        unknowns, rates = (*unknowns, system.plain.t), (*rates, sp.S.One)
    return FirstOrder(
        f"{system.name}, {form}", unknowns, tuple(definitions), tuple(rates), values, names
    )


def lambdify_definitions(
    arguments: Sequence[sp.Symbol],
    definitions: Sequence[Definition],
    results: Sequence[sp.Expr],
    modules: str,
) -> Callable[..., Any]:
    """Return a Python function of ``arguments`` that evaluates definitions and then results."""
    if modules != "mpmath":  # mpmath evaluates integers of any size exactly
        results = float_literals(list(results))
        definitions = [(name, float_literals(value)) for name, value in definitions]
    function: Callable[..., Any] = sp.lambdify(
        list(arguments),
        list(results),
        modules,
        cse=lambda expressions: (list(definitions), expressions),
    )
    return function


class SystemOutputs:
    """Outputs of a system as SymPy definitions with shared subexpressions.

    ``of_positions`` are the definitions that depend on q, t and parameters only. ``of_velocities``
    are those that also depend on v, and may contain the others.
    """

    def __init__(self, plain: Plain, outputs: Mapping[Key, Value]) -> None:
        level = plain.level(plain.graph)
        program = share(StraightLineCode.of(plain.graph, outputs, level))
        self._plain, self._keys, self._outputs = plain, list(outputs), program.outputs
        self._n, self._m = len(plain.q), len(plain.constraint_names)
        self.of_positions: list[Definition] = []
        self.of_velocities: list[Definition] = []
        symbols = plain.symbols
        #: The expression of each node: a symbol, or the name of its definition.
        self._nodes: dict[int, sp.Expr] = dict(zip(plain.numbers(symbols), symbols, strict=True))
        self._nodes[UNIT] = sp.S.One
        for n in program.order():
            if n not in self._nodes:
                line = program.lines[n]
                name = sp.Symbol(f"x_{n}", real=True)
                value = line_to_sympy(line.kind, line.parts, self._nodes)
                definitions = self.of_velocities if line.level > 1 else self.of_positions
                definitions.append((name, value))
                self._nodes[n] = name

    def value(self, *key: Hashable) -> sp.Expr:
        """Return an output in terms of the definitions; 0 if there is no output with this key."""
        coefficient, n = self._outputs.get(key, ZERO)
        return number(coefficient) * self._nodes[n] if coefficient else sp.S.Zero

    def function(self, state: Sequence[sp.Symbol], modules: str) -> Callable[..., Any]:
        """Return a function of state, parameters, inputs and t for all outputs, in their order."""
        arguments = [*state, *self._plain.parameters, *self._plain.u, self._plain.t]
        results = [self.value(*key) for key in self._keys]
        definitions = [*self.of_positions, *self.of_velocities]
        return lambdify_definitions(arguments, definitions, results, modules)

    def bordered_mass(self) -> sp.ImmutableDenseMatrix:
        """Return [[M, Phi^T], [Phi, 0]], shape (n + m, n + m); M without constraints."""
        n, size = self._n, self._n + self._m

        def entry(i: int, j: int) -> sp.Expr:
            low, high = min(i, j), max(i, j)
            if high < n:
                return self.value("M", high, low)
            return self.value("Phi", high - n, low) if low < n else sp.S.Zero

        return sp.ImmutableDenseMatrix(size, size, entry)

    def right_sides(self) -> list[sp.Expr]:
        """Return the values of M v' + Phi^T lambda and of Phi v', length n + m."""
        forces = [self.value("force", i) for i in range(self._n)]
        return [*forces, *(-self.value("curvature", c) for c in range(self._m))]


def _momentum_outputs(plain: Plain) -> dict[Key, Value]:
    """Return the entries of M and a in p = M v + a."""
    outputs: dict[Key, Value] = {("M", i, j): value for (i, j), value in plain.M.items()}
    return outputs | {("a", i): value for i, value in enumerate(plain.a)}


def _acceleration_outputs(plain: Plain) -> dict[Key, Value]:
    """Return the right-hand sides of the equations for v' and lambda, and the entries of Phi."""
    places = plain.numbers(plain.q), plain.numbers(plain.v), plain.time
    graph, constraints = plain.graph, plain.write_constraints(plain.graph)
    slopes, forces, curvatures, _ = accelerations(graph, plain.L, constraints, plain.f, places)
    outputs: dict[Key, Value] = {
        ("Phi", c, i): x for c, row in enumerate(slopes) for i, x in enumerate(row)
    }
    outputs |= {("force", i): value for i, value in enumerate(forces)}
    outputs |= {("b", c): b for c, b in enumerate(constraints.sides(graph, plain.time))}
    return outputs | {("curvature", c): value for c, value in enumerate(curvatures)}


def _solve_symmetric(
    matrix: sp.ImmutableDenseMatrix, right: list[sp.Expr], name: str
) -> tuple[tuple[Definition, ...], tuple[sp.Symbol, ...]]:
    """Solve a symmetric linear system by L D L^T; return definitions, and the unknowns' symbols.

    Each nonzero entry of L, D and of the solution is a definition.
    """
    n = matrix.rows
    definitions: list[Definition] = []

    def define(what: str, value: sp.Expr) -> sp.Symbol:
        symbol = sp.Symbol(f"{what}_of_{name}", real=True)
        definitions.append((symbol, value))
        return symbol

    L = sp.zeros(n, n)
    D: list[sp.Symbol] = []
    y: list[sp.Symbol] = []
    for i in range(n):
        for j in range(i):
            rest = matrix[i, j] - sp.Add(*(L[i, k] * L[j, k] * D[k] for k in range(j)))
            if rest != 0:
                L[i, j] = define(f"L_{i}_{j}", rest / D[j])
        pivot = matrix[i, i] - sp.Add(*(L[i, k] ** 2 * D[k] for k in range(i)))
        D.append(define(f"D_{i}", pivot))
        y.append(define(f"y_{i}", right[i] - sp.Add(*(L[i, k] * y[k] for k in range(i)))))
    x: list[sp.Symbol] = []
    for i in reversed(range(n)):
        known = sp.Add(*(L[k, i] * x[n - 1 - k] for k in range(i + 1, n)))
        x.append(define(f"{name}_{i}", y[i] / D[i] - known))
    return tuple(definitions), tuple(reversed(x))
