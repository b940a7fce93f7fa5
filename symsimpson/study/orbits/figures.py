"""Figures of orbits and families."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.plotting.axes import get_axes
from symsimpson.study.orbits.orbit import Family, Orbit


def plot_orbit(orbit: Orbit, ax: Any) -> Any:
    """Draw an orbit in the plane of its first two coordinates, or of q and p."""
    ax, names, run = get_axes(ax, (5, 4)), orbit.search.stepper.coordinates, orbit.trajectory
    t = np.linspace(run.t[0], run.t[-1], max(200, len(run)))
    states = run.sol(t) if orbit.search.flow.fixed_steps else run.y
    second = 1 if len(names) > 1 else len(names)
    ax.plot(states[0], states[second])
    ax.set(xlabel=names[0], ylabel=names[1] if len(names) > 1 else f"p_{names[0]}")
    ax.set_title(f"{orbit.search.stepper.system}: period {orbit.period:.6g}")
    return ax


def plot_multipliers(orbits: Sequence[Orbit], ax: Any) -> Any:
    """Draw multipliers and the unit circle in the complex plane."""
    ax, angles = get_axes(ax, (4, 4)), np.linspace(0, 2 * np.pi, 200)
    ax.plot(np.cos(angles), np.sin(angles), "0.6", lw=0.8)
    for orbit in orbits:
        ax.plot(orbit.multipliers.real, orbit.multipliers.imag, "o", ms=4)
    ax.set(xlabel="real part", ylabel="imaginary part", aspect="equal", title="multipliers")
    return ax


def plot_family(family: Family, x: str, y: str, ax: Any) -> Any:
    """Draw a quantity of the orbits against another, with bifurcations as points."""
    ax = get_axes(ax, (6, 4))
    horizontal, vertical = family[x], family[y]
    stable = np.array([orbit.stable for orbit in family])
    for holds, line in ((True, "C0-"), (False, "C0--")):
        here = np.where(stable == holds, 1.0, np.nan)
        joined = np.fmax(here, np.append(here[1:], np.nan)) if holds else here
        name = "stable" if holds else "unstable"
        ax.plot(horizontal * joined, vertical * joined, line, label=name)
    kinds = dict.fromkeys(point.kind for point in family.bifurcations)
    for k, kind in enumerate(kinds, 1):
        points = (point for point in family.bifurcations if point.kind == kind)
        some = replace(family, orbits=tuple(point.orbit for point in points))
        ax.plot(some[x], some[y], f"C{k}o", ms=5, label=kind)
    ax.set(xlabel=x, ylabel=y, title=f"{family.search.stepper.system}: family of periodic orbits")
    ax.legend()
    return ax
