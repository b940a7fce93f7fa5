"""Tables and small pictures in HTML. Whatever comes from a user is escaped here."""

from __future__ import annotations

import dataclasses
import html
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from symsimpson.support.array_types import Reals

__all__ = ["box", "curves", "facts", "fields_given", "scatter", "table"]

#: Points of a picture; more would not be seen.
POINTS = 240
#: A value that a user gave is shown up to so many characters.
LONGEST = 400
WIDTH, HEIGHT, MARGIN = 240.0, 48.0, 2.0
#: Colours that are told apart on a light page and on a dark one.
COLOURS = ("#3b7dd8", "#e07b39", "#3a9e6b", "#b455a0", "#8a7f2f", "#d1495b")
LEFT = ' style="text-align: left"'


def box(title: str, *parts: str) -> str:
    """Put parts under a title."""
    return f"<div><b>{html.escape(title)}</b>{''.join(parts)}</div>"


def facts(pairs: Sequence[tuple[str, object]]) -> str:
    """Lay out names and what they are; a part that is markup already is given as ``Markup``."""
    rows = "".join(
        f"<tr><th{LEFT}>{html.escape(name)}</th><td{LEFT}>{_cell(value)}</td></tr>"
        for name, value in pairs
    )
    return f"<table><tbody>{rows}</tbody></table>"


def fields_given(title: str, value: Any) -> str:
    """Put the fields of a dataclass that differ from their defaults under a title."""
    pairs = []
    for field in dataclasses.fields(value):
        given, factory = getattr(value, field.name), field.default_factory
        if given is not field.default and (not isinstance(factory, type) or given != factory()):
            if isinstance(given, Mapping):
                given = ", ".join(f"{key} = {x}" for key, x in given.items())
            text = str(getattr(given, "name", given))
            pairs.append((field.name, text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."))
    return box(title, facts(pairs))


def table(rows: Sequence[Sequence[object]]) -> str:
    """Lay out rows, the first of which is their head."""
    head, *body = rows
    first = "".join(f"<th{LEFT}>{_cell(cell)}</th>" for cell in head)
    rest = "".join(
        f"<tr><th{LEFT}>{_cell(row[0])}</th>"
        f"{''.join(f'<td{LEFT}>{_cell(cell)}</td>' for cell in row[1:])}</tr>"
        for row in body
    )
    return f"<table><thead><tr>{first}</tr></thead><tbody>{rest}</tbody></table>"


class Markup(str):
    """Text that is HTML already."""


def _cell(value: object) -> str:
    return value if isinstance(value, Markup) else html.escape(str(value))


def curves(x: Reals, columns: Sequence[Reals]) -> Markup:
    """Draw columns over x in one picture, each in its colour."""
    stride = max(1, -(-len(x) // POINTS))
    x = np.asarray(x[::stride], dtype=float)
    ys = [np.asarray(column[::stride], dtype=float) for column in columns]
    place = _Frame(x, np.concatenate(ys) if ys else x)
    lines = "".join(
        f'<polyline fill="none" stroke="{COLOURS[k % len(COLOURS)]}" points="{place(x, y)}"/>'
        for k, y in enumerate(ys)
    )
    return _picture(lines)


def scatter(x: Reals, y: Reals) -> Markup:
    """Draw points."""
    stride = max(1, -(-len(x) // (4 * POINTS)))
    x, y = (np.asarray(values[::stride], dtype=float) for values in (x, y))
    points = _Frame(x, y)(x, y).split()
    dots = "".join(
        '<circle cx="{}" cy="{}" r="0.9" fill="{}"/>'.format(*point.split(","), COLOURS[0])
        for point in points
    )
    return _picture(dots)


class _Frame:
    """Where points of finite numbers lie in a picture."""

    def __init__(self, x: Reals, y: Reals) -> None:
        self._x, self._y = (self._range(values) for values in (x, y))

    @staticmethod
    def _range(values: Reals) -> tuple[float, float]:
        finite = values[np.isfinite(values)]
        if not finite.size:
            return 0.0, 1.0
        low, high = float(finite.min()), float(finite.max())
        return low, (high - low) or 1.0

    def __call__(self, x: Reals, y: Reals) -> str:
        finite = np.isfinite(x) & np.isfinite(y)
        across = MARGIN + (x[finite] - self._x[0]) / self._x[1] * (WIDTH - 2 * MARGIN)
        down = HEIGHT - MARGIN - (y[finite] - self._y[0]) / self._y[1] * (HEIGHT - 2 * MARGIN)
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True))


def _picture(content: str) -> Markup:
    size = f'width="{WIDTH:g}" height="{HEIGHT:g}" viewBox="0 0 {WIDTH:g} {HEIGHT:g}"'
    return Markup(f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{content}</svg>')


def in_text(name: str) -> str:
    r"""Return a name for \text{...} in LaTeX, without what means something there."""
    return re.sub(r"[^A-Za-z0-9 ,()]", r"\\_", name)


def aligned(rows: Sequence[tuple[str, str]]) -> str:
    """Return equations in LaTeX, one below the other; lines without a left side are text."""
    text = r" \\ ".join(f"{left} &= {right}" if left else f"& {right}" for left, right in rows)
    return rf"$\displaystyle \begin{{aligned}} {text} \end{{aligned}}$"
