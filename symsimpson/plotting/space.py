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
    width, height = (round(x * shown.dpi) for x in shown.size)
    go = library("plotly.graph_objects", "an animation in space", "plot")

    def parts(frame: int) -> list[Any]:
        gap = np.full((1, 3), np.nan)  # one line with gaps for all links
        links = [x for link in scene.links for x in (scene.ends(frame, link), gap)]
        trails = [_line(go, scene.trail(frame, k), PATH, 3) for k in range(len(scene.names))]
        bodies = []
        for body in scene.bodies:
            j = np.arange(1, len(body[frame]) - 2)
            triangles = {"i": 0 * j, "j": j, "k": j + 1, "color": BODY, "opacity": 0.5}
            bodies.append(go.Mesh3d(**_xyz(body[frame][:-1]), **triangles))
            bodies.append(_line(go, body[frame], BODY, 5))
        how = {"mode": "markers", "hovertext": scene.names, "marker": {"size": 4, "color": BODY}}
        dots = go.Scatter3d(**_xyz(scene.points[frame]), **how)
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
    play, jump = at_once | frame | {"fromcurrent": True}, at_once | frame
    buttons = [
        {"label": "&#9654;", "method": "animate", "args": [None, play]},
        {"label": "||", "method": "animate", "args": [[None], jump]},
    ]
    steps = [
        {"label": f"{float(now):.2f}", "method": "animate", "args": [[str(k)], jump]}
        for k, now in enumerate(t)
    ]
    at_left = {"direction": "left", "x": 0, "y": 0, "xanchor": "left", "pad": {"t": 30}}
    slider = {"steps": steps, "x": 0.2, "len": 0.78, "currentvalue": {"prefix": "t = "}}
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
            "updatemenus": [{"type": "buttons", "buttons": buttons, **at_left}],
            "sliders": [slider],
        },
    )
    return str(figure.to_html(include_plotlyjs=True, full_html=True, animation_opts=play))


def _line(go: Any, points: Any, colour: str, width: float) -> Any:
    line = {"color": colour, "width": width}
    return go.Scatter3d(**_xyz(points), mode="lines", hoverinfo="skip", line=line)


def _xyz(points: Any) -> dict[str, Any]:
    return dict(zip("xyz", np.round(points, 6).T, strict=True))
