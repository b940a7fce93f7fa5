"""Places of coordinates and constraints in one order: who stands behind whom, and how close."""

import mpmath as mp
import numpy as np
import pytest
from support.bindings import bind_float
from support.cases import sweep
from support.workspace import begin, block

import symsimpson as ss
from symsimpson.discrete.equations import discretise
from symsimpson.lower.module_kernels import lower
from symsimpson.lower.pipeline import source
from symsimpson.lower.storage import Border
from symsimpson.targets.binding import bind_mpmath

#: Seven coordinates in an order of its own; constraints on neighbours, one of them alone.
ORDER = (3, 1, 4, 0, 2, 6, 5)
MEMBERS = [frozenset(x) for x in ((3, 1), (4, 0, 2), (6, 5), (1,))]
NEAR = [{2, 4, 3}, {3}, {0, 4}, {1, 0}, {0, 2}, {6}, {5}]


@pytest.mark.parametrize(
    "held", [Border.chain(ORDER, MEMBERS, NEAR), Border.dense(7, 4)], ids=["chain", "dense"]
)
def test_each_constraint_stands_behind_its_coordinates(held):
    n = 7
    order = ORDER if held.storage.banded else range(n)
    place = dict(zip([*order, *range(n, n + 4)], held.place, strict=True))
    assert sorted(place.values()) == list(range(n + 4))
    for c, members in enumerate(MEMBERS):
        distances = [place[n + c] - place[a] for a in members]
        assert all(0 < distance <= held.storage.band for distance in distances)
    pairs = [(a, b) for a, others in enumerate(NEAR) for b in others]
    assert max(abs(place[a] - place[b]) for a, b in pairs) <= held.storage.band
    found = held.constants(1)["CONSTRAINT_AT"]
    assert [found[place[n + c]] for c in range(4)] == [0, 1, 2, 3]
    assert sum(c >= 0 for c in found) == 4


@pytest.mark.slow
def test_chains_grow_in_proportion_to_their_links():
    """Rows of the workspace, and lines of text, which are those of three families of terms."""
    systems = map(ss.systems.hanging_chain, (20, 40, 80))
    modules = [lower(discretise(system, ss.SIMPSON)) for system in systems]
    rows = [module.rows for module in modules]
    assert rows[2] - rows[1] == 2 * (rows[1] - rows[0])
    assert {module.tables["HELD_BAND"] for module in modules} == {5}
    assert len({len(module.functions) for module in modules}) == 1


def test_a_constraint_on_one_coordinate_of_many():
    """Nothing meets anything but the constraint and its coordinate."""
    held = Border.chain((0, 1, 2), [frozenset({1})], [set(), set(), set()])
    assert held.place == (0, 1, 3, 2)
    assert held.storage.band == 1


@pytest.mark.parametrize(
    ("name", "scheme"),
    sweep(
        [
            ("cartesian_pendulum", "simpson"),
            ("quaternion_top", "midpoint"),
            ("four_bar", "gauss4"),
            ("slider_crank", "lobatto6"),
        ],
        2,
    ),
)
def test_corrections_in_straight_lines_are_those_of_loops(name, scheme):
    """Wrong ones would go unseen: where they do not converge, loops with pivoting follow."""
    system = getattr(ss.systems, name)()
    module, h, pick = bind_float(source(system, scheme)), 0.05, np.random.default_rng(1)
    q = np.array(system.reference_state["q0"], dtype=float)
    found = []
    start = begin(module, q, pick.normal(size=len(q)), system.parameters.values(), h)
    rows = block(module, "INCREMENT", module.UNKNOWNS)
    start[rows, 0] += pick.normal(size=module.UNKNOWNS) / 20
    for newton in (module.newton, module.newton_pivoted):
        W = start.copy()
        newton(h, 0.0, W)
        found.append((W - start)[rows, 0])
    assert np.abs(found[0]).max() > 1e-3
    assert np.abs(found[0] - found[1]).max() < 1e-10 * np.abs(found[1]).max()


@pytest.mark.parametrize(
    ("correction", "before", "left"),
    [
        ("1e-4", "1e-3", "1e-4"),
        ("1e-3", "1e-3", "1e-3"),  # not rounding
        ("1e-26", "1e-20", "1e-26"),
        ("1e-26", "2e-26", 0),  # it shrinks no more
        (0, "inf", 0),
        ("nan", "1e-20", "nan"),
    ],
)
def test_when_a_drift_ends_on_the_constraints(correction, before, left):
    with mp.workdps(15):
        text = source(ss.systems.cartesian_pendulum(), "suzuki4")
        module = bind_mpmath(text, checking=True)
        W = np.full((module.ROWS, 1), mp.mpf(0), dtype=object)
        W[module.CORRECTION_SQUARED, 0] = 2 * mp.mpf(correction)
        W[module.INCREMENT_SQUARED, 0] = mp.mpf(2)
        W[module.RELATIVE, 0] = mp.mpf(before)
        module.check_drift(W, 0)
        assert str(W[module.RELATIVE, 0]) == str(mp.mpf(left))
