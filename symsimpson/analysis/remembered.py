"""Choices of a scheme and a step, kept on disk for the same question."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import symsimpson
from symsimpson.analysis.choose import Choice
from symsimpson.api import compile as compile_system
from symsimpson.errors import StorageError, SymsimpsonError
from symsimpson.files import written_beside
from symsimpson.mechanics.retimed import RetimedSystem
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.runtime.kernels.cache import cache_folder

__all__ = ["remembered"]


def remembered(
    system: MechanicalSystem, question: Mapping[str, Any], choose: Callable[[], Choice]
) -> Choice:
    """Return the choice that was made before for the same question, or make it and keep it.

    Parameters
    ----------
    system : MechanicalSystem
    question : mapping
        All that the choice depends on beside the system, of which the texts tell one from another.
    choose : callable
        Makes the choice.
    """
    values = sorted((symbol.name, value) for symbol, value in system.parameters.items())
    asked = [symsimpson.__version__, system.digest, values, sorted(question.items())]
    place = cache_folder() / "choices" / f"{hashlib.sha256(repr(asked).encode()).hexdigest()}.json"
    found = _read(system, place)
    if found is None:
        found = choose()
        own = found.stepper._module.declared
        kept = {"scheme": found.stepper.scheme, "h": found.h, "reason": found.reason,
                "adapting": isinstance(own, RetimedSystem) and own is not system}  # fmt: skip
        with contextlib.suppress(StorageError, OSError):  # a full disk keeps nothing
            place.parent.mkdir(mode=0o700, exist_ok=True)
            with written_beside(place, "choice") as whole:
                whole.write_text(json.dumps(kept), encoding="utf-8")
    return found


def _read(system: MechanicalSystem, place: Path) -> Choice | None:
    """Read a choice; None if there is none, or none that makes sense."""
    try:
        kept = json.loads(place.read_text(encoding="utf-8"))
        scheme, h, reason = str(kept["scheme"]), float(kept["h"]), str(kept["reason"])
        if not 0 < h < math.inf:
            return None
        whole = system.retimed("encounters") if kept["adapting"] is True else system
        return Choice(compile_system(whole, scheme), h, reason)
    except (OSError, ValueError, KeyError, TypeError, SymsimpsonError):
        return None
