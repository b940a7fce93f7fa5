"""Lines come in an order that no hash decides."""

import sympy as sp

import symsimpson as ss
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
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
