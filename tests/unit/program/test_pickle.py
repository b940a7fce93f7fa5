"""Systems, steppers and what they computed go through pickle and copy."""

import copy
import multiprocessing
import pickle
import warnings
from concurrent.futures import ProcessPoolExecutor

import pytest
from support.cases import sweep

import symsimpson as ss
import symsimpson.errors


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
@pytest.mark.parametrize("name", sweep(["kepler", "double_pendulum", "lagrange_top"]))
def test_what_comes_back_is_the_same(name, again):
    system = ss.systems.CATALOGUE[name]()
    stepper = ss.compile(system, "gauss4")
    run = stepper.integrate(**system.reference_state, h=0.01, steps=50)
    events = run.events(f"{stepper.coordinates[0]} - 0.1")
    many = stepper.ensemble(run.q[:3], p0=run.p[:3], h=0.01, steps=5)
    assert run.energy is run.energy  # computed, and left out of what is kept
    assert again(system) == system
    assert type(again(system)) is type(system)
    assert again(stepper).program.declared == system
    assert (again(stepper).integrate(**system.reference_state, h=0.01, steps=50).q == run.q).all()
    assert (again(run).energy == run.energy).all()
    assert (again(run).sol(0.123) == run.sol(0.123)).all()
    assert (again(events).t == events.t).all()
    assert (again(many).q == many.q).all()


@pytest.mark.parametrize("arithmetic", ["mpmath", "arb"])
def test_many_digits_keep_all_of_them(arithmetic):
    stepper = ss.compile(ss.systems.pendulum(), precision=40, arithmetic=arithmetic)
    run = stepper.integrate(["0.1"], v0=[0], h="0.01", steps=5)
    again = pickle.loads(pickle.dumps(run))
    assert (again.q == run.q).all()
    assert (again.energy == run.energy).all()
    assert again.h == run.h
    further = ss.Stepper(again.program).integrate(again.q[-1], p0=again.p[-1], h=again.h, steps=5)
    assert (further.q == stepper.integrate(run.q[-1], p0=run.p[-1], h=run.h, steps=5).q).all()


def test_structures_and_films():
    system = ss.systems.lagrange_top()
    assert repr(pickle.loads(pickle.dumps(system.structure))) == repr(system.structure)
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=20)
    assert pickle.loads(pickle.dumps(run.animate(fps=5))).frames == run.animate(fps=5).frames


def errors():
    """One of each class of errors that symsimpson raises."""
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=3)
    given = {
        ss.StorageError: {"trajectory": run},
        ss.Interrupted: {"trajectory": run},
        ss.ConvergenceError: {
            "trajectory": run,
            "step": 3,
            "time": 0.3,
            "residual": 0.1,
            "status": ss.Status.NOT_CONVERGED,
        },
    }
    kinds = [getattr(ss.errors, name) for name in ss.errors.__all__]
    return [kind("what\nwhy", **given.get(kind, {})) for kind in kinds]


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_errors_come_back_with_what_they_carry(again):
    for error in errors():
        found = again(error)
        assert type(found) is type(error)
        assert str(found) == str(error)
        for name, value in vars(error).items():
            if name == "trajectory":
                assert (found.trajectory.q == value.q).all()
            else:
                assert getattr(found, name) == value


def fails(h):
    stepper = ss.compile(ss.systems.pendulum())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ss.StabilityWarning)
        return stepper.integrate([1.0], v0=[0.0], h=h, steps=3)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_member_that_fails_is_told_by_a_pool(method):
    context = multiprocessing.get_context(method)
    with warnings.catch_warnings():
        for kind in (DeprecationWarning, RuntimeWarning):  # of fork beside threads; JAX has its own
            warnings.simplefilter("ignore", kind)
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            good, bad = pool.submit(fails, 0.1), pool.submit(fails, 100.0)
            assert good.result(timeout=300).success
            with pytest.raises(ss.ConvergenceError) as told:
                bad.result(timeout=300)
    assert told.value.status is not ss.Status.SUCCESS
    assert len(told.value.trajectory) == 1


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_control_loops_go_on_where_they_were(again):
    stepper = ss.compile(ss.systems.driven_cart_pole(), "gauss4")
    loop = stepper.start([0.0, 0.1], v0=[0.0, 0.0], h=0.02)
    for _ in range(5):
        loop.step(0.3)
    other = again(loop)
    for value in (0.1, -0.4, 0.0):
        loop.step(value)
        other.step(value)
    assert (loop.q == other.q).all()
    assert (loop.p == other.p).all()
    assert loop.t == other.t
