"""Films of a run, by matplotlib in a plane or by plotly in space."""

from __future__ import annotations

import base64
import html
import io
import os
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from html import escape
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.plotting.axes import axes, colours, label, legend, name_axis, style
from symsimpson.plotting.run_figures import curve_of
from symsimpson.plotting.scene import Film, Scene, places_of, scene_of
from symsimpson.program.input_values import whole_number
from symsimpson.support.extras import library
from symsimpson.support.files import read_path, write_text, written_beside
from symsimpson.support.progress import Progress

#: Runs of at most so many seconds are shown as fast as they are.
LONGEST = 10.0
#: A trail has so many points from one frame to the next.
FINE = 8
#: Inches, and dots an inch, of a figure are fewer.
MOST_DOTS = 1000


class Animation:
    """A film that shows itself in a notebook, without any connection.

    Attributes
    ----------
    frames : int
    """

    def __init__(
        self,
        page: Callable[[], str],
        write: Callable[..., None],
        frames: int,
        size: tuple[int, int],
    ) -> None:
        self._make_page, self._write, self.frames, self._size = page, write, frames, size

    @cached_property
    def _page(self) -> str:
        return self._make_page()

    def save(self, path: str | os.PathLike[str], *, frame: int = 0) -> Path:
        """Write the film as the ending of the name says.

        Parameters
        ----------
        path : path
            In ``.html``, a page that plays anywhere; in ``.gif`` or ``.mp4`` (needs ffmpeg, or
            ``pip install imageio-ffmpeg``); or in ``.png``, one frame, the first by default.
        frame : int
            Number of the frame in a ``.png`` file; a negative number counts from the end.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            If the name ends otherwise, there is no such frame, or a library is missing.
        StorageError
            If the file cannot be written.
        """
        place = read_path("the file of the animation", path)
        if place.suffix == ".html":
            return write_text(path, self._page, "animation")
        known = whole_number(frame)
        if place.suffix not in KINDS or known not in range(-self.frames, self.frames):
            reject(
                f"{os.fspath(path)!r}, frame={frame!r}: there is no such kind of film, or frame.",
                remedy="End the name in .html, .gif, .mp4 or .png; frames are 0 to "
                f"{self.frames - 1}.",
            )
        with written_beside(place, "animation") as whole:
            self._write(whole, place.suffix, int(frame) % self.frames)
        return place

    def _repr_html_(self) -> str:
        width, height = self._size
        # a page of its own, so that its scripts run and disturb nobody
        return (
            f'<iframe srcdoc="{html.escape(self._page)}" width="{width}" height="{height}" '
            'style="border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"Animation({self.frames} frames; save('film.html') keeps it)"


def animate(
    run: Any,
    *,
    seconds: float | None = None,
    fps: int = 20,
    figsize: tuple[float, float] | None = None,
    dpi: float = 72,
) -> Animation:
    """Film the points and bodies of a system."""
    numbers = all(isinstance(x, Real) for x in (fps, 1 if seconds is None else seconds))
    if not numbers or not 1 <= fps <= 100 or not (seconds is None or 0 < seconds <= 600):
        reject(
            f"seconds={seconds!r}, fps={fps!r} make no film.",
            remedy="Pass up to 600 seconds, and from 1 to 100 frames in each.",
        )
    sizes = [dpi, *np.ravel((1, 1) if figsize is None else figsize)]
    real = all(isinstance(x, Real) for x in sizes)
    if len(sizes) != 3 or not real or not all(0 < x < MOST_DOTS for x in sizes):
        reject(
            f"figsize={figsize!r}, dpi={dpi!r} are no size of a figure.",
            remedy="Pass a width and a height in inches, and dots per inch: figsize=(6, "
            "4), dpi=100.",
        )
    span = abs(float(run.t[-1] - run.t[0]))
    length = seconds or (span if 1 <= span <= LONGEST else LONGEST)
    frames = max(2, round(length * fps))
    t = np.linspace(float(run.t[0]), float(run.t[-1]), (frames - 1) * FINE + 1)
    scene = scene_of(run.at(t), FINE)
    inches, more = ((8.3, 9.2), 50) if scene.spatial else ((4.2, 4.2), 168)
    make = film_in_space if scene.spatial else film_in_plane
    title = f"{run.program.system}, {run.program.scheme}"
    width, height = figsize or inches
    film = Film(scene, t[::FINE], fps, title, (width, height), dpi)
    size = max(round(width * dpi) + 50, 420), round(height * dpi) + more
    return Animation(partial(make, film), partial(write_film, film), frames, size)


def read_places(some: Any) -> list[Any]:
    """Return all positions at some states, as one array."""
    places = places_of(some).values()
    return [np.concatenate([x.reshape(len(some), -1) for x in places], axis=1)]


def plot_path(run: Any, *, connected: bool = True, ax: Any = None) -> Any:
    """Draw the paths of the points of a system, and where all is in the end."""
    curve = curve_of(run, read_places, connected)
    scene = scene_of(curve.states)
    in_space = {"subplot_kw": {"projection": "3d"}} if scene.spatial else {}
    ax = axes(ax, (5, 5) if scene.spatial else (4.5, 4.5), **in_space)
    if scene.spatial and not hasattr(ax, "set_zlim"):
        reject(
            f"{run.program.system} moves in space, and these axes are plane.",
            remedy="Make axes with plt.subplots(subplot_kw={'projection': '3d'}), or leave ax out.",
        )
    acted = np.flatnonzero(np.diff(curve.states.t) == 0)  # an event may move points at once
    paths = np.insert(scene.fine, acted + 1, np.nan, axis=0)
    how = style(curve.connected, len(scene.fine), 0.7)
    for k, (name, colour) in enumerate(zip(scene.names, colours(len(scene.names)), strict=True)):
        ax.plot(*paths[:, k].T, color=colour, label=label(name), **how)
    painter(ax, scene)(-1)
    frame_scene(ax, scene)
    ax.set_title(f"{run.program.system}, {run.program.scheme}")
    if len(scene.names) > 1:
        legend(ax)
    return ax


#: Kinds of files, and what writes them.
KINDS = {".gif": "pillow", ".mp4": "ffmpeg", ".png": "one frame"}

#: A frame has few colours; with so many it is a third as long, and looks the same.
COLOURS = 48
#: Dots an inch by default, whatever the style is.
DOTS = 72
#: matplotlib's player takes its icons from elsewhere; these are letters of any font.
ICONS = {
    "minus": "&minus;",
    "fast-backward": "|&laquo;",
    "step-backward": "|&lsaquo;",
    "play fa-flip-horizontal": "&#9664;",
    "pause": "||",
    "play": "&#9654;",
    "step-forward": "&rsaquo;|",
    "fast-forward": "&raquo;|",
    "plus": "+",
}


def film_in_plane(shown: Film) -> str:
    """Return a page with matplotlib's own player, that needs no connection."""
    film = library("matplotlib.animation", "an animation", "plot")
    with _moving(shown) as animation, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.html"
        writer = film.HTMLWriter(
            fps=shown.fps, embed_frames=True, default_mode="loop", embed_limit=500
        )
        _save(animation, path, writer, shown)
        page = path.read_text(encoding="utf-8")
    page = re.sub(r'(?<=image/png;base64,)[^"]+', _smaller, page)
    page = re.sub(r"<link[^>]*>\s*", "", page)
    page = re.sub(r"(anim\w+) = new Animation\([^;]*;", r"\g<0> \1.play_animation();", page)
    return re.sub(r'<i class="fa fa-([^"]*)"></i>', lambda tag: ICONS[tag[1]], page)


def write_film(shown: Film, path: Path, kind: str, frame: int) -> None:
    """Write a film, or one frame of it, as files of its kind are.

    Raises InputError if what writes this kind is not installed.
    """
    film = library("matplotlib.animation", "an animation", "plot")
    if kind == ".mp4" and not film.writers.is_available("ffmpeg"):
        ffmpeg = library("imageio_ffmpeg", "an .mp4 file", "film")
        settings = library("matplotlib", "an animation", "plot").rcParams
        settings["animation.ffmpeg_path"] = ffmpeg.get_ffmpeg_exe()
    with _moving(shown) as animation:
        if kind == ".png":
            animation._func(frame)
            animation._fig.savefig(path, format="png", dpi=max(2 * DOTS, shown.dpi))
        else:
            _save(animation, path, film.writers[KINDS[kind]](fps=shown.fps), shown)


def _save(animation: Any, path: Path, writer: Any, shown: Film) -> None:
    with Progress(len(shown.t), None, "frame") as bar:
        animation.save(
            path, writer=writer, dpi=shown.dpi, progress_callback=lambda frame, all_: bar.add(1)
        )


def frame_scene(ax: Any, scene: Scene) -> None:
    """Give axes the limits of a scene, equal scales, and names."""
    for axis, middle in zip("xyz", scene.middle, strict=False):
        ax.set(**{f"{axis}lim": (middle - scene.reach, middle + scene.reach)})
        name_axis(ax, axis, axis, scene.unit)
    ax.set_aspect("equal")


@contextmanager
def _moving(shown: Film) -> Iterator[Any]:
    """Draw a scene frame by frame, in a style of its own."""
    matplotlib = library("matplotlib", "an animation", "plot")
    figures = library("matplotlib.figure", "an animation", "plot")
    film = library("matplotlib.animation", "an animation", "plot")
    scene = shown.scene
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):  # it has its own
        figure = figures.Figure(figsize=shown.size, dpi=shown.dpi)
        space = {"projection": "3d"} if scene.spatial else {}
        ax = figure.add_axes((0.16, 0.12, 0.8, 0.8), **space)
        frame_scene(ax, scene)
        ax.grid(lw=0.4, alpha=0.6)
        nothing, caption = np.empty((len(scene.middle), 0)), ax.set_title("", fontsize=10)
        trails = [ax.plot(*nothing, lw=0.9, color="C1", alpha=0.6)[0] for _ in scene.names]
        paint = painter(ax, scene)

        def draw(frame: int) -> list[Any]:
            for k, trail in enumerate(trails):
                _put(trail, scene.trail(frame, k))
            caption.set_text(f"{shown.title}: t = {float(shown.t[frame]):.2f}")
            return paint(frame)

        every, frames = 1000 / shown.fps, len(shown.t)
        animation = film.FuncAnimation(figure, draw, frames=frames, interval=every, blit=False)
        animation._draw_was_started = True  # a single frame needs no film
        yield animation


