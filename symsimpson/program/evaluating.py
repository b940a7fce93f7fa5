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

__all__ = ["evaluate", "evaluate_energy", "evaluate_in", "evaluate_members", "observer", "watching"]


def evaluate(
    program: Program,
    kernel: str,
    block: str,
    count: int,
    states: tuple[Reals, Reals, Reals],
    values: Reals,
    inputs: Reals = NO_INPUTS,
    before: str = "",
) -> Reals:
    """Evaluate a kernel of the state at many states (t, q, p); shape (len(q), count).

    ``inputs`` has states in the places of steps; they stand in powers alone. Another kernel may
    come ``before`` it.
    """
    header, numbers = program.header, program.numbers
    with numbers.working():
        W = workspace(header, numbers, numbers.read(values))
        return evaluate_in(W, program, kernel, block, count, states, inputs, before=before)


def evaluate_members(
    program: Program,
    kernel: str,
    block: str,
    count: int,
    t: Reals,
    q: Reals,
    p: Reals,
    values: Reals,
) -> Reals:
    """Evaluate a kernel of the state at states of many members, each with its own parameters.

    ``q`` and ``p`` have shape (K, ..., n), ``values`` (K, m), ``t`` the shape of the axes between,
    or that of all but the last; gives shape (K, ..., count).
    """
    t = np.broadcast_to(t, q.shape[:-1])
    results = np.empty((*q.shape[:-1], count))
    distinct, group = np.unique(values, axis=0, return_inverse=True)
    for k, parameters in enumerate(distinct):
        here = np.flatnonzero(group.ravel() == k)
        some_q, some_p = (x[here].reshape(-1, program.n) for x in (q, p))
        states = t[here].ravel(), some_q, some_p
        rows = evaluate(program, kernel, block, count, states, parameters)
        results[here] = rows.reshape(results[here].shape)
    return results


def evaluate_in(
    W: Reals,
    program: Program,
    kernel: str,
    block: str,
    count: int,
    states: tuple[Reals, Reals, Reals],
    inputs: Reals = NO_INPUTS,
    *,
    before: str = "",
) -> Reals:
    """Evaluate a kernel at states (t, q, p), in a workspace that holds parameters.

    Fast sines have no value for huge angles: there the library's are taken.
    """
    numbers, kernels, (t, q, p) = program.numbers, program.kernels, states
    header, unit = program.header, numbers.read(1.0).item()

    def values(t: Reals, q: Reals, p: Reals, inputs: Reals, *, any_angle: bool) -> Reals:
        address = kernels.address(kernel, any_angle=any_angle)
        first = kernels.address(before, any_angle=any_angle) if before else 0
        addresses = kernels.address("prepare"), first, address
        out, given = numbers.zeros((len(q), count)), tuple(map(numbers.read, (t, q, p)))
        setting = unit, W, header.driver_layout, given, header.layout[block]
        numbers.driver("evaluate")(addresses, *setting, out, inputs)
        return numbers.result(out)

    rows = values(t, q, p, inputs, any_angle=False)
    if header.fast_sines and not numbers.all_finite(rows):
        again = ~numbers.finite(rows).all(axis=1)
        again &= numbers.finite(q).all(axis=1) & numbers.finite(p).all(axis=1)
        if again.any():
            some_inputs = inputs if inputs.shape[1] == 1 else inputs[:, again]
            rows[again] = values(t[again], q[again], p[again], some_inputs, any_angle=True)
    return rows


def observer(
    program: Program, observed: Sequence[Observed], values: Reals
) -> tuple[tuple[int, int, int], Reals]:
    """Return what evaluates expressions: prepare, the energy and a kernel; and their workspace.

    Raises InputError if the stepper has many digits.
    """
    header, numbers, kernels = program.header, program.numbers, program.kernels
    kernel = kernels.compile_observer(observing_kernel(header, observed), len(observed))
    W = workspace(header, numbers, numbers.read(values), more=len(observed))
    return (kernels.address("prepare"), kernels.address("energy"), kernel), W


def watching(
    program: Program, observed: Sequence[Observed], values: Reals
) -> Callable[[Reals, Reals, Reals], Reals]:
    """Return what evaluates expressions at many states (t, q, p); shape (len(q), len(observed)).

    Raises InputError if the stepper has many digits.
    """
    header, numbers = program.header, program.numbers
    (prepare, energy, kernel), W = observer(program, observed, values)
    # asked for one state often: all but the states is found once
    addresses = prepare, energy if any(quantity.energetic for quantity in observed) else 0, kernel
    driver = numbers.driver("evaluate")
    first, about, count = header.rows, header.driver_layout, len(observed)

    def watch(t: Reals, q: Reals, p: Reals) -> Reals:
        out = np.zeros((len(q), count))
        # copies: what came from a file, or from another process, may be read-only
        states = tuple(np.array(x, dtype=np.float64, order="C") for x in (t, q, p))
        driver(addresses, 1.0, W, about, states, first, out, NO_INPUTS)
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
