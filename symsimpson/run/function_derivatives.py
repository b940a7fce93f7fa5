"""Derivatives of a run as a function: its Jacobian matrix, and products with it.

The Jacobian follows from variations that the run carries forward, for all members at once. For
inputs that differ between steps, and for products with its transpose, the discrete adjoint carries
derivatives back from the end of a run to its start.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_array
from symsimpson.program.program import Program
from symsimpson.run.function_arguments import Argument, Output
from symsimpson.run.gradients import Objective, differentiate_back
from symsimpson.run.integrate import integrate
from symsimpson.run.requested import run_at_fixed_times
from symsimpson.run.run_function import FunctionOfRun, FunctionStates, member_of
from symsimpson.run.state_costs import CostDerivatives, StateCost, pull_velocities
from symsimpson.stepping.inputs import program_with_derivatives, read_variables
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Reals

#: Largest number of variations for which they are faster than the adjoint of a single run.
FEW_COLUMNS = 6


@dataclass(frozen=True)
class WeightedOutputs:
    """The sum of all outputs times weights, as a cost of the stored states of one member."""

    outputs: tuple[Output, ...]
    costs: dict[str, list[StateCost]]  #: The components of outputs that are expressions.
    weights: list[Reals]  #: For each output, shape (number of samples, *shape of the output).
    variables: int  #: Number of parameters and inputs by which the program differentiates.

    def slopes(
        self, place: slice, steps: Reals, t: Reals, q: Reals, p: Reals, values: Reals
    ) -> CostDerivatives:
        """Return the derivatives of the weighted sum at the samples ``place``."""
        n = q.shape[1]
        state, parameters = np.zeros((len(q), 2 * n)), np.zeros((len(q), self.variables))
        for output, weights in zip(self.outputs, self.weights, strict=True):
            rows = weights[place]
            if not output.expressions:
                state = state + np.pad(rows, ((0, 0), (0, n) if output.name == "q" else (n, 0)))
                continue
            for k, cost in enumerate(self.costs[output.name]):
                slopes = cost.slopes(steps, t, q, p, values)
                slopes = slopes.times(rows[:, k] if output.shape else rows)
                state = state + slopes.state
                parameters = parameters + slopes.parameters
        return CostDerivatives(0 * t, state, parameters)


class FunctionDerivatives:
    """The derivatives of a function of a run; the class ``RunFunction`` documents them."""

    def __init__(self, function: FunctionOfRun) -> None:
        self.function = function
        self._arguments, self._outputs = function.arguments, function.outputs
        program = function.program
        #: Whether the adjoint carries derivatives back over steps of this run.
        self.has_adjoint = not (
            program.header.retimed or program.modes is not None or function.spec.run_events
        )
        self._by_step = any(argument.by_step for argument in self._arguments)
        names = [x.name for x in self._arguments if not x.of_state]
        self._names = read_variables(program, names)
        if self._by_step and not self.has_adjoint:
            kind = "a time transformation" if program.header.retimed else "events or contacts"
            self._no_derivatives: str | None = f"derivatives by the inputs of steps with {kind}"
        else:
            self._no_derivatives = None
        started = function.spec.velocities and any(x.of_state for x in self._arguments)
        if program.header.retimed and started:
            self._no_derivatives = "derivatives by an initial state with v0 of a retimed system"

    @cached_property
    def _program(self) -> Program:
        """The program with derivatives by the parameters and inputs of the function."""
        if self._no_derivatives is not None:
            reject(
                f"{self._no_derivatives} are not available.",
                where=self.function.program.system,
                remedy="Declare a constant input as a parameter. Start with p0 instead of v0.",
            )
        return program_with_derivatives(self.function.program, self._names)

    @cached_property
    def _costs(self) -> dict[str, list[StateCost]]:
        """The components of outputs that are expressions; raises InputError without derivatives."""
        header, events = self.function.program.header, self.function.spec.run_events
        for text in (x.text for output in self._outputs for x in output.expressions):
            moving = header.canonical and re.search(r"\bv_\d", text)
            timed = events is not None and re.search(r"\bt\b", text)
            if header.retimed or moving or timed:
                reject(
                    "derivatives of this output are not available.",
                    where=self.function.program.system,
                    why="They are missing for expressions of retimed systems, for velocities of a "
                    "Hamiltonian, and for the time with events.",
                    remedy="Use the outputs 'q' and 'p'.",
                )
        return {
            output.name: [
                StateCost(self._program, f"output {output.name}", x) for x in output.expressions
            ]
            for output in self._outputs
            if output.expressions
        }

    # products with the Jacobian; blocks have shape (K, size of the output, size of the argument)

    def jacobian(self, given: tuple[Any, ...]) -> list[list[Reals]]:
        """Return the Jacobian of each output by each argument."""
        spec, members, _ = self.function.read(given)
        rows = () if members is None else (members,)
        return [
            [
                block.reshape((*rows, *shape, *argument.shape))
                for argument, block in zip(self._arguments, blocks, strict=True)
            ]
            for shape, blocks in zip(
                self.function.output_shapes, self._blocks(spec, members), strict=True
            )
        ]

    def pull_back(
        self, given: tuple[Any, ...], cotangents: Sequence[Any]
    ) -> tuple[Sequence[Reals] | None, list[Reals]]:
        """Return the outputs, and the derivatives of their sum times ``cotangents``, by argument.

        The outputs are None if their values were not needed. With few arguments, variations that
        the run carries forward are faster than the adjoint.
        """
        spec, members, values = self.function.read(given)
        weights = self._read_values("cotangents", cotangents, self.function.output_shapes, members)
        columns = 2 * self.function.program.n * any(x.of_state for x in self._arguments)
        few = columns + len(self._parameters) <= FEW_COLUMNS or members is not None
        if self.has_adjoint and (self._by_step or not few):
            outputs: Sequence[Reals] | None = None
            each = [
                self._pull_back_member(member_of(spec, k, members), [x[k] for x in weights])
                for k in range(members or 1)
            ]
            slopes = [np.stack(rows) for rows in zip(*each, strict=True)]
        else:
            outputs, every_block = self._blocks_of_variations(spec, members)
            blocks = zip(*every_block, strict=True)
            flat = [x.reshape(len(x), 1, -1) for x in weights]
            slopes = [
                np.sum([w @ x for w, x in zip(flat, column, strict=True)], axis=0)
                for column in blocks
            ]
        return outputs, self._sum_shared(values, slopes, members)

    def _sum_shared(
        self, values: Sequence[Reals], slopes: Sequence[Reals], members: int | None
    ) -> list[Reals]:
        """Return slopes of members by argument; sum those by arguments that members share."""
        results = []
        for argument, value, slope in zip(self._arguments, values, slopes, strict=True):
            of_members = members is not None and value.ndim > len(argument.shape)
            whole = slope.reshape((-1, *argument.shape))
            results.append(whole if of_members else whole.sum(axis=0))
        return results

    def push_forward(self, given: tuple[Any, ...], tangents: Sequence[Any]) -> list[Reals]:
        """Return the derivatives of all outputs along ``tangents`` of the arguments."""
        spec, members, _ = self.function.read(given)
        shapes = [argument.shape for argument in self._arguments]
        along = self._read_values("tangents", tangents, shapes, members)
        columns = [x.reshape(len(x), -1, 1) for x in along]
        rows = () if members is None else (members,)
        every_block = self._blocks(spec, members)
        return [
            np.sum([x @ v for x, v in zip(blocks, columns, strict=True)], axis=0).reshape(
                (*rows, *shape)
            )
            for shape, blocks in zip(self.function.output_shapes, every_block, strict=True)
        ]

    def curve(
        self, given: tuple[Any, ...], cotangents: Any, tangents: Any
    ) -> tuple[list[Reals], list[Reals]]:
        """Return the result of :meth:`pull_back`, and its derivatives along ``tangents``."""
        program, function = self._program, self.function
        self._check_second_derivatives()
        spec, members, values = function.read(given)
        weights = self._read_values("cotangents", cotangents, function.output_shapes, members)
        shapes = [argument.shape for argument in self._arguments]
        along = self._read_values("tangents", tangents, shapes, members)
        each = []
        for k in range(members or 1):
            member = member_of(spec, k, members)
            run = integrate(program, replace(member, every=1), False)
            jumps = np.zeros((2, member.steps + 1, program.n))
            places = slice(None, None, member.every) if member.every else slice(member.steps, None)
            for output, weight in zip(self._outputs, weights, strict=True):
                jumps["qp".index(output.name), places] += weight[k]
            assert program.tools is not None
            each.append(
                program.tools.second_derivatives(
                    program, member, run, self._arguments, [x[k] for x in along], jumps
                )
            )
        slopes, products = (
            self._sum_shared(values, [np.stack(rows) for rows in zip(*parts, strict=True)], members)
            for parts in zip(*each, strict=True)
        )
        return slopes, products

    def _check_second_derivatives(self) -> None:
        """Raise InputError if the function has no second derivatives."""
        program = self._program
        if not self.has_adjoint or program.header.constraints:
            why = "Runs with constraints, events, contacts or retiming have first derivatives only."
        elif not program.numbers.compiled:
            why = "Runs with many digits have first derivatives only."
        elif any(output.expressions for output in self._outputs):
            why = "Only the outputs 'q' and 'p' have them: pass of=('q', 'p')."
        elif program.header.canonical or "equations" not in program.header.functions:
            why = "Only Lagrangian systems with schemes of the Galerkin family have them."
        elif program.method is None or program.tools is None:
            why = "A module from a file does not contain the expressions of the system."
        else:
            return
        reject("second derivatives are not available.", where=program.system, why=why)

    def _read_values(
        self, name: str, given: Any, shapes: Sequence[tuple[int, ...]], members: int | None
    ) -> list[Reals]:
        """Read an array for each shape; each result has a first axis for the members."""
        what = "output" if name == "cotangents" else "argument"
        if not isinstance(given, (tuple, list)) or len(given) != len(shapes):
            reject(
                f"{name} is not a tuple of {len(shapes)} arrays.",
                remedy=f"Pass one array for each {what}: shapes {', '.join(map(str, shapes))}.",
            )
        read = []
        for value, shape in zip(given, shapes, strict=True):
            array = read_array(name, value, self.function.program.numbers)
            whole = (members or 1, *shape)
            if array.shape not in (shape, whole if members else shape):
                reject(
                    f"{name} has an array of shape {array.shape}, but must have shape "
                    f"{whole if members else shape}.",
                    remedy=f"Pass one array for each {what}, with its shape.",
                )
            read.append(np.broadcast_to(array, whole))
        return read

    def _blocks(self, spec: RunSpec, members: int | None) -> list[list[Reals]]:
        """Return the Jacobian blocks of all outputs, each by all arguments."""
        if not self._by_step:
            return self._blocks_of_variations(spec, members)[1]
        each = [self._rows_of_member(member_of(spec, k, members)) for k in range(members or 1)]
        return [
            [np.stack([x[i][j] for x in each]) for j in range(len(self._arguments))]
            for i in range(len(self._outputs))
        ]

    def _rows_of_member(self, spec: RunSpec) -> list[list[Reals]]:
        """Return the blocks of one member, row by row, from one adjoint sweep for each row."""
        shapes = self.function.output_shapes
        zeros = [np.zeros(shape) for shape in shapes]
        blocks = []
        for i, shape in enumerate(shapes):
            rows = []
            for unit in np.eye(int(np.prod(shape))):
                weights = [*zeros[:i], unit.reshape(shape), *zeros[i + 1 :]]
                rows.append([x.ravel() for x in self._pull_back_member(spec, weights)])
            blocks.append([np.stack(column) for column in zip(*rows, strict=True)])
        return blocks

    def _blocks_of_variations(
        self, spec: RunSpec, members: int | None
    ) -> tuple[Sequence[Reals], list[list[Reals]]]:
        """Return the outputs, and the blocks from variations that the runs carry forward."""
        program, function, n = self._program, self.function, self.function.program.n
        costs = self._costs  # raises before the run if derivatives are missing
        count = 2 * n if any(x.of_state for x in self._arguments) else 0
        varied, run = replace(spec, tangents=np.eye(2 * n)[:, :count]), None
        if function.program.header.retimed:
            program = function.program

            def run(member: RunSpec, on_failure: str) -> Any:
                of_tau = member.t_end is None
                given = program, member, self._names, False, on_failure
                return run_at_fixed_times(*given, fixed_steps=of_tau)

        states = function.states(program, varied, members, run=run)
        assert states.variations is not None
        shape = members or 1, function.stored, 2 * n, -1
        changes = states.variations.reshape(shape)
        if spec.velocities and count:
            starts = [self._start_slopes(member_of(spec, k, members)) for k in range(members or 1)]
            changes[..., :count] = changes[..., :count] @ np.stack(starts)[:, None]
        columns, first = [], count
        for argument in self._arguments:
            if argument.of_state:
                columns.append(slice(n) if argument.kind == "q" else slice(n, 2 * n))
            else:
                columns.append(slice(first, first + 1))
                first += 1
        outputs = function.outputs_of(states.t, states.q, states.p, spec.parameters)
        by_output = self._output_changes(costs, states, spec, members, changes, count)
        return outputs, [
            [x[..., column].reshape(len(x), -1, x[0, ..., column].shape[-1]) for column in columns]
            for x in by_output
        ]

    def _start_slopes(self, spec: RunSpec) -> Reals:
        """Return the derivatives of (q0, p0) by (q0, v0) at the start of one member."""
        program, n = self._program, self.function.program.n
        start = self.function.run_without_steps(spec)
        q, p = (np.repeat(x[None], 2 * n, axis=0) for x in start)
        times = np.full(2 * n, float(spec.t0))
        return pull_velocities(program, times, q, p, np.eye(2 * n), spec.parameters)[0]

    def _output_changes(
        self,
        costs: dict[str, list[StateCost]],
        states: FunctionStates,
        spec: RunSpec,
        members: int | None,
        changes: Reals,
        count: int,
    ) -> list[Reals]:
        """Convert changes of states to changes of outputs, shape (K, M, ..., k)."""
        n, results = self.function.program.n, []
        shape = len(changes), self.function.stored
        t = np.broadcast_to(np.reshape(states.t, (-1, shape[1])), shape)
        q, p = (x.reshape(*shape, n) for x in (states.q, states.p))
        steps = np.arange(shape[1]) * float(spec.every) if spec.every else np.array([spec.steps])
        for output in self._outputs:
            if not output.expressions:
                results.append(changes[:, :, :n] if output.name == "q" else changes[:, :, n:])
                continue
            rows = np.zeros((*shape, len(output.expressions), changes.shape[-1]))
            for k in range(len(changes)):
                values = member_of(spec, k, members).parameters
                for c, cost in enumerate(costs[output.name]):
                    slopes = cost.slopes(1.0 * steps, t[k], q[k], p[k], values)
                    rows[k, :, c] = (slopes.state[:, None] @ changes[k])[:, 0]
                    rows[k, :, c, count:] += slopes.parameters
            results.append(rows if output.shape else rows[:, :, 0])
        return results

    def _pull_back_member(self, spec: RunSpec, weights: Sequence[Reals]) -> list[Reals]:
        """Return the derivatives of the weighted sum of the outputs of one member."""
        program, n = self._program, self.function.program.n
        if not spec.every:  # the samples are the initial and the final state
            first = [np.zeros_like(x) for x in weights] if spec.steps else []
            weights = [np.stack([*first[i : i + 1], x]) for i, x in enumerate(weights)]
        sample = WeightedOutputs(self._outputs, self._costs, list(weights), len(self._names))
        every = spec.every or max(spec.steps, 1)
        inputs = [j for j, x in enumerate(self._parameters) if x.kind == "input"]
        _, by_state, by_parameter, by_step = differentiate_back(
            program, spec, Objective(None, (sample,), every), inputs, False
        )
        results = []
        for argument in self._arguments:
            if argument.of_state:
                results.append(by_state[:n] if argument.kind == "q" else by_state[n:])
                continue
            place = self._parameters.index(argument)
            if argument.kind == "input":
                results.append(argument.gather(by_step[:, inputs.index(place)]))
            else:
                results.append(by_parameter[place])
        return results

    @cached_property
    def _parameters(self) -> list[Argument]:
        """The arguments that are no part of the state, in the order of the program's names."""
        return [argument for argument in self._arguments if not argument.of_state]
