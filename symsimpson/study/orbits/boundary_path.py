"""Paths: an initial state, a duration, and how the search ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from symsimpson.results.trajectory import Trajectory
from symsimpson.study.orbits.outcome import OrbitStatus
from symsimpson.support.array_types import Floats

#: Names of quantities that are no expressions.
ENERGY, PERIOD = "energy", "period"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Path:
    """A motion between two boundaries; :meth:`Stepper.boundary` returns it.

    Attributes
    ----------
    duration : float
        The time from one boundary to the other.
    steps : int
        Number of steps.
    q0, v0, p0 : ndarray, shape (n,)
        The initial state.
    states : ndarray, shape (steps + 1, 2 n)
        The states (q, p) along the path.
    energy : float
        H at the initial state.
    parameters, unknowns : mapping from str to float
        Values of the parameters and of the unknowns.
    status, message : OrbitStatus, str
        How the search ended.
    success : bool
        True if the path was found.
    residual : float
        The largest error of the boundary conditions, relative to the scale of the motion.
    iterations : int
        Number of Newton iterations.

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.kepler_plane(), "gauss8")
    >>> path = stepper.boundary([1.0, 0.0], [-0.5, 1.2], duration=2.0, steps=24)
    >>> path.success, path.v0.round(9).tolist()
    (True, [-0.094933487, 1.134076482])
    """

    period: float
    steps: int
    q0: Floats
    p0: Floats
    values: Floats  #: Of the parameters.
    unknowns: Mapping[str, float]
    status: OrbitStatus
    message: str
    residual: float
    iterations: int
    #: Sizes of Newton's corrections, relative to the scale.
    corrections: tuple[float, ...]
    search: Any  #: The equations, and the functions that use them.

    @property
    def duration(self) -> float:
        """The time from one boundary to the other."""
        return self.period

    @property
    def success(self) -> bool:
        """True if the search found what it was to find."""
        return self.status.success

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters."""
        return dict(zip(self.search.stepper.parameters, self.values.tolist(), strict=True))

    @property
    def h(self) -> float:
        """The step size; of retimed systems, in transformed time."""
        flow = self.search.flow
        return self.period / self.steps if flow.fixed_steps else float(flow.spec.h)

    @cached_property
    def trajectory(self) -> Trajectory:
        """The run over the whole path."""
        return self.search.run(self, every=1)

    @cached_property
    def states(self) -> Floats:
        """The states (q, p) along the path, a row for each."""
        return np.concatenate([self.trajectory.q, self.trajectory.p], axis=1)

    @property
    def v0(self) -> Floats:
        """The initial velocities, shape (n,)."""
        if not np.isfinite([*self.q0, *self.p0]).all():
            return np.full(len(self.q0), np.nan)
        return np.asarray(self._start.v[0])

    @property
    def energy(self) -> float:
        """H at the initial state."""
        return float(self._start.energy[0])

    @cached_property
    def _start(self) -> Trajectory:
        """A run of no steps from the initial state."""
        none = {"h": 1.0, "steps": 0, "t_end": None, "events": None, "on_failure": "raise"}
        return self.search.run(self, **none)

    def _title(self) -> str:
        return f"duration {self.period:.10g}, {self.steps} steps"

    def __repr__(self) -> str:
        name, stepper = type(self).__name__, self.search.stepper
        return f"{name}({stepper.system}, {stepper.scheme}: {self._title()}; {self.status.name})"
