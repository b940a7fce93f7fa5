"""Entries of the catalogue: a system with a state to start from, and its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from symsimpson.declare.system import MechanicalSystem

State = Mapping[str, Any]


def read_numbers(text: str) -> dict[str, float]:
    """Read a table of names, each before its number."""
    words = text.split()
    return dict(zip(words[::2], map(float, words[1::2]), strict=True))


@dataclass(frozen=True, eq=False, repr=False)
class CatalogueSystem(MechanicalSystem):
    """A well-known system with a state to start from and its source.

    Attributes
    ----------
    reference_state : mapping
        ``q0`` and one of ``v0`` and ``p0``, as ``integrate(**reference_state, ...)`` takes them.
    source : str
        Where the system, its parameters and the state come from.
    """

    reference_state: State = field(kw_only=True, default_factory=dict)
    source: str = field(kw_only=True, default="")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "reference_state", MappingProxyType(dict(self.reference_state)))
