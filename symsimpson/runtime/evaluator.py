"""Values at given states: equations, energy, expressions, by a generated module."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError
from symsimpson.module.header import read_header
from symsimpson.runtime.equations import evaluate_equations
from symsimpson.runtime.evaluating import evaluate_energy
from symsimpson.runtime.inputs import read_parameters
from symsimpson.runtime.kernels.numbers import FLOAT64, Numbers
from symsimpson.runtime.loaded import Loaded, Tools
from symsimpson.runtime.names import Names
from symsimpson.support.calling import explaining
from symsimpson.support.derivation import Derivation
from symsimpson.support.names import spelled

__all__ = ["Evaluator"]

#: float64, or numbers of mpmath in an object array.
Reals = NDArray[Any]
Parameters = Mapping[Any, Any]


@explaining()
class Evaluator:
    """The kernels of one module, and what they give at states of any origin.

    :class:`Stepper` is one that also takes steps, and describes parameters and attributes.
    """

    def __init__(
        self,
        source: str,
        where: str,
        *,
        defaults: Mapping[str, float] | None = None,
        numbers: Numbers | None = None,
        reference_state: Mapping[str, Any] | None = None,
        declared: Any = None,
        derivation: Derivation | None = None,
        tools: Tools | None = None,
        differentiate: Callable[[tuple[str, ...], Any], Evaluator] | None = None,
        names: Names | None = None,
    ) -> None:
        header = read_header(source, where)
        self.source, self._where = source, where
        numbers = numbers or FLOAT64
        kernels = numbers.kernels(source, header)
        self._module = Loaded(header, numbers, kernels, declared, derivation, tools)
        self.system, self.scheme, self.order = header.system, header.scheme, header.order
        self._names = names = names or Names(header, declared, defaults)
        self.coordinates, self.parameters = names.coordinates.shown, names.parameters.shown
        self.inputs, self.invariants = names.inputs.shown, names.invariants.shown
        self.reference_state = reference_state
        self._differentiate = differentiate
        #: Steppers that differentiate by these parameters and inputs, and a running cost.
        self._variants: dict[tuple[tuple[str, ...], Any], Evaluator] = {}
        self._looked_at: set[tuple[Any, bytes]] = set()
        #: By values of parameters: a box of positions without singular points of the coordinates.
        self._regular: dict[bytes, tuple[Any, Any]] = {}
        #: How often such a box was not found.
        self._irregular: dict[bytes, int] = {}
        #: What is prepared for short runs, where states need not be looked at one by one.
        special = header.constraints or header.inputs
        free = header.real_everywhere and not special
        self._prepared: list[Any] | None = [] if free and numbers.compiled else None
        #: Steps and lengths of runs that are not short, though it did not seem so.
        self._long: set[tuple[float, float]] = set()
        #: What inputs are in runs that are given none.
        self._held: Mapping[str, float] | None = None
        self._defaults = numbers.read(header.defaults)
        self._given = defaults
        if defaults is not None:
            self._defaults = numbers.read(list(defaults.values()))

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self._module.header.n

    @property
    def units(self) -> dict[str, str]:
        """Units of quantities by name, as they were declared with the system."""
        return dict(getattr(self._module.declared, "units", {}))

    def __reduce__(self) -> tuple[Any, ...]:
        state = self.reference_state
        given = {
            "defaults": self._given and dict(self._given),
            "declared": self._module.declared,
            "reference_state": state and dict(state),
            "numbers": self._module.numbers,
            "tools": self._module.tools,
            "differentiate": self._differentiate,
            "names": self._names,
        }
        return partial(type(self), self.source, self._where, **given), ()

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
            behind them phi(X_k) for k = 1..d.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> q1, p1 = stepper.step([1.0], p=[0.0], h=0.01)
        >>> bool(abs(stepper.residual([1.0], [0.0], [q1], h=0.01)).max() < 1e-14)
        True
        """
        return evaluate_equations(self, q0, p0, nodes, h, parameters, t, inputs, multipliers)[0]

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
        return evaluate_equations(self, q0, p0, nodes, h, parameters, t, inputs, multipliers)[1]

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
        return evaluate_energy(self, q, p, parameters, t)

    def _named_values(self, given: Parameters | None = None) -> dict[str, Any]:
        return dict(zip(self.parameters, self._values(given).tolist(), strict=True))

    def _free_values(self, given: Parameters | None = None) -> dict[str, Any]:
        """Return the values of those parameters that do not follow from the start."""
        values = self._named_values(given)
        own = self._module.header.from_start
        return {name: value for name, value in values.items() if name not in own}

    def _check_given(self, given: Parameters | None) -> None:
        """Refuse values of parameters that follow from the start of a run.

        Raises
        ------
        InputError
        """
        own = self._module.header.from_start
        if own and isinstance(given, Mapping) and not own.isdisjoint(map(spelled, given)):
            raise InputError(
                f"parameters give {', '.join(sorted(own))}, or one of them, which follow from the "
                "start of a run.\nLeave them out: E0 is the energy there."
            )

    def _values(self, given: Parameters | None) -> Reals:
        if given is None:
            return self._defaults.copy()
        header = self._module.header
        self._check_given(given)
        values = read_parameters(
            self._names.parameters, header.signs, self._defaults, given, self._module.numbers
        )
        if self._names.idle:
            self._names.warn_of_idle(self.system, np.flatnonzero(values != self._defaults))
        return values
