"""Costs of states: expressions, their values and derivatives at many states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.input_values import read_array
from symsimpson.program.numbers import Numbers, workspace
from symsimpson.program.observed import evaluate, read_expression
from symsimpson.program.program import Program
from symsimpson.stepping.inputs import STEP
from symsimpson.support.array_types import Reals
from symsimpson.text.quantity import OBSERVABLE


@dataclass(frozen=True)
class Slopes:
    """A quantity at states, and its derivatives."""

    value: Reals  #: shape (M,)
    state: Reals  #: By q and p, shape (M, 2 n).
    parameters: Reals  #: By what is varied, at given q and p, shape (M, k).

    def times(self, factors: Reals) -> Slopes:
        """Return the slopes of a cost whose derivatives by the quantity are these."""
        weights = factors[:, None]
        return Slopes(self.value, weights * self.state, weights * self.parameters)


class _Written:
    """A quantity as SymPy has it: what it contains, and a function of arrays."""

    def __init__(self, text: str, n: int, parameters: int, numbers: Numbers) -> None:
        import sympy as sp  # only who asks for gradients waits for it

        names = [f"{x}_{i}" for x in "qpv" for i in range(n)]
        names += [f"a_{j}" for j in range(parameters)] + ["t"]
        symbols = {name: sp.Symbol(name, real=True) for name in names}
        functions = {"abs": sp.Abs, "min": sp.Min, "max": sp.Max}
        computed = {scalar.symbol: sp.Symbol(scalar.symbol) for scalar in OBSERVABLE}
        # the text was written anew from a list of what is allowed; numbers are what they say
        self._expression = sp.sympify(text, locals=symbols | functions | computed, rational=True)
        self.computed = self._expression.has(*computed.values())
        self.moving = self._expression.has(*(symbols[f"v_{i}"] for i in range(n)))
        self._symbols, self._numbers = list(symbols.values()), numbers

    @cached_property
    def evaluate(self) -> Callable[..., list[Reals]]:
        """Return its value and its derivatives by all symbols."""
        import sympy as sp

        class Whole(sp.Function):
            """The largest whole number below: constant but where it jumps."""

            def fdiff(self, argindex: int = 1) -> Any:
                return sp.S.Zero

        value = self._expression.replace(sp.Mod, lambda a, b: a - b * Whole(a / b))
        every = [value, *(sp.diff(value, symbol) for symbol in self._symbols)]
        whole = [expression.replace(Whole, sp.floor) for expression in every]
        function: Callable[..., list[Reals]] = self._numbers.lambdified(self._symbols, whole)
        return function


#: A search asks for the same quantity many times.
_written = lru_cache(maxsize=64)(_Written)


class StateCost:
    """A quantity of a state: an expression in q, p, v, parameters and t.

    The program is one that differentiates its steps; ``what`` names the quantity in messages.
    Raises InputError if the expression contains something else.
    """

    def __init__(self, program: Program, what: str, expression: Any) -> None:
        self.program = program
        text = read_expression(program, expression).text
        self._written = _written(text, program.n, len(program.parameters), program.numbers)
        if self._written.computed:
            reject(
                f"{what} contains the energy, or a part of it, whose derivatives are not known "
                "here.",
                remedy="Write it with coordinates, velocities and parameters.",
            )
        if self._written.moving and program.header.constraints:
            reject(
                f"{what} contains velocities, whose derivatives are not known with constraints.",
                remedy="Write it with coordinates and momenta, or as running=.",
            )
        varied, parameters = program.header.varied_by or (), program.header.parameters
        #: Which of the parameters are varied, and which of h and t; inputs are none of them.
        self._varied = [
            parameters.index(name) if name in parameters else name if name in STEP else None
            for name in varied
        ]

    def slopes(self, steps: Reals, t: Reals, q: Reals, p: Reals, values: Reals) -> Slopes:
        """Return the quantity behind so many steps, and its derivatives by q, p and what is varied.

        With h or the time of the start the time of a state is varied, too.

        Velocities are functions of (q, p) and the parameters: what depends on them is
        differentiated through p = L_v(q, v).
        """
        program, n = self.program, self.program.n
        numbers = program.numbers
        v = evaluate(program, "start", "VELOCITY", n, (t, q, p), values)
        results = self._written.evaluate(*q.T, *p.T, *v.T, *values, t)
        rows = [np.broadcast_to(numbers.read(row), len(q)) for row in results]
        value, state = rows[0], np.stack(rows[1 : 2 * n + 1], axis=1)
        by_velocity = np.stack(rows[2 * n + 1 : 3 * n + 1], axis=1)
        times = {None: numbers.zeros(len(q)), "t": rows[-1], "h": steps * rows[-1]}
        by_parameter = [
            rows[1 + 3 * n + j] if isinstance(j, int) else times[j] for j in self._varied
        ]
        parameters = np.stack(by_parameter, axis=1) if by_parameter else numbers.zeros((len(q), 0))
        if self._written.moving:
            # with dp = P_q dq + M dv + P_a da: mu = M^-1 g_v is the derivative by p
            still = evaluate(program, "start", "VELOCITY", n, (t, q, 0 * p), values)
            mu = evaluate(program, "start", "VELOCITY", n, (t, q, by_velocity), values) - still
            given = np.concatenate([0 * q, -mu], axis=1)
            pulled, further = pull_velocities(program, t, q, p, given, values)
            state = state + np.concatenate([pulled[:, :n], mu], axis=1)
            parameters = parameters + further
        return Slopes(value, state, parameters)


def pull_velocities(
    program: Program, t: Reals, q: Reals, p: Reals, given: Reals, values: Reals
) -> tuple[Reals, Reals]:
    """Turn derivatives by q and p into those by q and v, and by what is varied at given q and v.

    ``given`` has shape (M, 2 n), for as many states; the results have shapes (M, 2 n) and (M, k).
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


