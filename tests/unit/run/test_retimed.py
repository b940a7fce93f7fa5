"""Runs in a time of their own: where they end, what is stored, what is refused."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.run.integrate import start_run
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import read_run

START = {"q0": [1.9, 0.0], "v0": [0.0, 0.2], "h": 0.3}


def kepler():
    x, y = ss.coordinates("x y")
    return ss.MechanicalSystem(
        "kepler_plane",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-1 / sp.sqrt(x**2 + y**2),
        positions={"body": (x, y)},
    )


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(kepler().retimed("encounters"), "simpson")


@pytest.fixture(scope="module")
def run(stepper):
    return stepper.integrate(**START, t_end=7.0)


def same(one, other):
    assert all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("t", "tau", "q", "p", "newton_iterations")
    )
    assert (one.steps, one.status, one.E0) == (other.steps, other.status, other.E0)


def test_states_of_the_user(run):
    assert run.q.shape == (len(run.t), 2)
    assert (run.t[0], run.t[-1]) == (0.0, 7.0)
    assert np.all(np.diff(run.t) > 0)
    assert np.allclose(np.diff(run.tau)[:-1], 0.3, atol=1e-13)
    assert run.t[1] == pytest.approx(0.3, rel=0.05)  # the first step in t
    assert run.v[0].tolist() == [0.0, 0.2]
    assert run.p[0].tolist() == [0.0, 0.2]
    assert run.E0 == run.energy[0] == pytest.approx(0.02 - 1 / 1.9, abs=1e-15)


def test_backwards_and_from_another_time(stepper):
    run = stepper.integrate(**START | {"h": -0.3}, t0=2.0, t_end=-1.0)
    assert run.t[-1] == -1.0
    assert np.all(np.diff(run.t) < 0)
    with pytest.raises(ss.InputError, match="negative h"):
        stepper.integrate(**START, t_end=-1.0)
    with pytest.raises(ss.InputError, match="exactly one of"):
        stepper.integrate(**START, t_end=1.0, steps=3)


@pytest.mark.parametrize("every", [1, 5, None])
def test_what_is_stored(stepper, run, every):
    some = stepper.integrate(**START, t_end=7.0, every=every)
    assert some.steps == run.steps
    assert some.t[-1] == 7.0
    assert np.array_equal(some.q[-1], run.q[-1])
    stride = slice(None, run.steps + 1, every) if every else slice(0, 0)
    assert np.array_equal(some.t[:-1], run.t[:-1][stride] if every else [])


@pytest.mark.parametrize("scheme", sweep(["kahan_li8", "gauss8"]))
@pytest.mark.parametrize("every", sweep([7, 1, None], 2))
def test_a_run_in_one_call_has_the_same_bits(scheme, every):
    stepper = ss.compile(kepler().retimed("encounters"), scheme)
    for sign in (1, -1):
        how = {"h": 0.1 * sign, "t0": 1.0, "t_end": 1.0 + 20.0 * sign, "every": every}
        plain = stepper.integrate([1.9, 0.0], v0=[0.0, 0.2], progress=False, **how)
        brief_run = stepper.integrate([1.9, 0.0], v0=[0.0, 0.2], **how)
        for name in ("t", "tau", "q", "p", "newton_iterations"):
            np.testing.assert_array_equal(getattr(brief_run, name), getattr(plain, name))
        assert brief_run.steps == plain.steps
        assert brief_run.E0 == plain.E0
        np.testing.assert_array_equal(brief_run.v, plain.v)


@pytest.mark.slow
def test_a_run_of_many_steps_is_not_begun_twice(stepper):
    how = {"q0": [1.9, 0.0], "v0": [0.0, 0.2], "h": 0.001, "t_end": 40.0, "every": None}
    ends = [stepper.integrate(**how) for _ in range(3)]
    assert ends[0].steps > 20_000
    assert stepper.program.findings.long == {(0.001, 40.0)}
    same(ends[0], ends[2])


def test_more_states_than_there_is_room_for(monkeypatch, stepper, run):
    monkeypatch.setattr("symsimpson.run.integrate.ROOM", 16)
    same(stepper.integrate(**START, t_end=7.0, progress=False), run)


def test_steps_may_be_counted(stepper, run):
    counted = stepper.integrate(**START, steps=run.steps)
    assert np.array_equal(counted.t, run.t[:-1])
    assert np.array_equal(counted.q, run.q[:-1])


def test_states_between_steps(stepper, run):
    assert np.array_equal(run.sol(run.t), run.y)
    times = np.linspace(0, 7, 57)
    sparse = stepper.integrate(**START, t_end=7.0, every=4)
    assert np.abs(sparse.sol(times) - run.sol(times)).max() < 1e-9
    crossings = run.events("y", direction=-1)
    assert np.abs(crossings.q[:, 1]).max() < 1e-14
    with pytest.raises(ss.InputError, match="outside the run"):
        run.at([7.1])
    assert run.animate(fps=5) is not None


def test_checkpoints_and_files(stepper, run, tmp_path):
    file = tmp_path / "run.ckpt"
    same(stepper.integrate(**START, t_end=7.0, checkpoint=file, checkpoint_every=9), run)
    again = ss.resume(file)
    same(again, run)
    for name in ("run.nc", "run.zarr"):
        run.save(tmp_path / name)
        same(ss.open_trajectory(tmp_path / name), run)


def test_a_file_of_a_module_keeps_its_time(stepper, run, tmp_path):
    path = tmp_path / "kepler.py"
    path.write_text(stepper.source)
    same(ss.load(path).integrate(**START, t_end=7.0), run)


def test_a_checkpoint_of_another_end_is_another_run(stepper, tmp_path):
    file = tmp_path / "run.ckpt"
    stepper.integrate(**START, t_end=7.0, checkpoint=file)
    with pytest.raises(ss.InputError, match="another run"):
        stepper.integrate(**START, t_end=8.0, checkpoint=file)


def begun(stepper, t0=0.0):
    program, state = stepper.program, (START["q0"], START["v0"])
    spec = read_run(program, Request(*state, h=0.3, t_end=7.0, t0=t0))
    run = start_run(program, spec, 0, 1)
    return run


def test_time_that_does_not_go_on_is_a_failure(stepper):
    run = begun(stepper)
    run.advance(3)
    q, p = run.end()
    run.rows("PARAMETER", len(stepper.parameters))[-1] *= -1
    run.advance(9)
    assert (run.status, run.step) == (ss.Status.RATE_NOT_POSITIVE, 3)
    assert np.array_equal(run.end(), (q, p))


@pytest.mark.parametrize("patience", [1.0, 0.0])
def test_time_that_stands_still_is_a_failure(monkeypatch, stepper, patience):
    monkeypatch.setattr("symsimpson.stepping.run.STANDSTILL", 2)
    monkeypatch.setattr("symsimpson.stepping.run.PATIENCE", patience)  # 0: steps one by one
    run = begun(stepper, 1.0)
    run.rows("PARAMETER", len(stepper.parameters))[-1] = 1e300
    run.advance(5000)
    assert run.status is ss.Status.RATE_NOT_POSITIVE


def test_a_rate_that_vanishes_on_the_way_is_told():
    """What is thrown back there has the right energy before and behind."""
    x, y = ss.coordinates("x y")
    orbits = ss.MechanicalSystem(
        "orbits",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-1 / sp.sqrt(x**2 + y**2),
    )
    stepper = ss.compile(orbits.retimed(x), "simpson")
    with pytest.warns(
        ss.ResolutionWarning, match="the rate dt/dtau nearly vanishes at about t=2.55446"
    ):
        stepper.integrate([1.6, 0.0], v0=[0.0, 0.4], h=0.05, t_end=3.0, on_failure="return")


def test_a_mean_over_steps_is_refused(stepper):
    with pytest.raises(ss.InputError, match="not the mean over time"):
        stepper.integrate(**START, t_end=7.0, reduce={"m": ("mean", "x1")})


@pytest.mark.slow
def test_kicks_and_drifts_end_at_a_time():
    x, y = kepler().coordinates
    system = kepler().retimed(sp.sqrt(x**2 + y**2))
    run = ss.compile(system, ss.composition("kahan_li8")).integrate(**START | {"h": 0.1}, t_end=7.0)
    wanted = ss.compile(system, "gauss12").integrate(**START, t_end=7.0)
    assert run.t[-1] == 7.0
    assert np.abs(run.q[-1] - wanted.q[-1]).max() < 1e-9
    times = np.linspace(0, 7, 29)
    assert np.abs(run.sol(times) - wanted.sol(times)).max() < 1e-8
    with pytest.raises(ss.SchemeError, match="only for a quadratic kinetic energy"):
        ss.compile(system, ss.composition("blanes_moan6"))
    with pytest.raises(ss.SchemeError, match="function of V"):
        ss.compile(kepler().retimed(1 + x**2), ss.composition("kahan_li8"))


def test_a_rate_is_positive_where_a_run_begins():
    x, _ = kepler().coordinates
    stepper = ss.compile(kepler().retimed(x), "simpson")
    with pytest.raises(ss.InputError, match=r"the rate dt/dtau is -1\.9"):
        stepper.integrate([-1.9, 0.0], v0=[0.0, 0.2], h=0.1, t_end=1.0)


@pytest.mark.parametrize("name", ["E0", "g_start", ss.energy])
def test_what_follows_from_the_start_is_not_given(stepper, name):
    with pytest.raises(ss.InputError, match="follow from the initial state"):
        stepper.integrate(**START, steps=3, parameters={name: -0.5})


@pytest.mark.slow
def test_sections_are_events(stepper):
    start = {"q0": [1.9, 0.0], "v0": [0.0, 0.2], "h": 0.1}
    run = stepper.integrate(**start, t_end=60.0)
    for length in ({"t_end": 60.0}, {"steps": run.steps}):
        section, events = stepper.poincare("y", **start, **length), run.events("y")
        assert len(section) > 15
        for name in ("t", "q", "p", "direction"):
            np.testing.assert_allclose(getattr(section, name), getattr(events, name), atol=1e-11)
    last = events.t[3]  # in the part of a step at the end
    assert len(stepper.poincare("y", **start, t_end=last + 1e-3)) == 4
    assert len(stepper.poincare("y", **start, t_end=last - 1e-3)) == 3


def test_a_loop_takes_the_steps_of_a_run(stepper):
    run, loop = stepper.integrate(**START, steps=9), stepper.start(**START)
    for _ in range(9):
        loop.step()
    assert loop.t == run.t[-1]
    assert np.array_equal(loop.q, run.q[-1])
    assert np.array_equal(loop.v, run.v[-1])


@pytest.mark.parametrize(("every", "t_end"), [(1, 10.0), (None, 10.0), (40, 150.0)])
def test_unresolved_motion_is_told_with_its_time(every, t_end):
    """The first encounter, at t = 3, is lost: in the first block of a long run."""
    system = kepler()
    slow = system.retimed((-system.potential) ** sp.Rational(-1, 2))
    with pytest.warns(ss.ResolutionWarning, match="about t="):
        run = ss.compile(slow, "suzuki4").integrate(
            [1.9, 0.0], v0=[0.0, 0.05], h=0.1, t_end=t_end, every=every
        )
    since = float(run.message.split("about t=")[1].split()[0])
    assert since == (0.0 if t_end > 100.0 else pytest.approx(3.0, abs=1.0))
    assert run.t[-1] == t_end


def test_an_error_of_the_energy_that_comes_back_is_no_other_motion(recwarn):
    stepper = ss.compile(kepler().retimed("encounters"), "simpson")
    run = stepper.integrate([1.99, 0.0], v0=[0.0, 0.005], h=0.8, t_end=60.0)
    assert abs(run.energy_error).max() > 0.4  # near the centre, K / g
    assert not recwarn


@pytest.mark.slow
def test_states_beyond_memory_end_a_run_with_what_it_has(monkeypatch):
    """How many steps lead to the end is not known before; each part asks for room for all."""
    from symsimpson.run import ended

    stepper = ss.compile(ss.systems.kepler_plane().retimed("encounters"), "gauss8")
    given = {"q0": [1.6, 0.0], "v0": [0.0, 0.5], "h": 1e-3, "t_end": 40.0}
    whole = stepper.integrate(**given)
    monkeypatch.setattr(ended, "PIECES_PER_CHECK", 1)
    monkeypatch.setattr(ended, "JOIN_FACTOR", 10**12)  # as if all states took so much more
    with pytest.raises(ss.StorageError, match=r"do not fit into memory.*are available") as caught:
        stepper.integrate(**given)
    kept = caught.value.trajectory
    assert len(kept) > 1000
    assert np.array_equal(kept.q, whole.q[: len(kept)])
    run = stepper.integrate(**given, on_failure="return")
    assert not run.success
    assert np.array_equal(run.q, kept.q)
