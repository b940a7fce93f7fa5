"""Symplecticity, reversibility, momenta and invariants, with a method that must fail."""

import numpy as np
import pytest
from support.bindings import bind_complex, bind_float
from support.cases import sweep
from support.workspace import begin, state, take_step

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.schemes.composition import COMPOSITIONS
from symsimpson.study.analysis.discrete_flow import DiscreteFlow

PENDULUM = ss.systems.double_pendulum()
TOP = ss.systems.lagrange_top()


def symplectic_defect(D):
    n = D.shape[0] // 2
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return np.abs(D.T @ J @ D - J).max()


def tangent(module, q, p, parameters, h, steps):
    """Derivative of the map by a complex step through the whole Newton solve."""
    z = np.array([*q, *p], dtype=complex)
    n = len(q)
    columns = []
    for k in range(2 * n):
        moved = z.copy()
        moved[k] += 1e-30j
        W = begin(module, moved[:n], moved[n:], parameters, h, dtype=complex)
        for _ in range(steps):
            take_step(module, W, h, iterations=9)
        columns.append(np.imag(state(module, W)) / 1e-30)
    return np.array(columns).T


x, y = ss.coordinates("x y")
#: Constant M, forces of positions alone, a rotational symmetry: every scheme takes it.
CENTRAL = ss.MechanicalSystem(
    "central_force",
    coordinates=[x, y],
    kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
    potential=(x**2 + y**2) / 2 + (x**2 + y**2) ** 2 / 4,
    parameters={},
)
EVEN = range(6, 17, 2)
KINDS = ["simpson", "gauss6", "blanes_moan6"]
FAMILY = [
    "midpoint",
    "lobatto2",
    "gauss4",
    *(f"{k}{n}" for k in ("gauss", "lobatto") for n in EVEN),
]
EVERY = KINDS + [name for name in (*FAMILY, *COMPOSITIONS) if name not in KINDS]
EVERY += ["lobatto_3_3", "lobatto_4_4", "gauss_4_3"]


@pytest.mark.parametrize("scheme", sweep(EVERY, len(KINDS)))
def test_every_scheme_is_symplectic_reversible_and_keeps_momenta(scheme):
    """In 50 digits, at a large step; each scheme that gets a name comes here by itself."""
    flow = DiscreteFlow(ss.compile(CENTRAL, scheme), {}, 50)
    z, h = np.array([0.8, -0.3, 0.4, 0.9]), 0.25
    D, _ = flow.tangent(z, h)
    J = np.kron([[0, 1], [-1, 0]], np.eye(2, dtype=int)).astype(object)
    assert max(map(abs, (D.T @ J @ D - J).ravel())) < 1e-28
    there = flow.run(z, h, 10)
    momentum = there.q[:, 0] * there.p[:, 1] - there.q[:, 1] * there.p[:, 0]
    assert max(abs(momentum - momentum[0])) < 1e-46
    back = flow.advance(np.concatenate([there.q[-1], there.p[-1]]), -h, 10)
    assert max(map(abs, back - z)) < 1e-44


@pytest.mark.parametrize("scheme", sweep(EVERY, len(KINDS)))
def test_every_scheme_compiled(scheme):
    """The compiled steps are those in many digits, and as reversible as rounding allows."""
    stepper = ss.compile(CENTRAL, scheme)
    q0, p0, h = [0.8, -0.3], [0.4, 0.9], 0.0625
    there = stepper.integrate(q0, p0=p0, h=h, steps=200)
    momentum = there.q[:, 0] * there.p[:, 1] - there.q[:, 1] * there.p[:, 0]
    assert np.abs(momentum - momentum[0]).max() < 2e-14
    back = stepper.integrate(there.q[-1], p0=there.p[-1], h=-h, steps=200, every=None)
    assert np.abs(back.q[0] - q0).max() < 2e-13
    many = ss.compile(CENTRAL, scheme, precision=66, arithmetic="arb")
    exact = many.integrate(q0, p0=p0, h=h, steps=20, every=None)
    assert np.abs((exact.q[0] - there.q[20]).astype(float)).max() < 2e-15


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "gauss4", "lobatto6"]))
@pytest.mark.parametrize(("system", "h"), [(PENDULUM, 0.1), (TOP, 0.05)], ids=["pendulum", "top"])
def test_one_step_is_symplectic(system, h, scheme):
    module = bind_complex(source(system, scheme))
    parameters = list(system.parameters.values())
    if system is PENDULUM:
        q, p = [0.7, -1.1], [0.9, -0.25]
    else:  # units in which the momenta are of order one: 1/g instead of kg
        q, p = [0.0, np.pi / 3, 0.0], [32.1145, 0.5, 32.075]
        parameters = [
            a * (1000 if str(k) in ("m_top", "I", "I3") else 1)
            for k, a in system.parameters.items()
        ]
    D = tangent(module, q, p, parameters, h, 1)
    assert symplectic_defect(D) < 1e-13 * max(1.0, np.abs(D).max())


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint"]))
def test_a_hundred_steps_are_symplectic(scheme):
    module = bind_complex(source(PENDULUM, scheme))
    D = tangent(module, [0.7, -1.1], [0.2, -0.1], PENDULUM.parameters.values(), 0.05, 100)
    assert symplectic_defect(D) < 1e-13 * np.abs(D).max() ** 2


