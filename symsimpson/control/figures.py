"""Figures of solutions of optimal control."""

from __future__ import annotations

from typing import Any

import numpy as np

from symsimpson.plotting.axes import axes, colours, label, name_axis

__all__ = ["iterations", "motion", "sparsity"]


def motion(result: Any) -> Any:
    """Draw coordinates and inputs over the time, a panel for each unit, inputs with bounds."""
    read, units = result.layout.read, result.layout.read.system.units
    t = np.linspace(0, result.duration, 12 * result.layout.steps + 1)
    groups: dict[tuple[str, Any], list[str]] = {}
    for kind, names in (("coordinates", read.names), ("inputs", read.inputs)):
        for name in names:
            groups.setdefault((kind, units.get(name)), []).append(name)
    size = (6.4, 1.4 + 1.7 * len(groups))
    panels = np.atleast_1d(axes(None, size, nrows=len(groups), sharex=True))
    values = {name: result.functions[name](t) for name in read.names} | result.inputs(t)
    for ax, ((kind, unit), names) in zip(panels, groups.items(), strict=True):
        for name, colour in zip(names, colours(len(names)), strict=True):
            ax.plot(t, values[name], label=label(name), color=colour)
            bounds = read.of_inputs.get(read.inputs.index(name), ()) if kind == "inputs" else ()
            for bound in filter(np.isfinite, bounds):
                ax.axhline(bound, color=colour, linestyle=":", linewidth=1)
        name_axis(ax, "y", kind if len(names) > 1 else names[0], unit)
        if len(names) > 1:
            ax.legend()
    name_axis(panels[-1], "x", "t", units.get("t"))
    return panels[0].figure


def iterations(result: Any) -> Any:
    """Draw by how much constraints are violated, and optimality is missed, in each iteration."""
    ax = axes(None, (6.4, 3.2))
    for name, key in (("constraint violation", "inf_pr"), ("optimality", "inf_du")):
        values = np.array(result.history.get(key, []))
        ax.semilogy(np.where(values > 0, values, np.nan), label=name)
    ax.set(xlabel="iteration", ylabel="largest, scaled")
    ax.legend()
    return ax.figure


def sparsity(result: Any) -> Any:
    """Draw where the Jacobian of the constraints and the Hessian of the Lagrangian have entries."""
    programme, *_ = result.layout.programme
    left, right = axes(None, (8.0, 4.0), ncols=2)
    rows, size = programme.shape
    named = (
        (left, "Jacobian", programme.jacobian_places, rows, "constraint"),
        (right, "Hessian, upper half", programme.hessian_places, size, "variable"),
    )
    for ax, name, (row, column), height, of_rows in named:
        ax.plot(column, row, linestyle="", marker="s", markersize=max(0.4, 120 / size))
        ax.set(
            title=f"{name}: {len(row)} entries",
            xlim=(-0.5, size - 0.5),
            ylim=(height - 0.5, -0.5),
            xlabel="variable",
            ylabel=of_rows,
        )
    return left.figure