def painter(ax: Any, scene: Scene) -> Callable[[int], list[Any]]:
    """Return what draws the links, bodies and points of a frame."""
    nothing = np.empty((len(scene.middle), 0))
    rigid, loose = {"lw": 2, "ls": "-"}, {"lw": 0.8, "ls": ":"}
    lines = [
        ax.plot(*nothing, color="0.25", **(rigid if x.rigid else loose))[0] for x in scene.links
    ]
    bodies = [
        ax.plot(*nothing, color="C0", lw=1.6)[0]
        if scene.spatial
        else ax.fill([], [], color="C0", alpha=0.4)[0]
        for _ in scene.bodies
    ]
    (dots,) = ax.plot(*nothing, "o", ms=7, color="C0")

    def draw(frame: int) -> list[Any]:
        for line, link in zip(lines, scene.links, strict=True):
            _put(line, scene.ends(frame, link))
        for shape, body in zip(bodies, scene.bodies, strict=True):
            _put(shape, body[frame])
        _put(dots, scene.points[frame])
        return [*lines, *bodies, dots]

    return draw


def _put(shape: Any, points: Any) -> None:
    """Move a polygon, or a line in the plane or in space, to points."""
    if hasattr(shape, "set_xy"):
        shape.set_xy(points)
    else:
        getattr(shape, "set_data_3d", shape.set_data)(*points.T)


