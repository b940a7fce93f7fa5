"""Runs over parts of an orbit, with their derivatives by the state, the period and unknowns."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from symsimpson.errors import ConvergenceError, InputError
from symsimpson.program.evaluation import evaluate
from symsimpson.program.program import Program
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.integrate import integrate
from symsimpson.run.requested import run_at_fixed_times
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats

#: Relative displacement for differences of the energy.
SMALL = 2.0**-17
#: Numbers below this part of the scale become 0; denormal numbers slow runs down.
NEGLIGIBLE = 1e-200

#: The period, and its derivatives by the unknown parameters, from the values of all parameters.
PeriodOfParameters = Callable[[Floats], tuple[float, Floats]]


@dataclass(frozen=True)
class Leg:
    """The end of a run, and its derivatives; all are NaN if a step failed or the run has no end."""

    end: Floats  #: (q, p) at the end, shape (2 n,).
    slopes: (
        Floats  #: By (q, p) at the start, the period and k parameters, shape (2 n, 2 n + 1 + k).
    )
    t: float  #: The time at the end.
    failed: Trajectory | None = None  #: The run if a step failed.


@dataclass(frozen=True)
class Flow:
    """The runs of a search: equal parts of a period, or one run to a terminal event.

    ``spec`` is the template of the runs. The program differentiates by h (unless events end the
    run, or the system is retimed), then by the unknown parameters, whose places in all parameters
    are ``places``.
    """

    program: Program
    spec: RunSpec
    places: tuple[int, ...]
    steps: int  #: Steps of the run; with events or a time transformation, the most.
    segments: int = 1
    period_of: PeriodOfParameters | None = None  #: Of driven systems.
    parts: int = 1  #: Number of runs in an orbit: 2 if the second half mirrors the first one.

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.program.n

    @property
    def to_event(self) -> bool:
        """Whether an event ends the run."""
        return self.spec.run_events is not None

    @property
    def retimed(self) -> bool:
        """Whether the steps are constant in transformed time."""
        return self.program.header.retimed

    @property
    def fixed_steps(self) -> bool:
        """Whether a period has a fixed number of steps of equal length."""
        return not (self.to_event or self.retimed)

    @property
    def free_period(self) -> bool:
        """Whether the period is an unknown."""
        return self.period_of is None and not self.to_event

    def refined(self, factor: int) -> Flow:
        """Return the flow with ``factor`` times as many steps."""
        h = self.spec.h if self.fixed_steps else self.spec.h / factor
        return replace(self, spec=replace(self.spec, h=h), steps=self.steps * factor)

    def leg(self, number: int, z: Floats, period: float, values: Floats) -> Leg:
        """Run a segment from the state z."""
        n = self.n
        z = np.where(abs(z) < NEGLIGIBLE * (abs(z).max() or 1.0), 0.0, z)
        spec = replace(
            self.spec,
            q0=np.ascontiguousarray(z[:n]),
            other0=np.ascontiguousarray(z[n:]),
            parameters=values,
            tangents=np.eye(2 * n),
        )
        if self.retimed:
            spec = replace(spec, t_end=self.spec.t0 + period)
        elif not self.to_event:
            h, count = period / self.steps, self.steps // self.segments
            spec = replace(spec, h=h, steps=count, t0=self.spec.t0 + h * (count * number))
        run = self._run(spec)
        missed = run is not None and self.to_event and run.ended_by is None
        if run is None or missed or not run.success or run.variations is None:
            nothing = np.full((2 * n, 2 * n + 1 + len(self.places)), np.nan)
            return Leg(nothing[:, 0], nothing, np.nan, run)
        end, D = np.concatenate([run.q[-1], run.p[-1]]), np.array(run.variations[-1])
        if self.fixed_steps:
            D[:, 2 * n] /= self.steps
        else:  # (H_p, -H_q) is the rate of a retimed system, which is conservative
            rate = turned(self.energy_gradient(end, values)) if self.retimed else 0.0
            D = np.insert(D, 2 * n, rate, axis=1)
        return Leg(end, D, float(run.t[-1]))

    def _run(self, spec: RunSpec) -> Trajectory | None:
        """Return the run, None if it cannot start; its warnings matter for the final orbit only."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                if self.retimed:
                    names = self.program.header.parameters
                    varied = tuple(names[k] for k in self.places)
                    return run_at_fixed_times(self.program, spec, varied, False, "return")
                return integrate(self.program, spec, progress=False, on_failure="return")
            except (InputError, ConvergenceError):
                return None

    def energy(self, states: Floats, values: Floats) -> Floats:
        """Return H at states, shape (N, 2 n)."""
        q, p = np.ascontiguousarray(states[:, : self.n]), np.ascontiguousarray(states[:, self.n :])
        t = np.full(len(states), float(self.spec.t0))
        energies: Floats = evaluate(self.program, "energy", "ENERGY", 1, (t, q, p), values)[:, 0]
        return energies

    def energy_gradient(self, z: Floats, values: Floats) -> Floats:
        """Return dH/d(q, p), by central differences."""
        sizes = SMALL * np.maximum(abs(z), abs(z).max() or 1.0)
        both = self.energy(np.concatenate([z + np.diag(sizes), z - np.diag(sizes)]), values)
        return np.asarray((both[: len(z)] - both[len(z) :]) / (2 * sizes))


def turned(vectors: Floats) -> Floats:
    """Return J x for vectors x in the rows: (x_p, -x_q)."""
    n = vectors.shape[-1] // 2
    return np.concatenate([vectors[..., n:], -vectors[..., :n]], axis=-1)


def scale_of(states: Floats) -> Floats:
    """Return the scale of (q, p): the largest coordinate and the largest momentum of states."""
    q, p = np.split(abs(states), 2, axis=1)
    return np.repeat([q.max() or 1.0, p.max() or 1.0], q.shape[1])
