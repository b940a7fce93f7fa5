"""Equations of motion in SymPy and linear ones, against SymPy's mechanics and differences."""

import json

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.driven import van_der_pol
from support.places import DATA
from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

import symsimpson as ss


@pytest.mark.parametrize("name", ["double_pendulum", "cart_pole", "elastic_pendulum"])
def test_equations_are_those_of_lagranges_method(name):
    system = getattr(ss.systems, name)()
    method = LagrangesMethod(system.lagrangian, list(system.coordinates))
    theirs = method.form_lagranges_equations()
    ours = sp.Matrix([one.lhs - one.rhs for one in system.equations])
    assert sp.simplify(ours - theirs) == sp.zeros(system.n, 1)


def test_forces_and_constraints_stand_in_equations():
    system, *_ = van_der_pol()
    (equation,) = system.equations
    assert equation.rhs != 0
    assert equation.lhs.has(system.coordinates[0].diff(ss.time, 2))
    rod = ss.systems.cartesian_pendulum()
    *motion, phi = rod.equations
    assert phi.rhs == 0
    assert phi.lhs == next(iter(rod.constraints.values()))
    assert all("lambda" in str(one.rhs) for one in motion)


STATES = {
    "pendulum": ([0.3], [0.7]),
    "double_pendulum": ([0.3, -1.1], [0.4, 2.0]),
    "driven_cart_pole": ([0.1, 2.0], [0.3, -1.0]),
    "lagrange_top": ([0.0, 1.0, 0.0], [2.0, 0.1, 40.0]),
}


@pytest.mark.parametrize("name", sweep(STATES, 2))
def test_linear_equations_are_differences_of_accelerations(name):
    system = ss.systems.EVERY[name]()
    q, v = map(np.array, STATES[name])
    n, m = system.n, len(system.inputs)
    a = [sp.Dummy() for _ in range(n)]
    twice = {x.diff(ss.time, 2): y for x, y in zip(system.coordinates, a, strict=True)}
    rows = sp.Matrix([(one.lhs - one.rhs).xreplace(twice) for one in system.equations])
    M = rows.jacobian(a)
    rest = rows.subs(dict.fromkeys(a, 0))
    names = [*(x.diff(ss.time) for x in system.coordinates), *system.coordinates]
    dummies = [sp.Dummy() for _ in names]
    swap = list(zip(names, dummies, strict=True))
    function = sp.lambdify(
        [*dummies, *system.inputs],
        [expression.subs(swap).subs(system.parameters) for expression in (M, rest)],
        "numpy",
    )

    def rate(state):
        mass, own = function(*state[n : 2 * n], *state[:n], *state[2 * n :])
        return np.concatenate([state[n : 2 * n], -np.linalg.solve(mass, own)[:, 0]])

    here = np.concatenate([q, v, 0.3 * np.ones(m)])
    steps = 1e-5 * np.eye(2 * n + m)
    slopes = np.array([(rate(here + e) - rate(here - e)) / 2e-5 for e in steps]).T
    given = {"inputs": dict.fromkeys(system.inputs, 0.3)} if m else {}
    A, B = system.linearise(q, v, **given)
    assert A.shape == (2 * n, 2 * n)
    assert B.shape == (2 * n, m)
    assert np.abs(np.hstack([A, B]) - slopes).max() < 1e-6 * np.abs(slopes).max()


def test_constraints_hold_on_in_linear_equations():
    """In space a pendulum's motion is two oscillations; its length adds two zeros."""
    A, B = ss.systems.cartesian_pendulum().linearise([0.0, 0.0, -1.0])
    squares = np.sort(np.linalg.eigvals(A).astype(complex) ** 2)
    assert np.abs(squares - [-9.81, -9.81, -9.81, -9.81, 0, 0]).max() < 1e-12
    assert B.shape == (6, 0)


