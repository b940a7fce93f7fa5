"""The gradient of a cost of a run, by derivatives that are carried back along it."""

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
from symsimpson.run.ended import raise_failure, trajectory_of
from symsimpson.run.integrate import integrate, started
from symsimpson.run.resolution import real_energies
from symsimpson.run.state_costs import Measured, StateCost, pull_velocities, read_samples
from symsimpson.stepping.driving import Samples, given_inputs, steps_a_period
from symsimpson.stepping.inputs import read_varied, refuse_retimed, varied_program
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Ints, Reals
from symsimpson.support.names import spelled

#: Records of all steps are kept where they have no more numbers than this: 64 MB.
RECORDED = 8_000_000


@dataclass(frozen=True)
class Objective:
    """The objective of a run: costs of its last state and of samples on the way."""

    end: StateCost | None  #: A cost of the last state.
    #: Each costs the sum of the squares by which the run differs from it.
    samples: tuple[Measured, ...]
    every: int  #: Steps between samples.


def differentiate_back(
    program: Program,
    spec: RunSpec,
    objective: Objective,
    inputs: Sequence[int],
    progress: bool | None,
) -> tuple[Any, Reals, Reals, Reals]:
    """Run, and carry the derivatives of the cost back to the start.

    The program differentiates its steps; ``inputs`` are the numbers of the inputs among what is
    varied. Returned are the cost and its derivatives: by q0 and p0, or v0 if the run begins with
    velocities, shape (2 n,); by what is varied, shape (k,); by inputs in each step and node, shape
    (N, k, s) or (N, k, 1). Raises InputError, ConvergenceError or Interrupted, as a run does.
    """
    numbers = program.numbers
    with numbers.working():
        way = Way(program, spec, progress)
        back = _Back(program, spec, objective, inputs)
        back.leave_end(way)
        for first, records, q, p in way.segments():
            back.carry(first, records, q, p)
        return back.arrived(way)


class Way:
    """The way there: a run that was made, and can be made again from places on it."""

    def __init__(self, program: Program, spec: RunSpec, progress: bool | None) -> None:
        header, count = program.header, spec.steps
        recorder = tape(header)
        whole = count * recorder.rows <= RECORDED
        self.piece = max(1, count if whole else isqrt(count))
        self._count = count
        self._run = run = started(program, spec, 1, self.piece + 1, recorders=(recorder,))
        self.q0, self.p0 = run.begun[1]
        self._places: list[tuple[list[int], Reals]] = []
        left = False
        with run.watched(count, progress):
            while run.step < count and run.alive:
                if run.step:
                    run.forget()
                self._places.append((run.position(), run.W[:, 0].copy()))
                run.advance(min(run.step + self.piece, count))
                left = left or _leaves_domain(program, run)
        if run.status is not Status.SUCCESS:
            trajectory = trajectory_of(program, run, count, run.status, spec, run.stored(), 0)
            raise_failure(run, trajectory, trajectory)
        if left:  # a run of the same steps tells after which of them, with the states before
            integrate(program, replace(spec, every=1))
        self.q1, self.p1 = (run.rows(x, program.n).copy() for x in ("POSITION", "MOMENTUM"))

    def segments(self) -> Iterator[tuple[int, Reals, Reals, Reals]]:
        """Go back over the segments: the number of the first step, records, and states."""
        run = self._run
        for i, (position, kept) in reversed(list(enumerate(self._places))):
            first = i * self.piece
            last = min(first + self.piece, self._count)
            if last < self._count:  # the last one is still there
                run.put_back(position, kept)
                run.store(0)
                run.advance(last)
            yield first, run.recorded[: last - first + 1], *run.stored()[:2]


def _leaves_domain(program: Program, run: Run) -> bool:
    """Return whether the energy is no finite number at one of the states in the arrays of a run."""
    if program.header.real_everywhere:
        return False
    q, p, *_ = run.stored()
    t = run.t0 + run.h * program.numbers.counted(run.step + 1 - len(q), run.step + 1, 1)
    return not real_energies(program, (t, q, p), run.parameters).all()


