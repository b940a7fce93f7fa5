"""Figures of one run, or of many."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.plotting.axes import axes, colours, dotted, label, legend, name_axis
from symsimpson.plotting.curve import MOST, curve_of, envelope, sample
from symsimpson.program.input_values import read_count
from symsimpson.support.names import counted, shortened, spelled

__all__ = ["plot", "plot_energy", "plot_exponents", "plot_members", "plot_phase", "plot_section"]

#: Quantities whose largest values differ by more than this factor have panels of their own.
APART = 30
#: Numbers below this part of others are rounding.
ROUNDING = 1e-9
#: Up to LINES share a panel; if there are more, FEW do, in colours that are easily told apart.
LINES, FEW = 12, 10
#: So many coordinates are drawn unless names are given.
SHOWN = 60
#: What bands show of an ensemble.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


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
    wanted = [spelled(name) for name in read_names(names, some.program.coordinates)]
    units, steady = some.program.units, {"energy", *some.program.invariants}
    title = f"{some.program.system}, {some.program.scheme}"
    if names is None and len(wanted) > SHOWN:
        title += f": {SHOWN} of {len(wanted)} coordinates"
        wanted = wanted[:SHOWN]
    # the energy at a state between others says little of that at these
    moving = [name for name in wanted if name not in steady]
    curve = curve_of(some, lambda states: [states[name] for name in moving], connected)
    drawn = {name: curve.states if name in moving else curve.knots for name in wanted}
    values = {name: states[name] for name, states in drawn.items()}
    groups = panels_of(values, units) if ax is None else [list(values)]
    size = (7, 3.5 if len(groups) == 1 else 1.2 + 1.6 * len(groups))
    panels = np.ravel(
        axes(ax, size, **({"nrows": len(groups), "sharex": True} if ax is None else {}))
    )
    hues = cycle(colours(len(values) if ax or len(values) <= LINES else FEW))
    for panel, group in zip(panels, groups, strict=True):
        for name in group:
            joined, how = connected and (curve.connected or name in steady), {"label": label(name)}
            draw_over_time(panel, drawn[name].t, values[name], joined, color=next(hues), **how)
        panel.grid(lw=0.4, alpha=0.6)
        shared = {units.get(name) for name in group}
        unit = shared.pop() if len(shared) == 1 else None
        name_axis(panel, "y", group[0] if len(group) == 1 else "", unit)
        if len(group) > 1:
            legend(panel)
    panels[0].set_title(title)
    name_axis(panels[-1], "x", "t", units.get("t"))
    return panels[0]


def draw_over_time(ax: Any, t: Any, values: Any, joined: bool, **how: Any) -> None:
    """Draw a line, or dots, of a quantity that has a number or several at each time."""
    how = {"lw": 1.2, **how} if joined else {**dotted(len(t)), **how}
    for column in np.reshape(values, (len(t), math.prod(np.shape(values)[1:]))).T:
        few = sample(len(t), MOST)
        ax.plot(*(envelope(t, column) if joined else (t[few], column[few])), **how)


def panels_of(values: Mapping[str, Any], units: Mapping[str, str]) -> list[list[str]]:
    """Return names for panels, one above the other.

    Lengths say nothing beside angles, and small numbers nothing beside large ones.
    """
    groups: list[list[str]] = []
    for unit in dict.fromkeys(map(units.get, values)):
        sizes = {}
        for name, column in values.items():
            if units.get(name) == unit:
                y = np.abs(np.asarray(column, dtype=np.float64))
                sizes[name] = y.max(where=np.isfinite(y), initial=0.0)
        largest = max(sizes.values())  # what is 0 up to rounding may stand anywhere
        sizes = {name: x if x > ROUNDING * largest else largest for name, x in sizes.items()}
        least = np.inf
        for name in sorted(sizes, key=sizes.__getitem__):
            if not groups or sizes[name] > APART * least or least == np.inf:
                groups.append([])
                least = sizes[name]
            groups[-1].append(name)
    order, most = list(values).index, LINES if len(values) <= LINES else FEW
    groups = sorted((sorted(group, key=order) for group in groups), key=lambda x: order(x[0]))
    parts = [np.array_split(group, -(-len(group) // most)) for group in groups]
    return [part.tolist() for group in parts for part in group]


def members_drawn(count: int, members: Any, most: Any) -> Any:
    """Return numbers of members to draw, spread over all if they are counted; None for bands.

    Raises InputError if there are no such members.
    """
    if np.ndim(members):
        if np.size(members) and np.isin(members, np.arange(-count, count)).all():
            return np.asarray(members, dtype=np.int64)
        raise InputError(
            f"members={shortened(members)} are none of {counted(count, 'member')}.\n"
            "Pass how many to draw, or their numbers, from 0 on."
        )
    given = {"most": most, "members": members}
    wanted = [read_count(name, x, 1) for name, x in given.items() if x is not None]
    return np.linspace(0, count - 1, min(count, *wanted)).astype(np.int64) if wanted else None


def plot_members(many: Any, name: Any, some: Any, *, ax: Any = None) -> Any:
    """Draw how a quantity of all members is spread, over time or at the end, or lines of some."""
    (name,) = read_names(None if name is None else [name], many.program.coordinates[:1])
    values, program = np.asarray(many[name], dtype=np.float64), many.program
    ax, shown, unit = axes(ax, (7, 3.5)), len(many), program.units.get(spelled(name))
    if some is None and np.ndim(many.t) == 2:  # each has times of its own
        some = members_drawn(len(many), 100, None)
    if values.ndim == 1:
        last = values[np.isfinite(values)]
        shown = len(last)
        ax.hist(last, bins=min(60, max(5, int(len(last) ** 0.5))))
        ax.set_ylabel("members")
        name_axis(ax, "x", f"{spelled(name)} at the end", unit)
    else:
        if some is None:
            draw_bands(ax, many.t, values)
        else:
            shown, how = len(some), {"lw": 0.8, "alpha": max(0.15, min(1.0, 8 / len(some)))}
            joined = curve_of(many[int(some[0])], lambda states: [states[name]]).connected
            times = np.broadcast_to(many.t, values.shape)
            for k in some:
                draw_over_time(ax, times[k], values[k], joined, **how)
        name_axis(ax, "x", "t", program.units.get("t"))
        name_axis(ax, "y", name, unit)
    ax.set_title(f"{program.system}, {program.scheme}: {shown} of {counted(len(many), 'member')}")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def draw_bands(ax: Any, t: Any, values: Any) -> None:
    """Draw the median of members at each time, and bands that hold half and 90 % of them."""
    some = np.isfinite(values).any(axis=0)  # until the last member failed
    values, t = np.where(np.isfinite(values), values, np.nan)[:, some], t[some]
    quantile = np.nanquantile if np.isnan(values).any() else np.quantile  # three times as fast
    lowest, low, median, high, highest = quantile(values, QUANTILES, axis=0)
    ax.fill_between(t, lowest, highest, color="C0", alpha=0.2, lw=0, label="5 to 95 %")
    ax.fill_between(t, low, high, color="C0", alpha=0.35, lw=0, label="25 to 75 %")
    ax.plot(t, median, color="C0", lw=1.2, label="median", marker="." if len(t) <= 50 else "")
    legend(ax)


def plot_phase(
    some: Any, x: Any = None, y: Any = None, *, connected: bool = True, ax: Any = None
) -> Any:
    """Draw one quantity over another: a momentum over its coordinate, unless others are named."""
    (x,) = read_names(None if x is None else [x], some.program.coordinates[:1])
    (y,) = read_names(None if y is None else [y], [f"p_{spelled(x)}"])
    program = some.program
    curve = curve_of(some, lambda states: [states[x], states[y]], connected, thin=True)
    drawn = curve.states[x], curve.states[y]
    ax = axes(ax, (4.5, 4.5))
    ax.locator_params(axis="x", nbins=6)
    ax.plot(*drawn, **({"lw": 0.8} if curve.connected else dotted(len(some))))
    ax.set_title(f"{program.system}, {program.scheme}")
    for axis, name in (("x", x), ("y", y)):
        name_axis(ax, axis, name, program.units.get(spelled(name)))
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def plot_section(crossings: Any, names: Any = None, *, ax: Any = None) -> Any:
    """Draw states of a section: two quantities that are named, or that it does not fix."""
    wanted = read_names(names, free_names(crossings))
    if len(wanted) == 2:
        return plot_phase(crossings, *wanted, connected=False, ax=ax)
    return plot(crossings, wanted, connected=False, ax=ax)


def free_names(crossings: Any) -> tuple[str, ...]:
    """Return the first coordinate of a section that it does not fix, and its momentum.

    Changes are compared with how far the system moves meanwhile, which has the same unit.
    """
    t, q, p, v = (np.asarray(getattr(crossings, x), dtype=np.float64) for x in "tqpv")
    names = crossings.program.coordinates
    if len(t) > 1:
        size = np.maximum(np.abs(q).max(axis=0), np.abs(v).max(axis=0) * np.ptp(t))
        free = np.ptp(q, axis=0) > ROUNDING * size
        free &= np.ptp(p, axis=0) > ROUNDING * np.abs(p).max(axis=0)
        if free.any():
            name = names[int(free.argmax())]
            return name, f"p_{name}"
    return (f"p_{names[0]}",) if len(names) == 1 else names[:1]


def plot_energy(run: Any, *, shadow: bool = False, ax: Any = None) -> Any:
    """Draw the error of the energy over time; where forces do work, the energy less that work."""
    ax = axes(ax, (7, 3))
    constant, unit = run.program.header.conservative, run.program.units.get("energy")
    absolute = not constant and unit is not None
    scale = 1.0 if constant or absolute else run.energy_scale
    change = run.energy_error if constant else run.energy_balance / scale
    draw_over_time(ax, run.t, change, True, lw=0.8, label="energy" if shadow else None)
    if shadow:
        kept = (run.shadow_energy - run.shadow_energy[0]) / run.energy_scale
        draw_over_time(ax, run.t, kept, True, lw=0.8, label="shadow energy")
        legend(ax)
    shown, relative = "H - H0" if constant else "H - H0 - work", ""
    if not absolute and (run.E0 or run.kinetic_energy.any()):
        relative = "|H0|" if run.energy_scale == abs(run.E0) else "kinetic energy"
    name_axis(ax, "x", "t", run.program.units.get("t"))
    name_axis(ax, "y", f"({shown}) / {relative}" if relative else shown, None if relative else unit)
    what = "energy error" if constant else "energy balance"
    ax.set_title(f"{what}: {run.program.system}, {run.program.scheme}, h = {float(run.h):g}")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def plot_exponents(chaos: Any, *, ax: Any = None) -> Any:
    """Draw Lyapunov exponents over the time that they were averaged over."""
    ax = axes(ax, (7, 3))
    ax.set_prop_cycle(color=colours(chaos.history.shape[1]))
    for k, history in enumerate(chaos.history.T):
        ax.plot(chaos.t, history, lw=0.8, label=f"exponent {k + 1}")
    program = chaos.trajectory.program
    unit = program.units.get("t")
    name_axis(ax, "x", "t", unit)
    name_axis(ax, "y", "exponent", f"1/{unit}" if unit else "1 / time")
    ax.set_title(f"{program.system}, {program.scheme}")
    legend(ax)
    ax.grid(lw=0.4, alpha=0.6)
    return ax
