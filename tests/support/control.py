"""Derivatives of programmes of optimal control, against differences of high order."""

import numpy as np


def check_derivatives(problem, scheme, steps=3):
    """Compare those of all rows by all unknowns; patterns miss nothing."""
    from scipy import sparse

    from symsimpson.schemes.named import read_scheme
    from symsimpson.study.control.layout import Layout
    from symsimpson.study.control.problem_parts import read_grid
    from symsimpson.study.control.solution import build_initial_point

    grid = read_grid(steps, len(problem.reading.phases))
    layout = Layout(problem.reading, read_scheme(scheme), grid)
    programme, *_ = layout.nlp
    rng = np.random.default_rng(3)
    at = build_initial_point(layout, None) + 0.1 * rng.normal(size=layout.size)
    multipliers, cost = rng.normal(size=programme.shape[0]), 0.7

    def slopes(at):
        gradient, entries = programme.slopes(at)
        jacobian = sparse.csr_matrix((entries, programme.jacobian_places), shape=programme.shape)
        return gradient, jacobian.toarray()

    def lagrangian(at):
        gradient, jacobian = slopes(at)
        return cost * gradient + jacobian.T @ multipliers

    def differences(function, size=2e-3):
        weights = enumerate([4 / 5, -1 / 5, 4 / 105, -1 / 280], start=1)
        ways = size * np.eye(layout.size)
        pairs = list(weights)
        return np.array(
            [
                sum(c * (function(at + i * way) - function(at - i * way)) for i, c in pairs) / size
                for way in ways
            ]
        ).T

    def rows(at):
        own, others = programme.values(at)
        return np.array([own, *others])

    gradient, jacobian = slopes(at)
    right = differences(rows)
    assert np.abs(np.vstack([gradient, jacobian]) - right).max() < 1e-10 * np.abs(right).max()
    hessian = np.zeros((layout.size, layout.size))
    hessian[programme.hessian_places] = programme.curvatures(at, cost, multipliers)
    hessian += np.triu(hessian, 1).T
    right = differences(lagrangian)
    assert np.abs(hessian - right).max() < 1e-10 * np.abs(right).max()
