"""Figures of one run, or of many."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.plotting.axes import axes, colours
from symsimpson.support.names import counted, shortened, spelled

__all__ = ["plot", "plot_energy", "plot_exponents", "plot_members", "plot_phase"]

#: The dots of states that no line connects.
DOTS = {"ls": "none", "marker": ".", "ms": 2.5}


def label(name: Any) -> str:
    """Return a name as matplotlib writes it as it is.

    It would read what is between dollars as a formula, and hide what begins with a line.
    """
    text = spelled(name).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def with_unit(name: Any, units: Mapping[str, str]) -> str:
    """Return a name as matplotlib writes it, and its unit if that is known."""
    unit = units.get(spelled(name))
    return label(name) + (f" [{unit}]" if unit else "")


def read_names(given: Any, default: Sequence[Any]) -> list[Any]:
    """Read which quantities to draw: one, or several in a row; all of a default for None.

    Raises InputError if numbers are given, as to matplotlib.
    """
    if given is None:
        return list(default)
    wanted = [given] if is_name(given) or not isinstance(given, Iterable) else list(given)
    if not all(map(is_name, wanted)):
        raise InputError(
            f"{shortened(given)} is given to be drawn, which is no name of a quantity.\nPass names "
            "or symbols, as plot('q1', 'energy'); matplotlib draws arrays: plt.plot(run.t, "
            "run['q1'])."
        )
    return wanted or list(default)


def is_name(given: Any) -> bool:
    """Return whether something may name a quantity: a text, a symbol, a function of time."""
    return isinstance(given, str) or hasattr(given, "free_symbols")


def plot(some: Any, names: Any = None, *, connected: bool = True, ax: Any = None) -> Any:
    """Draw quantities over time: all coordinates, unless some are named."""
    wanted = read_names(names, some.program.coordinates)
    values, units = {spelled(name): some[name] for name in wanted}, some.program.units
    by_unit: dict[str | None, list[str]] = {}
    for name in values:
        by_unit.setdefault(units.get(name), []).append(name)
    title = f"{some.program.system}, {some.program.scheme}"
    if ax is None and len(by_unit) > 1:  # one above the other: lengths say nothing beside angles
        size = (7, 1.2 + 1.6 * len(by_unit))
        panels = list(axes(None, size, nrows=len(by_unit), sharex=True))
    else:
        panels, by_unit = [axes(ax, (7, 3.5))], {None: list(values)}
    how, colour = ({"lw": 1.2} if connected else DOTS), iter(colours(len(values)))
    for panel, (unit, together) in zip(panels, by_unit.items(), strict=True):
        for name in together:
            panel.plot(some.t, values[name], label=label(name), color=next(colour), **how)
        panel.grid(lw=0.4, alpha=0.6)
        if len(together) == 1:
            panel.set_ylabel(with_unit(together[0], units))
        else:
            same = {units.get(name) for name in together}
            shared = unit or (same.pop() if len(same) == 1 else None)
            panel.set_ylabel(f"[{shared}]" if shared else "")
            panel.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    panels[0].set_title(title)
    panels[-1].set_xlabel(with_unit("t", units))
    return panels[0]


def plot_members(many: Any, name: Any, some: Any, *, ax: Any = None) -> Any:
    """Draw a quantity of some members over time, or how its last values are spread."""
    (name,) = read_names(None if name is None else [name], many.program.coordinates[:1])
    values, units = many[name], many.program.units
    ax, shown = axes(ax, (7, 3.5)), len(some)
    if values.ndim == 2:
        times = np.broadcast_to(many.t, values.shape)
        ax.plot(times[some].T, values[some].T, lw=0.8, alpha=max(0.15, min(1.0, 8 / len(some))))
        ax.set(xlabel=with_unit("t", units), ylabel=with_unit(name, units))
    else:
        last = values[np.isfinite(values)]  # of all, not of some
        shown = len(last)
        ax.hist(last, bins=min(60, max(5, int(len(last) ** 0.5))))
        ax.set(xlabel=f"{with_unit(name, units)} at the end", ylabel="members")
    program = many.program
    ax.set_title(f"{program.system}, {program.scheme}: {shown} of {counted(len(many), 'member')}")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def plot_phase(
    some: Any, x: Any = None, y: Any = None, *, connected: bool = True, ax: Any = None
) -> Any:
    """Draw one quantity over another: a momentum over its coordinate, unless others are named."""
    (x,) = read_names(None if x is None else [x], some.program.coordinates[:1])
    (y,) = read_names(None if y is None else [y], [f"p_{spelled(x)}"])
    curve = some[x], some[y]
    ax = axes(ax, (4.5, 4.5))
    ax.plot(*curve, **({"lw": 0.8} if connected else DOTS))
    title = f"{some.program.system}, {some.program.scheme}"
    units = some.program.units
    ax.set(xlabel=with_unit(x, units), ylabel=with_unit(y, units), title=title)
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def plot_energy(run: Any, *, shadow: bool = False, ax: Any = None) -> Any:
    """Draw the error of the energy over time; where forces do work, the energy less that work."""
    ax = axes(ax, (7, 3))
    constant = run.program.header.conservative
    change = run.energy_error if constant else run.energy_balance
    ax.plot(run.t, change, lw=0.8, label="energy" if shadow else None)
    if shadow:
        kept = run.shadow_energy
        ax.plot(run.t, (kept - kept[0]) / run.energy_scale, lw=0.8, label="shadow energy")
        ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    name = f"{run.program.system}, {run.program.scheme}, h = {float(run.h):g}"
    shown, unit = "H - H0" if constant else "H - H0 - work", run.program.units.get("energy")
    if constant and run.energy_scale == abs(run.E0):
        shown = "(H - H0) / |H0|"
    elif constant and run.kinetic_energy.any():
        shown = "(H - H0) / kinetic energy"
    elif unit:
        shown += f" [{unit}]"
    what = "energy error" if constant else "energy balance"
    time = with_unit("t", run.program.units)
    ax.set(xlabel=time, ylabel=shown, title=f"{what}: {name}")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def plot_exponents(chaos: Any, *, ax: Any = None) -> Any:
    """Draw Lyapunov exponents over the time that they were averaged over."""
    ax = axes(ax, (7, 3))
    ax.set_prop_cycle(color=colours(chaos.history.shape[1]))
    for k, history in enumerate(chaos.history.T):
        ax.plot(chaos.t, history, lw=0.8, label=f"exponent {k + 1}")
    program = chaos.trajectory.program
    ax.set(xlabel="t", ylabel="exponent, 1 / time", title=f"{program.system}, {program.scheme}")
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    ax.grid(lw=0.4, alpha=0.6)
    return ax
