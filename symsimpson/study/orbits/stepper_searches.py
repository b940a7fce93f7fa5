"""The searches for orbits that a stepper calls."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from symsimpson.study.orbits import bifurcations, continuation, figures, orbit_files
from symsimpson.study.orbits.boundaries import find_path
from symsimpson.study.orbits.boundary_path import Path
from symsimpson.study.orbits.find import OrbitArguments, find_periodic
from symsimpson.study.orbits.orbit import Family, Orbit

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


def periodic(stepper: Any, **given: Any) -> Orbit:
    """Search for a periodic orbit; see :meth:`Stepper.periodic`."""
    return find_periodic(stepper, TOOLS, OrbitArguments(**given))


def boundary(stepper: Any, *given: Any) -> Path:
    """Search for a path between two boundaries; see :meth:`Stepper.boundary`."""
    return find_path(stepper, TOOLS, *given)


def open_family(stepper: Any, path: Any, **given: Any) -> Family:
    """Read a family from a file; see :meth:`Stepper.open_family`."""
    return orbit_files.open_family(stepper, TOOLS, path, given)
