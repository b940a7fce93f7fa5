"""Axes to draw into."""

from __future__ import annotations

from typing import Any

from symsimpson.errors import InputError
from symsimpson.support.extras import library

__all__ = ["axes", "colours"]


def axes(ax: Any, size: tuple[float, float], **how: Any) -> Any:
    """Return the axes that are there, or new ones; ``how`` they are made.

    Raises InputError if matplotlib is not installed, or what is there are no axes.
    """
    plt = library("matplotlib.pyplot", "a figure", "plot")
    if ax is None:
        return plt.subplots(figsize=size, layout="constrained", **how)[1]
    if not isinstance(ax, library("matplotlib.axes", "a figure", "plot").Axes):
        raise InputError(
            f"ax is {type(ax).__name__}, not axes of matplotlib.\n"
            "Pass one of plt.subplots()[1], or leave ax out."
        )
    return ax


def colours(count: int) -> list[Any]:
    """Return so many colours, no two of them alike: matplotlib's own, or more from a map."""
    matplotlib = library("matplotlib", "a figure", "plot")
    if count <= len(matplotlib.rcParams["axes.prop_cycle"]):
        return [matplotlib.colors.to_hex(f"C{k}") for k in range(count)]
    turbo = matplotlib.colormaps["turbo"]
    return [turbo(k / (count - 1)) for k in range(count)]
