"""A mechanical system as y' = f(y), written down from its energies in the textbook way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import sympy as sp

from symsimpson.mechanics.plain import Plain
from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["FirstOrder", "canonical", "reduced_top", "second_order"]

Definition = tuple[sp.Symbol, sp.Expr]


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

        Parameters
        ----------
        modules : {"math", "mpmath", "jax"}
            The functions that it calls.
        """
        made: Callable[..., Any] = sp.lambdify(
            [*self.unknowns, *self.parameters], list(self.rates), modules,
            cse=lambda expressions: (list(self.definitions), expressions),
        )  # fmt: skip
        return made

    def values(self, given: Mapping[Any, Any] | None) -> list[Any]:
        """Merge parameter values, by name, into the defaults."""
        found = dict(zip(self.names, self.parameters.values(), strict=True))
        for key, value in (given or {}).items():
            if str(key) not in found:
                raise ValueError(
                    f"{self.name} has no parameter {str(key)!r}. It has {', '.join(found)}."
                )
            found[str(key)] = value
        return list(found.values())


def canonical(system: MechanicalSystem) -> FirstOrder:
    """Write Hamilton's equations in (q, p).

    q' = v with M v = p - a, and p' = dL/dq at (q, v).
    """
    plain = system.plain
    p = _symbols("p", len(plain.q))
    momenta = [x - a for x, a in zip(p, plain.gyroscopic, strict=True)]
    definitions, v = _solve(plain.mass, momenta, "v")
    forces = [force.xreplace(dict(zip(plain.v, v, strict=True))) for force in _forces(plain)]
    return _system(system, "canonical", (*plain.q, *p), definitions, (*v, *forces))


def second_order(system: MechanicalSystem) -> FirstOrder:
    """Write the Euler-Lagrange equations in (q, v): M v' = dL/dq - (d p/d q) v."""
    plain = system.plain
    momenta = plain.mass * sp.Matrix(plain.v) + sp.Matrix(plain.gyroscopic)
    moving = momenta.jacobian(plain.q) * sp.Matrix(plain.v)
    right = [force - move for force, move in zip(_forces(plain), moving, strict=True)]
    definitions, a = _solve(plain.mass, right, "a")
    return _system(system, "second order", (*plain.q, *plain.v), definitions, (*plain.v, *a))


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
        "reduced_top", (phi, theta, xi), ((turn, precession),), (turn, xi, bend),
        dict(zip(symbols, values, strict=True)), ("p_phi", "p_psi", "I", "A"),
    )  # fmt: skip


def _system(
    system: MechanicalSystem,
    form: str,
    unknowns: tuple[sp.Symbol, ...],
    definitions: tuple[Definition, ...],
    rates: tuple[sp.Expr, ...],
) -> FirstOrder:
    values = dict(zip(system.plain.parameters, system.parameters.values(), strict=True))
    names = tuple(str(symbol) for symbol in system.parameters)
    return FirstOrder(f"{system.name}, {form}", unknowns, definitions, rates, values, names)


def _forces(plain: Plain) -> list[sp.Expr]:
    """Give dL/dq."""
    v = sp.Matrix(plain.v)
    kinetic = (v.T * plain.mass * v)[0] / 2 + sp.Matrix(plain.gyroscopic).dot(v)
    lagrangian = sp.expand(kinetic) - plain.potential
    return [lagrangian.diff(x) for x in plain.q]


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


def _symbols(name: str, count: int) -> tuple[sp.Symbol, ...]:
    return tuple(sp.Symbol(f"{name}_{i}", real=True) for i in range(count))
