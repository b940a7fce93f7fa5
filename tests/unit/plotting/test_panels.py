"""What stands on axes: panels, labels, sections, bands of ensembles, and sizes of films."""

import matplotlib
import numpy as np
import pytest

import symsimpson as ss
from symsimpson.plotting.axes import name_axis
from symsimpson.plotting.run_figures import find_free_names, group_panels

matplotlib.use("Agg")


@pytest.fixture(autouse=True)
def no_figure_stays():
    yield
    import matplotlib.pyplot as plt

    plt.close("all")


@pytest.fixture(scope="module")
def run():
    stepper = ss.compile(ss.systems.double_pendulum())
    return stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.02, t_end=4.0)


@pytest.fixture(scope="module")
def many():
    stepper = ss.compile(ss.systems.pendulum())
    q0 = np.linspace(0.1, 1.1, 11)[:, None]
    return stepper.ensemble(q0, v0=[0.0], h=0.1, steps=10, every=2)


def test_large_and_small_numbers_have_panels():
    small, large, zero = np.sin(np.arange(9)), np.linspace(0, 500, 9), 1e-15 * np.arange(9)
    assert group_panels({"a": small, "b": large}, {}, "bz") == [["a"], ["b"]]
    assert group_panels({"b": large, "a": small, "z": zero}, {}, "bz") == [["b", "z"], ["a"]]
    assert group_panels({"a": small, "b": 20 * small, "c": 1e-3 * small}, {}, "bz") == [
        ["a", "b"],
        ["c"],
    ]
    assert group_panels({"a": small, "b": small}, {"a": "m"}, "") == [["a"], ["b"]]
    assert group_panels({"a": small * np.nan, "z": 0 * small}, {}, "bz") == [["a", "z"]]
    assert group_panels({"x": small, "p_x": 1e-27 * small}, {}, "x") == [["x"], ["p_x"]]


def test_powers_of_ten_stand_in_labels(run):
    from matplotlib.figure import Figure

    for scale, text in ((1e-15, "x [$10^{-15}$ m]"), (3e11, "x [$10^{11}$ m]"), (1.0, "x [m]")):
        ax = Figure().add_subplot()
        ax.plot([-scale, scale], [0, 1])
        name_axis(ax, "x", "x", "m")
        name_axis(ax, "y", "$a$")
        ax.figure.canvas.draw()
        shown = ax.xaxis.offsetText
        assert (ax.get_xlabel(), ax.get_ylabel()) == (text, r"\$a\$")
        assert not (shown.get_visible() and shown.get_text())
        ax.plot([-1e3, 1e3], [0, 1])  # labels follow what is drawn later
        name_axis(ax, "x", "x")
        assert ax.get_xlabel() == ("x [$10^{11}$]" if scale > 1 else "x")
        assert ax.xaxis.offsetText.get_visible() == (scale <= 1)


@pytest.mark.slow
def test_paths_in_space_have_three_names():
    top = ss.systems.lagrange_top()
    ax = ss.compile(top).integrate(**top.reference_state, h=0.002, steps=20).plot_path()
    assert [ax.get_xlabel(), ax.get_ylabel(), ax.get_zlabel()] == ["x", "y", "z"]


def test_sections_are_drawn(run):
    section = run.events("q1")
    ax = section.plot()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("q2", "p_q2")
    (dots,) = ax.lines
    assert dots.get_linestyle() == "None"
    assert (dots.get_ydata() == section["p_q2"]).all()
    assert run.events("q2").plot().get_xlabel() == "q1"
    assert run.events("v_q1").plot().get_xlabel() == "q1"
    ax = section.plot("q2", "v_q2")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("q2", "v_q2")
    assert (section.plot("p_q1").get_xlabel(), section.plot("p_q1").get_ylabel()) == ("t", "p_q1")
    over_time = section.plot(["q1", "q2", "v_q2"]).figure.axes
    assert over_time[-1].get_xlabel() == "t"
    assert section.plot_path().lines[0].get_linestyle() == "None"
    assert run.events("q1 - 50").plot().get_ylabel() == "p_q1"  # none is there
    with pytest.raises(ss.InputError, match="there is no quantity 'q3'"):
        section.plot("q1", "q3")


@pytest.mark.slow
def test_sections_of_one_coordinate():
    swing = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=80)
    assert find_free_names(swing.events("theta")) == ("p_theta",)
    assert find_free_names(swing.events("sin(3*t)")) == ("theta", "p_theta")


def test_ensembles_are_bands(many):
    ax = many.plot()
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["5 to 95 %", "25 to 75 %", "median"]
    assert ax.lines[0].get_ydata() == pytest.approx(np.median(many["theta"], axis=0))
    outer = ax.collections[0].get_paths()[0].get_extents()
    assert outer.y1 == pytest.approx(np.quantile(many["theta"], 0.95, axis=0).max())
    assert "11 of 11 members" in ax.get_title()


def test_members_are_lines(many):
    for most, numbers in ((2, [0, 10]), (1, [0]), (100, range(11))):
        lines = many.plot(most=most).lines
        assert len(lines) == len(numbers)
        for line, k in zip(lines, numbers, strict=True):
            assert (line.get_ydata() == many["theta"][k]).all()
    for wrong in ([1], 0, 0.5, "all"):
        with pytest.raises(ss.InputError, match="most is"):
            many.plot(most=wrong)


def test_members_that_failed_are_left_out_of_bands(many):
    import dataclasses

    q = many.q.copy()
    q[0, 3:] = q[1:, 5:] = np.nan
    ax = dataclasses.replace(many, q=q).plot()
    assert ax.lines[0].get_ydata() == pytest.approx(np.nanmedian(q[:, :5, 0], axis=0))


@pytest.mark.slow
def test_films_have_names_and_sizes(run, tmp_path):
    image = pytest.importorskip("PIL.Image")
    film = run.animate(seconds=1, fps=2, figsize=(5, 4), dpi=150)
    with image.open(film.save(tmp_path / "film.png")) as opened:
        assert opened.size == (750, 600)
    assert 'width="800"' in film._repr_html_()
    for wrong in (
        {"figsize": 3},
        {"figsize": (1, 2, 3)},
        {"figsize": "ab"},
        {"figsize": (0, 1)},
        {"dpi": None},
        {"dpi": -1},
        {"dpi": np.inf},
        {"figsize": (np.nan, 1)},
    ):
        with pytest.raises(ss.InputError, match="not a size of a figure"):
            run.animate(**wrong)


@pytest.mark.slow
def test_the_balance_of_energies_has_a_unit_or_a_scale():
    import sympy as sp

    (x,) = ss.coordinates("x")
    m = sp.Symbol("m", positive=True)
    for units, label in (({}, "(H - H0 - work) / |H0|"), ({"energy": "J"}, "H - H0 - work [")):
        brake = ss.MechanicalSystem(
            "brake",
            coordinates=(x,),
            kinetic=m * x.diff() ** 2 / 2,
            potential=0,
            parameters={m: 1.0},
            forces={x: -x.diff()},
            units=units,
        )
        run = ss.compile(brake).integrate([0.0], v0=[1.0], h=0.1, steps=9)
        assert run.plot_energy().get_ylabel().startswith(label)
        assert ("J]" in run.plot_energy().get_ylabel()) == bool(units)
