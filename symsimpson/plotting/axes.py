"""Axes of figures, with their labels, colours and line styles."""

from __future__ import annotations

import math
from typing import Any

from symsimpson.errors import reject
from symsimpson.support.extras import import_library
from symsimpson.support.names import spelled


def get_axes(ax: Any, size: tuple[float, float], **how: Any) -> Any:
    """Return the axes ``ax``, or new axes if it is None; ``how`` has options of plt.subplots.

    Raises InputError if matplotlib is not installed, or if ``ax`` is of another type.
    """
    plt = import_library("matplotlib.pyplot", "a figure", "plot")
    if ax is None:
        return plt.subplots(figsize=size, layout="constrained", **how)[1]
    if not isinstance(ax, import_library("matplotlib.axes", "a figure", "plot").Axes):
        reject(
            f"ax is {type(ax).__name__}, not matplotlib axes.",
            remedy="Pass axes from plt.subplots()[1], or leave ax out.",
        )
    return ax


def choose_colours(count: int) -> list[Any]:
    """Return different colours from matplotlib's cycle, or from a colour map for many."""
    matplotlib = import_library("matplotlib", "a figure", "plot")
    if count <= len(matplotlib.rcParams["axes.prop_cycle"]):
        return [matplotlib.colors.to_hex(f"C{k}") for k in range(count)]
    turbo = matplotlib.colormaps["turbo"]
    return [turbo(k / (count - 1)) for k in range(count)]


def line_style(joined: bool, count: int, width: float) -> dict[str, Any]:
    """Return options of a joined line of some width, or of ``count`` separate dots."""
    dots = {"ls": "none", "marker": ".", "ms": 2.5 if count > 300 else 5}
    return {"lw": width} if joined else dots


def escape_label(name: Any) -> str:
    """Return a name with special characters of matplotlib escaped.

    matplotlib interprets text between dollar signs as a formula. It hides labels that begin with
    an underscore.
    """
    text = spelled(name).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def name_axis(ax: Any, axis: str, name: Any, unit: str | None = None) -> None:
    """Label the axis "x", "y" or "z" with a name and a unit. Call it after all plots.

    The label includes the power of ten of large and small numbers. matplotlib would put it in a
    corner.
    """
    matplotlib = import_library("matplotlib", "a figure", "plot")
    formatter = import_library("matplotlib.ticker", "a figure", "plot").ScalarFormatter()
    scale, parts = getattr(ax, f"{axis}axis"), [escape_label(unit)] if unit else []
    largest = max(map(abs, getattr(ax, f"get_{axis}lim")()))
    power = math.floor(math.log10(largest)) if 0 < largest < math.inf else 0
    least, most = matplotlib.rcParams["axes.formatter.limits"]
    scaled = not least < power < most
    if isinstance(scale.get_major_formatter(), type(formatter)):
        if scaled:
            parts.insert(0, f"$10^{{{power}}}$")
            formatter.set_useOffset(False)
            formatter.set_powerlimits((power, power))
        scale.set_major_formatter(formatter)
        scale.offsetText.set_visible(not scaled)
    texts = [escape_label(name), f"[{' '.join(parts)}]"] if parts else [escape_label(name)]
    getattr(ax, f"set_{axis}label")(" ".join(filter(str.strip, texts)))


def name_axes(ax: Any, program: Any, x: Any, y: Any) -> Any:
    """Label both axes, set the title and draw a grid. Call it after all plots."""
    for axis, name in (("x", x), ("y", y)):
        name_axis(ax, axis, name, program.units.get(spelled(name)))
    ax.set_title(f"{program.system}, {program.scheme}")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def add_legend(ax: Any) -> None:
    """Add a legend to the right of the axes, where it hides no line."""
    left = 1.1 if hasattr(ax, "get_zlim") else 1.01
    ax.legend(fontsize=8, loc="upper left", bbox_to_anchor=(left, 1), frameon=False)
