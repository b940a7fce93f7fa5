"""Values at given states: equations, energy, expressions, by a generated module."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.equations import evaluate_equations
from symsimpson.runtime.inputs import read_array, read_parameters
from symsimpson.runtime.kernels.header import Header, read_header
from symsimpson.runtime.kernels.numbers import FLOAT64, Numbers
from symsimpson.runtime.kernels.observed import Observed, observing_kernel
from symsimpson.runtime.loaded import Loaded, Tools
from symsimpson.runtime.names import Names
from symsimpson.runtime.runs.driving import NO_INPUTS
from symsimpson.runtime.runs.run import workspace
from symsimpson.support.calling import explaining
from symsimpson.support.derivation import Derivation
from symsimpson.support.names import spelled

__all__ = ["Evaluator", "evaluate", "evaluate_members", "watching"]

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
            "defaults": self._given and dict(self._given), "declared": self._module.declared,
            "reference_state": state and dict(state), "numbers": self._module.numbers,
            "tools": self._module.tools, "differentiate": self._differentiate,
            "names": self._names,
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
        return evaluate_equations(
            self, q0, p0, nodes, h, parameters, t, inputs, multipliers
        )[0]  # fmt: skip

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
        return evaluate_equations(
            self, q0, p0, nodes, h, parameters, t, inputs, multipliers
        )[1]  # fmt: skip

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
            self._names.parameters,
            header.signs,
            self._defaults,
            given,
            self._module.numbers,
        )
        if self._names.idle:
            self._names.warn_of_idle(self.system, np.flatnonzero(values != self._defaults))
        return values


def evaluate(
    stepper: Evaluator, kernel: str, block: str, count: int, t: Reals, q: Reals, p: Reals,
    values: Reals, inputs: Reals = NO_INPUTS, before: str = "",
) -> Reals:  # fmt: skip
    """Evaluate a kernel of the state at many states; shape (len(q), count).

    ``inputs`` has states in the places of steps; they stand in powers alone. Another kernel may
    come ``before`` it.
    """
    header, numbers = stepper._module.header, stepper._module.numbers
    with numbers.working():
        W = workspace(header, numbers, numbers.read(values))
        return evaluate_in(W, stepper, kernel, block, count, t, q, p, inputs, before=before)


def velocities_by(header: Header) -> str:
    """Return the kernel that gives the velocities of a state; a retimed start gives dq/dtau."""
    return "energy" if header.retimed else "start"


def evaluate_members(
    stepper: Evaluator, kernel: str, block: str, count: int, t: Reals, q: Reals, p: Reals,
    values: Reals,
) -> Reals:  # fmt: skip
    """Evaluate a kernel of the state at states of many members, each with its own parameters.

    ``q`` and ``p`` have shape (K, ..., n), ``values`` (K, m), ``t`` the shape of the axes between;
    gives shape (K, ..., count).
    """
    found = np.empty((*q.shape[:-1], count))
    own, group = np.unique(values, axis=0, return_inverse=True)
    for k, parameters in enumerate(own):
        here = np.flatnonzero(group.ravel() == k)
        some_q, some_p = (x[here].reshape(-1, stepper.n) for x in (q, p))
        times = np.broadcast_to(t, q[here].shape[:-1]).ravel()
        rows = evaluate(stepper, kernel, block, count, times, some_q, some_p, parameters)
        found[here] = rows.reshape(found[here].shape)
    return found


def evaluate_in(
    W: Reals, stepper: Evaluator, kernel: str, block: str, count: int, t: Reals, q: Reals, p: Reals,
    inputs: Reals = NO_INPUTS, *, before: str = "",
) -> Reals:  # fmt: skip
    """Evaluate a kernel of the state in a workspace that holds parameters.

    Fast sines have no value for huge angles: there the library's are taken.
    """
    numbers, kernels = stepper._module.numbers, stepper._module.kernels
    place = stepper._module.header.layout[block], count

    def values(t: Reals, q: Reals, p: Reals, inputs: Reals, *, any_angle: bool) -> Reals:
        address = kernels.address(kernel, any_angle=any_angle)
        first = kernels.address(before, any_angle=any_angle) if before else 0
        return _evaluated(stepper, W, (first, address), place, t, q, p, inputs)

    found = values(t, q, p, inputs, any_angle=False)
    if stepper._module.header.fast_sines and not numbers.all_finite(found):
        again = ~numbers.finite(found).all(axis=1)
        again &= numbers.finite(q).all(axis=1) & numbers.finite(p).all(axis=1)
        if again.any():
            own = inputs if inputs.shape[1] == 1 else inputs[:, again]
            found[again] = values(t[again], q[again], p[again], own, any_angle=True)
    return found


def watching(
    stepper: Evaluator, found: Sequence[Observed], values: Reals
) -> Callable[[Reals, Reals, Reals], Reals]:
    """Return what evaluates expressions at many states (t, q, p); shape (len(q), len(found)).

    Raises
    ------
    InputError
        If the stepper has many digits.
    """
    header, numbers = stepper._module.header, stepper._module.numbers
    kernels = stepper._module.kernels
    kernel = kernels.observing(observing_kernel(header, found), len(found))
    energy = kernels.address("energy") if any(one.energetic for one in found) else 0
    W = workspace(header, numbers, numbers.read(values), more=len(found))
    return lambda t, q, p: _evaluated(
        stepper, W, (energy, kernel), (header.rows, len(found)), t, q, p
    )  # fmt: skip


def _evaluated(
    stepper: Evaluator, W: Reals, kernels: tuple[Any, Any], block: tuple[int, int], t: Reals,
    q: Reals, p: Reals, inputs: Reals = NO_INPUTS,
) -> Reals:  # fmt: skip
    """Evaluate two kernels, the first of which may be 0; returns a block of so many rows."""
    numbers, (first, count) = stepper._module.numbers, block
    out = numbers.zeros((len(q), count))
    numbers.driver("evaluate")(
        stepper._module.kernels.address("prepare"), *kernels, numbers.read(1.0).item(), W,
        stepper._module.header.told, numbers.read(t), numbers.read(q), numbers.read(p), first, out,
        inputs,
    )  # fmt: skip
    return numbers.result(out)


def evaluate_energy(
    stepper: Evaluator, given_q: ArrayLike, given_p: ArrayLike,
    parameters: Mapping[Any, Any] | None, t: ArrayLike,
) -> Reals:  # fmt: skip
    """Evaluate the Hamiltonian at states of any origin."""
    numbers, n = stepper._module.numbers, stepper.n
    with numbers.working():
        states = [read_array(name, x, numbers) for name, x in (("q", given_q), ("p", given_p))]
        for name, state in zip("qp", states, strict=True):
            if state.ndim != 2 or state.shape != (len(states[0]), n):
                raise InputError(
                    f"{name} has shape {state.shape}, expected (N, {n}).\n"
                    "Pass one row for each state; q and p of equal length."
                )
        values = stepper._values(parameters)
        times = np.broadcast_to(read_array("t", t, numbers), len(states[0]))
    q, p = states
    found: Reals = evaluate(stepper, "energy", "ENERGY", 1, times, q, p, values)
    return found[:, 0]
