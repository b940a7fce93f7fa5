"""Figures of solutions of optimal control."""

from __future__ import annotations

from typing import Any

import numpy as np

from symsimpson.plotting.axes import axes, colours

__all__ = ["iterations", "motion", "sparsity"]


def motion(result: Any) -> Any:
    """Draw coordinates and inputs over the time, inputs with their bounds."""
    upper, lower = axes(None, (6.4, 4.8), nrows=2, sharex=True)
    layout = result.layout
    upper.set_prop_cycle(color=colours(len(layout.read.names)))
    lower.set_prop_cycle(color=colours(max(1, len(layout.read.inputs))))
    t = np.linspace(0, result.duration, 12 * layout.steps + 1)
    for name in layout.read.names:
        upper.plot(t, result.functions[name](t), label=name)
    for k, (name, values) in enumerate(result.inputs(t).items()):
        (line,) = lower.plot(t, values, label=name)
        for bound in layout.read.of_inputs.get(k, ()):
            if np.isfinite(bound):
                lower.axhline(bound, color=line.get_color(), linestyle=":", linewidth=1)
    upper.set_ylabel("coordinates")
    lower.set(xlabel="t", ylabel="inputs")
    for ax in (upper, lower)[: 1 + bool(layout.read.inputs)]:
        ax.legend()
    return upper.figure


def iterations(result: Any) -> Any:
    """Draw by how much rows are violated, and optimality is missed, in each iteration."""
    ax = axes(None, (6.4, 3.2))
    for name, key in (("violation of rows", "inf_pr"), ("optimality", "inf_du")):
        values = np.array(result.history.get(key, []))
        ax.semilogy(np.where(values > 0, values, np.nan), label=name)
    ax.set(xlabel="iteration", ylabel="largest, in the solver's units")
    ax.legend()
    return ax.figure


def sparsity(result: Any) -> Any:
    """Draw where the Jacobian of the rows and the Hessian of the Lagrangian have entries."""
    programme, *_ = result.layout.programme
    left, right = axes(None, (8.0, 4.0), ncols=2)
    rows, size = programme.shape
    named = (
        (left, "Jacobian", programme.jacobian_places, rows),
        (right, "Hessian, upper half", programme.hessian_places, size),
    )
    for ax, name, (row, column), height in named:
        ax.plot(column, row, linestyle="", marker="s", markersize=max(0.4, 120 / size))
        ax.set(
            title=f"{name}: {len(row)} entries",
            xlim=(-0.5, size - 0.5),
            ylim=(height - 0.5, -0.5),
            xlabel="unknown",
            ylabel="row",
        )
    return left.figure
