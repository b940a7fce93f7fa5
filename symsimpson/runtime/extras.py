"""Libraries that only some need."""

from __future__ import annotations

import importlib
from typing import Any

from symsimpson.errors import InputError

__all__ = ["data_library"]


def data_library(name: str, use: str) -> Any:
    """Import a library of the extra ``data``.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(
            f"{use} needs {name}, which is not installed.\n"
            "Install it with pip install 'symsimpson[data]'."
        ) from None
