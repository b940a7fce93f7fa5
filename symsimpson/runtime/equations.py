"""The equations of a step at given nodes: residual and Jacobian, with multipliers or without."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError
from symsimpson.module.matrices import equations_of, held_equations_of
from symsimpson.runtime.inputs import read_array, read_number, read_vector
from symsimpson.runtime.runs.driving import read_driving
from symsimpson.runtime.runs.run import Run

if TYPE_CHECKING:
    from symsimpson.runtime.program import Program

__all__ = ["evaluate_equations"]

#: float64, or numbers of mpmath in an object array.
Reals = NDArray[Any]


def evaluate_equations(
    program: Program,
    q0: ArrayLike,
    p0: ArrayLike,
    nodes: ArrayLike,
    h: Any,
    given: Mapping[Any, Any] | None,
    t: Any,
    inputs: Any,
    multipliers: ArrayLike | None = None,
) -> tuple[Reals, Reals]:
    """Evaluate residual and Jacobian of a step at given nodes, and multipliers if they are given.

    Raises
    ------
    InputError
        If there are no equations, or arrays of other shapes.
    """
    header, n, numbers = program.header, program.n, program.numbers
    d, m = header.degree, len(header.constraints)
    if "equations" not in header.functions:
        raise InputError(
            f"{program.scheme} is explicit: a step has no equations to evaluate.\n"
            "Ask a stepper of another scheme, as 'simpson'."
        )
    with numbers.working():
        names = program.names.coordinates
        q = read_vector("q0", q0, names, numbers)
        p = read_vector("p0", p0, names, numbers)
        h, t = read_number("h", h, numbers), read_number("t", t, numbers)
        points = read_array("nodes", nodes, numbers)
        if points.shape != (d, n):
            raise InputError(
                f"nodes has shape {points.shape}, expected ({d}, {n}).\n"
                "Pass the inner control points and q1, one row each."
            )
        mu = None if multipliers is None else read_array("multipliers", multipliers, numbers)
        if mu is not None and (mu.shape != (d, m) or not m):
            raise InputError(
                f"multipliers has shape {mu.shape}, but {program.system} has {m} constraints and "
                f"{program.scheme} {d} points at which they pull.\nPass shape ({d}, {m}): those "
                "at X_0, ..., X_(d-1); none to a system without constraints."
            )
        kernels = program.kernels
        run = Run(program, program.values(given), h, h * 0, 0, 1)
        run.rows("POSITION", n)[:] = q
        run.rows("MOMENTUM", n)[:] = p
        run.rows("INCREMENT", d * n)[:] = (points - q).ravel()
        if mu is not None:
            run.rows("INCREMENT", d * (n + m))[d * n :] = (mu * h).ravel()
        addresses = kernels.address("prepare"), 0, kernels.address("equations")
        numbers.driver("evaluate")(
            addresses,
            h,
            run.W,
            header.told,
            (numbers.read([t]), q[None, :], p[None, :]),
            header.layout["RESIDUAL"],
            numbers.zeros((1, 0)),
            read_driving(program, inputs, h, 1),
        )
        found = equations_of(header, run) if mu is None else held_equations_of(header, run, h)
        residual, jacobian = map(numbers.result, found)
    return residual.ravel(), jacobian.reshape(residual.size, residual.size)
