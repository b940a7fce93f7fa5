"""Libraries that only some need."""

from __future__ import annotations

import importlib
from typing import Any

from symsimpson.errors import reject


def library(name: str, use: str, extra: str) -> Any:
    """Import a library that comes with an extra of the package.

    Raises InputError if it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        reject(
            f"{use} needs {name.partition('.')[0]}, which is not installed.",
            remedy=f"Install it with pip install 'symsimpson[{extra}]'.",
        )
