"""Figures of one run, or of many."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.plotting.axes import DOTTED, axes, colours, label, legend, name_axis
from symsimpson.plotting.curve import MOST, Curve, curve_of, envelope, sample
from symsimpson.program.input_values import read_count
from symsimpson.support.names import counted, shortened, spelled

__all__ = ["plot", "plot_energy", "plot_exponents", "plot_members", "plot_phase", "plot_section"]

#: Quantities whose ranges differ by more than this, or lie so far apart, have panels of their own.
APART = 30
#: Ranges below this part of others are rounding, and values that differ by less are the same.
ROUNDING, SAME = 1e-9, 1e-9
#: Up to LINES share a panel, and FEW, of colours that are easily told apart, if there are more.
LINES, FEW, PANELS = 12, 10, 6
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
    if names is None and len(wanted) > (most := PANELS * LINES):
        title += f": {most} of {counted(len(wanted), 'coordinate')}"
        wanted = wanted[:most]
    if connected:  # the energy at a state between others says little of that at these
        moving = [name for name in wanted if name not in steady]
        curve = curve_of(some, lambda states: [states[name] for name in moving])
    else:
        curve = Curve(some, some, False)
    drawn = {name: curve.knots if name in steady else curve.states for name in wanted}
    values = {name: states[name] for name, states in drawn.items()}
    together = panels_of(values, units) if ax is None else [(None, wanted)]
    size = (7, 3.5 if len(together) == 1 else 1.2 + 1.6 * len(together))
    panels = np.ravel(axes(ax, size, **({} if ax else {"nrows": len(together), "sharex": True})))
    hues = [*colours(len(values))] if ax or len(values) <= LINES else None
    for panel, (unit, group) in zip(panels, together, strict=True):
        ways = [{"color": hue} for hue in hues[: len(group)]] if hues else [{}] * len(group)
        hues = hues[len(group) :] if hues else None
        for name, way in zip(group, ways, strict=True):
            joined = connected and (curve.connected or name in steady)
            draw_over_time(panel, drawn[name].t, values[name], joined, label=label(name), **way)
        panel.grid(lw=0.4, alpha=0.6)
        if len(group) == 1:
            name_axis(panel, "y", group[0], units.get(group[0]))
        else:
            same = {units.get(name) for name in group}
            name_axis(panel, "y", "", unit or (same.pop() if len(same) == 1 else None))
            legend(panel)
    panels[0].set_title(title)
    name_axis(panels[-1], "x", "t", units.get("t"))
    return panels[0]


def draw_over_time(ax: Any, t: Any, values: Any, joined: bool, **how: Any) -> None:
    """Draw a line, or dots, of a quantity that has a number or several at each time."""
    how = {"lw": 1.2, **how} if joined else {**DOTTED, **how}
    for column in np.reshape(values, (len(t), -1)).T:
        few = sample(len(t), MOST)
        ax.plot(*(envelope(t, column) if joined else (t[few], column[few])), **how)


def panels_of(
    values: Mapping[str, Any], units: Mapping[str, str]
) -> list[tuple[str | None, list[str]]]:
    """Return names for panels, one above the other, each with its unit.

    Lengths say nothing beside angles, and what moves little would be flat beside what moves much.
    """
    groups: list[tuple[str | None, list[str], list[Any]]] = []
    for name, column in values.items():
        y = np.asarray(column, dtype=np.float64)
        finite, unit = np.isfinite(y), units.get(name)
        ends = y.min(where=finite, initial=np.inf), y.max(where=finite, initial=-np.inf)
        for of_group, names, ranges in groups:
            low, high = np.transpose([*ranges, ends])
            spans, all_of = high - low, high.max() - low.min()
            moves = spans > ROUNDING * all_of
            if of_group == unit and all_of <= APART * spans.min(where=moves, initial=np.inf):
                names.append(name)
                ranges.append(ends)
                break
        else:
            groups.append((unit, [name], [ends]))
    if len(groups) > PANELS:
        several = list(dict.fromkeys(map(units.get, values)))
        groups = [(x, [name for name in values if units.get(name) == x], []) for x in several]
    most = LINES if len(values) <= LINES else FEW
    return [
        (unit, part.tolist())
        for unit, names, _ in groups
        for part in np.array_split(np.array(names, dtype=object), -(-len(names) // most))
    ]


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
    if values.ndim == 1:
        last = values[np.isfinite(values)]
        shown = len(last)
        ax.hist(last, bins=min(60, max(5, int(len(last) ** 0.5))))
        name_axis(ax, "x", f"{spelled(name)} at the end", unit)
        ax.set_ylabel("members")
    else:
        if some is None:
            draw_bands(ax, *at_common_times(np.asarray(many.t, dtype=np.float64), values))
            legend(ax)
        else:
            shown, alpha = len(some), max(0.15, min(1.0, 8 / len(some)))
            joined = curve_of(many[int(some[0])], lambda states: [states[name]]).connected
            for t, column in zip(
                np.broadcast_to(many.t, values.shape)[some], values[some], strict=True
            ):
                draw_over_time(ax, t, column, joined, lw=0.8, alpha=alpha)
        name_axis(ax, "x", "t", program.units.get("t"))
        name_axis(ax, "y", name, unit)
    ax.set_title(f"{program.system}, {program.scheme}: {shown} of {counted(len(many), 'member')}")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def draw_bands(ax: Any, t: Any, values: Any) -> None:
    """Draw the median of members at each time, and bands that hold half and 90 % of them."""
    some = np.isfinite(values).any(axis=0)  # until the last member failed
    t, values = t[some], np.where(np.isfinite(values), values, np.nan)[:, some]
    lowest, low, median, high, highest = np.nanquantile(values, QUANTILES, axis=0)
    ax.fill_between(t, lowest, highest, color="C0", alpha=0.2, lw=0, label="5 to 95 %")
    ax.fill_between(t, low, high, color="C0", alpha=0.35, lw=0, label="25 to 75 %")
    ax.plot(t, median, color="C0", lw=1.2, label="median", marker="." if len(t) <= 50 else "")


def at_common_times(t: Any, values: Any) -> tuple[Any, Any]:
    """Return values at the same times for all members, those of retimed systems interpolated."""
    if t.ndim == 1:
        return t, values
    sign = -1.0 if np.nanmean(np.diff(t)) < 0 else 1.0
    times = np.linspace(np.nanmin(sign * t), np.nanmax(sign * t), t.shape[1])
    rows = []
    for own, column in zip(sign * t, values, strict=True):
        there = np.isfinite(own)
        rows.append(np.interp(times, own[there], column[there], left=np.nan, right=np.nan))
    return sign * times, np.array(rows)


def plot_phase(
    some: Any, x: Any = None, y: Any = None, *, connected: bool = True, ax: Any = None
) -> Any:
    """Draw one quantity over another: a momentum over its coordinate, unless others are named."""
    (x,) = read_names(None if x is None else [x], some.program.coordinates[:1])
    (y,) = read_names(None if y is None else [y], [f"p_{spelled(x)}"])
    some[y]  # a name that there is none of leaves no figure
    program, curve = some.program, Curve(some, some, False)
    if connected:
        curve = curve_of(some, lambda states: [states[x], states[y]], thin=True)
    ax = axes(ax, (4.5, 4.5))
    ax.locator_params(axis="x", nbins=6)
    ax.plot(curve.states[x], curve.states[y], **({"lw": 0.8} if curve.connected else DOTTED))
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
    """Return a coordinate and its momentum that differ from state to state, or what else does.

    Changes are compared with how far the system moves meanwhile, which is in the same units.
    """
    q, p, v = (np.asarray(getattr(crossings, x), dtype=np.float64) for x in ("q", "p", "v"))
    if len(q) < 2:
        return crossings.program.coordinates[:1]
    speed, duration = np.abs(v).max(axis=0), np.ptp(np.asarray(crossings.t, dtype=np.float64))
    size = np.maximum(np.abs(q).max(axis=0), speed * duration)
    free = np.ptp(q, axis=0) > SAME * size
    moving = np.ptp(p, axis=0) * speed > SAME**2 * np.abs(p * v).sum(axis=1).max()
    names = crossings.program.coordinates
    for name, *differ in zip(names, free, moving, strict=True):
        if all(differ):
            return name, f"p_{name}"
    left = [name for name, differs in zip(names, free, strict=True) if differs]
    left += [f"p_{name}" for name, differs in zip(names, moving, strict=True) if differs]
    return tuple(left[:2] or names[:1])


def plot_energy(run: Any, *, shadow: bool = False, ax: Any = None) -> Any:
    """Draw the error of the energy over time; where forces do work, the energy less that work."""
    ax = axes(ax, (7, 3))
    constant, unit = run.program.header.conservative, run.program.units.get("energy")
    change = run.energy_error if constant else run.energy_balance
    shown = "H - H0" if constant else "H - H0 - work"
    if not constant and unit is None:
        change = change / run.energy_scale
    draw_over_time(ax, run.t, change, True, lw=0.8, label="energy" if shadow else None)
    if shadow:
        kept = (run.shadow_energy - run.shadow_energy[0]) / run.energy_scale
        draw_over_time(ax, run.t, kept, True, lw=0.8, label="shadow energy")
        legend(ax)
    if not constant and unit is not None:
        pass
    elif run.energy_scale == abs(run.E0):
        shown, unit = f"({shown}) / |H0|", None
    elif run.kinetic_energy.any():
        shown, unit = f"({shown}) / kinetic energy", None
    name_axis(ax, "x", "t", run.program.units.get("t"))
    name_axis(ax, "y", shown, unit)
    what = "energy error" if constant else "energy balance"
    name = f"{run.program.system}, {run.program.scheme}, h = {float(run.h):g}"
    ax.set_title(f"{what}: {name}")
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
