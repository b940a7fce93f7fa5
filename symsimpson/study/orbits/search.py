"""Searches for orbits: the solution of the equations, and the verdict on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import reject
from symsimpson.results.trajectory import Trajectory
from symsimpson.study.orbits.boundary_path import Path
from symsimpson.study.orbits.flow import Flow
from symsimpson.study.orbits.multipliers import Multipliers, multipliers_of
from symsimpson.study.orbits.orbit import Orbit
from symsimpson.study.orbits.outcome import OrbitStatus
from symsimpson.study.orbits.shooting import OrbitUnknowns, Shooting, Solution, Sweep
from symsimpson.support.array_types import Floats

#: Residuals of found orbits, relative to the scale.
FOUND, COARSE = 1e-11, 1e-8
#: Largest unfolding number and largest error of trivial multipliers of a resolved orbit.
UNFOLDED, TRIVIAL = 1e-9, 1e-4
#: The speed of an equilibrium, and the error of a shorter period, relative to the scale.
AT_REST, REPEATED = 1e-8, 1e-7
#: A period that is a smaller part of its guess is no solution.
SHRUNK = 1e-3
#: The largest number of repetitions that is looked for.
MOST_REPEATED = 12
#: Singular values of D - I below this part of the largest derivative are zeros.
NULL = 1e-9
#: The return of a run over an orbit, relative to the scale and to the growth of deviations.
RETURN = 1e-10
#: An orbit with an error above this is not resolved.
WORST_ERROR = 1e-2
NOTHING = Multipliers(np.zeros(0, np.complex128), np.zeros(0, np.complex128), np.nan)


@dataclass(frozen=True)
class Search:
    """A stepper, the equations of its orbit, and what remains of the arguments."""

    stepper: Stepper
    shooting: Shooting
    unknown_names: tuple[str, ...]
    given: Any  #: The arguments of the search, for families.
    symplectic: bool
    tools: Any  #: The functions that results call: they need other parts of this room.
    mirror: Floats | None = None  #: The reversal of (q, p), for orbits with conditions half-way.

    @property
    def flow(self) -> Flow:
        """The runs of the search."""
        return self.shooting.flow

    def refined(self, factor: int) -> Search:
        """Return the search with ``factor`` times as many steps."""
        if not isinstance(factor, int) or factor < 1:
            reject(f"factor is {factor!r}.", remedy="Pass a whole number from 2 on.")
        return replace(self, shooting=self.shooting.with_flow(self.flow.refined(factor)))

    def scaled_to(self, orbit: Orbit) -> Search:
        """Return the search with the scale of an orbit."""
        n, run = self.flow.n, orbit.trajectory
        sizes = [abs(run.q).max() or 1.0, abs(run.p).max() or 1.0]
        half = 2 if self.mirror is not None else 1
        scaled = replace(
            self.shooting, scale=np.repeat(sizes, n), reference_period=orbit.period / half
        )
        return replace(self, shooting=scaled)

    def point_of(self, path: Path) -> OrbitUnknowns:
        """Return the unknowns of a result, in as many segments as the search has."""
        states = np.concatenate([path.q0, path.p0])[None]
        if self.flow.segments > 1:
            states = self.split(path.trajectory)
        names = self.shooting.closing.symbols if self.shooting.closing is not None else ()
        extra = np.array([path.unknowns[str(x)] for x in names], dtype=np.float64)
        unfolding = np.zeros(self.shooting.unfolded)
        return OrbitUnknowns(states, path.period, path.values, extra, unfolding)

    def split(self, run: Trajectory) -> Floats:
        """Return the states of a run at the starts of the segments."""
        t = run.t[0] + (run.t[-1] - run.t[0]) * np.arange(self.flow.segments) / self.flow.segments
        return np.asarray(run.sol(t).T)

    def orbit_near(self, orbit: Orbit) -> Orbit:
        """Solve the equations from another solution of them."""
        return self.orbit(self.shooting.solve(self.point_of(orbit)))

    # -- results

    def fields(self, solution: Solution) -> dict[str, Any]:
        """Return the fields that all results have."""
        point, n = solution.sweep.point, self.flow.n
        names = self.unknown_names
        numbers = [*point.values[list(self.flow.places)].tolist(), *point.extra.tolist()]
        period = point.period
        if self.flow.to_event:
            period = solution.sweep.legs[-1].t - float(self.flow.spec.t0)
        return {
            "period": period,
            "steps": self.flow.steps,
            "q0": point.states[0, :n].copy(),
            "p0": point.states[0, n:].copy(),
            "values": point.values,
            "unknowns": dict(zip(names, numbers, strict=True)),
            "residual": solution.sweep.size,
            "iterations": len(solution.corrections),
            "corrections": solution.corrections,
            "search": self,
        }

    def path(self, solution: Solution) -> Path:
        """Return the result of a search between boundaries."""
        status = self._status_of_rows(solution, 1.0)
        message = self._message(status, solution)
        return Path(status=status, message=message, **self.fields(solution))

    def orbit(self, solution: Solution, *, examined: bool = True) -> Orbit:
        """Return an orbit with its multipliers, and a verdict if it is to be ``examined``."""
        fields, sweep = self.fields(solution), solution.sweep
        D = self._derivative(sweep)
        growth = self._growth(D) if np.isfinite(D).all() else 1.0
        status = self._status_of_rows(solution, growth)
        unfolding = float(abs(sweep.point.unfolding).max(initial=0.0))
        more: dict[str, Any] = {
            "derivative": D,
            "floquet": self._multipliers(self._scaled(D)) if np.isfinite(D).all() else NOTHING,
            "unfolding": unfolding,
        }
        if self.mirror is not None:
            fields["period"], fields["steps"] = 2 * fields["period"], 2 * fields["steps"]
        draft = Orbit(status=status, message="", **fields, **more)
        reason, primitive = "", None
        if status.success and examined:
            status, reason, primitive = self._examine(draft)
        message = reason or self._message(status, solution)
        return replace(draft, status=status, message=message, primitive=primitive)

    def _derivative(self, sweep: Sweep) -> Floats:
        """Return the derivative of the period map; a mirrored orbit has two halves."""
        size = 2 * self.flow.n
        if sweep.failure is not None:
            return np.full((size, size), np.nan)
        D = self.shooting.period_map(sweep)
        if self.mirror is not None:
            D = self.mirror @ np.linalg.solve(D, self.mirror @ D)
        return D

    def _scaled(self, D: Floats) -> Floats:
        """Return a derivative in units of the scale."""
        scale = self.shooting.scale
        return np.asarray(D * scale / scale[:, None])

    def _growth(self, D: Floats) -> float:
        """Return how much deviations grow, at least 1."""
        return max(1.0, float(abs(self._scaled(D)).max()))

    def _multipliers(self, D: Floats) -> Multipliers:
        """Return the multipliers of a period, or of all parts of a symmetric orbit."""
        integrals, closing = self.shooting.integrals, self.shooting.closing
        trivial = integrals.count if self.symplectic else int(integrals.timeless)
        power = 1 if closing is None or closing.moves else closing.order
        return multipliers_of(D, trivial, symplectic=self.symplectic, power=power)

    def _status_of_rows(self, solution: Solution, growth: float) -> OrbitStatus:
        """Return the status that follows from the residual alone."""
        if solution.interrupted:
            return OrbitStatus.INTERRUPTED
        if solution.sweep.failure is not None:
            return OrbitStatus.WRONG_EVENT if self.flow.to_event else OrbitStatus.STEP_FAILED
        size = solution.sweep.size
        if not solution.converged or size > max(COARSE, 10 * np.finfo(float).eps * growth):
            return OrbitStatus.NOT_CONVERGED
        tight = size <= max(FOUND, 10 * np.finfo(float).eps * growth)
        return OrbitStatus.FOUND if tight else OrbitStatus.FOUND_COARSE

    def _message(self, status: OrbitStatus, solution: Solution) -> str:
        sweep, where = solution.sweep, f"{self.stepper.system}, {self.stepper.scheme}: "
        message = where + status.message
        if status is OrbitStatus.STEP_FAILED and solution.failed is not None:
            message += f" {solution.failed.message}"
        if status is OrbitStatus.NOT_CONVERGED and np.isfinite(sweep.size):
            row = int(abs(sweep.residual).argmax())
            names = self._row_names()
            name = names[row] if row < len(names) else "a condition"
            message += f" The largest residual is {sweep.size:.1e}, of {name}."
            growth = self._growth(self._derivative(sweep))
            if growth > 100:
                message += (
                    f" The motion multiplies deviations by {growth:.0f}: give the initial "
                    "state to more digits, or a guess along the whole orbit."
                )
        return message

    def _row_names(self) -> list[str]:
        """Return what each row of the equations is about."""
        names = self.stepper.coordinates
        gaps = [*names, *(f"p_{x}" for x in names)]
        count = self.flow.segments - (self.shooting.closing is None)
        rows = [f"the gap in {x}" for _ in range(count) for x in gaps]
        return rows + [x.name for x in (*self.shooting.conditions, *self.shooting.last)]

    def _examine(self, orbit: Orbit) -> tuple[OrbitStatus, str, Orbit | None]:
        """Return the status of a solution of the equations: it need not be a resolved orbit."""
        scale, where = self.shooting.scale, f"{self.stepper.system}, {self.stepper.scheme}: "
        run = orbit.trajectory
        if not run.success:
            return OrbitStatus.STEP_FAILED, where + run.message, None
        states = np.concatenate([run.q, run.p], axis=1)
        moved = abs(states - states[0]).max(axis=0) / scale
        if abs(orbit.period) < SHRUNK * abs(self.shooting.reference_period):
            why = " The period fell to zero: give a nearer guess of it."
            message = where + OrbitStatus.NOT_CONVERGED.message + why
            return OrbitStatus.NOT_CONVERGED, message, None
        if moved.max() < AT_REST:
            return OrbitStatus.EQUILIBRIUM, "", None
        growth = self._growth(orbit.derivative)
        closing = self.shooting.closing
        if closing is not None and not self.flow.to_event:
            extra = np.array([orbit.unknowns[str(x)] for x in closing.symbols], dtype=np.float64)
            shift, _ = closing.at(orbit.values, extra)
            gap = abs(states[-1] - closing.matrix @ states[0] - shift) / scale
            if gap.max() > RETURN * growth:
                why = f" A run over one period returns within {gap.max():.0e} of the scale only."
                return (
                    OrbitStatus.NOT_RESOLVED,
                    where + OrbitStatus.NOT_RESOLVED.message + why,
                    None,
                )
        if orbit.unfolding > UNFOLDED or not orbit.trivial <= TRIVIAL * growth**0.25:
            why = (
                f" The unfolding is {orbit.unfolding:.0e} of the scale, and trivial multipliers "
                f"differ from 1 by {orbit.trivial:.0e}."
            )
            return OrbitStatus.NOT_RESOLVED, where + OrbitStatus.NOT_RESOLVED.message + why, None
        if (primitive := self._primitive(orbit, states)) is not None:
            return OrbitStatus.SHORTER, "", primitive
        if self.symplectic and self.mirror is None:
            off = self._scaled(orbit.derivative) - np.eye(len(scale))
            sizes = np.linalg.svd(off, compute_uv=False)
            if (sizes < NULL * max(1.0, sizes[0])).sum() > self.shooting.integrals.count:
                return OrbitStatus.NOT_ISOLATED, "", None
        return orbit.status, "", None

    def _primitive(self, orbit: Orbit, states: Floats) -> Orbit | None:
        """Return the orbit of the shortest period if this one repeats it."""
        closing = self.shooting.closing
        plain = closing is not None and closing.order == 1 and not closing.moves
        if not plain or not self.flow.free_period or self.flow.retimed:
            return None
        moves = abs(np.diff(states, axis=0)).max(axis=0)
        for k in range(MOST_REPEATED, 1, -1):
            at = states[round(self.flow.steps / k)]
            if (abs(at - states[0]) > moves).any():  # more than a step away
                continue
            if self.flow.steps % k:
                at = orbit.trajectory.sol(orbit.trajectory.t[0] + orbit.period / k)
            if (abs(at - states[0]) / self.shooting.scale).max() > REPEATED:
                continue
            flow = replace(self.flow, steps=max(1, self.flow.steps // k), segments=1)
            other = replace(self, shooting=self.shooting.with_flow(flow))
            point = other.point_of(replace(orbit, search=other))
            return other.orbit(other.shooting.solve(replace(point, period=orbit.period / k)))
        return None

    # -- runs

    def run(self, path: Path, *, every: int | None, whole: bool = True) -> Trajectory:
        """Integrate a result over its whole length, with the public method."""
        options: dict[str, Any] = {"p0": path.p0, "parameters": self.free_parameters(path)}
        options |= {"t0": float(self.flow.spec.t0), "every": every, "progress": False}
        if not whole:
            return self.stepper.integrate(path.q0, h=1.0, steps=0, **options)
        options["on_failure"] = "return"
        if self.flow.to_event:
            events = self.given.events
            return self.stepper.integrate(
                path.q0, h=path.h, steps=path.steps, events=events, **options
            )
        if self.flow.retimed:
            end = float(self.flow.spec.t0) + path.period
            return self.stepper.integrate(path.q0, h=path.h, t_end=end, **options)
        return self.stepper.integrate(path.q0, h=path.h, steps=path.steps, **options)

    def free_parameters(self, path: Path) -> dict[str, float]:
        """Return the parameters that a run may be given."""
        fixed = self.stepper.program.header.from_start
        return {name: x for name, x in path.parameters.items() if name not in fixed}

    def manifold(self, orbit: Orbit, kind: str, size: float, count: int, periods: float) -> Any:
        """Run from states beside an orbit; see :meth:`Orbit.manifold`."""
        if kind not in ("unstable", "stable"):
            reject(f"kind is {kind!r}.", remedy="Pass 'unstable' or 'stable'.")
        if self.flow.to_event or self.flow.retimed:
            reject(
                "manifolds need an orbit with fixed steps and without events.",
                where=self.stepper.system,
            )
        ahead = kind == "unstable"
        values, vectors = np.linalg.eig(orbit.derivative)
        sizes = abs(values) if ahead else 1 / np.maximum(abs(values), 1e-300)
        place = int(np.argmax(np.where(abs(values.imag) <= 1e-9 * abs(values), sizes, 0.0)))
        if sizes[place] < 1 + 1e-6:
            reject(
                f"this orbit has no {kind} manifold.",
                where=self.stepper.system,
                why="It is stable, or its multipliers are complex.",
            )
        direction = vectors[:, place].real
        n, steps, h = self.flow.n, orbit.steps, orbit.h
        start = (direction / np.linalg.norm(direction / self.shooting.scale))[:, None]
        run = self.stepper.integrate(
            orbit.q0,
            p0=orbit.p0,
            h=h,
            steps=steps,
            tangents=start,
            t0=float(self.flow.spec.t0),
            parameters=self.free_parameters(orbit),
        )
        some = np.unique(np.linspace(0, steps, count, endpoint=False).round().astype(int))
        beside = run.tangent[some][..., 0]
        lengths = np.linalg.norm(beside / self.shooting.scale, axis=1, keepdims=True)
        states = np.concatenate([run.q, run.p], axis=1)[some] + size * beside / lengths
        return self.stepper.ensemble(
            states[:, :n],
            p0=states[:, n:],
            h=h if ahead else -h,
            steps=max(1, round(periods * steps)),
            t0=run.t[some] if not self.stepper.program.header.autonomous else 0.0,
            every=1,
            parameters=self.free_parameters(orbit),
            progress=False,
        )

    def refined_to(self, orbit: Orbit, error: float, most: int) -> Orbit:
        """Double the steps until the estimated error is below ``error``."""
        order = self.stepper.order
        while orbit.success:
            finer = orbit.refined(2)
            if not finer.success:
                return orbit
            moved = [*(finer.q0 - orbit.q0), *(finer.p0 - orbit.p0)] / self.shooting.scale
            off = max(abs(moved).max(), abs(finer.period / orbit.period - 1)) / (1 - 2.0**-order)
            estimate = float(off) * 2.0**-order
            orbit = replace(finer, error=estimate)
            if estimate <= error:
                return orbit
            if orbit.steps * 2 > most or off > WORST_ERROR:
                status = OrbitStatus.NOT_RESOLVED
                why = f" The estimated error is {estimate:.0e} with {orbit.steps} steps."
                return replace(orbit, status=status, message=status.message + why)
        return orbit
