# SPDX-License-Identifier: Apache-2.0
"""TOML and JSON files as nested dicts, and TOML text of such dicts."""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from inertiad.base.error import InputError

FILE_BYTES_MAX: Final = 1_000_000


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object. InputError names the file, and the line where it stops being JSON."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{path}: not JSON: {error}") from None
    if not isinstance(data, dict):
        raise InputError(f"{path}: not a JSON object")
    return data


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as nested dicts. InputError names file and line."""
    try:
        if path.stat().st_size > FILE_BYTES_MAX:
            raise InputError(f"{path}: larger than {FILE_BYTES_MAX} bytes, not a description")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text at byte {error.start}") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not TOML: {error or 'nested too deeply'}") from None


def toml_value(value: Any) -> str:
    """A value as TOML text on one line."""
    if isinstance(value, list):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _toml_lines(data: dict[str, Any], prefix: str) -> Iterator[str]:
    tables = {key: value for key, value in data.items() if isinstance(value, dict)}
    arrays = {
        key: value for key, value in data.items() if isinstance(value, list) and value and isinstance(value[0], dict)
    }
    for key, value in data.items():
        if key not in tables and key not in arrays:
            yield f"{key} = {toml_value(value)}"
    for key, table in tables.items():
        yield f"\n[{prefix}{key}]"
        yield from _toml_lines(table, f"{prefix}{key}.")
    for key, array in arrays.items():
        for table in array:
            yield f"\n[[{prefix}{key}]]"
            yield from _toml_lines(table, f"{prefix}{key}.")


def to_toml(data: dict[str, Any]) -> str:
    """The keys of a robot.toml as text that reads back the same. Keys must be bare: letters, digits, _ and -."""
    return "\n".join(_toml_lines(data, "")) + "\n"
