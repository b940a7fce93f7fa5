"""The searches for orbits that a stepper calls."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

from symsimpson.study.orbits import bifurcations, continuation, figures, orbit_files
from symsimpson.study.orbits.find import find_path, find_periodic

#: The functions that results call.
TOOLS = SimpleNamespace(
    follow=continuation.follow,
    extend=continuation.extend,
    bifurcations=bifurcations.find_bifurcations,
    resonances=bifurcations.find_resonances,
    switch=bifurcations.switch,
    save=orbit_files.save_family,
    plot_orbit=figures.plot_orbit,
    plot_multipliers=figures.plot_multipliers,
    plot_family=figures.plot_family,
)


#: The methods of a stepper with these names.
periodic = partial(find_periodic, TOOLS)
boundary = partial(find_path, TOOLS)
open_family = partial(orbit_files.open_family, TOOLS)
