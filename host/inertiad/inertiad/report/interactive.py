# SPDX-License-Identifier: Apache-2.0
"""Drawings for the page: dictionaries that plotly.js draws. page.js puts in colours, sizes and the grid of panels.

Colours are "@role" or "@role/opacity" until the browser knows its theme; a panel's axes are numbered in reading order.
"""

from typing import Any, Final

import numpy as np

from inertiad.base.table import Array
from inertiad.report.figure import (
    SERIES,
    Bars,
    Color,
    Dots3,
    Drawing,
    Figure,
    Heat,
    Line,
    Mark,
    Mesh3,
    Panel,
    Path3,
    Points,
    Rule,
    Scene,
    View,
)

SIGNED: Final = [[0.0, "#2563a8"], [0.5, "@ground"], [1.0, "#c2410c"]]
MENU: Final[dict[str, Any]] = {
    "type": "buttons",
    "direction": "right",
    "showactive": False,
    "bgcolor": "@ground",
    "bordercolor": "@muted",
    "x": 0,
    "y": 1.06,
    "xanchor": "left",
}
IN_SIGHT: Final = 0.88
"""size of a view's box in plotly's scene, where the camera sees all of it"""
UNSIGNED: Final = [[0.0, "@ground"], [1.0, "#1f5fa8"]]


def _color(color: Color, opacity: float | None = None) -> str:
    name = SERIES[color % len(SERIES)] if isinstance(color, int) else f"@{color}"
    return name if opacity is None else f"{name}/{opacity:g}"


def _numbers(values: Any) -> list[float | None]:
    """Five digits: more than a screen shows, a third of the bytes."""
    return [None if not np.isfinite(v) else float(f"{v:.5g}") for v in np.asarray(values, dtype=float).ravel().tolist()]


def _band(mark: Line, axes: dict[str, str]) -> dict[str, Any]:
    assert mark.half is not None
    x = np.concatenate([mark.x, mark.x[::-1]])
    y = np.concatenate([mark.y + mark.half, (mark.y - mark.half)[::-1]])
    fill = {"fill": "toself", "fillcolor": _color(mark.color, 0.2), "line": {"width": 0}, "hoverinfo": "skip"}
    return {"type": "scatter", "mode": "lines", "x": _numbers(x), "y": _numbers(y), "showlegend": False, **fill, **axes}


def _of_line(mark: Line, axes: dict[str, str]) -> list[dict[str, Any]]:
    style = {"color": _color(mark.color), "width": mark.width, "dash": "dash" if mark.dashed else "solid"}
    trace = {"type": "scatter", "mode": "lines", "x": _numbers(mark.x), "y": _numbers(mark.y), "line": style, **axes}
    return [*([_band(mark, axes)] if mark.half is not None else []), trace | {"name": mark.name}]


def _of_points(mark: Points, axes: dict[str, str]) -> list[dict[str, Any]]:
    symbol = "circle-open" if mark.hollow else "circle"
    trace: dict[str, Any] = {
        "type": "scatter",
        "mode": "markers",
        "x": mark.labels,
        "y": _numbers(mark.y),
        "name": mark.name,
        **axes,
    }
    trace["marker"] = {"color": _color(mark.color), "size": 8, "symbol": symbol}
    if mark.half is not None:
        trace["error_y"] = {"type": "data", "array": _numbers(mark.half), "thickness": 1.5, "width": 4}
    return [trace]


def _of_bars(mark: Bars, axes: dict[str, str]) -> list[dict[str, Any]]:
    color = [_color(c) for c in mark.color] if isinstance(mark.color, list) else _color(mark.color)
    trace: dict[str, Any] = {
        "type": "bar",
        "x": mark.labels,
        "y": _numbers(mark.y),
        "name": mark.name,
        "marker": {"color": color},
    }
    if mark.base is not None:
        trace |= {
            "base": _numbers(mark.base),
            "offset": -0.12 if mark.thin else -0.3,
            "width": 0.24 if mark.thin else 0.6,
        }
        if mark.thin:
            trace["opacity"] = 0.55
    return [trace | axes]


def _of_heat(mark: Heat, axes: dict[str, str]) -> list[dict[str, Any]]:
    scale: dict[str, Any] = (
        {"colorscale": SIGNED, "zmin": -1, "zmax": 1} if mark.signed else {"colorscale": UNSIGNED, "zmin": 0, "zmax": 1}
    )
    text = [[f"{100 * v:.0f} %" if mark.as_percent else f"{v:.2f}" for v in row] for row in mark.z]
    trace: dict[str, Any] = {
        "type": "heatmap",
        "x": mark.columns,
        "y": mark.rows,
        "z": [_numbers(row) for row in mark.z],
        "text": text,
    }
    return [trace | scale | axes | {"texttemplate": "%{text}", "showscale": False, "xgap": 1, "ygap": 1}]


def _traces(mark: Mark, axes: dict[str, str]) -> list[dict[str, Any]]:
    match mark:
        case Line():
            return _of_line(mark, axes)
        case Points():
            return _of_points(mark, axes)
        case Bars():
            return _of_bars(mark, axes)
        case Heat():
            return _of_heat(mark, axes)
    return []


def _rule(mark: Rule, number: str) -> dict[str, Any]:
    line = {"color": _color(mark.color), "width": 1.5, "dash": "dash"}
    return {
        "type": "line",
        "xref": f"x{number} domain",
        "yref": f"y{number}",
        "x0": 0,
        "x1": 1,
        "y0": mark.y,
        "y1": mark.y,
        "line": line,
    }


