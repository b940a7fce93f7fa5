"""What terms of L are multiplied by, computed once a run; and what explicit steps store."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_float
from support.workspace import block, new_workspace

import symsimpson as ss
from symsimpson.lower.pipeline import source

MASSES = [Fraction(k + 3, 7) for k in range(10)]


@pytest.fixture(scope="module")
def ten_bodies():
    text = source(ss.systems.n_body(10), "blanes_moan6")
    module = bind_float(text)
    values = [float(value) for value in (*MASSES, Fraction(2, 3))]
    W = new_workspace(module, np.zeros(30), np.zeros(30), values)
    module.prepare(0.1, 0.0, W)
    return text, module, W


def test_products_of_parameters_are_computed_in_a_loop(ten_bodies):
    text, module, W = ten_bodies
    assert text.count("W[COEFFICIENT") < 10
    found = W[block(module, "COEFFICIENT", 55), 0]
    pairs = [MASSES[a] * MASSES[b] * Fraction(2, 3) for a in range(10) for b in range(a)]
    expected = sorted([m / 2 for m in MASSES] + pairs)
    assert np.sort(found) == pytest.approx([float(x) for x in expected], rel=1e-15)


def test_few_products_and_other_coefficients_are_written_out():
    z = ss.coordinates("z0:60")
    a, b = sp.symbols("a b", positive=True)
    strengths = [a * b, (a + b) ** 3, *(2 * a for _ in z[2:])]
    system = ss.MechanicalSystem(
        "few",
        coordinates=z,
        kinetic=sum(x.diff() ** 2 / 2 for x in z),
        potential=sum(c * x**4 for c, x in zip(strengths, z, strict=True))
        + sum(x * y for x, y in pairwise(z)),
        parameters={a: 1.5, b: 2.5},
    )
    text = source(system, "blanes_moan6")
    assert "FAMILY_1" in text
    assert "PRODUCTS_" not in text
    module = bind_float(text)
    W = new_workspace(module, np.zeros(60), np.zeros(60), [1.5, 2.5])
    module.prepare(0.1, 0.0, W)
    found = W[module.COEFFICIENT : module.RESIDUAL, 0]
    assert sorted(abs(found)) == [3.0, 3.75, 64.0]  # L has -V


def test_an_explicit_step_of_separate_bodies_stores_a_diagonal_mass(ten_bodies):
    _, module, _ = ten_bodies
    assert module.BAND == 0
    assert module.MASS - module.NODE_L_VV == 30
    assert list(module.COORDINATE) == list(range(30))
    implicit = bind_float(source(ss.systems.n_body(10), "midpoint"))
    assert implicit.BAND == 29
