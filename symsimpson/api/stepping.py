"""Steps one at a time: a single one, and control loops that give inputs as they go."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.api.evaluator import Evaluator, Parameters
from symsimpson.run.requested import end_of_step
from symsimpson.stepping.driving import node_times
from symsimpson.stepping.request import Request, of_a_step, step_request
from symsimpson.stepping.spec import read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explaining

if TYPE_CHECKING:
    from collections.abc import Sequence

    from symsimpson.run.loop import ControlLoop
    from symsimpson.stepping.event import Event


@explaining()
class Stepping(Evaluator):
    """Single steps and control loops of a stepper, to which :class:`Stepper` adds whole runs."""

    def step(
        self,
        q: ArrayLike,
        v: ArrayLike | None = None,
        *,
        p: ArrayLike | None = None,
        h: float,
        t: float = 0.0,
        inputs: Any = None,
        parameters: Parameters | None = None,
    ) -> tuple[Reals, Reals]:
        """Take one step from (q, v), or from (q, p).

        Parameters
        ----------
        q, v, p : array_like, shape (n,)
            One of ``v`` and ``p`` is left out.
        h : float
        t : float
            The time at the start.
        inputs : mapping, optional
            A number for each input, or one for each node of the step.
        parameters : mapping, optional

        Returns
        -------
        q1, p1 : ndarray, shape (n,)

        Raises
        ------
        InputError, ConvergenceError
            As :meth:`integrate`.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> q1, p1 = stepper.step([1.0], p=[0.0], h=0.01)
        >>> bool(q1[0] < 1.0), bool(p1[0] < 0.0)
        (True, True)
        """
        request = step_request(q, v, p, h, t, parameters, inputs)
        end = end_of_step(self.program, request)
        return end.q[0], end.p[0]

    def node_times(self, h: Any, steps: int, t0: Any = 0.0) -> Reals:
        """Return the times at which inputs given at nodes are taken.

        Parameters
        ----------
        h : float
        steps : int
        t0 : float, optional

        Returns
        -------
        ndarray, shape (steps, s)
            t0 + (j + c_i) h for the nodes c_i of step j.

        Raises
        ------
        InputError
            If the system has no inputs.

        Examples
        --------
        >>> import symsimpson as ss
        >>> cart = ss.compile(ss.systems.driven_cart_pole())
        >>> cart.node_times(0.1, 2).round(12).tolist()
        [[0.0, 0.05, 0.1], [0.1, 0.15, 0.2]]
        """
        return node_times(self.program, h, steps, t0)

    def start(
        self,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        p0: ArrayLike | None = None,
        h: float,
        t0: float = 0.0,
        parameters: Parameters | None = None,
        events: Sequence[Event] | None = None,
    ) -> ControlLoop:
        """Begin a run that is taken step by step, with inputs that may depend on what it does.

        Parameters
        ----------
        q0, v0, p0, h, t0, parameters, events
            As for :meth:`integrate`.

        Returns
        -------
        ControlLoop
            ``loop.step(u)`` takes a step. ``loop.t``, ``.q``, ``.p``, ``.v``, ``.energy``,
            ``.multipliers`` and ``.constraint_forces`` describe the state. Its steps are bitwise
            identical to those from :meth:`integrate`.

        Raises
        ------
        InputError
            If the arguments make no sense.

        Examples
        --------
        >>> import symsimpson as ss
        >>> cart = ss.systems.driven_cart_pole()
        >>> loop = ss.compile(cart).start([0.0, 0.1], v0=[0.0, 0.0], h=0.01)
        >>> for _ in range(100):
        ...     loop.step(-2.0 * loop.q[0] - 1.0 * loop.v[0])
        >>> round(loop.t, 12), bool(abs(loop.q[0]) < 0.5)
        (1.0, True)
        """
        from symsimpson.run.loop import ControlLoop

        zeros = np.zeros(len(self.inputs)) if self.inputs else None
        begin = q0, v0, p0, h, None, 1, t0
        request = Request(*begin, parameters, of_a_step(zeros), events=events)
        return ControlLoop(self.program, read_run(self.program, request))
