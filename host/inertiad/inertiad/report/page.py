# SPDX-License-Identifier: Apache-2.0
"""One self-contained HTML page: text, tables, drawings, plotly.js."""

import base64
import json
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files

from inertiad.report import interactive, printed
from inertiad.report.figure import DARK, LIGHT, Drawing, Scene, Table
from inertiad.report.verdict import Verdict


@dataclass(frozen=True)
class Tile:
    """A number to see first."""

    name: str
    value: str
    unit: str
    sigma: str


@dataclass(frozen=True)
class Fold:
    """A table behind a click."""

    title: str
    table: Table


Block = Drawing | Table | Fold | str
"""a string is a paragraph"""


@dataclass(frozen=True)
class Section:
    key: str
    title: str
    blocks: list[Block] = field(default_factory=list)


@dataclass(frozen=True)
class Page:
    title: str
    subtitle: str
    verdict: Verdict
    tiles: list[Tile]
    sections: list[Section]


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in table.head) if any(table.head) else ""
    rows = []
    for number, row in enumerate(table.rows):
        first = "".join(f'<th scope="row">{escape(cell)}</th>' for cell in row[:1])
        cells = first + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        kind = "alert" if number in table.alert else "faint" if number in table.faint else "plain"
        rows.append(f'<tr class="{kind}">{cells}</tr>')
    columns = "numbers" if table.numbers else "words"
    foot = f'<p class="foot">{escape(table.foot)}</p>' if table.foot else ""
    thead = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f'<div class="wide"><table class="{columns}">{thead}<tbody>{"".join(rows)}</tbody></table></div>{foot}'


def _drawing(drawing: Drawing, is_titled: bool) -> str:
    still = ""
    if isinstance(drawing, Scene):  # for browsers without WebGL, and for paper
        data = base64.b64encode(printed.png(drawing)).decode()
        still = f'<img class="still" alt="{escape(drawing.title)}" src="data:image/png;base64,{data}">'
    kind = "scene" if isinstance(drawing, Scene) else "flat"
    title = f"<h3>{escape(drawing.title)}</h3>" if is_titled else ""
    return (
        f'<figure id="figure-{drawing.key}">{title}'
        f'<div class="drawing {kind}" data-key="{drawing.key}"></div>{still}'
        f'<figcaption>{escape(drawing.caption)} <button class="csv" data-key="{drawing.key}">CSV</button></figcaption>'
        "</figure>"
    )


def _block(block: Block, section: str) -> str:
    """section: its title, which a drawing need not repeat."""
    match block:
        case str():
            return f"<p>{escape(block)}</p>"
        case Table():
            return _table(block)
        case Fold():
            return f"<details><summary>{escape(block.title)}</summary>{_table(block.table)}</details>"
    return _drawing(block, block.title != section)


def _section(section: Section) -> str:
    blocks = "".join(_block(block, section.title) for block in section.blocks)
    title = f"<summary><h2>{escape(section.title)}</h2></summary>"
    return f'<section id="{section.key}"><details class="part" open>{title}{blocks}</details></section>'


def _verdict(verdict: Verdict) -> str:
    rows = []
    for finding in verdict.findings:
        action = f'<p class="action">{escape(finding.do)}</p>' if finding.do else ""
        rows.append(
            f'<li class="{finding.severity}"><b class="badge">{finding.severity}</b>'
            f"<div><p>{escape(finding.says)}</p>{action}</div></li>"
        )
    return (
        f'<section id="verdict" class="{verdict.severity}"><h2>{escape(verdict.headline)}</h2>'
        f"<ul>{''.join(rows)}</ul></section>"
    )


def _tile(tile: Tile) -> str:
    value = f"<b>{escape(tile.value)} <small>{escape(tile.unit)}</small></b>"
    return f'<div class="tile"><span>{escape(tile.name)}</span>{value}<span>{escape(tile.sigma)}</span></div>'


def _script_json(data: object) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("</", "<\\/")


def drawings_of(page: Page) -> list[Drawing]:
    """All drawings of a page, in order."""
    return [block for section in page.sections for block in section.blocks if not isinstance(block, str | Table | Fold)]


def render(page: Page) -> str:
    """The page's HTML."""
    from plotly.offline import get_plotlyjs

    here = files("inertiad.report")
    drawings = {drawing.key: interactive.document(drawing) for drawing in drawings_of(page)}
    links = "".join(f'<a href="#{s.key}">{escape(s.title)}</a>' for s in page.sections)
    sections = "".join(map(_section, page.sections))
    tiles = f'<div class="tiles">{"".join(map(_tile, page.tiles))}</div>' if page.tiles else ""
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<link rel="icon" href="data:,">
<title>{escape(page.title)}</title>
<style>{(here / "page.css").read_text(encoding="utf-8")}</style></head>
<body><header id="top"><h1>{escape(page.title)}</h1><p>{escape(page.subtitle)}</p></header>
<nav><a href="#verdict">Verdict</a>{links}</nav>
<noscript><p class="noscript">Figures are drawn by JavaScript, which is off here. As pictures:
inertiactl report RUN --figures FOLDER</p></noscript>
<main>{_verdict(page.verdict)}{tiles}{sections}</main>
<a class="back" href="#top" aria-label="back to top">↑ top</a>
<script id="palettes" type="application/json">{_script_json({"light": LIGHT, "dark": DARK})}</script>
<script id="drawings" type="application/json">{_script_json(drawings)}</script>
<script>{get_plotlyjs()}</script>
<script>{(here / "page.js").read_text(encoding="utf-8")}</script>
</body></html>
"""
