"""What steps with constraints keep: order, form, momenta, positions; what mistakes would cost."""

from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.index_one import motion

import symsimpson as ss
from symsimpson.study.analysis.discrete_flow import DiscreteFlow

#: The end, and the steps to it that the order is seen from.
PROBLEMS = {"four_bar": ("0.4", 20), "quaternion_top": ("0.4", 8), "jointed_bodies": ("0.1", 2)}
ORDERS = {
    "midpoint": 2,
    "lobatto2": 2,
    "simpson": 4,
    "gauss4": 4,
    "lobatto6": 6,
    "gauss6": 6,
    "gauss8": 8,
}


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(ORDERS, 3))
@pytest.mark.parametrize("name", sweep(PROBLEMS))
def test_the_order_is_that_without_constraints(name, scheme):
    """Of positions, momenta and the energy, in 40 digits, so that no rounding stands in the way."""
    system, (end, few) = ss.systems.CONSTRAINED[name](), PROBLEMS[name]
    stepper = ss.compile(system, scheme, precision=40)
    states, energies = [], []
    for steps in (few, 2 * few, 4 * few):
        h = sp.Rational(end) / steps
        run = stepper.integrate(**system.reference_state, h=str(h.n(30)), steps=steps)
        states.append(np.concatenate([run.q[-1], run.p[-1]]))
        energies.append(max(abs(run.energy - run.energy[0])))
    changes = [max(abs(a - b)) for a, b in pairwise(states)]
    assert stepper.order == ORDERS[scheme]
    assert abs(np.log2(float(changes[0] / changes[1])) - stepper.order) < 0.15
    assert abs(np.log2(float(energies[1] / energies[2])) - stepper.order) < 0.15


@pytest.mark.parametrize("name", sweep(["cartesian_pendulum", *PROBLEMS, "slider_crank"], 0))
def test_the_motion_is_that_of_the_index_one_equations(name):
    system = ss.systems.CONSTRAINED[name]()
    start = system.reference_state
    run = ss.compile(system, "gauss8").integrate(**start, h=0.01, t_end=1.0)
    exact = motion(system, start["q0"], start["v0"], run.t[::20])
    assert np.abs(run.q[::20] - exact[:, : run.q.shape[1]]).max() < 1e-9
    assert np.abs(run.v[::20] - exact[:, run.q.shape[1] :]).max() < 1e-8


SCHEMES = ["simpson", "gauss4", "midpoint", "lobatto2", "lobatto6", "gauss6", "gauss8", "radau3"]


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(SCHEMES))
@pytest.mark.parametrize("name", sweep(["cartesian_pendulum", "four_bar", "quaternion_top"]))
def test_certificates_pass(name, scheme):
    """Symplectic for displacements that constraints allow, reversible, momenta, orders: all."""
    system = ss.systems.CONSTRAINED[name]()
    certificate = ss.compile(system, scheme).certify(h=0.01)
    assert certificate.passed, certificate
    names = [check.name for check in certificate.checks]
    assert {"constraints", "velocities", "symplectic"} <= set(names)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scheme"),
    [("slider_crank", "simpson"), ("jointed_bodies", "midpoint"), ("tumbling_body", "simpson")],
)
def test_certificates_of_others(name, scheme):
    certificate = ss.compile(ss.systems.CONSTRAINED[name](), scheme).certify(h=0.01)
    assert certificate.passed, certificate


@pytest.mark.slow
def test_certificates_with_friction_and_a_drive():
    """Their order is measured by M v' + Phi^T lambda = ..., solved in many digits."""
    x, y = ss.coordinates("x y")
    c, w = sp.symbols("c w", positive=True)
    system = ss.MechanicalSystem(
        "braked",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y,
        forces={x: sp.cos(w * ss.time) - c * x.diff() ** 3, y: -c * y.diff()},
        parameters={c: 0.2, w: 3.0},
        constraints=[x**2 + y**2 - 1],
    )
    certificate = ss.compile(system).certify([0.6, -0.8], [0.8, 0.6], h=0.02)
    assert certificate.passed, certificate


def solved(rows, u):
    """Newton's method, derivatives by complex steps."""
    for _ in range(12):
        moved = [np.imag(rows(u + 1e-30j * d)) / 1e-30 for d in np.eye(len(u))]
        u = u - np.linalg.solve(np.array(moved).T, np.real(rows(u + 0j)))
    return u


