"""Derivatives that runs carried along: of one run, or of all members of an ensemble."""

from __future__ import annotations

from typing import Any, NoReturn

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
        """Variations (dq, dp) of N stored states of n coordinates, shape (N, 2 n, k) for k of them.

        Raises
        ------
        InputError
            If the run carried none along.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (51, 2, 2)
        >>> stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (2, 2, 2)
        """
        variations = self._carried("tangents=4")
        count = variations.shape[-1] - len(self._names_varied)
        return variations[..., :count] if count else self._missing("tangents=4")

    @property
    def sensitivity(self) -> dict[str, NDArray[Any]]:
        """Derivatives of N stored states (q, p), by name of parameter or input, shape (N, 2 n).

        Raises
        ------
        InputError
            If the run carried none along.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, sensitivities="l")
        >>> run.sensitivity["l"].shape
        (51, 2)
        """
        variations, names = self._carried("sensitivities='l'"), self._names_varied
        first = variations.shape[-1] - len(names)
        return {name: variations[..., first + j] for j, name in enumerate(names)}

    def _carried(self, ask: str) -> NDArray[Any]:
        """Return all variations; those by parameters stand behind those of the state."""
        return self._missing(ask) if self.variations is None else self.variations

    def _missing(self, ask: str) -> NoReturn:
        raise InputError(
            "this run carried no derivatives of this kind along.\n"
            f"Ask for them: integrate(..., {ask})."
        )
