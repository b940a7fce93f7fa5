"""The energy along a run: its error, the work of forces on it, what the scheme keeps of it."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.numbers import workspace
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, driver_layout, work
from symsimpson.results.states import States, Stored
from symsimpson.stepping.driving import inputs_there, since
from symsimpson.stepping.inputs import varied_program
from symsimpson.stepping.run import FALLBACK_STRETCH
from symsimpson.support.array_types import Reals
from symsimpson.support.derivation import LAGRANGIAN

#: The name of the sum of all forces, and of what a run may record.
TOTAL, WORK = "total", "work"
#: The name of what velocity constraints that move do.
CONSTRAINTS = "constraints"


class Energies(Stored):
    """Energies along a run; :class:`Trajectory` is one."""

    @cached_property
    def energy_scale(self) -> Any:
        """The scale of ``energy_error``: the size of H0 or the median kinetic energy.

        The median is taken over the stored states. H0 alone says nothing where the zero of the
        potential happens to lie near it, as for a pendulum released at 90 degrees. A system at
        rest with H0 = 0 has the scale 1.
        """
        kinetic = np.sort(self._energies[:, 1])[len(self) // 2]
        scale = max(abs(self._first_energy), kinetic)
        return scale if scale > 0 else scale * 0 + 1

    @cached_property
    def energy_error(self) -> NDArray[Any]:
        """(H - H0) / :attr:`energy_scale`, shape (N + 1,), without what events gave or took.

        Raises
        ------
        InputError
            If forces do work, or the energy depends on the time.
        """
        header = self.program.header
        if not header.conservative:
            why = (
                "forces do work on it"
                if header.forces
                else "constraints that move do work on it"
                if header.carried
                else "it depends on the time"
            )
            reject(
                f"{self.program.system}: the energy is not constant, {why}, so its change does "
                "not measure the error.",
                remedy="Use run.energy_balance, the change of the energy minus "
                "the work done; run.energy and run.work are its parts.",
            )
        return (self.energy - self._first_energy - self._given) / self.energy_scale

    @property
    def _first_energy(self) -> Any:
        """The energy at the start."""
        if self.every is not None:
            return self.energy[0]
        if self.program.header.retimed:
            return self.parameters["E0"]
        return self._beginning.energy[0]

    @cached_property
    def _beginning(self) -> States:
        """The state at the start, where the last one alone is stored.

        Raises InputError if a file does not hold it.
        """
        if self.begun is None:
            reject(
                "this file holds the last state of a run alone, and not how it began, as files did "
                "before version 0.3.",
                remedy="Take the run again, or store states on the way: every=100.",
            )
        t, (q, p) = self.begun
        return self.with_states(np.array([t]), q[None], p[None])

    @cached_property
    def _given(self) -> Any:
        """The energy that events gave up to stored states, which impacts take; 0 without any."""
        if not self.records:
            return 0
        from symsimpson.results.events import energies_given

        return energies_given(self)

    @cached_property
    def _integrals(self) -> tuple[dict[str, NDArray[Any]], NDArray[Any]]:
        return integrals(self)

    @property
    def work(self) -> dict[str, NDArray[Any]]:
        """The work of each force since the start, and of all under "total", shape (N + 1,) each.

        It is h sum_i b_i f_i.v_i over the nodes of all steps, and is accurate to the order of the
        scheme; under "constraints" it is that of velocity constraints A v = b that move. Steps are
        taken again for it, unless the run was asked to ``record`` it; after one that cannot be, as
        in a passage that was not resolved, it is NaN.

        Raises
        ------
        InputError
            If only the last state is stored and work was not recorded, or the scheme is explicit.

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
        return self._integrals[0]

    @cached_property
    def power(self) -> dict[str, NDArray[Any]]:
        """The power f.v of each force at the stored states, and of all under "total".

        Inputs are those of the step that begins at a state; at the last, of the step before it.
        """
        if self.program.header.conservative:
            return {TOTAL: 0 * self.t}
        return named_parts(self.program, _powers_at(self))

    @cached_property
    def energy_balance(self) -> NDArray[Any]:
        """H - H0 minus the work of the forces plus the integral of dL/dt, shape (N + 1,).

        Zero for the exact motion, and of the order of the scheme.

        Raises
        ------
        InputError
            As for :attr:`work`.
        """
        work, lost = self._integrals
        return self.energy - self._first_energy - self._given - work["total"] + lost

    @cached_property
    def shadow_energy(self) -> NDArray[Any]:
        """The modified energy that the scheme conserves, to leading order, shape (N + 1,).

        Up to exponentially small terms the scheme is the flow of a modified Hamiltonian H + dH
        (backward error analysis). The mean of dH over a step is -(L_d - S)/h: L_d is the discrete
        Lagrangian, and S the action along a more accurate path with the same ends. For schemes of
        order 2 and 4, H oscillates by h^2 and h^4, but H + dH only by h^4 and h^8. So a drift, a
        force that is not conservative or equations that were not solved show at once. Above order
        6 it tells no more than the energy.

        Raises
        ------
        InputError
            If not all states are stored, the energy is not constant, there are constraints, or
            fewer than four steps, or these are fixed in another time.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.02, steps=100)
        >>> bool(np.ptp(run.shadow_energy) < np.ptp(run.energy) / 1000)
        True
        """
        return shadow_energy(self)

    def plot_energy(self, *, shadow: bool = False, ax: Any = None) -> Any:
        """Draw the error of the energy over time, into ``ax`` if given; returns the axes.

        Where forces do work, or the energy depends on the time, :attr:`energy_balance` is drawn;
        with ``shadow`` the change of :attr:`shadow_energy`, too.

        Raises
        ------
        InputError
            If matplotlib is not installed, or there is no shadow energy.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.plot_energy().get_ylabel()
        '(H - H0) / |H0| [$10^{-5}$]'
        """
        from symsimpson.plotting.run_figures import plot_energy

        return plot_energy(self, shadow=shadow, ax=ax)


