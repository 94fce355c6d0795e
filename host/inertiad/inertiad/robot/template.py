# SPDX-License-Identifier: Apache-2.0
"""A commented robot.toml to start from, with signals bound to a DBC as far as its names tell."""

import math
import os
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from inertiad.base import quantity
from inertiad.base.recognition import recognise
from inertiad.base.text_files import toml_value
from inertiad.robot import dbc, reference

ANCHOR_RADIUS, ANCHOR_HEIGHT = 2.5, 3.0
"""m: of the anchors that a new file holds until they are replaced"""
ANCHORS_APART = 0.1
"""rad: half the angle between the two anchors of a corner"""
NARROW = 0.4
"""share of its width to which the platform of few cables is narrowed along y, so that their lines do not all meet"""
ATTACHMENT_RADIUS, ATTACHMENT_HEIGHT = 0.35, 0.15
WIDTH = 110


@dataclass(frozen=True)
class Start:
    """What is known of the robot."""

    name: str
    n_cables: int
    imu_rate: float | None = None
    """Hz"""
    dbc: list[str] = field(default_factory=list)
    """files of the one bus, relative to the new robot.toml"""
    signals: dict[str, Any] = field(default_factory=dict)
    """as in [signals]"""
    choices: dict[str, list[str]] = field(default_factory=dict)
    """other signals of the DBC that might be the quantity"""
    missing: tuple[str, ...] = ()
    """quantities the robot needs and the DBC does not show"""

    @property
    def attitude(self) -> str:
        return "rpy" if "roll" in self.signals else "quaternion"


