"""Random systems: M(q) positive definite, V with many kinds of terms."""

from __future__ import annotations

import random

import sympy as sp

import symsimpson as ss


def random_system(seed):
    """A system with 1 to 4 coordinates; every third one has gyroscopic terms."""
    return drawn_system(random.Random(seed), f"random_{seed}", gyroscopic=seed % 3 == 0)


def drawn_system(pick, name, *, gyroscopic=False):
    """The same from any source of random choices."""
    n = pick.randint(1, 4)
    q = ss.coordinates(" ".join(f"q{i}" for i in range(n)))
    v = [x.diff() for x in q]
    m, k, w = sp.symbols("m k w", positive=True)

    def term():
        x, y = pick.choice(q), pick.choice(q)
        c = sp.Rational(pick.randint(-9, 9) or 1, pick.randint(5, 9))
        return c * pick.choice(
            [
                sp.sin(w * x),
                sp.cos(x - 2 * y),
                x**3 * y,
                x**2,
                k * x * y,
                1 / (3 + sp.cos(x) + y**2),
                sp.exp(-(x**2)),
                sp.exp(sp.sin(y)),
                sp.sqrt(2 + x**2),
                sp.sqrt(1 + (x - y) ** 2) ** 3,
                sp.tan(x / 4),
                sp.log(2 + y**2),
                sp.tanh(x),
                sp.atan(x * y),
                sp.sinh(x / 3),
                (4 + x) ** sp.Rational(1, 3),
                sp.Float(0.7) * x,
            ]
        )

    # M = D + sum of squares: positive definite for every q
    kinetic = sum((m + sp.Rational(i, 3)) * u**2 for i, u in enumerate(v)) / 2
    for _ in range(pick.randint(0, 2)):
        kinetic += sum(u * term() / 3 for u in pick.sample(v, pick.randint(1, n))) ** 2
    potential = sum((term() for _ in range(pick.randint(1, 4))), sp.S.Zero)
    linear = sum((u * term() / 5 for u in v), sp.S.Zero) if gyroscopic else sp.S.Zero
    potential += pick.choice([sp.S.Zero, sp.Rational(2, 3), k, -w * k / 3])  # no coordinate in it
    return ss.MechanicalSystem(
        name,
        coordinates=q,
        kinetic=kinetic,
        potential=potential,
        gyroscopic=linear,
        parameters={m: 1.25, k: 0.5, w: 1.5},
    )


def random_state(seed, n):
    pick = random.Random(seed)
    q = [pick.randint(-80, 80) / 100 for _ in range(n)]
    v = [pick.randint(-80, 80) / 100 for _ in range(n)]
    return q, v


def structured_system(seed):
    """A random system with planted structure: cyclic coordinates, constant mass, linear or
    decoupled parts, alone and together. Gives the system and what was planted."""
    pick = random.Random(10_000 + seed)
    m, k, w = sp.symbols("m k w", positive=True)
    q, kinetic, potential, gyroscopic, planted = [], 0, 0, 0, set()
    groups = pick.choice([1, 1, 1, 2])
    for number in range(groups):
        kind = pick.choice(["cyclic", "cyclic", "constant", "linear", "plain"])
        x = list(ss.coordinates(" ".join(f"x{number}{i}" for i in range(pick.randint(1, 2)))))
        y = []
        v = [c.diff() for c in x]
        planted.add(kind)
        wave = [sp.Rational(pick.randint(1, 9), 10) * sp.cos(c + i) for i, c in enumerate(x)]
        if kind == "cyclic":
            y = list(ss.coordinates(" ".join(f"y{number}{i}" for i in range(pick.randint(1, 2)))))
            u = [c.diff() for c in y]
            kinetic += sum(m * z**2 for z in (*v, *u)) / 2
            for z in u:  # sums of squares with couplings keep M positive definite
                coupling = sum(c * b for c, b in zip(wave, v, strict=True))
                kinetic += (z * pick.choice([1 + wave[0], sp.exp(wave[-1])]) + coupling) ** 2 / 2
            if len(u) == 2:
                kinetic += (u[0] + wave[0] * u[1]) ** 2 / 4
            if pick.random() < 0.3:
                gyroscopic += wave[0] * u[0] / 3
            potential += sum(k * sp.cos(c) for c in x) + sum(x) ** 4 / 9
        elif kind == "plain":
            kinetic += sum(m * z**2 * (2 + a) for z, a in zip(v, wave, strict=True)) / 2
            potential += sum(k * sp.sin(w * c) for c in x) + sum(x) ** 2 / 2
        else:
            kinetic += sum(m * z**2 for z in v) / 2 + m * sum(v) ** 2 / 5
            potential += (
                k * sum(x) ** 2 / 2 + sum((2 + i) * c**2 for i, c in enumerate(x)) - x[0] / 3
            )
            if kind == "constant":
                potential += sum(sp.cos(w * c) for c in x) + sum(x) ** 4 / 20
        q += x + y
    order = list(range(len(q)))
    pick.shuffle(order)
    system = ss.MechanicalSystem(
        f"structured_{seed}",
        coordinates=[q[i] for i in order],
        kinetic=sp.expand(kinetic),
        potential=potential,
        gyroscopic=gyroscopic,
        parameters={m: 1.25, k: 0.5, w: 1.5},
    )
    return system, planted | ({"decoupled"} if groups > 1 else set())