def _powers_at(run: Stored, *, arriving: bool = False) -> Reals:
    """Evaluate the power of each force, then dL/dt where something depends on t.

    With the inputs of the step that begins at a state, or of the one that arrives there.
    """
    program, states, values = run.program, (run.t, run.q, run.p), run.parameter_values
    inputs = inputs_there(program, run.driven, run.t, arriving=arriving)
    return evaluate(program, "power", "POWER", program.header.powers, states, values, inputs)


def named_parts(program: Program, parts: Reals) -> dict[str, Reals]:
    """Name the columns of forces, and add them up."""
    names = [*program.names.forces.shown, *([CONSTRAINTS] if program.header.carried else [])]
    by_force = {name: parts[..., k] for k, name in enumerate(names)}
    return by_force | {TOTAL: sum(by_force.values(), np.zeros(parts.shape[:-1], dtype=parts.dtype))}


def integrals(run: Stored) -> tuple[dict[str, Reals], Reals]:
    """Return the work of each force and of all, and the integral of dL/dt, up to stored states.

    Each step is taken again: work is the integral h sum_i b_i f_i.v_i of the scheme, of its order.
    Behind a step that cannot be taken again they are NaN. Raises InputError if only the last state
    is stored, or the scheme is explicit.
    """
    program, header = run.program, run.program.header
    if header.conservative:
        return {TOTAL: 0 * run.t}, 0 * run.t
    if run.records and WORK not in run.recorded:
        reject(
            "the work of a run in which events acted is not known: its steps are not taken again "
            "with their parts.",
            remedy="Record it: record='work'.",
        )
    if run.every is None and WORK not in run.recorded:
        reject(
            "a run that keeps its last state alone (every=None) does not tell what work was done.",
            remedy="Record it: record='work'; or store states on the way: every=1, or every=100.",
        )
    work(header)  # refuses explicit steps
    parts = _integrated(run)
    lost = 0 * run.t if header.autonomous else parts[:, -1]
    return named_parts(program, parts), lost


def rough_parts(run: Stored) -> Reals:
    """Integrate the powers at stored states by the trapezoidal rule: of forces, then of -dL/dt."""
    begins = _powers_at(run)
    ends = _powers_at(run, arriving=True) if run.input_values.size else begins
    spans = np.diff(np.asarray(run.t, dtype=np.float64))[:, None]
    means = np.asarray(begins[:-1] + ends[1:], dtype=np.float64) / 2
    return _signed(run, np.concatenate([0 * means[:1], (spans * means).cumsum(axis=0)]))


def parts_of_work(run: Stored) -> Reals:
    """Return what each force did up to stored states, then the integral of -dL/dt."""
    return _signed(run, np.asarray(_integrated(run), dtype=np.float64))


def _signed(run: Stored, parts: Reals) -> Reals:
    """Give dL/dt, the last of powers, the sign by which H follows it."""
    if not run.program.header.autonomous:
        parts[:, -1] *= -1
    return parts


def _integrated(run: Stored) -> Reals:
    """Return the integrals of powers up to stored states, by steps taken again unless recorded."""
    if WORK in run.recorded:
        return run.recorded[WORK]
    numbers, header = run.program.numbers, run.program.header
    with numbers.working():
        return np.asarray(numbers.result(_added_up(run, header.powers)))


