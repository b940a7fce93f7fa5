"""Random systems, states and input; the smallest that fails is shown."""

from functools import cache

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from support import fuzz
from support.bindings import bind_complex, bind_float
from support.strategies import names, runs, states, systems
from support.workspace import begin, state, take_step
from sympy.physics.mechanics import dynamicsymbols

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.text.header import read_header
from symsimpson.text.syntax import check_structure

#: The same examples each time; without a clock, which other work on the machine would trip.
BUDGET = {"derandomize": True, "deadline": None, "suppress_health_check": list(HealthCheck)}
PENDULUM = ss.systems.double_pendulum()


@cache
def stepper_of(scheme):
    return ss.compile(PENDULUM, scheme)


@settings(max_examples=400, **BUDGET)
@given(runs(2))
@pytest.mark.slow
def test_any_input_is_run_or_refused(asked):
    """Finite states and a status, or a typed error with its remedy; nothing else."""
    for scheme in ("simpson", "midpoint", "gauss8"):
        stepper = stepper_of(scheme)
        try:
            run = stepper.integrate(**asked, on_failure="return")
        except (ss.InputError, ss.StabilityWarning, ss.ResolutionWarning):
            continue
        assert np.isfinite(run.q).all()
        assert np.isfinite(run.p).all()
        assert isinstance(run.status, ss.Status)
        if asked["steps"] is not None:
            assert (run.status is ss.Status.SUCCESS) == (run.steps == asked["steps"])


@settings(max_examples=12, **BUDGET)
@given(systems(), states(4))
@pytest.mark.slow
def test_any_system_makes_a_symplectic_step(system, numbers):
    """The derivative of a step by a complex step, for whatever structure is found."""
    text = source(system, "simpson")
    check_structure(text, "drawn")
    n, h = system.n, 0.03125
    values = list(system.parameters.values())
    q = [x % 1.0 if np.isfinite(x) else 0.3 for x in numbers[:n]]
    p = [0.25 * (k + 1) for k in range(n)]
    plain = bind_float(text)
    W = begin(plain, q, p, values, h)
    take_step(plain, W, h, iterations=8)
    module = bind_complex(text)
    columns = []
    for k in range(2 * n):
        z = np.array([*q, *p], dtype=complex)
        z[k] += 1e-30j
        moved = begin(module, z[:n], z[n:], values, h, dtype=complex)
        take_step(module, moved, h, iterations=8)
        columns.append(np.imag(state(module, moved)) / 1e-30)
    assert np.abs(np.real(state(module, moved)) - state(plain, W)).max() < 1e-11
    D = np.array(columns).T
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    assert np.abs(D.T @ J @ D - J).max() < 1e-12 * max(1.0, np.abs(D).max() ** 2)


@settings(max_examples=60, **BUDGET)
@given(names.filter(lambda name: "\0" not in name), names)  # SymPy refuses it as a function
@pytest.mark.slow
def test_any_name_is_text(first, second):
    """Whatever symbols are called, the module is one of ours, and its parameters identifiers."""
    q = sp.Function(first)(dynamicsymbols._t)
    mass = sp.Symbol(second, positive=True)
    try:
        system = ss.MechanicalSystem(
            "named",
            coordinates=[q],
            kinetic=mass * q.diff() ** 2 / 2,
            potential=mass * q,
            parameters={mass: 1.0},
        )
    except ss.ModelError:
        return
    text = source(system, "midpoint")
    check_structure(text, "named")
    header = read_header(text, "named")
    assert all(name.isidentifier() for name in (*header.parameters, *header.coordinates))


def test_the_campaign_finds_what_it_checks():
    assert fuzz.check(1000) == (1000, None)
