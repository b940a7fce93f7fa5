"""Steppers of modules that come from files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symsimpson.module.syntax import check_structure

if TYPE_CHECKING:
    from symsimpson.runtime.loaded import Tools
    from symsimpson.runtime.stepper import Stepper

__all__ = ["read_stepper"]


def read_stepper(text: str, where: str, tools: Tools | None = None) -> Stepper:
    """Make a stepper of a module that comes from a file, once digest and structure are checked.

    Raises
    ------
    StaleKernelError
        If it is not a module that this version generated.
    """
    from symsimpson.runtime.stepper import Stepper

    stepper = Stepper(text, where, tools=tools)  # compares the digest, executes nothing
    check_structure(text, where)
    return stepper
