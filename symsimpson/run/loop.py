"""A run that the user advances step by step, for example in a control loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import ResolutionWarning, reject
from symsimpson.program.evaluation import evaluate
from symsimpson.program.input_values import MOST_STEPS
from symsimpson.program.numbers import NOTHING
from symsimpson.program.program import Program
from symsimpson.results.states import States
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import describe_domain_error, make_trajectory, raise_failure
from symsimpson.run.integrate import start_run
from symsimpson.run.resolution import real_energies
from symsimpson.run.verdict import describe_passage
from symsimpson.stepping.driving import make_input_history, read_input_values
from symsimpson.stepping.request import inputs_for_one_step
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explain_methods, warn
from symsimpson.support.interpreter import defer_interrupts
from symsimpson.support.names import counted
from symsimpson.text.quantity import velocities_by

if TYPE_CHECKING:
    from symsimpson.results.events import Events


@explain_methods()
class ControlLoop:
    """A run that you advance step by step; :meth:`Stepper.start` returns it.

    Attributes
    ----------
    t : number
        Time after the last step.
    q, p, v : ndarray, shape (n,)
        Positions, conjugate momenta and velocities after the last step.
    energy : float
        Energy H after the last step.
    multipliers : ndarray, shape (m,)
        Multipliers of the constraints after the last step, with the inputs of that step. Before
        the first step the inputs are zero.
    constraint_forces : ndarray, shape (n,)
        Generalised forces of all constraints, with the same inputs.
    steps : int
        Number of steps taken.
    ended_by : str or None
        Name of the terminal event that ended the loop, else None.

    Examples
    --------
    >>> import symsimpson as ss
    >>> loop = ss.compile(ss.systems.pendulum()).start([1.0], v0=[0.0], h=0.01)
    >>> loop.step()
    >>> loop.steps, loop.t
    (1, 0.01)
    >>> rod = ss.compile(ss.systems.cartesian_pendulum()).start([0, 0, -1], v0=[2, 0, 0], h=0.01)
    >>> rod.constraint_forces.round(6) + 0.0  # m (g + v^2/l)
    array([ 0.   ,  0.   , 17.953])
    """

    def __init__(self, program: Program, spec: RunSpec) -> None:
        self.program, self._spec = program, spec
        numbers = program.numbers
        nodes, count = len(program.header.input_places), len(program.inputs)
        with numbers.working():
            # inputs of the current step: the driver reads this array for all steps
            self._inputs = numbers.zeros((1, 1, nodes or 1, count))
            # the end is unknown, so an event exactly at the end of a step acts in the next step
            endless = replace(spec, steps=MOST_STEPS)
            self._run = start_run(program, endless, 0, 1, self._inputs)
            #: Whether a step is one call of compiled code, which Ctrl-C cannot interrupt.
            plain = spec.run_events is None and program.modes is None
            self._compiled_steps = numbers.compiled and plain
            #: Whether to check that steps resolve a passage with a small mass matrix.
            self._checks_passages = self._compiled_steps and program.declared is not None

    def __reduce__(self) -> tuple[Any, ...]:
        run = self._run
        state = run.position(), run.W[:, 0].copy(), self._inputs
        return ControlLoop, (self.program, self._spec), state

    def __setstate__(self, state: tuple[Any, Reals, Reals]) -> None:
        position, column, self._inputs[:] = state
        self._run.restore(position, column)

    def step(self, u: ArrayLike | Mapping[Any, ArrayLike] | None = None) -> None:
        """Take one step.

        Parameters
        ----------
        u : number, array_like or mapping, optional
            Values of the m inputs during the step. Shape (m,) means constant values, shape (s, m)
            values at the s nodes of the step. A single input may be a number. A mapping has one
            value for each input, by name or symbol. Omit it for a system without inputs.

        Raises
        ------
        InputError
            If an input is missing or not finite, or if an event has ended the loop.
        ConvergenceError
            If the step fails. The loop then keeps its state before the step.
        """
        program, run = self.program, self._run
        numbers = program.numbers
        if u is None and program.inputs:
            reject(
                f"the step needs values for the inputs {', '.join(program.inputs)}.",
                where=program.system,
                remedy="Pass loop.step(u) with a number for each input, or a mapping.",
            )
        with numbers.working():
            given = read_input_values(program, inputs_for_one_step(u), run.h, 1, run.current_time)
            if run.has_arrived:
                reject(
                    f"the loop is at its end. {run.reason}",
                    remedy="Start another loop with stepper.start.",
                )
            before, last, self._inputs[:] = run.step, self._inputs.copy(), given
            here = None if program.header.real_everywhere else (run.position(), run.W[:, 0].copy())
            with NOTHING if self._compiled_steps else defer_interrupts():
                run.advance(before + 1)
                succeeded = run.alive or run.has_arrived
                if not succeeded:
                    self._inputs[:] = last
            if not succeeded:
                ended = self._trajectory(before + 1)
                raise_failure(run, ended, ended)
            if here is not None and self._left_domain():
                about = describe_domain_error(program, run, run.current_time, before + 1)
                run.restore(*here)
                self._inputs[:] = last
                ended = replace(self._trajectory(before + 1), **about)
                raise_failure(run, ended, ended)
            if self._checks_passages and run.value("PIVOT_TIME") < np.inf:
                self._check_passage()

    def _check_passage(self) -> None:
        """Warn once if the last and the following steps do not resolve a small mass matrix."""
        program, run, n = self.program, self._run, self.program.n
        run.rows("PIVOT_TIME", 1)[:] = np.inf
        before = run.rows("PREVIOUS", 3 * n).copy()
        states = (
            (run.begun[0], *run.begun[1]),
            (run.current_time - run.h, before[:n], before[2 * n :]),
        )
        about = program, program.declared, states, run.h, run.parameters, self._inputs
        passed = None if program.tools is None else program.tools.unresolved_step(*about)
        if passed is not None:
            self._checks_passages = False
            words = describe_passage(passed, float(run.h))
            warn(f"{program.system}, {program.scheme}: {words}", ResolutionWarning)

    def _trajectory(self, steps: int) -> Trajectory:
        """Return the run so far as a trajectory with the last state only and without inputs."""
        run = self._run
        stored = run.stored_states()
        ended = make_trajectory(self.program, run, steps, run.status, self._spec, stored, 0)
        return replace(ended, driven=None)

    def events(self, name: str) -> Events:
        """Return the records of an event so far, as :meth:`Trajectory.events` does.

        Parameters
        ----------
        name : str
            Name of the event.

        Returns
        -------
        Actions
            Times, states before and after, and impulses of the event.
        """
        return self._trajectory(self.steps).events(name)

    @property
    def ended_by(self) -> str | None:
        """Name of the terminal event that ended the loop, else None."""
        return self._run.ended_by

    @property
    def steps(self) -> int:
        """Number of completed steps."""
        return self._run.step

    @property
    def t(self) -> Any:
        """Time after the last step, or the time of a terminal event."""
        run = self._run
        return self.program.numbers.single(
            run.end_within[0] if run.end_within else run.current_time
        )

    @property
    def q(self) -> Reals:
        """Positions, shape (n,)."""
        return self._state("POSITION")

    @property
    def p(self) -> Reals:
        """Conjugate momenta, shape (n,)."""
        return self._state("MOMENTUM")

    @property
    def v(self) -> Reals:
        """Velocities, shape (n,)."""
        program, run = self.program, self._run
        with program.numbers.working():
            kernel = velocities_by(run.header)
            return evaluate(
                program, kernel, "VELOCITY", program.n, self._current_rows(), run.parameters
            )[0]

    @property
    def energy(self) -> Any:
        """Energy H."""
        return self._states().energy.item(0)

    @property
    def multipliers(self) -> Reals:
        """Multipliers of the constraints, shape (m,); see :attr:`Trajectory.multipliers`."""
        return self._states().multipliers[0]

    @property
    def constraint_forces(self) -> Reals:
        """Generalised forces of the constraints, shape (n,)."""
        return self._states().constraint_forces[0]

    def _states(self) -> States:
        """Return the current state with the inputs of the last step, for derived quantities."""
        program, run = self.program, self._run
        numbers = program.numbers
        result, single = numbers.result, numbers.single
        with numbers.working():
            t, q, p = map(result, self._current_rows())
            setting = single(run.t0), single(run.h), self.steps, self.ended_by
            inputs = make_input_history(result(self._inputs), *setting)
            values = result(run.parameters)
        return States(t=t, q=q, p=p, program=program, parameter_values=values, driven=inputs)

    def _left_domain(self) -> bool:
        """Return whether the current energy is not finite, unless an event ended the loop here."""
        run = self._run
        real = real_energies(self.program, self._current_rows(), run.parameters)
        return run.end_within is None and not real.all()

    def _current_rows(self) -> tuple[Reals, Reals, Reals]:
        """Return t, q and p as arrays with one row each."""
        read = self.program.numbers.read
        return read(self.t)[None], read(self.q)[None], read(self.p)[None]

    def _state(self, block: str) -> Reals:
        if self._run.end_within is not None:
            return self._run.end_within[1 + (block == "MOMENTUM")].copy()
        return self.program.numbers.result(self._run.rows(block, self.program.n).copy())

    def __repr__(self) -> str:
        program = self.program
        return (
            f"ControlLoop({program.system}, {program.scheme}: {counted(self.steps, 'step')} of "
            f"h={float(self._run.h):g}, t = {float(self.t):g})"
        )
