"""Films of a run, and where its points went."""

from __future__ import annotations

import html
import os
from collections.abc import Callable
from functools import cached_property, partial
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.plotting.axes import axes, colours
from symsimpson.plotting.pictures import KINDS, film_in_plane, write_film
from symsimpson.plotting.scene import scene_of
from symsimpson.plotting.space import film_in_space
from symsimpson.program.input_values import whole_number
from symsimpson.support.files import read_path, write_text, written_beside

__all__ = ["Animation", "animate", "plot_path"]

#: Runs of at most so many seconds are shown as fast as they are.
LONGEST = 10.0
#: A trail has so many points from one frame to the next.
FINE = 8


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
        self._make, self._write, self.frames, self._size = page, write, frames, size

    @cached_property
    def _page(self) -> str:
        return self._make()

    def save(self, path: str | os.PathLike[str], *, frame: int = 0) -> Path:
        """Write the film as the ending of the name says.

        Parameters
        ----------
        path : path
            In ``.html``, a page that plays anywhere; in ``.gif`` or ``.mp4`` (needs ffmpeg, or
            ``pip install imageio-ffmpeg``); or in ``.png``, one frame.
        frame : int
            Which one; a negative number counts from the end.

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
            raise InputError(
                f"{os.fspath(path)!r}, frame={frame!r}: there is no such kind of film, or frame."
                f"\nEnd the name in .html, .gif, .mp4 or .png; frames are 0 to {self.frames - 1}."
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


def animate(run: Any, *, seconds: float | None = None, fps: int = 20) -> Animation:
    """Film the points and bodies of a system."""
    numbers = all(isinstance(x, Real) for x in (fps, 1 if seconds is None else seconds))
    if not numbers or not 1 <= fps <= 100 or not (seconds is None or 0 < seconds <= 600):
        raise InputError(
            f"seconds={seconds!r}, fps={fps!r} make no film.\n"
            "Pass up to 600 seconds, and from 1 to 100 frames in each."
        )
    span = abs(float(run.t[-1] - run.t[0]))
    length = seconds or (span if 1 <= span <= LONGEST else LONGEST)
    frames = max(2, round(length * fps))
    t = np.linspace(float(run.t[0]), float(run.t[-1]), (frames - 1) * FINE + 1)
    scene = scene_of(run.at(t), FINE)
    title = f"{run.program.system}, {run.program.scheme}"
    make, size = (film_in_space, (640, 720)) if scene.spatial else (film_in_plane, (420, 470))
    shown = scene, t[::FINE], fps, title
    return Animation(partial(make, *shown), partial(write_film, *shown), frames, size)


def plot_path(run: Any, *, ax: Any = None) -> Any:
    """Draw the paths of the points of a system, and where all is in the end."""
    scene = scene_of(run)
    in_space = {"subplot_kw": {"projection": "3d"}} if scene.spatial else {}
    ax = axes(ax, (5, 5) if scene.spatial else (4.5, 4.5), **in_space)
    if scene.spatial and not hasattr(ax, "set_zlim"):
        raise InputError(
            f"{run.program.system} moves in space, and these axes are plane.\n"
            "Make axes with plt.subplots(subplot_kw={'projection': '3d'}), or leave ax out."
        )
    for k, (name, colour) in enumerate(zip(scene.names, colours(len(scene.names)), strict=True)):
        ax.plot(*scene.fine[:, k].T, lw=0.7, color=colour, alpha=0.8, label=name)
    for link in scene.links:
        style = {"lw": 1.6, "ls": "-"} if link.rigid else {"lw": 0.8, "ls": ":"}
        ax.plot(*scene.ends(-1, link).T, color="0.25", **style)
    for body in scene.bodies:
        ax.plot(*body[-1].T, color="0.25", lw=1.6)
    ax.plot(*scene.points[-1].T, "o", color="C0", ms=6)
    for axis, middle in zip("xyz", scene.middle, strict=False):
        getattr(ax, f"set_{axis}lim")(middle - scene.reach, middle + scene.reach)
    ax.set_aspect("equal")
    ax.set(title=f"{run.program.system}, {run.program.scheme}", xlabel="x", ylabel="y")
    if len(scene.names) > 1:
        ax.legend(fontsize=8)
    return ax
