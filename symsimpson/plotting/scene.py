"""Positions of points and bodies over time, and the lines between points."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from symsimpson.declare.declared import points_of
from symsimpson.errors import reject
from symsimpson.support.array_types import Floats
from symsimpson.support.names import spelled

#: A distance is constant if it changes by less than this fraction of the scene.
RIGID = 1e-6
#: Length of a trail, in frames.
TRAIL = 40


class Segment(NamedTuple):
    """A line between two points, given by their indices; -1 is the origin."""

    first: int
    second: int
    rigid: bool


class Scene(NamedTuple):
    """Points and bodies over time; N is the number of frames, k the number of points."""

    names: tuple[str, ...]  #: Names of the points.
    #: Points at the times of frames and between them, shape ((N - 1) stride + 1, k, 2 or 3).
    fine: Floats
    bodies: tuple[Floats, ...]  #: Closed polygons, shape (N, corners + 1, 2 or 3).
    links: tuple[Segment, ...]
    middle: Floats  #: Centre of the scene, shape (2 or 3,).
    reach: float  #: Largest distance from the middle along an axis.
    stride: int  #: Times in ``fine`` from one frame to the next.
    unit: str  #: Unit of all positions.

    @property
    def points(self) -> Floats:
        """Points at the times of frames, shape (N, k, 2 or 3)."""
        return self.fine[:: self.stride]

    @property
    def spatial(self) -> bool:
        """True for a scene of three dimensions."""
        return self.points.shape[2] == 3

    def trail(self, frame: int, which: int) -> Floats:
        """Return the recent path of a point, up to a frame."""
        return self.fine[max(0, frame - TRAIL) * self.stride : frame * self.stride + 1, which]

    def ends(self, frame: int, link: Segment) -> Floats:
        """Return both ends of a segment in a frame."""
        first = self.points[frame, link.first] if link.first >= 0 else np.zeros_like(self.middle)
        return np.array([first, self.points[frame, link.second]])


class FrameSequence(NamedTuple):
    """A scene, the times of its frames, and the settings of its animation."""

    scene: Scene
    t: Floats
    fps: int
    title: str
    size: tuple[float, float]  #: In inches.
    dpi: float


def build_scene(states: Any, stride: int = 1) -> Scene:
    """Return the scene of states; each ``stride``-th state is a frame.

    Raises InputError if the system declares no positions, or if there are no states.
    """
    flat = evaluate_positions(states)
    points = {name: x[:, None] for name, x in flat.items() if x.ndim == 2}
    bodies = [np.concatenate([x, x[:, :1]], axis=1) for x in flat.values() if x.ndim == 3]
    all_points = np.concatenate(list(points.values()) or [bodies[0][:, :0]], axis=1)
    links = _find_segments(all_points)
    origin = [0 * all_points] if any(link.first < 0 for link in links) else []
    drawn = [all_points, *bodies, *origin]
    low = np.min([x.min(axis=(0, 1)) for x in drawn if x.size], axis=0)
    high = np.max([x.max(axis=(0, 1)) for x in drawn if x.size], axis=0)
    reach = 0.55 * float((high - low).max()) or 1.0
    frame_bodies, middle = tuple(x[::stride] for x in bodies), (low + high) / 2
    unit = find_unit(states.program)
    return Scene(tuple(points), all_points, frame_bodies, links, middle, reach, stride, unit)


def evaluate_positions(states: Any) -> dict[str, Floats]:
    """Return points, shape (N, 2 or 3), and corners of bodies, (N, corners, 2 or 3), by name.

    Raises InputError if the system declares no positions, or if there are no states.
    """
    declared = states.program.declared
    positions = getattr(declared, "positions", None)
    if not positions:
        reject(
            "the system declares no positions.",
            where=states.program.system,
            why="Steppers from generated files never have positions.",
            remedy="Declare MechanicalSystem(..., positions={'bob': (l*sin(q), -l*cos(q))}), and "
            "compile this system.",
        )
    if not len(states):
        reject("there are no states to draw.", remedy="Use a longer run, or another part of it.")
    places = points_of(declared, states.t, states.q, states.parameter_values)
    dimension = max(2, *(x.shape[-1] for x in places.values()))
    return {
        name: np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, dimension - x.shape[-1])])
        for name, x in places.items()
    }


def find_unit(program: Any) -> str:
    """Return the common unit of all positions; "" if it is unknown or not unique."""
    known, units = program.units, set()
    for name, place in program.declared.positions.items():
        terms = [term for axis in np.ravel(place) for term in axis.as_ordered_terms()]
        factors = {spelled(x) for term in terms for x in term.as_ordered_factors()}
        units |= {known[x] for x in ([name] if name in known else factors & set(known))}
    return units.pop() if len(units) == 1 else ""


def _find_segments(points: Floats) -> tuple[Segment, ...]:
    """Connect each point to the point before it, or to the origin, if the distance is constant.

    A single point without a constant distance has a segment that is not rigid.
    """
    links = []
    size = np.ptp(points, axis=(0, 1)).max() if points.size else 0.0
    for k in range(points.shape[1]):
        for before in (k - 1, -1):
            start = points[:, before] if before >= 0 else 0.0
            distance = np.linalg.norm(points[:, k] - start, axis=-1)
            if np.ptp(distance) <= RIGID * size:
                links.append(Segment(before, k, True))
                break
    if not links and points.shape[1] == 1:
        links.append(Segment(-1, 0, False))
    return tuple(links)
