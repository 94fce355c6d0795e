# SPDX-License-Identifier: Apache-2.0
"""CSV files of other tools as channels: separator, decimal comma, BOM, units and a row of them found from the text.

A channel holds the rows in which its cell is not blank, so sensors of different rates in one file keep their own.
"""

import codecs
import csv
import itertools
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from inertiad.base import units
from inertiad.base.error import InputError
from inertiad.base.recognition import recognise
from inertiad.base.table import Array

SEPARATORS: Final = (";", "\t", ",", "|")
HEAD_LINES: Final = 60
"""a file's header ends within these"""
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|nan|inf|-inf", re.IGNORECASE)
_UNIT = re.compile(r"^(.*?)\s*[\[(]([^\[\]()]*)[\])]\s*$")


@dataclass(frozen=True)
class Channel:
    """One column of numbers over time."""

    name: str
    unit: str
    """as in the file"""
    t: Array
    """s [N]"""
    value: Array
    """in unit [N]"""

    @property
    def rate(self) -> float:
        """Hz, from the mean interval, gaps left out; 0: fewer than two samples."""
        return rate_of(self.t)


def rate_of(t: Array) -> float:
    """Hz of increasing times [N], s, from the mean of the intervals that are no gaps; 0: fewer than two."""
    steps = np.diff(t)
    if not len(steps):
        return 0.0
    return float(1.0 / np.mean(steps[steps <= 1.5 * np.median(steps)]))


def text_of(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if is_wide else ("utf-8-sig", "cp1252"):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise InputError(f"{path}: not text: allowed: UTF-8, UTF-16 with BOM, or Windows-1252")


def separator_of(lines: list[str]) -> str:
    """The one that most lines have the same number of, at least one."""
    best, most = ",", 0
    for separator in SEPARATORS:
        counts = Counter(line.count(separator) for line in lines if separator in line)
        n_columns, n_lines = max(counts.items(), key=lambda item: (item[1], item[0]), default=(0, 0))
        if n_columns and n_lines > most:
            best, most = separator, n_lines
    return best


def is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell.strip()) is not None


def _first_data_row(path: Path, rows: list[list[str]]) -> int:
    """The first row of which half the cells or more are numbers, with another like it below."""

    def is_data(row: list[str]) -> bool:
        filled = [cell for cell in row if cell.strip()]
        return len(filled) > 0 and sum(map(is_number, filled)) >= len(filled) / 2

    for number in range(1, min(len(rows), HEAD_LINES)):
        if is_data(rows[number]) and (number + 1 >= len(rows) or is_data(rows[number + 1])):
            return number
    raise InputError(f"{path}: no row of numbers below a header within {HEAD_LINES} lines")


def split_head(head: str) -> tuple[str, str]:
    """Name and unit of a column's head, "a [m/s2]" or "a (g)"; "" for no unit."""
    match = _UNIT.match(head)
    return (match[1], match[2].strip()) if match else (head, "")


def _heads(rows: list[list[str]]) -> list[tuple[str, str]]:
    """Names and units of the columns, from the rows above the numbers: "a [m/s2]", "a (g)", or a row of units."""
    last = [cell.strip().strip('"') for cell in rows[-1]]
    unit_row = [""] * len(last)
    if len(rows) > 1 and sum(map(bool, map(str.strip, rows[-2]))) >= len([c for c in last if c]):
        known = {unit for table in units.SI_VALUE.values() for unit in table if unit}
        plain = [cell.strip("[]() ") for cell in last if cell]
        if plain and sum(units.plain(cell) in known or cell in ("-", "1", "") for cell in plain) > len(plain) / 2:
            unit_row, last = [cell.strip("[]() ") for cell in last], [cell.strip().strip('"') for cell in rows[-2]]
    heads = []
    for name, unit in zip(last, unit_row, strict=False):
        heads.append((name, unit) if unit else split_head(name))
    return heads


def _numbers(path: Path, name: str, cells: list[tuple[int, str]], has_comma: bool) -> Array:
    try:
        return np.array([cell.replace(",", ".") if has_comma else cell for _, cell in cells], np.float64)
    except ValueError:
        line, cell = next((line, cell) for line, cell in cells if not is_number(cell))
        raise InputError(f'{path}: line {line}: {name} = "{cell}": allowed: a number, or blank') from None


def _columns(path: Path) -> Iterator[tuple[str, str, list[tuple[int, str]], bool]]:
    """Name, unit, filled cells with their row's number, and whether the decimal sign is a comma, of each column."""
    text = text_of(path)
    numbered = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    places, lines = [number for number, _ in numbered], [line for _, line in numbered]
    if len(lines) < 2:
        raise InputError(f"{path}: no rows below a header")
    separator = separator_of(lines[: 4 * HEAD_LINES])
    rows = list(csv.reader(lines, delimiter=separator))
    first = _first_data_row(path, rows)
    has_comma = separator != "," and any(re.fullmatch(r"\s*[+-]?\d*,\d+.*", c) for row in rows[first:] for c in row)
    heads = _heads(rows[:first])
    twice = [name for name, n in Counter(name for name, _ in heads if name).items() if n > 1]
    if twice:
        raise InputError(f"{path}: column {twice[0]} is there {Counter(n for n, _ in heads)[twice[0]]} times")
    width = max(map(len, rows[first:]))
    if width > len(heads):
        at = next(i for i, row in enumerate(rows[first:], first) if len(row) > len(heads))
        raise InputError(f"{path}: line {places[at]}: {len(rows[at])} values: allowed: {len(heads)}, as the header has")
    for i, (name, unit) in enumerate(heads):
        cells = [
            (places[n], row[i].strip()) for n, row in enumerate(rows[first:], first) if i < len(row) and row[i].strip()
        ]
        if name and cells:
            yield name, unit, cells, has_comma


def read(path: Path, time: str | None = None, time_unit: str | None = None) -> list[Channel]:
    """Every column of numbers of a CSV file, over its column of time.

    time: name of that column; None: the first one recognised as a time. time_unit: None: as in the file, else s.
    InputError: no table, no time, time that does not increase within a channel, or a cell that is no number.
    """
    found = list(_columns(path))
    named = [name for name, unit, _, _ in found if (recognise(name, unit) == "t" if time is None else name == time)]
    if not named:
        wanted = "no column of time, as t or Time [s]" if time is None else f'no column "{time}"'
        raise InputError(f"{path}: {wanted}; columns: {', '.join(name for name, *_ in found[:24])}")
    at: dict[int, float] = {}
    for name, unit, cells, has_comma in found:
        if name == named[0]:
            factor = units.factor("t", time_unit or unit, f"{path}: {name}")
            at = dict(
                zip([n for n, _ in cells], (factor * _numbers(path, name, cells, has_comma)).tolist(), strict=True)
            )
    channels = []
    for name, unit, cells, has_comma in found:
        if name != named[0] and any(is_number(cell) for _, cell in cells[:20]):
            kept = [(n, cell) for n, cell in cells if n in at]
            t, value = np.array([at[n] for n, _ in kept]), _numbers(path, name, kept, has_comma)
            there = np.isfinite(t) & np.isfinite(value)
            kept, t, value = list(itertools.compress(kept, there)), t[there], value[there]
            if not len(t):
                continue
            back = np.flatnonzero(np.diff(t) <= 0.0)
            if len(back):
                line = kept[int(back[0]) + 1][0]
                raise InputError(f"{path}: line {line}: {named[0]} does not increase")
            channels.append(Channel(name, unit, t, value))
    return channels
