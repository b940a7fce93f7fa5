"""What is computed once, and lines in an order that no hash decides."""

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
