"""Stages by loops come to what Newton's method comes to, for all that a constant M may go with."""

import re

import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_float
from support.cases import sweep
from support.forms import limited
from support.workspace import block, new_workspace

import symsimpson as ss
from symsimpson.lower import module_kernels, pipeline
from symsimpson.lower.stages import looped_stages
from symsimpson.run.requested import program_for_request
from symsimpson.stepping.request import Request

H = 0.0625


def model(**more):
    """Three tied masses, of which the last has no force of its own."""
    x, y, _ = q = ss.coordinates("x y z")
    u, v, w = (one.diff() for one in q)
    a = sp.Symbol("a", positive=True)
    return ss.MechanicalSystem(
        "tied",
        coordinates=q,
        kinetic=(u**2 + 2 * v**2 + w**2) / 2 + a * (u + v) * w / 3,
        potential=(x**2 + x * y + y**4) / 2 + sp.sin(x),
        parameters={a: 0.5},
        **more,
    )


def variants():
    x, y, _ = ss.coordinates("x y z")
    push = sp.Symbol("push")
    yield "conservative", {}, {}
    yield "in a field", {"gyroscopic": x**2 * y.diff() - y * x.diff() / 3}, {}
    yield "dragged", {"forces": {x: -x.diff() * y / 4, y: sp.cos(2 * ss.time)}}, {}
    field = sp.sin(x + 2 * ss.time) * y.diff()
    yield "in a field that changes", {"gyroscopic": field, "forces": {x: -x.diff() / 4}}, {}
    yield "driven", {"forces": {y: push}, "inputs": (push,)}, {"inputs": {"push": [0.5, -0.25, 1]}}


@pytest.fixture
def by_loops(monkeypatch):
    limited(monkeypatch, STAGE_COORDINATES=0)


def runs(stepper, monkeypatch, **given):
    """Run by stages, then by Newton's method alone."""
    made = program_for_request(
        stepper.program, Request(None, tangents=given.get("tangents"))
    ).kernels
    assert made.fallbacks[0] == "stages"
    for first in (0, 1):
        monkeypatch.setattr(made, "fallbacks", made.fallbacks[first:])
        yield stepper.integrate([0.3, -0.5, 0.2], v0=[0.7, 0.1, -0.4], h=H, steps=3, **given)


@pytest.mark.parametrize(("about", "more", "given"), sweep(variants(), 2))
def test_stages_and_newtons_method_agree(about, more, given, by_loops, monkeypatch):
    stepper = ss.compile(model(**more), "gauss10", precision=40)
    assert "enter_stage(" in stepper.source
    stages, newton = runs(stepper, monkeypatch, **given)
    assert stages.newton_iterations[1:].min() > newton.newton_iterations[1:].max()
    assert abs(stages.q - newton.q).max() < 1e-33
    assert abs(stages.p - newton.p).max() < 1e-33


def test_families_of_terms_in_a_field(monkeypatch):
    """Sums over the members of a family begin anew at each node."""
    limited(monkeypatch, UNROLLED_UNKNOWNS=0, STAGE_COORDINATES=0, FAMILY_MEMBERS=0)
    x, y, z = ss.coordinates("x y z")
    around = x * y.diff() - y * x.diff() + y * z.diff() - z * y.diff()
    stepper = ss.compile(model(gyroscopic=around), "gauss10", precision=40)
    stages, newton = runs(stepper, monkeypatch)
    assert abs(stages.q - newton.q).max() < 1e-33
    assert abs(stages.p - newton.p).max() < 1e-33
    assert re.search(r"def gyroscopic_\d", stepper.source)


def test_they_take_as_many_iterations_as_straight_lines(monkeypatch):
    """From the first step on, and where velocities are extrapolated with care."""
    given = {"q0": [0.3, -0.5, 0.2], "v0": [0.7, 0.1, -0.4], "steps": 4}
    straight = ss.compile(model(), "gauss10", precision=40)
    limited(monkeypatch, STAGE_COORDINATES=0)
    loops = ss.compile(model(), "gauss10", precision=40)
    assert "enter_stage(" in loops.source
    assert "enter_stage(" not in straight.source
    for h in (H, 8 * H):
        one, other = (stepper.integrate(**given, h=h) for stepper in (straight, loops))
        assert one.newton_iterations.tolist() == other.newton_iterations.tolist()


def test_they_measure_their_corrections_alike(monkeypatch):
    """By the masses of all coordinates, at each node."""
    found = []
    for limits in ({}, {"STAGE_COORDINATES": 0}):
        limited(monkeypatch, **limits)
        module = bind_float(pipeline.derive(model(), "gauss10").text)
        W = new_workspace(module, [0.3, -0.5, 0.2], [0.7, 0.1, -0.4], [0.5])
        module.prepare(8 * H, 0.0, W)
        module.start_stages(8 * H, 0.0, W)
        for _ in range(2):
            module.iterate(8 * H, 0.0, W)
        rows = [block(module, name, 5) for name in ("STAGE_CORRECTION", "STAGE_SIZE")]
        found.append(np.array([W[row, 0] for row in rows]))
    assert found[0].min() > 0
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_the_same_text_serves_masses_that_change(monkeypatch):
    """Small systems have a trace of it; as loops it factorises M at each node."""
    limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    monkeypatch.setattr(
        module_kernels, "_stage_kernels", lambda low, known, **_: looped_stages(low, known)
    )
    stepper = ss.compile(ss.systems.double_pendulum(), "gauss10", precision=40)
    assert "least_pivot(" in stepper.source
    found = []
    made = stepper.program.kernels
    for first in (0, 1):
        monkeypatch.setattr(made, "fallbacks", made.fallbacks[first:])
        found.append(stepper.integrate([0.8, 1.0], v0=[0.2, -0.1], h=H, steps=3))
    assert abs(found[0].q - found[1].q).max() < 1e-33
    assert abs(found[0].p - found[1].p).max() < 1e-33


@pytest.mark.slow
def test_their_derivatives_agree(by_loops, monkeypatch):
    stepper = ss.compile(model(), "gauss10", precision=40)
    stages, newton = runs(stepper, monkeypatch, tangents=2)
    assert abs(stages.tangent[-1] - newton.tangent[-1]).max() < 1e-30


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["gauss6", "gauss12"])
def test_clusters_of_atoms_compiled(scheme, monkeypatch):
    system = ss.systems.argon_cluster(9)
    stepper = ss.compile(system, scheme)
    assert "enter_stage(" in stepper.source
    found = []
    made = stepper.program.kernels
    for first in (0, 1):
        monkeypatch.setattr(made, "fallbacks", made.fallbacks[first:])
        found.append(stepper.integrate(**system.reference_state, h=1e-4, steps=50))
    for name in ("q", "p"):
        stages, newton = (getattr(run, name) for run in found)
        assert np.abs(stages - newton).max() < 1e-12 * np.abs(newton).max()
    assert np.abs(found[0].p.reshape(-1, 9, 3).sum(axis=1)).max() < 1e-13
