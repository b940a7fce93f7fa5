"""Steppers that differ from a generated module in one line: for comparison, never for use."""

from __future__ import annotations

import hashlib
import re

from symsimpson.runtime.stepper import Stepper

__all__ = ["oversolved", "rewritten"]

_SIGNED = re.compile(r"^# sha256 of what follows: ([0-9a-f]{64})\n", re.MULTILINE)


def rewritten(stepper: Stepper, old: str, new: str) -> Stepper:
    """Give a stepper with another line in its module, which is signed anew.

    Raises
    ------
    ValueError
        If the line does not stand there once.
    """
    text = stepper.source
    banner = _SIGNED.search(text)
    if banner is None or text.count(old) != 1:
        raise ValueError(f"{old!r} does not stand once in the module")
    text = text.replace(old, new)
    digest = hashlib.sha256(text[banner.end() :].encode()).hexdigest()
    text = text.replace(banner[1], digest, 1)
    return Stepper(text, f"{stepper.system}, changed", reference_state=stepper.reference_state)


def oversolved(stepper: Stepper) -> Stepper:
    """Give a stepper whose Newton iterations go on until corrections stagnate in rounding."""
    if stepper._facts.newton_unknowns == 0:
        return stepper
    line = re.search(r"^NEGLIGIBLE = [^#\n]*", stepper.source, re.MULTILINE)
    assert line is not None
    return rewritten(stepper, line[0].rstrip(), "NEGLIGIBLE = 0.0")
