"""Quantities of the states of a run or of an ensemble, as attributes and by name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import UnknownNameError, reject
from symsimpson.program.program import Program
from symsimpson.results.tables import Variable, attribute_name, make_variable
from symsimpson.support.names import did_you_mean, public_names, shortened, spelled
from symsimpson.text.quantity import QUANTITIES, VECTORS, scalars_of, slopes_of

NO_KINETIC_ENERGY = (
    "A HamiltonianSystem has no kinetic and no potential energy. Use run.energy, which is H."
)


class Quantities:
    """Quantities of states q and p of shape (..., n), evaluated at the first access."""

    t: NDArray[Any]
    q: Any
    p: Any
    program: Program

    def _evaluate_rows(
        self, kernel: str, block: str, count: int, *, driven: bool = False
    ) -> NDArray[Any]:
        """Evaluate ``count`` rows of a block at all states by a kernel, shape (..., count).

        Raises InputError if the rows are ``driven`` by inputs whose values are unknown.
        """
        raise NotImplementedError

    def _evaluate_quantity(self, name: str) -> NDArray[Any]:
        """Evaluate a quantity of the table ``QUANTITIES``; vectors have their own last axis."""
        quantity = QUANTITIES[name]
        assert quantity.kernel is not None
        kernel, count = (
            quantity.kernel(self.program.header),
            len(quantity.shown(self.program.names)),
        )
        values = self._rows(kernel, quantity.block, count, driven=quantity.driven)
        return values if quantity.axis else values[..., 0]

    def _rows(self, kernel: str, block: str, count: int, *, driven: bool = False) -> NDArray[Any]:
        """Evaluate rows like :meth:`_evaluate_rows`; ``count`` may be 0."""
        if not count:
            return np.zeros((*np.shape(self.q)[:-1], 0))
        return self._evaluate_rows(kernel, block, count, driven=driven)

    @cached_property
    def v(self) -> NDArray[Any]:
        """Velocities dq/dt, with the shape of q."""
        return self._evaluate_quantity("v")

    @cached_property
    def energy(self) -> NDArray[Any]:
        """The energy H, with the shape of q without its last axis."""
        return self._energies[..., 0]

    @cached_property
    def kinetic_energy(self) -> NDArray[Any]:
        """The part of H that is quadratic in p; the rest of H is the potential energy.

        If L is not quadratic in the velocities, it is v.L_vv.v/2. A HamiltonianSystem has none.

        Raises
        ------
        AttributeError
            For a HamiltonianSystem.
        """
        if self.program.header.canonical:
            raise AttributeError(NO_KINETIC_ENERGY)
        return self._energies[..., 1]

    @cached_property
    def _energies(self) -> NDArray[Any]:
        """The energy H and its kinetic part, shape (..., 2)."""
        return self._evaluate_rows("energy", "ENERGY", 2)

    @cached_property
    def invariants(self) -> dict[str, NDArray[Any]]:
        """The invariants that the system declares, by name, each with the shape of ``energy``."""
        names = self.program.invariants
        if not names:
            return {}
        values = self._evaluate_rows("invariants", "INVARIANT", len(names))
        return {name: values[..., i] for i, name in enumerate(names)}

    @cached_property
    def points(self) -> dict[str, NDArray[np.float64]]:
        """The places of the points and bodies that the system declares as ``positions``, by name.

        A point has shape (..., 2) or (..., 3), and a body has shape (..., corners, 2 or 3).
        """
        program = self.program
        if program.tools is None or not getattr(program.declared, "positions", None):
            return {}
        return program.tools.points_of(program.declared, *self._point_arguments())

    def _point_arguments(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return t, q and the parameter values, with equal first axes, to evaluate points."""
        raise NotImplementedError

    @cached_property
    def multipliers(self) -> NDArray[Any]:
        """Multipliers lambda of L - lambda.phi, shape (..., m), with the order of the scheme.

        These multipliers keep the acceleration of a state on the constraints. The multipliers of
        the steps differ; they have low order (Hairer, Lubich and Wanner, VII.1). The multipliers of
        velocity constraints, whose force is -A^T lambda, come last. If inputs jump between two
        steps, the multipliers are those of the step that begins.

        Raises
        ------
        InputError
            If the system has inputs whose values at the states are unknown.
        """
        if getattr(self, "history", None) is not None:
            from symsimpson.results.mode_history import constraint_values

            return constraint_values(self)[0]
        return self._evaluate_quantity("multipliers")

    @cached_property
    def constraint_error(self) -> NDArray[Any]:
        """Values of the declared constraints phi(q), shape (..., m); they are round-off errors."""
        header = self.program.header
        rolling, count = len(header.velocity_constraints), len(header.constraints)
        return self._rows("multipliers", "CONSTRAINT", count)[..., : count - rolling]

    @cached_property
    def velocity_constraint_error(self) -> NDArray[Any]:
        """Values A v - b of the velocity constraints, shape (..., m); they are round-off errors."""
        count = len(self.program.header.velocity_constraints)
        return self._rows("multipliers", "SLIP", count)

    @cached_property
    def constraint_forces(self) -> NDArray[Any]:
        """The generalised forces -Phi^T lambda of all constraints, with the shape of q.

        They do not include forces of contacts.
        """
        if not self.program.header.constraints:
            return 0 * np.asarray(self.q)
        if getattr(self, "history", None) is not None:
            from symsimpson.results.mode_history import constraint_values

            return constraint_values(self)[1]
        block, count = "CONSTRAINT_FORCE", self.program.n
        return -self._evaluate_rows("multipliers", block, count, driven=True)

    @property
    def _prescribed_names(self) -> tuple[str, ...]:
        """Names of prescribed coordinates, their velocities and the forces that move them."""
        motion = getattr(self.program.declared, "motion", None)
        return () if motion is None or self.program.tools is None else motion.names

    def _prescribed(self, key: str) -> NDArray[Any]:
        """Return a quantity of a prescribed coordinate."""
        program, (t, q, values) = self.program, self._point_arguments()
        inputs = self._inputs_at_states() if key.startswith("force_") else np.zeros((1, 0))
        assert program.tools is not None
        return np.asarray(
            program.tools.prescribed(key, program.declared, (t, q, self.v, values), inputs)
        )

    def _inputs_at_states(self) -> NDArray[Any]:
        """Return the inputs at all states, shape (..., number of inputs)."""
        if self.program.inputs:
            reject(
                "forces of prescribed motions with inputs are available for single members only.",
                remedy="Select a member first: ensemble[0]['force_x'].",
            )
        return np.zeros((1, 0))

    def _slopes(self) -> NDArray[Any]:
        """Return Phi = dphi/dq at all states, shape (..., m, n)."""
        header = self.program.header
        rows = self._evaluate_rows("multipliers", "CONSTRAINT_QQ", header.layout["HELD_SIZE"])
        return slopes_of(header, rows)

    def _special_quantity(self, key: str) -> Any:
        """Return a quantity that only this kind of result has; None for other names."""
        return None

    def _special_names(self) -> list[str]:
        """Return the names that :meth:`_special_quantity` knows."""
        return []

    def _look_up(self, key: Any) -> NDArray[Any]:
        """Return a quantity by its name; the names of the user come first.

        Raises UnknownNameError, which lists all names.
        """
        several = isinstance(key, (slice, tuple, list, np.ndarray))
        names, key = self.program.names, spelled(key)
        if key in names.coordinates.places:
            return np.asarray(self.q[..., names.coordinates.places[key]])
        if (values := self._special_quantity(key)) is not None:
            return cast(NDArray[Any], values)
        for quantity in QUANTITIES.values():
            place = quantity.places(names).get(key.removeprefix(quantity.prefix))
            if place is not None and key.startswith(quantity.prefix):
                return np.asarray(getattr(self, quantity.name)[..., place])
        watched = names.invariants
        if key in watched.places:
            return self.invariants[watched.shown[watched.places[key]]]
        if key in (getattr(self.program.declared, "positions", None) or ()):
            return self.points[key]
        if key in self._prescribed_names:
            return self._prescribed(key)
        if key == "t" or key in QUANTITIES:
            return cast(NDArray[Any], getattr(self, key))
        every = self._ipython_key_completions_()
        whole = [quantity.name for quantity in VECTORS]
        reject(
            f"there is no quantity {shortened(key)}.{did_you_mean(key, every)}",
            why=f"The quantities are {', '.join(every)}, and the vectors {', '.join(whole)}.",
            remedy="Pass one name at a time, or select from an array: .q[3:5]." * several,
            error=UnknownNameError,
        )

    def _ipython_key_completions_(self) -> list[str]:
        """Return the names of all scalar quantities."""
        names = self.program.names
        every = [x for vector in QUANTITIES.values() if vector.axis for x in vector.shown(names)]
        positions = getattr(self.program.declared, "positions", None) or ()
        every += [*names.invariants.shown, *self._special_names(), *positions]
        every += [*self._prescribed_names, "t"]
        return every + [quantity.name for quantity in scalars_of(self.program.header)]

    def __iter__(self: Any) -> Iterator[Any]:
        """Iterate over ``self[k]``: the states of a run, or the members of an ensemble."""
        return (self[k] for k in range(len(self)))

    def __array__(self, dtype: Any = None, copy: Any = None) -> NoReturn:
        """Raise InputError; NumPy would iterate over states of states without end."""
        reject(
            f"a {type(self).__name__} is not an array.",
            remedy="Pass one of its arrays, such as .q, .p, .t or ['energy'].",
        )

    __dir__ = public_names

    def _quantities(self, axes: tuple[str, ...]) -> list[Variable]:
        """Return quantities, invariants and points as variables with these first ``axes``."""
        program = self.program
        variables = [
            make_variable(x.name, getattr(self, x.name), axes, program, doc=x.doc)
            for x in (*VECTORS, *scalars_of(program.header))
        ]
        variables += [
            Variable(f"invariant_{k}", values, axes, name, (name,))
            for k, (name, values) in enumerate(self.invariants.items())
        ]
        for k, (name, place) in enumerate(self.points.items()):
            key = attribute_name(name, str(k))
            point = make_variable(name, place, axes, program, key, f"place of {name}")
            variables.append(replace(point, name=f"point_{key}", array=f"point_{name}"))
        return variables
