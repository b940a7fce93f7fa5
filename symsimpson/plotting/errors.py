"""Figures of errors, against the step or against run time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.plotting.axes import axes, colours, legend


def plot_convergence(
    steps: ArrayLike,
    errors: Mapping[str, ArrayLike],
    *,
    orders: Mapping[str, int] | None = None,
    ax: Any = None,
) -> Any:
    """Draw errors against the step in logarithmic axes.

    Parameters
    ----------
    steps : array_like, shape (k,)
        Step sizes, from large to small.
    errors : mapping from label to array_like, shape (k,)
    orders : mapping from label to int, optional
        Labels whose line gets a triangle of that slope.
    ax : matplotlib axes, optional
        Drawn into; made if there are none.

    Returns
    -------
    matplotlib axes
    """
    ax = axes(ax, (6, 4))
    h = np.asarray(steps, dtype=np.float64)
    for marker, (label, values) in zip("osD^vP*X" * len(errors), errors.items(), strict=False):
        line = np.asarray(values, dtype=np.float64)
        (drawn,) = ax.loglog(h, line, marker + "-", ms=4, lw=1.2, label=label)
        if orders and label in orders:
            end = min(2, h.size - 1)
            corner = (float(h[-1]), float(line[-1]))
            slope_triangle(ax, corner, orders[label], float(h[-1 - end]), color=drawn.get_color())
    every = max(1, (h.size + 3) // 4)
    ax.set_xticks(h[::every], [f"{step:.3g}" for step in h[::every]])
    ax.minorticks_off()
    ax.set_xlabel("step h")
    ax.legend()
    return ax


def slope_triangle(
    ax: Any, corner: tuple[float, float], order: int, to: float, *, color: str = "0.4"
) -> None:
    """Draw a triangle of slope ``order`` below a line, from its smallest step to another step.

    The axes have logarithmic scales; ``corner`` is the line's point at the smallest step.
    """
    x, y = corner[0], corner[1] / 3
    top = y * (to / x) ** order
    ax.plot([x, to, to, x], [y, y, top, y], lw=0.8, color=color)
    middle = float(np.sqrt(x * to))
    side = (to, float(np.sqrt(y * top)))
    how: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8, "color": color}
    ax.annotate("1", (middle, y), (0, -2), ha="center", va="top", **how)
    ax.annotate(str(order), side, (3, 0), ha="left", va="center", **how)


def plot_work_precision(record: Any, *, ax: Any = None) -> Any:
    """Draw median run time against error in logarithmic axes; small and low is good.

    Of each contender the points are drawn that no other of its points beats in both.

    Parameters
    ----------
    record : Any
    ax : matplotlib axes, optional
        Drawn into; made if there are none.

    Returns
    -------
    matplotlib axes
    """
    ax = axes(ax, (8.5, 5))
    for k, (name, colour) in enumerate(zip(record.names, colours(len(record.names)), strict=True)):
        line: list[tuple[float, float]] = []
        points = [p for p in record.points if p.name == name]
        for point in sorted(points, key=lambda p: p.median):
            if not line or point.error < line[-1][0]:
                line.append((point.error, point.median))
        first = points[0].what == "steps" and not name.startswith("rk")
        style = "o-" if first else f"{'sD^v<>+x*'[k % 9]}--"
        errors, times = zip(*line, strict=True)
        how = {"lw": 1.8} if first else {"lw": 1.0, "alpha": 0.75}
        ax.loglog(errors, times, style, ms=3.5, label=name, color=colour, **how)
    ax.invert_xaxis()
    ax.set(
        xlabel="error of the state at the end",
        ylabel="run time [s]",
        title=f"{record.system}, t = {record.t_end:g}",
    )
    ax.grid(which="major", lw=0.4, alpha=0.6)
    legend(ax)
    return ax
