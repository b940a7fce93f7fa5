"""The equations of a step: evaluated at given control points, or linearised along a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.input_values import read_array, read_number, read_vector
from symsimpson.program.numbers import Numbers, workspace
from symsimpson.program.program import Program
from symsimpson.results.motion_derivatives import Linearisation
from symsimpson.run.gradients import ForwardRun
from symsimpson.stepping.driving import read_input_values
from symsimpson.stepping.inputs import (
    program_with_derivatives,
    read_step,
    read_variables,
    reject_retimed,
)
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.names import spelled
from symsimpson.text.quantity import equations_of, held_equations_of


class StepArguments(NamedTuple):
    """Unchecked arguments of the equations of a step, as for :meth:`Stepper.residual`."""

    q0: ArrayLike
    nodes: ArrayLike
    h: Any
    parameters: Mapping[Any, Any] | None
    t: Any
    inputs: Any = None
    multipliers: ArrayLike | None = None


def evaluate_equations(program: Program, at: StepArguments, p0: ArrayLike) -> tuple[Reals, Reals]:
    """Evaluate the residual and the Jacobian of a step at given control points and multipliers.

    Raises InputError if the scheme is explicit or an array has the wrong shape.
    """
    header, numbers = program.header, program.numbers
    _check_equations(program)
    with numbers.working():
        p = read_vector("p0", p0, program.names.coordinates, numbers)
        step = _StepEvaluator.read(program, at)
        step.evaluate("equations", p)
        equations = (
            equations_of(header, step.run)
            if at.multipliers is None
            else held_equations_of(header, step.run, step.h)
        )
        residual, jacobian = map(numbers.result, equations)
    return residual.ravel(), jacobian.reshape(residual.size, residual.size)


def evaluate_curvature(
    program: Program,
    at: StepArguments,
    weights: ArrayLike,
    constraint_weights: ArrayLike | None,
    wrt: Any,
) -> Reals:
    """Evaluate the second derivatives of a weighted sum of the equations of a step.

    Raises InputError if the scheme is explicit or an array has the wrong shape.
    """
    _check_equations(program)
    names = read_variables(program, wrt)
    program = program_with_derivatives(program, names, second=True)
    header, n, numbers = program.header, program.n, program.numbers
    d, m = header.degree, len(header.constraints)
    with numbers.working():
        step = _StepEvaluator.read(program, at)
        rows = _read_shaped("weights", weights, (d + 1, n), numbers)
        of_constraints = numbers.zeros((d + 1, m))
        if constraint_weights is not None:
            of_constraints = _read_shaped(
                "constraint_weights", constraint_weights, (d + 1, m), numbers
            )
        all_weights = np.concatenate([rows, of_constraints], axis=None)
        step.run.rows("ROW_WEIGHT", (d + 1) * (n + m))[:] = all_weights
        step.evaluate("curvature", numbers.zeros(n))
        size = header.layout["HESSIAN_SIZE"]
        matrix = numbers.result(step.run.rows("HESSIAN", size**2)).reshape(size, size)
        # a parameter acts at all nodes, an input at each node has a value of its own
        before = (d + 1) * n + d * m
        groups = list(range(before))
        for j, name in enumerate(names):
            nodes = range(before + j * header.nodes, before + (j + 1) * header.nodes)
            groups += nodes if name in header.inputs else nodes[:1]
        for axis in (0, 1):
            matrix = np.add.reduceat(matrix, groups, axis=axis)
        return np.asarray((matrix + matrix.T) / 2)  # sums over nodes differ by round-off


def _check_equations(program: Program) -> None:
    """Raise InputError for an explicit scheme, and for a Hamiltonian."""
    if program.header.canonical:
        reject(
            "a HamiltonianSystem has no equations of a step for its control points.",
            where=program.system,
            why="The unknowns of its steps are velocities and forces at the nodes.",
            remedy="Declare the Lagrangian, or differentiate with stepper.tangent and "
            "stepper.gradient.",
        )
    if "equations" not in program.header.functions:
        reject(
            f"the scheme {program.scheme} is explicit, so its steps have no equations to evaluate.",
            remedy="Compile with an implicit scheme, such as 'simpson'.",
        )


def _read_shaped(name: str, value: ArrayLike, shape: tuple[int, int], numbers: Numbers) -> Reals:
    """Read an array; raise InputError if it has another shape."""
    array = read_array(name, value, numbers)
    if array.shape != shape:
        reject(
            f"{name} has shape {array.shape}, but must have shape {shape}.",
            remedy="Pass a row for each control point X_0, ..., X_d.",
        )
    return array


@dataclass(frozen=True)
class _StepEvaluator:
    """A step with given control points and multipliers, in the workspace of a run."""

    program: Program
    run: Run
    q: Reals
    h: Any
    t: Any
    inputs: Reals

    @classmethod
    def read(cls, program: Program, at: StepArguments) -> _StepEvaluator:
        """Check the arguments of a step, and write its control points into a workspace."""
        header, n, numbers = program.header, program.n, program.numbers
        d, m = header.degree, len(header.constraints)
        q = read_vector("q0", at.q0, program.names.coordinates, numbers)
        h, t = read_step(at.h, numbers), read_number("t", at.t, numbers)
        points = read_array("nodes", at.nodes, numbers)
        if points.shape != (d, n):
            reject(
                f"nodes has shape {points.shape}, but must have shape ({d}, {n}).",
                remedy="Pass the inner control points and q1, one row each.",
            )
        mu = at.multipliers
        mu = None if mu is None else read_array("multipliers", mu, numbers)
        if mu is not None and (mu.shape != (d, m) or not m):
            reject(
                f"multipliers has shape {mu.shape}, but must have shape ({d}, {m}).",
                why=f"{program.system} has {m} constraints, and {program.scheme} applies their "
                f"forces at {d} control points.",
                remedy="Pass the multipliers at X_0, ..., X_(d-1). Omit them for a system without "
                "constraints.",
            )
        run = Run(program, program.values(at.parameters), h, h * 0)
        run.rows("INCREMENT", d * n)[:] = (points - q).ravel()
        if mu is not None:
            run.rows("INCREMENT", d * (n + m))[d * n :] = (mu * h).ravel()
        return cls(program, run, q, h, t, read_input_values(program, at.inputs, h, 1, t))

    def evaluate(self, kernel: str, p: Reals) -> None:
        """Call a kernel for the step, with the momentum ``p`` at its start."""
        program, run = self.program, self.run
        numbers, header = program.numbers, program.header
        unknowns = run.rows("INCREMENT", header.degree * (program.n + len(header.constraints)))
        given = unknowns.copy()
        run.rows("POSITION", program.n)[:] = self.q
        run.rows("MOMENTUM", program.n)[:] = p
        for name in ("start", kernel):  # "start" computes the terms that depend on q0 only
            numbers.driver("evaluate")(
                (program.kernels.address("prepare"), 0, program.kernels.address(name)),
                self.h,
                run.W,
                header.driver_layout,
                (numbers.read([self.t]), self.q[None, :], p[None, :]),
                header.layout["RESIDUAL"],
                numbers.zeros((1, 0)),
                (self.inputs, run.parameters[None]),
            )
            unknowns[:] = given


def linearise(program: Program, request: Request, wrt: Any, progress: bool | None) -> Linearisation:
    """Run, and differentiate each step by its initial state and by ``wrt``.

    Raises InputError, SchemeError, ConvergenceError or Interrupted.
    """
    reject_retimed(program, "linearisations")
    names: Sequence[Any] = wrt if isinstance(wrt, (tuple, list)) else (wrt,)
    program = program_with_derivatives(program, read_variables(program, names))
    spec = read_run(program, request)
    n, size = program.n, 2 * program.n
    header, numbers = program.header, program.numbers
    with numbers.working():
        forward = ForwardRun(program, spec, progress)
        q, p = numbers.zeros((2, spec.steps + 1, n))
        rows = numbers.zeros((spec.steps, size, size))
        slopes = numbers.zeros((spec.steps, size, len(header.varied_by or ()), header.nodes))
        for first, records, *states in forward.segments():
            here = slice(first, first + len(records))
            q[here], p[here] = states
            _linearise_segment(program, spec, first, records, rows[here], slopes[here])
        q[-1], p[-1] = forward.q1, forward.p1
        by_name = dict(zip(map(spelled, names), np.moveaxis(slopes, 2, 0), strict=True))
        inputs = {name for name in by_name if program.names.inputs.place(name) is not None}
        result = numbers.result
        return Linearisation(
            result(spec.t0 + spec.h * numbers.counted(0, spec.steps + 1, 1)),
            result(q),
            result(p),
            result(rows),
            {name: result(x.sum(axis=2)) for name, x in by_name.items() if name not in inputs},
            {name: result(x) for name, x in by_name.items() if name in inputs},
        )


def _linearise_segment(
    program: Program, spec: RunSpec, first: int, records: Reals, rows: Reals, slopes: Reals
) -> None:
    """Compute the derivatives of the steps of a segment into ``rows`` and ``slopes``.

    One adjoint sweep over a step gives one row of its matrix.
    """
    header, numbers = program.header, program.numbers
    size, W = 2 * program.n, workspace(header, numbers, spec.parameters)
    begun, every = header.layout["ADJOINT"], np.arange(slopes[0, 0].size)
    kernels = tuple(map(program.kernels.address, ("prepare", "adjoint")))
    setting = (spec.h, spec.t0, W, header.driver_layout)
    places = (begun, header.layout["COST_SLOPE"])
    carry_back, no_jumps = numbers.driver("carry_back"), numbers.zeros((0, 0))
    unit = numbers.read(np.eye(size))
    totals, row_slopes = numbers.zeros((2, every.size)), numbers.zeros((1, every.size))
    for k in range(len(records) - 1):
        given = records[k : k + 2], no_jumps, spec.inputs
        for row in range(size):
            W[begun : begun + size, 0] = unit[row]
            carry_back(kernels, setting, places, first + k, given, totals, every, row_slopes)
            rows[k, row] = W[begun : begun + size, 0]
            slopes[k, row] = row_slopes.reshape(slopes.shape[2:])
