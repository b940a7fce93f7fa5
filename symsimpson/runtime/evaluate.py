"""Evaluate what can be computed at states: equations, energy, invariants, expressions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.inputs import read_array, read_number, read_vector
from symsimpson.runtime.load import Kernels, equations_of
from symsimpson.runtime.machine import Run, workspace
from symsimpson.runtime.observe import Observed, observing_kernel

if TYPE_CHECKING:
    from symsimpson.runtime.evaluator import Evaluator

__all__ = ["evaluate", "evaluate_energy", "evaluate_equations", "watching"]

Reals = NDArray[Any]


def evaluate(
    stepper: Evaluator, kernel: str, block: str, count: int, q: Reals, p: Reals, values: Reals
) -> Reals:
    """Evaluate a kernel of the state at many states; shape (len(q), count)."""
    facts, numbers = stepper._facts, stepper._numbers
    with numbers.working():
        W = workspace(facts, numbers, numbers.read(values))
        return evaluate_in(W, stepper, kernel, block, count, q, p)


def evaluate_members(
    stepper: Evaluator, kernel: str, block: str, count: int, q: Reals, p: Reals, values: Reals
) -> Reals:
    """Evaluate a kernel of the state at states of many members, each with its own parameters.

    ``q`` and ``p`` have shape (K, ..., n), ``values`` (K, m); gives shape (K, ..., count).
    """
    found = np.empty((*q.shape[:-1], count))
    own, group = np.unique(values, axis=0, return_inverse=True)
    for k, parameters in enumerate(own):
        here = np.flatnonzero(group.ravel() == k)
        some_q, some_p = (x[here].reshape(-1, stepper.n) for x in (q, p))
        rows = evaluate(stepper, kernel, block, count, some_q, some_p, parameters)
        found[here] = rows.reshape(found[here].shape)
    return found


def evaluate_in(
    W: Reals, stepper: Evaluator, kernel: str, block: str, count: int, q: Reals, p: Reals
) -> Reals:
    """Evaluate a kernel of the state in a workspace that holds parameters.

    Fast sines have no value for huge angles: there the library's are taken.
    """
    numbers, kernels = stepper._numbers, stepper._kernels
    place = stepper._facts.layout[block], count

    def values(q: Reals, p: Reals, *, any_angle: bool) -> Reals:
        address = kernels.address(kernel, any_angle=any_angle)
        return _evaluated(stepper, W, (0, address), place, numbers.zeros(len(q)), q, p)

    found = values(q, p, any_angle=False)
    if stepper._facts.fast_sines and not numbers.all_finite(found):
        again = ~numbers.finite(found).all(axis=1)
        again &= numbers.finite(q).all(axis=1) & numbers.finite(p).all(axis=1)
        if again.any():
            found[again] = values(q[again], p[again], any_angle=True)
    return found


def watching(
    stepper: Evaluator, found: Sequence[Observed], values: Reals
) -> Callable[[Reals, Reals, Reals], Reals]:
    """Give what evaluates expressions at many states (t, q, p); shape (len(q), len(found)).

    Raises
    ------
    InputError
        If the stepper has many digits.
    """
    facts, numbers, kernels = stepper._facts, stepper._numbers, stepper._kernels
    if not isinstance(kernels, Kernels):
        raise InputError(
            "expressions are evaluated in double precision, and this stepper has many digits.\n"
            "Compile without precision."
        )
    kernel = kernels.observing(observing_kernel(facts, found), len(found))
    energy = kernels.address("energy") if any(one.energetic for one in found) else 0
    W = workspace(facts, numbers, numbers.read(values), more=len(found))
    return lambda t, q, p: _evaluated(
        stepper, W, (energy, kernel), (facts.rows, len(found)), t, q, p
    )  # fmt: skip


def _evaluated(
    stepper: Evaluator, W: Reals, kernels: tuple[Any, Any], block: tuple[int, int], t: Reals,
    q: Reals, p: Reals,
) -> Reals:  # fmt: skip
    """Evaluate two kernels, the first of which may be 0; gives a block of so many rows."""
    numbers, (first, count) = stepper._numbers, block
    out = numbers.zeros((len(q), count))
    numbers.driver("evaluate")(
        stepper._kernels.address("prepare"), *kernels, numbers.read(1.0).item(), W,
        stepper._facts.places, numbers.read(t), numbers.read(q), numbers.read(p), first, out,
    )  # fmt: skip
    return numbers.result(out)


def evaluate_energy(
    stepper: Evaluator, q: ArrayLike, p: ArrayLike, parameters: Mapping[Any, Any] | None
) -> Reals:
    """Evaluate the Hamiltonian at states of any origin."""
    numbers, n = stepper._numbers, stepper.n
    with numbers.working():
        states = [read_array(name, x, numbers) for name, x in (("q", q), ("p", p))]
        for name, state in zip("qp", states, strict=True):
            if state.ndim != 2 or state.shape != (len(states[0]), n):
                raise InputError(
                    f"{name} has shape {state.shape}, expected (N, {n}).\n"
                    "Pass one row for each state; q and p of equal length."
                )
        values = stepper._values(parameters)
    energies: Reals = evaluate(stepper, "energy", "ENERGY", 1, states[0], states[1], values)[:, 0]
    return energies


def evaluate_equations(
    stepper: Evaluator,
    q0: ArrayLike,
    p0: ArrayLike,
    nodes: ArrayLike,
    h: Any,
    given: Mapping[Any, Any] | None,
) -> tuple[Reals, Reals]:
    """Evaluate residual, shape (d n,), and Jacobian, shape (d n, d n), at given nodes."""
    facts, n, numbers = stepper._facts, stepper.n, stepper._numbers
    d = facts.degree
    if "equations" not in facts.functions:
        raise InputError(
            f"{stepper.scheme} is explicit: a step has no equations to evaluate.\n"
            "Ask a stepper of another scheme, as 'simpson'."
        )
    with numbers.working():
        q = read_vector("q0", q0, stepper.coordinates, numbers)
        p = read_vector("p0", p0, stepper.coordinates, numbers)
        h = read_number("h", h, numbers)
        points = read_array("nodes", nodes, numbers)
        if points.shape != (d, n):
            raise InputError(
                f"nodes has shape {points.shape}, expected ({d}, {n}).\n"
                "Pass the inner control points and q1, one row each."
            )
        kernels = stepper._kernels
        run = Run(facts, kernels, numbers, stepper._values(given), h, h * 0, 0, 1)
        run.rows("POSITION", n)[:] = q
        run.rows("MOMENTUM", n)[:] = p
        run.rows("INCREMENT", d * n)[:] = (points - q).ravel()
        numbers.driver("evaluate")(
            kernels.address("prepare"), 0, kernels.address("equations"), h, run.W, facts.places,
            numbers.zeros(1), q[None, :], p[None, :], facts.layout["RESIDUAL"],
            numbers.zeros((1, 0)),
        )  # fmt: skip
        residual, jacobian = map(numbers.result, equations_of(facts, run))
    return residual.ravel(), jacobian.reshape(d * n, d * n)
