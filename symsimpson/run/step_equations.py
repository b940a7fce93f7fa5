"""The equations of a step at given nodes, or linearised along a run."""

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
from symsimpson.run.gradients import Way
from symsimpson.stepping.driving import read_driving
from symsimpson.stepping.inputs import read_step, read_varied, refuse_retimed, varied_program
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.names import spelled
from symsimpson.text.quantity import equations_of, held_equations_of


class At(NamedTuple):
    """A step whose control points are given, as users give them."""

    #: As :meth:`Stepper.residual` takes them.
    q0: ArrayLike
    nodes: ArrayLike
    h: Any
    parameters: Mapping[Any, Any] | None
    t: Any
    inputs: Any = None
    multipliers: ArrayLike | None = None


def evaluate_equations(program: Program, at: At, p0: ArrayLike) -> tuple[Reals, Reals]:
    """Evaluate residual and Jacobian of a step at given nodes, and multipliers if they are given.

    Raises InputError if there are no equations, or arrays of other shapes.
    """
    header, numbers = program.header, program.numbers
    _check_equations(program)
    with numbers.working():
        p = read_vector("p0", p0, program.names.coordinates, numbers)
        step = _Step.read(program, at)
        step.evaluate("equations", p)
        equations = (
            equations_of(header, step.run)
            if at.multipliers is None
            else held_equations_of(header, step.run, step.h)
        )
        residual, jacobian = map(numbers.result, equations)
    return residual.ravel(), jacobian.reshape(residual.size, residual.size)


def evaluate_curvature(
    program: Program, at: At, weights: ArrayLike, constraint_weights: ArrayLike | None, wrt: Any
) -> Reals:
    """Evaluate second derivatives of weighted rows of a step.

    Raises InputError if there are no equations, or arrays of other shapes.
    """
    _check_equations(program)
    names = read_varied(program, wrt, of_steps=True)
    program = varied_program(program, names, second=True)
    header, n, numbers = program.header, program.n, program.numbers
    d, m = header.degree, len(header.constraints)
    with numbers.working():
        step = _Step.read(program, at)
        rows = _shaped("weights", weights, (d + 1, n), numbers)
        held = numbers.zeros((d + 1, m))
        if constraint_weights is not None:
            held = _shaped("constraint_weights", constraint_weights, (d + 1, m), numbers)
        step.run.rows("ROW_WEIGHT", (d + 1) * (n + m))[:] = np.concatenate([rows, held], axis=None)
        step.evaluate("curvature", numbers.zeros(n))
        size = header.layout["HESSIAN_SIZE"]
        matrix = numbers.result(step.run.rows("HESSIAN", size**2)).reshape(size, size)
        # derivatives by a parameter go through all nodes, those by an input through each
        before = (d + 1) * n + d * m
        groups = list(range(before))
        for j, name in enumerate(names):
            nodes = range(before + j * header.nodes, before + (j + 1) * header.nodes)
            groups += nodes if name in header.inputs else nodes[:1]
        for axis in (0, 1):
            matrix = np.add.reduceat(matrix, groups, axis=axis)
        return np.asarray((matrix + matrix.T) / 2)  # sums over nodes have another order there


def _check_equations(program: Program) -> None:
    """Refuse steps that are explicit; raises InputError."""
    if "equations" not in program.header.functions:
        reject(
            f"{program.scheme} is explicit: a step has no equations to evaluate.",
            remedy="Ask a stepper of another scheme, as 'simpson'.",
        )


def _shaped(name: str, value: ArrayLike, shape: tuple[int, int], numbers: Numbers) -> Reals:
    """Read an array of this shape; raises InputError."""
    array = read_array(name, value, numbers)
    if array.shape != shape:
        reject(
            f"{name} has shape {array.shape}, expected {shape}.",
            remedy="Pass a row for each control point X_0, ..., X_d.",
        )
    return array


@dataclass(frozen=True)
class _Step:
    """A step whose control points and multipliers are given."""

    program: Program
    run: Run
    q: Reals
    h: Any
    t: Any
    inputs: Reals

    @classmethod
    def read(cls, program: Program, at: At) -> _Step:
        """Read a step, and put its path into a workspace; raises InputError."""
        header, n, numbers = program.header, program.n, program.numbers
        d, m = header.degree, len(header.constraints)
        q = read_vector("q0", at.q0, program.names.coordinates, numbers)
        h, t = read_step(at.h, numbers), read_number("t", at.t, numbers)
        points = read_array("nodes", at.nodes, numbers)
        if points.shape != (d, n):
            reject(
                f"nodes has shape {points.shape}, expected ({d}, {n}).",
                remedy="Pass the inner control points and q1, one row each.",
            )
        mu = at.multipliers
        mu = None if mu is None else read_array("multipliers", mu, numbers)
        if mu is not None and (mu.shape != (d, m) or not m):
            reject(
                f"multipliers has shape {mu.shape}, but {program.system} has {m} constraints and "
                f"{program.scheme} {d} points at which they pull.",
                remedy=f"Pass shape ({d}, {m}): those "
                "at X_0, ..., X_(d-1); none to a system without constraints.",
            )
        run = Run(program, program.values(at.parameters), h, h * 0, 0, 1)
        run.rows("INCREMENT", d * n)[:] = (points - q).ravel()
        if mu is not None:
            run.rows("INCREMENT", d * (n + m))[d * n :] = (mu * h).ravel()
        return cls(program, run, q, h, t, read_driving(program, at.inputs, h, 1, t))

    def evaluate(self, kernel: str, p: Reals) -> None:
        """Call a kernel for it, with a momentum at its start."""
        program, run = self.program, self.run
        numbers, header = program.numbers, program.header
        unknowns = run.rows("INCREMENT", header.degree * (program.n + len(header.constraints)))
        given = unknowns.copy()
        run.rows("POSITION", program.n)[:] = self.q
        run.rows("MOMENTUM", program.n)[:] = p
        for name in ("start", kernel):  # what depends on q0 alone may be known before
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
    refuse_retimed(program, "linearisations")
    asked: Sequence[Any] = wrt if isinstance(wrt, (tuple, list)) else (wrt,)
    program = varied_program(program, read_varied(program, asked, of_steps=True))
    spec = read_run(program, request)
    n, size = program.n, 2 * program.n
    header, numbers = program.header, program.numbers
    with numbers.working():
        way = Way(program, spec, progress)
        q, p = numbers.zeros((2, spec.steps + 1, n))
        rows = numbers.zeros((spec.steps, size, size))
        slopes = numbers.zeros((spec.steps, size, len(header.varied_by or ()), header.nodes))
        for first, records, *states in way.segments():
            here = slice(first, first + len(records))
            q[here], p[here] = states
            _linearise(program, spec, first, records, rows[here], slopes[here])
        q[-1], p[-1] = way.q1, way.p1
        by_name = dict(zip(map(spelled, asked), np.moveaxis(slopes, 2, 0), strict=True))
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


def _linearise(
    program: Program, spec: RunSpec, first: int, records: Reals, rows: Reals, slopes: Reals
) -> None:
    """Fill in the derivatives of the steps of a segment, row by row."""
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
