"""Curves follow the motion between stored states, and through events."""

import matplotlib
import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

matplotlib.use("Agg")
x, y = ss.coordinates("x y")


@pytest.fixture(autouse=True)
def no_figure_stays():
    yield
    import matplotlib.pyplot as plt

    plt.close("all")


def plane(**options):
    kinetic = (x.diff() ** 2 + y.diff() ** 2) / 2
    return ss.compile(ss.MechanicalSystem("plane", coordinates=(x, y), kinetic=kinetic, **options))


@pytest.fixture(scope="module")
def circle():
    """A stepper on a circle of radius 1, of which 1.9 of 2 pi are stored."""
    spring = plane(potential=(x**2 + y**2) / 2, positions={"mass": (x, y)})
    return lambda **how: spring.integrate([1.0, 0.0], v0=[0.0, 1.0], h=0.1, **how)


@pytest.fixture(scope="module")
def thrown():
    """A ball that bounces off the floor, and jumps back to x = 0 from x = 1."""
    ball = plane(potential=10 * y, positions={"ball": (x, y)})
    events = [
        ss.Event(y, name="floor", action=ss.Impact(0.8)),
        ss.Event(x - 1, name="wall", action=ss.Change(positions={x: 0})),
    ]
    return lambda **how: ball.integrate([0, 1.0], v0=[1.0, 0], **{"h": 0.1} | how, events=events)


def middles(line):
    points = np.array(line.get_data()).T
    return np.linalg.norm((points[1:] + points[:-1]) / 2, axis=1)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "part",
    [
        slice(None),
        pytest.param(slice(1, 5), marks=SLOW),
        pytest.param(slice(None, None, -1), marks=SLOW),
    ],
)
def test_few_states_are_joined_along_the_path(circle, part):
    run = circle(steps=95, every=19)[part]
    assert middles(run.plot_path().lines[0]) == pytest.approx(1, abs=0.01)
    assert middles(run.plot_phase().lines[0]) == pytest.approx(1, abs=0.01)
    line = run.plot("x").lines[0]
    assert line.get_ydata() == pytest.approx(np.cos(line.get_xdata()), abs=1e-4)


@pytest.mark.slow
def test_files_have_the_states_between(circle, tmp_path):
    circle(steps=190, every=19).save(tmp_path / "run.nc")
    run = ss.open_trajectory(tmp_path / "run.nc")
    assert middles(run.plot_phase().lines[0]) == pytest.approx(1, abs=0.01)


@pytest.mark.slow
def test_states_that_resolve_the_motion_stay(circle):
    run = circle(steps=100)
    h = run[::2]
    assert (run.plot_path().lines[0].get_xdata() == run["x"]).all()
    assert len(h.plot_path().lines[0].get_xdata()) > len(h)


def test_states_alone_are_dots_where_lines_would_mislead(circle):
    for t, style in ((np.arange(0, 12, 0.2), "-"), (np.arange(0, 60, 2.4), "None")):
        some = circle(t_eval=t)
        drawn = some.plot_path().lines[0], some.plot_phase().lines[0], some.plot("y").lines[0]
        assert [line.get_linestyle() for line in drawn] == [style] * 3
        assert all(len(line.get_xdata()) == len(t) for line in drawn)
    a_period_apart = circle(t_eval=2 * np.pi * np.arange(5))
    assert a_period_apart.plot_path().lines[0].get_linestyle() == "None"
    run = circle(steps=190, every=19)
    chosen = run[run["x"] > 0]  # with gaps
    assert chosen.plot("x").lines[0].get_linestyle() == "None"
    assert circle(steps=9, every=None).plot().lines[0].get_linestyle() == "None"


def test_steps_taken_again_are_bounded(circle, monkeypatch):
    run = circle(steps=190, every=19)
    monkeypatch.setattr("symsimpson.plotting.run_figures.STEPS", 300)
    line = run.plot_path().lines[0]
    assert (line.get_linestyle(), len(line.get_xdata())) == ("None", 11)


