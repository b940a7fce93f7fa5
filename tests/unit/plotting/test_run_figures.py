"""Figures of a run: what is drawn, into which axes."""

import matplotlib
import numpy as np
import pytest

import symsimpson as ss

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def run():
    stepper = ss.compile(ss.systems.double_pendulum())
    return stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.01, t_end=2.0)


@pytest.mark.slow
def test_no_two_of_many_coordinates_have_one_colour():
    stepper = ss.compile(ss.systems.n_pendulum(12), "midpoint")
    many = stepper.integrate([0.1] * 12, v0=[0] * 12, h=0.01, steps=3)
    assert len({line.get_color() for line in many.plot().lines}) == 12
    few = [line.get_color() for line in many.plot(["q1", "q2"]).lines]
    assert few == [matplotlib.colors.to_hex(colour) for colour in ("C0", "C1")]
    paths = many.plot_path().lines[:12]
    assert len({line.get_color() for line in paths}) == 12


@pytest.fixture(autouse=True)
def no_figure_stays():
    yield
    import matplotlib.pyplot as plt

    plt.close("all")


def test_quantities_over_time(run):
    ax = run.plot()
    assert [line.get_label() for line in ax.lines] == ["q1", "q2"]
    assert (ax.lines[1].get_ydata() == run["q2"]).all()
    assert run.plot("energy", ax=ax) is ax
    assert (ax.lines[2].get_ydata() == run.energy).all()
    assert len(run[:50].plot(["v_q1", "p_q2"]).lines[0].get_xdata()) == 50
    import matplotlib.pyplot as plt

    before = plt.get_fignums()
    for wrong in (run.plot, run.plot_phase):
        with pytest.raises(KeyError, match="there is no quantity 'q3'"):
            wrong("q3")
    assert plt.get_fignums() == before  # no empty figure is left


def test_arrays_and_numbers_are_not_drawn(run):
    many = ss.compile(ss.systems.pendulum()).ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=9)
    kept = ss.compile(ss.systems.pendulum()).integrate(
        [1.0], v0=[0], h=0.1, steps=9, save=["theta"]
    )
    for draw, given in (
        (run.plot, (run.t, run.q)),
        (run.plot, (run.t,)),
        (run.plot, (3,)),
        (run.plot, ([0, 1],)),
        (run.plot_phase, (0, 1)),
        (run.plot_phase, ("q1", 1)),
        (kept.plot, (kept["theta"],)),
        (many.plot, (0,)),
        (many.plot, (many.q,)),
    ):
        with pytest.raises(ss.InputError, match="not the name of a quantity"):
            draw(*given)
    with pytest.raises(ss.InputError, match="most is 'all', not a whole number"):
        many.plot(most="all")
    assert len(run.plot([]).lines) == len(run.plot({"q1": 0, "q2": 0}).lines) == 2


def test_titles_tell_how_many_members_are_drawn():
    """Lines are of some, and a histogram of last states is of all that have one."""
    stepper = ss.compile(ss.systems.pendulum())
    given = {"q0": [[0.1], [0.2], [0.3], [0.4]], "v0": [0.0], "h": 0.1, "steps": 4}
    assert "2 of 4 members" in stepper.ensemble(**given, every=1).plot(most=2).get_title()
    bars = stepper.ensemble(**given).plot(most=2)
    assert "4 of 4 members" in bars.get_title()
    assert sum(bar.get_height() for bar in bars.patches) == 4


@pytest.mark.slow
def test_phase_plane_and_sections(run):
    ax = run.plot_phase()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("q1", "p_q1")
    assert run.plot_phase("q2", "v_q2", ax=ax) is ax
    found = run.events("q1")
    dots = found.plot_phase("q2").lines[0]
    assert dots.get_linestyle() == "None"
    assert len(dots.get_xdata()) == len(found)


def test_energy(run):
    ax = run.plot_energy()
    assert (ax.lines[0].get_ydata() == run.energy_error).all()
    assert ax.get_ylabel() == "(H - H0) / |H0| [$10^{-8}$]"
    assert not ax.yaxis.offsetText.get_visible()
    free = ss.compile(ss.systems.kepler())
    assert free.integrate(**free.reference_state, h=0.01, steps=5).plot_energy().get_xlabel() == "t"


@pytest.mark.slow
def test_energies_are_labelled_by_the_scale_that_they_are_relative_to():
    pendulum = ss.compile(ss.systems.pendulum())
    level = pendulum.integrate([np.pi / 2], v0=[0.0], h=0.1, steps=50)  # H0 is 1e-16
    assert level.energy_scale > 1
    assert level.plot_energy().get_ylabel().startswith("(H - H0) / kinetic energy")
    fall = ss.compile(ss.systems.harmonic_oscillator())
    rest = fall.integrate([0.0], v0=[0.0], h=0.1, steps=5)
    assert rest.plot_energy().get_ylabel() == "H - H0"


@pytest.mark.slow
def test_paths(run):
    ax = run.plot_path()
    paths = {line.get_label(): line for line in ax.lines[:2]}
    assert set(paths) == {"elbow", "bob"}
    l1 = run.parameters["l1"]
    assert paths["elbow"].get_xdata() == pytest.approx(l1 * np.sin(run["q1"]))
    assert ax.get_aspect() == 1
    top = ss.compile(ss.systems.lagrange_top())
    spatial = top.integrate(**top.reference_state, h=0.001, steps=50).plot_path()
    assert spatial.name == "3d"
    with pytest.raises(ss.InputError, match="ax has two dimensions"):
        top.integrate(**top.reference_state, h=0.001, steps=50).plot_path(ax=ax)
    with pytest.raises(ss.InputError, match="no states to draw"):
        run[5:5].plot_path()


def test_without_matplotlib(run, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ss.InputError, match=r"needs matplotlib.*\n.*symsimpson\[plot\]"):
        run.plot()


@pytest.mark.slow
def test_names_one_by_one_and_symbols(run):
    q1, q2 = ss.systems.double_pendulum().coordinates
    ax = run.plot("q1", q2, q1.diff())
    assert [line.get_label() for line in ax.lines] == ["q1", "q2", "v_q1"]
    assert run.plot(q1).get_ylabel() == "q1"
    ax = run.plot_phase(q2)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("q2", "p_q2")
    with pytest.raises(ss.InputError, match=r"there is no quantity 'v_q3'. Did you mean v_q[12]\?"):
        run.plot("q1", "v_q3")


@pytest.mark.parametrize(
    ("name", "shown"), [("$a$b$", r"\$a\$b\$"), ("_x", " _x"), (r"\mu", r"\mu")]
)
def test_names_are_written_as_they_are(name, shown):
    from matplotlib.figure import Figure

    from symsimpson.plotting.axes import escape_label

    assert escape_label(name) == shown
    figure = Figure()
    ax = figure.add_subplot()
    ax.plot([0, 1], label=escape_label(name))
    assert len(ax.legend().get_texts()) == 1
    figure.canvas.draw()  # dollars are no formula
