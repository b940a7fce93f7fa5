"""A mechanical system as y' = f(y), written down from its energies in the textbook way."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from symsimpson.declare.constraints import accelerations
from symsimpson.declare.plain import Plain
from symsimpson.declare.system import MechanicalSystem
from symsimpson.graph.lines import Program
from symsimpson.graph.nodes import UNIT, ZERO, Value
from symsimpson.graph.read import line_written, number
from symsimpson.graph.share import share
from symsimpson.support.literals import float_literals

Definition = tuple[sp.Symbol, sp.Expr]
Key = tuple[Hashable, ...]


@dataclass(frozen=True)
class FirstOrder:
    """Ordinary differential equations y' = f(y).

    Attributes
    ----------
    name : str
    unknowns : tuple of sympy symbols
        The components of y.
    definitions : tuple of (symbol, expression)
        Values that the rates use, each made of those before it.
    rates : tuple of sympy expressions
        f, in unknowns, parameters and definitions.
    parameters : mapping from sympy symbol to float
        With the values used unless others are given.
    names : tuple of str
        The parameters' names, in the same order.
    """

    name: str
    unknowns: tuple[sp.Symbol, ...]
    definitions: tuple[Definition, ...]
    rates: tuple[sp.Expr, ...]
    parameters: Mapping[sp.Symbol, float]
    names: tuple[str, ...]

    def function(self, modules: str) -> Callable[..., Any]:
        """Make f as a Python function of the unknowns and the parameters, one argument each.

        The functions that it calls are those of ``modules``: "math", "mpmath" or "jax".
        """
        arguments = [*self.unknowns, *self.parameters]
        return line_function(arguments, self.definitions, self.rates, modules)

    def state(self, *parts: Any) -> list[Any]:
        """Join the parts of a state at t = 0; where t is an unknown, it stands last."""
        joined = [x for part in parts for x in part]
        return joined + [0 * joined[0]] * (len(self.unknowns) - len(joined))

    def values(self, given: Mapping[Any, Any] | None) -> list[Any]:
        """Merge parameter values, by name, into the defaults."""
        values = dict(zip(self.names, self.parameters.values(), strict=True))
        for key, value in (given or {}).items():
            if str(key) not in values:
                raise ValueError(
                    f"{self.name} has no parameter {str(key)!r}. It has {', '.join(values)}."
                )
            values[str(key)] = value
        return list(values.values())


def canonical(system: MechanicalSystem) -> FirstOrder:
    """Write Hamilton's equations in (q, p).

    q' = v with M v = p - a, and p' = dL/dq + f at (t, q, v). Where something depends on t, it is
    the last unknown, of the rate 1. With constraints M v + Phi^T nu = p - a and Phi v = 0, A v = b
    where they are those of velocities, and p' = dL/dq + f - Phi^T lambda.
    """
    plain = system.plain
    n = len(plain.q)
    p = sp.symbols(f"p_:{n}", real=True)
    outputs = _mass_and_a(plain) | {("F", i): f for i, f in enumerate(plain.right_sides)}
    held = len(plain.held)
    if held:
        outputs |= _accelerating(plain)
    lines = Lines(plain, outputs)
    momenta = [x - lines.value("a", i) for i, x in enumerate(p)]
    carried = [lines.value("b", c) for c in range(held)]
    solution, unknowns = _solve(lines.held_mass(), [*momenta, *carried], "v")
    v = unknowns[:n]
    known = dict(zip(plain.v, v, strict=True))
    rates = [lines.value("F", i).xreplace(known) for i in range(n)]
    later = [(name, value.xreplace(known)) for name, value in lines.later]
    definitions = (*lines.early, *solution, *later)
    if held:
        right = [value.xreplace(known) for value in lines.right()]
        solution, unknowns = _solve(lines.held_mass(), right, "a")
        definitions = (*definitions, *solution)
        rates = [
            rate - sp.Add(*(lines.value("Phi", c, i) * unknowns[n + c] for c in range(held)))
            for i, rate in enumerate(rates)
        ]
    return _system(system, "canonical", (*plain.q, *p), definitions, (*v, *rates))


def second_order(system: MechanicalSystem) -> FirstOrder:
    """Write the Euler-Lagrange equations in (q, v): M v' = dL/dq + f - (d p/d q) v - d p/d t.

    Where something depends on t, it is the last unknown, of the rate 1.
    """
    plain = system.plain
    lines = Lines(plain, {**_mass_and_a(plain), **_accelerating(plain)})
    solution, unknowns = _solve(lines.held_mass(), lines.right(), "a")
    definitions = (*lines.early, *lines.later, *solution)
    rates = (*plain.v, *unknowns[: system.n])
    return _system(system, "second order", (*plain.q, *plain.v), definitions, rates)


def reduced_top(p_phi: Any, p_psi: Any, *, inertia: float = 1.0, A: Any = None) -> FirstOrder:
    """Write the nutation and precession of a Lagrange top whose momenta are known.

    y = (phi, theta, xi) with theta' = xi, xi' = (A + phi'^2 cos theta - p_psi phi'/I) sin theta
    and phi' = (p_phi - p_psi cos theta)/(I sin^2 theta); A = m g l/I, (2 pi)^2 unless given.
    """
    phi, theta, xi = sp.symbols("phi theta xi", real=True)
    symbols = sp.symbols("p_phi p_psi I A", real=True)
    first, second, moment, square = symbols
    turn = sp.Symbol("turn", real=True)
    precession = (first - second * sp.cos(theta)) / (moment * sp.sin(theta) ** 2)
    bend = (square + turn**2 * sp.cos(theta) - second / moment * turn) * sp.sin(theta)
    values = (p_phi, p_psi, inertia, float(4 * sp.pi**2) if A is None else A)
    return FirstOrder(
        "reduced_top",
        (phi, theta, xi),
        ((turn, precession),),
        (turn, xi, bend),
        dict(zip(symbols, values, strict=True)),
        ("p_phi", "p_psi", "I", "A"),
    )


def _system(
    system: MechanicalSystem,
    form: str,
    unknowns: tuple[sp.Symbol, ...],
    definitions: Sequence[Definition],
    rates: Sequence[sp.Expr],
) -> FirstOrder:
    values = dict(zip(system.plain.parameters, system.parameters.values(), strict=True))
    values |= dict.fromkeys(system.plain.u, 0.0)  # inputs are constants here
    names = tuple(map(str, (*system.parameters, *system.inputs)))
    if not system.plain.autonomous:
        unknowns, rates = (*unknowns, system.plain.t), (*rates, sp.S.One)
    return FirstOrder(
        f"{system.name}, {form}", unknowns, tuple(definitions), tuple(rates), values, names
    )


def line_function(
    arguments: Sequence[sp.Symbol],
    definitions: Sequence[Definition],
    results: Sequence[sp.Expr],
    modules: str,
) -> Callable[..., Any]:
    """Return a function of numbers for results that are made of definitions."""
    if modules != "mpmath":  # whole numbers are exact there, however large
        results = float_literals(list(results))
        definitions = [(name, float_literals(value)) for name, value in definitions]
    function: Callable[..., Any] = sp.lambdify(
        list(arguments),
        list(results),
        modules,
        cse=lambda expressions: (list(definitions), expressions),
    )
    return function


class Lines:
    """Outputs as definitions, a line each: those of q alone, and those of v behind them."""

    def __init__(self, plain: Plain, outputs: Mapping[Key, Value]) -> None:
        level = plain.level(plain.graph)
        program = share(Program.of(plain.graph, outputs, level))
        self._plain, self._keys, self._outputs = plain, list(outputs), program.outputs
        self._n, self._held = len(plain.q), len(plain.held)
        self.early: list[Definition] = []
        self.later: list[Definition] = []
        symbols = plain.symbols
        self._done: dict[int, sp.Expr] = dict(zip(plain.numbers(symbols), symbols, strict=True))
        self._done[UNIT] = sp.S.One
        for n in program.order():
            if n not in self._done:
                line = program.lines[n]
                name = sp.Symbol(f"x_{n}", real=True)
                value = line_written(line.kind, line.parts, self._done)
                (self.later if line.level > 1 else self.early).append((name, value))
                self._done[n] = name

    def value(self, *key: Hashable) -> sp.Expr:
        """Return an output."""
        coefficient, n = self._outputs.get(key, ZERO)
        return number(coefficient) * self._done[n] if coefficient else sp.S.Zero

    def function(self, state: Sequence[sp.Symbol], modules: str) -> Callable[..., Any]:
        """Return a function of a state, parameters, inputs and t for all outputs in their order."""
        arguments = [*state, *self._plain.parameters, *self._plain.u, self._plain.t]
        results = [self.value(*key) for key in self._keys]
        return line_function(arguments, [*self.early, *self.later], results, modules)

    def held_mass(self) -> sp.ImmutableDenseMatrix:
        """Return M, bordered by Phi where there are constraints."""
        n, size = self._n, self._n + self._held

        def entry(i: int, j: int) -> sp.Expr:
            low, high = min(i, j), max(i, j)
            if high < n:
                return self.value("M", high, low)
            return self.value("Phi", high - n, low) if low < n else sp.S.Zero

        return sp.ImmutableDenseMatrix(size, size, entry)

    def right(self) -> list[sp.Expr]:
        """Return M v' + Phi^T lambda, then Phi v'."""
        pushes = [self.value("push", i) for i in range(self._n)]
        return [*pushes, *(-self.value("curve", c) for c in range(self._held))]


def _mass_and_a(plain: Plain) -> dict[Key, Value]:
    outputs: dict[Key, Value] = {("M", i, j): value for (i, j), value in plain.M.items()}
    return outputs | {("a", i): value for i, value in enumerate(plain.a)}


def _accelerating(plain: Plain) -> dict[Key, Value]:
    """Return what determines accelerations, and Phi."""
    places = plain.numbers(plain.q), plain.numbers(plain.v), plain.time
    graph, held = plain.graph, plain.held_rows(plain.graph)
    slopes, push, curve, _ = accelerations(graph, plain.L, held, plain.f, places)
    outputs: dict[Key, Value] = {
        ("Phi", c, i): x for c, row in enumerate(slopes) for i, x in enumerate(row)
    }
    outputs |= {("push", i): value for i, value in enumerate(push)}
    outputs |= {("b", c): row[-1] for c, row in enumerate(held.rows, len(held.phi))}
    return outputs | {("curve", c): value for c, value in enumerate(curve)}


def _solve(
    matrix: sp.ImmutableDenseMatrix, right: list[sp.Expr], name: str
) -> tuple[tuple[Definition, ...], tuple[sp.Symbol, ...]]:
    """Solve by L D L^T, every entry under a name of its own."""
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
