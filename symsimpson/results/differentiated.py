"""Derivatives that runs carried along: of one run, or of all members of an ensemble."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.program.program import Program

__all__ = ["Differentiated"]


class Differentiated:
    """Derivatives that were carried along beside states; ensembles have an axis of members."""

    program: Program
    variations: NDArray[Any] | None

    @property
    def _names_varied(self) -> tuple[str, ...]:
        """Parameters and inputs that it was differentiated by."""
        return self.program.names.varied(self.program.header.varied_by or ())

    @property
    def tangent(self) -> NDArray[Any]:
        """Variations (dq, dp) of the stored states, shape (N + 1, 2 n, k).

        Raises
        ------
        InputError
            If the run was not asked for them.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (51, 2, 2)
        >>> stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (2, 2, 2)
        """
        count = len(self._names_varied)
        return self._carried("tangents=4")[..., : -count or None]

    @property
    def sensitivity(self) -> dict[str, NDArray[Any]]:
        """Derivatives of the stored states (q, p) by parameters and inputs, shape (N + 1, 2 n).

        Raises
        ------
        InputError
            If the run was not asked for them.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, sensitivities="l")
        >>> run.sensitivity["l"].shape
        (51, 2)
        """
        names = self._names_varied
        variations = self._carried("sensitivities='l'")
        first = variations.shape[-1] - len(names)
        return {name: variations[..., first + j] for j, name in enumerate(names)}

    def _carried(self, how: str) -> NDArray[Any]:
        if self.variations is None:
            raise InputError(
                "this run carried no derivatives along.\n"
                f"Ask for them: stepper.integrate(..., {how})."
            )
        return self.variations
