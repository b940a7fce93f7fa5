"""What is computed once, and lines in an order that no hash decides."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.pipeline import source
from symsimpson.discrete.equations import discretise


def test_values_move_to_the_next_step_in_the_order_of_their_names():
    low = Lowering(discretise(ss.systems.pendulum(), ss.SIMPSON))
    (q,) = low.q
    parts = [low.graph.define(f"part_{k}", q ** (k + 2), "some") for k in range(8)]
    total = low.graph.define("total", sp.Add(*parts), "some")
    following = low.graph.declare(sp.Symbol("q_next", real=True), Level.STEP)
    before = len(low.graph.definitions)
    low.moved(total, {q: following})
    names = [symbol.name for symbol in list(low.graph.definitions)[before:]]
    assert names == [*(f"part_{k}_next" for k in range(8)), "total_next"]


def test_a_sum_of_known_angles_needs_no_sine_of_its_own():
    text = source(ss.systems.double_pendulum(), ss.SIMPSON)
    assert "sincos(q1_1)" in text
    assert "sincos(angle" not in text
    assert "sin_angle1_1 = cos_q2_1*sin_q1_1 - cos_q1_1*sin_q2_1" in text


def test_a_sine_that_something_is_divided_by_keeps_its_digits():
    x, y = ss.coordinates("x y")
    g = sp.Symbol("g", positive=True)
    system = ss.MechanicalSystem(
        "close", coordinates=(x, y), kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=g / sp.sin(x - y) ** 2 + sp.cos(x) + sp.cos(y), parameters={g: 1.0},
    )  # fmt: skip
    assert "sincos(angle" in source(system, ss.SIMPSON)


@pytest.mark.parametrize(
    "number", [sp.Integer(10) ** 20, sp.Rational(1.38e-23), sp.Rational(0.1) ** 3, sp.factorial(30)]
)
@pytest.mark.parametrize("scheme", ["midpoint", "gauss8"])
def test_numbers_beyond_64_bits(number, scheme):
    (x,) = ss.coordinates("x")
    k = sp.Symbol("k")

    def swung(factor, parameters):
        system = ss.MechanicalSystem(
            "large", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=factor * x**4,
            parameters=parameters,
        )  # fmt: skip
        h = 0.1 / float(number) ** 0.5
        return ss.compile(system, scheme).integrate([0.3], v0=[0.0], h=h, steps=5).q

    np.testing.assert_allclose(swung(number, {}), swung(k, {k: float(number)}), rtol=1e-14)


def test_numbers_that_no_double_holds_are_refused():
    (x,) = ss.coordinates("x")
    tiny = ss.MechanicalSystem(
        "tiny", coordinates=(x,), kinetic=x.diff() ** 2 / 2,
        potential=sp.Rational(0.1) ** 30 * x**2, parameters={},
    )  # fmt: skip
    with pytest.raises(ss.GenerationError, match="larger than doubles can be"):
        ss.compile(tiny)
