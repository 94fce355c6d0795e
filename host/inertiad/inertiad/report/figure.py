# SPDX-License-Identifier: Apache-2.0
"""Figures as data, for two renderers: interactive.py for the page, printed.py for PNG and PDF.

A figure is a grid of panels, a panel a list of marks. Colours are roles, so that both renderers and both themes agree.
"""

import itertools
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from inertiad.base.table import Array

Where = Literal["near", "far", "both"]
"""the views that show a mark: the platform, the whole robot"""
Role = Literal["estimate", "truth", "nominal", "good", "care", "bad", "muted", "ink"]
Color = Role | int
"""a role, or the number of a series"""

LIGHT: Final[dict[str, str]] = {
    "estimate": "#1f5fa8",
    "truth": "#c2410c",
    "nominal": "#6b7280",
    "good": "#15803d",
    "care": "#b45309",
    "bad": "#c01c28",
    "muted": "#9aa3af",
    "ink": "#1f2937",
}
DARK: Final[dict[str, str]] = {
    "estimate": "#6cb0ff",
    "truth": "#ff9a5c",
    "nominal": "#a3acba",
    "good": "#4ade80",
    "care": "#fbbf24",
    "bad": "#ff6b6b",
    "muted": "#6b7684",
    "ink": "#e5e7eb",
}
SERIES: Final = (
    *("#3b82c4", "#e08214", "#2a9d64", "#c6509b", "#8a6fd1", "#a6761d", "#17a2b8", "#d1495b"),
    *("#6a994e", "#7b8794", "#b5838d", "#4d908e", "#f3a712", "#577590", "#9c6644", "#5e60ce"),
)
"""of the cables and of anything else counted; distinct on light and dark ground"""
POINTS_MAX: Final = 1200
"""of a line: what a screen shows"""


@dataclass(frozen=True)
class Line:
    """y over x, with a band of +- half."""

    x: Array
    y: Array
    name: str
    color: Color = "estimate"
    width: float = 1.5
    dashed: bool = False
    half: Array | None = None


@dataclass(frozen=True)
class Points:
    """Values over labels, with error bars of +- half."""

    labels: list[str]
    y: list[float]
    name: str
    color: Color = "estimate"
    half: list[float] | None = None
    hollow: bool = False


@dataclass(frozen=True)
class Bars:
    """Upright bars over labels, from base."""

    labels: list[str]
    y: list[float]
    name: str
    color: Color | list[Color] = "estimate"
    base: list[float] | None = None
    thin: bool = False


@dataclass(frozen=True)
class Rule:
    """A line across at a height."""

    y: float
    name: str
    color: Color = "muted"


@dataclass(frozen=True)
class Heat:
    """Numbers -1 .. 1, or 0 .. 1, in cells."""

    rows: list[str]
    columns: list[str]
    z: Array
    """[rows, columns]"""
    signed: bool
    as_percent: bool = False


Mark = Line | Points | Bars | Rule | Heat


@dataclass(frozen=True)
class Panel:
    marks: list[Mark]
    title: str = ""
    x: str = ""
    y: str = ""
    log: bool = False
    span: tuple[float, float] | None = None
    """of y; None: what the marks need"""


@dataclass(frozen=True)
class Figure:
    key: str
    """file name, and anchor on the page"""
    title: str
    caption: str
    panels: list[Panel]
    columns: int = 1
    """at most, where there is room"""
    height: int = 260
    """px of a panel"""


@dataclass(frozen=True)
class Path3:
    """A line in space; several pieces where a row is NaN."""

    points: Array
    """m [N, 3]"""
    name: str
    color: Color
    width: float = 3.0
    where: Where = "both"
    in_legend: bool = True


@dataclass(frozen=True)
class Mesh3:
    """A closed surface."""

    points: Array
    """m [N, 3]"""
    triangles: Array
    """[K, 3] indices"""
    name: str
    color: Color
    opacity: float
    where: Where = "both"
    in_legend: bool = True


@dataclass(frozen=True)
class Dots3:
    points: Array
    labels: list[str]
    name: str
    color: Color
    size: float = 4.0
    where: Where = "both"
    in_legend: bool = True


@dataclass(frozen=True)
class View:
    """What of a scene is looked at: a box, m."""

    name: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    is_far: bool = False

    def shows(self, mark: "Path3 | Mesh3 | Dots3") -> bool:
        """True if the mark belongs to this view."""
        return mark.where == "both" or (mark.where == "far") == self.is_far

    @property
    def size(self) -> tuple[float, float, float]:
        """Edges of the box, m: a picture with these proportions is true to scale."""
        x, y, z = (b - a for a, b in zip(self.low, self.high, strict=True))
        return x, y, z


@dataclass(frozen=True)
class Scene:
    key: str
    title: str
    caption: str
    marks: list[Path3 | Mesh3 | Dots3]
    views: list[View]
    """the first is shown first"""


Drawing = Figure | Scene


def thinned(x: Array, y: Array, n: int = POINTS_MAX) -> tuple[Array, Array]:
    """At most about n points that still show every peak: least and greatest of each piece."""
    if len(x) <= n:
        return x, y
    edges = np.linspace(0, len(x), n // 2 + 1).astype(int)
    keep = {0, len(x) - 1}
    for first, last in itertools.pairwise(edges):
        keep |= {first + int(np.argmin(y[first:last])), first + int(np.argmax(y[first:last]))}
    at = np.array(sorted(keep))
    return x[at], y[at]


def line(x: Array, y: Array, name: str, color: Color = "estimate", **options: object) -> Line:
    """A Line of no more points than can be seen."""
    return Line(*thinned(np.asarray(x), np.asarray(y)), name, color, **options)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Table:
    """Rows of text for the page."""

    head: list[str]
    rows: list[list[str]]
    numbers: bool = True
    """all columns but the first are aligned to the right"""
    foot: str = ""
    faint: list[int] = field(default_factory=list)
    """rows that say nothing"""
    alert: list[int] = field(default_factory=list)
    """rows to look at"""
