"""Animations of a run: matplotlib for plane motions, plotly for motions in space."""

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
from symsimpson.plotting.axes import (
    add_legend,
    choose_colours,
    escape_label,
    get_axes,
    line_style,
    name_axis,
)
from symsimpson.plotting.run_figures import refine_curve
from symsimpson.plotting.scene import FrameSequence, Scene, build_scene, evaluate_positions
from symsimpson.program.input_values import whole_number
from symsimpson.support.extras import import_library
from symsimpson.support.files import atomic_path, read_path, write_text
from symsimpson.support.progress import Progress

#: Runs of 1 to LONGEST seconds are animated in real time.
LONGEST = 10.0
#: Points of a trail from one frame to the next.
FINE = 8
#: Upper limit of the width and height in inches, and of dots per inch.
MOST_DOTS = 1000


class Animation:
    """An animation of a run, which a notebook displays without an internet connection.

    ``run.animate()`` returns it.

    Attributes
    ----------
    frames : int
        The number of frames.

    Examples
    --------
    >>> import symsimpson as ss
    >>> system = ss.systems.pendulum()
    >>> run = ss.compile(system).integrate(**system.reference_state, h=0.1, steps=20)
    >>> run.animate(seconds=2, fps=10)
    Animation(20 frames; save('film.html') keeps it)
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
        """Save the animation, or one frame, to a file.

        Parameters
        ----------
        path : str or path-like
            The name of the file. Its extension selects the format: ``.html`` for a page that any
            browser plays, ``.gif``, ``.mp4``, or ``.png`` for one frame. The format ``.mp4`` needs
            ffmpeg, or ``pip install imageio-ffmpeg``.
        frame : int
            The number of the frame in a ``.png`` file. The default is 0. Negative numbers count
            from the end.

        Returns
        -------
        pathlib.Path
            The path of the file.

        Raises
        ------
        InputError
            If the extension is unknown, the frame does not exist, or a library is missing.
        StorageError
            If the file cannot be written.
        """
        place = read_path("the file of the animation", path)
        if place.suffix == ".html":
            return write_text(path, self._page, "animation")
        known = whole_number(frame)
        if place.suffix not in KINDS or known not in range(-self.frames, self.frames):
            reject(
                f"path is {os.fspath(path)!r} and frame is {frame!r}, but one of them is invalid.",
                remedy="Use the extension .html, .gif, .mp4 or .png, and a frame from 0 to "
                f"{self.frames - 1}.",
            )
        with atomic_path(place, "animation") as file:
            self._write(file, place.suffix, int(frame) % self.frames)
        return place

    def _repr_html_(self) -> str:
        width, height = self._size
        # a separate page, so that its scripts run and do not affect the notebook
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
    """Return an animation of the points and bodies of a system."""
    numbers = all(isinstance(x, Real) for x in (fps, 1 if seconds is None else seconds))
    if not numbers or not 1 <= fps <= 100 or not (seconds is None or 0 < seconds <= 600):
        reject(
            f"seconds is {seconds!r} and fps is {fps!r}, but one of them is out of range.",
            remedy="Pass at most 600 seconds, and 1 to 100 frames per second.",
        )
    sizes = [dpi, *np.ravel((1, 1) if figsize is None else figsize)]
    real = all(isinstance(x, Real) for x in sizes)
    if len(sizes) != 3 or not real or not all(0 < x < MOST_DOTS for x in sizes):
        reject(
            f"figsize is {figsize!r} and dpi is {dpi!r}, which is not a size of a figure.",
            remedy="Pass a width and a height in inches, and dots per inch: figsize=(6, 4), "
            f"dpi=100. All must be below {MOST_DOTS}.",
        )
    span = abs(float(run.t[-1] - run.t[0]))
    length = seconds or (span if 1 <= span <= LONGEST else LONGEST)
    frames = max(2, round(length * fps))
    t = np.linspace(float(run.t[0]), float(run.t[-1]), (frames - 1) * FINE + 1)
    scene = build_scene(run.at(t), FINE)
    inches, more = ((8.3, 9.2), 50) if scene.spatial else ((4.2, 4.2), 168)
    make = make_space_page if scene.spatial else make_plane_page
    title = f"{run.program.system}, {run.program.scheme}"
    width, height = figsize or inches
    sequence = FrameSequence(scene, t[::FINE], fps, title, (width, height), dpi)
    size = max(round(width * dpi) + 50, 420), round(height * dpi) + more
    return Animation(partial(make, sequence), partial(write_animation, sequence), frames, size)


def list_positions(states: Any) -> list[Any]:
    """Return an array of all positions at states, in a list."""
    places = evaluate_positions(states).values()
    return [np.concatenate([x.reshape(len(states), -1) for x in places], axis=1)]


def plot_path(run: Any, *, connected: bool = True, ax: Any = None) -> Any:
    """Draw the paths of all points, and points and bodies at the final time."""
    curve = refine_curve(run, list_positions, connected)
    scene = build_scene(curve.states)
    in_space = {"subplot_kw": {"projection": "3d"}} if scene.spatial else {}
    ax = get_axes(ax, (5, 5) if scene.spatial else (4.5, 4.5), **in_space)
    if scene.spatial and not hasattr(ax, "set_zlim"):
        reject(
            "ax has two dimensions, but the motion has three.",
            where=run.program.system,
            remedy="Make axes with plt.subplots(subplot_kw={'projection': '3d'}), or leave ax out.",
        )
    jumps = np.flatnonzero(np.diff(curve.states.t) == 0)  # events may move points instantly
    paths = np.insert(scene.fine, jumps + 1, np.nan, axis=0)
    how = line_style(curve.connected, len(scene.fine), 0.7)
    colours = choose_colours(len(scene.names))
    for k, (name, colour) in enumerate(zip(scene.names, colours, strict=True)):
        ax.plot(*paths[:, k].T, color=colour, label=escape_label(name), **how)
    make_painter(ax, scene)(-1)
    frame_scene(ax, scene)
    ax.set_title(f"{run.program.system}, {run.program.scheme}")
    if len(scene.names) > 1:
        add_legend(ax)
    return ax


#: Writers of matplotlib by file extension.
KINDS = {".gif": "pillow", ".mp4": "ffmpeg", ".png": "one frame"}

#: Colours of a frame. A palette of 48 colours reduces the size to a third, and looks the same.
COLOURS = 48
#: Dots per inch by default, in any style.
DOTS = 72
#: Replacements for the icons of matplotlib's player, which it would load from the internet.
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


def make_plane_page(sequence: FrameSequence) -> str:
    """Return an HTML page with matplotlib's player, which needs no internet connection."""
    animations = import_library("matplotlib.animation", "an animation", "plot")
    with _draw_frames(sequence) as animation, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.html"
        writer = animations.HTMLWriter(
            fps=sequence.fps, embed_frames=True, default_mode="loop", embed_limit=500
        )
        _save_frames(animation, path, writer, sequence)
        page = path.read_text(encoding="utf-8")
    page = re.sub(r'(?<=image/png;base64,)[^"]+', _compress_picture, page)
    page = re.sub(r"<link[^>]*>\s*", "", page)
    page = re.sub(r"(anim\w+) = new Animation\([^;]*;", r"\g<0> \1.play_animation();", page)
    return re.sub(r'<i class="fa fa-([^"]*)"></i>', lambda tag: ICONS[tag[1]], page)


