"""Searches for orbits: the solution of the equations, and the verdict on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import reject
from symsimpson.results.trajectory import Trajectory
from symsimpson.study.orbits.boundary_path import Path
from symsimpson.study.orbits.flow import Flow, scale_of
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
#: Motion of positions that is only round-off, relative to the scale.
ROUNDED = 1e-12
#: The least period as a part of its guess, and the largest number of repetitions.
SHRUNK, MOST_REPEATED = 1e-3, 12
#: Singular values of D - I below this part of the largest derivative are zeros.
NULL = 1e-9
#: The return of a run over an orbit, relative to the scale and to the growth of deviations.
RETURN = 1e-10
#: An orbit with a larger error, or with the most steps, is not resolved.
WORST_ERROR, MOST_STEPS = 1e-2, 2**16


@dataclass(frozen=True)
class Search:
    """A stepper, the equations of its orbit, and what remains of the arguments."""

    stepper: Stepper
    shooting: Shooting
    given: Any  #: The arguments of the search, for families.
    symplectic: bool
    tools: Any  #: The functions that results call: they need other parts of this room.
    mirror: Floats | None = None  #: The reversal of (q, p), for orbits with conditions half-way.

    @property
    def flow(self) -> Flow:
        """The runs of the search."""
        return self.shooting.flow

    def with_flow(self, flow: Flow) -> Search:
        """Return the search with other steps."""
        return replace(self, shooting=replace(self.shooting, flow=flow))

    def refined(self, factor: int) -> Search:
        """Return the search with ``factor`` times as many steps."""
        if not isinstance(factor, int) or factor < 1:
            reject(f"factor is {factor!r}.", remedy="Pass a whole number from 2 on.")
        return self.with_flow(self.flow.refined(factor))

    def scaled_to(self, orbit: Orbit) -> Search:
        """Return the search with the scale of an orbit."""
        period, scale = orbit.period / self.flow.parts, scale_of(orbit.states)
        return replace(self, shooting=replace(self.shooting, scale=scale, reference_period=period))

    def point_of(self, path: Path) -> OrbitUnknowns:
        """Return the unknowns of a result, in as many segments as the search has."""
        states, period = np.concatenate([path.q0, path.p0])[None], path.period / self.flow.parts
        if self.flow.segments > 1:
            run = path.trajectory
            parts = np.arange(self.flow.segments) / (self.flow.segments * self.flow.parts)
            states = run.sol(run.t[0] + (run.t[-1] - run.t[0]) * parts).T
        unfolding = np.zeros(self.shooting.unfolded)
        return OrbitUnknowns(states, period, path.values, self.extra(path), unfolding)

    def extra(self, path: Path) -> Floats:
        """Return the values of the unknowns that are no parameters."""
        return np.array([path.unknowns[str(x)] for x in self.shooting.symbols], dtype=np.float64)

    def orbit_near(self, orbit: Orbit) -> Orbit:
        """Solve the equations from another solution of them."""
        return self.orbit(self.shooting.solve(self.point_of(orbit)))

    # -- results

    def fields(self, solution: Solution) -> dict[str, Any]:
        """Return the fields that all results have."""
        sweep, n, parts = solution.sweep, self.flow.n, self.flow.parts
        point, period = sweep.point, sweep.point.period
        if self.flow.to_event:
            period = sweep.legs[-1].t - float(self.flow.spec.t0)
        unknowns = {self.stepper.parameters[k]: float(point.values[k]) for k in self.flow.places}
        unknowns |= dict(zip(map(str, self.shooting.symbols), point.extra.tolist(), strict=True))
        return {
            "period": period * parts,
            "steps": self.flow.steps * parts,
            "q0": point.states[0, :n].copy(),
            "p0": point.states[0, n:].copy(),
            "values": point.values,
            "unknowns": unknowns,
            "residual": sweep.size,
            "iterations": len(solution.corrections),
            "corrections": solution.corrections,
            "search": self,
        }

    def path(self, solution: Solution) -> Path:
        """Return the result of a search between boundaries."""
        status = self._status_of_rows(solution, 1.0)
        message = self._message(status, self._reason(status, solution))
        return Path(status=status, message=message, **self.fields(solution))

    def orbit(self, solution: Solution, *, examined: bool = True) -> Orbit:
        """Return an orbit with its multipliers, and a verdict if it is to be ``examined``."""
        D = self._derivative(solution.sweep)
        status = self._status_of_rows(solution, self._growth(D))
        draft = Orbit(
            status=status,
            message="",
            derivative=D,
            **self._multipliers(self._scaled(D))._asdict(),
            unfolding=float(abs(solution.sweep.point.unfolding).max(initial=0.0)),
            **self.fields(solution),
        )
        why, shorter = self._reason(status, solution), None
        if status.success and examined:
            status, why, shorter = self._examine(draft)
        message = self._message(status, why)
        return replace(draft, status=status, message=message, primitive=shorter)

    def _derivative(self, sweep: Sweep) -> Floats:
        """Return the derivative of the period map; a mirrored orbit has two halves."""
        n, closing = 2 * self.flow.n, self.shooting.closing
        if sweep.failure is not None:
            return np.full((n, n), np.nan)
        D: Floats = np.eye(n)
        for leg in sweep.legs:
            D = leg.slopes[:, :n] @ D
        if closing is not None:
            D = np.asarray(np.linalg.solve(closing.matrix, D))
        return D if self.mirror is None else self.mirror @ np.linalg.solve(D, self.mirror @ D)

    def _scaled(self, D: Floats) -> Floats:
        """Return a derivative in units of the scale."""
        return D * self.shooting.scale / self.shooting.scale[:, None]

    def _growth(self, D: Floats) -> float:
        """Return how much deviations grow, at least 1; 1 after a failure."""
        return float(np.fmax(1.0, abs(self._scaled(D)).max()))

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
        size, rounding = solution.sweep.size, 10 * np.finfo(float).eps * growth
        if not solution.converged or size > max(COARSE, rounding):
            return OrbitStatus.NOT_CONVERGED
        return OrbitStatus.FOUND if size <= max(FOUND, rounding) else OrbitStatus.FOUND_COARSE

    def _message(self, status: OrbitStatus, why: str) -> str:
        return f"{self.stepper.system}, {self.stepper.scheme}: {status.message} {why}".strip()

    def _reason(self, status: OrbitStatus, solution: Solution) -> str:
        """Return why Newton's method failed, if it did."""
        sweep = solution.sweep
        if status is OrbitStatus.STEP_FAILED and sweep.failure and sweep.failure.failed:
            return sweep.failure.failed.message
        if status is not OrbitStatus.NOT_CONVERGED or not np.isfinite(sweep.size):
            return ""
        row = int(abs(sweep.residual).argmax())
        why = f"The largest residual is {sweep.size:.1e}, of {self._row_names()[row]}."
        growth = self._growth(self._derivative(sweep))
        if growth > 100:
            why += (
                f" The motion multiplies deviations by {growth:.0f}: give the initial state to "
                "more digits, or a guess along the whole orbit."
            )
        return why

    def _row_names(self) -> list[str]:
        """Return what each row of the equations is about."""
        shooting, names = self.shooting, self.stepper.coordinates
        count = self.flow.segments - (shooting.closing is None)
        gaps = [f"the gap in {x}" for x in (*names, *(f"p_{x}" for x in names))]
        return gaps * count + [x.name for x in (*shooting.conditions, *shooting.last)]

    def _examine(self, orbit: Orbit) -> tuple[OrbitStatus, str, Orbit | None]:
        """Return the status of a solution, and why: it need not be a resolved orbit."""
        shooting, run, states = self.shooting, orbit.trajectory, orbit.states
        closing, scale = shooting.closing, shooting.scale
        if not run.success:
            return OrbitStatus.STEP_FAILED, run.message, None
        if abs(orbit.period) < SHRUNK * abs(shooting.reference_period):
            why = "The period fell to zero: give a nearer guess of it."
            return OrbitStatus.NOT_CONVERGED, why, None
        moves = abs(states - states[0]) / scale
        still = (moves < AT_REST).all() or (moves[:, : self.stepper.n] < ROUNDED).all()
        if still and self.stepper.program.header.autonomous:
            return OrbitStatus.EQUILIBRIUM, "", None
        growth = self._growth(orbit.derivative)
        if closing is not None and not self.flow.to_event:
            shift, _ = closing.at(orbit.values, self.extra(orbit))
            gap = (abs(states[-1] - closing.matrix @ states[0] - shift) / scale).max()
            if gap > RETURN * growth:
                why = f"A run over one period returns within {gap:.0e} of the scale only."
                return OrbitStatus.NOT_RESOLVED, why, None
        if orbit.unfolding > UNFOLDED or not orbit.trivial <= TRIVIAL * growth**0.25:
            why = (
                f"The unfolding is {orbit.unfolding:.0e} of the scale, and trivial multipliers "
                f"differ from 1 by {orbit.trivial:.0e}."
            )
            return OrbitStatus.NOT_RESOLVED, why, None
        if (primitive := self._primitive(orbit)) is not None:
            return OrbitStatus.SHORTER, "", primitive
        if self.symplectic and self.mirror is None:
            off = self._scaled(orbit.derivative) - np.eye(len(scale))
            sizes = np.linalg.svd(off, compute_uv=False)
            if (sizes < NULL * max(1.0, sizes[0])).sum() > shooting.integrals.count:
                return OrbitStatus.NOT_ISOLATED, "", None
        return orbit.status, "", None

    def _primitive(self, orbit: Orbit) -> Orbit | None:
        """Return the orbit of the shortest period if this one repeats it."""
        closing = self.shooting.closing
        plain = closing is not None and closing.order == 1 and not closing.moves
        if not plain or not self.flow.free_period or self.flow.retimed:
            return None
        states = orbit.states
        moves = abs(np.diff(states, axis=0)).max(axis=0)
        for k in range(MOST_REPEATED, 1, -1):
            at = states[round(self.flow.steps / k)]
            if (abs(at - states[0]) > moves).any():  # more than a step away
                continue
            if self.flow.steps % k:
                at = orbit.trajectory.sol(orbit.trajectory.t[0] + orbit.period / k)
            if (abs(at - states[0]) / self.shooting.scale).max() > REPEATED:
                continue
            steps = max(1, self.flow.steps // k)
            other = self.with_flow(replace(self.flow, steps=steps, segments=1))
            return other.orbit_near(replace(orbit, period=orbit.period / k))
        return None

    # -- runs

    def run(self, path: Path, **options: Any) -> Trajectory:
        """Integrate a result over its whole length, with the public method."""
        t0 = float(self.flow.spec.t0)
        timed = self.flow.retimed and not self.flow.to_event
        length = {"t_end": t0 + path.period} if timed else {"steps": path.steps}
        given = {"h": path.h, "events": self.given.events, "on_failure": "return"}
        given |= {"p0": path.p0, "t0": t0, "parameters": self.free_parameters(path)}
        return self.stepper.integrate(path.q0, progress=False, **(given | length | options))

    def free_parameters(self, path: Path) -> dict[str, float]:
        """Return the parameters that a run may be given."""
        fixed = self.stepper.program.header.from_start
        return {name: x for name, x in path.parameters.items() if name not in fixed}

    def manifold(self, orbit: Orbit, kind: str, size: float, count: int, periods: float) -> Any:
        """Run from states beside an orbit; see :meth:`Orbit.manifold`."""
        n, scale, system = self.flow.n, self.shooting.scale, self.stepper.system
        if kind not in ("unstable", "stable"):
            reject(f"kind is {kind!r}.", remedy="Pass 'unstable' or 'stable'.")
        if not self.flow.fixed_steps:
            reject("manifolds need an orbit with fixed steps and without events.", where=system)
        ahead = kind == "unstable"
        values, vectors = np.linalg.eig(orbit.derivative)
        sizes = abs(values) if ahead else 1 / np.maximum(abs(values), 1e-300)
        place = int(np.argmax(np.where(abs(values.imag) <= 1e-9 * abs(values), sizes, 0.0)))
        if sizes[place] < 1 + 1e-6:
            reject(
                f"this orbit has no {kind} manifold.",
                where=system,
                why="It is stable, or its multipliers are complex.",
            )
        direction = vectors[:, place].real / np.linalg.norm(vectors[:, place].real / scale)
        run = self.run(orbit, every=1, tangents=direction[:, None], on_failure="raise")
        some = np.unique(np.linspace(0, orbit.steps, count, endpoint=False).round().astype(int))
        beside = run.tangent[some][..., 0]
        beside = beside / np.linalg.norm(beside / scale, axis=1, keepdims=True)
        states = orbit.states[some] + size * beside
        return self.stepper.ensemble(
            states[:, :n],
            p0=states[:, n:],
            h=orbit.h if ahead else -orbit.h,
            steps=max(1, round(periods * orbit.steps)),
            t0=run.t[some] if not self.stepper.program.header.autonomous else 0.0,
            every=1,
            parameters=self.free_parameters(orbit),
            progress=False,
        )

    def refined_to(self, orbit: Orbit, error: float) -> Orbit:
        """Double the steps until the estimated error is below ``error``."""
        part = 2.0**-self.stepper.order
        while orbit.success:
            finer = orbit.refined(2)
            if not finer.success:
                return orbit
            moved = [*(finer.q0 - orbit.q0), *(finer.p0 - orbit.p0)] / self.shooting.scale
            off = max(abs(moved).max(), abs(finer.period / orbit.period - 1)) / (1 - part)
            estimate = float(off) * part
            orbit = replace(finer, error=estimate)
            if estimate <= error:
                return orbit
            if orbit.steps * 2 > MOST_STEPS or off > WORST_ERROR:
                why = f"The estimated error is {estimate:.0e} with {orbit.steps} steps."
                status = OrbitStatus.NOT_RESOLVED
                return replace(orbit, status=status, message=self._message(status, why))
        return orbit
