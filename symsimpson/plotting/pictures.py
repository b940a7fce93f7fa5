"""Films by matplotlib: a page for what moves in a plane, files of pictures for anything."""

from __future__ import annotations

import base64
import io
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from symsimpson.plotting.axes import name_axis
from symsimpson.plotting.scene import Film, Scene
from symsimpson.support.extras import library
from symsimpson.support.progress import Progress

__all__ = ["KINDS", "film_in_plane", "frame_scene", "painter", "write_film"]

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
