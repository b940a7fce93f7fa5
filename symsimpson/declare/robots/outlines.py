"""Outlines of shapes, as closed polygons."""

from __future__ import annotations

import numpy as np

from symsimpson.declare.robots.tree import Shape
from symsimpson.support.array_types import Floats

#: Corners of the polygons that are drawn for circles.
CORNERS = 8
#: A path around a square.
SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 0)])


def outline(shape: Shape) -> Floats:
    """Return the corners of a shape in the frame of its link, shape (m, 3)."""
    if shape.kind == "box":
        both = np.concatenate([SQUARE - np.eye(3)[2], SQUARE + np.eye(3)[2]])
        corners = both * np.array(shape.size) / 2
    else:
        radius, length = (*shape.size, 0.0)[:2]
        angles = 2 * np.pi * np.arange(CORNERS) / CORNERS
        circle = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        if shape.kind == "cylinder":
            up = np.array([0.0, 0.0, length / 2])
            corners = np.concatenate([circle - up, circle[:1] - up, circle + up, circle[:1] + up])
        else:
            corners = np.concatenate([circle, circle[:1], circle[:, [0, 2, 1]]])
    return corners @ shape.place.turn.T + shape.place.shift
