"""The kernels of a module in sets, as the driver takes them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

from symsimpson.errors import InputError
from symsimpson.module.header import Header
from symsimpson.module.interface import (
    EXPLICIT,
    KERNEL_SETS,
    NEWTON,
    NEWTON_AFTER_STAGES,
    PIVOTED,
    STAGES,
    WITH_PIVOTS,
)

__all__ = ["KernelSets"]


class KernelSets(ABC):
    """Kernels in some arithmetic: addresses of compiled ones, or functions.

    Attributes
    ----------
    header : Header
    by_stages : bool
        Whether steps are iterated over stages first.
    """

    def __init__(self, header: Header, *, by_stages: bool) -> None:
        self.header, self.by_stages = header, by_stages
        self._sets: dict[tuple[str, str], Any] = {}

    @cached_property
    def fallbacks(self) -> tuple[str, ...]:
        """Names of the sets to take steps with, each where the one before fails."""
        first = ("stages",) if self.by_stages else ()
        return (*first, "newton", *(("robust",) if self.header.newton_unknowns else ()))

    def set(self, name: str, behind: str = "") -> Any:
        """Return a set: its mode, then its kernels, and one to be called ``behind`` each step.

        "robust" is Newton's method with row pivoting and the library's sine and cosine. It takes
        any angle and meets no singular pivot, at several times the cost.
        """
        if (name, behind) not in self._sets:  # finding compiled code takes the digest of the text
            self._sets[name, behind] = self._made(name, behind)
        return self._sets[name, behind]

    def _made(self, name: str, behind: str) -> Any:
        if name == "stages":
            mode = STAGES
        elif not self.header.newton_unknowns:
            mode = EXPLICIT
        else:
            # forces may change the energy as they like
            watched = self.by_stages and self.header.conservative
            mode = NEWTON_AFTER_STAGES if watched else NEWTON
        robust = name == "robust"
        *names, energy = KERNEL_SETS[mode]
        if robust and self.header.unrolled:
            names[names.index("newton")] = PIVOTED
        kernels = self.compiled(name, names, any_angle=robust)
        # the energy is a kernel of its own, for whoever asks for it
        measure = self.address(energy, any_angle=robust) if energy else 0
        if robust and f"{behind}{WITH_PIVOTS}" in self.header.functions:
            behind += WITH_PIVOTS
        last = self.address(behind, any_angle=robust) if behind else 0
        return self.joined(mode, [*kernels, measure, last])

    @property
    @abstractmethod
    def location(self) -> str:
        """Where the code of a step is, in words."""

    @abstractmethod
    def compiled(self, label: str, names: list[str], *, any_angle: bool) -> list[Any]:
        """Return kernels that are compiled together; 0 for an empty name."""

    @abstractmethod
    def joined(self, mode: int, kernels: list[Any]) -> Any:
        """Return a set as the driver of this arithmetic takes it."""

    @abstractmethod
    def address(self, name: str, *, any_angle: bool = False) -> Any:
        """Return one kernel; of one that takes any angle, if that is asked for."""

    def observing(self, kernel: str, rows: int) -> Any:
        """Return a further kernel, whose text stands behind the module's.

        The workspace has so many more rows, from what was ROWS on.

        Raises
        ------
        InputError
            If nothing is compiled here.
        """
        raise InputError(
            "expressions are evaluated in double precision, and this stepper has many digits.\n"
            "Compile without precision."
        )
