# SPDX-License-Identifier: Apache-2.0
"""Drawings for paper: PNG and PDF by matplotlib, on white."""

import io
import itertools
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.figure import Figure as Canvas

from inertiad.report.figure import (
    LIGHT,
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
)

PX_PER_INCH: Final = 100.0
WIDTH: Final = 11.0
"""inches"""
STYLE: Final[Any] = {
    "font.size": 8.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e5e7eb",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "pdf.fonttype": 42,
}


def _color(color: Color) -> str:
    return SERIES[color % len(SERIES)] if isinstance(color, int) else LIGHT[color]


def _colors(bars: Bars) -> Any:
    return [_color(c) for c in bars.color] if isinstance(bars.color, list) else _color(bars.color)


def _bars(axes: Any, bars: Bars, panel: Panel) -> None:
    beside = [mark for mark in panel.marks if isinstance(mark, Bars) and mark.base is None]
    if bars.base is None and len(beside) > 1:
        width = 0.8 / len(beside)
        x = np.arange(len(bars.labels)) + (beside.index(bars) - 0.5 * (len(beside) - 1)) * width
        axes.bar(x, bars.y, width, color=_colors(bars), label=bars.name)
        axes.set_xticks(range(len(bars.labels)), bars.labels)
    else:
        width, alpha = (0.24, 0.55) if bars.thin else (0.6, 1.0)
        axes.bar(bars.labels, bars.y, width, bottom=bars.base, color=_colors(bars), label=bars.name, alpha=alpha)


def _heat(axes: Any, mark: Heat) -> None:
    axes.imshow(mark.z, cmap="RdBu_r" if mark.signed else "Blues", vmin=-1 if mark.signed else 0, vmax=1, aspect="auto")
    axes.set_xticks(range(len(mark.columns)), mark.columns)
    axes.set_yticks(range(len(mark.rows)), mark.rows)
    axes.grid(False)
    for (i, j), value in np.ndenumerate(mark.z):
        text = f"{100 * value:.0f} %" if mark.as_percent else f"{value:.2f}"
        axes.text(j, i, text, ha="center", va="center", color="white" if abs(value) > 0.6 else "black")


def _mark(axes: Any, mark: Mark, panel: Panel) -> None:
    match mark:
        case Line():
            style = "--" if mark.dashed else "-"
            axes.plot(mark.x, mark.y, style, color=_color(mark.color), lw=0.7 * mark.width, label=mark.name)
            if mark.half is not None:
                low, high = mark.y - mark.half, mark.y + mark.half
                axes.fill_between(mark.x, low, high, color=_color(mark.color), alpha=0.2, lw=0)
        case Points():
            fill = {"markerfacecolor": "none"} if mark.hollow else {}
            axes.errorbar(
                mark.labels,
                mark.y,
                mark.half,
                fmt="o",
                ms=4,
                capsize=2,
                color=_color(mark.color),
                label=mark.name,
                **fill,
            )
        case Bars():
            _bars(axes, mark, panel)
        case Rule():
            axes.axhline(mark.y, ls="--", lw=1.0, color=_color(mark.color), label=mark.name)
        case Heat():
            _heat(axes, mark)


def _panel(axes: Any, panel: Panel) -> None:
    for mark in panel.marks:
        _mark(axes, mark, panel)
    axes.set_title(panel.title, loc="left", fontsize=9)
    axes.set_xlabel(panel.x)
    axes.set_ylabel(panel.y)
    if panel.log:
        axes.set_yscale("log")
    if panel.span is not None:
        axes.set_ylim(*panel.span)
    labels = [tick.get_text() for tick in axes.get_xticklabels()]
    if sum(map(len, labels)) > 60 or any(len(t) > 9 for t in labels):
        axes.tick_params(axis="x", rotation=60)


