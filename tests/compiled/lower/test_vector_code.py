"""Kernels over lanes: packed instructions, no branches between lanes, the same numbers."""

import re

import mpmath
import numpy as np
import pytest
from support.bindings import bind_float
from support.cases import sweep
from support.workspace import new_workspace, walked

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.program.driver import driver
from symsimpson.program.numbers import NO_INPUTS
from symsimpson.text.interface import NEWTON


def kernels(text, lanes):
    text = text.replace("LANES = 1\n", f"LANES = {lanes}\n")
    return bind_float(text), walked(text, ("prepare", "start", "newton", "advance"), lanes)


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint"]))
def test_eight_lanes_are_packed(scheme):
    _, made = kernels(source(ss.systems.double_pendulum(), scheme), 8)
    for name in ("newton", "advance"):
        assembly = made[name]._library.get_asm_str()
        packed = len(re.findall(r"\bv?(?:add|mul|sub|div|fn?m(?:add|sub)\w*)pd\b", assembly))
        single = len(re.findall(r"\bv?(?:add|mul|sub|div|fn?m(?:add|sub)\w*)sd\b", assembly))
        assert packed > 100, name
        assert single < packed / 5, name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scheme", "least"),
    sweep(
        [
            ("double_pendulum", "gauss16", 150),
            ("double_pendulum", "gauss8", 150),
            ("lagrange_top", "gauss16", 120),
            ("henon_heiles", "gauss12", 40),
        ]
    ),
)
def test_nodes_of_one_trajectory_are_packed(name, scheme, least):
    """All loops over nodes, although the last one is short: compilers like to unroll it."""
    text = source(ss.systems.CATALOGUE[name](), scheme)
    assembly = walked(text, ["iterate"])["iterate"]._library.get_asm_str()
    packed = len(re.findall(r"\bv?(?:add|mul|sub|div|fn?m(?:add|sub)\w*)pd\b", assembly))
    single = len(re.findall(r"\bv?(?:add|mul|sub|div|fn?m(?:add|sub)\w*)sd\b", assembly))
    assert packed > least
    assert single <= 36  # the judgement of an iteration, and of how far angles were turned


@pytest.mark.slow
def test_lanes_do_not_know_of_each_other():
    """A lane's bits are the same whatever the other lanes do, converged or diverging."""
    text = source(ss.systems.double_pendulum())
    module, made = kernels(text, 8)
    rng = np.random.default_rng(3)
    q, p = rng.uniform(-2, 2, (2, 8)), rng.uniform(-0.3, 0.3, (2, 8))
    length = 9.81 / (2 * np.pi) ** 2
    addresses = np.array([NEWTON, *(k.address for k in made.values()), 0])
    stepper = ss.compile(ss.systems.double_pendulum())

    def run(q, p):
        W = new_workspace(module, q, p, [1.0, 1.0, length, length, 9.81])
        at = stepper.program.header.driver_layout
        stored = np.empty((1, 2, 8))
        driver("begin", 8)(addresses, 0, 0.02, 0.0, W, at)
        progress = np.zeros(3, dtype=np.int64)
        driver("take_steps", 8)(
            addresses,
            (0.02, 0.0, W, at),
            progress,
            200,
            0,
            (stored, stored.copy(), stored[:, :0], np.zeros((1, 8), dtype=np.int64)),
            NO_INPUTS,
        )
        assert progress.tolist() == [200, 0, 0]
        return W[module.POSITION : module.POSITION + 4]

    whole = run(q, p)
    shuffled = run(q[:, ::-1].copy(), p[:, ::-1].copy())[:, ::-1]
    assert (whole == shuffled).all()
    alone = run(np.repeat(q[:, 2:3], 8, axis=1), np.repeat(p[:, 2:3], 8, axis=1))
    assert (alone == whole[:, 2:3]).all()
    single = stepper.integrate(q[:, 2], p0=p[:, 2], h=0.02, steps=200)
    np.testing.assert_allclose(whole[:2, 2], single.q[-1], rtol=0, atol=1e-13)


@pytest.mark.parametrize("size", [1.0, 30.0, 1e4, 1e6, 4.9e8])
def test_sine_and_cosine(size):
    sincos = bind_float(source(ss.systems.pendulum())).sincos
    rng = np.random.default_rng(5)
    near = np.round(rng.uniform(-1, 1, 200) * size / (np.pi / 2)) * (np.pi / 2)
    for x in [*rng.uniform(-size, size, 800), *near, 0.0]:
        for found, truth in zip(sincos(x), mpmath.mp.cos_sin(mpmath.mpf(x))[::-1], strict=True):
            assert abs(found - truth) <= 2 * np.spacing(abs(float(truth)))


def test_sine_and_cosine_know_their_domain():
    sincos = bind_float(source(ss.systems.pendulum())).sincos
    assert all(np.isnan(value) for x in (5.1e8, -1e300, np.inf, np.nan) for value in sincos(x))
