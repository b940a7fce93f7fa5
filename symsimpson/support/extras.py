"""Imports of optional libraries."""

from __future__ import annotations

import importlib
from typing import Any

from symsimpson.errors import reject


def import_library(name: str, use: str, extra: str) -> Any:
    """Import an optional library, which an extra of the package installs.

    ``use`` names the feature in the message. Raises InputError if the library is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        reject(
            f"{use} needs {name.partition('.')[0]}, which is not installed.",
            remedy=f"Install it with pip install 'symsimpson[{extra}]'.",
        )
