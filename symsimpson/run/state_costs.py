"""Costs of states: values and derivatives of an expression at many states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.evaluation import evaluate
from symsimpson.program.input_values import read_array
from symsimpson.program.numbers import Numbers, workspace
from symsimpson.program.observed import read_expression
from symsimpson.program.program import Program
from symsimpson.stepping.inputs import STEP
from symsimpson.support.array_types import Reals
from symsimpson.text.quantity import OBSERVABLE


@dataclass(frozen=True)
class CostDerivatives:
    """Values of a quantity at M states, and its derivatives."""

    value: Reals  #: Values, shape (M,).
    state: Reals  #: Derivatives by q and p, shape (M, 2 n).
    parameters: Reals  #: Derivatives by the k variables at fixed q and p, shape (M, k).

    def times(self, factors: Reals) -> CostDerivatives:
        """Apply the chain rule: ``factors`` are the derivatives of a cost by the quantity."""
        weights = factors[:, None]
        return CostDerivatives(self.value, weights * self.state, weights * self.parameters)


class _SymbolicCost:
    """A SymPy expression of a state, and a function that evaluates it with its derivatives."""

    def __init__(self, text: str, n: int, parameters: int, numbers: Numbers) -> None:
        import sympy as sp  # slow to import, and needed for gradients only

        names = [f"{x}_{i}" for x in "qpv" for i in range(n)]
        names += [f"a_{j}" for j in range(parameters)] + ["t"]
        symbols = {name: sp.Symbol(name, real=True) for name in names}
        functions = {"abs": sp.Abs, "min": sp.Min, "max": sp.Max}
        computed = {scalar.symbol: sp.Symbol(scalar.symbol) for scalar in OBSERVABLE}
        # safe: the reader of expressions wrote this text from a list of allowed operations
        self._expression = sp.sympify(text, locals=symbols | functions | computed, rational=True)
        self.computed = self._expression.has(*computed.values())
        self.moving = self._expression.has(*(symbols[f"v_{i}"] for i in range(n)))
        self._symbols, self._numbers = list(symbols.values()), numbers

    @cached_property
    def evaluate(self) -> Callable[..., list[Reals]]:
        """Function of arrays that returns the value and the derivatives by all symbols."""
        import sympy as sp

        class Whole(sp.Function):
            """The floor function, with derivative 0."""

            def fdiff(self, argindex: int = 1) -> Any:
                return sp.S.Zero

        value = self._expression.replace(sp.Mod, lambda a, b: a - b * Whole(a / b))
        every = [value, *(sp.diff(value, symbol) for symbol in self._symbols)]
        whole = [expression.replace(Whole, sp.floor) for expression in every]
        function: Callable[..., list[Reals]] = self._numbers.lambdified(self._symbols, whole)
        return function


#: An optimiser uses the same expression many times.
_symbolic_cost = lru_cache(maxsize=64)(_SymbolicCost)


class StateCost:
    """A quantity of a state: an expression in q, p, v, parameters and t.

    The program must have derivatives of its steps. ``what`` names the quantity in messages. Raises
    InputError if the expression contains anything else.
    """

    def __init__(self, program: Program, what: str, expression: Any) -> None:
        self.program = program
        text = read_expression(program, expression).text
        self._symbolic = _symbolic_cost(text, program.n, len(program.parameters), program.numbers)
        if self._symbolic.computed:
            reject(
                f"{what} contains the energy or a part of it.",
                why="Derivatives of the energy are not available here.",
                remedy="Write the expression with coordinates, velocities and parameters.",
            )
        if self._symbolic.moving and program.header.constraints:
            reject(
                f"{what} contains velocities of a system with constraints.",
                why="Derivatives of these velocities are not available.",
                remedy="Write the expression with coordinates and momenta, or pass it as running=.",
            )
        varied, parameters = program.header.varied_by or (), program.header.parameters
        #: For each variable: index of the parameter, "h" or "t", or None for an input.
        self._varied = [
            parameters.index(name) if name in parameters else name if name in STEP else None
            for name in varied
        ]

    def slopes(self, steps: Reals, t: Reals, q: Reals, p: Reals, values: Reals) -> CostDerivatives:
        """Return the quantity at states after ``steps`` steps, and its derivatives.

        The derivatives are those by q, p and the variables. If h or t0 is a variable, the time of a
        state varies, too. Velocities are functions of (q, p) and the parameters, because
        p = L_v(q, v).
        """
        program, n = self.program, self.program.n
        numbers = program.numbers
        v = evaluate(program, "start", "VELOCITY", n, (t, q, p), values)
        results = self._symbolic.evaluate(*q.T, *p.T, *v.T, *values, t)
        rows = [np.broadcast_to(numbers.read(row), len(q)) for row in results]
        value, state = rows[0], np.stack(rows[1 : 2 * n + 1], axis=1)
        by_velocity = np.stack(rows[2 * n + 1 : 3 * n + 1], axis=1)
        times = {None: numbers.zeros(len(q)), "t": rows[-1], "h": steps * rows[-1]}
        by_parameter = [
            rows[1 + 3 * n + j] if isinstance(j, int) else times[j] for j in self._varied
        ]
        parameters = np.stack(by_parameter, axis=1) if by_parameter else numbers.zeros((len(q), 0))
        if self._symbolic.moving:
            # with dp = P_q dq + M dv + P_a da: mu = M^-1 g_v is the derivative by p
            still = evaluate(program, "start", "VELOCITY", n, (t, q, 0 * p), values)
            mu = evaluate(program, "start", "VELOCITY", n, (t, q, by_velocity), values) - still
            given = np.concatenate([0 * q, -mu], axis=1)
            pulled, further = pull_velocities(program, t, q, p, given, values)
            state = state + np.concatenate([pulled[:, :n], mu], axis=1)
            parameters = parameters + further
        return CostDerivatives(value, state, parameters)


def pull_velocities(
    program: Program, t: Reals, q: Reals, p: Reals, given: Reals, values: Reals
) -> tuple[Reals, Reals]:
    """Convert derivatives by q and p to derivatives by q and v at M states.

    ``given`` has shape (M, 2 n). The first result has the derivatives by q and v, shape (M, 2 n).
    The second has additional derivatives by the variables at fixed q and v, shape (M, k).
    """
    numbers, header = program.numbers, program.header
    kernels = program.kernels
    W = workspace(header, numbers, values)
    varied, nodes = len(header.varied_by or ()), header.nodes
    out, slopes = given.copy(), numbers.zeros((len(q), max(1, varied * nodes)))
    addresses = tuple(map(kernels.address, ("prepare", "start", "start_adjoint")))
    setting = numbers.read(1.0).item(), t, W, header.driver_layout
    rows = header.layout["ADJOINT"], header.layout["COST_SLOPE"]
    numbers.driver("pull_velocities")(addresses, setting, (q, p), rows, out, slopes)
    return out, slopes[:, : varied * nodes : nodes]


class CostOfSamples(Protocol):
    """A cost of equally spaced states, with its derivatives by them."""

    def slopes(
        self, place: slice, steps: Reals, t: Reals, q: Reals, p: Reals, values: Reals
    ) -> CostDerivatives:
        """Return the cost of the states ``place``, and its derivatives."""


@dataclass(frozen=True)
class SampleCost:
    """Measurements of a quantity at equally spaced states; NaN means no measurement."""

    quantity: StateCost
    values: Reals

    def slopes(
        self, place: slice, steps: Reals, t: Reals, q: Reals, p: Reals, values: Reals
    ) -> CostDerivatives:
        """Return the squared deviations from the measurements ``place``, with derivatives."""
        slopes, data = self.quantity.slopes(steps, t, q, p, values), self.values[place]
        known = data == data  # NaN differs from itself
        off = np.where(known, slopes.value - data, 0 * slopes.value)
        changed = slopes.times(2 * off)
        return CostDerivatives(off * off, changed.state, changed.parameters)


def read_samples(
    program: Program, samples: Mapping[Any, ArrayLike] | None, steps: int, every: int
) -> tuple[SampleCost, ...]:
    """Read measured samples, a mapping from expressions to values.

    Raises InputError if their number is not the number of states, or if all are NaN.
    """
    numbers, measured = program.numbers, []
    count = steps // every + 1
    if samples is not None and not isinstance(samples, Mapping):
        reject(
            f"samples is a {type(samples).__name__}, not a mapping.",
            remedy="Pass samples={'x': [...]}, with NaN for missing measurements.",
        )
    for expression, given in (samples or {}).items():
        values = read_array(f"samples of {expression}", given, numbers)
        if values.shape != (count,):
            reject(
                f"samples of {expression} have shape {values.shape}, but must have shape "
                f"({count},).",
                why=f"Samples are at the initial state and after each {every} of {steps} steps.",
                remedy=f"Pass {count} numbers, NaN for missing measurements, or another every=.",
            )
        if not numbers.finite(values).any():
            reject(
                f"samples of {expression} contain no finite number.",
                remedy="Pass at least one number.",
            )
        measured.append(
            SampleCost(StateCost(program, f"samples of {expression}", expression), values)
        )
    return tuple(measured)
