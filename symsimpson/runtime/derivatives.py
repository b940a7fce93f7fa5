"""What can be asked of the derivatives of steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.runs.integrate import integrate
from symsimpson.runtime.runs.spec import read_run
from symsimpson.runtime.runs.variations import read_varied, varied_stepper
from symsimpson.runtime.stepping import Stepping, of_a_step

if TYPE_CHECKING:
    from symsimpson.runtime.evaluator import Evaluator, Parameters

__all__ = ["Differentiating"]

#: float64, or numbers of mpmath in an object array.
Reals = NDArray[Any]


class Differentiating(Stepping):
    """Derivatives of steps and of runs, exact ones of what is computed."""

    def tangent(
        self,
        q: ArrayLike,
        v: ArrayLike | None = None,
        *,
        p: ArrayLike | None = None,
        h: Any,
        wrt: str | Sequence[Any] = ("q", "p"),
        t: Any = 0.0,
        inputs: Any = None,
        parameters: Parameters | None = None,
    ) -> tuple[Reals, Reals, Reals]:
        """Take one step, and differentiate it.

        Parameters
        ----------
        q, v, p : array_like, shape (n,)
            One of ``v`` and ``p`` is left out.
        h : float
        wrt : sequence of str or symbols
            "q" and "p" for positions and momenta at the start, names or symbols of parameters and
            inputs. Of an input it is the same change at all nodes.
        t, inputs, parameters
            As for :meth:`step`.

        Returns
        -------
        q1, p1 : ndarray, shape (n,)
        D : ndarray, shape (2 n, k)
            Derivatives of (q1, p1), with n columns for each of "q" and "p" and one for each name.
            Those by parameters are at given v where that was given.

        Raises
        ------
        InputError, ConvergenceError
            As :meth:`integrate`.
        SchemeError
            If steps of the scheme, or of the system, are not differentiated.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> q1, p1, D = stepper.tangent([1.0], p=[0.0], h=0.01, wrt=("q", "p", "l"))
        >>> D.shape, round(float(np.linalg.det(D[:, :2])), 12)
        ((2, 3), 1.0)
        """
        n, given = self.n, (wrt,) if isinstance(wrt, str) else tuple(wrt)
        own = [name for name in given if name not in ("q", "p")]
        stepper = varied_stepper(self, read_varied(self, own))
        spec = read_run(
            stepper, (q, v, p), (h, None, 1, t), parameters, None, of_a_step(stepper, inputs), 2 * n
        )  # fmt: skip
        end = integrate(stepper, spec, None, None, None, "raise")
        assert end._tangents is not None
        D = end._tangents[0]
        places = {"q": range(n), "p": range(n, 2 * n)}
        columns: list[int] = []
        for name in given:
            columns += places.get(name) or [2 * n + own.index(name)]
        return end.q[0], end.p[0], D[:, columns]

    def _differentiating(self, tangents: Any, sensitivities: Any, checkpoint: Any) -> Evaluator:
        """Return the stepper that carries along what a run is asked for.

        Raises
        ------
        InputError
            If that cannot be kept in a checkpoint.
        """
        if tangents is None and sensitivities is None:
            return self
        if checkpoint is not None:
            raise InputError(
                "a checkpoint keeps states alone, and no derivatives of them.\n"
                "Leave out checkpoint, or tangents and sensitivities."
            )
        names = () if sensitivities is None else sensitivities
        return varied_stepper(self, read_varied(self, names))
