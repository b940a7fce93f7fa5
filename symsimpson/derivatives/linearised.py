"""The steps of a run, linearised: row by row by the adjoint of the step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from symsimpson.derivatives.adjoint_run import Way
from symsimpson.program.program import Program
from symsimpson.program.workspace import workspace
from symsimpson.results.motion_derivatives import Linearisation
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.stepping.variations import read_varied, refuse_retimed, varied_program
from symsimpson.support.array_types import Reals
from symsimpson.support.names import spelled


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
