"""Axes to draw into."""

from __future__ import annotations

from typing import Any

from symsimpson.runtime.extras import library

__all__ = ["axes"]


def axes(ax: Any, size: tuple[float, float]) -> Any:
    """Give the axes that are there, or new ones.

    Raises
    ------
    InputError
        If matplotlib is not installed.
    """
    if ax is not None:
        return ax
    plt = library("matplotlib.pyplot", "a figure", "plot")
    return plt.subplots(figsize=size, layout="constrained")[1]
