"""The Fermi-Pasta-Ulam chain with stiff springs."""

from __future__ import annotations

import sympy as sp

from symsimpson.errors import ModelError
from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["fermi_pasta_ulam"]


def fermi_pasta_ulam(n: int = 3) -> CatalogueSystem:
    """A chain of n stiff linear and n + 1 soft quartic springs, between fixed ends.

    ``x_i`` is the displacement of the i-th stiff spring and ``y_i`` its expansion, both scaled.
    """
    if isinstance(n, bool) or not isinstance(n, int) or n < 1:
        raise ModelError(f"a chain has a whole number of stiff springs, not {n!r}.\nUse 3.")
    x, y = coordinates(f"x1:{n + 1}"), coordinates(f"y1:{n + 1}")
    omega = sp.Symbol("omega", positive=True)
    soft = [
        x[0] - y[0],
        *(x[i + 1] - y[i + 1] - x[i] - y[i] for i in range(n - 1)),
        x[n - 1] + y[n - 1],
    ]
    stiffness = 50.0
    rest = (0.0,) * (n - 1)
    return CatalogueSystem(
        f"fermi_pasta_ulam_{n}",
        coordinates=(*x, *y),
        kinetic=sp.Add(*(q.diff() ** 2 for q in (*x, *y))) / 2,
        potential=omega**2 * sp.Add(*(yi**2 for yi in y)) / 2 + sp.Add(*(s**4 for s in soft)) / 4,
        parameters={omega: stiffness},
        reference_state={
            "q0": (1.0, *rest, 1.0 / stiffness, *rest),
            "v0": (1.0, *rest, 1.0, *rest),
        },
        source="E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section I.5.1",
    )
