"""Explicit schemes: their coefficients, their order, and steps against kicks and drifts by hand."""

from itertools import pairwise

import mpmath
import numpy as np
import pytest
from support.cases import sweep
from support.forms import limited

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.schemes.composition import COMPOSITIONS

HENON = ss.systems.henon_heiles()
CHAIN = ss.systems.fermi_pasta_ulam()


@pytest.mark.parametrize("name", COMPOSITIONS)
def test_coefficients(name):
    scheme = ss.composition(name)
    kicks, drifts = scheme.kicks, scheme.drifts
    assert sum(kicks) == sum(drifts) == 1
    assert kicks == kicks[::-1]
    assert drifts == drifts[::-1]
    assert len(kicks) == len(drifts) + 1
    assert scheme.source


def test_unknown_name():
    with pytest.raises(ss.SchemeError, match="there is no composition 'yoshida5'"):
        ss.composition("yoshida5")


@pytest.mark.parametrize("name", sweep(COMPOSITIONS))
@pytest.mark.parametrize(
    ("system", "t_end"), [(ss.systems.pendulum(), 2), (CHAIN, 0.25)], ids=["pendulum", "chain"]
)
def test_order(system, t_end, name):
    """From the differences of runs with h, h/2, h/4 and h/8, in 40 digits."""
    stepper = ss.compile(system, name, precision=40, arithmetic="arb")
    ends = []
    for steps in (50, 100, 200, 400):
        h = mpmath.mpf(t_end) / steps
        run = stepper.integrate(**system.reference_state, h=h, steps=steps, every=None)
        ends.append(np.concatenate([run.q[0], run.p[0]]))
    gaps = [float(np.abs(a - b).max()) for a, b in pairwise(ends)]
    found = np.log2(np.array(gaps[:-1]) / np.array(gaps[1:]))
    assert abs(found[-1] - ss.composition(name).order) < 0.15, (found, gaps)


@pytest.mark.parametrize("name", sweep(COMPOSITIONS))
def test_kicks_and_drifts(name):
    """Ten steps by hand, in doubles."""
    scheme, h = ss.composition(name), 0.1
    run = ss.compile(HENON, name).integrate(**HENON.reference_state, h=h, steps=10)
    q, p = run.q[0].copy(), run.p[0].copy()
    kicks, drifts = ([float(x) for x in row] for row in (scheme.kicks, scheme.drifts))
    for _ in range(10):
        for kick, drift in zip(kicks, [*drifts, 0.0], strict=True):
            p -= h * kick * np.array([q[0] + 2 * q[0] * q[1], q[1] + q[0] ** 2 - q[1] ** 2])
            q += h * drift * p
    assert np.abs(run.q[-1] - q).max() < 1e-14
    assert np.abs(run.p[-1] - p).max() < 1e-14
    assert run.newton_iterations.sum() == 0


@pytest.mark.parametrize("name", COMPOSITIONS)
def test_a_step_takes_as_many_forces_as_drifts(name):
    """The force at the last kick is that at the first one of the next step."""
    text = source(ss.systems.pendulum(), name)
    advance = text[text.index("def advance(") :].partition("\n\n\n")[0]
    assert advance.count(" = sincos(") == len(ss.composition(name).drifts)


@pytest.mark.parametrize("name", sweep(["suzuki4", "blanes_moan6", "kahan_li8"], 0))
def test_loops_are_straight_lines(name, monkeypatch):
    """Kernels with loops, as large systems get them, and the solution of another scheme."""
    given = {**CHAIN.reference_state, "h": 0.001, "steps": 500, "every": None}
    straight = ss.compile(CHAIN, name).integrate(**given)
    limited(monkeypatch, UNROLLED_FORCES=1)
    looped = ss.compile(CHAIN, name)
    assert "range(1, len(KICKS))" in looped.source
    run = looped.integrate(**given)
    assert np.abs(run.q - straight.q).max() < 1e-14
    other = ss.compile(CHAIN, "gauss8").integrate(**given)
    assert np.abs(run.q - other.q).max() < 1e-8


@pytest.mark.slow
def test_a_long_chain():
    """Loops over families, whose coordinates stand in another order."""
    q = ss.coordinates(" ".join(f"x{i}" for i in range(40)))
    chain = ss.MechanicalSystem(
        "long_chain",
        coordinates=q,
        kinetic=sum(x.diff() ** 2 for x in q) / 2,
        potential=sum((b - a) ** 2 / 2 + (b - a) ** 4 / 4 for a, b in pairwise(q)),
        parameters={},
    )
    start = {"q0": np.sin(np.arange(40.0)), "p0": np.zeros(40), "every": None}
    run = ss.compile(chain, "kahan_li8").integrate(**start, h=0.05, steps=100)
    fine = ss.compile(chain, "simpson").integrate(**start, h=0.005, steps=1000)
    assert np.abs(run.q - fine.q).max() < 1e-8
    assert abs(run.p.sum()) < 1e-12


@pytest.mark.parametrize(
    ("system", "what"),
    [
        (ss.systems.double_pendulum(), "mass matrix depends on positions"),
        (ss.systems.lagrange_top(), "mass matrix depends on positions"),
    ],
)
def test_what_is_not_explicit_is_refused(system, what):
    with pytest.raises(ss.SchemeError, match=what):
        ss.compile(system, "kahan_li8")


def test_forces_of_velocities_are_refused():
    x, y = ss.coordinates("x y")
    L = (x.diff() ** 2 + y.diff() ** 2) / 2 + x * y.diff() - x**4 - y**2
    charged = ss.MechanicalSystem.from_lagrangian("charged", L, coordinates=[x, y], parameters={})
    with pytest.raises(ss.SchemeError, match="force depends on velocities in x, y"):
        ss.compile(charged, "suzuki4")


def test_an_explicit_step_has_no_equations():
    stepper = ss.compile(HENON, "suzuki4")
    with pytest.raises(ss.InputError, match="suzuki4 is explicit"):
        stepper.residual([0.1, 0.2], [0, 0], [[0.1, 0.2]], 0.1)


@pytest.mark.slow
def test_certificate():
    assert ss.compile(HENON, "kahan_li6").certify().passed


@pytest.mark.slow
def test_linear_limits():
    """Where the trace of a step of the linear oscillator leaves [-2, 2]."""
    from symsimpson.study.analysis.stability.standard_problems import linear_limits, theory_limits

    for name in ("suzuki4", "blanes_moan4", "kahan_li6"):
        theory, seen = theory_limits(name, 6.0), linear_limits(name, 6.0)
        assert len(seen) == len(theory) > 0
        assert np.allclose(seen, theory, atol=1e-3)
