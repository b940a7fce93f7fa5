"""Random systems by all schemes: code in straight lines and in loops takes the same steps."""

from functools import cache

import numpy as np
import pytest
from support.bindings import bind_float
from support.forms import limited
from support.random_systems import random_state, random_system
from support.workspace import begin, state, take_step

from symsimpson.discrete.equations import discretise
from symsimpson.lower import module_kernels
from symsimpson.lower.emit import emit
from symsimpson.schemes.scheme import MIDPOINT, SIMPSON, galerkin

pytestmark = pytest.mark.slow


#: The highest orders have tables of their own making, in loops alone: they differ by the rule.
@cache
def schemes():
    family = [MIDPOINT, SIMPSON, *(galerkin("gauss", nodes, nodes) for nodes in range(2, 9))]
    return [*family, *(galerkin("lobatto", nodes, nodes - 1) for nodes in (2, *range(4, 10)))]


H, STEPS, AT_ONCE = 0.02, 3, 10


def ends(equations, unknowns, members, monkeypatch, q, v):
    """The state after some steps, of code in one form; None if the scheme has only the other."""
    limited(monkeypatch, UNROLLED_UNKNOWNS=unknowns, FAMILY_MEMBERS=members)
    text = emit(equations, module_kernels.lower(equations))
    module = bind_float(text)
    if unknowns and "newton_pivoted" not in text:
        return None
    W = begin(module, q, v, equations.system.parameters.values(), H)
    for _ in range(STEPS):
        take_step(module, W, H, iterations=6)
    module.energy(H, 0.0, W)
    return np.array([*state(module, W), W[module.ENERGY, 0]])


@pytest.mark.parametrize("start", range(0, 300, AT_ONCE))
def test_straight_lines_and_loops_take_the_same_steps(start, monkeypatch):
    """Families of terms, constants among them, and every term by itself."""
    compared = 0
    for seed in range(start, start + AT_ONCE):
        system, scheme = random_system(seed), schemes()[seed % len(schemes())]
        q, v = random_state(seed, system.n)
        straight = discretise(system, scheme, ())
        forms = [(straight, 10**6, 99), (straight, 0, 99), (straight, 0, 0)]
        found = [ends(*form, monkeypatch, q, v) for form in forms]
        for other in found[:2]:
            if other is not None:
                np.testing.assert_allclose(
                    other, found[2], rtol=1e-11, atol=1e-12, err_msg=f"{seed}, {scheme.name}"
                )
                compared += 1
    assert compared >= AT_ONCE
