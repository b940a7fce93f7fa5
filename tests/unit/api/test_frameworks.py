"""Functions of runs in JAX and PyTorch: values, derivatives, and vectorised calls."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

pytestmark = pytest.mark.slow
Q, P = np.array([0.8, 1.0]), np.array([0.1, -0.2])


@pytest.fixture(scope="module")
def jax():
    library = pytest.importorskip("jax")
    library.config.update("jax_enable_x64", True)
    return library


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch")


def double_pendulum(**options):
    stepper = ss.compile(ss.systems.double_pendulum(), "gauss4")
    return stepper.function(h=0.05, steps=10, **options)


def conservative():
    return double_pendulum(wrt=("q0", "p0", "l1")), (Q, P, 1.1), True


def velocities():
    return double_pendulum(wrt=("q0", "v0"), every=5), (Q, P), True


def expressions():
    return double_pendulum(of=("q1*v_q2", "p")), (Q, P), False


def forced():
    cart = ss.compile(ss.systems.driven_cart_pole(), "simpson")
    f = cart.function(h=0.05, steps=6, wrt=("u", "q0"), v0=[0.1, 0.2])
    return f, (np.linspace(-1, 1, 6), np.array([0.0, 0.4])), True


def constrained():
    """A pendulum in Cartesian coordinates; gravity and mass keep its initial state consistent."""
    rod = ss.compile(ss.systems.cartesian_pendulum(), "gauss4")
    start = {"q0": [0.6, 0.0, -0.8], "v0": [0.0, 1.0, 0.0]}
    return rod.function(h=0.05, steps=8, wrt=("g", "m"), **start), (9.0, 1.2), False


def retimed():
    system = ss.systems.kepler_plane().retimed("encounters")
    f = ss.compile(system, "gauss4").function(h=0.05, t_end=1.0)
    return f, (np.array([1.0, 0.2]), np.array([0.1, 0.9])), False


def impacts():
    """A ball with drag that hits the ground once."""
    (y,), g = ss.coordinates("y"), sp.Symbol("g", positive=True)
    ball = ss.MechanicalSystem(
        "ball", coordinates=(y,), kinetic=y.diff() ** 2 / 2, potential=g * y,
        parameters={g: 9.8}, forces={y: -y.diff() / 10},
    )  # fmt: skip
    ground = ss.Event(y, name="ground", action=ss.Impact(0.7))
    f = ss.compile(ball, "gauss4").function(h=0.05, steps=7, wrt=("q0", "v0", "g"), events=[ground])
    return f, (np.array([0.3]), np.array([0.1]), 9.0), False


CASES = (conservative, velocities, expressions, forced, constrained, retimed, impacts)


@pytest.mark.parametrize("make", CASES)
def test_jax(make, jax):
    from jax.test_util import check_grads

    f, given, twice = make()
    F, forward = f.to_jax(), None
    values = f(*given)
    for x, y in zip(jax.jit(F)(*given), values, strict=True):
        assert (np.asarray(x) == y).all()
    check_grads(F, given, order=2 if twice else 1, modes=("rev",), eps=1e-5)
    if make is not forced:
        forward = f.to_jax("forward")
        check_grads(forward, given, order=1, modes=("fwd", "rev"), eps=1e-5)
    axes = (0, *[None] * (len(given) - 1))
    many = np.stack([given[0], np.multiply(given[0], 1.001)])
    if make is constrained:
        many = np.array([9.0, 9.1])
    for one, two in zip(jax.vmap(F, axes)(many, *given[1:]), f(many, *given[1:]), strict=True):
        assert (np.asarray(one) == two).all()
    slopes = jax.vmap(jax.jacrev(F), axes)(many, *given[1:])
    blocks = f.jacobian(many, *given[1:])
    for slope, row in zip(slopes, blocks, strict=True):
        assert np.asarray(slope) == pytest.approx(row[0], rel=1e-10, abs=1e-11)
    if forward is not None:
        again = jax.jit(jax.jacfwd(forward))(*given)
        for slope, row in zip(again, f.jacobian(*given), strict=True):
            assert np.asarray(slope) == pytest.approx(row[0], rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("make", CASES)
def test_torch(make, torch):
    f, given, twice = make()
    T = f.to_torch()
    given = [torch.tensor(np.asarray(x), dtype=torch.float64, requires_grad=True) for x in given]
    assert torch.autograd.gradcheck(T, given)
    if twice:
        assert torch.autograd.gradgradcheck(T, given)
    else:
        (slope,) = torch.autograd.grad(T(*given)[0].sum(), given[0], create_graph=True)
        if make is not expressions or not f.arguments:
            with pytest.raises(ss.InputError, match="second derivatives"):
                slope.sum().backward()
    if make is conservative:
        many = [torch.stack([x, 1.001 * x]).detach().requires_grad_() for x in given]
        assert torch.autograd.gradcheck(T, many)
        assert torch.autograd.gradgradcheck(T, (many[0], given[1], many[2]))
        mapped = torch.func.vmap(T, in_dims=(0, None, 0))(many[0], given[1], many[2])
        assert (mapped[0] == T(many[0], given[1], many[2])[0]).all()


def test_what_jax_rejects(jax):
    F = double_pendulum().to_jax()
    with pytest.raises(ss.InputError, match="argument q0 has shape"):
        F(np.zeros(3), P)
    with pytest.raises(ss.InputError, match="takes 2 arguments"):
        F(Q)
    with pytest.raises(ss.InputError, match="mode is 'both'"):
        double_pendulum().to_jax("both")
    jax.config.update("jax_enable_x64", False)
    try:
        for call in (lambda: F(Q, P), double_pendulum().to_jax):
            with pytest.raises(ss.InputError, match="jax_enable_x64"):
                call()
    finally:
        jax.config.update("jax_enable_x64", True)


def test_what_torch_rejects(torch):
    T = double_pendulum(of="q").to_torch()
    q = torch.tensor(Q, dtype=torch.float32, requires_grad=True)
    T(q, torch.zeros(2)).sum().backward()
    assert q.grad.dtype == torch.float32
    with pytest.raises(ss.InputError, match=r"tensor\.cpu\(\)"):
        T(torch.zeros(2, device="meta"), torch.zeros(2))
    with pytest.raises(ss.InputError, match="complex"):
        T(torch.zeros(2, dtype=torch.complex128), torch.zeros(2))


def test_energies(jax):
    system = ss.systems.double_pendulum()
    T, V = system.energies.to_jax()
    run = ss.compile(system).integrate(Q, v0=P, h=0.1, steps=1, parameters={"m1": 2.0})
    more = {"m1": 2.0}
    assert float(T(Q, P, more) + V(Q, more)) == pytest.approx(run.energy[0], rel=1e-14)
    assert np.asarray(jax.grad(T, 1)(Q, P, more)) == pytest.approx(run.p[0], rel=1e-14)
    assert T(np.stack([Q, Q, Q]), P).shape == (3,)
    vortices = ss.systems.point_vortices()
    H, state = vortices.energies.to_jax(), vortices.reference_state
    run = ss.compile(vortices, "gauss4").integrate(**state, h=0.1, steps=1)
    energy = H(np.array(state["q0"]), np.array(state["p0"]))
    assert float(energy) == pytest.approx(run.energy[0], rel=1e-14)
    with pytest.raises(ss.InputError, match="no parameter 'm9'"):
        V(Q, {"m9": 1.0})