def _added_up(run: Stored, count: int) -> Reals:
    """Take steps again, and add up so many integrals; NaN behind one that cannot be taken so.

    Steps that the run took with more robust kernels are taken with these.
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
            since(inputs, done * every),
        )
        if reached > 1:
            done, number = done + reached - 1, int(done + reached < last)
        else:
            number += 1
        if number == len(sets):
            out[done + 1 :] = numbers.read(np.nan)
            break
    return out


#: What is summed of H and of its error at four steps: around a state, and at the first two states.
AROUND = np.array([-1, 7, 7, -1]) / 12
FIRST, SECOND = np.array([25, -23, 13, -3]) / 12, np.array([3, 13, -5, 1]) / 12
#: Nodes of the quadrature along the better path, by its degree.
NODES = {3: 5, 5: 7}


def shadow_energy(run: Stored) -> Reals:
    """Return H + dH at all states: to h^8 for schemes of order 4, to h^4 for those of order 2.

    If the scheme is the flow of H + dH, then L_d - S = -(integral of dH over the step), where S is
    the action of the exact path between the same ends. Action is stationary there, so that a path
    with small errors gives it: a Hermite polynomial through positions and velocities at both ends,
    of degree three for schemes up to order 4, and five, with accelerations, for order 6.
    Raises InputError if there is none, or states are missing.
    """
    change = changes(run)
    inner = [weight * change[k : len(change) - 3 + k] for k, weight in enumerate(AROUND)]
    ends = [side[:4] @ weights for side in (change, change[::-1]) for weights in (FIRST, SECOND)]
    at_states = np.concatenate([ends[:2], sum(inner), ends[:1:-1]])
    return np.asarray(run.energy + at_states)


def changes(run: Stored) -> Reals:
    """Return dH in the mean over each step, -(L_d - S)/h, shape (N,)."""
    _check_shadow(run)
    program = varied_program(run.program, (), LAGRANGIAN)
    return (_actions(program, run) - _discrete_actions(program, run)) / run.h


def _check_shadow(run: Stored) -> None:
    """Raise InputError unless a run has a shadow energy."""
    header = run.program.header
    reasons = {
        "its energy is not constant: look at run.energy_balance": not header.conservative,
        "its steps are fixed in another time": header.retimed,
        "events acted on it": run.records,
        "its paths are held by constraints": header.constraints,
        "not all states are stored: integrate with every=1": run.every != 1,
        "it takes four steps to tell": run.steps < 4,
        "it is found in double precision: compile without precision": run.p.dtype != np.float64,
    }
    why = next((reason for reason, applies in reasons.items() if applies), None)
    if why is not None:
        reject(f"{header.system}: there is no shadow energy of this run, {why}.")


def _discrete_actions(program: Program, run: Stored) -> Reals:
    """Return L_d of all steps, which are taken again."""
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
            f"{program.system}: the step to t = {float(run.t[reached]):g} could not be "
            "taken again.",
            remedy="Take a smaller step.",
        )
    return out[1:, 0]


def _actions(program: Program, run: Stored) -> Reals:
    """Return the actions of Hermite polynomials through the states, by Gauss quadrature."""
    degree = 3 if program.order <= 4 else 5
    places, weights = np.polynomial.legendre.leggauss(NODES[degree])
    h, q, v = run.h, run.q, run.v
    ends = [q[:-1], h * v[:-1], q[1:], h * v[1:]]
    if degree == 5:
        a = h * h * _accelerations(q, v, h)
        ends = [*ends[:2], a[:-1], *ends[2:], a[1:]]
    basis = _hermite(degree)
    total = np.zeros(run.steps)
    for place, weight in zip((places + 1) / 2, weights / 2, strict=True):
        here = sum(b(place) * x for b, x in zip(basis, ends, strict=True))
        slope = sum(b.deriv()(place) * x for b, x in zip(basis, ends, strict=True)) / h
        t = run.t[:-1] + place * h
        states, values = (t, here, slope), run.parameter_values
        L = evaluate(program, "running_cost", "NODE_COST", 1, states, values)
        total += weight * h * L[:, 0]
    return total


def _accelerations(q: Reals, v: Reals, h: Any) -> Reals:
    """Return accelerations at states, of fourth order, from those before and behind."""
    inner = 2 * (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2 - (v[2:] - v[:-2]) / (2 * h)
    one_sided = np.array([-25, 48, -36, 16, -3]) / (12 * h)
    first, last = one_sided @ v[:5], -one_sided @ v[:-6:-1]
    return np.concatenate([first[None], inner, last[None]])


def _hermite(degree: int) -> list[Polynomial]:
    """Return the polynomials for value, slope (and second derivative) at 0, then at 1."""
    count = (degree + 1) // 2
    rows = [
        [Polynomial.basis(k).deriv(m)(place) for k in range(degree + 1)]
        for place in (0, 1)
        for m in range(count)
    ]
    return [Polynomial(column) for column in np.linalg.inv(np.array(rows)).T]
