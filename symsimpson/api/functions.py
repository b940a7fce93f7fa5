"""The class ``RunFunction``: a run as a function of its initial state, parameters and inputs."""

from __future__ import annotations

from typing import Any

from symsimpson.api.frameworks import Convertible
from symsimpson.errors import reject
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.run.run_function import FunctionOfRun
from symsimpson.stepping.request import Request
from symsimpson.support.calling import explain_methods


@explain_methods()
class RunFunction(Convertible):
    """A run as a function of arrays; :meth:`Stepper.function` returns it.

    ``f(*arguments)`` returns the outputs ``of`` the run. ``wrt`` lists the arguments in their
    order. The function keeps no results, so several threads may call it at the same time.

    Each argument has the shape of its value: (n,) for a part of the initial state, () for a
    parameter, and the shape of the values in ``inputs=`` for an input, by default (steps,). Add a
    first axis of length K to run K members as one ensemble. An argument without this axis is the
    same for all members. Outputs then have the first axis, too.

    An output "q", "v" or "p" has shape (n,), and an expression has shape (). With ``every``, an
    axis of the stored states comes before them.

    Attributes
    ----------
    arguments : tuple of str
        Names of the arguments.
    outputs : tuple of str
        Names of the outputs.

    Notes
    -----
    The first call checks the step size as :meth:`Stepper.integrate` does. Later calls check that
    steps converge, that the energy is steady, and that states are finite. They warn of other
    signs of steps that are too large only where a run needs the fallback kernels.

    Examples
    --------
    >>> import numpy as np, symsimpson as ss
    >>> stepper = ss.compile(ss.systems.pendulum())
    >>> f = stepper.function(h=0.01, steps=100, of="q", wrt=("q0", "p0", "l"))
    >>> f(np.array([1.0]), np.array([0.0]), 1.0).round(4)
    array([-0.9801])
    >>> f(np.linspace(0.1, 1.0, 5)[:, None], np.zeros(1), 1.0).shape
    (5, 1)
    >>> f.jacobian([1.0], [0.0], 1.0)[2].shape
    (1,)
    """

    def __call__(self, *arguments: Any, full: bool = False) -> Any:
        """Run, and return the outputs.

        Parameters
        ----------
        *arguments : array_like
            Values of the arguments.
        full : bool, default False
            True also returns the status of the run, or an array with the statuses of the members.

        Returns
        -------
        ndarray or tuple of ndarray
            The outputs; a pair (outputs, status) with ``full``.

        Raises
        ------
        InputError
            If an argument has another shape, is complex, or is not finite.
        ConvergenceError
            If a step of a single run fails, unless ``full`` is True. Its outputs are then NaN.

        Warns
        -----
        ResolutionWarning
            If members fail, unless ``full`` is True. Their outputs are NaN.
        """
        values = self._call(arguments)
        if values is None:
            values, status = self._function.evaluate(arguments, raising=not full)
            if full:
                return self._pack(values), status
        elif full:
            return self._pack(values), Status.SUCCESS
        return values if self._several else values[0]

    def _pack_arguments(self, values: Any) -> Any:
        """Return a tuple if ``wrt`` lists several arguments."""
        return tuple(values) if self._function.several_arguments else values[0]

    def jacobian(self, *arguments: Any) -> Any:
        """Return the derivatives of all outputs by all arguments.

        Parameters
        ----------
        *arguments : array_like
            Values of the arguments.

        Returns
        -------
        ndarray, or tuples of them
            ``J[i][j]`` has the derivatives of output i by argument j. After the axis of members,
            its shape is the shape of the output followed by the shape of the argument. If ``of`` or
            ``wrt`` is a single name, this level is absent.

        Raises
        ------
        InputError
            If an argument is invalid, or the derivatives are not available.
        ConvergenceError
            If a step fails.
        SchemeError
            If steps of this scheme or system cannot be differentiated.

        Examples
        --------
        >>> import symsimpson as ss
        >>> f = ss.compile(ss.systems.pendulum()).function(h=0.01, steps=100, wrt=("q0", "p0"))
        >>> J = f.jacobian([1.0], [0.0])
        >>> round(float(J[0][0][0, 0] * J[1][1][0, 0] - J[0][1][0, 0] * J[1][0][0, 0]), 12)
        1.0
        """
        rows = self._derivatives.jacobian(arguments)
        return self._pack([self._pack_arguments(row) for row in rows])

    def jvp(self, arguments: Any, tangents: Any) -> tuple[Any, Any]:
        """Return the outputs, and their derivatives along a direction of the arguments.

        Parameters
        ----------
        arguments : tuple of array_like
            Values of the arguments.
        tangents : tuple of array_like
            The direction: an array for each argument, with its shape.

        Returns
        -------
        values, derivatives : ndarray or tuple of ndarray
            The outputs, and the product of the Jacobian with the direction.

        Raises
        ------
        InputError, ConvergenceError, SchemeError
            As for :meth:`jacobian`.

        Examples
        --------
        >>> import symsimpson as ss
        >>> f = ss.compile(ss.systems.pendulum()).function(h=0.01, steps=100, of="q")
        >>> value, change = f.jvp(([1.0], [0.0]), ([1.0], [0.0]))
        >>> value.shape, change.shape
        ((1,), (1,))
        """
        given = self._as_tuple(arguments)
        values = self._function.values(given)
        changes = self._derivatives.push_forward(given, self._as_tuple(tangents))
        return self._pack(values), self._pack(changes)

    def vjp(self, arguments: Any, cotangents: Any) -> tuple[Any, Any]:
        """Return the outputs, and the derivatives of their weighted sum by all arguments.

        Parameters
        ----------
        arguments : tuple of array_like
            Values of the arguments.
        cotangents : ndarray or tuple of ndarray
            The weights: an array for each output, with its shape.

        Returns
        -------
        values, derivatives : ndarray or tuple of ndarray
            The outputs, and an array for each argument, with its shape. The derivative by an
            argument that all members share is the sum over the members.

        Raises
        ------
        InputError, ConvergenceError, SchemeError
            As for :meth:`jacobian`.

        Examples
        --------
        >>> import symsimpson as ss
        >>> f = ss.compile(ss.systems.pendulum()).function(h=0.01, steps=100, of="q")
        >>> value, (by_q0, by_p0) = f.vjp(([1.0], [0.0]), [1.0])
        >>> by_q0.shape, by_p0.shape
        ((1,), (1,))
        """
        given = self._as_tuple(arguments)
        values, slopes = self._derivatives.pull_back(given, self._as_weights(cotangents))
        values = self._function.values(given) if values is None else values
        return self._pack(values), self._pack_arguments(slopes)

    def hvp(self, arguments: Any, cotangents: Any, tangents: Any) -> tuple[Any, Any]:
        """Return the derivatives of a weighted sum of the outputs, and their change.

        The second derivatives belong to the discrete steps, and are exact up to round-off.

        Parameters
        ----------
        arguments, cotangents
            The same arguments as for :meth:`vjp`.
        tangents : tuple of array_like
            The direction: an array for each argument, with its shape.

        Returns
        -------
        derivatives, products : ndarray or tuple of ndarray
            The derivatives that :meth:`vjp` returns, and the product of the second derivatives
            with the direction.

        Raises
        ------
        InputError
            If the system has constraints, events, contacts or a time transformation, if the scheme
            is explicit, or if an output is neither "q" nor "p". Also for the reasons of
            :meth:`jacobian`.
        ConvergenceError
            If a step fails.

        Examples
        --------
        >>> import symsimpson as ss
        >>> f = ss.compile(ss.systems.pendulum()).function(h=0.01, steps=100, of="q", wrt="q0",
        ...                                                v0=[0.0])
        >>> slope, curvature = f.hvp([1.0], [1.0], [1.0])
        >>> slope.round(3), curvature.round(3)
        (array([-0.906]), array([0.349]))
        """
        given = self._as_tuple(arguments)
        directions = self._as_weights(cotangents), self._as_tuple(tangents)
        slopes, products = self._derivatives.curve(given, *directions)
        return self._pack_arguments(slopes), self._pack_arguments(products)

    def _as_tuple(self, arguments: Any) -> tuple[Any, ...]:
        """Return the arguments as a tuple; a function of one name takes the array itself."""
        if not self._function.several_arguments:
            return (arguments,)
        if not isinstance(arguments, (tuple, list)):
            reject(
                f"the arguments are {type(arguments).__name__}, not a tuple.",
                remedy=f"Pass ({', '.join(self.arguments)},).",
            )
        return tuple(arguments)

    def _as_weights(self, cotangents: Any) -> Any:
        """Return the weights of the outputs as a tuple."""
        return cotangents if self._several else (cotangents,)

    def __repr__(self) -> str:
        program, spec = self._function.program, self._function.spec
        length = f"to t = {spec.t_end:g}" if spec.t_end is not None else f"{spec.steps} steps"
        return (
            f"RunFunction({program.system}, {program.scheme}: ({', '.join(self.arguments)}) -> "
            f"({', '.join(self.outputs)}), {length} of h={float(spec.h):g})"
        )


def make_function(
    program: Program, request: Request, of: Any, wrt: Any, threads: int | None
) -> RunFunction:
    """Return the function of a request; :meth:`Stepper.function` documents the arguments."""
    return RunFunction(FunctionOfRun(program, request, of, wrt, threads))
