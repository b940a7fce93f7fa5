"""The energy during a run: its error, the work of forces, and the shadow energy."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.evaluation import evaluate
from symsimpson.program.numbers import workspace
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, driver_layout, work
from symsimpson.results.states import FinishedRun, States
from symsimpson.stepping.driving import inputs_at_times, inputs_from_step
from symsimpson.stepping.inputs import program_with_derivatives
from symsimpson.stepping.run import FALLBACK_STRETCH
from symsimpson.support.array_types import Reals
from symsimpson.support.derivation import LAGRANGIAN

#: The key of the sum over all forces, and the name that ``record`` takes.
TOTAL, WORK = "total", "work"
#: The key of the work that moving velocity constraints do.
CONSTRAINTS = "constraints"


class Energies(FinishedRun):
    """The energies of a run; :class:`Trajectory` inherits them."""

    @cached_property
    def energy_scale(self) -> Any:
        """The scale of ``energy_error``: the larger of abs(H0) and the median kinetic energy.

        The median is taken over the stored states. The kinetic energy matters if H0 is near zero,
        as for a pendulum released at 90 degrees. A system at rest with H0 = 0 has the scale 1.
        """
        kinetic = np.sort(self._energies[:, 1])[len(self) // 2]
        scale = max(abs(self._initial_energy), kinetic)
        return scale if scale > 0 else scale * 0 + 1

    @property
    def has_constant_energy(self) -> bool:
        """Whether the energy is constant, apart from impacts."""
        works = self.history is not None and self.history.works
        return bool(self.program.header.conservative) and not works

    @cached_property
    def energy_error(self) -> NDArray[Any]:
        """The relative energy error (H - H0) / :attr:`energy_scale`, shape (N + 1,).

        Energy that events add or dissipate is subtracted.

        Raises
        ------
        InputError
            If forces do work, or the energy depends on the time.
        """
        header, works = self.program.header, self.history is not None and self.history.works
        if not self.has_constant_energy:
            cause = (
                "friction or moving contacts do work"
                if works
                else "forces do work"
                if header.forces
                else "moving constraints do work"
                if header.carried
                else "it depends on the time"
            )
            reject(
                f"the energy is not constant: {cause}.",
                where=self.program.system,
                why="Its change therefore does not measure the error.",
                remedy="Use run.energy_balance, the change of the energy minus the work done. "
                "run.energy and run.work are its parts.",
            )
        return (self.energy - self._initial_energy - self._energy_from_events) / self.energy_scale

    @property
    def _initial_energy(self) -> Any:
        """The initial energy H0."""
        if self.every is not None:
            return self.energy[0]
        if self.program.header.retimed:
            return self.parameters["E0"]
        return self._initial_state.energy[0]

    @cached_property
    def _initial_state(self) -> States:
        """The initial state of a run that stores only its final state.

        Raises InputError if a file does not contain the initial state.
        """
        if self.begun is None:
            reject(
                "this file has the final state of a run, but not the initial state.",
                why="Files written before version 0.3 do not have it.",
                remedy="Repeat the run, or store states during the run: every=100.",
            )
        t, (q, p) = self.begun
        return self.with_states(np.array([t]), q[None], p[None])

    @cached_property
    def _energy_from_events(self) -> Any:
        """The energy that events added up to each stored state; negative after impacts."""
        if not self.records:
            return 0
        from symsimpson.results.events import event_energies

        return event_energies(self)

    @cached_property
    def _work_integrals(self) -> tuple[dict[str, NDArray[Any]], NDArray[Any]]:
        """The work of the forces, and the integral of dL/dt."""
        return integrate_powers(self)

    @property
    def work(self) -> dict[str, NDArray[Any]]:
        """The work of each force since the initial time, by name, shape (N + 1,) each.

        The key "total" has the sum over all forces. The key "constraints" has the work of moving
        velocity constraints A v = b. The work is h sum_i b_i f_i.v_i over the nodes of all steps,
        and has the order of the scheme.

        The first access repeats the steps, unless the run has ``record="work"``. If a step cannot
        be repeated, as in an unresolved passage of a singular point, later values are NaN.

        Raises
        ------
        InputError
            If the run stores only its final state and did not record the work, or the scheme is
            explicit.

        Examples
        --------
        >>> import sympy as sp, symsimpson as ss
        >>> (x,) = ss.coordinates("x")
        >>> brake = ss.MechanicalSystem("brake", coordinates=(x,), kinetic=x.diff()**2/2,
        ...                             potential=0*x, forces={x: -x.diff()})
        >>> run = ss.compile(brake).integrate([0.0], v0=[1.0], h=0.1, t_end=1.0)
        >>> float(run.work["total"][-1].round(6))  # (exp(-2) - 1)/2
        -0.432332
        """
        return self._work_integrals[0]

    @cached_property
    def power(self) -> dict[str, NDArray[Any]]:
        """The power f.v of each force at the stored states, by name, shape (N + 1,) each.

        The key "total" has the sum over all forces. The inputs at a state are those of the step
        that begins there. The inputs at the final state are those of the last step.
        """
        if self.history is not None:
            from symsimpson.results.mode_history import powers

            forces = len(self.program.names.forces.shown)
            return powers(self, _evaluate_powers(self) if forces else 0 * self.q)
        if self.program.header.conservative:
            return {TOTAL: 0 * self.t}
        return name_columns(self.program, _evaluate_powers(self))

    @cached_property
    def energy_balance(self) -> NDArray[Any]:
        """H - H0 minus the work of the forces plus the integral of dL/dt, shape (N + 1,).

        The balance is zero for the exact motion. Its error has the order of the scheme.

        Raises
        ------
        InputError
            For the same reasons as :attr:`work`.
        """
        work, by_time = self._work_integrals
        change = self.energy - self._initial_energy - self._energy_from_events
        return change - work["total"] + by_time

    @cached_property
    def shadow_energy(self) -> NDArray[Any]:
        """The modified energy H + dH that the scheme conserves, to leading order, shape (N + 1,).

        Up to exponentially small terms, the scheme is the exact flow of a modified Hamiltonian
        H + dH (Hairer, Lubich and Wanner, IX, backward error analysis). The mean of dH over a step
        is -(L_d - S)/h. L_d is the discrete Lagrangian, and S is the action along a more accurate
        path with the same ends.

        For schemes of order 2 and 4, H oscillates with amplitude O(h^2) and O(h^4), but H + dH only
        with O(h^4) and O(h^8). A drift, a nonconservative force or an unsolved equation is
        therefore visible at once. Above order 6, the shadow energy shows no more than the energy.

        Raises
        ------
        InputError
            If not all states are stored, the energy is not constant, or the run has fewer than four
            steps. Also if the system has constraints or a time transformation.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.02, steps=100)
        >>> bool(np.ptp(run.shadow_energy) < np.ptp(run.energy) / 1000)
        True
        """
        return shadow_energy(self)

    def plot_energy(self, *, shadow: bool = False, ax: Any = None) -> Any:
        """Draw the energy error over time.

        If forces do work, or the energy depends on the time, the method draws
        :attr:`energy_balance`.

        Parameters
        ----------
        shadow : bool, default False
            True also draws the change of :attr:`shadow_energy`.
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes.

        Returns
        -------
        matplotlib axes
            The axes of the figure.

        Raises
        ------
        InputError
            If matplotlib is not installed, or the run has no shadow energy.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.plot_energy().get_ylabel()
        '(H - H0) / |H0| [$10^{-5}$]'
        """
        from symsimpson.plotting.run_figures import plot_energy

        return plot_energy(self, shadow=shadow, ax=ax)


def _evaluate_powers(run: FinishedRun, *, arriving: bool = False) -> Reals:
    """Evaluate the power of each force at the stored states, then dL/dt if L depends on t.

    The inputs are those of the step that begins at a state, or of the ``arriving`` step.
    """
    program, states, values = run.program, (run.t, run.q, run.p), run.parameter_values
    inputs = inputs_at_times(program, run.driven, run.t, arriving=arriving)
    return evaluate(program, "power", "POWER", program.header.powers, states, values, inputs)


def name_columns(program: Program, parts: Reals) -> dict[str, Reals]:
    """Return the columns of the forces by name, and their sum as "total"."""
    names = [*program.names.forces.shown, *([CONSTRAINTS] if program.header.carried else [])]
    by_force = {name: parts[..., k] for k, name in enumerate(names)}
    return by_force | {TOTAL: sum(by_force.values(), np.zeros(parts.shape[:-1], dtype=parts.dtype))}


def integrate_powers(run: FinishedRun) -> tuple[dict[str, Reals], Reals]:
    """Return the work of each force by name, and the integral of dL/dt, at the stored states.

    The function repeats each step, and sums h sum_i b_i f_i.v_i over its nodes. If a step cannot
    be repeated, later values are NaN. Raises InputError if the run stores only its final state, or
    the scheme is explicit.
    """
    program, header = run.program, run.program.header
    if run.history is not None:
        from symsimpson.results.mode_history import recorded_work

        return recorded_work(run)
    if header.conservative:
        return {TOTAL: 0 * run.t}, 0 * run.t
    if run.records and WORK not in run.recorded:
        reject(
            "the work is unknown, because events acted on this run.",
            why="Steps that an event divides are not repeated.",
            remedy="Record it: record='work'.",
        )
    if run.every is None and WORK not in run.recorded:
        reject(
            "the work is unknown, because this run stored only its final state (every=None).",
            remedy="Record it: record='work'; or store states during the run: every=1, or "
            "every=100.",
        )
    work(header)  # raises InputError if the steps are explicit
    parts = _power_integrals(run)
    return name_columns(program, parts), 0 * run.t if header.autonomous else parts[:, -1]


def approximate_work(run: FinishedRun) -> Reals:
    """Integrate the powers of the forces, then -dL/dt, by the trapezoidal rule over stored states.

    The result has a column for each force, and one for -dL/dt if L depends on t.
    """
    begins = _evaluate_powers(run)
    ends = _evaluate_powers(run, arriving=True) if run.input_values.size else begins
    spans = np.diff(np.asarray(run.t, dtype=np.float64))[:, None]
    means = np.asarray(begins[:-1] + ends[1:], dtype=np.float64) / 2
    return _negate_time_part(run, np.concatenate([0 * means[:1], (spans * means).cumsum(axis=0)]))


def exact_work(run: FinishedRun) -> Reals:
    """Return the work of each force at the stored states, then the integral of -dL/dt."""
    return _negate_time_part(run, np.asarray(_power_integrals(run), dtype=np.float64))


def _negate_time_part(run: FinishedRun, parts: Reals) -> Reals:
    """Negate the last column, the integral of dL/dt, in place: dH/dt = -dL/dt."""
    if not run.program.header.autonomous:
        parts[:, -1] *= -1
    return parts


def _power_integrals(run: FinishedRun) -> Reals:
    """Return the recorded integrals of the powers at the stored states, or repeat the steps."""
    if WORK in run.recorded:
        return run.recorded[WORK]
    numbers, header = run.program.numbers, run.program.header
    with numbers.working():
        return np.asarray(numbers.result(_replay_work(run, header.powers)))


def _replay_work(run: FinishedRun, count: int) -> Reals:
    """Repeat the steps and sum ``count`` integrals, shape (N + 1, count).

    Like the run, the function tries the next set of kernels if a step fails. If all sets fail,
    later values are NaN.
    """
    program, every = run.program, run.every
    assert every is not None
    numbers, header, kernels = program.numbers, program.header, program.kernels
    W = workspace(header, numbers, numbers.read(run.parameter_values))
    t, q, p, h = map(numbers.read, (run.t, run.q, run.p, run.h))
    out, inputs = numbers.zeros((len(run), count)), numbers.read(run.input_values)
    recorder, sets = work(header), kernels.fallbacks
    assert recorder is not None
    at = driver_layout(header, (recorder,))
    done, number = 0, 0
    while done < len(run) - 1:
        last = len(run) if number == 0 else min(len(run), done + 1 + FALLBACK_STRETCH)
        some = slice(done, last)
        reached: int = numbers.driver("replay")(
            kernels.set(sets[number], (recorder,), again=True),
            (h.item(), t[some], W, at),
            (q[some], p[some]),
            every,
            False,
            out[some],
            inputs_from_step(inputs, done * every),
        )
        if reached > 1:
            done, number = done + reached - 1, int(done + reached < last)
        else:
            number += 1
        if number == len(sets):
            out[done + 1 :] = numbers.read(np.nan)
            break
    return out


#: Weights of dH in four consecutive steps, for a state between them and for the first two states.
AROUND = np.array([-1, 7, 7, -1]) / 12
FIRST, SECOND = np.array([25, -23, 13, -3]) / 12, np.array([3, 13, -5, 1]) / 12
#: Number of Gauss nodes for the action of a Hermite polynomial, by its degree.
NODES = {3: 5, 5: 7}


def shadow_energy(run: FinishedRun) -> Reals:
    """Return H + dH at all states, up to h^8 for schemes of order 4 and h^4 for order 2.

    If the scheme is the flow of H + dH, then L_d - S = -(integral of dH over the step). S is the
    action of the exact path between the same ends. The action is stationary there, so an
    approximate path is sufficient: a Hermite polynomial through positions and velocities at both
    ends. Its degree is three for schemes up to order 4. For order 6 its degree is five, and it
    matches accelerations, too. Raises InputError if the run has no shadow energy.
    """
    change = mean_corrections(run)
    inner = [weight * change[k : len(change) - 3 + k] for k, weight in enumerate(AROUND)]
    ends = [side[:4] @ weights for side in (change, change[::-1]) for weights in (FIRST, SECOND)]
    at_states = np.concatenate([ends[:2], sum(inner), ends[:1:-1]])
    return np.asarray(run.energy + at_states)


def mean_corrections(run: FinishedRun) -> Reals:
    """Return the mean of dH over each step, -(L_d - S)/h, shape (N,)."""
    _check_shadow(run)
    program = program_with_derivatives(run.program, (), LAGRANGIAN)
    return (_actions(program, run) - _discrete_actions(program, run)) / run.h


def _check_shadow(run: FinishedRun) -> None:
    """Raise InputError unless a run has a shadow energy."""
    header = run.program.header
    reasons = {
        "Its energy is not constant.\nUse run.energy_balance.": not header.conservative,
        "Its steps are constant in transformed time.": header.retimed,
        "Events acted on it.": run.records,
        "The system has constraints.": header.constraints,
        "Not all states are stored.\nIntegrate with every=1.": run.every != 1,
        "It has fewer than four steps.": run.steps < 4,
        "The shadow energy needs double precision.\nCompile without precision.": (
            run.p.dtype != np.float64
        ),
    }
    reason = next((text for text, applies in reasons.items() if applies), None)
    if reason is not None:
        reject("this run has no shadow energy.", where=header.system, why=reason)


def _discrete_actions(program: Program, run: FinishedRun) -> Reals:
    """Return L_d of all steps, shape (steps,), by repeating the steps."""
    numbers, header = program.numbers, program.header
    recorder = Recorder("step_cost", header.layout["COST"], rows=1)
    kernels, out = program.kernels, numbers.zeros((run.steps + 1, 1))
    W = workspace(header, numbers, numbers.read(run.parameter_values))
    t, q, p = (np.ascontiguousarray(numbers.read(x)) for x in (run.t, run.q, run.p))
    reached = numbers.driver("replay")(
        kernels.set("newton", (recorder,), again=True),
        (float(run.h), t, W, driver_layout(header, (recorder,))),
        (q, p),
        1,
        True,
        out,
        numbers.read(run.input_values),
    )
    if reached < len(run):
        reject(
            f"the step to t = {float(run.t[reached]):g} cannot be repeated.",
            where=program.system,
            remedy="Reduce the step size h.",
        )
    return out[1:, 0]


def _actions(program: Program, run: FinishedRun) -> Reals:
    """Return the actions of Hermite polynomials between the states, by Gauss quadrature."""
    degree = 3 if program.order <= 4 else 5
    places, weights = np.polynomial.legendre.leggauss(NODES[degree])
    h, q, p, v = run.h, run.q, run.p, run.v
    canonical = program.header.canonical
    ends = [q[:-1], h * v[:-1], q[1:], h * v[1:]]
    if degree == 5:
        a = h * h * _rates(v, h)
        ends = [*ends[:2], a[:-1], *ends[2:], a[1:]]
    basis = _hermite(degree)
    if canonical:  # L = p.v - H along paths of q and p
        kicks = h * _rates(p, h)
        pushed = [p[:-1], kicks[:-1], p[1:], kicks[1:]]
        cubic = _hermite(3)
    total = np.zeros(run.steps)
    for place, weight in zip((places + 1) / 2, weights / 2, strict=True):
        here = sum(b(place) * x for b, x in zip(basis, ends, strict=True))
        slope = sum(b.deriv()(place) * x for b, x in zip(basis, ends, strict=True)) / h
        t = run.t[:-1] + place * h
        if canonical:
            there = sum(b(place) * x for b, x in zip(cubic, pushed, strict=True))
            L = (there * slope).sum(axis=-1) - run.with_states(t, here, there).energy
        else:
            states, values = (t, here, slope), run.parameter_values
            L = evaluate(program, "running_cost", "NODE_COST", 1, states, values)[:, 0]
        total += weight * h * L
    return total


def _rates(x: Reals, h: Any) -> Reals:
    """Return h^-1 times fourth-order differences: time derivatives at the states."""
    inner = (x[:-4] - 8 * x[1:-3] + 8 * x[3:-1] - x[4:]) / 12
    sides = np.array([[-25, 48, -36, 16, -3], [-3, -10, 18, -6, 1]]) / 12
    return np.concatenate([sides @ x[:5], inner, -(sides @ x[:-6:-1])[::-1]]) / h


def _hermite(degree: int) -> list[Polynomial]:
    """Return the Hermite basis for value, slope (and second derivative) at 0, then at 1."""
    count = (degree + 1) // 2
    rows = [
        [Polynomial.basis(k).deriv(m)(place) for k in range(degree + 1)]
        for place in (0, 1)
        for m in range(count)
    ]
    return [Polynomial(column) for column in np.linalg.inv(np.array(rows)).T]
