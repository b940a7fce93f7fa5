"""Values of the equations at given states, or after one step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.observed import evaluate_energy
from symsimpson.program.program import Program
from symsimpson.run.requested import end_of_step
from symsimpson.run.step_equations import At, evaluate_curvature, evaluate_equations
from symsimpson.stepping.driving import node_times
from symsimpson.stepping.request import Request, of_a_step, step_request
from symsimpson.stepping.spec import read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explaining

if TYPE_CHECKING:
    from symsimpson.run.loop import ControlLoop
    from symsimpson.stepping.event import Event

Parameters = Mapping[Any, Any]


@explaining()
class Evaluator:
    """The kernels of one module, which evaluate equations at any state and take single steps.

    :class:`Stepper` adds whole runs, and describes parameters and attributes.
    """

    def __init__(self, program: Program) -> None:
        if not isinstance(program, Program):
            reject(
                f"a stepper is made of a program, and {type(program).__name__} is none.",
                remedy="Make one with symsimpson.compile(system, scheme), or "
                "symsimpson.load(path).",
            )
        #: The module, compiled, as the package knows it.
        self.program = program
        self.source, self.reference_state = program.source, program.reference_state
        self.system, self.scheme, self.order = program.system, program.scheme, program.order
        self.coordinates, self.parameters = program.coordinates, program.parameters
        self.inputs, self.invariants = program.inputs, program.invariants

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.program.n

    @property
    def units(self) -> dict[str, str]:
        """Units of quantities by name, as they were declared with the system."""
        return self.program.units

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.program,)

    def __repr__(self) -> str:
        return f"Stepper({self.system}, {self.scheme}, order {self.order})"

    def residual(
        self,
        q0: ArrayLike,
        p0: ArrayLike,
        nodes: ArrayLike,
        h: float,
        parameters: Parameters | None = None,
        *,
        t: float = 0.0,
        inputs: Any = None,
        multipliers: ArrayLike | None = None,
    ) -> Reals:
        """Evaluate the discrete Euler-Lagrange equations at given nodes.

        Parameters
        ----------
        q0, p0 : array_like, shape (n,)
        nodes : array_like, shape (d, n)
            Control points X_1..X_d of the path; the last is q1.
        h : float
        parameters : mapping, optional
        t : float, optional
            When the step begins.
        inputs : mapping or array_like, optional
            Those of the step, as for one of :meth:`Stepper.integrate`.
        multipliers : array_like, shape (d, m), optional
            mu_k of the constraints at X_0..X_(d-1), impulses.

        Returns
        -------
        ndarray, shape (d n,) or (d (n + m),)
            D_k L_d for k = 1..d-1, then p0 + D_0 L_d. With multipliers, these less Phi^T mu_k, and
            after them phi(X_k) for k = 1..d.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> q1, p1 = stepper.step([1.0], p=[0.0], h=0.01)
        >>> bool(abs(stepper.residual([1.0], [0.0], [q1], h=0.01)).max() < 1e-14)
        True
        """
        at = At(q0, nodes, h, parameters, t, inputs, multipliers)
        return evaluate_equations(self.program, at, p0)[0]

    def jacobian(
        self,
        q0: ArrayLike,
        p0: ArrayLike,
        nodes: ArrayLike,
        h: float,
        parameters: Parameters | None = None,
        *,
        t: float = 0.0,
        inputs: Any = None,
        multipliers: ArrayLike | None = None,
    ) -> Reals:
        """Evaluate the exact Jacobian of :meth:`residual` by the nodes, shape (d n, d n).

        With multipliers it is that by the nodes and by these, shape (d (n + m), d (n + m)).

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> stepper.jacobian([1.0], [0.0], [[0.9]], h=0.01).shape
        (1, 1)
        """
        at = At(q0, nodes, h, parameters, t, inputs, multipliers)
        return evaluate_equations(self.program, at, p0)[1]

    def hessian(
        self,
        q0: ArrayLike,
        nodes: ArrayLike,
        h: float,
        weights: ArrayLike,
        parameters: Parameters | None = None,
        *,
        t: float = 0.0,
        inputs: Any = None,
        multipliers: ArrayLike | None = None,
        constraint_weights: ArrayLike | None = None,
        wrt: str | Sequence[Any] = (),
    ) -> Reals:
        """Evaluate second derivatives of weighted equations, sum_k weights_k . D_k L_d.

        Programmes of optimal control, whose Lagrangian they are part of, ask for these. A kernel
        for them is derived and compiled when it is first asked for.

        Parameters
        ----------
        q0, nodes, h, parameters, t, inputs, multipliers
            As for :meth:`residual`.
        weights : array_like, shape (d + 1, n)
            Those of D_k L_d for k = 0..d, of forces too; with multipliers less Phi(X_k)^T mu_k.
        constraint_weights : array_like, shape (d + 1, m), optional
            Weights of phi(X_k), which are added.
        wrt : str, symbol or sequence of them
            Parameters and inputs to differentiate by, besides control points and multipliers; "h"
            and "t", the size of the step and the time of its start.

        Returns
        -------
        ndarray, shape (K, K)
            By X_0, ..., X_d, n columns each; by mu_0, ..., mu_(d-1), m each; by what ``wrt`` names:
            a column for a parameter, and s for an input, by its values at the nodes. Symmetric.

        Raises
        ------
        InputError
            If shapes are other ones, or a step has no equations.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> H = stepper.hessian([1.0], [[0.9]], h=0.1, weights=[[0.5], [2.0]], wrt="l")
        >>> H.shape, bool(abs(H - H.T).max() == 0)
        ((3, 3), True)
        """
        at = At(q0, nodes, h, parameters, t, inputs, multipliers)
        return evaluate_curvature(self.program, at, weights, constraint_weights, wrt)

    def energy(
        self,
        q: ArrayLike,
        p: ArrayLike,
        parameters: Parameters | None = None,
        *,
        t: ArrayLike = 0.0,
    ) -> Reals:
        """Evaluate the Hamiltonian at states of any origin.

        Parameters
        ----------
        q, p : array_like, shape (N, n)
        parameters : mapping, optional
        t : float or array_like, shape (N,), optional
            Times of the states, where T or V depend on it.

        Returns
        -------
        ndarray, shape (N,)

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> stepper.energy([[0.0]], [[0.0]]).round(2)
        array([-9.81])
        """
        return evaluate_energy(self.program, q, p, parameters, t)

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
