# SPDX-License-Identifier: Apache-2.0
"""Layouts for viewers of an exported MCAP file: Foxglove and Lichtblick (JSON), PlotJuggler (XML)."""

import json
from typing import Any, Final
from xml.etree import ElementTree

from inertiad.exchange.dataset import INERTIA, Dataset
from inertiad.exchange.foxglove import TOPICS, WORLD

COLORS: Final = ("#3b82c4", "#e08214", "#2a9d64", "#c6509b", "#8a6fd1", "#a6761d", "#17a2b8", "#d1495b")
GROUPS: Final = (
    ("mass, kg", "estimate", ("mass",)),
    ("CoG, m", "estimate", tuple(f"cog_{a}" for a in "xyz")),
    ("inertia about the CoG, kg m2", "estimate", tuple(f"inertia_cog_{e}" for e in INERTIA)),
    ("specific force, m/s2", "signals", tuple(f"acc_{a}" for a in "xyz")),
    ("angular rate, rad/s", "signals", tuple(f"gyro_{a}" for a in "xyz")),
)


def _plots(data: Dataset) -> list[tuple[str, str, tuple[str, ...]]]:
    """Title, table and columns of each plot, of what the run has."""
    signals = data.tables.get("signals")
    forces = tuple(name for name in signals.columns if name.startswith("f_")) if signals is not None else ()
    found = [("tensions, N", "signals", forces), *GROUPS]
    return [
        (title, table, columns)
        for title, table, columns in found
        if columns and table in data.tables and all(name in data.tables[table].columns for name in columns)
    ]


def _stacked(panels: list[str]) -> Any:
    """Panels one below the other, of equal height."""
    if len(panels) == 1:
        return panels[0]
    share = 100.0 / len(panels)
    return {"first": panels[0], "second": _stacked(panels[1:]), "direction": "column", "splitPercentage": share}


def foxglove(data: Dataset, has_scene: bool) -> str:
    """Layout of Foxglove and Lichtblick: the robot at the left, plots at the right, events below."""
    panels: dict[str, Any] = {}
    for k, (title, table, columns) in enumerate(_plots(data)):
        paths = [
            {"value": f"/{table}.{name}", "label": name, "enabled": True, "timestampMethod": "receiveTime"}
            for name in columns
        ]
        panels[f"Plot!{k}"] = {"title": title, "paths": paths, "showLegend": True, "isSynced": True}
    plots = list(panels)
    panels["RawMessages!events"] = {"topicPath": "/events"}
    right = _stacked([*plots, "RawMessages!events"])
    layout = right
    if has_scene:
        grid = {"layerId": "foxglove.Grid", "instanceId": "grid", "visible": True, "frameId": WORLD, "size": 20}
        panels["3D!robot"] = {
            "followMode": "follow-none",
            "followTf": WORLD,
            "cameraState": {"distance": 25, "phi": 65, "thetaOffset": 45, "perspective": True, "fovy": 45},
            "topics": {topic: {"visible": topic != "/platform/pose"} for topic in TOPICS},
            "layers": {"grid": grid},
        }
        layout = {"first": "3D!robot", "second": right, "direction": "row", "splitPercentage": 55}
    document = {"configById": panels, "globalVariables": {}, "userNodes": {}, "layout": layout}
    return json.dumps(document | {"playbackConfig": {"speed": 1}}, indent=1)


def plotjuggler(data: Dataset) -> str:
    """Layout of PlotJuggler: a tab per table, a plot per group of columns."""
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    plots = _plots(data)
    for tab in dict.fromkeys(table for _, table, _ in plots):
        mine = [(title, columns) for title, table, columns in plots if table == tab]
        container = ElementTree.SubElement(
            ElementTree.SubElement(window, "Tab", containers="1", tab_name=tab), "Container"
        )
        sizes = ";".join([f"{1.0 / len(mine):.4f}"] * len(mine))
        splitter = ElementTree.SubElement(container, "DockSplitter", orientation="-", sizes=sizes, count=str(len(mine)))
        for title, columns in mine:
            area = ElementTree.SubElement(splitter, "DockArea", name=title)
            plot = ElementTree.SubElement(
                area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false"
            )
            for k, name in enumerate(columns):
                ElementTree.SubElement(plot, "curve", name=f"/{tab}/{name}", color=COLORS[k % len(COLORS)])
    ElementTree.SubElement(window, "currentTabIndex", index="0")
    ElementTree.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
