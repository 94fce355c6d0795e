# SPDX-License-Identifier: Apache-2.0
"""Text exports of motion capture systems as channels: Motive (OptiTrack), Vicon Nexus and Tracker, Qualisys QTM.

A rigid body or marker NAME gives NAME.position.x y z, and a body NAME.rotation.x y z (w). A frame in which it was not
seen is no sample: blank cells in Motive and Vicon, zeros in Qualisys. Vicon numbers its frames: time 0 is frame 1.

Layouts, as far as the makers' manuals give them: OptiTrack, "Data Export: CSV"; Vicon Nexus User Guide, "ASCII files";
Qualisys Track Manager, "TSV export". No export of a real system was at hand.
"""

import codecs
import csv
import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from inertiad.base import units
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.exchange import foreign_csv
from inertiad.exchange.foreign_csv import Channel

HEAD_BYTES: Final = 4096
"""a file's first line ends within these"""
VICON_SECTIONS: Final = ("Trajectories", "Objects", "Segments", "Markers", "Model Outputs", "Devices", "Joints")
VICON_READ: Final = ("Trajectories", "Objects", "Segments", "Markers")
"""sections that hold positions, one row a frame"""
LENGTH_UNITS: Final = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}
QTM_BODY: Final = ("position.x", "position.y", "position.z", "rotation.roll", "rotation.pitch", "rotation.yaw")
QTM_BODY_WIDTH: Final = 16
"""columns of a 6D body: position, angles, residual, nine entries of the rotation matrix"""
Row = list[str]


def kind(path: Path) -> str | None:
    """The system that a text file is from, by its first line: "Motive", "Vicon", "Qualisys"; None: none of them.

    InputError: the file cannot be read.
    """
    if path.is_dir() or path.suffix.lower() not in (".csv", ".tsv", ".txt"):
        return None
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    is_wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    first = head.decode("utf-16" if is_wide else "utf-8-sig", "replace").lstrip().splitlines()[:1]
    line = first[0].strip() if first else ""
    if line.startswith("Format Version"):
        return "Motive"
    if line.startswith("NO_OF_FRAMES"):
        return "Qualisys"
    return "Vicon" if line.strip(',;"\t ') in VICON_SECTIONS else None


def read(path: Path) -> list[Channel]:
    """Positions and rotations of an export of kind(). InputError: another layout, a cell no number, nothing seen."""
    readers: dict[str, Callable[[Path, list[Row]], Iterator[Channel]]] = {
        "Motive": _motive, "Vicon": _vicon, "Qualisys": _qualisys,
    }  # fmt: skip
    system = kind(path) or ""
    channels = list(readers[system](path, _rows(path)))
    if not channels:
        raise InputError(f"{path}: a {system} export without a position: allowed: one with rigid bodies or markers")
    return channels


def _rows(path: Path) -> list[Row]:
    """Cells of each line, blank lines as empty rows."""
    lines = foreign_csv.text_of(path).splitlines()
    separator = foreign_csv.separator_of([line for line in lines[:400] if line.strip()])
    rows = csv.reader((line.replace("\0", "") for line in lines), delimiter=separator)
    return [[cell.strip() for cell in row] if any(map(str.strip, row)) else [] for row in rows]


def _named_once(names: list[str]) -> list[str]:
    """Names with a number behind those that were there before."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        found.append(f"{name} ({seen[name]})" if seen[name] > 1 else name)
    return found


def _values(path: Path, first: int, rows: list[Row], column: int) -> Array:
    """A column as numbers, NaN where it is blank. first: number of the first row's line."""
    cells = [row[column] if column < len(row) else "" for row in rows]
    try:
        return np.array([cell.replace(",", ".") or "nan" for cell in cells], np.float64)
    except ValueError:
        for number, cell in enumerate(cells, first):
            if cell and not foreign_csv.is_number(cell):
                raise InputError(f'{path}: line {number}: "{cell}": allowed: a number, or blank') from None
        raise


def _channel(path: Path, name: str, unit: str, t: Array, value: Array) -> Iterator[Channel]:
    """The channel of the samples that are there; nothing where there are none. InputError: time goes back."""
    there = np.isfinite(value) & np.isfinite(t)
    t, value = t[there], value[there]
    if (np.diff(t) <= 0.0).any():
        raise InputError(f"{path}: {name}: time does not increase after {t[np.argmax(np.diff(t) <= 0.0)]:.6g} s")
    if len(t) > 1:
        yield Channel(name, unit, t, value)


def _end(rows: list[Row], first: int) -> int:
    """Number of the row after the block of rows that begins with first."""
    return next((k for k in range(first, len(rows)) if not rows[k]), len(rows))


# ---- Motive ----------------------------------------------------------------------------------------------------------


