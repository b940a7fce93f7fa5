"""Derivatives of whole steps against complex steps through the same text, in plain arithmetic."""

import numpy as np
import pytest
from support.bindings import bind_complex, bind_float
from support.cases import sweep
from support.workspace import new_workspace, state

import symsimpson as ss
from symsimpson.lower.pipeline import derive

H, STEPS, TINY = 0.02, 2, 1e-30


def take_steps(module, W, *, by_stages, behind=None):
    module.prepare(H, 0.0, W)
    (module.start_stages if by_stages else module.start)(H, 0.0, W)
    iterate = module.iterate if by_stages else getattr(module, "newton", None)
    for step in range(STEPS):
        for _ in range(50 if by_stages else 8):
            if iterate is not None:
                W[module.ACTIVE, 0] = 1  # imaginary parts need as many iterations as real ones
                iterate(H, H * step, W)
        W[module.ACTIVE, 0] = 1
        (module.advance_stages if by_stages else module.advance)(H, H * step, W)
        if behind is not None:
            behind(H, H * step, W)


def carried(module, z, a, **how):
    """The derivative that the module carries along, by state and by parameters."""
    n, columns = module.DIMENSION, len(z) + len(a)
    room = module.TANGENT + columns * (3 * n + module.UNKNOWNS)
    W = np.zeros((max(module.ROWS, room), 1))
    W[: module.ROWS] = new_workspace(module, z[:n], z[n:], a)
    W[module.TANGENTS] = columns
    W[module.TANGENT : module.TANGENT + len(z) ** 2, 0] = np.eye(len(z)).ravel()
    take_steps(module, W, behind=module.tangent, **how)
    return W[module.TANGENT : module.TANGENT + columns * len(z), 0].reshape(columns, -1).T


def by_complex_steps(module, z, a, **how):
    """The same: imaginary parts of the ends of runs with tiny imaginary parts."""
    n, columns = module.DIMENSION, []
    for k in range(len(z) + len(a)):
        moved = np.concatenate([z, a]).astype(complex)
        moved[k] += 1j * TINY
        W = new_workspace(module, moved[:n], moved[n : 2 * n], moved[2 * n :], complex)
        take_steps(module, W, **how)
        columns.append(np.imag(state(module, W)) / TINY)
    return np.array(columns).T


@pytest.mark.parametrize(
    ("name", "scheme"),
    sweep(
        [
            ("double_pendulum", "simpson"),
            ("van_der_pol", "gauss4"),
            ("elastic_pendulum", "gauss8"),
            ("damped_pendulum", "lobatto6"),
            ("lagrange_top", "simpson"),
            ("kepler", "gauss6"),
            ("cart_pole", "midpoint"),
            ("henon_heiles", "gauss6"),
            ("fermi_pasta_ulam", "simpson"),
            ("heavy_top", "lobatto6"),
        ],
        2,
    ),
)
def test_derivatives_are_those_of_the_text(name, scheme):
    system = getattr(ss.systems, name)()
    text = derive(system, scheme, varied=[str(a) for a in system.parameters]).text
    plain, bent = bind_float(text), bind_complex(text)
    start = dict(system.reference_state)
    q = np.array(start["q0"], dtype=float)
    z = np.concatenate([q, start.get("p0", np.full(len(q), 0.3))])
    for by_stages in (False, True)[: 1 + hasattr(plain, "iterate")]:
        found = carried(plain, z, plain.FACTS["defaults"], by_stages=by_stages)
        truth = by_complex_steps(bent, z, plain.FACTS["defaults"], by_stages=by_stages)
        assert np.abs(found - truth).max() < 1e-13 * np.abs(truth).max()