def printed_simpson_residual(system, z, q0, p0, h, parameters):
    """Simpson's scheme with F_q as printed in the paper: h/12 and h/6 for h/24 and h/12."""
    import sympy as sp

    q = sp.symbols("u:2", real=True)
    M = system.plain.mass.xreplace(dict(zip(system.plain.q, q, strict=True)))
    V = system.plain.to_sympy(system.plain.V).xreplace(dict(zip(system.plain.q, q, strict=True)))
    values = dict(zip(system.plain.parameters, parameters, strict=True))
    M, V = M.xreplace(values), V.xreplace(values)
    dM = [sp.lambdify(q, M.diff(x)) for x in q]
    dV, mass = [sp.lambdify(q, V.diff(x)) for x in q], sp.lambdify(q, M)

    def equations(z):
        qm, q1, p1 = z[:2], z[2:4], z[4:]
        g = [(-3 * q0 + 4 * qm - q1) / h, (q1 - q0) / h, (q0 - 4 * qm + 3 * q1) / h]
        at = [q0, qm, q1]
        Mg = [np.array(mass(*x)) @ v for x, v in zip(at, g, strict=True)]
        Q = [np.array([v @ np.array(d(*x)) @ v for d in dM]) for x, v in zip(at, g, strict=True)]
        dv = [np.array([d(*x) for d in dV]) for x in at]
        middle = 2 / 3 * (Mg[0] - Mg[2]) + h / 3 * Q[1] - 2 * h / 3 * dv[1]
        force = [Qi / 2 - d for Qi, d in zip(Q, dv, strict=True)]
        momentum = p1 - p0 - h / 6 * (force[0] + 4 * force[1] + force[2])
        mean = (Mg[0] + 4 * Mg[1] + Mg[2]) / 6
        printed = (
            h * mean - h / 2 * (p1 + p0) + h**2 / 12 * (Q[2] - Q[0]) - h**2 / 6 * (dv[2] - dv[0])
        )
        return np.concatenate([middle, momentum, printed])

    return equations(z)


@pytest.mark.slow
def test_the_printed_formula_is_not_symplectic():
    """The negative control: a defect that the test above would catch."""
    h, parameters = 0.1, list(PENDULUM.parameters.values())

    def step(z0):
        q0, p0 = z0[:2], z0[2:]
        z = np.concatenate([q0, q0, p0])
        for _ in range(60):
            R = printed_simpson_residual(PENDULUM, z, q0, p0, h, parameters)
            J = np.array(
                [
                    (
                        printed_simpson_residual(PENDULUM, z + d, q0, p0, h, parameters)
                        - printed_simpson_residual(PENDULUM, z - d, q0, p0, h, parameters)
                    )
                    / 2e-6
                    for d in 1e-6 * np.eye(6)
                ]
            ).T
            z = z - np.linalg.solve(J, R)
            if np.abs(R).max() < 1e-13:
                break
        return z[2:]

    stepper = ss.compile(PENDULUM)

    def derived(z0):
        return np.concatenate(stepper.step(z0[:2], p=z0[2:], h=h))

    z = np.array([np.pi / 4, np.pi / 3, 0.0, 0.0])
    defects = []
    for method in (step, derived):
        D = [(method(z + d) - method(z - d)) / 2e-4 for d in 1e-4 * np.eye(4)]
        defects.append(symplectic_defect(np.array(D).T))
    assert defects[0] > 1e-2
    assert defects[1] < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint"]))
