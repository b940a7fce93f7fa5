"""Choices of a scheme and a step, kept on disk for the same question."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import symsimpson
from symsimpson.analysis.choose import Choice
from symsimpson.api.compiling import compile as compile_system
from symsimpson.mechanics.retimed import RetimedSystem
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.program.answers import kept

__all__ = ["remembered"]


def remembered(
    system: MechanicalSystem,
    question: Mapping[str, Any],
    duration: float,
    choose: Callable[[], Choice],
) -> Choice:
    """Return the choice that was made before for the same question, or make it and keep it.

    The ``question`` is all that the choice depends on beside the system; the texts of it tell one
    from another.
    """
    values = sorted((symbol.name, value) for symbol, value in system.parameters.items())
    asked = ["whole path", symsimpson.__version__, system.digest, values, sorted(question.items())]

    def read(record: Any) -> Choice:
        h, error = float(record["h"]), float(record["error"])
        if not (0 < h / duration < math.inf and error >= 0):
            raise ValueError("no step, or no error")
        whole = system.retimed("encounters") if record["adapting"] is True else system
        return Choice(compile_system(whole, str(record["scheme"])), h, str(record["reason"]), error)

    def content(choice: Choice) -> dict[str, Any]:
        declared = choice.stepper.program.declared
        adapting = isinstance(declared, RetimedSystem) and declared is not system
        return {
            "scheme": choice.stepper.scheme,
            "h": choice.h,
            "reason": choice.reason,
            "error": choice.error_estimate,
            "adapting": adapting,
        }

    return kept("choices", repr(asked), read, choose, content)
