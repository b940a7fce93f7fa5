"""Films of what moves in space, by plotly."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from symsimpson.plotting.scene import Film
from symsimpson.support.extras import library

__all__ = ["film_in_space"]

BODY, PATH, LINE = "#3b7dd8", "#e07b39", "#444444"


def film_in_space(shown: Film) -> str:
    """Return a page that carries plotly with it."""
    scene, t = shown.scene, shown.t
    trail = "lines" if scene.joined else "markers"
    width, height = (round(x * shown.dpi) for x in shown.size)
    go = library("plotly.graph_objects", "an animation in space", "plot")

    def parts(frame: int) -> list[Any]:
        gap = np.full((1, 3), np.nan)  # one line with gaps for all links
        links = [x for link in scene.links for x in (scene.ends(frame, link), gap)]
        trails = [_line(go, scene.trail(frame, k), PATH, 3, trail) for k in range(len(scene.names))]
        bodies = []
        for body in scene.bodies:
            corners = len(body[frame]) - 1
            triangles = {
                "i": [0] * (corners - 2),
                "j": list(range(1, corners - 1)),
                "k": list(range(2, corners)),
            }
            bodies.append(go.Mesh3d(**_xyz(body[frame][:-1]), **triangles, color=BODY, opacity=0.5))
            bodies.append(_line(go, body[frame], BODY, 5))
        dots = go.Scatter3d(
            **_xyz(scene.points[frame]),
            mode="markers",
            hovertext=scene.names,
            marker={"size": 4, "color": BODY},
        )
        return [_line(go, np.concatenate(links or [gap]), LINE, 6), *trails, *bodies, dots]

    ranges = {
        f"{axis}axis": {
            "range": [float(m - scene.reach), float(m + scene.reach)],
            "title": {"text": f"{axis} [{escape(scene.unit)}]" if scene.unit else axis},
        }
        for axis, m in zip("xyz", scene.middle, strict=True)
    }
    at_once = {"mode": "immediate", "transition": {"duration": 0}}
    frame = {"frame": {"duration": 1000 / shown.fps, "redraw": True}}
    buttons = [
        {
            "label": "&#9654;",
            "method": "animate",
            "args": [None, at_once | frame | {"fromcurrent": True}],
        },
        {"label": "||", "method": "animate", "args": [[None], at_once | frame]},
    ]
    steps = [
        {"label": f"{float(now):.2f}", "method": "animate", "args": [[str(k)], at_once | frame]}
        for k, now in enumerate(t)
    ]
    figure = go.Figure(
        data=parts(0),
        frames=[go.Frame(data=parts(k), name=str(k)) for k in range(len(t))],
        layout={
            "title": shown.title,
            "showlegend": False,
            "margin": {"l": 0, "r": 0, "t": 40, "b": 0},
            "scene": ranges | {"aspectmode": "cube"},
            "width": width,
            "height": height,
            "updatemenus": [
                {
                    "type": "buttons",
                    "direction": "left",
                    "buttons": buttons,
                    "x": 0.0,
                    "y": 0.0,
                    "xanchor": "left",
                    "yanchor": "top",
                    "pad": {"t": 30},
                }
            ],
            "sliders": [
                {"steps": steps, "x": 0.2, "len": 0.78, "currentvalue": {"prefix": "t = "}}
            ],
        },
    )
    page = figure.to_html(
        include_plotlyjs=True,
        full_html=True,
        animation_opts=at_once | frame | {"fromcurrent": True},
    )
    return str(page)


def _line(go: Any, points: Any, colour: str, width: float, mode: str = "lines") -> Any:
    style = {
        mode.removesuffix("s"): {"color": colour, "width" if mode == "lines" else "size": width}
    }
    return go.Scatter3d(**_xyz(points), mode=mode, hoverinfo="skip", **style)


def _xyz(points: Any) -> dict[str, Any]:
    return dict(zip("xyz", np.round(points, 6).T, strict=True))
