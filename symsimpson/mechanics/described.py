"""The Lagrangian, mass matrix and equations that follow from the declaration of a system."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import ModelError
from symsimpson.mechanics.declared import Declared
from symsimpson.support.calling import explaining

__all__ = ["Described"]

#: What the rest of the package asks a system for, and users do not.
INNER = frozenset({"digest", "large", "mass_checked", "plain", "retimer", "retiming", "seconds"})


@explaining(ModelError)
class Described(Declared):
    """Properties that follow from the declaration of a system, in the user's own symbols."""

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates, less that of constraints of positions."""
        return self.n - len(self.constraints)

    @property
    def velocity_degrees_of_freedom(self) -> int:
        """Number of coordinates, less that of all constraints: velocities that are free."""
        return self.degrees_of_freedom - len(self.velocity_constraints)

    @cached_property
    def equations(self) -> tuple[sp.Eq, ...]:
        """The Euler-Lagrange equations d/dt dL/dv - dL/dq = f, one for each coordinate, in SymPy.

        Of a system with constraints, with -Phi^T lambda on the right, and phi = 0 after them; of
        those of velocities, with -A^T lambda, and A v - b = 0.

        Raises
        ------
        ModelError
            If T and V are too long for expressions of SymPy.

        Examples
        --------
        >>> import symsimpson as ss
        >>> ss.systems.henon_heiles().equations[0]
        Eq(2*x(t)*y(t) + x(t) + Derivative(x(t), (t, 2)), 0)
        """
        from symsimpson.mechanics.equations_of_motion import equations

        return equations(self)

    def linearise(
        self,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        parameters: Mapping[Any, float] | None = None,
        inputs: Mapping[Any, float] | None = None,
        t: float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the linear equations of motion about a state, x' = A x + B u.

        Constraints hold on, so multipliers change with the state. The eigenvalues of A are those of
        the motion, and zeros: two for a constraint of positions, one for one of velocities.

        Parameters
        ----------
        q0, v0 : array_like, shape (n,)
            Positions and velocities; at rest unless v0 is given.
        parameters, inputs : mapping, optional
            Values; the system's own for parameters, 0 for inputs, unless given.
        t : float
            The time, where something depends on it.

        Returns
        -------
        A : ndarray, shape (2 n, 2 n)
            How the rates of (q, v) change with (q, v).
        B : ndarray, shape (2 n, m)
            How they change with the inputs.

        Raises
        ------
        InputError
            If the state makes no sense or does not satisfy the constraints, or nothing is
            smooth there.
        ModelError
            If the system is too large.

        Examples
        --------
        >>> import numpy as np
        >>> import symsimpson as ss
        >>> A, B = ss.systems.pendulum().linearise([0.0])
        >>> bool(abs(np.linalg.eigvals(A).imag).max() ** 2 == 9.81)
        True
        """
        from symsimpson.mechanics.equations_of_motion import linearised

        return linearised(self, q0, v0, parameters, inputs, t)

    def consistent(
        self,
        q0: ArrayLike,
        v0: ArrayLike,
        fixed: Iterable[Any] = (),
        parameters: Mapping[Any, Any] | None = None,
        t: float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the nearest state that satisfies the constraints.

        Parameters
        ----------
        q0, v0 : array_like, shape (n,)
        fixed : sequence of coordinates or their names, optional
            Those that stay as they are.
        parameters : mapping, optional
            Values other than the defaults.
        t : float
            The time, where velocity constraints depend on it.

        Returns
        -------
        q0, v0 : ndarray, shape (n,)
            They satisfy phi(q) = 0, dphi/dq.v = 0 and A v = b to rounding. No state near
            them is nearer to the given ones, in the norm of M(q0).

        Raises
        ------
        InputError
            If there is no such state nearby, or the arguments make no sense.

        Examples
        --------
        >>> import symsimpson as ss
        >>> x, y = ss.coordinates("x y")
        >>> rod = ss.MechanicalSystem(
        ...     "rod", coordinates=(x, y), kinetic=(x.diff()**2 + y.diff()**2)/2, potential=y,
        ...     constraints={"length": x**2 + y**2 - 1})
        >>> q, v = rod.consistent([0.6, -0.7], [1.0, 0.0], fixed=["x"])
        >>> q.round(12).tolist(), v.round(12).tolist()
        ([0.6, -0.8], [1.0, 0.75])
        """
        from symsimpson.mechanics.consistent import consistent

        return consistent(self, q0, v0, fixed, parameters, t)

    def __repr__(self) -> str:
        names = ", ".join(q.func.__name__ for q in self.coordinates)
        return f"MechanicalSystem({self.name!r}, coordinates=({names}))"

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name not in INNER]

    def _repr_latex_(self) -> str:
        from symsimpson.mechanics.latex import system

        return system(self)
