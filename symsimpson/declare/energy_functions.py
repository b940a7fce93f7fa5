"""The energies of a system as functions of JAX."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import sympy as sp

from symsimpson.declare.coordinates import time
from symsimpson.declare.declared import Declared
from symsimpson.errors import reject
from symsimpson.support.extras import import_library
from symsimpson.support.names import NameTable, read_mapping, spelled


class EnergyFunctions:
    """The energies of a system as functions for other libraries; ``system.energies`` has them.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.systems.pendulum().energies
    EnergyFunctions(pendulum: T and V)
    """

    def __init__(self, system: Declared) -> None:
        self._system = system
        self._momenta: tuple[sp.Symbol, ...] = getattr(system, "momenta", ())

    def to_jax(self) -> Any:
        """Return the functions T and V, or H for a Hamiltonian system.

        Returns
        -------
        tuple of callable, or callable
            ``T(q, v, parameters=None, t=0.0)`` and ``V(q, parameters=None, t=0.0)``, whose
            difference is L. T has all terms with velocities. A :class:`HamiltonianSystem` returns
            ``H(q, p, parameters=None, t=0.0)``. Arrays have shape (..., n), and results (...).
            ``parameters`` is a mapping from names or symbols; other parameters keep the values of
            the declaration.

        Raises
        ------
        InputError
            If JAX is not installed. A call raises it for an unknown parameter.

        Examples
        --------
        >>> import jax, jax.numpy as jnp, symsimpson as ss
        >>> jax.config.update("jax_enable_x64", True)
        >>> T, V = ss.systems.pendulum().energies.to_jax()
        >>> jax.grad(V)(jnp.array([0.5])).round(3)
        Array([4.703], dtype=float64)
        """
        import_library("jax", "to_jax()", "jax")
        system = self._system
        if self._momenta:
            return self._function(system.hamiltonian, self._momenta)  # type: ignore[attr-defined]
        velocities = tuple(q.diff(time) for q in system.coordinates)
        T = self._function(system.kinetic + system.gyroscopic, velocities)
        return T, self._function(system.potential, ())

    def _function(self, energy: sp.Expr, others: tuple[sp.Expr, ...]) -> Callable[..., Any]:
        """Return a function of q, the values of ``others`` if any, parameters and t."""
        import jax.numpy as jnp

        system = self._system
        table = NameTable("parameter", [spelled(a) for a in system.parameters])
        defaults = [float(x) for x in system.parameters.values()]
        known = (*others, *system.coordinates, *system.parameters, time)
        plain = {x: sp.Symbol(f"x_{k}") for k, x in enumerate(known)}
        evaluate = sp.lambdify([*plain.values()], energy.xreplace(plain), "jax")

        def energy_of(
            *state: Any, parameters: Mapping[Any, Any] | None = None, t: Any = 0.0
        ) -> Any:
            arrays = [jnp.asarray(x) for x in state]
            values: list[Any] = list(defaults)
            given = read_mapping("parameters", parameters, "m")
            for place, value in table.values_by_place(given).items():
                values[place] = value
            for x in arrays:
                if x.shape[-1:] != (system.n,):
                    reject(
                        f"an array has shape {x.shape}, but its last axis must have {system.n} "
                        "entries.",
                        where=system.name,
                        remedy="Pass one number for each coordinate along the last axis.",
                    )
            columns = [x[..., k] for x in reversed(arrays) for k in range(system.n)]
            shape = jnp.broadcast_shapes(*(x.shape[:-1] for x in arrays))
            return jnp.broadcast_to(1.0 * jnp.asarray(evaluate(*columns, *values, t)), shape)

        if others:
            return lambda q, v, parameters=None, t=0.0: energy_of(q, v, parameters=parameters, t=t)
        return lambda q, parameters=None, t=0.0: energy_of(q, parameters=parameters, t=t)

    def __repr__(self) -> str:
        return f"EnergyFunctions({self._system.name}: {'H' if self._momenta else 'T and V'})"
