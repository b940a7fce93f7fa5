"""Libraries that only some need."""

from __future__ import annotations

import importlib
from typing import Any

from symsimpson.errors import InputError


def library(name: str, use: str, extra: str) -> Any:
    """Import a library that comes with an extra of the package.

    Raises InputError if it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(
            f"{use} needs {name.partition('.')[0]}, which is not installed.\n"
            f"Install it with pip install 'symsimpson[{extra}]'."
        ) from None
