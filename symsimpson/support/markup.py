"""Tables and small pictures in HTML. This module escapes all texts of the user."""

from __future__ import annotations

import dataclasses
import html
import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from symsimpson.support.array_types import Reals

#: Points of a picture: one for each pixel of its width.
POINTS = 240
#: Longer values of the user are cut to this number of characters.
LONGEST = 400
WIDTH, HEIGHT, MARGIN = 240.0, 48.0, 2.0
#: Colours that differ clearly on a light and on a dark page.
COLOURS = ("#3b7dd8", "#e07b39", "#3a9e6b", "#b455a0", "#8a7f2f", "#d1495b")
LEFT = ' style="text-align: left"'


def box(title: str, *parts: str) -> str:
    """Return a title with HTML parts below it."""
    return f"<div><b>{html.escape(title)}</b>{''.join(parts)}</div>"


def facts(pairs: Sequence[tuple[str, object]]) -> str:
    """Return a table of names and values. A value of type ``Markup`` is not escaped."""
    return f"<table><tbody>{''.join(map(_row, pairs))}</tbody></table>"


def _row(cells: Sequence[object], names: int = 1) -> str:
    """Return a row of a table. The first ``names`` cells are headings."""
    tags = ["th"] * names + ["td"] * (len(cells) - names)
    escaped = (x if isinstance(x, Markup) else html.escape(str(x)) for x in cells)
    shown = zip(tags, escaped, strict=True)
    return f"<tr>{''.join(f'<{tag}{LEFT}>{cell}</{tag}>' for tag, cell in shown)}</tr>"


def fields_given(title: str, value: Any) -> str:
    """Return a title, and a table of the fields of a dataclass that differ from their defaults."""
    pairs = []
    for field in dataclasses.fields(value):
        given = getattr(value, field.name)
        if isinstance(given, Mapping):
            given = ", ".join(f"{key} = {x}" for key, x in given.items()) or field.default
        if given is not field.default:
            pairs.append(
                (field.name, textwrap.shorten(str(getattr(given, "name", given)), LONGEST))
            )
    return box(title, facts(pairs))


def table(rows: Sequence[Sequence[object]]) -> str:
    """Return a table. The first row contains the headings."""
    head, *body = rows
    lines = "".join(map(_row, body))
    return f"<table><thead>{_row(head, len(head))}</thead><tbody>{lines}</tbody></table>"


class Markup(str):
    """A text that is already HTML."""


def curves(x: Reals, columns: Sequence[Reals]) -> Markup:
    """Draw curves over x in one picture, each in its own colour."""
    some = slice(None, None, max(1, -(-len(x) // POINTS)))
    across, rows = _scaled(x[some], WIDTH), [column[some] for column in columns]
    drawn = [_points(across, y) for y in HEIGHT - _scaled(rows, HEIGHT)]
    lines = "".join(
        f'<polyline fill="none" stroke="{COLOURS[k % len(COLOURS)]}" points="{points}"/>'
        for k, points in enumerate(drawn)
    )
    return _picture(lines)


def scatter(x: Reals, y: Reals) -> Markup:
    """Draw the points (x, y) as dots."""
    some = slice(None, None, max(1, -(-len(x) // (4 * POINTS))))
    dots = "".join(
        '<circle cx="{}" cy="{}" r="0.9" fill="{}"/>'.format(*point.split(","), COLOURS[0])
        for point in _points(_scaled(x[some], WIDTH), HEIGHT - _scaled(y[some], HEIGHT)).split()
    )
    return _picture(dots)


def _scaled(given: Any, size: float) -> Any:
    """Scale numbers to the width or height ``size`` of a picture, within the margins."""
    values = np.asarray(given, dtype=float)
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return MARGIN + (values - low) / ((high - low) or 1.0) * (size - 2 * MARGIN)


def _points(across: Any, down: Any) -> str:
    finite = np.isfinite(across) & np.isfinite(down)
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across[finite], down[finite], strict=True))


def _picture(content: str) -> Markup:
    size = f'width="{WIDTH:g}" height="{HEIGHT:g}" viewBox="0 0 {WIDTH:g} {HEIGHT:g}"'
    return Markup(f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{content}</svg>')


def in_text(name: str) -> str:
    r"""Escape a name for \text{...} in LaTeX."""
    return re.sub(r"[^A-Za-z0-9 ,()]", r"\\_", name)


def aligned(rows: Sequence[tuple[str, str]]) -> str:
    """Return aligned LaTeX equations, one a line. Rows without a left side are text."""
    text = r" \\ ".join(f"{left} &= {right}" if left else f"& {right}" for left, right in rows)
    return rf"$\displaystyle \begin{{aligned}} {text} \end{{aligned}}$"
