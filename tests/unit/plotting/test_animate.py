"""Films: what is in them, and that they need nothing from elsewhere."""

import re

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.plotting.scene import Segment, build_scene


def run_of(name, **options):
    stepper = ss.compile(getattr(ss.systems, name)())
    given = {"h": 0.002, "steps": 500} | options
    return stepper.integrate(**stepper.reference_state, **given)


@pytest.fixture(scope="module")
def run():
    return run_of("double_pendulum", h=0.1, steps=10)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "links"),
    sweep(
        [
            ("double_pendulum", (Segment(-1, 0, True), Segment(0, 1, True))),
            ("cart_pole", (Segment(0, 1, True),)),
            ("elastic_pendulum", (Segment(-1, 0, False),)),
            ("spherical_pendulum", (Segment(-1, 0, True),)),
        ]
    ),
)
def test_what_keeps_its_distance_is_linked(name, links):
    assert build_scene(run_of(name)).links == links


def test_points_are_where_they_were_declared(run):
    scene = build_scene(run)
    l1, l2 = run.parameters["l1"], run.parameters["l2"]
    x = l1 * np.sin(run["q1"]) + l2 * np.sin(run["q2"])
    assert scene.points[:, 1, 0] == pytest.approx(x)
    assert (np.abs(scene.points - scene.middle) <= scene.reach).all()


@pytest.mark.slow
def test_a_body_turns_with_the_top():
    run = run_of("lagrange_top")
    scene = build_scene(run)
    (disc,) = scene.bodies
    assert disc.shape == (501, 7, 3)
    assert (disc[:, 0] == disc[:, -1]).all()
    spokes = disc - scene.points
    length = run.parameters["l"]
    assert np.linalg.norm(spokes, axis=2) == pytest.approx(np.full((501, 7), length / 2))
    assert np.einsum("nij,nj->ni", spokes, scene.points[:, 0]) == pytest.approx(0, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(["double_pendulum", "lagrange_top"]))
def test_films_need_nothing_from_elsewhere(tmp_path, name):
    film = run_of(name).animate(fps=5)
    assert film.frames == 5
    page = film.save(tmp_path / "film.html").read_text(encoding="utf-8")
    fetched = re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=[\"'](?!data:)[^\"']*", page)
    assert fetched == []
    assert "fa fa-" not in page
    shown = film._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert shown.count('"') == 8  # the page is escaped within its own


@pytest.mark.slow
def test_length_of_a_film():
    run = run_of("double_pendulum", h=0.01, steps=300)
    assert run.animate().frames == 60
    assert run.animate(seconds=1.5, fps=10).frames == 15
    assert run_of("double_pendulum", h=0.05, steps=600, every=20).animate(fps=10).frames == 100


@pytest.mark.parametrize(
    "options",
    [{"fps": 0}, {"fps": 1000}, {"fps": None}, {"seconds": -1}, {"seconds": 1e9}, {"seconds": "2"}],
)
def test_films_that_are_none(run, options):
    with pytest.raises(ss.InputError, match="one of them is out of range"):
        run.animate(**options)


@pytest.mark.slow
def test_systems_without_positions(tmp_path):
    (x,) = ss.coordinates("x")
    m = sp.Symbol("m", positive=True)
    bare = ss.MechanicalSystem(
        "bare", coordinates=(x,), kinetic=m * x.diff() ** 2 / 2, potential=x**2, parameters={m: 1.0}
    )
    run = ss.compile(bare).integrate([1.0], v0=[0.0], h=0.1, steps=10)
    with pytest.raises(ss.InputError, match=r"Declare MechanicalSystem\(..., positions"):
        run.animate()
    path = ss.generate(ss.systems.pendulum(), directory=tmp_path)
    loaded = ss.load(path).integrate([1.0], v0=[0.0], h=0.1, steps=10)
    with pytest.raises(ss.InputError, match="from generated files never have positions"):
        loaded.plot_path()


