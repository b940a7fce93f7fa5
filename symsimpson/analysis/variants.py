"""Steppers that differ from a generated module in some constants: for comparison, never for use."""

from __future__ import annotations

from collections.abc import Mapping

from symsimpson.definitions import definitions, redefined
from symsimpson.runtime.kernels.header import SIGNED, digest
from symsimpson.runtime.stepper import Stepper

__all__ = ["oversolved", "rewritten"]


def rewritten(stepper: Stepper, constants: Mapping[str, str]) -> Stepper:
    """Return a stepper with other constants in its module, which is signed anew.

    Parameters
    ----------
    stepper : Stepper
    constants : mapping from str to str
        Python expressions by name.

    Raises
    ------
    ValueError
        If the module has no such constant.
    """
    missing = constants.keys() - definitions(stepper.source)
    if missing:
        raise ValueError(f"the module has no {', '.join(sorted(missing))}")
    text = redefined(stepper.source, {name: f"{name} = {x}" for name, x in constants.items()})
    banner = SIGNED.search(text)
    assert banner is not None
    text = text.replace(banner[1], digest(text[banner.end() :]), 1)
    return Stepper(
        text, f"{stepper.system}, changed", reference_state=stepper.reference_state,
        tools=stepper._module.tools,
    )  # fmt: skip


def oversolved(stepper: Stepper) -> Stepper:
    """Return a stepper whose iterations go on until corrections stagnate in rounding."""
    if stepper._module.header.newton_unknowns == 0:
        return stepper
    names = ("LOST", "ROUNDING") if stepper._module.header.by_stages else ("NEGLIGIBLE",)
    return rewritten(stepper, dict.fromkeys(names, "0.0"))
