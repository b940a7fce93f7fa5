"""Iterations over nodes that converge slowly go on until steps are solved."""

import symsimpson as ss


def test_slow_iterations_are_solved_to_rounding():
    """Corrections shrink slowly here, and now and then one is larger than the one before."""
    run, exact = (
        ss.compile(ss.systems.henon_heiles(), "gauss8", precision=digits).integrate(
            [0.3, 0.1], v0=[0.1, 0.2], h=2.375, steps=1
        )
        for digits in (None, 40)
    )
    assert abs(run.q - exact.q).max() < 1e-14
    assert abs(run.p - exact.p).max() < 1e-14
