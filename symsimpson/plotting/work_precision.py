"""Run time against error."""

from __future__ import annotations

from typing import Any

from symsimpson.plotting.axes import axes, colours, legend

__all__ = ["plot_work_precision"]


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