def example_geometry(n: int) -> list[tuple[list[float], list[float]]]:
    """Anchor and attachment of each of n cables, m: six or more in pairs from corners to both neighbouring vertices
    of the platform, an odd one down the middle; with fewer one beside the other."""
    if n < 6:
        radial = [_example_cable(2.0 * math.pi * (i + 0.5) / n, 0.0, ATTACHMENT_HEIGHT) for i in range(n)]
        return [(anchor, [x, round(NARROW * y, 3) + 0.0, z]) for anchor, (x, y, z) in radial]
    corners = n // 2
    found = []
    for i in range(2 * corners):
        side = (-1.0) ** i
        at = 2.0 * math.pi * (i // 2 + 0.5) / corners + side * ANCHORS_APART
        found.append(_example_cable(at, side * (math.pi / corners - ANCHORS_APART), side * ATTACHMENT_HEIGHT))
    return found if n % 2 == 0 else [*found, ([0.0, 0.0, ANCHOR_HEIGHT], [0.0, 0.0, ATTACHMENT_HEIGHT])]


def _example_cable(angle: float, turn: float, height: float) -> tuple[list[float], list[float]]:
    """From an anchor at an angle to an attachment turned on by more, rad, at a height, m."""
    anchor = [ANCHOR_RADIUS * math.cos(angle), ANCHOR_RADIUS * math.sin(angle), ANCHOR_HEIGHT]
    attachment = [ATTACHMENT_RADIUS * math.cos(angle + turn), ATTACHMENT_RADIUS * math.sin(angle + turn), height]
    return [round(v, 3) + 0.0 for v in anchor], [round(v, 3) + 0.0 for v in attachment]


def start_from_dbc(name: str, paths: list[Path], n_cables: int | None, imu_rate: float | None, folder: Path) -> Start:
    """Propose [signals] of a robot.toml in a folder from the names and units of the signals of DBC files.

    InputError: one is no usable DBC.
    """
    candidates: dict[str, list[tuple[str, str]]] = {}
    inside: dict[str, dict[str, str]] = {}
    for message, _ in dbc.load(paths).messages:
        for signal in message.signals:
            place = f"{message.name}.{signal.name}"
            found = recognise(signal.name, signal.unit or "") or recognise(place, signal.unit or "")
            if found in ("t", "counter"):
                inside.setdefault(message.name, {}).setdefault(found, place)
            elif found is not None:
                candidates.setdefault(found, []).append((message.name, place))
    numbers = [int(q[2:]) for q in candidates if q.startswith("f_")]
    n = n_cables or max(numbers, default=8)
    chosen = {q: found[0] for q, found in candidates.items() if not q.startswith("f_") or int(q[2:]) <= n}
    attitude = quantity.QUATERNION if quantity.QUATERNION[0] in chosen else quantity.RPY
    other = quantity.RPY if attitude == quantity.QUATERNION else quantity.QUATERNION
    chosen = {q: place for q, place in chosen.items() if q not in other}
    needed = (*quantity.ACC, *quantity.GYRO, *attitude, *quantity.forces(n))
    signals: dict[str, Any] = {q: chosen[q][1] for q in (*needed, *quantity.POSITION) if q in chosen}
    signals |= _counters({q: message for q, (message, _) in chosen.items()}, inside)
    choices = {
        q: [place for _, place in found[1:]] for q, found in candidates.items() if q in chosen and len(found) > 1
    }
    missing = tuple(q for q in needed if q not in chosen)
    files = [os.path.relpath(path, folder) for path in paths]
    return Start(name, n, imu_rate, files, signals, choices, missing)


def _counters(message_of: dict[str, str], inside: dict[str, dict[str, str]]) -> dict[str, Any]:
    """Counter and time of each sensor, from the messages that carry its quantities."""
    found: dict[str, Any] = {}
    for sensor, end in (("imu", "acc_x"), ("force", "f_1"), ("pos", "pos_x")):
        messages = dict.fromkeys(m for q, m in message_of.items() if quantity.sensor(q) == sensor)
        counters = [inside[m]["counter"] for m in messages if "counter" in inside.get(m, {})]
        if counters and len(counters) == len(messages):
            found[f"{sensor}_counter"] = counters[0] if len(counters) == 1 else counters
        first = message_of.get(end, "")
        if "t" in inside.get(first, {}):
            found[f"{sensor}_time"] = inside[first]["t"]
    return found


# ---- text ------------------------------------------------------------------------------------------------------------


def _comment(text: str) -> Iterator[str]:
    yield from textwrap.wrap(text, WIDTH, initial_indent="# ", subsequent_indent="# ")


def _keys(table: dict[str, Any], tables: dict[str, Any], values: dict[str, Any], is_active: bool) -> Iterator[str]:
    """Every key of a table below its meaning; commented out where it keeps its default."""
    for name, key in table["properties"].items():
        yield from _comment(f"{reference.meaning(key)} ({reference.allowed(key, tables)})")
        if name in values:
            yield f"{'' if is_active else '# '}{name} = {toml_value(values[name])}"
        else:
            yield f"# {name} = {toml_value(key['default']) if 'default' in key else '...'}"


def _section(title: str, tables: dict[str, Any], name: str, values: dict[str, Any]) -> Iterator[str]:
    yield ""
    table = tables[name]
    yield from _comment(" ".join(table["description"].split()))
    yield f"{'' if values else '# '}[{title}]"
    yield from _keys(table, tables, values, bool(values))


def _cables(n: int, tables: dict[str, Any]) -> Iterator[str]:
    keys = tables["Cable"]["properties"]
    yield ""
    yield from _comment(
        "The cables, in the order of their force sensors f_1, f_2, ... REPLACE these example places by your robot's."
    )
    for name in ("anchor", "attachment"):
        yield from _comment(f"{name}: {reference.meaning(keys[name])} ({reference.allowed(keys[name], tables)})")
    for anchor, attachment in example_geometry(n):
        yield from ("[[cable]]", f"anchor = {toml_value(anchor)}", f"attachment = {toml_value(attachment)}")


def _signals(start: Start) -> Iterator[str]:
    if not start.dbc:
        yield from _comment(
            "[[bus]] and [signals] name the DBC files and bind quantities to their signals. Without them the CAN "
            "layout of `inertiactl encode` and `inertiactl simulate` holds. `inertiactl init --dbc FILE` proposes them."
        )
        return
    yield from (
        "[[bus]]",
        f"dbc = {toml_value(start.dbc if len(start.dbc) > 1 else start.dbc[0])}",
        "# bitrate = 1000000.0",
        "",
    )
    yield from _comment('QUANTITY = "MESSAGE.signal", proposed from the DBC\'s names and units: check each.')
    yield "[signals]"
    for name, value in start.signals.items():
        others = f"  # or {', '.join(start.choices[name])}" if name in start.choices else ""
        yield f"{name} = {toml_value(value)}{others}"
    for name in start.missing:
        yield f'# {name} = "MESSAGE.signal"  # not found in the DBC'


def text(start: Start) -> str:
    """Text of a robot.toml. It compiles unless start.missing names quantities."""
    tables = reference.schema()["$defs"]
    imu = {} if start.imu_rate is None else {"rate": start.imu_rate}
    attitude = {"source": start.attitude} if start.attitude == "rpy" else {}
    lines = [
        *_comment("Robot description of inertiad. SI units; W: world frame, z up; P: platform frame; I: IMU frame."),
        *_comment("Keys behind # have the default shown. All keys: inertiactl help robot.toml"),
        *_comment(
            "Editors with a TOML language server complete and check it after `inertiactl schema -o robot.schema.json` "
            'and the line "#:schema ./robot.schema.json" on top.'
        ),
        "",
        f"name = {toml_value(start.name)}",
        *_section("cables", tables, "Cables", {"tension_min": 0.0}),
        *_cables(start.n_cables, tables),
        *_section("imu", tables, "Imu", {"position": [0.0, 0.0, 0.0]} | imu),
        *_section("tracker", tables, "Tracker", {"target": [0.0, 0.0, 0.0]}),
        *_section("nominal", tables, "Nominal", {}),
        "",
        *_signals(start),
        *_section("attitude", tables, "Attitude", attitude),
    ]
    return "\n".join(lines) + "\n"
