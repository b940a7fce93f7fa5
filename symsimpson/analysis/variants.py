"""Steppers that differ from a generated module in one line: for comparison, never for use."""

from __future__ import annotations

import re

from symsimpson.runtime.kernels.module import SIGNED, digest
from symsimpson.runtime.stepper import Stepper

__all__ = ["oversolved", "rewritten"]


def rewritten(stepper: Stepper, old: str, new: str) -> Stepper:
    """Give a stepper with another line in its module, which is signed anew.

    Raises
    ------
    ValueError
        If the line does not stand there once.
    """
    text = stepper.source
    banner = SIGNED.search(text)
    if banner is None or text.count(old) != 1:
        raise ValueError(f"{old!r} does not stand once in the module")
    text = text.replace(old, new)
    text = text.replace(banner[1], digest(text[banner.end() :]), 1)
    return Stepper(text, f"{stepper.system}, changed", reference_state=stepper.reference_state)


def oversolved(stepper: Stepper) -> Stepper:
    """Give a stepper whose iterations go on until corrections stagnate in rounding."""
    if stepper._facts.newton_unknowns == 0:
        return stepper
    names = ("LOST", "ROUNDING") if stepper._facts.by_stages else ("NEGLIGIBLE",)
    for name in names:
        line = re.search(rf"^{name} = [^#\n]*", stepper.source, re.MULTILINE)
        assert line is not None
        stepper = rewritten(stepper, line[0].rstrip(), f"{name} = 0.0")
    return stepper