@pytest.mark.parametrize(
    "how",
    [
        {},
        pytest.param({"every": 5}, marks=SLOW),
        pytest.param({"t_eval": np.linspace(0, 2, 41)}, marks=SLOW),
    ],
)
def test_impacts_are_drawn(thrown, how):
    run = thrown(**how) if "t_eval" in how else thrown(t_end=2, **how)
    assert run.plot("y").lines[0].get_ydata().min() == pytest.approx(0, abs=1e-12)
    line = run.plot("v_y").lines[0]
    t, v = line.get_data()
    floor = run.events("floor")
    assert len(floor) == 3
    for hit, before, after in zip(floor.t, floor["v_y"], floor.after["v_y"], strict=True):
        assert v[t == hit][[0, -1]] == pytest.approx([before, after])
    falling = np.diff(v) <= 1e-12
    assert (np.diff(t)[~falling] == 0).all()  # it rises at impacts alone
    fallen = run.plot("energy").lines[0]
    assert (np.diff(fallen.get_xdata())[np.diff(fallen.get_ydata()) < -1e-9] == 0).all()


@pytest.mark.slow
def test_jumps_break_paths_and_not_curves_over_time(thrown):
    run = thrown(t_end=2)
    path = run.plot_path().lines[0].get_xdata()
    assert np.isnan(path).sum() == len(run.records)
    assert np.nanmax(np.abs(np.diff(path))) < 0.2
    assert np.isfinite(run.plot("x").lines[0].get_ydata()).all()
    assert len(run[3:9].plot("x").lines[0].get_xdata()) < 100


@pytest.mark.slow
def test_members_are_drawn_as_what_they_are(circle):
    spring = plane(potential=(x**2 + y**2) / 2)
    many = spring.ensemble([[1.0, 0.0], [2.0, 0.0]], v0=[0.0, 1.0], h=0.2, steps=60, every=12)
    assert many[0].plot("x").lines[0].get_linestyle() == "None"
    assert many.plot("x", most=2).lines[0].get_linestyle() == "None"


def test_numbers_that_are_not_finite_are_left_out(circle):
    run = circle(steps=40)
    q, p = run.q.copy(), run.p.copy()
    for some in (slice(30, None), slice(None)):
        q[some] = p[some] = np.nan
        lost = run.with_states(run.t, q, p)
        assert len(lost.plot("x").lines[0].get_xdata()) == 41
        assert len(lost.plot_phase().lines[0].get_xdata()) == 41


def test_noise_beside_motion_is_no_motion():
    """A coordinate that is 0 up to rounding made dots of the figure of all."""
    run = plane(potential=(x**2 + y**2) / 2).integrate([1.0, 0.0], v0=[0.0, 0.0], h=0.1, steps=60)
    run.q[:, 1] = 1e-16 * np.cos(np.arange(61) ** 2)
    line, noise = (line for ax in run.plot().figure.axes for line in ax.lines)
    assert line.get_linestyle() == noise.get_linestyle() == "-"
    assert len(line.get_xdata()) == 61


@pytest.mark.slow
def test_units_of_positions():
    a, l1 = sp.symbols("a l1", positive=True)
    given = {"potential": x**2, "parameters": {a: 1.0, l1: 1.0}}
    for places, units, unit in (
        ({"p": (x, y)}, {x: "m", y: "m"}, " [m]"),
        ({"p": (x + l1 * sp.sin(y), -l1 * sp.cos(y))}, {x: "m", y: "rad", l1: "m"}, " [m]"),
        ({"p": (x, y)}, {"p": "km"}, " [km]"),
        ({"p": (x, y)}, {x: "m", y: "mm"}, ""),
        ({"p": (x, y), "q": [(x, 0), (y, 1), (0, y)]}, {x: "m", y: "m"}, " [m]"),
        ({"p": (a * x, y)}, {a: "N/m", x: "m"}, ""),
        ({"p": (x, y)}, {}, ""),
    ):
        run = plane(**given, positions=places, units=units).integrate(
            [1.0, 0.0], v0=[0.0, 1.0], h=0.1, steps=3
        )
        ax = run.plot_path()
        assert (ax.get_xlabel(), ax.get_ylabel()) == (f"x{unit}", f"y{unit}")