def write_animation(sequence: FrameSequence, path: Path, kind: str, frame: int) -> None:
    """Write an animation, or one frame of it, to a file of the given extension.

    Raises InputError if a library for this format is not installed.
    """
    animations = import_library("matplotlib.animation", "an animation", "plot")
    if kind == ".mp4" and not animations.writers.is_available("ffmpeg"):
        ffmpeg = import_library("imageio_ffmpeg", "an .mp4 file", "film")
        settings = import_library("matplotlib", "an animation", "plot").rcParams
        settings["animation.ffmpeg_path"] = ffmpeg.get_ffmpeg_exe()
    with _draw_frames(sequence) as animation:
        if kind == ".png":
            animation._func(frame)
            animation._fig.savefig(path, format="png", dpi=max(2 * DOTS, sequence.dpi))
        else:
            writer = animations.writers[KINDS[kind]](fps=sequence.fps)
            _save_frames(animation, path, writer, sequence)


def _save_frames(animation: Any, path: Path, writer: Any, sequence: FrameSequence) -> None:
    with Progress(len(sequence.t), None, "frame") as bar:
        animation.save(
            path, writer=writer, dpi=sequence.dpi, progress_callback=lambda frame, all_: bar.add(1)
        )


def frame_scene(ax: Any, scene: Scene) -> None:
    """Set the limits of a scene, equal scales and the labels of axes."""
    for axis, middle in zip("xyz", scene.middle, strict=False):
        ax.set(**{f"{axis}lim": (middle - scene.reach, middle + scene.reach)})
        name_axis(ax, axis, axis, scene.unit)
    ax.set_aspect("equal")


