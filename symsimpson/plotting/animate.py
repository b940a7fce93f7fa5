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
from symsimpson.plotting.axes import axes, colours, label, legend, style
from symsimpson.plotting.curve import curve_of
from symsimpson.plotting.pictures import KINDS, film_in_plane, frame_scene, painter, write_film
from symsimpson.plotting.scene import Film, places_of, scene_of
from symsimpson.plotting.space import film_in_space
from symsimpson.program.input_values import whole_number
from symsimpson.support.files import read_path, write_text, written_beside

__all__ = ["Animation", "animate", "plot_path"]

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
        raise InputError(
            f"seconds={seconds!r}, fps={fps!r} make no film.\n"
            "Pass up to 600 seconds, and from 1 to 100 frames in each."
        )
    sizes = [dpi, *np.ravel((1, 1) if figsize is None else figsize)]
    real = all(isinstance(x, Real) for x in sizes)
    if len(sizes) != 3 or not real or not all(0 < x < MOST_DOTS for x in sizes):
        raise InputError(
            f"figsize={figsize!r}, dpi={dpi!r} are no size of a figure.\n"
            "Pass a width and a height in inches, and dots per inch: figsize=(6, 4), dpi=100."
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
        raise InputError(
            f"{run.program.system} moves in space, and these axes are plane.\n"
            "Make axes with plt.subplots(subplot_kw={'projection': '3d'}), or leave ax out."
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
