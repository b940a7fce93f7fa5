"""Values at given states: equations, energy, expressions, by a generated module."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import ArrayLike

from symsimpson.errors import InputError
from symsimpson.program.observed import evaluate_energy
from symsimpson.program.program import Program
from symsimpson.run.step_equations import At, evaluate_curvature, evaluate_equations
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explaining

Parameters = Mapping[Any, Any]


@explaining()
class Evaluator:
    """The kernels of one module, and what they give at states of any origin.

    :class:`Stepper` is one that also takes steps, and describes parameters and attributes.
    """

    def __init__(self, program: Program) -> None:
        if not isinstance(program, Program):
            raise InputError(
                f"a stepper is made of a program, and {type(program).__name__} is none.\n"
                "Make one with symsimpson.compile(system, scheme), or symsimpson.load(path)."
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
