"""Choice of the kind of run for a request: short, with derivatives, or with selected output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.evaluation import evaluate_energy
from symsimpson.program.program import Program
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.integrate import integrate
from symsimpson.run.short_runs import try_short_run
from symsimpson.stepping.inputs import (
    check_on_failure,
    program_with_derivatives,
    read_variables,
    reject_combinations,
)
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.contact_values import reject_contacts
from symsimpson.support.progress import read_progress

if TYPE_CHECKING:
    from symsimpson.results.sampled import Sampled, Saved


def run_at_fixed_times(
    program: Program,
    spec: RunSpec,
    names: tuple[str, ...],
    progress: bool | None,
    on_failure: str,
    *,
    fixed_steps: bool = False,
) -> Trajectory:
    """Run a retimed system, and differentiate the stored states at their fixed times t.

    E0, the first rate and the duration of steps in t depend on the initial state, and the
    derivatives include this. They come from the system in which E0 is a coordinate and t its
    momentum.

    Parameters
    ----------
    program : Program
        Program of the retimed system.
    spec : RunSpec
        Specification of the run, with variations of the initial state.
    names : tuple of str
        Parameters to differentiate by, at fixed q0 and fixed v0 or p0.
    progress, on_failure
        As for :meth:`Stepper.integrate`.
    fixed_steps : bool
        If True, differentiate at fixed tau instead of fixed t. The default is False.
    """
    wanted, plain = spec.tangents, replace(spec, tangents=None)
    assert wanted is not None
    moving = program_with_derivatives(program, names)
    run = integrate(program, plain, progress, on_failure)
    begun = integrate(program, replace(plain, steps=0, t_end=None, every=1), progress=False)
    derivatives = _RetimedDerivatives(
        program, moving, names, wanted, begun, run, spec.velocities, fixed_steps
    )
    return replace(run, variations=derivatives.tangents(), varied_by=names)


@dataclass(frozen=True)
class _RetimedDerivatives:
    """Derivatives of the stored states of a retimed run by its initial state and parameters.

    ``begun`` has the initial state, ``run`` all stored states. ``moving`` is the program of the
    system with the coordinate E0.
    """

    program: Program
    moving: Program
    names: tuple[str, ...]
    wanted: Reals
    begun: Trajectory
    run: Trajectory
    velocities: bool
    fixed_steps: bool

    @property
    def n(self) -> int:
        """Number of coordinates of the user's system, without E0."""
        return self.program.n

    @property
    def variable_count(self) -> int:
        """Number of variables, other than the state, by which the steps are differentiated."""
        return len(self.moving.header.varied_by or ())

    @cached_property
    def values(self) -> Mapping[str, Any]:
        """Values of the parameters of ``moving``."""
        known = self.run.parameters
        return {name: known[name] for name in self.moving.parameters}

    def tangents(self) -> Reals:
        """Return the variations at all stored states, shape (N, 2 n, k)."""
        n, run, h = self.n, self.run, self.run.h
        every = run.every or max(run.steps, 1)
        z = np.concatenate([self.begun.q[0], [run.E0], self.begun.p[0], self.begun.t])
        start = self._initial_columns(z)
        columns = np.eye(2 * n + 2, dtype=z.dtype)
        whole = self._steps(z, h, run.steps // every * every, every, columns)
        derivatives_of_states = whole.variations
        assert derivatives_of_states is not None
        states = np.concatenate([whole.q, whole.p], axis=1)
        first = 0 if run.every else len(states) - 1
        rates = self._rates(whole)
        variations = [
            self._at_fixed_time(derivatives_of_states[k], rates[k], start)
            for k in range(first, len(states))
        ]
        part = run.tau[-1] - h * run.steps
        if len(variations) < len(run) or (run.every is None and part != 0):
            rest = run.steps % every
            z, derivative = states[-1], derivatives_of_states[-1]
            if rest:
                z, next_derivative = self._advance(z, h, rest)
                derivative = self._chain(next_derivative, derivative)
            if part != 0:
                _, next_derivative = self._advance(z, part, 1)
                # the derivative by the step size in t: the first rate divides it
                by_size = next_derivative[:, -1] * (-self.values["g_start"] / part)
                last = self._at_fixed_time(self._chain(next_derivative, derivative), by_size, start)
            else:  # the last partial step is below round-off
                last = self._at_fixed_time(
                    derivative, self._rates(self._run_without_steps(z))[0], start
                )
            variations = [last] if run.every is None else [*variations, last]
        result: Reals = np.array(variations)
        return result

    def _steps(self, z: Reals, h: Any, steps: int, every: int, columns: Reals) -> Trajectory:
        request = self._request(z, h, steps)._replace(every=every, tangents=columns)
        return integrate(self.moving, read_run(self.moving, request), progress=False)

    def _advance(self, z: Reals, h: Any, steps: int) -> tuple[Reals, Reals]:
        """Return the state after ``steps`` steps from z, and its derivative by z."""
        end = self._steps(z, h, steps, steps, np.eye(z.size, dtype=z.dtype))
        assert end.variations is not None
        return np.concatenate([end.q[-1], end.p[-1]]), end.variations[-1]

    def _chain(self, next_derivative: Reals, derivative: Reals) -> Reals:
        """Apply the chain rule: combine the derivative up to a state with the next one."""
        size = 2 * self.n + 2
        joined: Reals = next_derivative[:, :size] @ derivative
        joined[:, size:] = joined[:, size:] + next_derivative[:, size:]
        return joined

    def _run_without_steps(self, z: Reals) -> Trajectory:
        """Return a run without steps, for the invariants at a state."""
        return integrate(self.moving, read_run(self.moving, self._request(z, self.run.h, 0)))

    def _request(self, z: Reals, h: Any, steps: int) -> Request:
        m = self.n + 1
        return Request(z[:m], p0=z[m:], h=h, steps=steps, every=1, parameters=self.values)

    def _initial_columns(self, z: Reals) -> Reals:
        """Return the initial variations of the extended state and the parameters, as columns."""
        n, count = self.n, len(self.names)
        given = self.wanted.shape[1]
        slopes = {name: value[0] for name, value in self._run_without_steps(z).invariants.items()}
        start = np.zeros((2 * n + 2 + self.variable_count, given + count), dtype=z.dtype)
        start[:n, :given], start[n + 1 : 2 * n + 1, :given] = self.wanted[:n], self.wanted[n:]
        for j in range(count):
            start[2 * n + 2 + j, given + j] = 1
            if self.velocities:
                for i in range(n):
                    start[n + 1 + i, given + j] = slopes[f"p by {i} a{j}"]
        E = self._slopes_along(slopes, "E", start)
        start[n] = E
        if self.variable_count == count + 2:  # the rate contains E0
            start[-2] = E
        start[-1] = self._slopes_along(slopes, "rate", start) + slopes["rate by E"] * E
        return start

    def _slopes_along(self, slopes: Mapping[str, Any], what: str, start: Reals) -> Reals:
        """Return the derivative of E0 (``what`` = "E") or of the rate along each column."""
        n = self.n
        total = sum(slopes[f"{what} by q{i}"] * start[i] for i in range(n))
        if what == "E":
            total = total + sum(slopes[f"E by p{i}"] * start[n + 1 + i] for i in range(n))
        for j in range(len(self.names)):
            total = total + slopes[f"{what} by a{j}"] * start[2 * n + 2 + j]
        changed: Reals = np.asarray(total)
        return changed

    def _rates(self, whole: Trajectory) -> Reals:
        """Return the derivatives of states and times by t within the next step, from K."""
        n, slopes = self.n, whole.invariants
        q, p = whole.q[:, :n], whole.p[:, :n]
        known = self.run.parameters
        free = self.program.free_values()
        energy = evaluate_energy(self.program, q, p, {name: known[name] for name in free}, 0.0)
        rates = np.zeros((len(q), 2 * n + 2), dtype=q.dtype)
        for i in range(n):
            pull = slopes[f"rate by q{i}"] / slopes["rate"] * (energy - self.run.E0)
            rates[:, i] = slopes[f"E by p{i}"]
            rates[:, n + 1 + i] = -slopes[f"E by q{i}"] - pull
        rates[:, -1] = 1
        return rates

    def _at_fixed_time(self, derivative: Reals, moved: Reals, start: Reals) -> Reals:
        """Return variations of (q, p) at fixed t; ``moved`` is the derivative of the state by t."""
        n = self.n
        change = derivative @ start
        if not self.fixed_steps:
            change = change - np.outer(moved, change[-1] / moved[-1])
        variations: Reals = np.concatenate([change[:n], change[n + 1 : -1]])
        return variations


def run(
    program: Program,
    request: Request,
    checkpoint_every: int | None = None,
    progress: bool | None = None,
    on_failure: str = "raise",
) -> Any:
    """Run a request with the other arguments of :meth:`Stepper.integrate`.

    Raises InputError, StorageError, ConvergenceError or Interrupted.
    """
    if checkpoint_every is not None and request.checkpoint is None:
        reject(
            f"checkpoint_every={checkpoint_every!r} has no effect without checkpoint=.",
            remedy="Pass checkpoint='run.ckpt' as well, or remove checkpoint_every.",
        )
    if request.t_eval is not None or request.save is not None:
        return _run_with_selection(program, request, progress, on_failure)
    plain = request.inputs is None and not request.recorded and request.checkpoint is None
    plain = plain and request.events is None and program.modes is None
    read_progress(progress)
    check_on_failure(on_failure)
    if plain and progress is None:
        over = try_short_run(program, request)
        if over is not None:
            return over
    if program.header.retimed and request.varied:
        if request.checkpoint is not None:
            reject(
                "checkpoint= cannot be combined with derivatives of a retimed system.",
                where=program.system,
                remedy="Remove checkpoint, or remove tangents and sensitivities.",
            )
        names = _names_to_vary(program, request)
        return run_at_fixed_times(program, read_run(program, request), names, progress, on_failure)
    program = program_for_request(program, request)
    spec = read_run(program, request)
    return integrate(program, spec, progress, on_failure, request.checkpoint, checkpoint_every)


def _run_with_selection(
    program: Program, request: Request, progress: bool | None, on_failure: str
) -> Sampled | Saved:
    """Run, and store only the times ``t_eval`` or the quantities ``save``."""
    from symsimpson.run.chosen import find_run_length, run_with_selection  # few runs need it

    reject_combinations(request)
    if request.t_eval is not None and request.t_end is None and request.steps is None:
        t_end, steps = find_run_length(program, request)
        request = request._replace(t_end=t_end, steps=steps)
    spec = read_run(program, request)
    return run_with_selection(program, spec, request.t_eval, request.save, progress, on_failure)


def take_step(program: Program, request: Request) -> Trajectory:
    """Take the single step of a request; faster than :func:`run`."""
    short = request.inputs is None and program.modes is None
    end = try_short_run(program, request) if short else None
    return integrate(program, read_run(program, request)) if end is None else end


def take_step_with_tangents(
    program: Program, request: Request, names: tuple[str, ...]
) -> Trajectory:
    """Take the single step of a request, with its derivatives by the state and by ``names``."""
    reject_contacts(program.modes, program.system, "derivatives of one step")
    if program.header.retimed:
        spec = read_run(program, request)
        return run_at_fixed_times(program, spec, names, False, "raise", fixed_steps=True)
    program = program_with_derivatives(program, names)
    return integrate(program, read_run(program, request))


def program_for_request(program: Program, request: Request) -> Program:
    """Return the variant of a program that computes the derivatives a request asks for."""
    if not request.varied:
        return program
    return program_with_derivatives(program, _names_to_vary(program, request))


def _names_to_vary(program: Program, request: Request) -> tuple[str, ...]:
    """Read the names to differentiate by; raise InputError for an unknown name."""
    return read_variables(program, () if request.sensitivities is None else request.sensitivities)
