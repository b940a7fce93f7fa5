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
from symsimpson.program.recorders import Recorder


class KernelSets(ABC):
    """Kernels in some arithmetic: addresses of compiled ones, or functions.

    They are ``by_stages`` if steps are iterated over stages first.
    """

    def __init__(self, header: Header, *, by_stages: bool) -> None:
        self.header, self.by_stages = header, by_stages
        self._sets: dict[tuple[str, tuple[Recorder, ...], bool], Any] = {}

    @cached_property
    def fallbacks(self) -> tuple[str, ...]:
        """Names of the sets to take steps with, each where the one before fails."""
        first = ("stages",) if self.by_stages else ()
        return (*first, "newton", *(("robust",) if self.header.newton_unknowns else ()))

    def set(self, name: str, recorders: tuple[Recorder, ...] = (), *, again: bool = False) -> Any:
        """Return a set: its mode, then its kernels, and those of recorders.

        "robust" is Newton's method with row pivoting and sine and cosine of the C library. It takes
        any angle and meets no singular pivot, at several times the cost. Steps that are taken
        ``again`` were accepted once: how the energy changes is not looked at.
        """
        key = name, recorders, again
        if key not in self._sets:  # finding compiled code takes the digest of the text
            self._sets[key] = self._made(*key)
        return self._sets[key]

    def _made(self, name: str, recorders: tuple[Recorder, ...], again: bool) -> Any:
        if name == "stages":
            mode = STAGES
        elif not self.header.newton_unknowns:
            mode = EXPLICIT
        else:
            # forces may change the energy as they like
            watched = self.by_stages and self.header.conservative and not again
            mode = NEWTON_AFTER_STAGES if watched else NEWTON
        robust = name == "robust"
        *names, energy = KERNEL_SETS[mode]
        if robust and self.header.unrolled:
            names[names.index("newton")] = PIVOTED
        kernels = self.compile_set(name, names, any_angle=robust)
        # the energy is a kernel of its own, for whoever asks for it
        measure = self.address(energy, any_angle=robust) if energy else 0
        behind = [self._recording(recorder, robust) for recorder in recorders]
        return self.pack(mode, [*kernels, measure, *behind])

    def _recording(self, recorder: Recorder, robust: bool) -> Any:
        """Return the kernel of a recorder."""
        if recorder.text:
            return self.compile_observer(recorder.text, recorder.room)
        pivoted = f"{recorder.kernel}{WITH_PIVOTS}"
        name = pivoted if robust and pivoted in self.header.functions else recorder.kernel
        return self.address(name, any_angle=robust)

    @property
    @abstractmethod
    def location(self) -> str:
        """Where the code of a step is, in words."""

    @abstractmethod
    def compile_set(self, label: str, names: list[str], *, any_angle: bool) -> list[Any]:
        """Return kernels that are compiled together; 0 for an empty name."""

    @abstractmethod
    def pack(self, mode: int, kernels: list[Any]) -> Any:
        """Return a set as the driver of this arithmetic takes it."""

    @abstractmethod
    def address(self, name: str, *, any_angle: bool = False) -> Any:
        """Return one kernel; of one that takes any angle, if that is asked for."""

    def compile_observer(self, text: str, rows: int) -> Any:
        """Compile a further kernel, whose text stands behind the module's.

        The workspace has so many more rows, from what was ROWS on. Raises InputError if nothing is
        compiled here.
        """
        raise InputError(
            "expressions are evaluated in double precision, and this stepper has many digits.\n"
            "Compile without precision."
        )
