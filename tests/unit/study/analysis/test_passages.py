"""A damped spherical pendulum on a cart passes 7e-5 rad from the pole of its angles."""

import warnings

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.study.analysis.stability.passages import regular_box

SYMBOLS = M, m, l, g, c, d = sp.symbols("M m l g c d")
VALUES = dict(zip(SYMBOLS, (2.0, 1.0, 0.5, 9.81, 0.3, 0.02), strict=True))
STEPS = [
    (scheme, h)
    for h in (0.005, 0.02, 0.01, 0.002, 0.001)
    for scheme in ("gauss8", "simpson", "midpoint")
]


def with_angles():
    s, theta, phi = ss.coordinates("s theta phi")
    arm = l * sp.Matrix([sp.sin(theta) * sp.cos(phi), sp.sin(theta) * sp.sin(phi), -sp.cos(theta)])
    turning = theta.diff() ** 2 + sp.sin(theta) ** 2 * phi.diff() ** 2
    return declared("angles", s, arm, (theta, phi), turning)


def held():
    s, x, y, z = ss.coordinates("s x y z")
    arm = sp.Matrix([x, y, z])
    v = arm.diff(ss.time)
    return declared("held", s, arm, (x, y, z), v.dot(v) / l**2, (arm.dot(arm) - l**2,))


def declared(name, s, arm, coordinates, turning, constraints=()):
    v = arm.diff(ss.time) + sp.Matrix([s.diff(), 0, 0])
    return ss.MechanicalSystem(
        name,
        coordinates=(s, *coordinates),
        parameters=VALUES,
        constraints=constraints,
        kinetic=M * s.diff() ** 2 / 2 + m * v.dot(v) / 2,
        potential=m * g * arm[2],
        dissipation=c * s.diff() ** 2 / 2 + d * turning / 2,
    )


@pytest.fixture(scope="module")
def right():
    """Where the bob is at t = 20, by coordinates that have no pole, which agree in two orders."""
    theta, phi, turn, round_it = 0.8, 0.1, 0.3, 2.0
    out = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)])
    up = np.array([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta)])
    across = np.sin(theta) * np.array([-np.sin(phi), np.cos(phi), 0.0])
    bobs = []
    for scheme in ("gauss8", "gauss12"):
        run = ss.compile(held(), scheme).integrate(
            [0.0, *0.5 * out], v0=[0.0, *0.5 * (turn * up + round_it * across)], h=0.005, t_end=20.0
        )
        bobs.append(run.q[-1, 1:] + np.array([run.q[-1, 0], 0.0, 0.0]))
    assert np.abs(bobs[1] - bobs[0]).max() < 1e-9
    assert np.abs(bobs[0] - [0.15682706, -0.02494533, -0.49424493]).max() < 1e-8
    return bobs[1]


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "h"), STEPS)
def test_no_bob_elsewhere_is_a_success_without_a_word(right, scheme, h):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        run = ss.compile(with_angles(), scheme).integrate(
            [0.0, 0.8, 0.1], v0=[0.0, 0.3, 2.0], h=h, t_end=20.0, on_failure="return"
        )
    s, theta, phi = run.q[-1]
    bob = 0.5 * np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)])
    off = np.abs(bob + np.array([s, 0.0, 0.0]) - right).max()
    if not run.success:
        assert run.status is ss.Status.COORDINATE_SINGULARITY
        assert "Use coordinates that are regular there, such as Cartesian" in run.message
        assert "near theta=" in run.message
    elif off > {"midpoint": 1000}.get(scheme, 1) * h**2:  # errors that shrink as they should
        assert "singular point of the coordinates" in str(told[0].message)
        assert "near theta=" in run.message


@pytest.mark.slow
def test_a_wide_passage_is_passed_in_silence():
    run = ss.compile(with_angles(), "gauss8").integrate(
        [0.0, 0.8, 0.1], v0=[0.0, 0.3, 2.0], h=0.005, t_end=2.0
    )
    assert run.success


def bead_with_pendulum():
    """A bead on a parabola, y = kappa x^2/2, which carries a pendulum: M is definite everywhere."""
    x, theta = ss.coordinates("x theta")
    kappa = sp.Symbol("kappa", positive=True)
    bead = sp.Matrix([x, kappa * x**2 / 2])
    bob = bead + sp.Rational(7, 10) * sp.Matrix([sp.sin(theta), -sp.cos(theta)])
    slow, fast = bead.diff(ss.time), bob.diff(ss.time)
    return ss.MechanicalSystem(
        "bead_with_pendulum",
        coordinates=(x, theta),
        parameters={kappa: 0.8, m: 0.5},
        kinetic=(slow.dot(slow) + m * fast.dot(fast)) / 2,
        potential=9.81 * (bead[1] + m * bob[1]),
    )


def test_light_bodies_and_sharp_bends_are_no_singular_points():
    """Where det M is small and never 0, other coordinates are no help, and smaller steps are."""
    stepper = ss.compile(bead_with_pendulum())
    failed = stepper.integrate(
        [0.5, -1.0], v0=[0, 0], h=0.03, steps=40, parameters={m: 1000.0}, on_failure="return"
    )
    assert failed.status is ss.Status.STEP_TOO_LARGE
    assert "try a smaller h" in failed.message
    given = {"h": 0.01, "t_end": 6.0, "parameters": {"kappa": 80.0}}
    with pytest.warns(ss.ResolutionWarning, match=r"(?s)its inertia is small.*Use a smaller h"):
        stepper.integrate([1.0, 0.3], v0=[0, 0], **given)


@pytest.mark.parametrize(("inertia", "regular"), [(4.0, False), (3.99, False), (5.0, True)])
def test_no_box_is_regular_whose_corners_are_not(inertia, regular):
    """In four coordinates, corners are a small part of a box: random states do not come there."""
    *x, z = ss.coordinates("x1 x2 x3 x4 z")
    system = ss.MechanicalSystem(
        "corners",
        coordinates=(*x, z),
        parameters={M: inertia},
        kinetic=sum(y.diff() ** 2 for y in x) / 2 + (M - sum(y**2 for y in x)) * z.diff() ** 2 / 2,
        potential=sum(y**2 for y in x),
    )
    box = np.array([[-1.0] * 5, [1.0] * 5])
    found = regular_box(system, [inertia], *box, 0.0)
    assert np.array_equal(found, box) if regular else found is None
