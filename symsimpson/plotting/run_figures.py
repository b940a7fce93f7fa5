"""Figures of runs: their quantities, their errors, what they cost."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import ConvergenceError, InputError, reject
from symsimpson.plotting.axes import axes, colours, label, legend, name_axes, name_axis, style
from symsimpson.support.array_types import Floats
from symsimpson.support.names import counted, in_a_row, shortened, spelled

#: Chords that miss the motion by more than FINE of the range are divided, and by more than ROUGH
#: are not drawn.
FINE, ROUGH = 0.002, 0.02
#: The part of an interval at which its chord is checked, and how many intervals are.
PART, CHECKED = 0.381966, 200
#: States between take at most so many steps, divided by the number of coordinates; steps of
#: numbers with many digits count as many.
STEPS, DIGITS = 100_000, 1000
#: Ranges below this part of the values are rounding; below this part of others, noise.
ROUNDING, NOISE = 1e-6, 1e-12

Read = Callable[[Any], list[Any]]


class Curve(NamedTuple):
    """States along a curve, those that are stored or of events, and whether lines join them."""

    states: Any
    knots: Any
    connected: bool


def curve_of(some: Any, read: Read, connected: bool = True) -> Curve:
    """Return states such that straight lines between them follow what ``read`` gives of states.

    Runs take steps again for states between theirs. If that takes too many steps, or only states
    are known, and lines would mislead, the curve is not connected.
    """
    if not connected or not hasattr(some, "q"):  # saved quantities
        return Curve(some, some, connected)
    knots = curve = _with_events(some)
    t, parts = _times(knots), 1
    while (miss := _chords_miss(curve, read, some)) > FINE:
        parts *= 2
        inner = t[:-1, None] + np.diff(t)[:, None] * np.arange(1, parts) / parts
        more = _between(some, inner[np.diff(t) != 0].ravel())
        if more is None:
            break
        curve = _merged(knots, more.t, more.q, more.p)
    joined = miss <= ROUGH and len(t) > 1
    return Curve(curve if joined else knots, knots, joined)


def _chords_miss(curve: Any, read: Read, some: Any) -> float:
    """Return how far chords between states miss the motion of a run, as a part of its range."""
    t = _times(curve)
    first = np.flatnonzero(np.diff(t))
    if not first.size:
        return 0.0
    uneven = np.linspace(0, 1, CHECKED) ** 1.1  # no period hides between these intervals
    first = first[np.unique((uneven * (first.size - 1)).astype(np.int64))]
    a, b, span = curve[first], curve[first + 1], t[first + 1] - t[first]
    there = t[first] + PART * span
    inner = _between(some, there)
    if inner is None:  # Hermite's polynomial
        rise, span = b.q - a.q, span[:, None]
        bend = (1 - PART) * (span * a.v - rise) - PART * (span * b.v - rise)
        q = a.q + PART * rise + PART * (1 - PART) * bend
        inner = a.with_states(there, q, a.p + PART * (b.p - a.p))
    misses, sizes = [], []
    for columns in zip(*map(read, (curve, a, b, inner)), strict=True):
        y, u, v, w = (np.nan_to_num(np.asarray(x, float), posinf=0, neginf=0) for x in columns)
        misses.append(np.abs(u + PART * (v - u) - w).max(initial=0.0))
        y = np.concatenate([y, w])
        rounding = ROUNDING * np.abs(y).max(initial=0.0)
        sizes.append(np.ptp(y, axis=0).max(initial=rounding))
    ranges = np.maximum(sizes, NOISE * max(sizes, default=0.0))
    return float((misses / np.where(ranges > 0, ranges, 1.0)).max(initial=0.0))


def _between(some: Any, t: Floats) -> Any:
    """Return states of a run at times; None if it has none, or they take too many steps."""
    costly = some.program.n * (DIGITS if hasattr(some.program.numbers, "digits") else 1)
    try:
        dense = getattr(some, "sol", None)
        if dense is not None and dense.cost(t) * costly <= STEPS:
            return some.at(t)
    except (InputError, ConvergenceError):
        pass
    return None


def _with_events(some: Any) -> Any:
    """Return states and, between them, those before and after each event."""
    t, records = _times(some), getattr(some, "records", ())
    records = [x for x in records if t.min(initial=np.inf) <= x.t <= t.max(initial=-np.inf)]
    if not records:
        return some
    q = np.array([q for x in records for q in (x.q, x.q_after)])
    p = np.array([p for x in records for p in (x.p, x.p_after)])
    return _merged(some, np.repeat([float(x.t) for x in records], 2), q, p)


def _merged(some: Any, *more: Any) -> Any:
    """Return states with more of them, t, q and p, which replace those at the same times."""
    t, new = _times(some), np.asarray(more[0], dtype=np.float64)
    rest = ~np.isin(t, new)
    order = np.argsort(np.concatenate([t[rest], new]) * (1 if t[-1] >= t[0] else -1), kind="stable")
    pairs = zip((t, some.q, some.p), (new, *more[1:]), strict=True)
    return some.with_states(*(np.concatenate([x[rest], y])[order] for x, y in pairs))


def _times(some: Any) -> Floats:
    return np.asarray(some.t, dtype=np.float64)


#: Quantities whose largest values differ by more than this factor have panels of their own.
APART = 30
#: A section fixes a coordinate whose changes are below this part of how far the system moves.
FIXED = 1e-9
#: What bands show of an ensemble.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def read_names(given: Any, default: Sequence[Any]) -> list[Any]:
    """Read which quantities to draw: one, or several in a row; all of a default for None.

    Raises InputError if numbers are given, as to matplotlib.
    """
    if given is None:
        return list(default)
    wanted = list(in_a_row(given))
    if not all(isinstance(x, str) or hasattr(x, "free_symbols") for x in wanted):
        reject(
            f"{shortened(given)} is given to be drawn, which is no name of a quantity.",
            remedy="Pass names "
            "or symbols, as plot('q1', 'energy'); matplotlib draws arrays: plt.plot(run.t, "
            "run['q1']).",
        )
    return wanted or list(default)


def plot(some: Any, names: Any = None, *, connected: bool = True, ax: Any = None) -> Any:
    """Draw quantities over time: all coordinates, unless some are named."""
    wanted = [spelled(name) for name in read_names(names, some.program.coordinates)]
    program, units = some.program, some.program.units
    # the energy at a state between others says little of that at these
    moving = [name for name in wanted if name not in ("energy", *program.invariants)]
    curve = curve_of(some, lambda states: [states[name] for name in moving], connected)
    drawn = {name: curve.states if name in moving else curve.knots for name in wanted}
    values = {name: states[name] for name, states in drawn.items()}
    groups = [list(values)] if ax is not None else panels_of(values, units, program.coordinates)
    size = (7, 3.5 if len(groups) == 1 else 1.2 + 1.6 * len(groups))
    shared = {"nrows": len(groups), "sharex": True} if ax is None else {}
    panels, hues = np.ravel(axes(ax, size, **shared)), iter(colours(len(values)))
    for panel, group in zip(panels, groups, strict=True):
        for name in group:
            t, count = drawn[name].t, math.prod(np.shape(values[name])[1:])
            joined = connected and (curve.connected or name not in moving)
            columns = np.reshape(values[name], (len(t), count))
            how = style(joined, len(t), 1.2) | {"label": label(name), "color": next(hues)}
            panel.plot(t, columns, **how)
        name_axes(panel, program, "", group[0] if len(group) == 1 else "")
        if len(group) > 1:
            unit = {units.get(name) for name in group}
            name_axis(panel, "y", "", unit.pop() if len(unit) == 1 else None)
            legend(panel)
    for panel in panels[1:]:
        panel.set_title("")
    name_axis(panels[-1], "x", "t", units.get("t"))
    return panels[0]


def panels_of(
    values: Mapping[str, Any], units: Mapping[str, str], coordinates: Sequence[str]
) -> list[list[str]]:
    """Return names for panels, one above the other.

    Lengths and angles have separate panels, as have small and large numbers. Coordinates that are
    0 up to round-off share a panel with others.
    """
    finite = {k: np.nan_to_num(np.asarray(x, float), posinf=0, neginf=0) for k, x in values.items()}
    sizes = {name: np.abs(x).max(initial=0.0) for name, x in finite.items()}
    panels: list[list[str]] = []
    for name in sorted(sizes, key=sizes.__getitem__, reverse=True):
        for panel in panels:
            ratio = sizes[name] / (sizes[panel[0]] or 1.0)
            least = NOISE if {name, panel[0]} <= {*coordinates} else 0
            if units.get(panel[0]) == units.get(name) and not least < ratio < 1 / APART:
                panel.append(name)
                break
        else:
            panels.append([name])
    order = list(values).index
    return sorted((sorted(panel, key=order) for panel in panels), key=lambda x: order(x[0]))


def plot_members(many: Any, name: Any, most: int | None = None, *, ax: Any = None) -> Any:
    """Draw how a quantity of all members is spread, over time or at the end, or lines of some."""
    (name,) = read_names(None if name is None else [name], many.program.coordinates[:1])
    values, program = np.asarray(many[name], dtype=np.float64), many.program
    ax, shown = axes(ax, (7, 3.5)), len(many)
    if values.ndim == 1:
        last = values[np.isfinite(values)]
        shown = len(last)
        ax.hist(last, bins=min(60, max(5, int(len(last) ** 0.5))))
        name_axes(ax, program, "", "members")
        name_axis(ax, "x", f"{spelled(name)} at the end", program.units.get(spelled(name)))
    else:
        if most is None and np.ndim(many.t) == 1:
            draw_bands(ax, many.t, values)
        else:  # each may have times of its own
            shown = min(shown, most or 100)
            some = np.linspace(0, len(many) - 1, shown).astype(np.int64)
            curve = curve_of(many[int(some[0])], lambda states: [states[name]])
            how = style(curve.connected, len(curve.knots), 0.8)
            how["alpha"] = max(0.15, min(1.0, 8 / shown))
            ax.plot(np.broadcast_to(many.t, values.shape)[some].T, values[some].T, **how)
        name_axes(ax, program, "t", name)
    ax.set_title(f"{ax.get_title()}: {shown} of {counted(len(many), 'member')}")
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
    curve = curve_of(some, lambda states: [states[x], states[y]], connected)
    drawn = curve.states[x], curve.states[y]
    ax = axes(ax, (4.5, 4.5))
    ax.locator_params(axis="x", nbins=6)
    ax.plot(*drawn, **style(curve.connected, len(some), 0.8))
    return name_axes(ax, some.program, x, y)


def plot_section(crossings: Any, names: Any = None, *, ax: Any = None) -> Any:
    """Draw states of a section: two quantities that are named, or that it does not fix."""
    wanted = read_names(names, free_names(crossings))
    if len(wanted) == 2:
        return plot_phase(crossings, *wanted, connected=False, ax=ax)
    return plot(crossings, wanted, connected=False, ax=ax)


def free_names(crossings: Any) -> tuple[str, ...]:
    """Return the first coordinate that a section does not fix, and its momentum.

    Changes are compared with how far the system moves meanwhile, which has the same unit.
    """
    t, q, v = (np.asarray(getattr(crossings, x), dtype=np.float64) for x in "tqv")
    names = crossings.program.coordinates
    if len(t) > 1:
        size = np.maximum(np.abs(q).max(axis=0), np.abs(v).max(axis=0) * np.ptp(t))
        free = np.flatnonzero(np.ptp(q, axis=0) > FIXED * size)
        if free.size:
            return names[free[0]], f"p_{names[free[0]]}"
    return (f"p_{names[0]}",)


def plot_energy(run: Any, *, shadow: bool = False, ax: Any = None) -> Any:
    """Draw the error of the energy over time; where forces do work, the energy less that work."""
    ax = axes(ax, (7, 3))
    constant, unit = run.program.header.conservative, run.program.units.get("energy")
    absolute = not constant and unit is not None
    scale = 1.0 if constant or absolute else run.energy_scale
    change = run.energy_error if constant else run.energy_balance / scale
    ax.plot(run.t, change, lw=0.8, label="energy" if shadow else None)
    if shadow:
        kept = (run.shadow_energy - run.shadow_energy[0]) / run.energy_scale
        ax.plot(run.t, kept, lw=0.8, label="shadow energy")
        legend(ax)
    shown, relative = "H - H0" if constant else "H - H0 - work", ""
    if not absolute and (run.E0 or run.kinetic_energy.any()):
        relative = "|H0|" if run.energy_scale == abs(run.E0) else "kinetic energy"
    name_axes(ax, run.program, "t", "")
    name_axis(ax, "y", f"({shown}) / {relative}" if relative else shown, None if relative else unit)
    what = "energy error" if constant else "energy balance"
    ax.set_title(f"{what}: {ax.get_title()}, h = {float(run.h):g}")
    return ax


def plot_exponents(chaos: Any, *, ax: Any = None) -> Any:
    """Draw Lyapunov exponents over the time that they were averaged over."""
    ax, program, count = axes(ax, (7, 3)), chaos.trajectory.program, chaos.history.shape[1]
    ax.set_prop_cycle(color=colours(count))
    names = [f"exponent {k + 1}" for k in range(count)]
    ax.plot(chaos.t, chaos.history, lw=0.8, label=names)
    legend(ax)
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
    for marker, (name, values) in zip("osD^vP*X" * len(errors), errors.items(), strict=False):
        line = np.asarray(values, dtype=np.float64)
        (drawn,) = ax.loglog(h, line, marker + "-", ms=4, lw=1.2, label=name)
        if orders and name in orders:
            end = min(2, h.size - 1)
            corner = (float(h[-1]), float(line[-1]))
            slope_triangle(ax, corner, orders[name], float(h[-1 - end]), color=drawn.get_color())
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
