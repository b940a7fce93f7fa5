"""Figures of runs: quantities, energy errors, convergence and run times."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import ConvergenceError, InputError, reject
from symsimpson.plotting.axes import (
    add_legend,
    choose_colours,
    escape_label,
    get_axes,
    line_style,
    name_axes,
    name_axis,
)
from symsimpson.support.array_types import Floats
from symsimpson.support.names import as_tuple, counted, shortened, spelled

#: Chords are subdivided if their error exceeds the fraction FINE of the range of a quantity. They
#: are not drawn if it exceeds ROUGH.
FINE, ROUGH = 0.002, 0.02
#: Position in an interval, from 0 to 1, where its chord is checked; and the number of intervals
#: that are checked.
CHECK_POINT, CHECKED_INTERVALS = 0.381966, 200
#: Largest number of steps for intermediate states, times the number of coordinates. A step in
#: multiprecision counts as DIGITS steps.
STEPS, DIGITS = 100_000, 1000
#: Ranges below the fraction ROUNDING of the values are round-off errors. Ranges below the fraction
#: NOISE of other quantities are noise.
ROUNDING, NOISE = 1e-6, 1e-12

Quantities = Callable[[Any], list[Any]]


class Curve(NamedTuple):
    """States along a curve, the stored states and events among them, and a flag for lines."""

    states: Any
    knots: Any
    connected: bool


def refine_curve(motion: Any, read: Quantities, connected: bool = True) -> Curve:
    """Add intermediate states until straight lines approximate the quantities of ``read``.

    Runs repeat steps to compute intermediate states. The curve is not connected if this needs too
    many steps, or if ``motion`` has only stored states, and lines have a large error.
    """
    if not connected or not hasattr(motion, "q"):  # quantities from a file
        return Curve(motion, motion, connected)
    knots = curve = _insert_events(motion)
    t, parts = _read_times(knots), 1
    while (error := _measure_chord_error(curve, read, motion)) > FINE:
        parts *= 2
        inner = t[:-1, None] + np.diff(t)[:, None] * np.arange(1, parts) / parts
        more = _interpolate_states(motion, inner[np.diff(t) != 0].ravel())
        if more is None:
            break
        curve = _merge_states(knots, more.t, more.q, more.p)
    joined = error <= ROUGH and len(t) > 1
    return Curve(curve if joined else knots, knots, joined)


def _measure_chord_error(curve: Any, read: Quantities, motion: Any) -> float:
    """Return the largest error of chords between states, relative to the range of a quantity."""
    t = _read_times(curve)
    first = np.flatnonzero(np.diff(t))
    if not first.size:
        return 0.0
    uneven = np.linspace(0, 1, CHECKED_INTERVALS) ** 1.1  # avoids aliasing with periodic motions
    first = first[np.unique((uneven * (first.size - 1)).astype(np.int64))]
    a, b, span = curve[first], curve[first + 1], t[first + 1] - t[first]
    times = t[first] + CHECK_POINT * span
    inner = _interpolate_states(motion, times)
    if inner is None:  # cubic Hermite interpolation
        rise, span = b.q - a.q, span[:, None]
        bend = (1 - CHECK_POINT) * (span * a.v - rise) - CHECK_POINT * (span * b.v - rise)
        q = a.q + CHECK_POINT * rise + CHECK_POINT * (1 - CHECK_POINT) * bend
        inner = a.with_states(times, q, a.p + CHECK_POINT * (b.p - a.p))
    misses, sizes = [], []
    for columns in zip(*map(read, (curve, a, b, inner)), strict=True):
        y, u, v, w = (np.nan_to_num(np.asarray(x, float), posinf=0, neginf=0) for x in columns)
        misses.append(np.abs(u + CHECK_POINT * (v - u) - w).max(initial=0.0))
        y = np.concatenate([y, w])
        rounding = ROUNDING * np.abs(y).max(initial=0.0)
        sizes.append(np.ptp(y, axis=0).max(initial=rounding))
    ranges = np.maximum(sizes, NOISE * max(sizes, default=0.0))
    return float((misses / np.where(ranges > 0, ranges, 1.0)).max(initial=0.0))


def _interpolate_states(motion: Any, t: Floats) -> Any:
    """Return states of a run at times; None if that is impossible or needs too many steps."""
    costly = motion.program.n * (DIGITS if hasattr(motion.program.numbers, "digits") else 1)
    try:
        dense = getattr(motion, "sol", None)
        if dense is not None and dense.cost(t) * costly <= STEPS:
            return motion.at(t)
    except (InputError, ConvergenceError):
        pass
    return None


def _insert_events(motion: Any) -> Any:
    """Return states together with the states before and after each event."""
    t, records = _read_times(motion), getattr(motion, "records", ())
    records = [x for x in records if t.min(initial=np.inf) <= x.t <= t.max(initial=-np.inf)]
    if not records:
        return motion
    q = np.array([q for x in records for q in (x.q, x.q_after)])
    p = np.array([p for x in records for p in (x.p, x.p_after)])
    return _merge_states(motion, np.repeat([float(x.t) for x in records], 2), q, p)


def _merge_states(motion: Any, *more: Any) -> Any:
    """Insert states ``more`` = t, q, p; they replace states at the same times."""
    t, new = _read_times(motion), np.asarray(more[0], dtype=np.float64)
    others = ~np.isin(t, new)
    order = np.argsort(
        np.concatenate([t[others], new]) * (1 if t[-1] >= t[0] else -1), kind="stable"
    )
    pairs = zip((t, motion.q, motion.p), (new, *more[1:]), strict=True)
    return motion.with_states(*(np.concatenate([x[others], y])[order] for x, y in pairs))


def _read_times(motion: Any) -> Floats:
    return np.asarray(motion.t, dtype=np.float64)


#: Quantities whose largest values differ by more than this factor get separate panels.
PANEL_RATIO = 30
#: A section fixes a coordinate that changes by less than this fraction of the motion.
FIXED_FRACTION = 1e-9
#: Quantiles of an ensemble that bands show.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def read_names(given: Any, default: Sequence[Any]) -> list[Any]:
    """Return a list of quantities to draw from one name or several; the default for None.

    Raises InputError if the user passes numbers, as matplotlib expects.
    """
    if given is None:
        return list(default)
    wanted = list(as_tuple(given))
    if not all(isinstance(x, str) or hasattr(x, "free_symbols") for x in wanted):
        reject(
            f"{shortened(given)} is not the name of a quantity.",
            remedy="Pass names or symbols: plot(['q1', 'energy']). To draw arrays, use matplotlib: "
            "plt.plot(run.t, run['q1']).",
        )
    return wanted or list(default)


def plot(motion: Any, names: Any = None, *, connected: bool = True, ax: Any = None) -> Any:
    """Draw quantities over time; the default is all coordinates."""
    wanted = [spelled(name) for name in read_names(names, motion.program.coordinates)]
    program, units = motion.program, motion.program.units
    # the energy error oscillates within a step: draw stored states only
    moving = [name for name in wanted if name not in ("energy", *program.invariants)]
    curve = refine_curve(motion, lambda states: [states[name] for name in moving], connected)
    drawn = {name: curve.states if name in moving else curve.knots for name in wanted}
    values = {name: states[name] for name, states in drawn.items()}
    groups = [list(values)] if ax is not None else group_panels(values, units, program.coordinates)
    size = (7, 3.5 if len(groups) == 1 else 1.2 + 1.6 * len(groups))
    shared = {"nrows": len(groups), "sharex": True} if ax is None else {}
    panels, hues = np.ravel(get_axes(ax, size, **shared)), iter(choose_colours(len(values)))
    for panel, group in zip(panels, groups, strict=True):
        for name in group:
            t, count = drawn[name].t, math.prod(np.shape(values[name])[1:])
            joined = connected and (curve.connected or name not in moving)
            columns = np.reshape(values[name], (len(t), count))
            how = line_style(joined, len(t), 1.2)
            panel.plot(t, columns, label=escape_label(name), color=next(hues), **how)
        name_axes(panel, program, "", group[0] if len(group) == 1 else "")
        if len(group) > 1:
            unit = {units.get(name) for name in group}
            name_axis(panel, "y", "", unit.pop() if len(unit) == 1 else None)
            add_legend(panel)
    for panel in panels[1:]:
        panel.set_title("")
    name_axis(panels[-1], "x", "t", units.get("t"))
    return panels[0]


def group_panels(
    values: Mapping[str, Any], units: Mapping[str, str], coordinates: Sequence[str]
) -> list[list[str]]:
    """Return the names of quantities in each panel, from top to bottom.

    Quantities of different units have separate panels, and so have small and large numbers.
    Coordinates that are 0 up to round-off errors share a panel with others.
    """
    finite = {k: np.nan_to_num(np.asarray(x, float), posinf=0, neginf=0) for k, x in values.items()}
    sizes = {name: np.abs(x).max(initial=0.0) for name, x in finite.items()}
    panels: list[list[str]] = []
    for name in sorted(sizes, key=sizes.__getitem__, reverse=True):
        for panel in panels:
            ratio = sizes[name] / (sizes[panel[0]] or 1.0)
            least = NOISE if {name, panel[0]} <= {*coordinates} else 0
            if units.get(panel[0]) == units.get(name) and not least < ratio < 1 / PANEL_RATIO:
                panel.append(name)
                break
        else:
            panels.append([name])
    order = list(values).index
    return sorted((sorted(panel, key=order) for panel in panels), key=lambda x: order(x[0]))


def plot_members(many: Any, name: Any, most: int | None = None, *, ax: Any = None) -> Any:
    """Draw the distribution of a quantity over all members, or lines of ``most`` members."""
    (name,) = read_names(None if name is None else [name], many.program.coordinates[:1])
    values, program = np.asarray(many[name], dtype=np.float64), many.program
    ax, count = get_axes(ax, (7, 3.5)), len(many)
    if values.ndim == 1:
        last = values[np.isfinite(values)]
        count = len(last)
        ax.hist(last, bins=min(60, max(5, int(len(last) ** 0.5))))
        name_axes(ax, program, "", "members")
        name_axis(ax, "x", f"{spelled(name)} at the end", program.units.get(spelled(name)))
    else:
        if most is None and np.ndim(many.t) == 1:
            draw_bands(ax, many.t, values)
        else:  # members may have different times
            count = min(count, most or 100)
            selected = np.linspace(0, len(many) - 1, count).astype(np.int64)
            curve = refine_curve(many[int(selected[0])], lambda states: [states[name]])
            how = line_style(curve.connected, len(curve.knots), 0.8)
            how["alpha"] = max(0.15, min(1.0, 8 / count))
            ax.plot(np.broadcast_to(many.t, values.shape)[selected].T, values[selected].T, **how)
        name_axes(ax, program, "t", name)
    ax.set_title(f"{ax.get_title()}: {count} of {counted(len(many), 'member')}")
    return ax


def draw_bands(ax: Any, t: Any, values: Any) -> None:
    """Draw the median of all members over time, and bands that contain 50 % and 90 % of them."""
    selected = np.isfinite(values).any(axis=0)  # until the last member failed
    values, t = np.where(np.isfinite(values), values, np.nan)[:, selected], t[selected]
    # quantile is three times as fast
    quantile = np.nanquantile if np.isnan(values).any() else np.quantile
    lowest, low, median, high, highest = quantile(values, QUANTILES, axis=0)
    ax.fill_between(t, lowest, highest, color="C0", alpha=0.2, lw=0, label="5 to 95 %")
    ax.fill_between(t, low, high, color="C0", alpha=0.35, lw=0, label="25 to 75 %")
    ax.plot(t, median, color="C0", lw=1.2, label="median", marker="." if len(t) <= 50 else "")
    add_legend(ax)


def plot_phase(
    motion: Any, x: Any = None, y: Any = None, *, connected: bool = True, ax: Any = None
) -> Any:
    """Draw one quantity over another; the default is the first momentum over its coordinate."""
    (x,) = read_names(None if x is None else [x], motion.program.coordinates[:1])
    (y,) = read_names(None if y is None else [y], [f"p_{spelled(x)}"])
    curve = refine_curve(motion, lambda states: [states[x], states[y]], connected)
    values = curve.states[x], curve.states[y]
    ax = get_axes(ax, (4.5, 4.5))
    ax.locator_params(axis="x", nbins=6)
    ax.plot(*values, **line_style(curve.connected, len(motion), 0.8))
    return name_axes(ax, motion.program, x, y)


def plot_section(crossings: Any, names: Any = None, *, ax: Any = None) -> Any:
    """Draw the points of a section; the default is a free coordinate and its momentum."""
    wanted = read_names(names, find_free_names(crossings))
    if len(wanted) == 2:
        return plot_phase(crossings, *wanted, connected=False, ax=ax)
    return plot(crossings, wanted, connected=False, ax=ax)


def find_free_names(crossings: Any) -> tuple[str, ...]:
    """Return the first coordinate that a section does not fix, and its momentum.

    The change of a coordinate is compared with its displacement over the run.
    """
    t, q, v = (np.asarray(getattr(crossings, x), dtype=np.float64) for x in "tqv")
    names = crossings.program.coordinates
    if len(t) > 1:
        size = np.maximum(np.abs(q).max(axis=0), np.abs(v).max(axis=0) * np.ptp(t))
        free = np.flatnonzero(np.ptp(q, axis=0) > FIXED_FRACTION * size)
        if free.size:
            return names[free[0]], f"p_{names[free[0]]}"
    return (f"p_{names[0]}",)


def plot_energy(run: Any, *, shadow: bool = False, ax: Any = None) -> Any:
    """Draw the energy error over time; the work of forces is subtracted."""
    ax = get_axes(ax, (7, 3))
    constant, unit = run.has_constant_energy, run.program.units.get("energy")
    absolute = not constant and unit is not None
    scale = 1.0 if constant or absolute else run.energy_scale
    change = run.energy_error if constant else run.energy_balance / scale
    ax.plot(run.t, change, lw=0.8, label="energy" if shadow else None)
    if shadow:
        shadow_error = (run.shadow_energy - run.shadow_energy[0]) / run.energy_scale
        ax.plot(run.t, shadow_error, lw=0.8, label="shadow energy")
        add_legend(ax)
    quantity, relative = "H - H0" if constant else "H - H0 - work", ""
    canonical = run.program.header.canonical
    if not absolute and (canonical or run.E0 or run.kinetic_energy.any()):
        other = "size of p v/2" if canonical else "kinetic energy"
        relative = "|H0|" if run.energy_scale == abs(run.E0) else other
    name_axes(ax, run.program, "t", "")
    name_axis(
        ax, "y", f"({quantity}) / {relative}" if relative else quantity, None if relative else unit
    )
    what = "energy error" if constant else "energy balance"
    ax.set_title(f"{what}: {ax.get_title()}, h = {float(run.h):g}")
    return ax


def plot_exponents(chaos: Any, *, ax: Any = None) -> Any:
    """Draw Lyapunov exponents over the averaging time."""
    ax, program, count = get_axes(ax, (7, 3)), chaos.trajectory.program, chaos.history.shape[1]
    ax.set_prop_cycle(color=choose_colours(count))
    names = [f"exponent {k + 1}" for k in range(count)]
    ax.plot(chaos.t, chaos.history, lw=0.8, label=names)
    add_legend(ax)
    name_axes(ax, program, "t", "")
    unit = program.units.get("t")
    name_axis(ax, "y", "exponent", f"1/{unit}" if unit else "1 / time")
    return ax


def plot_convergence(
    steps: ArrayLike,
    errors: Mapping[str, ArrayLike],
    *,
    orders: Mapping[str, int] | None = None,
    ax: Any = None,
) -> Any:
    """Draw errors against the step size in logarithmic axes.

    Parameters
    ----------
    steps : array_like, shape (k,)
        The step sizes, from large to small.
    errors : mapping from label to array_like, shape (k,)
        The errors of each line.
    orders : mapping from label to int, optional
        The orders of lines that get a slope triangle. The default is none.
    ax : matplotlib.axes.Axes, optional
        The axes to draw in. The default is a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, with logarithmic scales.
    """
    ax = get_axes(ax, (6, 4))
    h = np.asarray(steps, dtype=np.float64)
    for marker, (name, values) in zip("osD^vP*X" * len(errors), errors.items(), strict=False):
        line = np.asarray(values, dtype=np.float64)
        (artist,) = ax.loglog(h, line, marker + "-", ms=4, lw=1.2, label=name)
        if orders and name in orders:
            end = min(2, h.size - 1)
            corner = (float(h[-1]), float(line[-1]))
            slope_triangle(ax, corner, orders[name], float(h[-1 - end]), color=artist.get_color())
    every = max(1, (h.size + 3) // 4)
    ax.set_xticks(h[::every], [f"{step:.3g}" for step in h[::every]])
    ax.minorticks_off()
    ax.set_xlabel("step h")
    ax.legend()
    return ax


def slope_triangle(
    ax: Any, corner: tuple[float, float], order: int, to: float, *, color: str = "0.4"
) -> None:
    """Draw a triangle of slope ``order`` below a line in logarithmic axes.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        The axes to draw in, with logarithmic scales.
    corner : (float, float)
        The step size and the error of the line at its smallest step.
    order : int
        The slope of the triangle.
    to : float
        The step size at the other end of the triangle.
    color : str
        A colour of matplotlib. The default is grey, ``"0.4"``.
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
    """Draw the median run time against the error in logarithmic axes.

    Each line has the measurements of one contender that are optimal: no other one has both a
    smaller error and a shorter run time.

    Parameters
    ----------
    record : WorkPrecision
        The record of ``symsimpson.work_precision``.
    ax : matplotlib.axes.Axes, optional
        The axes to draw in. The default is a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, with logarithmic scales.
    """
    ax = get_axes(ax, (8.5, 5))
    colours = choose_colours(len(record.names))
    for k, (name, colour) in enumerate(zip(record.names, colours, strict=True)):
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
    add_legend(ax)
    return ax
