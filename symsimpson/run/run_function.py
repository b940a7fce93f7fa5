"""A run as a function: its arguments, its outputs, and its evaluation for one or many members."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from symsimpson.errors import ResolutionWarning, reject
from symsimpson.program.configuration import available_threads, lanes_for
from symsimpson.program.evaluation import StateEvaluator, make_evaluator
from symsimpson.program.observed import observing_kernel
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.run.ensemble.dispatch import run_spec
from symsimpson.run.ensemble.ensemble import Ensemble
from symsimpson.run.ensemble.members import EnsembleSpec
from symsimpson.run.function_arguments import as_list, read_arguments, read_output, read_template
from symsimpson.run.integrate import integrate
from symsimpson.run.short_runs import BriefRequest, ShortCall, run_prepared
from symsimpson.stepping.constrained_start import project_start
from symsimpson.stepping.request import Request
from symsimpson.stepping.run_events import read_run_events
from symsimpson.stepping.spec import RunSpec, event_names
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import warn


@dataclass(frozen=True)
class FunctionStates:
    """Stored states of K members, or of one member without the first axis, and their values."""

    t: Reals
    q: Reals
    p: Reals
    status: Any  #: Status of the run, or the statuses of all members.
    #: Variations (dq, dp) of the states, shape (..., 2 n, k), if the run has variations.
    variations: Reals | None = None


class FunctionOfRun:
    """The evaluation of a run as a function. The class ``RunFunction`` documents the arguments.

    Nothing changes after the first call, except for the pool of workspaces. Threads may use it at
    the same time.
    """

    def __init__(
        self, program: Program, request: Request, of: Any, wrt: Any, threads: int | None
    ) -> None:
        self.program, self.request, self.threads = program, request, threads
        names, several = as_list(wrt)
        self.several_arguments = several
        template, spec = read_template(program, request, names)
        self.spec = spec
        self.arguments = read_arguments(program, template, spec, names)
        listed, self.several_outputs = as_list(of)
        self.outputs = tuple(read_output(program, x) for x in listed)
        if not self.outputs:
            reject("of is empty.", remedy="Pass the outputs of the function: of=('q', 'p').")
        #: Number of stored states of one member, and whether outputs have an axis for them.
        self.stored, self.by_state = spec.stored, bool(spec.every)
        if spec.every and spec.t_end is not None:
            reject(
                "every= is not available for a retimed system with t_end.",
                where=program.system,
                why="The number of its states is unknown.",
                remedy="Use every=None, or pass steps= instead of t_end=.",
            )
        self._checked = list[bool]()  # whether a run has checked the step size
        self._pool = list[ShortCall]()
        plain = program.modes is None and spec.run_events is None and spec.t_end is None
        plain = plain and program.numbers.compiled and program.header.real_everywhere
        self._short = plain and not program.header.constraints and not program.header.retimed
        self._short = self._short and all(x.is_plain for x in self.arguments)
        self._short = self._short and spec.steps <= ShortCall.longest(program)
        self._observed = [x for output in self.outputs for x in output.expressions]
        count = np.arange(spec.stored) * spec.every if spec.every else np.asarray(spec.steps)
        self._times: Reals = spec.t0 + spec.h * program.numbers.read(count)
        #: For each output 0 for q or 1 for p; None if an output is an expression.
        self._places: tuple[int, ...] | None = None
        if not self._observed:
            self._places = tuple("qp".index(output.name) for output in self.outputs)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without workspaces, whose arrays share memory."""
        return self.__dict__ | {"_pool": [], "_checked": []}

    # one member, in a prepared workspace

    def call(self, arguments: tuple[Any, ...]) -> Any:
        """Evaluate for one member in a prepared workspace.

        Return None if an argument needs conversion or an error message, if the arguments have
        members, or if the run fails. Then :meth:`evaluate` does the same in the usual way.
        """
        if not self._checked or not self._short:
            return None
        try:
            short = self._pool.pop()
        except IndexError:
            short = ShortCall(self.program, self.spec, self.arguments)
        results: Any = short.run(arguments)
        if results is not None and self._places is None:
            q, p = results
            results = self._short_outputs(short, q, p)
        self._pool.append(short)
        if results is None or self._places is None or self._places == (0, 1):
            return results
        return tuple([results[place] for place in self._places])

    @property
    def output_shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the outputs of one member."""
        states = (self.stored,) if self.by_state else ()
        return [(*states, *output.shape) for output in self.outputs]

    def run_without_steps(self, spec: RunSpec) -> tuple[Reals, Reals]:
        """Return q0 and p0 of one member."""
        begun = integrate(self.program, replace(spec, steps=0, every=1, t_end=None), False)
        return begun.q[0], begun.p[0]

    def values(self, arguments: tuple[Any, ...]) -> Sequence[Reals]:
        """Evaluate for one or many members; a failed run raises ConvergenceError."""
        results = self.call(arguments)
        return self.evaluate(arguments, raising=True)[0] if results is None else results

    # one or many members, as stepper.integrate and stepper.ensemble run them

    def evaluate(
        self, arguments: tuple[Any, ...], *, raising: bool
    ) -> tuple[tuple[Reals, ...], Any]:
        """Evaluate for one or many members; return the outputs, and the status or statuses.

        With ``raising``, a failed run raises ConvergenceError. Failed members are NaN, and a
        warning tells their number.
        """
        spec, members, values = self.read(arguments)
        if members is None and (converted := self.call(tuple(values))) is not None:
            return converted, Status.SUCCESS
        states = self.states(self.program, spec, members, raising=raising)
        self._checked[:] = [True]
        if members is not None and raising and (failed := int((states.status != 0).sum())):
            warn(
                f"{self.program.system}, {self.program.scheme}: {failed} of {members} members "
                "failed, and their values are NaN.\nPass full=True for their statuses.",
                ResolutionWarning,
            )
        outputs = self.outputs_of(states.t, states.q, states.p, spec.parameters)
        return outputs, states.status

    def read(self, given: tuple[Any, ...]) -> tuple[RunSpec, int | None, list[Reals]]:
        """Read the arguments of a call into the specification of a run.

        Return it with the number of members, which is None for a single run, and the arguments as
        arrays. Raises InputError.
        """
        program = self.program
        if len(given) != len(self.arguments):
            takes = ", ".join(f"{x.name} {x.shape}" for x in self.arguments)
            reject(
                f"the function takes {len(self.arguments)} arguments, but got {len(given)}.",
                where=program.system,
                remedy=f"Pass {takes}, or a row for each of K members.",
            )
        with program.numbers.working():
            values = [
                argument.read(value, program)
                for argument, value in zip(self.arguments, given, strict=True)
            ]
            sizes = {
                argument.name: len(value)
                for argument, value in zip(self.arguments, values, strict=True)
                if value.ndim > len(argument.shape)
            }
            members = max(sizes.values(), default=None)
            for name, size in sizes.items():
                if size != members:
                    reject(
                        f"argument {name} has {size} members, but another has {members}.",
                        remedy="Pass the same number of rows, or one value for all members.",
                    )
            return self._spec_of(values, members), members, values

    def _spec_of(self, values: Sequence[Reals], members: int | None) -> RunSpec:
        """Return the specification with the values of a call; members are rows."""
        program, spec, count = self.program, self.spec, members or 1
        q, other, parameters = (
            np.broadcast_to(x, (count, x.size)).copy()
            for x in (spec.q0, spec.other0, spec.parameters)
        )
        inputs = [spec.inputs[..., k] for k in range(spec.inputs.shape[-1])]
        for argument, value in zip(self.arguments, values, strict=True):
            if argument.kind == "parameter":
                parameters[:, argument.place] = value
            elif argument.kind == "input":
                spread = argument.spread(value)
                inputs[argument.place] = spread if spread.ndim == 3 else spread[None]
            else:
                (q if argument.kind == "q" else other)[:] = value
        driving = spec.inputs
        if any(argument.kind == "input" for argument in self.arguments):
            driving = np.stack(np.broadcast_arrays(*inputs), axis=-1)
        h = spec.h if members is None else 0.0
        q, other = project_start(program, q, other, spec.given, parameters, spec.t0, h=h)
        if members is None:
            q, other, parameters = q[0], other[0], parameters[0]
        return replace(spec, q0=q, other0=other, parameters=parameters, inputs=driving)

    def states(
        self,
        program: Program,
        spec: RunSpec,
        members: int | None,
        *,
        raising: bool = True,
        run: Callable[[RunSpec, str], Any] | None = None,
    ) -> FunctionStates:
        """Run one member or an ensemble, and return the stored states.

        ``program`` may be a variant with derivatives. ``run`` replaces the run of one member.
        """
        if self.request.events is not None:
            spec = replace(spec, run_events=read_run_events(program, self.request))
        spec = replace(spec, checked=bool(self._checked))
        if members is None:
            if run is None and program is self.program and (end := self._run_to_end(spec)):
                return self._states_of_run(end)
            run = run or partial(_integrate, program)
            return self._states_of_run(run(spec, "raise" if raising else "return"))
        if run is not None or not program.numbers.compiled:
            each = [
                self.states(program, member_of(spec, k), None, raising=False, run=run)
                for k in range(members)
            ]
            t, q, p = (np.stack([getattr(x, name) for x in each]) for name in ("t", "q", "p"))
            varied = [x.variations for x in each if x.variations is not None]
            status = np.array([int(x.status) for x in each])
            return FunctionStates(t, q, p, status, np.stack(varied) if varied else None)
        ensemble = self._run_ensemble(program, spec, members)
        status = np.asarray(ensemble.status)
        if not self.by_state:
            ensemble.q[status != 0] = ensemble.p[status != 0] = np.nan
        if ensemble.variations is not None:  # those of failed members are of their last states
            ensemble.variations[np.isnan(ensemble.q).any(axis=-1)] = np.nan
        return FunctionStates(ensemble.t, ensemble.q, ensemble.p, status, ensemble.variations)

    def _run_to_end(self, spec: RunSpec) -> Any:
        """Run one member to ``t_end`` with a time transformation; None if it needs a full run."""
        simple = spec.t_end is not None and spec.checked and spec.run_events is None
        if not simple or self.program.findings.prepared is None:
            return None
        state = spec.q0, spec.other0, spec.velocities, spec.every
        return run_prepared(
            self.program, BriefRequest(spec.parameters.copy(), *state), self.request
        )

    def _states_of_run(self, run: Any) -> FunctionStates:
        """Return the stored states of a single run; those after a failure are NaN."""
        columns = [run.t, run.q, run.p]
        columns += [] if run.variations is None else [run.variations]
        if not self.by_state:
            columns = [x[-1] if run.status is Status.SUCCESS else x[-1] * np.nan for x in columns]
        elif len(run.t) != self.stored:  # it failed, or an event added its end
            some = min(len(run.t), self.stored)
            on_grid = self.program.header.retimed or run.t[some - 1] == self._times[some - 1]
            if run.ended_by is not None and not on_grid:
                some -= 1  # the state at a terminal event is no state after whole steps
            whole = [np.full((self.stored, *x.shape[1:]), np.nan) for x in columns]
            for rows, x in zip(whole, columns, strict=True):
                rows[:some] = x[:some]
            columns = whole
        t, q, p, *varied = columns
        return FunctionStates(t, q, p, run.status, varied[0] if varied else None)

    def _run_ensemble(self, program: Program, spec: RunSpec, members: int) -> Ensemble:
        """Run an ensemble whose members are the rows of a specification."""
        tangents, varied = spec.tangents, len(program.header.varied_by or ())
        changed = None if tangents is None else np.pad(tangents, ((0, 0), (0, varied)))
        task = EnsembleSpec(
            **vars(spec) | {"tangents": changed},
            threads=self.threads or available_threads(),
            progress=False,
            lanes=lanes_for(program.header.rows, members),
            retimed=program.header.retimed,
            event_names=event_names(program, spec.run_events),
        )
        return run_spec(program, task)

    # outputs

    def outputs_of(self, t: Reals, q: Reals, p: Reals, parameters: Reals) -> tuple[Reals, ...]:
        """Return all outputs at states of shape (..., n); parameters have a row per member."""
        evaluate = None
        if self._observed:
            kernel, rows = self._kernel(), np.atleast_2d(parameters)
            evaluate = make_evaluator(self.program, self._observed, rows, kernel)
        return self._split_outputs(evaluate, t, q, p)

    def _short_outputs(self, short: ShortCall, q: Reals, p: Reals) -> tuple[Reals, ...]:
        """Return all outputs of a short call, which keeps its evaluator."""
        if short.evaluate is None:
            values = self._kernel()
            short.evaluate = make_evaluator(self.program, self._observed, short.values, values)
        short.evaluate.change_parameters(short.values)
        return self._split_outputs(short.evaluate, self._times, q, p)

    def _split_outputs(
        self, evaluate: StateEvaluator | None, t: Reals, q: Reals, p: Reals
    ) -> tuple[Reals, ...]:
        """Return the outputs from the state and from the values of all expressions."""
        n, shape = q.shape[-1], q.shape[:-1]
        if evaluate is None:
            values = q[..., :0]
        else:
            times = np.broadcast_to(t, shape).reshape(-1)
            results = evaluate(times, q.reshape(-1, n), p.reshape(-1, n))
            values = results.reshape((*shape, results.shape[1]))
        outputs, first = [], 0
        for output in self.outputs:
            if not output.expressions:
                outputs.append(q if output.name == "q" else p)
                continue
            last = first + len(output.expressions)
            outputs.append(values[..., first:last] if output.shape else values[..., first])
            first = last
        return tuple(outputs)

    def _kernel(self) -> Any:
        """Return the kernel of all expressions, which is compiled once."""
        known, observed = self.program.findings.events, self._observed
        key = "outputs", tuple(x.text for x in observed)
        if key not in known:
            text = observing_kernel(self.program.header, observed)
            known[key] = self.program.kernels.compile_observer(text, len(observed))
        return known[key]


def _integrate(program: Program, spec: RunSpec, on_failure: str) -> Any:
    """Run one member without a progress bar."""
    return integrate(program, spec, False, on_failure)


def member_of(spec: RunSpec, member: int, members: int | None = 0) -> RunSpec:
    """Return the specification of one member; the same if ``members`` is None, for a single run."""
    if members is None:
        return spec
    rows = {name: getattr(spec, name)[member] for name in ("q0", "other0", "parameters")}
    if spec.inputs.size:
        rows["inputs"] = spec.inputs[min(member, len(spec.inputs) - 1)][None]
    return replace(spec, **rows)
