"""Entries of the catalogue: systems with an initial state and a source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from symsimpson.declare.hamiltonian import HamiltonianSystem
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import ModelError, reject

State = Mapping[str, Any]


def check_count(system: str, parts: str, n: object, least: int, most: int | None = None) -> None:
    """Check the number of parts of a system, such as links or bodies."""
    if isinstance(n, bool) or not isinstance(n, int) or not least <= n <= (most or n):
        reject(
            f"{system} needs a whole number of {parts}, not {n!r}.",
            remedy=f"Pass {least} to {most}." if most else f"Pass {least} or more.",
            error=ModelError,
        )


def read_numbers(text: str) -> dict[str, float]:
    """Read pairs of a name and a number, separated by spaces."""
    words = text.split()
    return dict(zip(words[::2], map(float, words[1::2]), strict=True))


@dataclass(frozen=True, eq=False, repr=False)
class CatalogueSystem(MechanicalSystem):
    """A well-known system with an initial state and a source.

    Attributes
    ----------
    reference_state : mapping
        The initial state: ``q0``, and either ``v0`` or ``p0``. Pass it to a run as
        ``integrate(**reference_state, ...)``.
    source : str
        The publication of the system, its parameters and the state.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.systems.pendulum().reference_state["q0"]
    (1.0,)
    """

    reference_state: State = field(kw_only=True, default_factory=dict)
    source: str = field(kw_only=True, default="")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "reference_state", MappingProxyType(dict(self.reference_state)))


@dataclass(frozen=True, eq=False, repr=False)
class CatalogueHamiltonian(HamiltonianSystem):
    """A well-known system that is declared by H, with an initial state and a source.

    Attributes
    ----------
    reference_state : mapping
        The initial state, ``q0`` and ``p0``.
    source : str
        The publication of the system, its parameters and the state.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.systems.lotka_volterra().reference_state["p0"]
    (0.0,)
    """

    reference_state: State = field(kw_only=True, default_factory=dict)
    source: str = field(kw_only=True, default="")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "reference_state", MappingProxyType(dict(self.reference_state)))
