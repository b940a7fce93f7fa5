"""Derivatives of some steps with constraints, against differences of many digits and each other."""

import numpy as np

from symsimpson.study.analysis.discrete_flow import DiscreteFlow


def carried(stepper, z, h, steps, **options):
    n, z = stepper.n, z.astype(float)
    return stepper.integrate(z[:n], p0=z[n:], h=h, steps=steps, **options)


def check_parameters(stepper, values, z, h, steps, digits):
    """Also of those in constraints, where the start must move with them."""
    size = DiscreteFlow(stepper, values, digits).small
    names = stepper.parameters
    run = carried(stepper, z, h, steps, tangents=2 * stepper.n, sensitivities=names)
    for name in names:
        starts, ends = [], []
        for sign in (1, -1):
            moved = DiscreteFlow(stepper, {**values, name: values[name] + sign * size}, digits)
            starts.append(moved.project(z))
            ends.append(moved.advance(starts[-1], h, steps))
        start, end = (((a - b) / (2 * size)).astype(float) for a, b in (starts, ends))
        found = run.tangent[-1] @ start + run.sensitivity[name][-1]
        scale = np.abs(end).max() + np.abs(run.sensitivity[name][-1]).max()
        assert np.abs(found - end).max() < 1e-12 * max(scale, 1e-3), name


def check_adjoint(stepper, z, h, steps):
    """It is the transpose of the tangent, by the state and by parameters."""
    n, z, varied = stepper.n, z.astype(float), stepper.parameters
    run = carried(stepper, z, h, steps, tangents=2 * n, sensitivities=varied)
    weights = np.random.default_rng(3).normal(size=2 * n)
    names = [*stepper.coordinates, *(f"p_{q}" for q in stepper.coordinates)]
    cost = "+".join(f"({float(w)!r})*{x}" for w, x in zip(weights, names, strict=True))
    found = stepper.gradient(
        z[:n], p0=z[n:], h=h, steps=steps, cost=cost, wrt=("q", "p", *varied)
    ).gradient
    columns = [run.tangent[-1], *(run.sensitivity[name][-1][:, None] for name in varied)]
    truth = weights @ np.concatenate(columns, axis=1)
    assert np.abs(found - truth).max() < 1e-12 * np.abs(truth).max()