@dataclass(frozen=True)
class Measured:
    """Measurements of a quantity: at each so-many-th state, NaN where there is none."""

    quantity: StateCost
    values: Reals

    def slopes(
        self, place: slice, steps: Reals, t: Reals, q: Reals, p: Reals, values: Reals
    ) -> Slopes:
        """Return the squares of what the quantity differs by, at some of these states."""
        slopes, data = self.quantity.slopes(steps, t, q, p, values), self.values[place]
        known = data == data  # NaN differs from itself
        off = np.where(known, slopes.value - data, 0 * slopes.value)
        changed = slopes.times(2 * off)
        return Slopes(off * off, changed.state, changed.parameters)


def read_samples(
    program: Program, samples: Mapping[Any, ArrayLike] | None, steps: int, every: int
) -> tuple[Measured, ...]:
    """Read samples by the expressions that they are of.

    Raises InputError if their number is not that of the states, or none is a number.
    """
    numbers, measured = program.numbers, []
    count = steps // every + 1
    if samples is not None and not isinstance(samples, Mapping):
        reject(
            f"samples is a {type(samples).__name__}, not a mapping.",
            remedy="Say of what they are: "
            "samples={'x': [...]}, with NaN where nothing was measured.",
        )
    for expression, given in (samples or {}).items():
        values = read_array(f"samples of {expression}", given, numbers)
        if values.shape != (count,):
            reject(
                f"samples of {expression} have shape {values.shape}, and there are {count} states, "
                f"one after each {every} of {steps} steps, and the first.",
                remedy=f"Pass {count} numbers, NaN where nothing was measured, or another every=.",
            )
        if not numbers.finite(values).any():
            reject(f"samples of {expression}: none is finite.", remedy="Pass at least one number.")
        measured.append(
            Measured(StateCost(program, f"samples of {expression}", expression), values)
        )
    return tuple(measured)