@pytest.mark.slow
def test_linear_equations_of_a_bicycle():
    """Of the benchmark: the system is large, and has constraints of both kinds."""
    golden = json.loads((DATA / "golden_contact.json").read_text())["exact"]
    (rides,) = (case["eigenvalues"] for case in golden if case["case"] == "whipple_bicycle")
    bicycle, ahead = ss.systems.whipple_bicycle(), np.array([1, 0, 0, 0, 0, 0, -1 / 0.3, -1 / 0.35])
    for speed, pairs in rides.items():
        eigenvalues = np.linalg.eigvals(bicycle.linearise(np.zeros(8), float(speed) * ahead)[0])
        for pair in pairs:
            assert np.abs(eigenvalues - complex(*map(float, pair))).min() < 1e-11
        assert (np.abs(eigenvalues) < 1e-5).sum() == 16 - len(pairs)


@pytest.mark.plain
def test_linear_equations_of_what_rolls_are_those_of_differences():
    """Of neighbouring runs, a little before and after, none of which is a steady motion."""
    disc = ss.systems.rolling_disc()
    stepper, apart, soon = ss.compile(disc, "gauss6"), 1e-4, 1e-4
    rng = np.random.default_rng(7)
    q, v = disc.consistent(rng.uniform(-0.3, 0.3, disc.n), rng.uniform(-1, 1, disc.n))
    A, _ = disc.linearise(q, v)
    away = rng.uniform(-1, 1, (2, disc.n))

    def ends(sign):
        start = disc.consistent(*([q, v] + sign * apart * away))
        runs = [stepper.integrate(start[0], v0=start[1], h=h, steps=1) for h in (soon, -soon)]
        return np.hstack(start), np.subtract(*(np.hstack([x.q[-1], x.v[-1]]) for x in runs))

    (above, moved), (below, reached) = ends(1), ends(-1)
    rates = (moved - reached) / (2 * soon)
    assert np.abs(A @ (above - below) - rates).max() < 1e-6 * np.abs(rates).max()


@pytest.mark.slow
def test_a_cart_is_linearised_as_sympy_does():
    system = ss.systems.cart_pole()
    t = dynamicsymbols._t
    method = LagrangesMethod(system.lagrangian, list(system.coordinates))
    method.form_lagranges_equations()
    upright = dict.fromkeys(system.coordinates, 0) | {system.coordinates[1]: sp.pi}
    upright |= {x.diff(t): 0 for x in system.coordinates}
    theirs, *_ = method.linearize(
        q_ind=list(system.coordinates), qd_ind=[x.diff(t) for x in system.coordinates], A_and_B=True
    )
    theirs = np.array(theirs.subs(upright).subs(system.parameters), float)
    A, B = system.linearise({"x": 0.0, system.coordinates[1]: np.pi})
    assert np.abs(A - theirs).max() < 1e-12
    assert B.shape == (4, 0)


@pytest.mark.slow
def test_what_cannot_be_linearised_is_told():
    pendulum = ss.systems.pendulum()
    with pytest.raises(ss.InputError, match="q0 is"):
        pendulum.linearise([0.0, 1.0])
    with pytest.raises(ss.InputError, match="no parameter 'k'"):
        pendulum.linearise([0.0], parameters={"k": 1.0})
    with pytest.raises(ss.InputError, match="q0 does not satisfy the constraints"):
        ss.systems.cartesian_pendulum().linearise([0.0, 0.0, -1.1])
    with pytest.raises(ss.InputError, match="v0 does not satisfy the constraints"):
        ss.systems.cartesian_pendulum().linearise([0.0, 0.0, -1.0], [0.0, 0.0, 0.1])
    with pytest.raises(ss.InputError, match="no finite values"):
        ss.systems.kepler_plane().linearise([0.0, 0.0])
    with pytest.raises(ss.ModelError, match="too long"):
        _ = ss.systems.cloth().equations


def test_names_that_are_offered_are_public():
    assert {"CATALOGUE", "pendulum"} <= set(dir(ss.systems))
    assert not {"annotations", "Callable", "driven", "entry"} & set(dir(ss.systems))
    offered = [name for name in dir(ss.systems.pendulum()) if not name.startswith("_")]
    assert {"equations", "linearise", "retimed"} <= set(offered)
    assert not {"plain", "seconds", "mass_checked", "large"} & set(offered)
    assert "annotations" not in dir(ss)