class _Back:
    """The way back: derivatives of the cost by the state, and what they give on the way."""

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
        #: Those through nodes, in all, and what rounding has taken from the sums.
        self._totals = numbers.zeros((2, varied * self._nodes))
        places = np.arange(varied * self._nodes).reshape(varied, self._nodes)
        self._chosen = places[list(inputs)].ravel()
        held = self._nodes if spec.inputs.shape[2] > 1 else 1
        self._by_step = numbers.zeros((spec.steps, len(inputs), held))

    def _rows(self, block: str, count: int) -> Reals:
        first = self.program.header.layout[block]
        return self._W[first : first + count, 0]

    def leave_end(self, way: Way) -> None:
        """Begin with the cost of the last state."""
        cost, spec = self._objective.end, self._spec
        if cost is None:
            return
        numbers = self.program.numbers
        steps = numbers.read([spec.steps])
        ends = spec.t0 + spec.h * steps, way.q1[None], way.p1[None]
        slopes = cost.slopes(steps, *ends, spec.parameters)
        self._value = self._value + slopes.value[0]
        self._state += slopes.state[0]
        self._parameters = self._parameters + slopes.parameters[0]

    def carry(self, first: int, records: Reals, q: Reals, p: Reals) -> None:
        """Go back over the steps of a segment."""
        spec, count = self._spec, len(records) - 1
        header, numbers = self.program.header, self.program.numbers
        slopes = numbers.zeros((count, len(self._chosen)))
        jumps = self._jumps(first, q, p)
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
        held = self._by_step.shape[2] < self._nodes
        self._by_step[first : first + count] = (
            by_node.sum(axis=2, keepdims=True) if held else by_node
        )

    def _jumps(self, first: int, q: Reals, p: Reals) -> Reals:
        """Return what samples add at the states behind the steps of a segment, (count, 2 n)."""
        every, numbers = self._objective.every, self.program.numbers
        if not self._objective.samples:
            return numbers.zeros((0, 0))
        jumps = numbers.zeros((len(q) - 1, 2 * self.program.n))
        numbered = np.arange(first + 1, first + len(q))
        here = np.flatnonzero(numbered % every == 0)
        if here.size:
            jumps[here] = self._sampled(numbered[here] // every, q[here + 1], p[here + 1])
        return jumps

    def _sampled(self, places: Ints, q: Reals, p: Reals) -> Reals:
        """Add the samples at some states to the cost; return its derivatives by these states."""
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

    def arrived(self, way: Way) -> tuple[Any, Reals, Reals, Reals]:
        """Return the cost and its derivatives at the start."""
        spec, numbers = self._spec, self.program.numbers
        q0, p0 = way.q0[None], way.p0[None]
        if self._objective.samples:
            self._state += self._sampled(np.zeros(1, dtype=np.int64), q0, p0)[0]
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


#: The initial state, by what was given of it.
STATE = {"q": "q", "v": "v", "p": "p", "q0": "q", "v0": "v", "p0": "p"}


@dataclass(frozen=True)
class Wanted:
    """A cost, and what to differentiate it by."""

    #: Expressions of the last state, and along the path.
    cost: Any
    running: Any
    samples: Mapping[Any, Any] | None  #: Values, by expression.
    every: Any  #: Steps between samples.
    wrt: Sequence[Any]  #: Names or symbols.


def gradient_of(
    program: Program, request: Request, wanted: Wanted, progress: bool | None
) -> Gradient:
    """Return the cost of a run and its derivatives.

    Raises InputError, ConvergenceError or Interrupted.
    """
    refuse_retimed(program, "gradients of costs")
    several = isinstance(wanted.wrt, (tuple, list, set, frozenset))
    variables: Sequence[Any] = list(wanted.wrt) if several else [wanted.wrt]
    pairs = [(spelled(x), _is_state(program, x)) for x in variables]
    names = [name for name, state in pairs if not state]
    _check(wanted, pairs, velocities=request.v0 is not None)
    running = wanted.running
    # tables of others have an iterator, matrices of SymPy but a shape
    several = hasattr(running, "__iter__") or bool(getattr(running, "shape", False))
    if several and not isinstance(running, str):
        reject(
            f"running is a {type(running).__name__}, not one expression.",
            remedy="Add up what costs.",
        )
    if "h" in names and _moves(running) and program.names.parameters.place("h") is None:
        reject(
            "running= contains the time, and h moves the times of all steps of a run.",
            remedy="Leave h out of wrt, or write the cost without the time.",
        )
    program = varied_program(program, read_varied(program, names), running)
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
    given = given_inputs(program, request.inputs) if of_inputs else {}
    n, parts = program.n, {}
    for name, state in pairs:
        if state:
            parts[name] = by_state[:n] if STATE[name] == "q" else by_state[n:]
            continue
        varied_name = varied[names.index(name)]
        if varied_name in header.inputs:
            slopes = by_step[:, of_inputs.index(names.index(name))]
            key = program.inputs[header.inputs.index(varied_name)]
            parts[name] = _of_input(key, slopes, given[key], spec, program.numbers)
        else:
            parts[name] = np.asarray(by_parameter[names.index(name)])
    return Gradient(cost, parts)


def _moves(running: Any) -> bool:
    """Return whether the time stands in a cost along the path."""
    if not hasattr(running, "xreplace"):
        return re.search(r"\bt\b", str(running)) is not None
    from sympy import Derivative, Dummy, Symbol  # SymPy is there by now
    from sympy.core.function import AppliedUndef

    moved = running.xreplace({x: Dummy() for x in running.atoms(Derivative)})
    moved = moved.xreplace({x: Dummy() for x in moved.atoms(AppliedUndef)})
    return Symbol("t") in moved.free_symbols


def _is_state(program: Program, variable: Any) -> bool:
    """Return whether a variable is the initial state: a text, or no symbol of a parameter."""
    names, key = program.names, spelled(variable)
    known = names.parameters.place(key) is not None or names.inputs.place(key) is not None
    return key in STATE and not (known and (key.endswith("0") or not isinstance(variable, str)))


def _check(wanted: Wanted, pairs: Sequence[tuple[str, bool]], *, velocities: bool) -> None:
    """Refuse a cost of nothing, and derivatives by a state that was not given."""
    none = wanted.samples is None or (isinstance(wanted.samples, Mapping) and not wanted.samples)
    if wanted.cost is None and wanted.running is None and none:
        reject(
            "there is no cost to differentiate.",
            remedy="Pass cost= of the last state, running= along "
            "the path, or samples= that the run is to come near to.",
        )
    if not pairs:
        reject("wrt is empty.", remedy="Name what to differentiate by: wrt=('q', 'l1').")
    wrong, right = ("p", "v") if velocities else ("v", "p")
    of_state = [STATE[name] for name, state in pairs if state]
    if wrong in of_state:
        reject(
            f"wrt names {wrong!r}, and the run begins with {right}0.",
            remedy=f"Pass {wrong}0, or differentiate by {right!r}.",
        )
    if len({STATE[name] if state else name for name, state in pairs}) < len(pairs):
        reject(
            f"wrt is {', '.join(name for name, _ in pairs)}.",
            remedy="Name each only once, and what has a name of the state in a call of its own.",
        )


def _of_input(name: str, slopes: Reals, given: Any, spec: RunSpec, numbers: Numbers) -> Reals:
    """Bring the derivatives through steps and nodes, shape (N, s), into the shape of an input."""
    if isinstance(given, Samples):
        values = np.asarray(given.values)
        if not values.ndim:
            return np.asarray(slopes.sum())
        starts = np.arange(0, spec.steps, steps_a_period(name, given.period, spec.h, numbers))
        by_sample = 0 * np.resize(slopes[0], values.shape)
        by_sample[: starts.size] = np.add.reduceat(slopes.sum(axis=1), starts)
        return by_sample
    shape = slopes.shape if callable(given) else np.shape(given)
    if not shape:
        return np.asarray(slopes.sum())
    derivatives = slopes if slopes.size == np.prod(shape) else slopes.sum(axis=1)
    return derivatives.reshape(shape)
