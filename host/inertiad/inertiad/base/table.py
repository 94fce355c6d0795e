# SPDX-License-Identifier: Apache-2.0
"""Named columns over time, and the one reader of CSV files."""

import csv
import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inertiad.base import units
from inertiad.base.error import InputError

Array = NDArray[np.float64]
Values = NDArray[Any]
"""float64, int64, bool, or str as object"""
Convert = Callable[[str, list[str]], Values]
"""Values of a column, by its name, from the text of its cells. ValueError: a cell is not of that kind."""

NS: Final = 1_000_000_000
BLOCK: Final = 1 << 16
"""rows of a CSV file that are text at one time"""

LARGEST: Final = 1e15
"""beyond any sensor in any unit; products of such numbers do not overflow"""


@dataclass(frozen=True)
class Table:
    """Columns of equal length N over time. The unit of each: units.of(its name)."""

    t: Array
    """s, [N]"""
    columns: dict[str, Values]
    """[N] each"""
    name: str
    """of the table in messages: its file, or the kind of its rows"""
    exact: NDArray[np.int64] | None = None
    """ns, [N]: t where it is known to the nanosecond"""

    def __len__(self) -> int:
        return len(self.t)

    @property
    def t_ns(self) -> NDArray[np.int64]:
        """ns, [N]"""
        return np.rint(1e9 * self.t).astype(np.int64) if self.exact is None else self.exact

    def stack(self, *names: str) -> Array:
        """The named columns as [N, len(names)]."""
        return np.column_stack([self.columns[name] for name in names])


def at_ns(name: str, t_ns: NDArray[np.int64], columns: dict[str, Values]) -> Table:
    """A table over exact times, ns [N]."""
    return Table(np.asarray(t_ns * 1e-9, np.float64), columns, name, t_ns)


# ---- CSV -------------------------------------------------------------------------------------------------------------


def header(path: Path, example: str = "t [s],...") -> tuple[list[str], list[str]]:
    """Names and units of a CSV file's columns. InputError: unreadable, no column t, or a column twice.

    example: a header that would do, for the message.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            heads = [units.split(head) for head in file.readline().split(",")]
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text") from None
    names = [name for name, _ in heads]
    if "t" not in names:
        raise InputError(f"{path}: line 1: no column t: allowed: a header such as {example}")
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: line 1: column {name} is there twice")
    return names, [unit for _, unit in heads]


def _blocks(path: Path, n_columns: int) -> Iterator[tuple[list[int], list[list[str]]]]:
    """Line numbers and cells, a list per column, of up to BLOCK rows at a time. Empty lines are passed over."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        numbered = ((reader.line_num, row) for row in reader if len(row) > 1 or any(map(str.strip, row)))
        try:
            next(numbered, None)
            while rows := list(itertools.islice(numbered, BLOCK)):
                for line, row in rows:
                    if len(row) != n_columns:
                        allowed = f"{n_columns}, one per column of the header"
                        raise InputError(f"{path}: line {line}: {len(row)} values: allowed: {allowed}")
                yield [line for line, _ in rows], [list(cells) for cells in zip(*(row for _, row in rows), strict=True)]
        except UnicodeDecodeError:
            raise InputError(f"{path}: not UTF-8 text") from None
        except csv.Error as error:
            raise InputError(f"{path}: line {reader.line_num}: not CSV: {error}") from None


def _converted(path: Path, name: str, cells: list[str], lines: list[int], convert: Convert) -> Values:
    try:
        return convert(name, cells)
    except (ValueError, OverflowError):
        for line, cell in zip(lines, cells, strict=True):
            try:
                convert(name, [cell])
            except (ValueError, OverflowError):
                raise InputError(f'{path}: line {line}: {name} = "{cell.strip()}": allowed: a number') from None
        raise


def numbers(name: str, cells: list[str]) -> Array:
    """Every cell as a number."""
    return np.array(cells, np.float64)


def _time_ns(text: str) -> int:
    match = re.fullmatch(r"([+-]?)(\d+)(?:\.(\d{1,9})0*)?", text.strip())
    if not match:
        time = float(text)
        return round(time * 1e9) if np.isfinite(time) else 0  # a time that is no number is found in t
    size = int(match[2]) * NS + int((match[3] or "0").ljust(9, "0"))
    return -size if match[1] == "-" else size


def _exact(name: str, cells: list[str]) -> NDArray[np.int64]:
    return np.array([_time_ns(cell) for cell in cells], np.int64)


def read_columns(path: Path, convert: Convert = numbers, example: str = "t [s],...") -> Table:
    """A CSV file with a header, a column t [s] and any others.

    A head may have a unit, "x [mm]": its column is converted to SI. InputError names file, line and column of: what
    header() refuses, a unit of something else, a line of another length, a cell that convert refuses.
    """
    names, given = header(path, example)
    factors = [units.factor(name, unit, f"{path}: line 1") for name, unit in zip(names, given, strict=True)]
    parts: dict[str, list[Values]] = {name: [] for name in names}
    exact = []
    for lines, cells in _blocks(path, len(names)):
        for name, column in zip(names, cells, strict=True):
            parts[name].append(_converted(path, name, column, lines, numbers if name == "t" else convert))
        exact.append(_converted(path, "t", cells[names.index("t")], lines, _exact))
    columns = {}
    for name, factor in zip(names, factors, strict=True):
        values = np.concatenate(parts[name]) if parts[name] else convert(name, [])
        columns[name] = values if factor == 1.0 else values * factor
    t_ns = np.concatenate(exact) if exact else np.zeros(0, np.int64)
    per_unit = factors[names.index("t")]
    t_ns = t_ns if per_unit == 1.0 else np.rint(t_ns * per_unit).astype(np.int64)
    return Table(columns.pop("t"), columns, str(path), t_ns)


def _line_of(path: Path, row: int) -> int:
    """Line number of data row (counted from 0), empty lines passed over."""
    with path.open(encoding="utf-8", errors="replace") as file:
        filled = (number for number, line in enumerate(file, start=1) if line.strip())
        return next(itertools.islice(filled, row + 1, None))


def read(path: Path, allowed: list[str]) -> Table:
    """A CSV file of numbers over increasing time, its columns among the allowed names (which include t).

    InputError: see read_columns(); also for an unknown column, no row at all, something that is not a finite number or
    larger than LARGEST, time that does not increase.
    """
    names, _ = header(path, ",".join(allowed[:8]))
    for name in names:
        if name not in allowed:
            raise InputError(f'{path}: line 1: column "{name}" is unknown: allowed: {", ".join(allowed)}')
    table = read_columns(path, example=",".join(allowed[:8]))
    if len(table) == 0:
        raise InputError(f"{path}: no data below the header")
    data = np.column_stack([table.t if name == "t" else table.columns[name] for name in names])
    bad = np.argwhere(~(np.abs(data) <= LARGEST))
    if len(bad):
        row, column = bad[0]
        value = data[row, column]
        allowed_value = f"up to {LARGEST:g}" if np.isfinite(value) else "a finite number"
        raise InputError(f"{path}: line {_line_of(path, row)}: {names[column]} = {value}: allowed: {allowed_value}")
    back = np.flatnonzero(np.diff(table.t) <= 0.0)
    if len(back):
        row = int(back[0]) + 1
        before = f"above {table.t[row - 1]:.9g}, the line before"
        raise InputError(f"{path}: line {_line_of(path, row)}: t = {table.t[row]:.9g} s: allowed: {before}")
    return table
