"""Functions of runs: values as those of runs, exact derivatives, and arguments that are checked."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import mpmath as mp
import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.errors import ResolutionWarning

Q, P = np.array([0.8, 1.0]), np.array([0.1, -0.2])


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(ss.systems.double_pendulum(), "simpson")


def rows(value, count, generator):
    """Return ``count`` values near one."""
    value = np.asarray(value, float)
    return value * (1 + 0.01 * generator.standard_normal((count, *value.shape)))


def test_values_are_those_of_runs(stepper):
    f = stepper.function(h=0.02, steps=20, of=("p", "q", "q1*v_q2"), wrt=("q0", "p0", "l1"))
    for l1 in (1.0, 1.1, 1.1):  # the first call, one of other parameters, and the same again
        p, q, x = f(Q, P, l1)
        run = stepper.integrate(Q, p0=P, h=0.02, steps=20, parameters={"l1": l1})
        assert (q == run.q[-1]).all()
        assert (p == run.p[-1]).all()
        assert x == pytest.approx(run["q1"][-1] * run["v_q2"][-1], rel=1e-15)
    along = stepper.function(h=0.02, steps=20, of="q", every=5)
    for _ in range(2):
        every = stepper.integrate(Q, p0=P, h=0.02, steps=20, every=5)
        assert (along(Q, P) == every.q).all()
    (_, q, _), status = f(Q, P, 1.1, full=True)
    assert status is ss.Status.SUCCESS
    assert repr(f).startswith("RunFunction(double_pendulum, simpson: (q0, p0, l1) -> (p, q, q1")


def test_arguments_are_converted_or_rejected(stepper):
    f = stepper.function(h=0.02, steps=3, wrt=("q0", "p0", "l1"))
    truth = f(Q, P, 1.0)
    for again in (f(list(Q), P, 1), f(Q, P, np.float32(1)), f(Q, P, np.ones(()))):
        assert all((x == y).all() for x, y in zip(truth, again, strict=True))
    single = f(Q.astype(np.float32), P, 1.0)
    double = f(Q.astype(np.float32).astype(float), P, 1.0)
    assert all((x == y).all() for x, y in zip(single, double, strict=True))
    assert (f(np.array([1, 2]), P, 1.0)[0] == f(np.array([1.0, 2.0]), P, 1.0)[0]).all()
    for bad in (np.array([np.nan, 1.0]), np.array([np.inf, 1.0]), Q + 0j, np.zeros(3), 1.0, "a"):
        with pytest.raises(ss.InputError, match="argument q0"):
            f(bad, P, 1.0)
    for bad in (np.nan, -1.0, 0.0, 1j, [1.0, 2.0, np.nan]):
        with pytest.raises(ss.InputError, match="argument l1"):
            f(Q, P, bad)
    with pytest.raises(ss.InputError, match="takes 3 arguments"):
        f(Q, P)
    with pytest.raises(ss.InputError, match="has 2 members, but another has 3"):
        f(np.stack([Q] * 2), np.stack([P] * 3), 1.0)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"wrt": "p0"}, "no initial positions"),
        ({"wrt": "q0"}, "neither initial velocities nor momenta"),
        ({"wrt": ("q0", "vo")}, "wrt contains 'vo'"),
        ({"wrt": ("q0", "v0", "p0")}, "exactly one of v0 and p0"),
        ({"wrt": ("q0", "p0", "l3")}, "wrt contains 'l3'"),
        ({"wrt": "q0, v0"}, "Pass a tuple of names"),
        ({"wrt": ("q0", "p0", "l1", "l1")}, "'l1' twice"),
        ({"wrt": (), "q0": Q, "p0": P}, "wrt is empty"),
        ({"of": ()}, "of is empty"),
        ({"of": "q3"}, "unknown name 'q3'"),
        ({"q0": Q}, "both an argument"),
        ({"steps": None}, "exactly one of t_end and steps"),
    ],
)
def test_what_makes_no_function(stepper, wrong, text):
    with pytest.raises(ss.InputError, match=text):
        stepper.function(**{"h": 0.1, "steps": 3} | wrong)


def test_derivatives(stepper):
    generator = np.random.default_rng(1)
    f = stepper.function(
        h=0.02, steps=8, of=("q", "p", "q1*v_q2*l1"), every=4, wrt=("q0", "v0", "l1", "g")
    )
    given = Q, P, 1.1, 9.0
    values, jacobian = f(*given), f.jacobian(*given)
    weights = [generator.standard_normal(x.shape) for x in values]
    along = [generator.standard_normal(np.shape(x)) for x in given]
    _, changes = f.jvp(given, along)
    _, slopes = f.vjp(given, weights)
    left = sum((w * x).sum() for w, x in zip(weights, changes, strict=True))
    right = sum((w * x).sum() for w, x in zip(slopes, along, strict=True))
    assert left == pytest.approx(right, rel=1e-12)
    for j, slope in enumerate(slopes):
        whole = sum(
            np.tensordot(w, row[j], w.ndim) for w, row in zip(weights, jacobian, strict=True)
        )
        assert slope == pytest.approx(whole, rel=1e-11, abs=1e-12)
    end = stepper.function(h=0.02, steps=8, of="q1*v_q2*l1", wrt=("q0", "v0", "l1", "g"))
    found = stepper.gradient(
        Q, P, h=0.02, steps=8, cost="q1*v_q2*l1", wrt=("q", "v", "l1", "g"),
        parameters={"l1": 1.1, "g": 9.0},
    )  # fmt: skip
    pairs = zip(end.vjp(given, 1.0)[1], found.parts.values(), strict=True)
    assert all(x == pytest.approx(y, rel=1e-14, abs=1e-14) for x, y in pairs)


@pytest.mark.slow
def test_members(stepper):
    generator = np.random.default_rng(2)
    f = stepper.function(h=0.02, steps=30, of=("q", "q1*p_q2"), wrt=("q0", "p0", "l1"))
    q, l1 = rows(Q, 5, generator), rows(1.0, 5, generator)
    values, jacobian = f(q, P, l1), f.jacobian(q, P, l1)
    weights = [generator.standard_normal(x.shape) for x in values]
    along = generator.standard_normal((5, 2)), np.array([0.5, -1.0]), np.ones(5)
    _, changes = f.jvp((q, P, l1), along)
    _, slopes = f.vjp((q, P, l1), weights)
    total = np.zeros(2)
    for k in range(5):
        one = q[k], P, l1[k]
        assert all((x[k] == y).all() for x, y in zip(values, f(*one), strict=True))
        for row, row_of_one in zip(jacobian, f.jacobian(*one), strict=True):
            for x, y in zip(row, row_of_one, strict=True):
                assert x[k] == pytest.approx(y, rel=1e-12, abs=1e-13)
        _, change = f.jvp(one, (along[0][k], along[1], 1.0))
        assert all(x[k] == pytest.approx(y) for x, y in zip(changes, change, strict=True))
        _, slope = f.vjp(one, [w[k] for w in weights])
        assert slopes[0][k] == pytest.approx(slope[0], rel=1e-11)
        assert slopes[2][k] == pytest.approx(slope[2], rel=1e-11)
        total += slope[1]
    assert slopes[1] == pytest.approx(total, rel=1e-11)


@pytest.mark.slow
def test_failures(stepper):
    g = ss.compile(ss.systems.double_pendulum(), "simpson").function(h=80.0, steps=40, of="q")
    with pytest.warns(ss.StabilityWarning), pytest.raises(ss.ConvergenceError):
        g(Q, 1e6 * P)
    value, status = g(Q, 1e6 * P, full=True)
    assert np.isnan(value).all()
    assert status is not ss.Status.SUCCESS
    many = np.stack([0 * P, 1e6 * P])
    with pytest.warns(ResolutionWarning, match="1 of 2 members failed"):
        values = g(np.zeros(2), many)
    assert np.isnan(values).all(axis=1).tolist() == [False, True]
    _, statuses = g(np.zeros(2), many, full=True)
    assert (statuses != 0).tolist() == [False, True]


@pytest.mark.slow
def test_threads_at_the_same_time(stepper):
    f = stepper.function(h=0.01, steps=200)
    starts = rows(Q, 40, np.random.default_rng(3))
    truth = [f(q, P)[0] for q in starts]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda q: f(q, P)[0], [*starts] * 20))
    assert all((x == truth[k % 40]).all() for k, x in enumerate(found))


def pendulum_in_wind():
    """A pendulum with drag and an input, and the time in its potential."""
    (x,), u, c = ss.coordinates("x"), sp.Symbol("u"), sp.Symbol("c")
    return ss.MechanicalSystem(
        "pendulum_in_wind",
        coordinates=(x,),
        kinetic=x.diff() ** 2 * (2 + sp.cos(x)) / 2,
        potential=-sp.cos(x) * (1 + sp.sin(ss.time) / 5),
        parameters={c: 0.2},
        forces={x: u * sp.cos(x) - c * x.diff() ** 3},
        inputs=(u,),
    )


SHAPES = {"steps": (6,), "nodes": (6, 3), "number": (), "samples": (3,)}


@pytest.mark.slow
@pytest.mark.parametrize("kind", SHAPES)
def test_inputs(kind):
    generator, stepper = np.random.default_rng(4), ss.compile(pendulum_in_wind(), "simpson")
    u = generator.standard_normal(SHAPES[kind])
    template = None if kind == "steps" else {"u": u}
    if kind == "samples":
        template = {"u": ss.samples(u, period=0.2)}
    given = {"h": 0.1, "steps": 6}
    f = stepper.function(**given, of=("q", "p"), wrt=("q0", "v0", "u", "c"), inputs=template)
    x = [0.3], [0.2], u, 0.3
    for _ in range(2):
        inputs = template or {"u": u}
        run = stepper.integrate(x[0], x[1], **given, inputs=inputs, parameters={"c": 0.3})
        assert all((a == b).all() for a, b in zip(f(*x), (run.q[-1], run.p[-1]), strict=True))
    weights, along = ([1.0], [-0.5]), ([0.5], [1.0], generator.standard_normal(u.shape), -0.3)
    _, slopes = f.vjp(x, weights)
    _, changes = f.jvp(x, along)
    left = sum(np.sum(np.multiply(w, c)) for w, c in zip(weights, changes, strict=True))
    assert left == pytest.approx(
        sum(np.sum(np.multiply(s, d)) for s, d in zip(slopes, along, strict=True)), rel=1e-12
    )
    found = stepper.gradient(
        *x[:2], **given, cost="x - p_x/2", wrt=("q", "v", "u", "c"), inputs=inputs,
        parameters={"c": 0.3},
    )  # fmt: skip
    for slope, part in zip(slopes, found.parts.values(), strict=True):
        assert slope == pytest.approx(part, rel=1e-14, abs=1e-15)
    both, product = f.hvp(x, weights, along)
    for slope, part in zip(slopes, both, strict=True):
        assert slope == pytest.approx(part, rel=1e-12, abs=1e-13)
    size = 1e-4
    differences = [
        (8 * (a - b) - (c - d)) / (12 * size)
        for a, b, c, d in zip(
            *(
                f.vjp(
                    tuple(
                        np.add(y, k * size * np.asarray(d)) for y, d in zip(x, along, strict=True)
                    ),
                    weights,
                )[1]
                for k in (1, -1, 2, -2)
            ),
            strict=True,
        )
    ]
    for difference, part in zip(differences, product, strict=True):
        assert part == pytest.approx(difference, rel=1e-7, abs=1e-9)
    many = f(np.array([[0.3], [0.4]]), [0.2], u, np.array([0.3, 0.2]))
    assert (many[0][0] == f(*x)[0]).all()
    blocks = f.jacobian(np.array([[0.3], [0.4]]), [0.2], u, np.array([0.3, 0.2]))
    assert blocks[0][2].shape == (2, 1, *u.shape)
    assert blocks[0][2][0] == pytest.approx(f.jacobian(*x)[0][2], rel=1e-12)


CASES = {
    "conservative": (ss.systems.double_pendulum, "gauss8", Q, P, ("q0", "p0", "l1", "g")),
    "velocities": (ss.systems.double_pendulum, "simpson", Q, P, ("q0", "v0", "m1")),
    "damped": (ss.systems.damped_pendulum, "gauss4", [1.0], [0.3], ("q0", "p0", "l")),
    "cyclic": (ss.systems.lagrange_top, "simpson", None, None, ("q0", "v0")),
    "hamiltonian": (ss.systems.point_vortices, "gauss4", None, None, ("q0", "p0")),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_gradients_against_fifty_digits(case):
    make, scheme, q, other, wrt = CASES[case]
    system = make()
    stepper, exact = ss.compile(system, scheme), ss.compile(system, scheme, precision=50)
    if q is None:
        q, other = (system.reference_state[x] for x in wrt)
    values = [float(system.parameters[sp.Symbol(x, positive=True)]) for x in wrt[2:]]
    h, steps = (0.05 if case != "cyclic" else 0.001), 12
    f = stepper.function(h=h, steps=steps, wrt=wrt)
    g = exact.function(h=h, steps=steps, wrt=wrt)
    given = [np.asarray(q, float), np.asarray(other, float), *values]
    blocks = f.jacobian(*given)
    with mp.workdps(50):
        for j, value in enumerate(given):
            flat = [mp.mpf(float(x)) for x in np.ravel(value)]
            for k in range(len(flat)):
                ends = []
                for sign in (1, -1):
                    moved = [x + sign * mp.mpf(10) ** -15 * (i == k) for i, x in enumerate(flat)]
                    point = [list(map(mp.mpf, map(float, np.ravel(x)))) for x in given]
                    point[j] = moved
                    ends.append(
                        g(*(x if np.ndim(y) else x[0] for x, y in zip(point, given, strict=True)))
                    )
                for block, up, down in zip((row[j] for row in blocks), *ends, strict=True):
                    truth = np.array(
                        [(a - b) / (2 * mp.mpf(10) ** -15) for a, b in zip(up, down, strict=True)],
                        float,
                    )
                    column = block[:, k] if np.ndim(value) else block
                    scale = max(1.0, abs(truth).max())
                    assert abs(column - truth).max() < 1e-12 * scale


@pytest.mark.slow
def test_derivatives_of_failed_members_are_nan(stepper):
    f = stepper.function(h=0.1, steps=50, of="q", wrt=("q0", "p0", "g"))
    given = np.array([[0.1, 0.1], [1.0, 2.0]]), np.array([[0.0, 0.0], [1e6, -1e6]]), 9.81
    _, status = f(*given, full=True)
    assert (status != 0).tolist() == [False, True]
    blocks = f.jacobian(*given)
    assert all(np.isfinite(x[0]).all() and np.isnan(x[1]).all() for x in blocks)
    _, (by_q, _, by_g) = f.vjp(given, np.ones((2, 2)))
    assert np.isfinite(by_q[0]).all()
    assert np.isnan(by_g)


@pytest.mark.slow
def test_retimed_steps_are_differentiated_at_fixed_tau():
    system = ss.systems.kepler_plane().retimed("encounters")
    stepper, name = ss.compile(system, "gauss8"), "mu"
    given = {"h": 0.3, "q0": [1.6, 0.0], "p0": [0.0, 0.5], "wrt": name, "of": "q"}
    for length in ({"steps": 12}, {"t_end": 4.0}):
        f = stepper.function(**given, **length)
        difference = (f(1 + 1e-5) - f(1 - 1e-5)) / 2e-5
        assert f.jacobian(1.0) == pytest.approx(difference, rel=1e-7)
    with pytest.raises(ss.InputError, match="derivatives of this output"):
        stepper.function(**given | {"of": "x*y"}, steps=12).jacobian(1.0)


@pytest.mark.slow
def test_samples_that_are_as_many_as_the_steps():
    u, stepper = np.arange(6.0), ss.compile(pendulum_in_wind(), "simpson")
    template = {"u": ss.samples(np.zeros(6), period=0.2)}
    f = stepper.function(h=0.1, steps=6, wrt="u", q0=[0.3], v0=[0.2], inputs=template)
    values = [f(u)[0] for _ in range(3)]
    inputs = {"u": ss.samples(u, period=0.2)}
    run = stepper.integrate([0.3], [0.2], h=0.1, steps=6, inputs=inputs)
    assert all((x == run.q[-1]).all() for x in values)


@pytest.mark.slow
def test_copies(stepper):
    f = stepper.function(h=0.02, steps=20, of="q", wrt="l1", q0=Q, v0=P)
    truth = [f(x) for x in (1.0, 1.0, 1.2)]
    for g in (copy.deepcopy(f), pickle.loads(pickle.dumps(f))):
        assert all((g(x) == y).all() for x, y in zip((1.0, 1.0, 1.2), truth, strict=True))


@pytest.mark.slow
def test_a_coordinate_with_the_name_of_a_vector():
    q, r = ss.coordinates("q r")
    kinetic = (q.diff() ** 2 + r.diff() ** 2 * (1 + q**2)) / 2
    system = ss.MechanicalSystem(
        "named_q", coordinates=(q, r), kinetic=kinetic, potential=sp.cos(q) * r + r**2 / 2
    )
    f = ss.compile(system).function(h=0.1, steps=5, of="q", wrt=("q0", "v0"))
    assert f([0.3, 0.2], [0.1, 0.1]).shape == ()
    with pytest.raises(ss.InputError, match="second derivatives"):
        f.hvp(([0.3, 0.2], [0.1, 0.1]), 1.0, ([1.0, 0.0], [0.0, 0.0]))


@pytest.mark.parametrize("shape", [(6, 1), (1, 6), (1, 6, 3), (5,)])
def test_templates_of_other_shapes_are_rejected(shape):
    stepper = ss.compile(pendulum_in_wind(), "simpson")
    with pytest.raises(ss.InputError, match="input u ha"):
        stepper.function(h=0.1, steps=6, wrt=("q0", "v0", "u"), inputs={"u": np.zeros(shape)})
