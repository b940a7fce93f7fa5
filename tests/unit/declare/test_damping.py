"""Damping in proportion to the momenta: what is found, and what is not."""

import pytest
import sympy as sp

import symsimpson as ss

x, y = ss.coordinates("x y")
c, m, g = sp.symbols("c m g", positive=True)
u = sp.Symbol("u")
curved = (m + x**2) * x.diff() ** 2 / 2 + y.diff() ** 2 / 2 + sp.sin(x) * x.diff() * y.diff() / 3
flat = m * (x.diff() ** 2 + y.diff() ** 2) / 2


def found(kinetic, **more):
    system = ss.MechanicalSystem(
        "damped",
        coordinates=(x, y),
        kinetic=kinetic,
        potential=x**4 + x**2 * y**2 + y**2,
        parameters={c: 0.2, m: 1.5, g: 1.0},
        **more,
    )
    rate = system.structure.damping
    if rate is None:
        return None
    back = dict(zip(system.plain.parameters, (c, m, g), strict=True))
    return sp.simplify(system.plain.to_sympy(rate).xreplace(back))


DAMPED = {
    "Rayleigh": (flat, {"dissipation": c * flat / m}, c / m / 2),
    "curved": (curved, {"dissipation": 3 * g * curved}, 3 * g / 2),
    "by hand": (flat, {"forces": {x: -c * m * x.diff(), y: -c * m * y.diff()}}, c / 2),
    "named": (
        flat,
        {"forces": {"air": {x: -c * x.diff(), y: -2 * c * y.diff()}, "more": {x: -c * x.diff()}}},
        c / m,
    ),
    "gyroscopic": (
        flat,
        {
            "gyroscopic": g * x * y.diff(),
            "forces": {x: -c * m * x.diff(), y: -c * (m * y.diff() + g * x)},
        },
        c / 2,
    ),
    "anti-damping": (flat, {"forces": {x: c * m * x.diff(), y: c * m * y.diff()}}, -c / 2),
}
NOT = {
    "none": (flat, {}),
    "one of two": (flat, {"forces": {x: -c * x.diff()}}),
    "two rates": (flat, {"forces": {x: -c * x.diff(), y: -2 * c * y.diff()}}),
    "of velocities, not momenta": (curved, {"dissipation": c * flat}),
    "a field": (flat, {"gyroscopic": g * x * y.diff(), "dissipation": c * flat}),
    "beside a drive": (flat, {"dissipation": c * flat, "forces": {x: sp.cos(ss.time)}}),
    "in time": (flat, {"dissipation": c * flat * (2 + sp.cos(ss.time))}),
    "in place": (flat, {"dissipation": c * flat * (1 + x**2)}),
    "of an input": (flat, {"dissipation": u * flat, "inputs": (u,)}),
    "quadratic": (
        flat,
        {"forces": {v: -c * v.diff() * sp.sqrt(1 + x.diff() ** 2) for v in (x, y)}},
    ),
}


@pytest.mark.parametrize("name", DAMPED)
def test_rate(name):
    kinetic, more, rate = DAMPED[name]
    assert sp.simplify(found(kinetic, **more) - rate) == 0


@pytest.mark.parametrize("name", NOT)
def test_no_rate(name):
    kinetic, more = NOT[name]
    assert found(kinetic, **more) is None
