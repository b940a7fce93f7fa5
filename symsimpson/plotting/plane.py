"""Films of what moves in a plane, by matplotlib."""

from __future__ import annotations

import base64
import io
import re
import tempfile
from pathlib import Path
from typing import Any

from symsimpson.extras import library
from symsimpson.plotting.scene import Scene
from symsimpson.progress import Progress

__all__ = ["film_in_plane"]

#: A frame has few colours; with so many it is a third as long, and looks the same.
COLOURS = 48
#: Dots an inch, whatever the style is.
DOTS = 72
#: matplotlib's player takes its icons from elsewhere; these are letters of any font.
ICONS = {
    "minus": "&minus;", "fast-backward": "|&laquo;", "step-backward": "|&lsaquo;",
    "play fa-flip-horizontal": "&#9664;", "pause": "||", "play": "&#9654;",
    "step-forward": "&rsaquo;|", "fast-forward": "&raquo;|", "plus": "+",
}  # fmt: skip


def film_in_plane(scene: Scene, t: Any, fps: int, title: str) -> str:
    """Return a page with matplotlib's own player, that needs no connection."""
    matplotlib = library("matplotlib", "an animation", "plot")
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):  # it has its own
        return _film(scene, t, fps, title)


def _film(scene: Scene, t: Any, fps: int, title: str) -> str:
    figures = library("matplotlib.figure", "an animation", "plot")
    film = library("matplotlib.animation", "an animation", "plot")
    figure = figures.Figure(figsize=(4.2, 4.2), dpi=DOTS)
    ax = figure.add_axes((0.13, 0.08, 0.84, 0.84))
    (x, y), reach = scene.middle, scene.reach
    ax.set(xlim=(x - reach, x + reach), ylim=(y - reach, y + reach), aspect="equal")
    ax.grid(lw=0.4, alpha=0.6)
    caption = ax.set_title("", fontsize=10)
    trails = [ax.plot([], [], lw=0.9, color="C1", alpha=0.6)[0] for _ in scene.names]
    lines = [
        ax.plot([], [], color="0.25", lw=2.2 if link.rigid else 0.8, ls="-" if link.rigid else ":")
        for link in scene.links
    ]
    bodies = [ax.fill([], [], color="C0", alpha=0.4)[0] for _ in scene.bodies]
    (dots,) = ax.plot([], [], "o", ms=9, color="C0")

    def draw(frame: int) -> list[Any]:
        for k, trail in enumerate(trails):
            trail.set_data(*scene.trail(frame, k).T)
        for (line,), link in zip(lines, scene.links, strict=True):
            line.set_data(*scene.ends(frame, link).T)
        for patch, body in zip(bodies, scene.bodies, strict=True):
            patch.set_xy(body[frame])
        dots.set_data(*scene.points[frame].T)
        caption.set_text(f"{title}: t = {float(t[frame]):.2f}")
        return [*trails, dots, caption]

    made = film.FuncAnimation(figure, draw, frames=len(t), interval=1000 / fps, blit=False)
    with tempfile.TemporaryDirectory() as folder, Progress(len(t), None, "frame") as bar:
        path = Path(folder) / "film.html"
        writer = film.HTMLWriter(fps=fps, embed_frames=True, default_mode="loop", embed_limit=500)
        made.save(path, writer=writer, dpi=DOTS, progress_callback=lambda frame, frames: bar.add(1))
        page = path.read_text(encoding="utf-8")
    page = re.sub(r'(?<=image/png;base64,)[^"]+', _smaller, page)
    page = re.sub(r"<link[^>]*>\s*", "", page)
    page = re.sub(r"(anim\w+) = new Animation\([^;]*;", r"\g<0> \1.play_animation();", page)
    return re.sub(r'<i class="fa fa-([^"]*)"></i>', lambda found: ICONS[found[1]], page)


def _smaller(frame: re.Match[str]) -> str:
    """Return a picture in base64 with a palette of colours, on one line."""
    from PIL import Image  # which matplotlib needs, too

    written = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(frame[0].replace("\\\n", "")))) as picture:
        picture.convert("RGB").quantize(COLOURS).save(written, "png", optimize=True)
    return base64.b64encode(written.getvalue()).decode("ascii")
