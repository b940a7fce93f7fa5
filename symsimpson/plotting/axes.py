"""Axes to draw into, and their names."""

from __future__ import annotations

import math
from typing import Any

from symsimpson.errors import reject
from symsimpson.support.extras import library
from symsimpson.support.names import spelled


def axes(ax: Any, size: tuple[float, float], **how: Any) -> Any:
    """Return the axes that are there, or new ones; ``how`` they are made.

    Raises InputError if matplotlib is not installed, or what is there are no axes.
    """
    plt = library("matplotlib.pyplot", "a figure", "plot")
    if ax is None:
        return plt.subplots(figsize=size, layout="constrained", **how)[1]
    if not isinstance(ax, library("matplotlib.axes", "a figure", "plot").Axes):
        reject(
            f"ax is {type(ax).__name__}, not axes of matplotlib.",
            remedy="Pass one of plt.subplots()[1], or leave ax out.",
        )
    return ax


def colours(count: int) -> list[Any]:
    """Return so many colours, no two of them alike: matplotlib's own, or more from a map."""
    matplotlib = library("matplotlib", "a figure", "plot")
    if count <= len(matplotlib.rcParams["axes.prop_cycle"]):
        return [matplotlib.colors.to_hex(f"C{k}") for k in range(count)]
    turbo = matplotlib.colormaps["turbo"]
    return [turbo(k / (count - 1)) for k in range(count)]


def style(joined: bool, count: int, width: float) -> dict[str, Any]:
    """Return the style of a curve, or of ``count`` states that no line connects."""
    dots = {"ls": "none", "marker": ".", "ms": 2.5 if count > 300 else 5}
    return {"lw": width} if joined else dots


def label(name: Any) -> str:
    """Return a name as matplotlib writes it as it is.

    It would read what is between dollars as a formula, and hide what begins with a line.
    """
    text = spelled(name).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def name_axis(ax: Any, axis: str, name: Any, unit: str | None = None) -> None:
    """Label the axis "x", "y" or "z" with a name and a unit, after all is drawn.

    The label has the power of ten of large and small numbers, which matplotlib puts in a corner.
    """
    matplotlib = library("matplotlib", "a figure", "plot")
    formatter = library("matplotlib.ticker", "a figure", "plot").ScalarFormatter()
    scale, parts = getattr(ax, f"{axis}axis"), [label(unit)] if unit else []
    largest = max(map(abs, getattr(ax, f"get_{axis}lim")()))
    power = math.floor(math.log10(largest)) if 0 < largest < math.inf else 0
    least, most = matplotlib.rcParams["axes.formatter.limits"]
    moved = not least < power < most
    if isinstance(scale.get_major_formatter(), type(formatter)):
        if moved:
            parts.insert(0, f"$10^{{{power}}}$")
            formatter.set_useOffset(False)
            formatter.set_powerlimits((power, power))
        scale.set_major_formatter(formatter)
        scale.offsetText.set_visible(not moved)
    shown = [label(name), f"[{' '.join(parts)}]"] if parts else [label(name)]
    getattr(ax, f"set_{axis}label")(" ".join(filter(str.strip, shown)))


def name_axes(ax: Any, program: Any, x: Any, y: Any) -> Any:
    """Name two quantities with their units, and the system above a grid, after all is drawn."""
    for axis, name in (("x", x), ("y", y)):
        name_axis(ax, axis, name, program.units.get(spelled(name)))
    ax.set_title(f"{program.system}, {program.scheme}")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def legend(ax: Any) -> None:
    """Name the lines beside axes, where the names hide none of them."""
    away = 1.1 if hasattr(ax, "get_zlim") else 1.01
    ax.legend(fontsize=8, loc="upper left", bbox_to_anchor=(away, 1), frameon=False)
