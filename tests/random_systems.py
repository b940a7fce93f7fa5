"""Random systems: M(q) positive definite, V with many kinds of terms."""

from __future__ import annotations

import random

import sympy as sp

import symsimpson as ss


def random_system(seed):
    """A system with 1 to 4 coordinates; every third one has gyroscopic terms."""
    pick = random.Random(seed)
    n = pick.randint(1, 4)
    q = ss.coordinates(" ".join(f"q{i}" for i in range(n)))
    v = [x.diff() for x in q]
    m, k, w = sp.symbols("m k w", positive=True)

    def term():
        x, y = pick.choice(q), pick.choice(q)
        c = sp.Rational(pick.randint(-9, 9) or 1, pick.randint(5, 9))
        return c * pick.choice([
            sp.sin(w * x), sp.cos(x - 2 * y), x**3 * y, x**2, k * x * y, 1 / (3 + sp.cos(x) + y**2),
            sp.exp(-(x**2)), sp.exp(sp.sin(y)), sp.sqrt(2 + x**2), sp.sqrt(1 + (x - y) ** 2) ** 3,
            sp.tan(x / 4), sp.log(2 + y**2), sp.tanh(x), sp.atan(x * y), sp.sinh(x / 3),
            (4 + x) ** sp.Rational(1, 3), sp.Float(0.7) * x,
        ])  # fmt: skip

    # M = D + sum of squares: positive definite for every q
    kinetic = sum((m + sp.Rational(i, 3)) * u**2 for i, u in enumerate(v)) / 2
    for _ in range(pick.randint(0, 2)):
        kinetic += sum(u * term() / 3 for u in pick.sample(v, pick.randint(1, n))) ** 2
    potential = sum((term() for _ in range(pick.randint(1, 4))), sp.S.Zero)
    gyroscopic = sum((u * term() / 5 for u in v), sp.S.Zero) if seed % 3 == 0 else sp.S.Zero
    return ss.MechanicalSystem(
        f"random_{seed}", coordinates=q, kinetic=kinetic, potential=potential,
        gyroscopic=gyroscopic, parameters={m: 1.25, k: 0.5, w: 1.5},
    )  # fmt: skip


def random_state(seed, n):
    pick = random.Random(seed)
    q = [pick.randint(-80, 80) / 100 for _ in range(n)]
    v = [pick.randint(-80, 80) / 100 for _ in range(n)]
    return q, v
