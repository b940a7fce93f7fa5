"""The energy of a run: its error, the work of forces, and the part that a scheme keeps."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.results.states import States
from symsimpson.results.stored import Stored

__all__ = ["Energies"]


class Energies(Stored):
    """Energies along a run; :class:`Trajectory` is one."""

    @cached_property
    def energy_scale(self) -> Any:
        """The scale of ``energy_error``: the size of H0 or the median kinetic energy.

        The median is taken over the stored states. H0 alone says nothing where the zero of the
        potential happens to lie near it, as for a pendulum released at 90 degrees. A system at
        rest with H0 = 0 has the scale 1.
        """
        kinetic = np.sort(self._energies[:, 1])[len(self) // 2]
        scale = max(abs(self._first_energy), kinetic)
        return scale if scale > 0 else scale * 0 + 1

    @cached_property
    def energy_error(self) -> NDArray[Any]:
        """(H - H0) / :attr:`energy_scale`, shape (N + 1,), without what events gave or took.

        Raises
        ------
        InputError
            If forces do work, or the energy depends on the time.
        """
        header = self.program.header
        if not header.conservative:
            why = (
                "forces do work on it"
                if header.forces
                else "constraints that move do work on it"
                if header.carried
                else "it depends on the time"
            )
            raise InputError(
                f"{self.program.system}: the energy is not constant, {why}, so its change does "
                "not measure the error.\nUse run.energy_balance, the change of the energy minus "
                "the work done; run.energy and run.work are its parts."
            )
        return (self.energy - self._first_energy - self._given) / self.energy_scale

    @property
    def _first_energy(self) -> Any:
        """The energy at the start."""
        if self.every is not None:
            return self.energy[0]
        if self.program.header.retimed:
            return self.parameters["E0"]
        return self._beginning.energy[0]

    @cached_property
    def _beginning(self) -> States:
        """The state at the start, where the last one alone is stored.

        Raises InputError if a file does not hold it.
        """
        if self.begun is None:
            raise InputError(
                "this file holds the last state of a run alone, and not how it began, as files did "
                "before version 0.3.\nTake the run again, or store states on the way: every=100."
            )
        t, (q, p) = self.begun
        return self.with_states(np.array([t]), q[None], p[None])

    @cached_property
    def _given(self) -> Any:
        """The energy that events gave up to stored states, which impacts take; 0 without any."""
        if not self.records:
            return 0
        from symsimpson.results.records import energies_given

        return energies_given(self)

    @cached_property
    def _integrals(self) -> tuple[dict[str, NDArray[Any]], NDArray[Any]]:
        from symsimpson.results.work import integrals

        return integrals(self)

    @property
    def work(self) -> dict[str, NDArray[Any]]:
        """The work of each force since the start, and of all under "total", shape (N + 1,) each.

        It is h sum_i b_i f_i.v_i over the nodes of all steps, and is accurate to the order of the
        scheme; under "constraints" it is that of velocity constraints A v = b that move. Steps are
        taken again for it, unless the run was asked to ``record`` it; after one that cannot be, as
        in a passage that was not resolved, it is NaN.

        Raises
        ------
        InputError
            If only the last state is stored and work was not recorded, or the scheme is explicit.

        Examples
        --------
        >>> import sympy as sp, symsimpson as ss
        >>> (x,) = ss.coordinates("x")
        >>> brake = ss.MechanicalSystem("brake", coordinates=(x,), kinetic=x.diff()**2/2,
        ...                             potential=0*x, forces={x: -x.diff()})
        >>> run = ss.compile(brake).integrate([0.0], v0=[1.0], h=0.1, t_end=1.0)
        >>> float(run.work["total"][-1].round(6))  # (exp(-2) - 1)/2
        -0.432332
        """
        return self._integrals[0]

    @cached_property
    def power(self) -> dict[str, NDArray[Any]]:
        """The power f.v of each force at the stored states, and of all under "total".

        Inputs are those of the step that begins at a state; at the last, of the step before it.
        """
        from symsimpson.results.work import powers

        return powers(self)

    @cached_property
    def energy_balance(self) -> NDArray[Any]:
        """H - H0 minus the work of the forces plus the integral of dL/dt, shape (N + 1,).

        Zero for the exact motion, and of the order of the scheme.

        Raises
        ------
        InputError
            As for :attr:`work`.
        """
        work, lost = self._integrals
        return self.energy - self._first_energy - self._given - work["total"] + lost

    @cached_property
    def shadow_energy(self) -> NDArray[Any]:
        """The modified energy that the scheme conserves, to leading order, shape (N + 1,).

        Up to exponentially small terms the scheme is the flow of a modified Hamiltonian H + dH
        (backward error analysis). The mean of dH over a step is -(L_d - S)/h: L_d is the discrete
        Lagrangian, and S the action along a more accurate path with the same ends. For schemes of
        order 2 and 4, H oscillates by h^2 and h^4, but H + dH only by h^4 and h^8. So a drift, a
        force that is not conservative or equations that were not solved show at once. Above order
        6 it tells no more than the energy.

        Raises
        ------
        InputError
            If not all states are stored, the energy is not constant, there are constraints, or
            fewer than four steps, or these are fixed in another time.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.02, steps=100)
        >>> bool(np.ptp(run.shadow_energy) < np.ptp(run.energy) / 1000)
        True
        """
        from symsimpson.results.shadow import shadow_energy

        return shadow_energy(self)

    def plot_energy(self, *, shadow: bool = False, ax: Any = None) -> Any:
        """Draw the error of the energy over time, into ``ax`` if given; returns the axes.

        Where forces do work, or the energy depends on the time, :attr:`energy_balance` is drawn;
        with ``shadow`` the change of :attr:`shadow_energy`, too.

        Raises
        ------
        InputError
            If matplotlib is not installed, or there is no shadow energy.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.plot_energy().get_ylabel()
        '(H - H0) / |H0| [$10^{-5}$]'
        """
        from symsimpson.plotting.run_figures import plot_energy

        return plot_energy(self, shadow=shadow, ax=ax)
