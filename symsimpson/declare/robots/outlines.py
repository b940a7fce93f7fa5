"""Positions to draw a robot: origins of joints, and outlines of shapes as closed polygons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from symsimpson.declare.robots.bodies_of_tree import Bodies
from symsimpson.declare.robots.recursion import Vector, attached, exact
from symsimpson.declare.robots.tree import RobotTree, Shape
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


def positions_of(
    tree: RobotTree, bodies: Bodies, places: Sequence[tuple[Vector, Vector]]
) -> dict[str, Any]:
    """Return the origins of joints, and the outlines of shapes."""
    positions: dict[str, Any] = {}
    for body, (origin, _) in zip(bodies.moving, places, strict=False):
        name = "base" if body.joint is None else body.joint.name
        positions[f"{name} origin"] = tuple(origin)
    for link in tree.links.values():
        number, place = bodies.links[link.name]
        origin, turn = attached(places[number], place)
        for k, shape in enumerate(link.shapes, 1):
            name = f"{link.name} {shape.kind}{f' {k}' if k > 1 else ''}"
            positions[name] = [tuple(origin + turn @ exact(x)) for x in outline(shape)]
    return positions
