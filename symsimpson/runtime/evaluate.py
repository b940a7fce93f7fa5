"""Evaluate what a module can compute besides steps: equations, energy, invariants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.inputs import read_array, read_number, read_vector
from symsimpson.runtime.load import equations_of
from symsimpson.runtime.machine import Run

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["evaluate", "evaluate_energy", "evaluate_equations"]

Reals = NDArray[Any]


def evaluate(
    stepper: Stepper, kernel: str, block: str, count: int, q: Reals, p: Reals, values: Reals
) -> Reals:
    """Evaluate a kernel of the state at many states; shape (len(q), count)."""
    facts, numbers, kernels = stepper._facts, stepper._numbers, stepper._kernels
    with numbers.working():
        W = numbers.zeros((facts.rows, 1))
        first = facts.layout["PARAMETER"]
        W[first : first + values.size, 0] = numbers.read(values)
        out = numbers.zeros((len(q), count))
        numbers.driver("evaluate")(
            kernels.address("prepare"), kernels.address(kernel), numbers.read(1.0).item(), W,
            facts.places, numbers.read(q), numbers.read(p), facts.layout[block], out,
        )  # fmt: skip
        return numbers.result(out)


def evaluate_energy(
    stepper: Stepper, q: ArrayLike, p: ArrayLike, parameters: Mapping[Any, Any] | None
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
    stepper: Stepper,
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
            kernels.address("prepare"), kernels.address("equations"), h, run.W, facts.places,
            q[None, :], p[None, :], facts.layout["RESIDUAL"], numbers.zeros((1, 0)),
        )  # fmt: skip
        residual, jacobian = map(numbers.result, equations_of(facts, run))
    return residual.ravel(), jacobian.reshape(d * n, d * n)
