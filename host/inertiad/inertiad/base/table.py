# SPDX-License-Identifier: Apache-2.0
"""Named columns over time: the CSV files users bring."""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inertiad.base import units
from inertiad.base.error import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """Columns of equal length N over strictly increasing time."""

    t: Array
    """s, [N]"""
    columns: dict[str, Array]
    """SI, [N] each"""
    source: str
    """What to call the table in messages."""

    def stack(self, *names: str) -> Array:
        """The named columns as [N, len(names)]."""
        return np.column_stack([self.columns[name] for name in names])


def _bad_line(path: Path, names: list[str]) -> str:
    """Where a CSV file stops being a table of numbers."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            cells = line.rstrip("\r\n").split(",")
            if number == 1 or not line.strip():
                continue
            if len(cells) != len(names):
                return f"line {number}: {len(cells)} values: allowed: {len(names)}, one per column of the header"
            for name, cell in zip(names, cells, strict=True):
                try:
                    float(cell)
                except ValueError:
                    return f'line {number}: {name} = "{cell.strip()}": allowed: a number'
    return "not a table of numbers"


def _line_of(path: Path, row: int) -> int | None:
    """Line number of data row (counted from 0), empty lines passed over; None: there is no such row."""
    with path.open(encoding="utf-8", errors="replace") as file:
        filled = (number for number, line in enumerate(file, start=1) if line.strip())
        return next(itertools.islice(filled, row + 1, None), None)


def _numbers(path: Path, names: list[str]) -> Array:
    if _line_of(path, 0) is None:
        raise InputError(f"{path}: no data below the header")
    try:
        data = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, comments=None, encoding="utf-8")
    except (ValueError, UnicodeDecodeError):
        raise InputError(f"{path}: {_bad_line(path, names)}") from None
    if data.shape[1] != len(names):
        raise InputError(f"{path}: {_bad_line(path, names)}")
    return data


def _header(path: Path, allowed: list[str]) -> tuple[list[str], list[str]]:
    """Names and units of the columns."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            heads = [units.split(head) for head in file.readline().split(",")]
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text") from None
    names = [name for name, _ in heads]
    if "t" not in names:
        raise InputError(f"{path}: line 1: no column t: allowed: a header such as {','.join(allowed[:8])}")
    for name in names:
        if name not in allowed:
            raise InputError(f'{path}: line 1: column "{name}" is unknown: allowed: {", ".join(allowed)}')
        if names.count(name) > 1:
            raise InputError(f"{path}: line 1: column {name} is there twice")
    return names, [unit for _, unit in heads]


def read(path: Path, allowed: list[str]) -> Table:
    """A CSV file with a header, column t [s] and others of the allowed names (which include t), SI.

    A head may have a unit, "x [mm]": its column is converted. InputError names file, line and column of: an unknown or
    doubled column, a unit of something else, something that is not a finite number, time that does not increase.
    """
    names, given = _header(path, allowed)
    data = _numbers(path, names)
    data *= [units.factor(name, unit, f"{path}: line 1") for name, unit in zip(names, given, strict=True)]
    t = data[:, names.index("t")]
    bad = np.argwhere(~np.isfinite(data))
    if len(bad):
        row, column = bad[0]
        value = data[row, column]
        raise InputError(f"{path}: line {_line_of(path, row)}: {names[column]} = {value}: allowed: a finite number")
    back = np.flatnonzero(np.diff(t) <= 0.0)
    if len(back):
        row = int(back[0]) + 1
        before = f"above {t[row - 1]:.9g}, the line before"
        raise InputError(f"{path}: line {_line_of(path, row)}: t = {t[row]:.9g} s: allowed: {before}")
    return Table(t, {name: data[:, i] for i, name in enumerate(names) if name != "t"}, str(path))
