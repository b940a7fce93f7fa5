"""Values of kernels and of observed expressions at many states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.input_values import read_array
from symsimpson.program.numbers import NO_INPUTS, workspace
from symsimpson.program.observed import ObservedExpression, observing_kernel
from symsimpson.program.program import Program
from symsimpson.support.array_types import Reals


def evaluate(
    program: Program,
    kernel: str,
    block: str,
    count: int,
    states: tuple[Reals, Reals, Reals],
    values: Reals,
    inputs: Reals = NO_INPUTS,
) -> Reals:
    """Evaluate a kernel of the state at many states (t, q, p); shape (..., count).

    ``q`` and ``p`` have shape (..., n). The kernel "legendre" takes velocities in place of p.
    ``values`` of the parameters have shape (m,), or (K, m) if the first axis of ``q`` counts
    members. The axis of ``inputs`` for steps counts states here; only powers of forces use inputs.
    For huge angles, at which fast sines are NaN, the states are evaluated again with the sines of
    the C library.
    """
    header, numbers, kernels = program.header, program.numbers, program.kernels
    driver, shape = numbers.driver("evaluate"), states[1].shape[:-1]
    with numbers.working():
        rows_of_values = np.atleast_2d(numbers.read(values))
        if len(rows_of_values) > 1 and (rows_of_values == rows_of_values[0]).all():
            rows_of_values = rows_of_values[:1]  # the kernel "prepare" then runs once
        W, unit = workspace(header, numbers, rows_of_values[0]), numbers.read(1.0).item()
        t, q, p = map(numbers.read, states)
        t = t if t.shape == shape else np.broadcast_to(t, shape).copy()
        t, q, p = t.reshape(-1), q.reshape(-1, header.n), p.reshape(-1, header.n)

        def at(some: Any, values: Reals, inputs: Reals, *, any_angle: bool) -> Reals:
            address = kernels.address(kernel, any_angle=any_angle)
            addresses, here = (kernels.address("prepare"), 0, address), (t[some], q[some], p[some])
            out, given = numbers.zeros((len(here[0]), count)), (inputs, values)
            setting = unit, W, header.driver_layout, here, header.layout[block]
            driver(addresses, *setting, out, given)
            return numbers.result(out)

        rows = at(slice(None), rows_of_values, inputs, any_angle=False)
        if header.fast_sines and not numbers.all_finite(rows):
            known = numbers.finite(q).all(axis=1) & numbers.finite(p).all(axis=1)
            again = np.flatnonzero(known & ~numbers.finite(rows).all(axis=1))
            if again.size:
                some_values = rows_of_values[again * len(rows_of_values) // len(rows)]
                some_inputs = inputs if inputs.shape[1] == 1 else inputs[:, again]
                rows[again] = at(again, some_values, some_inputs, any_angle=True)
    return rows.reshape(*shape, count)


def prepare_observation(
    program: Program, observed: Sequence[ObservedExpression], values: Reals, kernel: Any = None
) -> tuple[tuple[int, int, int], Reals]:
    """Return the kernels that evaluate expressions (prepare, energy, observe), and a workspace.

    The ``kernel`` is compiled unless it is given. Raises InputError for a multiprecision stepper.
    """
    header, numbers, kernels = program.header, program.numbers, program.kernels
    if kernel is None:
        kernel = kernels.compile_observer(observing_kernel(header, observed), len(observed))
    W = workspace(header, numbers, np.atleast_2d(numbers.read(values))[0], more=len(observed))
    before = "multipliers" if any(quantity.held for quantity in observed) else "energy"
    return (kernels.address("prepare"), kernels.address(before), kernel), W


class StateEvaluator:
    """Evaluates expressions at states (t, q, p); see :func:`make_evaluator`."""

    def __init__(
        self, program: Program, observed: Sequence[ObservedExpression], values: Reals, kernel: Any
    ) -> None:
        numbers = program.numbers
        (prepare, before, kernel), W = prepare_observation(program, observed, values, kernel)
        computed = any(quantity.energetic or quantity.held for quantity in observed)
        self._addresses = prepare, before if computed else 0, kernel
        self._place = program.header.driver_layout, program.header.rows
        self._driver, self._zeros = numbers.driver("evaluate"), numbers.zeros
        self._count, self._workspace = len(observed), W
        self._values, self._prepared = np.atleast_2d(numbers.read(values)), False
        #: Returns the inputs at times, shape (1, N, 1, m); None without inputs.
        self.inputs_at: Callable[[Reals], Reals] | None = None

    def change_parameters(self, values: Reals) -> None:
        """Use other values of the parameters, shape (m,); the array is not copied."""
        self._values, self._prepared = values[None], False

    def __call__(self, t: Reals, q: Reals, p: Reals) -> Reals:
        """Return the values at states, shape (len(q), number of expressions)."""
        out = self._zeros((len(q), self._count))
        # copies, because arrays from files and from other processes may be read-only
        states = tuple(np.array(x, dtype=out.dtype, order="C") for x in (t, q, p))
        prepare, before, kernel = self._addresses
        again = self._prepared and len(self._values) == 1
        layout, first = self._place
        addresses = 0 if again else prepare, before, kernel
        given = NO_INPUTS if self.inputs_at is None else self.inputs_at(t), self._values
        self._driver(addresses, 1.0, self._workspace, layout, states, first, out, given)
        self._prepared = True
        return out


def make_evaluator(
    program: Program, observed: Sequence[ObservedExpression], values: Reals, kernel: Any = None
) -> StateEvaluator:
    """Return a function of states (t, q, p) that evaluates expressions.

    Its result has shape (len(q), len(observed)). ``values`` of the parameters have shape (m,), or
    (K, m) for equally many states of each of K members, one member after another. The ``kernel`` is
    compiled unless it is given. Raises InputError for a multiprecision stepper.
    """
    return StateEvaluator(program, observed, values, kernel)


def evaluate_energy(
    program: Program,
    given_q: ArrayLike,
    given_p: ArrayLike,
    parameters: Mapping[Any, Any] | None,
    t: ArrayLike,
) -> Reals:
    """Evaluate the Hamiltonian at given states, shape (N,), or at one state."""
    numbers, n = program.numbers, program.n
    with numbers.working():
        states = [read_array(name, x, numbers) for name, x in (("q", given_q), ("p", given_p))]
        single = all(state.shape == (n,) for state in states)
        states = [state[None] for state in states] if single else states
        for name, state in zip("qp", states, strict=True):
            if state.ndim != 2 or state.shape != (len(states[0]), n):
                reject(
                    f"{name} has shape {state.shape}, expected (N, {n}) or ({n},).",
                    remedy="Pass one row for each state, and as many rows in q as in p.",
                )
        values = program.values(parameters)
        times = np.broadcast_to(read_array("t", t, numbers), len(states[0]))
    q, p = states
    energies: Reals = evaluate(program, "energy", "ENERGY", 1, (times, q, p), values)
    return energies[0, 0] if single else energies[:, 0]