def _smaller(frame: re.Match[str]) -> str:
    """Return a picture in base64 with a palette of colours, on one line."""
    from PIL import Image  # which matplotlib needs, too

    written = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(frame[0].replace("\\\n", "")))) as picture:
        picture.convert("RGB").quantize(COLOURS).save(written, "png", optimize=True)
    return base64.b64encode(written.getvalue()).decode("ascii")


BODY, PATH, LINE = "#3b7dd8", "#e07b39", "#444444"


def film_in_space(shown: Film) -> str:
    """Return a page that carries plotly with it."""
    scene, t = shown.scene, shown.t
    width, height = (round(x * shown.dpi) for x in shown.size)
    go = library("plotly.graph_objects", "an animation in space", "plot")

    def parts(frame: int) -> list[Any]:
        gap = np.full((1, 3), np.nan)  # one line with gaps for all links
        links = [x for link in scene.links for x in (scene.ends(frame, link), gap)]
        trails = [_line(go, scene.trail(frame, k), PATH, 3) for k in range(len(scene.names))]
        bodies = []
        for body in scene.bodies:
            j = np.arange(1, len(body[frame]) - 2)
            triangles = {"i": 0 * j, "j": j, "k": j + 1, "color": BODY, "opacity": 0.5}
            bodies.append(go.Mesh3d(**_xyz(body[frame][:-1]), **triangles))
            bodies.append(_line(go, body[frame], BODY, 5))
        how = {"mode": "markers", "hovertext": scene.names, "marker": {"size": 4, "color": BODY}}
        dots = go.Scatter3d(**_xyz(scene.points[frame]), **how)
        return [_line(go, np.concatenate(links or [gap]), LINE, 6), *trails, *bodies, dots]

    ranges = {
        f"{axis}axis": {
            "range": [float(m - scene.reach), float(m + scene.reach)],
            "title": {"text": f"{axis} [{escape(scene.unit)}]" if scene.unit else axis},
        }
        for axis, m in zip("xyz", scene.middle, strict=True)
    }
    at_once = {"mode": "immediate", "transition": {"duration": 0}}
    frame = {"frame": {"duration": 1000 / shown.fps, "redraw": True}}
    play, jump = at_once | frame | {"fromcurrent": True}, at_once | frame
    buttons = [
        {"label": "&#9654;", "method": "animate", "args": [None, play]},
        {"label": "||", "method": "animate", "args": [[None], jump]},
    ]
    steps = [
        {"label": f"{float(now):.2f}", "method": "animate", "args": [[str(k)], jump]}
        for k, now in enumerate(t)
    ]
    at_left = {"direction": "left", "x": 0, "y": 0, "xanchor": "left", "pad": {"t": 30}}
    slider = {"steps": steps, "x": 0.2, "len": 0.78, "currentvalue": {"prefix": "t = "}}
    figure = go.Figure(
        data=parts(0),
        frames=[go.Frame(data=parts(k), name=str(k)) for k in range(len(t))],
        layout={
            "title": shown.title,
            "showlegend": False,
            "margin": {"l": 0, "r": 0, "t": 40, "b": 0},
            "scene": ranges | {"aspectmode": "cube"},
            "width": width,
            "height": height,
            "updatemenus": [{"type": "buttons", "buttons": buttons, **at_left}],
            "sliders": [slider],
        },
    )
    return str(figure.to_html(include_plotlyjs=True, full_html=True, animation_opts=play))


def _line(go: Any, points: Any, colour: str, width: float) -> Any:
    line = {"color": colour, "width": width}
    return go.Scatter3d(**_xyz(points), mode="lines", hoverinfo="skip", line=line)


def _xyz(points: Any) -> dict[str, Any]:
    return dict(zip("xyz", np.round(points, 6).T, strict=True))
