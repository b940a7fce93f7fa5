"""Some of the states of a run: rows of all that the whole run knows."""

import numpy as np
import pytest
from support.cases import sweep
from support.driven import kepler_with_drag

import symsimpson as ss


def retimed():
    stepper = ss.compile(ss.systems.kepler_plane().retimed("encounters"), "gauss8")
    return stepper.integrate([1.6, 0.0], v0=[0.0, 0.5], h=0.1, t_end=3.0, tangents=4)


def forced():
    system, q0, v0, _ = kepler_with_drag()
    return ss.compile(system).integrate(q0, v0, h=0.01, steps=40, sensitivities=["c"])


def held():
    system = ss.systems.cartesian_pendulum()
    return ss.compile(system).integrate(**system.reference_state, h=0.01, steps=40)


KNOWN = {
    forced: ("work", "power", "energy_balance", "sensitivity"),
    held: ("multipliers", "constraint_error", "constraint_forces"),
    retimed: ("tau", "tangent", "energy_error", "newton_iterations"),
}


@pytest.mark.parametrize("make", sweep(KNOWN, 1))
def test_rows_are_those_of_the_run(make):
    run = make()
    late = run.t > run.t[10]
    for places, part in (
        (slice(3, 5), run[3:5]),
        ([7], run[7]),
        (late, run[late]),
        (np.arange(len(run))[4::3][1:3], run[4::3][1:3]),
    ):
        for name in KNOWN[make]:
            own, whole = getattr(part, name), getattr(run, name)
            if not isinstance(whole, dict):
                own, whole = {"": own}, {"": whole}
            assert own.keys() == whole.keys()
            for key, rows in whole.items():
                assert np.array_equal(own[key], rows[places]), (name, key)
    with pytest.raises(AttributeError, match="nothing"):
        _ = run[3:5].nothing


@pytest.mark.slow
def test_parts_are_filmed():
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.01, steps=300)
    film = run[100:200].animate(fps=10)
    assert "1.0" in film._repr_html_() or film is not None


def test_events_of_a_part_are_those_in_its_time():
    (z,) = ss.coordinates("z")
    ball = ss.MechanicalSystem(
        "ball", coordinates=(z,), kinetic=z.diff() ** 2 / 2, potential=10 * z
    )
    floor = ss.Event(z, name="floor", action=ss.Impact(0.8))
    run = ss.compile(ball).integrate([1.0], v0=[0.0], h=0.05, steps=40, events=[floor])
    hits = run.events("floor")
    assert run[10:30].events("floor").t.tolist() == hits.t[1:2].tolist()
    assert run[10:30].events("floor").impulse.tolist() == hits.impulse[1:2].tolist()
    assert run[:10].events(z - 0.5).t.tolist() == run.events(z - 0.5).t[:1].tolist()
    assert len(run[:0].events("floor")) == 0


@pytest.mark.parametrize("name", ["at", "sol", "h", "energy_error", "save", "animate"])
def test_states_say_what_only_a_run_has(name):
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=3)
    states = run.at([0.1, 0.2])
    assert not hasattr(states, name)
    with pytest.raises(ss.InputError, match=f"States has no '{name}'.*\n.*run.{name}"):
        getattr(states, name)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = states.nothing
