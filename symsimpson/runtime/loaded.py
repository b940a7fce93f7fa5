"""A module as the package knows it, beside what its stepper shows to users."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from symsimpson.module.header import Header
from symsimpson.runtime.kernels.sets import KernelSets
from symsimpson.support.derivation import Derivation

if TYPE_CHECKING:
    from symsimpson.runtime.kernels.numbers import Numbers

__all__ = ["Loaded", "Tools"]


@dataclass(frozen=True)
class Tools:
    """Functions of layers above a stepper; it gets them from whoever makes it.

    Attributes
    ----------
    certify : callable
        Measures whether a stepper is what it should be.
    check_step : callable
        Takes a stepper, its system, q0, parameters and h, and warns of steps that are too large.
    force_terms : callable
        Takes a system, q, the values of parameters and inputs, and t; returns how large the terms
        of each force are, which may cancel.
    at_pole : callable
        Takes a system and a run; returns at which singular point of the coordinates that ended.
    unresolved_pole : callable
        Takes a stepper, its system and a run; returns when that passed such a point unresolved.
    kink_passed : callable
        Takes a system, times, positions and values; returns when a force jumped at which root.
    regular_box : callable
        Takes a system, values, two corners and a time; returns a box without either.
    points_of : callable
        Takes a system, times, positions and values; returns where its points are, by name.
    """

    certify: Callable[..., Any]
    check_step: Callable[..., None]
    force_terms: Callable[..., Any]
    at_pole: Callable[..., str]
    unresolved_pole: Callable[..., Any]
    kink_passed: Callable[..., Any]
    regular_box: Callable[..., Any]
    points_of: Callable[..., dict[str, Any]]


@dataclass(frozen=True)
class Loaded:
    """A module as the package knows it: what layers beside a stepper may use of it.

    Attributes
    ----------
    header : Header
    numbers : Numbers
    kernels : KernelSets
    declared : MechanicalSystem or None
        What the module was generated from.
    derivation : Derivation or None
    tools : Tools or None
    """

    header: Header
    numbers: Numbers
    kernels: KernelSets
    declared: Any
    derivation: Derivation | None
    tools: Tools | None