def _motive(path: Path, rows: list[Row]) -> Iterator[Channel]:
    head = next((k for k, row in enumerate(rows[:60]) if row[:1] == ["Frame"]), None)
    if head is None or len(rows[head]) < 3:
        raise InputError(f"{path}: Motive export without a line that begins with Frame,Time: allowed: CSV with header")
    settings = dict(itertools.pairwise(rows[0]))
    unit = LENGTH_UNITS.get(settings.get("Length Units", "").lower(), "")
    angle = "" if settings.get("Rotation Type", "Quaternion") == "Quaternion" else "deg"
    above = [row for row in rows[1:head] if row]
    labelled = {row[1]: row for row in above if len(row) > 1 and row[1]}
    if len(above) < 3:
        raise InputError(f"{path}: Motive export without lines of types, names and kinds above Frame: export them too")
    names, kinds = labelled.get("Name", above[1]), above[-1]
    data = rows[head + 1 : _end(rows, head + 1)]
    t = _values(path, head + 2, data, 1)
    columns = [
        (k, f"{names[k]}.{kinds[k].lower()}.{axis.lower()}", unit if kinds[k] == "Position" else angle)
        for k, axis in enumerate(rows[head])
        if 2 <= k < min(len(names), len(kinds)) and axis in ("X", "Y", "Z", "W")
    ]
    for (k, _, own), name in zip(columns, _named_once([name for _, name, _ in columns]), strict=True):
        yield from _channel(path, name, own, t, _values(path, head + 2, data, k))


# ---- Vicon -----------------------------------------------------------------------------------------------------------


def _vicon(path: Path, rows: list[Row]) -> Iterator[Channel]:
    for k, row in enumerate(rows):
        if row and row[0] in VICON_READ and not any(row[1:]):
            yield from _vicon_section(path, rows, k)


def _vicon_section(path: Path, rows: list[Row], k: int) -> Iterator[Channel]:
    """Section at row k: its name, the rate, objects, axes, units, then a row a frame."""
    block = rows[k : _end(rows, k)]
    if len(block) < 6 or block[3][:2] != ["Frame", "Sub Frame"] or not foreign_csv.is_number(block[1][0]):
        raise InputError(
            f'{path}: line {k + 1}: Vicon\'s section "{block[0][0]}" is followed by rate, names, axes from '
            "Frame,Sub Frame on, and units: not here"
        )
    rate = float(block[1][0])
    if not rate > 0.0:
        raise InputError(f"{path}: line {k + 2}: rate {block[1][0]}: allowed: frames per second")
    t = (_values(path, k + 6, block[5:], 0) - 1.0) / rate
    owner, names, own_units = "", [], []
    for column, axis in enumerate(block[3]):
        owner = (block[2][column] if column < len(block[2]) else "") or owner
        place = "rotation" if axis[:1] == "R" else "position"
        names.append(f"{owner}.{place}.{axis[-1:].lower()}")
        own_units.append(block[4][column] if column < len(block[4]) else "")
    for column, (name, unit) in enumerate(zip(_named_once(names), own_units, strict=True)):
        if column >= 2 and block[3][column].strip("RT") in ("X", "Y", "Z", "W"):
            yield from _channel(path, name, units.plain(unit), t, _values(path, k + 6, block[5:], column))


# ---- Qualisys --------------------------------------------------------------------------------------------------------


def _qualisys(path: Path, rows: list[Row]) -> Iterator[Channel]:
    settings = {row[0]: row[1:] for row in rows[:30] if row and row[0].isupper()}
    first = next(
        (k for k, row in enumerate(rows) if row and not row[0].isupper() and foreign_csv.is_number(row[0])), -1
    )
    rate = settings.get("FREQUENCY", [""])[0]
    if first < 0 or not foreign_csv.is_number(rate) or not float(rate.replace(",", ".")) > 0.0:
        raise InputError(f"{path}: Qualisys export without FREQUENCY or rows of numbers: allowed: TSV with header")
    has_time = rows[first - 1][:2] == ["Frame", "Time"]
    skip = 2 if has_time else 0
    data = rows[first : _end(rows, first)]
    counted = np.arange(len(data)) / float(rate.replace(",", "."))
    t = _values(path, first + 1, data, 1) if has_time else counted
    bodies = [name for name in settings.get("BODY_NAMES", []) if name]
    markers = [name for name in settings.get("MARKER_NAMES", []) if name]
    if not bodies and not markers:
        raise InputError(f"{path}: Qualisys export without MARKER_NAMES or BODY_NAMES: allowed: TSV with header")
    ends, width = (QTM_BODY, QTM_BODY_WIDTH) if bodies else (QTM_BODY[:3], 3)
    for number, name in enumerate(_named_once(bodies or markers)):
        columns = [_values(path, first + 1, data, skip + number * width + k) for k in range(len(ends))]
        unseen = np.all([column == 0.0 for column in columns[:3]], axis=0)
        for end, value in zip(ends, columns, strict=True):
            unit = "mm" if end.startswith("position") else "deg"
            yield from _channel(path, f"{name}.{end}", unit, t, np.where(unseen, np.nan, value))
