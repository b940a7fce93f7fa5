"""A catalogue of well-known systems; each function returns a system with an initial state."""

from __future__ import annotations

from collections.abc import Callable

from symsimpson.errors import ModelError
from symsimpson.support.calling import explain_arguments
from symsimpson.support.names import did_you_mean
from symsimpson.systems.entry import CatalogueHamiltonian, CatalogueSystem
from symsimpson.systems.geodesics import ellipsoid_geodesic, torus_geodesic
from symsimpson.systems.gravity import (
    figure_eight,
    kepler,
    kepler_plane,
    n_body,
    outer_solar_system,
    pythagorean,
)
from symsimpson.systems.lattices import argon, argon_cluster, cloth, fermi_pasta_ulam, water
from symsimpson.systems.mechanisms import (
    andrews_squeezer,
    cart_pole,
    driven_cart_pole,
    four_bar,
    hanging_chain,
    puma560,
    slider_crank,
)
from symsimpson.systems.oscillators import (
    charged_particle,
    damped_oscillator,
    damped_pendulum,
    duffing,
    dust_grain,
    harmonic_oscillator,
    henon_heiles,
    kapitza,
    van_der_pol,
)
from symsimpson.systems.pendulums import (
    double_pendulum,
    driven_double_pendulum,
    elastic_pendulum,
    n_pendulum,
    pendulum,
    spherical_pendulum,
)
from symsimpson.systems.relativity import (
    kerr_geodesic,
    lotka_volterra,
    point_vortices,
    post_newtonian_binary,
    relativistic_charge,
    restricted_three_bodies,
    schwarzschild_geodesic,
    spin_boson,
)
from symsimpson.systems.rolling import (
    ball_on_turntable,
    chaplygin_sleigh,
    rolling_disc,
    snakeboard,
    whipple_bicycle,
)
from symsimpson.systems.tops import (
    cartesian_pendulum,
    heavy_top,
    jointed_bodies,
    lagrange_top,
    lagrange_top_cusps,
    quaternion_top,
    rigid_body,
    tumbling_body,
)

Catalogue = dict[str, Callable[[], CatalogueSystem | CatalogueHamiltonian]]


#: How to change a parameter, for calls with an unknown argument.
REMEDY = " Pass values of parameters to runs: stepper.integrate(..., parameters={'g': 1.62})."


def _by_name(*makers: Callable[[], CatalogueSystem | CatalogueHamiltonian]) -> Catalogue:
    """Return the functions by name, with errors that explain how to change parameters."""
    return {make.__name__: explain_arguments(ModelError, REMEDY)(make) for make in makers}


#: Models whose generated modules the repository contains.
CATALOGUE = _by_name(
    pendulum,
    double_pendulum,
    n_pendulum,
    spherical_pendulum,
    elastic_pendulum,
    cart_pole,
    lagrange_top,
    lagrange_top_cusps,
    heavy_top,
    rigid_body,
    kepler,
    henon_heiles,
    fermi_pasta_ulam,
    harmonic_oscillator,
    torus_geodesic,
    ellipsoid_geodesic,
)
#: Models with many coordinates or long energies, without generated modules.
MODELS = _by_name(puma560, water, argon, argon_cluster, n_body, outer_solar_system, cloth)
#: Models with forces, a drive or inputs.
FORCED = _by_name(
    damped_pendulum,
    damped_oscillator,
    duffing,
    dust_grain,
    kapitza,
    van_der_pol,
    driven_double_pendulum,
    charged_particle,
    driven_cart_pole,
)
#: Models with constraints.
CONSTRAINED = _by_name(
    cartesian_pendulum,
    quaternion_top,
    tumbling_body,
    four_bar,
    slider_crank,
    jointed_bodies,
    andrews_squeezer,
    hanging_chain,
)
#: Models with velocity constraints.
ROLLING = _by_name(chaplygin_sleigh, rolling_disc, snakeboard, ball_on_turntable, whipple_bicycle)
#: Models with close encounters, which need a time transformation.
MEETING = _by_name(kepler_plane, pythagorean, figure_eight)
#: Models whose L is not quadratic in the velocities, whose M is indefinite, or that have H only.
GENERAL = _by_name(
    schwarzschild_geodesic,
    kerr_geodesic,
    relativistic_charge,
    post_newtonian_binary,
    restricted_three_bodies,
    point_vortices,
    lotka_volterra,
    spin_boson,
)
#: All models.
EVERY: Catalogue = {**CATALOGUE, **MODELS, **FORCED, **CONSTRAINED, **ROLLING, **MEETING, **GENERAL}
globals().update(EVERY)

__all__ = [
    "CATALOGUE",
    "CONSTRAINED",
    "EVERY",
    "FORCED",
    "GENERAL",
    "MEETING",
    "MODELS",
    "ROLLING",
    "CatalogueHamiltonian",
    "CatalogueSystem",
    "andrews_squeezer",
    "argon",
    "argon_cluster",
    "ball_on_turntable",
    "cart_pole",
    "cartesian_pendulum",
    "chaplygin_sleigh",
    "charged_particle",
    "cloth",
    "damped_oscillator",
    "damped_pendulum",
    "double_pendulum",
    "driven_cart_pole",
    "driven_double_pendulum",
    "duffing",
    "dust_grain",
    "elastic_pendulum",
    "ellipsoid_geodesic",
    "fermi_pasta_ulam",
    "figure_eight",
    "four_bar",
    "hanging_chain",
    "harmonic_oscillator",
    "heavy_top",
    "henon_heiles",
    "jointed_bodies",
    "kapitza",
    "kepler",
    "kepler_plane",
    "kerr_geodesic",
    "lagrange_top",
    "lagrange_top_cusps",
    "lotka_volterra",
    "n_body",
    "n_pendulum",
    "outer_solar_system",
    "pendulum",
    "point_vortices",
    "post_newtonian_binary",
    "puma560",
    "pythagorean",
    "quaternion_top",
    "relativistic_charge",
    "restricted_three_bodies",
    "rigid_body",
    "rolling_disc",
    "schwarzschild_geodesic",
    "slider_crank",
    "snakeboard",
    "spherical_pendulum",
    "spin_boson",
    "torus_geodesic",
    "tumbling_body",
    "van_der_pol",
    "water",
    "whipple_bicycle",
]


def __getattr__(name: str) -> object:
    raise AttributeError(
        f"module 'symsimpson.systems' has no attribute {name!r}.{did_you_mean(name, EVERY)}"
    )


def __dir__() -> list[str]:
    return list(__all__)