@pytest.mark.parametrize(
    ("system", "h", "steps", "threshold"),
    [
        (PENDULUM, 0.05, 100, 1e-13),
        (PENDULUM, 0.05, 10_000, 1e-10),
        (TOP, 0.05, 37, 1e-11),
        (TOP, 0.05, 3700, 1e-8),
    ],
    ids=["pendulum", "pendulum long", "top", "top long"],
)
def test_reversibility(system, h, steps, threshold, scheme):
    stepper = ss.compile(system, scheme)
    there = stepper.integrate(**system.reference_state, h=h, steps=steps)
    back = stepper.integrate(there.q[-1], p0=there.p[-1], h=-h, steps=steps, every=None)
    scale = np.maximum(1.0, np.abs(there.q).max(axis=0))
    assert np.abs((back.q[0] - there.q[0]) / scale).max() < threshold
    assert np.abs(back.p[0] - there.p[0]).max() < threshold * max(1.0, np.abs(there.p[0]).max())
    flipped = stepper.integrate(there.q[-1], p0=-there.p[-1], h=h, steps=steps, every=None)
    assert np.abs((flipped.q[0] - there.q[0]) / scale).max() < threshold


CYCLIC = {
    "lagrange_top": (0, 2),
    "spherical_pendulum": (1,),
    "cart_pole": (0,),
    "kepler": (1,),
    "rigid_body": (0,),
    "heavy_top": (0,),
    "torus_geodesic": (1,),
}


@pytest.mark.parametrize("name", sweep(CYCLIC, 2))
@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint"]))
def test_cyclic_momenta_do_not_change(name, scheme):
    system = ss.systems.CATALOGUE[name]()
    run = ss.compile(system, scheme).integrate(**system.reference_state, h=0.01, steps=2000)
    for i in CYCLIC[name]:
        assert system.coordinates[i].func.__name__ in system.structure.cyclic
        assert np.abs(run.p[:, i] - run.p[0, i]).max() <= 1e-13 * abs(run.p[0, i])


@pytest.mark.parametrize("name", sweep(ss.systems.CATALOGUE, 2))
def test_invariants_are_kept_to_the_order_of_the_scheme(name):
    system = ss.systems.CATALOGUE[name]()
    stepper = ss.compile(system)
    size, errors = 0.0, []
    for h in (0.01, 0.005):
        run = stepper.integrate(**system.reference_state, h=h, steps=round(1 / h))
        watched = {"energy": run.energy, **run.invariants}
        size = max(np.abs(v).max() for v in watched.values())
        errors.append([np.abs(v - v[0]).max() for v in watched.values()])
    for coarse, fine in zip(*errors, strict=True):
        assert fine < max(coarse / 10, 1e-12 * size)


@pytest.mark.slow
def test_energy_has_no_drift():
    """Block means over 200 000 steps stay within round-off of each other."""
    stepper = ss.compile(PENDULUM)
    run = stepper.integrate(**PENDULUM.reference_state, h=0.1 / 64, steps=200_000)
    means = run.energy_error.reshape(-1)[1:].reshape(8, -1).mean(axis=1)
    slope = np.polyfit(np.arange(8), means, 1)[0]
    assert abs(slope) < 2e-13


def test_newton_takes_few_iterations():
    for system, h, most in ((PENDULUM, 0.02, 2.3), (TOP, 0.01, 2.1)):
        run = ss.compile(system).integrate(**system.reference_state, h=h, steps=1000)
        assert run.newton_iterations.sum() / run.steps <= most


def test_plain_and_compiled_steps_have_the_same_rounding():
    module = bind_float(source(PENDULUM, "simpson"))
    q, p = PENDULUM.reference_state["q0"], PENDULUM.reference_state["p0"]
    W = begin(module, q, p, PENDULUM.parameters.values(), 0.05)
    for _ in range(50):
        take_step(module, W, 0.05, iterations=6)
    run = ss.compile(PENDULUM).integrate(q, p0=p, h=0.05, steps=50)
    assert np.abs(np.array(state(module, W)) - [*run.q[-1], *run.p[-1]]).max() < 1e-14
