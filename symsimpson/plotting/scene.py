"""Where the points and bodies of a system are, and which points hold together."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from symsimpson.declare.declared import points_of
from symsimpson.errors import reject
from symsimpson.support.array_types import Floats
from symsimpson.support.names import spelled

#: Distances that change by less than this, of the size of the scene, do not change.
RIGID = 1e-6
#: A trail has the length of so many frames.
TRAIL = 40


class Link(NamedTuple):
    """A line that is drawn between two points; -1 is the origin."""

    first: int
    second: int
    rigid: bool


class Scene(NamedTuple):
    """Points and bodies over time."""

    names: tuple[str, ...]  #: Those of the points.
    #: The points, at the times of the frames and between them, of shape
    #: ((N - 1) stride + 1, k, 2 or 3).
    fine: Floats
    bodies: tuple[Floats, ...]  #: Closed lines, shape (N, corners + 1, 2 or 3).
    links: tuple[Link, ...]
    middle: Floats  #: shape (2 or 3,)
    reach: float  #: Nothing is farther from the middle, along an axis.
    stride: int  #: Points in ``fine`` from one frame to the next.
    unit: str  #: That of all positions.

    @property
    def points(self) -> Floats:
        """The points, shape (N, k, 2 or 3)."""
        return self.fine[:: self.stride]

    @property
    def spatial(self) -> bool:
        """Whether it has three dimensions."""
        return self.points.shape[2] == 3

    def trail(self, frame: int, which: int) -> Floats:
        """Return where a point has been of late, between the frames too."""
        return self.fine[max(0, frame - TRAIL) * self.stride : frame * self.stride + 1, which]

    def ends(self, frame: int, link: Link) -> Floats:
        """Return the two ends of a link in one frame."""
        first = self.points[frame, link.first] if link.first >= 0 else np.zeros_like(self.middle)
        return np.array([first, self.points[frame, link.second]])


class Film(NamedTuple):
    """A scene, the times of its frames, and how they are shown."""

    scene: Scene
    t: Floats
    fps: int
    title: str
    size: tuple[float, float]  #: In inches.
    dpi: float


def scene_of(some: Any, stride: int = 1) -> Scene:
    """Evaluate the positions that were declared with a system; each ``stride``-th state is a frame.

    Raises InputError if there are none.
    """
    flat = places_of(some)
    points = {name: x[:, None] for name, x in flat.items() if x.ndim == 2}
    bodies = [np.concatenate([x, x[:, :1]], axis=1) for x in flat.values() if x.ndim == 3]
    together = np.concatenate(list(points.values()) or [bodies[0][:, :0]], axis=1)
    links = _links(together)
    drawn = [together, *bodies, *([0 * together] if any(link.first < 0 for link in links) else [])]
    low = np.min([x.min(axis=(0, 1)) for x in drawn if x.size], axis=0)
    high = np.max([x.max(axis=(0, 1)) for x in drawn if x.size], axis=0)
    reach = 0.55 * float((high - low).max()) or 1.0
    thinned, middle = tuple(x[::stride] for x in bodies), (low + high) / 2
    unit = unit_of(some.program)
    return Scene(tuple(points), together, thinned, links, middle, reach, stride, unit)


def places_of(some: Any) -> dict[str, Floats]:
    """Return points, shape (N, 2 or 3), and corners of bodies, (N, corners, 2 or 3), by name.

    Raises InputError if there are none.
    """
    declared = some.program.declared
    positions = getattr(declared, "positions", None)
    if not positions:
        reject(
            f"{some.program.system}: nothing says where its points are.",
            remedy="Declare them: MechanicalSystem(..., positions={'bob': (l*sin(q), "
            "-l*cos(q))}), and "
            "compile that system; a stepper from a file has none.",
        )
    if not len(some):
        reject("there are no states to draw.", remedy="Take a longer run, or another part of it.")
    places = points_of(declared, some.t, some.q, some.parameter_values)
    dimension = max(2, *(x.shape[-1] for x in places.values()))
    return {
        name: np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, dimension - x.shape[-1])])
        for name, x in places.items()
    }


def unit_of(program: Any) -> str:
    """Return the unit of points, or of factors in them; "" if it is not known or they differ."""
    known, units = program.units, set()
    for name, place in program.declared.positions.items():
        terms = [term for axis in np.ravel(place) for term in axis.as_ordered_terms()]
        factors = {spelled(x) for term in terms for x in term.as_ordered_factors()}
        units |= {known[x] for x in ([name] if name in known else factors & set(known))}
    return units.pop() if len(units) == 1 else ""


def _links(points: Floats) -> tuple[Link, ...]:
    """Link each point to the one before it, or the origin, where their distance is constant.

    A single point that is free has a link that is not rigid.
    """
    links = []
    size = np.ptp(points, axis=(0, 1)).max() if points.size else 0.0
    for k in range(points.shape[1]):
        for before in (k - 1, -1):
            start = points[:, before] if before >= 0 else 0.0
            distance = np.linalg.norm(points[:, k] - start, axis=-1)
            if np.ptp(distance) <= RIGID * size:
                links.append(Link(before, k, True))
                break
    if not links and points.shape[1] == 1:
        links.append(Link(-1, 0, False))
    return tuple(links)
