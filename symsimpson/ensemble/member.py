"""States of a member of an ensemble."""

from __future__ import annotations

from dataclasses import dataclass

from symsimpson.results.states import States
from symsimpson.support.array_types import Floats

__all__ = ["Member"]


@dataclass(frozen=True, eq=False, repr=False)
class Member(States):
    """States of one member of an ensemble.

    Attributes are those of :class:`States`, and ``tau``, the time of the steps of a retimed system,
    shape (N,), or None.
    """

    tau: Floats | None = None
