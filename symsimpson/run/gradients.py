"""Gradients of costs of a run by the adjoint method."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isqrt
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count
from symsimpson.program.numbers import Numbers, workspace
from symsimpson.program.program import Program
from symsimpson.program.recorders import tape
from symsimpson.program.status import Status
from symsimpson.results.motion_derivatives import Gradient
from symsimpson.run.ended import make_trajectory, raise_failure
from symsimpson.run.integrate import integrate, start_run
from symsimpson.run.resolution import real_energies
from symsimpson.run.state_costs import CostOfSamples, StateCost, pull_velocities, read_samples
from symsimpson.stepping.driving import Samples, collect_inputs, count_steps_per_period
from symsimpson.stepping.inputs import program_with_derivatives, read_variables, reject_retimed
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Ints, Reals
from symsimpson.support.names import spelled

#: Largest size of the records of all steps in numbers (64 MB); longer runs use checkpoints.
MOST_RECORDED = 8_000_000


@dataclass(frozen=True)
class Objective:
    """Objective of a run: a cost of the final state, and squared deviations from samples."""

    end: StateCost | None  #: Cost of the final state.
    #: Costs of samples of the states. The cost of measurements is the sum of squared deviations.
    samples: tuple[CostOfSamples, ...]
    every: int  #: Number of steps between samples.


def differentiate_back(
    program: Program,
    spec: RunSpec,
    objective: Objective,
    inputs: Sequence[int],
    progress: bool | None,
) -> tuple[Any, Reals, Reals, Reals]:
    """Run forward, and propagate the derivatives of the cost back to the initial state.

    The program must have derivatives of its steps. ``inputs`` are the indices of the inputs among
    the differentiation variables. Return the cost and three derivatives:

    - by q0 and p0, or by q0 and v0 if the run starts with velocities, shape (2 n,);
    - by the variables, shape (k,);
    - by inputs at each step and node, shape (N, k, s) or (N, k, 1).

    Raises InputError, ConvergenceError or Interrupted.
    """
    numbers = program.numbers
    with numbers.working():
        forward = ForwardRun(program, spec, progress)
        back = _AdjointSweep(program, spec, objective, inputs)
        back.start_at_end(forward)
        for first, records, q, p in forward.segments():
            back.carry_back(first, records, q, p)
        return back.derivatives_at_start(forward)


class ForwardRun:
    """A forward run that can be recomputed from its checkpoints, segment by segment."""

    def __init__(self, program: Program, spec: RunSpec, progress: bool | None) -> None:
        header, count = program.header, spec.steps
        recorder = tape(header)
        whole = count * recorder.rows <= MOST_RECORDED
        self.piece = max(1, count if whole else isqrt(count))
        self._count = count
        self._run = run = start_run(program, spec, 1, self.piece + 1, recorders=(recorder,))
        self.q0, self.p0 = run.begun[1]
        self._checkpoints: list[tuple[list[int], Reals]] = []
        outside = False
        with run.watched(count, progress):
            while run.step < count and run.alive:
                if run.step:
                    run.discard_stored()
                self._checkpoints.append((run.position(), run.W[:, 0].copy()))
                run.advance(min(run.step + self.piece, count))
                outside = outside or _leaves_domain(program, run)
        if run.status is not Status.SUCCESS:
            trajectory = make_trajectory(
                program, run, count, run.status, spec, run.stored_states(), 0
            )
            raise_failure(run, trajectory, trajectory)
        if outside:  # an ordinary run raises the error, with the step and the states before it
            integrate(program, replace(spec, every=1))
        self.q1, self.p1 = (run.rows(x, program.n).copy() for x in ("POSITION", "MOMENTUM"))

    def segments(self) -> Iterator[tuple[int, Reals, Reals, Reals]]:
        """Yield the segments from last to first: number of the first step, records, q and p."""
        run = self._run
        for i, (position, column) in reversed(list(enumerate(self._checkpoints))):
            first = i * self.piece
            last = min(first + self.piece, self._count)
            if last < self._count:  # the last segment is still in the arrays
                run.restore(position, column)
                run.store(0)
                run.advance(last)
            yield first, run.recorded[: last - first + 1], *run.stored_states()[:2]


def _leaves_domain(program: Program, run: Run) -> bool:
    """Return whether the energy is not finite at one of the stored states of a run."""
    if program.header.real_everywhere:
        return False
    q, p, *_ = run.stored_states()
    t = run.t0 + run.h * program.numbers.counted(run.step + 1 - len(q), run.step + 1, 1)
    return not real_energies(program, (t, q, p), run.parameters).all()


class _AdjointSweep:
    """Adjoint sweep: derivatives of the cost by the state, from the end of a run to its start.

    On the way it accumulates the derivatives by parameters and inputs.
    """

    def __init__(
        self, program: Program, spec: RunSpec, objective: Objective, inputs: Sequence[int]
    ) -> None:
        header, numbers = program.header, program.numbers
        self.program, self._spec, self._objective = program, spec, objective
        self._kernels = list(map(program.kernels.address, ("prepare", "adjoint")))
        self._W = workspace(header, numbers, spec.parameters)
        varied, self._nodes = len(header.varied_by or ()), header.nodes
        self._value = numbers.zeros(())[()]
        self._state = self._rows("ADJOINT", 2 * program.n)
        self._parameters = numbers.zeros(varied)
        #: Derivatives by variables at each node, summed over steps; then their round-off terms.
        self._totals = numbers.zeros((2, varied * self._nodes))
        places = np.arange(varied * self._nodes).reshape(varied, self._nodes)
        self._chosen = places[list(inputs)].ravel()
        columns = self._nodes if spec.inputs.shape[2] > 1 else 1
        self._by_step = numbers.zeros((spec.steps, len(inputs), columns))

    def _rows(self, block: str, count: int) -> Reals:
        first = self.program.header.layout[block]
        return self._W[first : first + count, 0]

    def start_at_end(self, forward: ForwardRun) -> None:
        """Start with the derivatives of the cost of the final state."""
        cost, spec = self._objective.end, self._spec
        if cost is None:
            return
        numbers = self.program.numbers
        steps = numbers.read([spec.steps])
        ends = spec.t0 + spec.h * steps, forward.q1[None], forward.p1[None]
        slopes = cost.slopes(steps, *ends, spec.parameters)
        self._value = self._value + slopes.value[0]
        self._state += slopes.state[0]
        self._parameters = self._parameters + slopes.parameters[0]

    def carry_back(self, first: int, records: Reals, q: Reals, p: Reals) -> None:
        """Propagate the derivatives back over the steps of a segment."""
        spec, count = self._spec, len(records) - 1
        header, numbers = self.program.header, self.program.numbers
        slopes = numbers.zeros((count, len(self._chosen)))
        jumps = self._sample_slopes(first, q, p)
        numbers.driver("carry_back")(
            tuple(self._kernels),
            (spec.h, spec.t0, self._W, header.driver_layout),
            (header.layout["ADJOINT"], header.layout["COST_SLOPE"]),
            first,
            (records, jumps, spec.inputs),
            self._totals,
            self._chosen,
            slopes,
        )
        by_node = slopes.reshape(count, len(self._chosen) // self._nodes, self._nodes)
        if self._by_step.shape[2] < self._nodes:  # inputs are constant over each step
            by_node = by_node.sum(axis=2, keepdims=True)
        self._by_step[first : first + count] = by_node

    def _sample_slopes(self, first: int, q: Reals, p: Reals) -> Reals:
        """Return the derivatives of sample costs by the state after each step, (count, 2 n)."""
        every, numbers = self._objective.every, self.program.numbers
        if not self._objective.samples:
            return numbers.zeros((0, 0))
        jumps = numbers.zeros((len(q) - 1, 2 * self.program.n))
        numbered = np.arange(first + 1, first + len(q))
        here = np.flatnonzero(numbered % every == 0)
        if here.size:
            jumps[here] = self._add_samples(numbered[here] // every, q[here + 1], p[here + 1])
        return jumps

    def _add_samples(self, places: Ints, q: Reals, p: Reals) -> Reals:
        """Add the sample costs at some states; return their derivatives by these states."""
        spec, numbers = self._spec, self.program.numbers
        steps = numbers.read(places * self._objective.every)
        states, some = (spec.t0 + steps * spec.h, q, p), slice(places[0], places[-1] + 1)
        by_state = numbers.zeros((len(places), 2 * self.program.n))
        for samples in self._objective.samples:
            slopes = samples.slopes(some, steps, *states, spec.parameters)
            self._value = self._value + slopes.value.sum()
            self._parameters = self._parameters + slopes.parameters.sum(axis=0)
            by_state = by_state + slopes.state
        return by_state

    def derivatives_at_start(self, forward: ForwardRun) -> tuple[Any, Reals, Reals, Reals]:
        """Return the cost and its derivatives at the initial state."""
        spec, numbers = self._spec, self.program.numbers
        q0, p0 = forward.q0[None], forward.p0[None]
        if self._objective.samples:
            self._state += self._add_samples(np.zeros(1, dtype=np.int64), q0, p0)[0]
        state = self._state.copy()
        totals = self._totals[0] + self._totals[1]
        through_nodes = totals.reshape(len(self._parameters), self._nodes)
        parameters = self._parameters + through_nodes.sum(axis=1)
        if spec.velocities:
            t = numbers.read([spec.t0])
            pulled, further = pull_velocities(self.program, t, q0, p0, state[None], spec.parameters)
            state, parameters = pulled[0], parameters + further[0]
        if "COST" in self.program.header.layout:
            self._value = self._value + self._rows("COST", 1)[0]
        result = numbers.result
        value = numbers.single(self._value)
        return value, result(state), result(parameters), result(self._by_step)


#: Accepted names of the parts of the initial state.
STATE = {"q": "q", "v": "v", "p": "p", "q0": "q", "v0": "v", "p0": "p"}


@dataclass(frozen=True)
class GradientArguments:
    """Arguments of a gradient: a cost, and the variables to differentiate by."""

    cost: Any  #: Expression of the final state.
    running: Any  #: Expression that is integrated along the path.
    samples: Mapping[Any, Any] | None  #: Measured values by expression.
    every: Any  #: Number of steps between samples.
    wrt: Sequence[Any]  #: Names or symbols.


def gradient_of(
    program: Program, request: Request, wanted: GradientArguments, progress: bool | None
) -> Gradient:
    """Return the cost of a run and its derivatives.

    Raises InputError, ConvergenceError or Interrupted.
    """
    reject_retimed(program, "gradients of costs")
    several = isinstance(wanted.wrt, (tuple, list, set, frozenset))
    variables: Sequence[Any] = list(wanted.wrt) if several else [wanted.wrt]
    pairs = [(spelled(x), is_state(program, x)) for x in variables]
    names = [name for name, state in pairs if not state]
    _check_gradient_arguments(wanted, pairs, velocities=request.v0 is not None)
    running = wanted.running
    # arrays have an iterator, matrices of SymPy only a shape
    several = hasattr(running, "__iter__") or bool(getattr(running, "shape", False))
    if several and not isinstance(running, str):
        reject(
            f"running is a {type(running).__name__}, not one expression.",
            remedy="Pass the sum of the costs as a single expression.",
        )
    if "h" in names and _contains_time(running) and program.names.parameters.place("h") is None:
        reject(
            "running= contains the time, so a run cannot be differentiated by h.",
            why="A change of h moves the times of all steps.",
            remedy="Remove h from wrt, or write the cost without the time.",
        )
    program = program_with_derivatives(
        program, read_variables(program, names, adjoint=True), running
    )
    spec = read_run(program, request)
    every = read_count("every", wanted.every, least=1)
    samples = read_samples(program, wanted.samples, spec.steps, every)
    end = None if wanted.cost is None else StateCost(program, "cost", wanted.cost)
    objective = Objective(end, samples, every)
    header = program.header
    varied = header.varied_by or ()
    of_inputs = [j for j, name in enumerate(varied) if name in header.inputs]
    cost, by_state, by_parameter, by_step = differentiate_back(
        program, spec, objective, of_inputs, progress
    )
    input_value = collect_inputs(program, request.inputs) if of_inputs else {}
    n, parts = program.n, {}
    for name, state in pairs:
        if state:
            parts[name] = by_state[:n] if STATE[name] == "q" else by_state[n:]
            continue
        varied_name = varied[names.index(name)]
        if varied_name in header.inputs:
            slopes = by_step[:, of_inputs.index(names.index(name))]
            key = program.inputs[header.inputs.index(varied_name)]
            parts[name] = _reshape_to_input(key, slopes, input_value[key], spec, program.numbers)
        else:
            parts[name] = np.asarray(by_parameter[names.index(name)])
    return Gradient(cost, parts)


def _contains_time(running: Any) -> bool:
    """Return whether a running cost contains the time t explicitly."""
    if not hasattr(running, "xreplace"):
        return re.search(r"\bt\b", str(running)) is not None
    from sympy import Derivative, Dummy, Symbol  # SymPy is loaded by now
    from sympy.core.function import AppliedUndef

    moved = running.xreplace({x: Dummy() for x in running.atoms(Derivative)})
    moved = moved.xreplace({x: Dummy() for x in moved.atoms(AppliedUndef)})
    return Symbol("t") in moved.free_symbols


def is_state(program: Program, variable: Any) -> bool:
    """Return whether a variable is part of the initial state, and not a parameter or input."""
    names, key = program.names, spelled(variable)
    known = names.parameters.place(key) is not None or names.inputs.place(key) is not None
    return key in STATE and not (known and (key.endswith("0") or not isinstance(variable, str)))


def _check_gradient_arguments(
    wanted: GradientArguments, pairs: Sequence[tuple[str, bool]], *, velocities: bool
) -> None:
    """Reject a missing cost, missing or repeated variables, and the wrong one of v and p."""
    none = wanted.samples is None or (isinstance(wanted.samples, Mapping) and not wanted.samples)
    if wanted.cost is None and wanted.running is None and none:
        reject(
            "there is no cost to differentiate.",
            remedy="Pass cost= of the final state, running= along the path, or samples= that the "
            "run should match.",
        )
    if not pairs:
        reject("wrt is empty.", remedy="Pass the variables of the gradient: wrt=('q', 'l1').")
    wrong, right = ("p", "v") if velocities else ("v", "p")
    of_state = [STATE[name] for name, state in pairs if state]
    if wrong in of_state:
        reject(
            f"wrt contains {wrong!r}, but the run starts with {right}0.",
            remedy=f"Pass {wrong}0, or differentiate by {right!r}.",
        )
    if len({STATE[name] if state else name for name, state in pairs}) < len(pairs):
        reject(
            f"wrt contains a variable twice: {', '.join(name for name, _ in pairs)}.",
            remedy="Pass each variable once. If a parameter has a name of the state, "
            "differentiate by it in a separate call.",
        )


def _reshape_to_input(
    name: str, slopes: Reals, input_value: Any, spec: RunSpec, numbers: Numbers
) -> Reals:
    """Convert derivatives by values at nodes, shape (N, s), to the shape of the user's input."""
    if isinstance(input_value, Samples):
        values = np.asarray(input_value.values)
        if not values.ndim:
            return np.asarray(slopes.sum())
        starts = np.arange(
            0, spec.steps, count_steps_per_period(name, input_value.period, spec.h, numbers)
        )
        by_sample = 0 * np.resize(slopes[0], values.shape)
        by_sample[: starts.size] = np.add.reduceat(slopes.sum(axis=1), starts)
        return by_sample
    shape = slopes.shape if callable(input_value) else np.shape(input_value)
    if not shape:
        return np.asarray(slopes.sum())
    derivatives = slopes if slopes.size == np.prod(shape) else slopes.sum(axis=1)
    return derivatives.reshape(shape)