def by_hand(wrong, h, steps, q, p):
    """A pendulum in the plane by Simpson's scheme, written down anew, with one mistake."""
    g = np.array([0.0, -9.81])

    def phi(x):
        return (x @ x - 1) / 2

    def path(start, middle, end, c):
        bends = 4 * middle - 3 * start - end, 2 * start - 4 * middle + 2 * end
        return start + c * bends[0] + c**2 * bends[1]

    for _ in range(steps):

        def rows(u, q=q, p=p):
            middle, end, first, second = u[:2], u[2:4], u[4], u[5]
            v = [(4 * middle - 3 * q - end) / h, (end - q) / h, (q - 4 * middle + 3 * end) / h]
            pull = [first * q, second * (q if wrong == "the force along the start" else middle)]
            row_0 = p - v[0] / 2 - 2 * v[1] / 3 + v[2] / 6 + h * g / 6
            row_1 = 2 * (v[0] - v[2]) / 3 + 2 * h * g / 3
            held = [phi(middle), phi(end)]
            if wrong == "phi at the end alone":
                pull[1], held[0] = 0 * q, second
            if wrong == "one multiplier":
                pull, held[0] = [first * q / 6, 2 * first * middle / 3], second
            if wrong == "at Gauss points":
                r = np.sqrt(3) / 6
                points = [path(q, middle, end, 0.5 - r), path(q, middle, end, 0.5 + r)]
                weight = [(1 - 3 * c + 2 * c**2, 4 * c - 4 * c**2) for c in (0.5 - r, 0.5 + r)]
                forces = [first * points[0], second * points[1]]
                pull = [sum(w[k] * f for w, f in zip(weight, forces, strict=True)) for k in (0, 1)]
                held = [phi(x) for x in points]
            return np.concatenate([row_0 - pull[0], row_1 - pull[1], held])

        guess = np.concatenate([q + h * p / 2, q + h * p, [0, 0]])
        u = solved(rows, guess)
        middle, end, first, second = u[:2], u[2:4], u[4], u[5]
        v = [(4 * middle - 3 * q - end) / h, (end - q) / h, (q - 4 * middle + 3 * end) / h]
        p = -v[0] / 6 + 2 * v[1] / 3 + v[2] / 2 + h * g / 6
        if wrong == "at Gauss points":
            r = np.sqrt(3) / 6
            for c, s in ((0.5 - r, first), (0.5 + r, second)):
                p = p - (2 * c**2 - c) * s * path(q, middle, end, c)
        if wrong != "p as it comes":
            p = p - end * (end @ p) / (end @ end)
        q = end
    return q, p


MISTAKES = [
    "",
    "the force along the start",
    "phi at the end alone",
    "one multiplier",
    "at Gauss points",
    "p as it comes",
]


def pendulum():
    x, y = ss.coordinates("x y")
    return ss.MechanicalSystem(
        "plane_pendulum",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y,
        constraints=[(x**2 + y**2 - 1) / 2],
    )


@pytest.mark.slow
@pytest.mark.parametrize("wrong", MISTAKES)
def test_every_mistake_is_seen(wrong):
    """The scheme written down anew is the product's; with a mistake order or form is lost."""
    system = pendulum()
    q, p = np.array([0.6, -0.8]), np.array([1.6, 1.2])
    exact = motion(system, q, p, [1.0])[-1]
    errors = [
        np.abs(np.concatenate(by_hand(wrong, 1.0 / n, n, q, p)) - exact).max() for n in (20, 40)
    ]
    order = np.log2(errors[0] / errors[1])

    def angle_map(state, h=0.25):
        """One step in the angle and its momentum, in which there is no constraint."""
        theta, spin = state
        start = np.array([np.sin(theta), -np.cos(theta)])
        along = np.array([np.cos(theta), np.sin(theta)])
        end, momentum = by_hand(wrong, h, 1, start, spin * along)
        return np.array([np.arctan2(end[0], -end[1]), momentum @ np.array([-end[1], end[0]])])

    z, small = np.array([0.6435, 2.0]), 1e-5
    columns = [(angle_map(z + d) - angle_map(z - d)) / (2 * small) for d in small * np.eye(2)]
    area = abs(np.linalg.det(np.array(columns)) - 1)
    if wrong == "":
        assert abs(order - 4) < 0.2
        assert area < 1e-8
        run = ss.compile(system).integrate(q, p0=p, h=0.05, steps=20)
        ends = np.concatenate(by_hand("", 0.05, 20, q, p))
        assert np.abs(np.concatenate([run.q[-1], run.p[-1]]) - ends).max() < 1e-11
    else:
        assert order < 3.5 or area > 1e-6


def test_the_last_part_of_p_moves_nothing():
    """What constraints would take from p has no effect on the motion, but is refused as a start."""
    stepper = ss.compile(pendulum())
    q, p = np.array([0.6, -0.8]), np.array([1.6, 1.2])
    first = stepper.integrate(q, p0=p, h=0.05, steps=20)
    second = stepper.integrate(q, p0=p + 3e-10 * q, h=0.05, steps=20)
    assert np.abs(first.q - second.q).max() < 1e-14