def _legend(canvas: Any, axes: list[Any]) -> None:
    named: dict[str, Any] = {}
    for each in axes:
        for handle, label in zip(*each.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    if len(named) > 1:
        canvas.legend(
            list(named.values()), list(named), loc="outside lower center", ncols=min(len(named), 8), frameon=False
        )


def _of_figure(figure: Figure) -> Canvas:
    columns = min(figure.columns, len(figure.panels))
    rows = -(-len(figure.panels) // columns)
    canvas = Canvas(figsize=(WIDTH, rows * figure.height / PX_PER_INCH + 0.9), layout="constrained")
    grid = np.atleast_1d(canvas.subplots(rows, columns, squeeze=False)).ravel().tolist()
    for axes, panel in zip(grid, figure.panels, strict=False):
        _panel(axes, panel)
    for axes in grid[len(figure.panels) :]:
        axes.set_axis_off()
    _legend(canvas, grid)
    canvas.suptitle(figure.title, x=0.01, ha="left", fontsize=11)
    return canvas


def _of_scene(scene: Scene) -> Canvas:
    canvas = Canvas(figsize=(WIDTH, 0.5 * WIDTH), layout="constrained")
    for number, view in enumerate(scene.views[:2]):
        axes = canvas.add_subplot(1, min(len(scene.views), 2), number + 1, projection="3d")
        low, high = np.array(view.low), np.array(view.high)
        for mark in scene.marks:
            if view.shows(mark):
                _space(axes, mark, low, high)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), title=view.name)
        axes.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
        axes.set_box_aspect(view.size)
        axes.view_init(elev=18, azim=-50)
    canvas.suptitle(scene.title, x=0.01, ha="left", fontsize=11)
    return canvas


def _space(axes: Any, mark: Path3 | Mesh3 | Dots3, low: Any, high: Any) -> None:
    match mark:
        case Path3():
            x, y, z = _clipped(mark.points, low, high).T
            axes.plot(x, y, z, color=_color(mark.color), lw=0.4 * mark.width)
        case Mesh3():
            x, y, z = mark.points.T
            axes.plot_trisurf(x, y, z, triangles=mark.triangles, color=_color(mark.color), alpha=mark.opacity, lw=0)
        case Dots3():
            inside = ((mark.points >= low) & (mark.points <= high)).all(axis=1)
            x, y, z = mark.points[inside].T
            axes.scatter(x, y, z, color=_color(mark.color), s=2.0 * mark.size, depthshade=False)
            for place, label, is_shown in zip(mark.points, mark.labels, inside, strict=True):
                if is_shown:
                    axes.text(*place, f" {label}", fontsize=7)


def _clipped(points: Any, low: Any, high: Any) -> Any:
    """The line with what lies outside of the box left out: axes in space do not do that."""
    steps = np.linspace(0.0, 1.0, max(2, 400 // len(points)), endpoint=False)[:, None]
    pieces = [a + steps * (b - a) for a, b in itertools.pairwise(points)]
    fine = np.concatenate([*pieces, points[-1:]])
    outside = ((fine < low) | (fine > high)).any(axis=1)
    return np.where(outside[:, None], np.nan, fine)


def draw(drawing: Drawing) -> Canvas:
    """On a canvas of its own."""
    with matplotlib.rc_context(STYLE):
        return _of_figure(drawing) if isinstance(drawing, Figure) else _of_scene(drawing)


def png(drawing: Drawing, dpi: int = 110) -> bytes:
    """The drawing as a PNG file's bytes."""
    buffer = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        draw(drawing).savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def write_all(drawings: list[Drawing], folder: Path) -> None:
    """Every drawing, into a folder that is made where it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for drawing in drawings:
        write(drawing, folder)


def write(drawing: Drawing, folder: Path) -> None:
    """KEY.png and KEY.pdf."""
    canvas = draw(drawing)
    with matplotlib.rc_context(STYLE):
        canvas.savefig(folder / f"{drawing.key}.png", dpi=160)
        canvas.savefig(folder / f"{drawing.key}.pdf")
