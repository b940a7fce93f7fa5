"""The energy that a scheme keeps, from the error of its action: no derivatives, any scheme.

If the scheme is the flow of H + dH, then L_d - S = -(integral of dH over the step), where S is the
action of the exact path between the same ends. Action is stationary there, so that a path with
small errors gives it: a Hermite polynomial through positions and velocities at both ends, of degree
three for schemes up to order 4, and five, with accelerations, for order 6.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from symsimpson.errors import InputError
from symsimpson.program.numbers import workspace
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, driver_layout
from symsimpson.results.states import Stored
from symsimpson.stepping.variations import varied_program
from symsimpson.support.array_types import Reals
from symsimpson.support.derivation import LAGRANGIAN

#: What is summed of H and of its error at four steps: around a state, and at the first two states.
AROUND = np.array([-1, 7, 7, -1]) / 12
FIRST, SECOND = np.array([25, -23, 13, -3]) / 12, np.array([3, 13, -5, 1]) / 12
#: Nodes of the quadrature along the better path, by its degree.
NODES = {3: 5, 5: 7}


def shadow_energy(run: Stored) -> Reals:
    """Return H + dH at all states: to h^8 for schemes of order 4, to h^4 for those of order 2.

    Raises InputError if there is none, or states are missing.
    """
    change = changes(run)
    inner = [weight * change[k : len(change) - 3 + k] for k, weight in enumerate(AROUND)]
    ends = [side[:4] @ weights for side in (change, change[::-1]) for weights in (FIRST, SECOND)]
    at_states = np.concatenate([ends[:2], sum(inner), ends[:1:-1]])
    return np.asarray(run.energy + at_states)


def changes(run: Stored) -> Reals:
    """Return dH in the mean over each step, -(L_d - S)/h, shape (N,)."""
    _check(run)
    program = varied_program(run.program, (), LAGRANGIAN)
    return (_actions(program, run) - _discrete_actions(program, run)) / run.h


def _check(run: Stored) -> None:
    header = run.program.header
    why = ""
    if not header.conservative:
        why = "its energy is not constant: look at run.energy_balance"
    elif header.retimed:
        why = "its steps are fixed in another time"
    elif run.records:
        why = "events acted on it"
    elif header.constraints:
        why = "its paths are held by constraints"
    elif run.every != 1:
        why = "not all states are stored: integrate with every=1"
    elif run.steps < 4:
        why = "it takes four steps to tell"
    elif run.p.dtype != np.float64:
        why = "it is found in double precision: compile without precision"
    if why:
        raise InputError(f"{header.system}: there is no shadow energy of this run, {why}.")


def _discrete_actions(program: Program, run: Stored) -> Reals:
    """Return L_d of all steps, which are taken again."""
    numbers, header = program.numbers, program.header
    recorder = Recorder("step_cost", header.layout["COST"], rows=1)
    kernels, out = program.kernels, numbers.zeros((run.steps + 1, 1))
    W = workspace(header, numbers, numbers.read(run.parameter_values))
    t, q, p = (np.ascontiguousarray(numbers.read(x)) for x in (run.t, run.q, run.p))
    reached = numbers.driver("replay")(
        kernels.set("newton", (recorder,), again=True),
        (float(run.h), t, W, driver_layout(header, (recorder,))),
        (q, p),
        1,
        True,
        out,
        numbers.read(run.input_values),
    )
    if reached < len(run):
        raise InputError(
            f"{program.system}: the step to t = {float(run.t[reached]):g} could not be taken again."
            "\nTake a smaller step."
        )
    return out[1:, 0]


def _actions(program: Program, run: Stored) -> Reals:
    """Return the actions of Hermite polynomials through the states, by Gauss quadrature."""
    degree = 3 if program.order <= 4 else 5
    places, weights = np.polynomial.legendre.leggauss(NODES[degree])
    h, q, v = run.h, run.q, run.v
    ends = [q[:-1], h * v[:-1], q[1:], h * v[1:]]
    if degree == 5:
        a = h * h * _accelerations(q, v, h)
        ends = [*ends[:2], a[:-1], *ends[2:], a[1:]]
    basis = _hermite(degree)
    total = np.zeros(run.steps)
    for place, weight in zip((places + 1) / 2, weights / 2, strict=True):
        here = sum(b(place) * x for b, x in zip(basis, ends, strict=True))
        slope = sum(b.deriv()(place) * x for b, x in zip(basis, ends, strict=True)) / h
        t = run.t[:-1] + place * h
        states, values = (t, here, slope), run.parameter_values
        L = evaluate(program, "running_cost", "NODE_COST", 1, states, values)
        total += weight * h * L[:, 0]
    return total


def _accelerations(q: Reals, v: Reals, h: Any) -> Reals:
    """Return accelerations at states, of fourth order, from those before and behind."""
    inner = 2 * (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2 - (v[2:] - v[:-2]) / (2 * h)
    one_sided = np.array([-25, 48, -36, 16, -3]) / (12 * h)
    first, last = one_sided @ v[:5], -one_sided @ v[:-6:-1]
    return np.concatenate([first[None], inner, last[None]])


def _hermite(degree: int) -> list[Polynomial]:
    """Return the polynomials for value, slope (and second derivative) at 0, then at 1."""
    count = (degree + 1) // 2
    rows = [
        [Polynomial.basis(k).deriv(m)(place) for k in range(degree + 1)]
        for place in (0, 1)
        for m in range(count)
    ]
    return [Polynomial(column) for column in np.linalg.inv(np.array(rows)).T]
