"""Figures of one run, or of many."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.names import spelled
from symsimpson.plotting.axes import axes

if TYPE_CHECKING:
    from symsimpson.runtime.ensembles.ensemble import Ensemble
    from symsimpson.runtime.results.chaos import Chaos
    from symsimpson.runtime.results.energies import Energies
    from symsimpson.runtime.results.states import States

__all__ = ["plot", "plot_energy", "plot_exponents", "plot_members", "plot_phase"]

#: The dots of states that no line connects.
DOTS = {"ls": "none", "marker": ".", "ms": 2.5}


def label(name: Any) -> str:
    """Return a name as matplotlib writes it as it is.

    It would read what is between dollars as a formula, and hide what begins with a line.
    """
    text = spelled(name).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def plot(
    some: States,
    names: Any = None,
    *,
    connected: bool = True,
    ax: Any = None,
) -> Any:
    """Draw quantities over time: all coordinates, unless some are named."""
    single = isinstance(names, str) or hasattr(names, "free_symbols")
    wanted = [names] if single else list(names or some._stepper.coordinates)
    found = {label(name): some[name] for name in wanted}
    ax = axes(ax, (7, 3.5))
    for name, values in found.items():
        ax.plot(some.t, values, label=name, **({"lw": 1.2} if connected else DOTS))
    ax.set(xlabel="t", title=f"{some._stepper.system}, {some._stepper.scheme}")
    ax.grid(lw=0.4, alpha=0.6)
    if len(wanted) == 1:
        ax.set_ylabel(*found)
    else:
        ax.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    return ax


def plot_members(many: Ensemble, name: Any, most: int, *, ax: Any = None) -> Any:
    """Draw a quantity of members over time, or how its last values are spread."""
    from symsimpson.runtime.ensembles.ensemble import spread  # which draws by this module

    values, some = many[name], spread(len(many), max(1, most))
    ax = axes(ax, (7, 3.5))
    if values.ndim == 2:
        times = np.broadcast_to(many.t, values.shape)
        ax.plot(times[some].T, values[some].T, lw=0.8, alpha=max(0.15, min(1.0, 8 / len(some))))
        ax.set(xlabel="t", ylabel=label(name))
    else:
        last = values[np.isfinite(values)]
        ax.hist(last, bins=min(60, max(5, int(len(last) ** 0.5))))
        ax.set(xlabel=f"{label(name)} at the end", ylabel="members")
    stepper = many._stepper
    ax.set_title(f"{stepper.system}, {stepper.scheme}: {len(some)} of {len(many)} members")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def plot_phase(
    some: States, x: Any = None, y: Any = None, *, connected: bool = True,
    ax: Any = None,
) -> Any:  # fmt: skip
    """Draw one quantity over another: a momentum over its coordinate, unless others are named."""
    x = some._stepper.coordinates[0] if x is None else x
    y = f"p_{spelled(x)}" if y is None else y
    found = some[x], some[y]
    ax = axes(ax, (4.5, 4.5))
    ax.plot(*found, **({"lw": 0.8} if connected else DOTS))
    title = f"{some._stepper.system}, {some._stepper.scheme}"
    ax.set(xlabel=label(x), ylabel=label(y), title=title)
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def plot_energy(run: Energies, *, shadow: bool = False, ax: Any = None) -> Any:
    """Draw the error of the energy over time; where forces do work, the energy less that work."""
    ax = axes(ax, (7, 3))
    constant = run._stepper._module.header.conservative
    change = run.energy_error if constant else run.energy_balance
    ax.plot(run.t, change, lw=0.8, label="energy" if shadow else None)
    if shadow:
        kept = run.shadow_energy
        ax.plot(run.t, (kept - kept[0]) / run.energy_scale, lw=0.8, label="shadow energy")
        ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    name = f"{run._stepper.system}, {run._stepper.scheme}, h = {float(run.h):g}"
    label = "(H - H0) / |H0|" if run.energy[0] != 0 else "H - H0"
    if not constant:
        label = "H - H0 - work"
    what = "energy error" if constant else "energy balance"
    ax.set(xlabel="t", ylabel=label, title=f"{what}: {name}")
    ax.grid(lw=0.4, alpha=0.6)
    return ax


def plot_exponents(chaos: Chaos, *, ax: Any = None) -> Any:
    """Draw Lyapunov exponents over the time that they were averaged over."""
    ax = axes(ax, (7, 3))
    for k, history in enumerate(chaos.history.T):
        ax.plot(chaos.t, history, lw=0.8, label=f"exponent {k + 1}")
    stepper = chaos.trajectory._stepper
    ax.set(xlabel="t", ylabel="exponent, 1 / time", title=f"{stepper.system}, {stepper.scheme}")
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    ax.grid(lw=0.4, alpha=0.6)
    return ax
