"""Systems, steppers and what they computed go through pickle and copy."""

import copy
import pickle

import pytest

import symsimpson as ss


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
@pytest.mark.parametrize("name", ["double_pendulum", "lagrange_top", "kepler"])
def test_what_comes_back_is_the_same(name, again):
    system = ss.systems.CATALOGUE[name]()
    stepper = ss.compile(system, "gauss4")
    run = stepper.integrate(**system.reference_state, h=0.01, steps=50)
    events = run.events(f"{stepper.coordinates[0]} - 0.1")
    many = stepper.ensemble(run.q[:3], p0=run.p[:3], h=0.01, steps=5)
    assert run.energy is run.energy  # computed, and left out of what is kept
    assert again(system) == system
    assert type(again(system)) is type(system)
    assert again(stepper)._declared == system
    assert (again(stepper).integrate(**system.reference_state, h=0.01, steps=50).q == run.q).all()
    assert (again(run).energy == run.energy).all()
    assert (again(run).sol(0.123) == run.sol(0.123)).all()
    assert (again(events).t == events.t).all()
    assert (again(many).q == many.q).all()


def test_many_digits_say_what_to_do():
    with pytest.raises(TypeError, match="compile it where it runs"):
        pickle.dumps(ss.compile(ss.systems.pendulum(), precision=30))