@pytest.mark.slow
def test_squeezer_at_its_end():
    """The Test Set's problem: its published values are good to nine digits, ours to eleven."""
    system = ss.systems.andrews_squeezer()
    run = ss.compile(system, "gauss8").integrate(**system.reference_state, h=1e-4, t_end=0.03)
    exact = [
        15.81077119516,
        -15.75637105842,
        0.04082224011970,
        -0.5347301163419,
        0.5244099658800,
        0.5347301163419,
        1.048080741042,
    ]
    assert np.abs(run.q[-1] - exact).max() < 1e-10
    assert abs(run.q[-1, 0] - 15.81077119629904) < 5e-9
    assert abs(run.q[-1, 1] + 15.75637105984298) < 5e-9
    lambdas = [98.56687039624109, -6.122688344255662, 0, 0, 0, 0]
    assert np.abs(run.multipliers[0] - lambdas).max() < 1e-10
    assert np.abs(run.energy - run.energy[0]).max() < 1e-8


@pytest.mark.slow
def test_midpoint_keeps_the_energy_of_a_free_body():
    system = ss.systems.tumbling_body()
    run = ss.compile(system, "midpoint").integrate(**system.reference_state, h=0.05, steps=2000)
    assert np.abs(run.energy_error).max() < 1e-13
    for name, values in run.invariants.items():
        assert np.abs(values - values[0]).max() < 2e-13, name
    assert np.abs((run.q**2).sum(axis=1) - 1).max() < 6e-16


def upright(I3=0.4, **start):
    g = sp.Symbol("g", positive=True)
    body = ss.RigidBody("top", inertia=(1, 1, sp.Rational(int(10 * I3), 10)))
    system = ss.MechanicalSystem(
        "upright",
        coordinates=body.coordinates,
        kinetic=body.kinetic,
        potential=g * body.to_space((0, 0, 1))[2],
        constraints=body.constraints,
        parameters={g: 1.0},
    )
    return system, body, body.state(**start)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [400, pytest.param(100_000, marks=pytest.mark.slow)])
def test_a_sleeping_top_stays_upright(steps):
    system, _, (q, v) = upright(angular_velocity=(0, 0, 6.0))
    run = ss.compile(system).integrate(q, v, h=0.05, steps=steps, every=100)
    assert np.abs(run.q[:, 1:3]).max() < 1e-13


@pytest.mark.slow
def test_a_top_passes_the_vertical_at_full_order():
    """At 0.005 rad, where Euler angles have a pole."""
    system, _, (q, v) = upright(angles=(0, 0.3, 0), angular_velocity=(-1.0, 0.012, 4.0))
    ends = [
        ss.compile(system, scheme).integrate(q, v, h=1 / n, steps=n, every=None).q[0]
        for scheme, n in (("gauss8", 200), ("simpson", 20), ("simpson", 40), ("simpson", 80))
    ]
    errors = [np.abs(end - ends[0]).max() for end in ends[1:]]
    assert abs(np.log2(errors[1] / errors[2]) - 4) < 0.15


@pytest.mark.slow
def test_positions_stay_after_a_million_steps():
    system = ss.systems.four_bar()
    run = ss.compile(system).integrate(
        **system.reference_state, h=0.01, steps=1_000_000, every=1000
    )
    assert np.abs(run.constraint_error).max() < 4e-15
    blocks = run.energy[1:].reshape(10, -1).mean(axis=1)
    assert abs(blocks[-1] - blocks[0]) < 1e-6 * abs(run.energy[0])


@pytest.mark.slow
def test_singular_mass_matrices():
    """A massless coordinate that a constraint moves, and SymPy's bodies without J0."""
    x, y = ss.coordinates("x y")
    lever = ss.MechanicalSystem(
        "lever",
        coordinates=(x, y),
        kinetic=x.diff() ** 2 / 2,
        potential=y**2,
        constraints=[y - sp.sin(x)],
    )
    run = ss.compile(lever).integrate([1.0, np.sin(1.0)], v0=[0.0, 0.0], h=0.01, steps=200)
    same = ss.MechanicalSystem(
        "same", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=sp.sin(x) ** 2
    )
    free = ss.compile(same, "gauss8").integrate([1.0], v0=[0.0], h=0.01, steps=200)
    assert np.abs(run["x"] - free["x"]).max() < 1e-7
    flow = DiscreteFlow(ss.compile(lever), {}, 50)
    z = flow.project([1.0, np.sin(1.0), 0.3, 0.0])
    D, E = flow.tangent(z, 0.1)
    J = np.kron([[0, 1], [-1, 0]], np.eye(2, dtype=int)).astype(object)
    assert max(map(abs, (D.T @ J @ D - E.T @ J @ E).ravel())) < 1e-28
