"""Kernels at given states: the energy and all else that follows from a state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import InputError
from symsimpson.program.input_values import read_array
from symsimpson.program.observed import Observed, observing_kernel
from symsimpson.program.program import Program
from symsimpson.program.workspace import NO_INPUTS, workspace
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

    ``q`` and ``p`` have shape (..., n); the kernel "legendre" takes velocities in place of p.
    Parameters have ``values`` of shape (m,), or (K, m) if the first axis of ``q`` counts members.
    ``inputs`` have states in the places of steps; they stand in powers alone. Fast sines have no
    value for huge angles: there the library's are taken.
    """
    header, numbers, kernels = program.header, program.numbers, program.kernels
    driver, shape = numbers.driver("evaluate"), states[1].shape[:-1]
    with numbers.working():
        rows_of_values = np.atleast_2d(numbers.read(values))
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


def observer(
    program: Program, observed: Sequence[Observed], values: Reals, kernel: Any = None
) -> tuple[tuple[int, int, int], Reals]:
    """Return what evaluates expressions: prepare, the energy and a kernel; and their workspace.

    The ``kernel`` is compiled unless it is given. Raises InputError if the stepper has many digits.
    """
    header, numbers, kernels = program.header, program.numbers, program.kernels
    if kernel is None:
        kernel = kernels.compile_observer(observing_kernel(header, observed), len(observed))
    W = workspace(header, numbers, np.atleast_2d(numbers.read(values))[0], more=len(observed))
    return (kernels.address("prepare"), kernels.address("energy"), kernel), W


def watching(
    program: Program, observed: Sequence[Observed], values: Reals, kernel: Any = None
) -> Callable[[Reals, Reals, Reals], Reals]:
    """Return what evaluates expressions at many states (t, q, p); shape (len(q), len(observed)).

    Parameters have ``values`` of shape (m,), or (K, m) if equally many states of K members follow
    one another. The ``kernel`` is compiled unless it is given. Raises InputError if the stepper has
    many digits.
    """
    header, numbers = program.header, program.numbers
    (prepare, energy, kernel), W = observer(program, observed, values, kernel)
    # asked for one state often: all but the states is found once
    addresses = prepare, energy if any(quantity.energetic for quantity in observed) else 0, kernel
    driver = numbers.driver("evaluate")
    first, about, count = header.rows, header.driver_layout, len(observed)
    given = NO_INPUTS, np.atleast_2d(numbers.read(values))

    def watch(t: Reals, q: Reals, p: Reals) -> Reals:
        out = numbers.zeros((len(q), count))
        # copies: what came from a file, or from another process, may be read-only
        states = tuple(np.array(x, dtype=out.dtype, order="C") for x in (t, q, p))
        driver(addresses, 1.0, W, about, states, first, out, given)
        return out

    return watch


def evaluate_energy(
    program: Program,
    given_q: ArrayLike,
    given_p: ArrayLike,
    parameters: Mapping[Any, Any] | None,
    t: ArrayLike,
) -> Reals:
    """Evaluate the Hamiltonian at states of any origin."""
    numbers, n = program.numbers, program.n
    with numbers.working():
        states = [read_array(name, x, numbers) for name, x in (("q", given_q), ("p", given_p))]
        for name, state in zip("qp", states, strict=True):
            if state.ndim != 2 or state.shape != (len(states[0]), n):
                raise InputError(
                    f"{name} has shape {state.shape}, expected (N, {n}).\n"
                    "Pass one row for each state; q and p of equal length."
                )
        values = program.values(parameters)
        times = np.broadcast_to(read_array("t", t, numbers), len(states[0]))
    q, p = states
    energies: Reals = evaluate(program, "energy", "ENERGY", 1, (times, q, p), values)
    return energies[:, 0]