def _rule_in_legend(mark: Rule, axes: dict[str, str]) -> dict[str, Any]:
    """Lines across have no entry of their own."""
    line = {"color": _color(mark.color), "width": 1.5, "dash": "dash"}
    return {"type": "scatter", "mode": "lines", "x": [None], "y": [None], "name": mark.name, "line": line, **axes}


def _axes_of(panel: Panel, number: str) -> dict[str, Any]:
    y: dict[str, Any] = {"title": {"text": panel.y}, "type": "log"} if panel.log else {"title": {"text": panel.y}}
    if panel.log:
        y["dtick"] = 1
    if panel.span is not None:
        y["range"] = _numbers(panel.span)
    if any(isinstance(mark, Heat) for mark in panel.marks):
        y["autorange"] = "reversed"
    x: dict[str, Any] = {"title": {"text": panel.x}}
    if any(isinstance(mark, Points | Bars | Heat) for mark in panel.marks):
        x["type"] = "category"
    return {f"xaxis{number}": x, f"yaxis{number}": y}


def _of_figure(figure: Figure) -> dict[str, Any]:
    data, shapes = [], []
    layout: dict[str, Any] = {}
    named: set[str] = set()
    for i, panel in enumerate(figure.panels):
        number = "" if i == 0 else str(i + 1)
        axes = {"xaxis": f"x{number}", "yaxis": f"y{number}"}
        layout |= _axes_of(panel, number)
        for mark in panel.marks:
            traces = [_rule_in_legend(mark, axes)] if isinstance(mark, Rule) else _traces(mark, axes)
            if isinstance(mark, Rule):
                shapes.append(_rule(mark, number))
            for trace in traces:
                name = trace.get("name", "")
                trace |= {"legendgroup": name, "showlegend": bool(name) and name not in named}
                named |= {name}
                data.append(trace)
    layout["shapes"] = shapes
    layout["showlegend"] = len(named - {""}) > 1
    layout["barmode"] = "overlay" if any(_has_base(panel) for panel in figure.panels) else "group"
    titles = [panel.title for panel in figure.panels]
    return {
        "data": data,
        "layout": layout,
        "grid": {"titles": titles, "columns": figure.columns, "height": figure.height},
    }


def _has_base(panel: Panel) -> bool:
    return any(isinstance(mark, Bars) and mark.base is not None for mark in panel.marks)


def _xyz(points: Array) -> dict[str, Any]:
    return {axis: _numbers(points[:, i]) for i, axis in enumerate("xyz")}


def _of_space(mark: Path3 | Mesh3 | Dots3) -> dict[str, Any]:
    match mark:
        case Path3():
            line = {"color": _color(mark.color), "width": mark.width}
            return {
                "type": "scatter3d",
                "mode": "lines",
                **_xyz(mark.points),
                "line": line,
                "name": mark.name,
                "showlegend": bool(mark.name) and mark.in_legend,
            }
        case Mesh3():
            i, j, k = (mark.triangles[:, n].tolist() for n in range(3))
            looks = {
                "color": _color(mark.color),
                "opacity": mark.opacity,
                "showlegend": bool(mark.name) and mark.in_legend,
            }
            return {"type": "mesh3d", **_xyz(mark.points), "i": i, "j": j, "k": k, "name": mark.name, **looks}
    marker = {"color": _color(mark.color), "size": mark.size}
    dots = {"type": "scatter3d", "mode": "markers+text", **_xyz(mark.points), "text": mark.labels, "marker": marker}
    return dots | {"name": mark.name, "showlegend": mark.in_legend, "textfont": {"size": 11, "color": "@ink"}}


def _aspect(view: View) -> dict[str, float]:
    """Proportions of a view's box: true to scale, and of a size at which the camera sees it whole."""
    mean = float(np.prod(view.size)) ** (1.0 / 3.0)
    return {axis: IN_SIGHT * edge / mean for axis, edge in zip("xyz", view.size, strict=True)}


def _button(view: View, shown: list[bool]) -> dict[str, Any]:
    layout: dict[str, Any] = {f"scene.{axis}axis.range": [view.low[i], view.high[i]] for i, axis in enumerate("xyz")}
    layout |= {"scene.aspectmode": "manual", "scene.aspectratio": _aspect(view)}
    return {"label": view.name, "method": "update", "args": [{"visible": shown}, layout]}


def _of_scene(scene: Scene) -> dict[str, Any]:
    first = scene.views[0]
    axes = {
        f"{axis}axis": {"range": [first.low[i], first.high[i]], "title": {"text": f"{axis}, m"}}
        for i, axis in enumerate("xyz")
    }
    buttons = [_button(view, [view.shows(mark) for mark in scene.marks]) for view in scene.views]
    eye = {"eye": {"x": 0.95, "y": -1.1, "z": 0.45}, "center": {"x": 0, "y": 0, "z": -0.08}}
    return {
        "data": [_of_space(mark) | {"visible": first.shows(mark)} for mark in scene.marks],
        "layout": {
            "scene": {**axes, "aspectmode": "manual", "aspectratio": _aspect(first), "camera": eye},
            "updatemenus": [MENU | {"buttons": buttons}],
            "showlegend": True,
        },
        "grid": None,
    }


def document(drawing: Drawing) -> dict[str, Any]:
    """The arguments that page.js hands to plotly.js."""
    return _of_figure(drawing) if isinstance(drawing, Figure) else _of_scene(drawing)