@contextmanager
def _draw_frames(sequence: FrameSequence) -> Iterator[Any]:
    """Yield the animation of a scene, in the same style for all users."""
    matplotlib = import_library("matplotlib", "an animation", "plot")
    figures = import_library("matplotlib.figure", "an animation", "plot")
    animations = import_library("matplotlib.animation", "an animation", "plot")
    scene = sequence.scene
    # the axes have a fixed position
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):
        figure = figures.Figure(figsize=sequence.size, dpi=sequence.dpi)
        space = {"projection": "3d"} if scene.spatial else {}
        ax = figure.add_axes((0.16, 0.12, 0.8, 0.8), **space)
        frame_scene(ax, scene)
        ax.grid(lw=0.4, alpha=0.6)
        nothing, caption = np.empty((len(scene.middle), 0)), ax.set_title("", fontsize=10)
        trails = [ax.plot(*nothing, lw=0.9, color="C1", alpha=0.6)[0] for _ in scene.names]
        paint = make_painter(ax, scene)

        def draw(frame: int) -> list[Any]:
            for k, trail in enumerate(trails):
                _move_shape(trail, scene.trail(frame, k))
            caption.set_text(f"{sequence.title}: t = {float(sequence.t[frame]):.2f}")
            return paint(frame)

        every, frames = 1000 / sequence.fps, len(sequence.t)
        timing = {"frames": frames, "interval": every, "blit": False}
        animation = animations.FuncAnimation(figure, draw, **timing)
        animation._draw_was_started = True  # avoids a warning if only one frame is drawn
        yield animation


def make_painter(ax: Any, scene: Scene) -> Callable[[int], list[Any]]:
    """Return a function that draws the segments, bodies and points of a frame."""
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
            _move_shape(line, scene.ends(frame, link))
        for shape, body in zip(bodies, scene.bodies, strict=True):
            _move_shape(shape, body[frame])
        _move_shape(dots, scene.points[frame])
        return [*lines, *bodies, dots]

    return draw


def _move_shape(shape: Any, points: Any) -> None:
    """Set the points of a polygon, or of a line in two or three dimensions."""
    if hasattr(shape, "set_xy"):
        shape.set_xy(points)
    else:
        getattr(shape, "set_data_3d", shape.set_data)(*points.T)


def _compress_picture(frame: re.Match[str]) -> str:
    """Return a base64 picture with a reduced palette, without line breaks."""
    from PIL import Image  # matplotlib depends on it

    buffer = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(frame[0].replace("\\\n", "")))) as picture:
        picture.convert("RGB").quantize(COLOURS).save(buffer, "png", optimize=True)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


BODY, PATH, LINE = "#3b7dd8", "#e07b39", "#444444"


def make_space_page(sequence: FrameSequence) -> str:
    """Return an HTML page that includes plotly."""
    scene, t = sequence.scene, sequence.t
    width, height = (round(x * sequence.dpi) for x in sequence.size)
    go = import_library("plotly.graph_objects", "an animation in space", "plot")

    def parts(frame: int) -> list[Any]:
        gap = np.full((1, 3), np.nan)  # one line with gaps for all segments
        links = [x for link in scene.links for x in (scene.ends(frame, link), gap)]
        trails = [_make_line(go, scene.trail(frame, k), PATH, 3) for k in range(len(scene.names))]
        bodies = []
        for body in scene.bodies:
            j = np.arange(1, len(body[frame]) - 2)
            triangles = {"i": 0 * j, "j": j, "k": j + 1, "color": BODY, "opacity": 0.5}
            bodies.append(go.Mesh3d(**_to_columns(body[frame][:-1]), **triangles))
            bodies.append(_make_line(go, body[frame], BODY, 5))
        how = {"mode": "markers", "hovertext": scene.names, "marker": {"size": 4, "color": BODY}}
        dots = go.Scatter3d(**_to_columns(scene.points[frame]), **how)
        return [_make_line(go, np.concatenate(links or [gap]), LINE, 6), *trails, *bodies, dots]

    ranges = {
        f"{axis}axis": {
            "range": [float(m - scene.reach), float(m + scene.reach)],
            "title": {"text": f"{axis} [{escape(scene.unit)}]" if scene.unit else axis},
        }
        for axis, m in zip("xyz", scene.middle, strict=True)
    }
    at_once = {"mode": "immediate", "transition": {"duration": 0}}
    frame = {"frame": {"duration": 1000 / sequence.fps, "redraw": True}}
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
            "title": sequence.title,
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


def _make_line(go: Any, points: Any, colour: str, width: float) -> Any:
    line = {"color": colour, "width": width}
    return go.Scatter3d(**_to_columns(points), mode="lines", hoverinfo="skip", line=line)


def _to_columns(points: Any) -> dict[str, Any]:
    return dict(zip("xyz", np.round(points, 6).T, strict=True))
