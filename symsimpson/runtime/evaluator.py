"""What a generated module can compute at given states."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from numpy.typing import ArrayLike, NDArray

from symsimpson.derivation import Derivation
from symsimpson.runtime.evaluate import evaluate_energy, evaluate_equations
from symsimpson.runtime.inputs import read_parameters
from symsimpson.runtime.load import Facts, read_facts
from symsimpson.runtime.numbers import FLOAT64, Numbers

__all__ = ["Evaluator"]

#: float64, or numbers of mpmath in an object array.
Reals = NDArray[Any]
Parameters = Mapping[Any, Any]


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
        numbers: Numbers = FLOAT64,
        reference_state: Mapping[str, Any] | None = None,
        declared: Any = None,
        derivation: Derivation | None = None,
    ) -> None:
        facts = read_facts(source, where)
        self.source, self._where = source, where
        self._facts: Facts = facts
        self._numbers = numbers
        self._kernels = numbers.kernels(source, facts)
        self.system, self.scheme, self.order = facts.system, facts.scheme, facts.order
        self.coordinates, self.parameters = facts.coordinates, facts.parameters
        self.invariants, self.reference_state = facts.invariants, reference_state
        self._declared, self._derivation = declared, derivation
        self._looked_at: set[tuple[float, bytes]] = set()
        #: Names of coordinates; those that a user gave come before those of the module.
        self._coordinate_names = {name: i for i, name in enumerate(facts.coordinates)}
        if declared is not None:
            users = {q.func.__name__: i for i, q in enumerate(declared.coordinates)}
            self._coordinate_names |= users
        self._aliases = {name: i for i, name in enumerate(facts.parameters)}
        self._defaults = numbers.read(facts.defaults)
        self._given = defaults
        if defaults is not None:
            self._aliases |= {name: i for i, name in enumerate(defaults)}
            self._defaults = numbers.read(list(defaults.values()))

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self._facts.n

    def __reduce__(self) -> tuple[Any, ...]:
        state = self.reference_state
        given = {
            "defaults": self._given and dict(self._given), "declared": self._declared,
            "reference_state": state and dict(state), "numbers": self._numbers,
        }  # fmt: skip
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
    ) -> Reals:
        """Evaluate the discrete Euler-Lagrange equations at given nodes.

        Parameters
        ----------
        q0, p0 : array_like, shape (n,)
        nodes : array_like, shape (d, n)
            Control points X_1..X_d of the path; the last is q1.
        h : float
        parameters : mapping, optional

        Returns
        -------
        ndarray, shape (d n,)
            D_k L_d for k = 1..d-1, then p0 + D_0 L_d.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> q1, p1 = stepper.step([1.0], [0.0], h=0.01)
        >>> bool(abs(stepper.residual([1.0], [0.0], [q1], h=0.01)).max() < 1e-14)
        True
        """
        return evaluate_equations(self, q0, p0, nodes, h, parameters)[0]

    def jacobian(
        self,
        q0: ArrayLike,
        p0: ArrayLike,
        nodes: ArrayLike,
        h: float,
        parameters: Parameters | None = None,
    ) -> Reals:
        """Evaluate the exact Jacobian of :meth:`residual` by the nodes, shape (d n, d n).

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
        >>> stepper.jacobian([1.0], [0.0], [[0.9]], h=0.01).shape
        (1, 1)
        """
        return evaluate_equations(self, q0, p0, nodes, h, parameters)[1]

    def energy(self, q: ArrayLike, p: ArrayLike, parameters: Parameters | None = None) -> Reals:
        """Evaluate the Hamiltonian at states of any origin.

        Parameters
        ----------
        q, p : array_like, shape (N, n)
        parameters : mapping, optional

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
        return evaluate_energy(self, q, p, parameters)

    def _named_values(self, given: Parameters | None = None) -> dict[str, Any]:
        return dict(zip(self.parameters, self._values(given).tolist(), strict=True))

    def _values(self, given: Parameters | None) -> Reals:
        facts = self._facts
        return read_parameters(
            self.parameters, self._aliases, facts.signs, self._defaults, given, self._numbers
        )
