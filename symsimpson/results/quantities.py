"""Quantities of states, by attribute and by name; of one run, or of all members of an ensemble."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import UnknownNameError, reject
from symsimpson.program.program import Program
from symsimpson.results.tables import Variable, attribute_name, variable_of
from symsimpson.support.names import did_you_mean, public_names, shortened, spelled
from symsimpson.text.quantity import QUANTITIES, SCALARS, VECTORS, slopes_of


class Quantities:
    """Quantities that follow from q and p of shape (..., n), computed when first asked for."""

    t: NDArray[Any]
    q: Any
    p: Any
    program: Program

    def _evaluated(
        self, kernel: str, block: str, count: int, *, driven: bool = False
    ) -> NDArray[Any]:
        """Return a block of rows at all states, shape (..., count).

        Raises InputError if it is ``driven`` by inputs, and those at the states are not known.
        """
        raise NotImplementedError

    def _of_table(self, name: str) -> NDArray[Any]:
        """Return a quantity of the table; its numbers, if there are several, on the last axis."""
        quantity = QUANTITIES[name]
        assert quantity.kernel is not None
        kernel, count = (
            quantity.kernel(self.program.header),
            len(quantity.shown(self.program.names)),
        )
        values = self._rows(kernel, quantity.block, count, driven=quantity.driven)
        return values if quantity.axis else values[..., 0]

    def _rows(self, kernel: str, block: str, count: int, *, driven: bool = False) -> NDArray[Any]:
        """Return a block of rows at all states; without rows, nothing is evaluated."""
        if not count:
            return np.zeros((*np.shape(self.q)[:-1], 0))
        return self._evaluated(kernel, block, count, driven=driven)

    @cached_property
    def v(self) -> NDArray[Any]:
        """Velocities, in the shape of q."""
        return self._of_table("v")

    @cached_property
    def energy(self) -> NDArray[Any]:
        """H, in the shape of q without the last axis."""
        return self._energies[..., 0]

    @cached_property
    def kinetic_energy(self) -> NDArray[Any]:
        """The part of H that is quadratic in p; what is left is the potential energy."""
        return self._energies[..., 1]

    @cached_property
    def _energies(self) -> NDArray[Any]:
        """H and its kinetic part, which stand in two rows, shape (..., 2)."""
        return self._evaluated("energy", "ENERGY", 2)

    @cached_property
    def invariants(self) -> dict[str, NDArray[Any]]:
        """The system's named invariants, each in the shape of the energy."""
        names = self.program.invariants
        if not names:
            return {}
        values = self._evaluated("invariants", "INVARIANT", len(names))
        return {name: values[..., i] for i, name in enumerate(names)}

    @cached_property
    def points(self) -> dict[str, NDArray[np.float64]]:
        """Where the points and bodies are that were declared as ``positions``, by name.

        Of shape (..., 2) or (..., 3) for a point, (..., corners, 2 or 3) for a body.
        """
        program = self.program
        if program.tools is None or not getattr(program.declared, "positions", None):
            return {}
        return program.tools.points_of(program.declared, *self._where())

    def _where(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return times, positions and values of parameters, of which the first axes agree."""
        raise NotImplementedError

    @cached_property
    def multipliers(self) -> NDArray[Any]:
        """Multipliers lambda of L - lambda.phi, shape (..., m): of the order of the scheme.

        They are those that keep the acceleration of a state on the constraints; not the ones of a
        step, which are of low order (Hairer, Lubich and Wanner, VII.1). Those of velocity
        constraints, which pull by -A^T lambda, stand last. Where inputs jump between two steps,
        they are those of the step that begins.

        Raises
        ------
        InputError
            If the system has inputs, and those at the states are not known.
        """
        return self._of_table("multipliers")

    @cached_property
    def constraint_error(self) -> NDArray[Any]:
        """phi(q) as it is written, shape (..., m): rounding alone."""
        header = self.program.header
        rolling, count = len(header.velocity_constraints), len(header.constraints)
        return self._rows("multipliers", "CONSTRAINT", count)[..., : count - rolling]

    @cached_property
    def velocity_constraint_error(self) -> NDArray[Any]:
        """A v - b of velocity constraints as they are written, shape (..., m): rounding alone."""
        count = len(self.program.header.velocity_constraints)
        return self._rows("multipliers", "SLIP", count)

    @cached_property
    def constraint_forces(self) -> NDArray[Any]:
        """The generalised forces -Phi^T lambda of all constraints, in the shape of q."""
        if not self.program.header.constraints:
            return 0 * np.asarray(self.q)
        block, count = "CONSTRAINT_FORCE", self.program.n
        return -self._evaluated("multipliers", block, count, driven=True)

    def _slopes(self) -> NDArray[Any]:
        """Return Phi = dphi/dq, shape (..., m, n)."""
        header = self.program.header
        rows = self._evaluated("multipliers", "CONSTRAINT_QQ", header.layout["HELD_SIZE"])
        return slopes_of(header, rows)

    def _own(self, key: str) -> Any:
        """Return a quantity of a name that only this kind of result knows; None if it is none."""
        return None

    def _own_names(self) -> list[str]:
        return []

    def _named(self, key: Any) -> NDArray[Any]:
        """Return a quantity by its name, a user's names first.

        Raises UnknownNameError with the names that there are.
        """
        several = isinstance(key, (slice, tuple, list, np.ndarray))
        names, key = self.program.names, spelled(key)
        if key in names.coordinates.places:
            return np.asarray(self.q[..., names.coordinates.places[key]])
        if (values := self._own(key)) is not None:
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
        if key == "t" or key in QUANTITIES:
            return cast(NDArray[Any], getattr(self, key))
        every = self._ipython_key_completions_()
        whole = [quantity.name for quantity in VECTORS]
        reject(
            f"there is no {shortened(key)}.{did_you_mean(key, every)} "
            f"There are {', '.join(every)}, and all of {', '.join(whole)} together."
            + several
            * "\nAsk for one at a time; several are parts of arrays, as .q[3:5].",
            error=UnknownNameError,
        )

    def _ipython_key_completions_(self) -> list[str]:
        """Return the names of quantities that have one number each."""
        names = self.program.names
        every = [x for vector in QUANTITIES.values() if vector.axis for x in vector.shown(names)]
        positions = getattr(self.program.declared, "positions", None) or ()
        every += [*names.invariants.shown, *self._own_names(), *positions, "t"]
        return every + [quantity.name for quantity in SCALARS]

    def __iter__(self: Any) -> Iterator[Any]:
        """Iterate over states, or members of an ensemble, as ``self[k]`` gives them."""
        return (self[k] for k in range(len(self)))

    def __array__(self, dtype: Any = None, copy: Any = None) -> NoReturn:
        """Raise InputError: NumPy would look for an array in states of states."""
        reject(
            f"a {type(self).__name__} is no array.",
            remedy="Pass one of its arrays: .q, .p, .t, or a quantity by its name, as ['energy'].",
        )

    __dir__ = public_names

    def _quantities(self, axes: tuple[str, ...]) -> list[Variable]:
        """Return stored quantities, invariants and points, whose first axes have these names."""
        program = self.program
        variables = [
            variable_of(x.name, getattr(self, x.name), axes, program, doc=x.doc)
            for x in (*VECTORS, *SCALARS)
        ]
        variables += [
            Variable(f"invariant_{k}", values, axes, name, (name,))
            for k, (name, values) in enumerate(self.invariants.items())
        ]
        for k, (name, place) in enumerate(self.points.items()):
            key = attribute_name(name, str(k))
            point = variable_of(name, place, axes, program, key, f"place of {name}")
            variables.append(replace(point, name=f"point_{key}", array=f"point_{name}"))
        return variables
