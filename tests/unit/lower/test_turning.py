"""Sines and cosines at nodes are computed twice a step, then turned by what angles change."""

import math
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
from support.workspace import new_workspace

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.targets.binding import bind, plain_arithmetic
from symsimpson.text.interface import MATH
from symsimpson.text.library import library_sources

FRESH = 2


def counting(text, fresh=FRESH):
    """Bind a module to Python floats, counting what is computed and what is turned."""
    counts = {"sincos": 0, "turned": 0}
    functions = {name: getattr(math, name) for name in [*MATH, "atan2"]}
    arithmetic = plain_arithmetic(functions, float, digits=16)

    def counted(function):
        name = function.__name__

        def call(*arguments):
            if name in counts:
                counts[name] += 1
            return function(*arguments)

        return call

    return bind(text, arithmetic | {"FRESH": fresh, "compiled": counted}), counts


def step_of(module, state, h):
    """Take a step by stages; returns the state and the iterations."""
    n, values = len(state["q0"]), module.FACTS["defaults"]
    W = new_workspace(module, state["q0"], state["p0"], values, float)
    module.prepare(h, 0.0, W)
    module.start_stages(h, 0.0, W)
    W[module.CONTRACTION], W[module.RELATIVE], W[module.ACTIVE] = 1.0, math.inf, 1.0
    count = 0
    while W[module.ACTIVE, 0] > 0 and count < 60:
        module.iterate(h, 0.0, W)
        count += 1
    W[module.ACTIVE] = 1.0
    module.advance_stages(h, 0.0, W)
    return np.concatenate([W[module.POSITION :][:n, 0], W[module.MOMENTUM :][:n, 0]]), count


START = {"q0": [0.8, 1.0], "p0": [0.05, -0.02]}


@pytest.fixture(scope="module")
def text():
    return source(ss.systems.double_pendulum(), "gauss8")


@pytest.mark.slow
def test_two_iterations_compute_them(text):
    module, counts = counting(text)
    counts["sincos"] = 0
    state, iterations = step_of(module, START, 0.01)
    starts = counts["sincos"] - FRESH * 2 * module.STRIDE
    assert iterations > FRESH + 1
    assert starts == 2  # those of the start of the run
    assert counts["turned"] == (iterations - FRESH) * 2 * module.STRIDE
    alone, more = counting(text, fresh=2**60)
    same, others = step_of(alone, START, 0.01)
    assert (others, more["turned"]) == (iterations, 0)
    assert np.abs(state - same).max() < 1e-16


@pytest.mark.slow
def test_angles_that_turn_far_have_sines_of_their_own(text):
    module, counts = counting(text)
    state, _ = step_of(module, START, 0.12)
    fresh, _ = step_of(counting(text, fresh=2**60)[0], START, 0.12)
    assert counts["turned"] > 0
    assert counts["sincos"] > 2 + FRESH * 2 * module.STRIDE
    assert np.abs(state - fresh).max() < 2e-15


def test_turned_to_rounding():
    text = library_sources()["turned"]
    module = SimpleNamespace()
    exec(text, {"compiled": lambda f: f}, module.__dict__)
    random = np.random.default_rng(3)
    for angle in random.uniform(-10, 10, 200):
        for change in random.uniform(-1, 1, 5) * 2.0**-7:
            sine, cosine = module.turned(math.sin(angle), math.cos(angle), change)
            with mpmath.workdps(30):
                exact = mpmath.mpf(float(angle)) + mpmath.mpf(float(change))
                off = max(abs(sine - mpmath.sin(exact)), abs(cosine - mpmath.cos(exact)))
            assert off < 2.5e-16


@pytest.mark.slow
def test_systems_without_angles_are_as_they_were():
    text = source(ss.systems.henon_heiles(), "gauss8")
    assert "turned" not in text
    assert "STAGE_TURN" not in text
