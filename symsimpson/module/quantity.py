"""The table of quantities that follow from a state: names, kernels, and the rows they stand in.

Attributes of results, names in expressions, columns of tables and variables of files all come from
it. A quantity of the workspace that a kernel computes is one more line here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from symsimpson.module.header import Header
from symsimpson.support.names import Named


def velocities_by(header: Header) -> str:
    """Return the kernel that gives the velocities of a state; a retimed start gives dq/dtau."""
    return "energy" if header.retimed else "start"


def by(kernel: str) -> Callable[[Header], str]:
    """Return what gives one kernel for all modules."""
    return lambda header: kernel


@dataclass(frozen=True)
class Quantity:
    """A quantity of states."""

    name: str  #: Of the attribute, of variables in files, and in ``run[name]`` if it is one number.
    doc: str  #: In words, as figures and files say it.
    block: str = ""  #: Where it stands in the workspace; "" if Python computes it.
    #: Takes a header, and returns the kernel that computes it; None for the state itself.
    kernel: Callable[[Header], str] | None = None
    #: What it has a number for each of; "" for a single number. Tables and files have single
    #: numbers, and those of coordinates.
    axis: str = ""
    prefix: str = ""  #: Stands before a name of these in the names of its numbers.
    #: Stands for it in kernels that observe expressions, with a number behind it if there is an
    #: axis; "" if no expression may contain it.
    symbol: str = ""
    like: str = ""  #: The quantity whose unit it has, unless it is given one.
    driven: bool = False  #: Whether it depends on the inputs at the state.

    def places(self, names: Any) -> Mapping[str, int]:
        """Return the place of each name that a user may give; of a single number there is none."""
        return self._axis(names).places if self.axis else {}

    def shown(self, names: Any) -> list[str]:
        """Return the names of its numbers."""
        return [f"{self.prefix}{x}" for x in self._axis(names).shown] if self.axis else [self.name]

    def _axis(self, names: Any) -> Named:
        named: Named = getattr(names, self.axis)
        return named


_TABLE = (
    Quantity("q", "position", "POSITION", axis="coordinates", symbol="q_"),
    Quantity("p", "conjugate momentum", "MOMENTUM", axis="coordinates", prefix="p_", symbol="p_"),
    Quantity(
        "v", "velocity", "VELOCITY", velocities_by, axis="coordinates", prefix="v_", symbol="v_"
    ),
    Quantity(
        "multipliers",
        "multipliers of constraints",
        "MULTIPLIER",
        by("multipliers"),
        axis="constraints",
        prefix="lambda_",
        driven=True,
    ),
    Quantity("energy", "energy H", "ENERGY", by("energy"), symbol="energy"),
    Quantity(
        "kinetic_energy",
        "kinetic energy",
        "KINETIC",
        by("energy"),
        symbol="kinetic_energy",
        like="energy",
    ),
)
QUANTITIES = {quantity.name: quantity for quantity in _TABLE}
#: Those with a number for each coordinate, and those of one number.
VECTORS = tuple(quantity for quantity in _TABLE if quantity.axis == "coordinates")
SCALARS = tuple(quantity for quantity in _TABLE if not quantity.axis)
#: Single numbers that expressions of users may contain.
OBSERVABLE = tuple(quantity for quantity in SCALARS if quantity.symbol)
