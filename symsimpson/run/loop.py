"""A run that is taken step by step, with inputs given as it goes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import ResolutionWarning, reject
from symsimpson.program.input_values import MOST_STEPS
from symsimpson.program.numbers import NOTHING
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.results.states import States
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import out_of_domain, raise_failure, trajectory_of
from symsimpson.run.integrate import started
from symsimpson.run.resolution import real_energies
from symsimpson.run.verdict import passage_in_words
from symsimpson.stepping.driving import driven, read_driving
from symsimpson.stepping.request import of_a_step
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explaining, warn
from symsimpson.support.interpreter import undisturbed
from symsimpson.support.names import counted
from symsimpson.text.quantity import velocities_by

if TYPE_CHECKING:
    from symsimpson.results.events import Events


@explaining()
class ControlLoop:
    """A run under way; made by :meth:`Stepper.start`.

    Attributes
    ----------
    t : number
        The time after the last step.
    q, p, v : ndarray, shape (n,)
        Positions, conjugate momenta and velocities there.
    energy : float
        The energy H there.
    multipliers : ndarray, shape (m,)
        Multipliers of the constraints there, with the inputs of the last step. Before the first
        step the inputs are zero.
    constraint_forces : ndarray, shape (n,)
        Generalised forces of all constraints there, with the same inputs.
    steps : int
        Steps taken.

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
            # of the last step: the driver takes them for all steps, and they change in between
            self._inputs = numbers.zeros((1, 1, nodes or 1, count))
            # its end is not known: what is zero where a step ends acts in the next one
            endless = replace(spec, steps=MOST_STEPS)
            self._run = started(program, endless, 0, 1, self._inputs)
            #: Whether a step is that of compiled code, in which nobody hears Ctrl-C.
            self._at_once = numbers.compiled and spec.run_events is None
            #: Whether a passage where M is small is to be looked at.
            self._watching = self._at_once and program.declared is not None

    def __reduce__(self) -> tuple[Any, ...]:
        run = self._run
        state = run.position(), run.W[:, 0].copy(), self._inputs
        return ControlLoop, (self.program, self._spec), state

    def __setstate__(self, state: tuple[Any, Reals, Reals]) -> None:
        position, column, self._inputs[:] = state
        self._run.put_back(position, column)  # it goes on to the same bits

    def step(self, u: ArrayLike | Mapping[Any, ArrayLike] | None = None) -> None:
        """Take a step.

        Parameters
        ----------
        u : number, array_like or mapping, optional
            The inputs of the step: of shape (m,), held over it; of shape (s, m), at its nodes; a
            number for a single input; or a mapping from each of them. None for a system without
            inputs.

        Raises
        ------
        InputError
            If an input is missing or not finite.
        ConvergenceError
            If the step could not be taken; the loop stays where it was.
        """
        program, run = self.program, self._run
        numbers = program.numbers
        if u is None and program.inputs:
            reject(
                f"{program.system} has the inputs {', '.join(program.inputs)}, and the step is "
                "given none.",
                remedy="Pass them: loop.step(u), with a number for each, or a mapping.",
            )
        with numbers.working():
            given = read_driving(program, of_a_step(u), run.h, 1, run.now)
            if run.arrived:
                reject(f"the loop is at its end: {run.reason}", remedy="Begin another one.")
            before, last, self._inputs[:] = run.step, self._inputs.copy(), given
            here = None if program.header.real_everywhere else (run.position(), run.W[:, 0].copy())
            with NOTHING if self._at_once else undisturbed():
                run.advance(before + 1)
                taken = run.alive or run.arrived
                if not taken:
                    self._inputs[:] = last
            if not taken:
                ended = self._trajectory(before + 1)
                raise_failure(run, ended, ended)
            if here is not None and self._has_no_energy():
                about = out_of_domain(program, run, run.now, before + 1)
                run.put_back(*here)
                self._inputs[:] = last
                ended = replace(self._trajectory(before + 1), **about)
                raise_failure(run, ended, ended)
            if self._watching and run.value("PIVOT_TIME") < np.inf:
                self._look_at_passage()

    def _look_at_passage(self) -> None:
        """Warn, once, where the last step and those that follow do not resolve a small M."""
        program, run, n = self.program, self._run, self.program.n
        run.rows("PIVOT_TIME", 1)[:] = np.inf
        before = run.rows("PREVIOUS", 3 * n).copy()
        states = (run.begun[0], *run.begun[1]), (run.now - run.h, before[:n], before[2 * n :])
        about = program, program.declared, states, run.h, run.parameters, self._inputs
        passed = None if program.tools is None else program.tools.unresolved_step(*about)
        if passed is not None:
            self._watching = False
            words = passage_in_words(passed, float(run.h))
            warn(f"{program.system}, {program.scheme}: {words}", ResolutionWarning)

    def _trajectory(self, steps: int) -> Trajectory:
        """Return the run so far, with its last state alone, and without the inputs of its steps."""
        run = self._run
        kept = run.stored()
        ended = trajectory_of(self.program, run, steps, run.status, self._spec, kept, 0)
        return replace(ended, driven=None)

    def events(self, name: str) -> Events:
        """Return what an event has done so far, as :meth:`Trajectory.events` of a run does.

        Parameters
        ----------
        name : str

        Returns
        -------
        Actions
        """
        return self._trajectory(self.steps).events(name)

    @property
    def ended_by(self) -> str | None:
        """The name of the event that ended the loop, within the step after the last."""
        return self._run.ended_by

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return self._run.step

    @property
    def t(self) -> Any:
        """The time after the last step."""
        run = self._run
        return self.program.numbers.single(run.end_within[0] if run.end_within else run.now)

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
            return evaluate(program, kernel, "VELOCITY", program.n, self._here(), run.parameters)[0]

    @property
    def energy(self) -> Any:
        """The energy H."""
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
        """Return the state and the inputs of the last step, as a run has them at its end."""
        program, run = self.program, self._run
        numbers = program.numbers
        result, single = numbers.result, numbers.single
        with numbers.working():
            t, q, p = map(result, self._here())
            setting = single(run.t0), single(run.h), self.steps, self.ended_by
            inputs = driven(result(self._inputs), *setting)
            values = result(run.parameters)
        return States(t=t, q=q, p=p, program=program, parameter_values=values, driven=inputs)

    def _has_no_energy(self) -> bool:
        """Return whether T or V has no value here; an event may end the loop at their bound."""
        run = self._run
        real = real_energies(self.program, self._here(), run.parameters)
        return run.end_within is None and not real.all()

    def _here(self) -> tuple[Reals, Reals, Reals]:
        """Return the time and the state, as arrays of one row."""
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
