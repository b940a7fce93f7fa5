"""Values of the discrete equations at given states, and single steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.evaluation import evaluate_energy
from symsimpson.program.program import Program
from symsimpson.run.requested import take_step
from symsimpson.run.step_equations import StepArguments, evaluate_curvature, evaluate_equations
from symsimpson.stepping.driving import node_times
from symsimpson.stepping.request import Request, inputs_for_one_step, step_request
from symsimpson.stepping.spec import read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explain_methods

if TYPE_CHECKING:
    from symsimpson.run.loop import ControlLoop
    from symsimpson.stepping.event import Event

Parameters = Mapping[Any, Any]


@explain_methods()
class Evaluator:
    """The part of a stepper that evaluates equations at any state and takes single steps.

    :class:`Stepper` adds runs. Its documentation describes the parameters and attributes.
    """

    def __init__(self, program: Program) -> None:
        if not isinstance(program, Program):
            reject(
                f"Stepper takes a compiled program, not a {type(program).__name__}.",
                remedy="Make a stepper with symsimpson.compile(system, scheme), or "
                "symsimpson.load(path).",
            )
        #: The compiled module.
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
        """Units of the quantities by name, as the system declares them."""
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
        """Evaluate the discrete Euler-Lagrange equations of one step.

        Parameters
        ----------
        q0, p0 : array_like, shape (n,)
            Positions and conjugate momenta at the start of the step.
        nodes : array_like, shape (d, n)
            Control points X_1, ..., X_d of the path. The last one is q1.
        h : float
            Step size, in the unit of time.
        parameters : mapping, optional
            Values of the parameters, by symbol or name. By default, those of the declaration.
        t : float, default 0.0
            Time at the start of the step.
        inputs : mapping or array_like, optional
            Values of the inputs during the step, as for one step of :meth:`Stepper.integrate`.
        multipliers : array_like, shape (d, m), optional
            Multipliers mu_k of the m constraints at X_0, ..., X_(d-1). They are impulses.

        Returns
        -------
        ndarray, shape (d n,) or (d (n + m),)
            D_k L_d for k = 1, ..., d-1, then p0 + D_0 L_d. With multipliers, Phi^T mu_k is
            subtracted, and phi(X_k) for k = 1, ..., d follows.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> q1, p1 = stepper.step([1.0], p=[0.0], h=0.01)
        >>> bool(abs(stepper.residual([1.0], [0.0], [q1], h=0.01)).max() < 1e-14)
        True
        """
        at = StepArguments(q0, nodes, h, parameters, t, inputs, multipliers)
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
        """Evaluate the exact Jacobian matrix of :meth:`residual` with respect to the nodes.

        Parameters
        ----------
        q0, p0, nodes, h, parameters, t, inputs, multipliers
            The same arguments as for :meth:`residual`.

        Returns
        -------
        ndarray, shape (d n, d n) or (d (n + m), d (n + m))
            The derivatives by the nodes. With multipliers, their columns follow.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> stepper.jacobian([1.0], [0.0], [[0.9]], h=0.01).shape
        (1, 1)
        """
        at = StepArguments(q0, nodes, h, parameters, t, inputs, multipliers)
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
        """Evaluate the second derivatives of the weighted equations, sum_k weights_k . D_k L_d.

        They are part of the Lagrangian's Hessian matrix in direct optimal control. The first call
        derives and compiles a kernel for them.

        Parameters
        ----------
        q0, nodes, h, parameters, t, inputs, multipliers
            The same arguments as for :meth:`residual`.
        weights : array_like, shape (d + 1, n)
            Weights of D_k L_d for k = 0, ..., d, including forces. With multipliers,
            Phi(X_k)^T mu_k is subtracted from D_k L_d.
        constraint_weights : array_like, shape (d + 1, m), optional
            Weights of phi(X_k), whose weighted sum is added.
        wrt : str, symbol or sequence of them, default ()
            Parameters and inputs to differentiate by, besides control points and multipliers. "h"
            is the step size, and "t" is the time at the start of the step.

        Returns
        -------
        ndarray, shape (K, K)
            A symmetric matrix. Its columns are derivatives by X_0, ..., X_d (n columns each), by
            mu_0, ..., mu_(d-1) (m columns each), and by the names in ``wrt``. A parameter has one
            column. An input has s columns, one for each node.

        Raises
        ------
        InputError
            If an array has another shape, or the step has no equations.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> H = stepper.hessian([1.0], [[0.9]], h=0.1, weights=[[0.5], [2.0]], wrt="l")
        >>> H.shape, bool(abs(H - H.T).max() == 0)
        ((3, 3), True)
        """
        at = StepArguments(q0, nodes, h, parameters, t, inputs, multipliers)
        return evaluate_curvature(self.program, at, weights, constraint_weights, wrt)

    def energy(
        self,
        q: ArrayLike,
        p: ArrayLike,
        parameters: Parameters | None = None,
        *,
        t: ArrayLike = 0.0,
    ) -> Reals:
        """Evaluate the Hamiltonian H at any states.

        Parameters
        ----------
        q, p : array_like, shape (N, n) or (n,)
            Positions and conjugate momenta.
        parameters : mapping, optional
            Values of the parameters, by symbol or name. By default, those of the declaration.
        t : float or array_like, shape (N,), default 0.0
            Times of the states. They matter if T or V depends on the time.

        Returns
        -------
        ndarray, shape (N,), or a number for one state
            The energies, in the unit of T and V.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> stepper.energy([[0.0]], [[0.0]]).round(2), float(stepper.energy([0.0], [0.0]))
        (array([-9.81]), -9.81)
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
        q : array_like, shape (n,)
            Positions at the start of the step.
        v, p : array_like, shape (n,), optional
            Velocities or conjugate momenta at the start of the step. Pass exactly one of them.
        h : float
            Step size, in the unit of time.
        t : float, default 0.0
            Time at the start of the step.
        inputs : mapping, optional
            For each input a number, or an array of shape (s,) with a value for each node.
        parameters : mapping, optional
            Values of the parameters, by symbol or name. By default, those of the declaration.

        Returns
        -------
        q1, p1 : ndarray, shape (n,)
            Positions and conjugate momenta at the end of the step.

        Raises
        ------
        InputError
            If an argument is invalid.
        ConvergenceError
            If the step fails.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> q1, p1 = stepper.step([1.0], p=[0.0], h=0.01)
        >>> bool(q1[0] < 1.0), bool(p1[0] < 0.0)
        (True, True)
        """
        request = step_request(q, v, p, h, t, parameters, inputs)
        end = take_step(self.program, request)
        return end.q[0], end.p[0]

    def node_times(self, h: Any, steps: int, t0: Any = 0.0) -> Reals:
        """Return the times of the nodes, at which steps evaluate the inputs.

        Parameters
        ----------
        h : float
            Step size, in the unit of time.
        steps : int
            Number of steps.
        t0 : float, default 0.0
            Initial time.

        Returns
        -------
        ndarray, shape (steps, s)
            The times t0 + (j + c_i) h for the s nodes c_i of step j.

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
        """Start a run that takes one step per call, with inputs that may depend on the state.

        Parameters
        ----------
        q0, v0, p0, h, t0, parameters, events
            The same arguments as for :meth:`integrate`.

        Returns
        -------
        ControlLoop
            ``loop.step(u)`` takes a step. ``loop.t``, ``.q``, ``.p``, ``.v``, ``.energy``,
            ``.multipliers`` and ``.constraint_forces`` describe the current state. Its steps are
            bitwise identical to those of :meth:`integrate`.

        Raises
        ------
        InputError
            If an argument is invalid.

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
        request = Request(
            q0, v0, p0, h, None, 1, t0, parameters, inputs_for_one_step(zeros), events=events
        )
        return ControlLoop(self.program, read_run(self.program, request))