@pytest.mark.slow
def test_points_in_one_dimension_and_bad_ones():
    (x,) = ss.coordinates("x")
    given = {"coordinates": (x,), "kinetic": x.diff() ** 2 / 2, "potential": x**2, "parameters": {}}
    system = ss.MechanicalSystem("line", **given, positions={"mass": x})
    assert build_scene(
        ss.compile(system).integrate([1.0], v0=[0.0], h=0.1, steps=3)
    ).points.shape == (4, 1, 2)
    for bad in ((x, x, x, x), [[x, x], []]):
        with pytest.raises(ss.ModelError, match="components"):
            ss.MechanicalSystem("line", **given, positions={"mass": bad})


@pytest.mark.slow
def test_a_film_has_its_own_layout(recwarn):
    plt = pytest.importorskip("matplotlib.pyplot")
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    with plt.rc_context({"figure.constrained_layout.use": True, "savefig.dpi": 200}):
        page = run.animate(seconds=1, fps=3)._repr_html_()
    assert not recwarn
    assert len(page) < 100_000
    assert page.count("\n") < 1000


@pytest.mark.slow
def test_points_that_move_with_the_time(tmp_path):
    """A pivot that is shaken by hand is drawn, filmed, and where it is at each time."""
    import sympy as sp

    (theta,), a = ss.coordinates("theta"), sp.Symbol("a")
    pivot = a * sp.cos(3 * ss.time)
    shaken = ss.MechanicalSystem(
        "shaken",
        coordinates=(theta,),
        kinetic=theta.diff() ** 2 / 2,
        potential=-sp.cos(theta),
        parameters={a: 0.3},
        positions={
            "pivot": (pivot, 0),
            "bob": (pivot + sp.sin(theta), -sp.cos(theta)),
            "table": [(pivot, 0), (pivot + 1, 0), (pivot, 1)],
        },
    )
    run = ss.compile(shaken).integrate([1.0], v0=[0.0], h=0.1, steps=30, parameters={a: 0.5})
    moved = 0.5 * np.cos(3 * run.t)
    scene = build_scene(run)
    assert scene.points[:, 0, 0] == pytest.approx(moved)
    assert scene.points[:, 1, 0] == pytest.approx(moved + np.sin(run["theta"]))
    assert scene.bodies[0][:, 1, 0] == pytest.approx(moved + 1)
    assert [(link.first, link.second) for link in scene.links if link.rigid] == [(0, 1)]
    path = run[3:9].plot_path().lines[0].get_xdata()  # some states have their own times
    assert path[::2] == pytest.approx(moved[3:9])
    assert path[1::2] == pytest.approx(0.5 * np.cos(3 * (run.t[3:8] + 0.05)))
    assert run.animate(fps=5, seconds=1).save(tmp_path / "film.html").stat().st_size > 1000


#: How files of each kind begin.
BEGINS = {".gif": b"GIF89a", ".png": b"\x89PNG", ".mp4": b"\x00\x00\x00"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", BEGINS)
@pytest.mark.parametrize("name", sweep(["double_pendulum", "lagrange_top"]))
def test_files_are_what_their_ending_says(tmp_path, name, kind):
    pytest.importorskip("imageio_ffmpeg")
    film = run_of(name).animate(fps=5)
    written = film.save(tmp_path / f"film{kind}", frame=-1)
    assert written.read_bytes().startswith(BEGINS[kind])
    assert written.stat().st_size > 3000
    assert [one.name for one in tmp_path.iterdir()] == [written.name]


@pytest.mark.slow
def test_a_gif_has_all_frames(tmp_path):
    image = pytest.importorskip("PIL.Image")
    film = run_of("double_pendulum").animate(fps=5)
    with image.open(film.save(tmp_path / "film.gif")) as opened:
        assert opened.n_frames == film.frames


@pytest.mark.parametrize(
    ("name", "frame"), [("film.txt", 0), ("film", 0), ("film.png", 99), ("film.png", "last")]
)
def test_other_endings_and_frames_are_refused(run, tmp_path, name, frame):
    with pytest.raises(ss.InputError, match=r"\.html, \.gif, \.mp4 or \.png"):
        run.animate(fps=5).save(tmp_path / name, frame=frame)
    assert not list(tmp_path.iterdir())
