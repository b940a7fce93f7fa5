"""Runs of all kinds as they are requested: short ones, with derivatives, of chosen states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.observed import evaluate_energy
from symsimpson.program.program import Program
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.integrate import integrate
from symsimpson.run.short_runs import brief_run
from symsimpson.stepping.inputs import read_failure, read_varied, refuse_together, varied_program
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.progress import read_progress

if TYPE_CHECKING:
    from symsimpson.results.sampled import Sampled, Saved


def timed_run(
    program: Program,
    spec: RunSpec,
    names: tuple[str, ...],
    progress: bool | None,
    on_failure: str,
    *,
    fixed_steps: bool = False,
) -> Trajectory:
    """Run, and differentiate the stored states at the times that they have.

    E0, the first rate and the lengths of steps in t depend on the initial state: the derivatives
    contain that. They come from the system in which E0 is a coordinate and t its momentum.

    Parameters
    ----------
    program, spec
        Of a retimed system; with variations of the initial state.
    names : tuple of str
        Parameters to differentiate by, at given q0, and given v0 or p0.
    progress, on_failure
        As for :meth:`Stepper.integrate`.
    fixed_steps : bool
        Whether the end is that of the steps in tau, wherever it comes to lie in t.
    """
    wanted, plain = spec.tangents, replace(spec, tangents=None)
    assert wanted is not None
    moving = varied_program(program, names)
    run = integrate(program, plain, progress, on_failure)
    begun = integrate(program, replace(plain, steps=0, t_end=None, every=1), progress=False)
    derivatives = _Derivatives(
        program, moving, names, wanted, begun, run, spec.velocities, fixed_steps
    )
    return replace(run, variations=derivatives.tangents(), varied_by=names)


@dataclass(frozen=True)
class _Derivatives:
    """How stored states follow from the start: ``begun`` is that, ``run`` all of them."""

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
        """Number of coordinates of the user."""
        return self.program.n

    @property
    def others(self) -> int:
        """Number of parameters that the steps are differentiated by."""
        return len(self.moving.header.varied_by or ())

    @cached_property
    def values(self) -> Mapping[str, Any]:
        """Parameters of all steps."""
        known = self.run.parameters
        return {name: known[name] for name in self.moving.parameters}

    def tangents(self) -> Reals:
        """Return the variations at all stored states, shape (N, 2 n, k)."""
        n, run, h = self.n, self.run, self.run.h
        every = run.every or max(run.steps, 1)
        z = np.concatenate([self.begun.q[0], [run.E0], self.begun.p[0], self.begun.t])
        start = self._start(z)
        columns = np.eye(2 * n + 2, dtype=z.dtype)
        # the first are those of the state, but for the time, of which nothing depends
        whole = self._steps(z, h, run.steps // every * every, every, columns)
        ways = whole.variations
        assert ways is not None
        states = np.concatenate([whole.q, whole.p], axis=1)
        first = 0 if run.every else len(states) - 1
        rates = self._rates(whole)
        variations = [self._held(ways[k], rates[k], start) for k in range(first, len(states))]
        part = run.tau[-1] - h * run.steps
        if len(variations) < len(run) or (run.every is None and part != 0):
            rest = run.steps % every
            z, way = states[-1], ways[-1]
            if rest:
                z, more = self._onward(z, h, rest)
                way = self._joined(more, way)
            if part != 0:
                _, more = self._onward(z, part, 1)
                # by the size of the step: the first rate divides it
                by_size = more[:, -1] * (-self.values["g_start"] / part)
                last = self._held(self._joined(more, way), by_size, start)
            else:  # less than rounding: the end is that of the whole steps
                last = self._held(way, self._rates(self._here(z))[0], start)
            variations = [last] if run.every is None else [*variations, last]
        result: Reals = np.array(variations)
        return result

    def _steps(self, z: Reals, h: Any, steps: int, every: int, columns: Reals) -> Trajectory:
        asked = self._asked(z, h, steps)._replace(every=every, tangents=columns)
        return integrate(self.moving, read_run(self.moving, asked), progress=False)

    def _onward(self, z: Reals, h: Any, steps: int) -> tuple[Reals, Reals]:
        """Return the state after some steps from another, and how it follows from that."""
        end = self._steps(z, h, steps, steps, np.eye(z.size, dtype=z.dtype))
        assert end.variations is not None
        return np.concatenate([end.q[-1], end.p[-1]]), end.variations[-1]

    def _joined(self, more: Reals, way: Reals) -> Reals:
        """Return how a state follows from the start of all, where ``way`` led to one before it."""
        size = 2 * self.n + 2
        joined: Reals = more[:, :size] @ way
        joined[:, size:] = joined[:, size:] + more[:, size:]
        return joined

    def _here(self, z: Reals) -> Trajectory:
        """Return a run of no steps."""
        asked = self._asked(z, self.run.h, 0)
        return integrate(self.moving, read_run(self.moving, asked))

    def _asked(self, z: Reals, h: Any, steps: int) -> Request:
        m = self.n + 1
        return Request(z[:m], p0=z[m:], h=h, steps=steps, every=1, parameters=self.values)

    def _start(self, z: Reals) -> Reals:
        """Return what each variation changes at the start: state, then parameters."""
        n, count = self.n, len(self.names)
        given = self.wanted.shape[1]
        slopes = {name: value[0] for name, value in self._here(z).invariants.items()}
        start = np.zeros((2 * n + 2 + self.others, given + count), dtype=z.dtype)
        start[:n, :given], start[n + 1 : 2 * n + 1, :given] = self.wanted[:n], self.wanted[n:]
        for j in range(count):
            start[2 * n + 2 + j, given + j] = 1
            if self.velocities:
                for i in range(n):
                    start[n + 1 + i, given + j] = slopes[f"p by {i} a{j}"]
        E = self._along(slopes, "E", start)
        start[n] = E
        if self.others == count + 2:  # E0 stands in the rate, too
            start[-2] = E
        start[-1] = self._along(slopes, "rate", start) + slopes["rate by E"] * E
        return start

    def _along(self, slopes: Mapping[str, Any], what: str, start: Reals) -> Reals:
        """Return how E0 or the rate change along the columns."""
        n = self.n
        total = sum(slopes[f"{what} by q{i}"] * start[i] for i in range(n))
        if what == "E":
            total = total + sum(slopes[f"E by p{i}"] * start[n + 1 + i] for i in range(n))
        for j in range(len(self.names)):
            total = total + slopes[f"{what} by a{j}"] * start[2 * n + 2 + j]
        changed: Reals = np.asarray(total)
        return changed

    def _rates(self, whole: Trajectory) -> Reals:
        """Return how states and their times move within the next step, by t: that of K."""
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

    def _held(self, way: Reals, moved: Reals, start: Reals) -> Reals:
        """Return variations of (q, p) where t is held by moving along ``moved``."""
        n = self.n
        change = way @ start
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
    """Run as requested; further arguments are those of :meth:`Stepper.integrate`.

    Raises InputError, StorageError, ConvergenceError or Interrupted.
    """
    if checkpoint_every is not None and request.checkpoint is None:
        reject(
            f"checkpoint_every={checkpoint_every!r} says how often a file is written, and there is "
            "none.",
            remedy="Pass checkpoint='run.ckpt', too, or leave it out.",
        )
    if request.t_eval is not None or request.save is not None:
        return _chosen(program, request, progress, on_failure)
    plain = request.inputs is None and not request.recorded and request.checkpoint is None
    plain = plain and request.events is None
    read_progress(progress)
    read_failure(on_failure)
    if plain and progress is None:
        over = brief_run(program, request)
        if over is not None:
            return over
    if program.header.retimed and request.varied:
        if request.checkpoint is not None:
            reject(
                f"{program.system} is retimed, and a checkpoint keeps no derivatives in another "
                "time.",
                remedy="Leave out checkpoint, or tangents and sensitivities.",
            )
        names = _names_to_vary(program, request)
        return timed_run(program, read_run(program, request), names, progress, on_failure)
    program = program_for(program, request)
    spec = read_run(program, request)
    return integrate(program, spec, progress, on_failure, request.checkpoint, checkpoint_every)


def _chosen(
    program: Program, request: Request, progress: bool | None, on_failure: str
) -> Sampled | Saved:
    """Run, and keep chosen states or quantities."""
    from symsimpson.run.chosen import chosen_run, last_time  # few runs need it

    refuse_together(request)
    if request.t_eval is not None and request.t_end is None and request.steps is None:
        t_end, steps = last_time(program, request)
        request = request._replace(t_end=t_end, steps=steps)
    spec = read_run(program, request)
    return chosen_run(program, spec, request.t_eval, request.save, progress, on_failure)


def end_of_step(program: Program, request: Request) -> Trajectory:
    """Take the one step of a request, and return its end; quicker than :func:`run`."""
    end = brief_run(program, request) if request.inputs is None else None
    return integrate(program, read_run(program, request)) if end is None else end


def tangent_of_step(program: Program, request: Request, names: tuple[str, ...]) -> Trajectory:
    """Take the one step of a request, with its derivatives by the state and by these names."""
    if program.header.retimed:
        spec = read_run(program, request)
        return timed_run(program, spec, names, False, "raise", fixed_steps=True)
    program = varied_program(program, names)
    return integrate(program, read_run(program, request))


def program_for(program: Program, request: Request) -> Program:
    """Return the variant of a program that computes the derivatives a request asks for."""
    if not request.varied:
        return program
    return varied_program(program, _names_to_vary(program, request))


def _names_to_vary(program: Program, request: Request) -> tuple[str, ...]:
    """Read the names to differentiate by; raise InputError for an unknown name."""
    return read_varied(program, () if request.sensitivities is None else request.sensitivities)
