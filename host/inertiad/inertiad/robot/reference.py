# SPDX-License-Identifier: Apache-2.0
"""The reference of robot.toml's keys, as JSON schema and as text, both made from keys.py and description.Robot."""

import textwrap
from collections.abc import Iterator
from typing import Any

from inertiad.base.text_files import toml_value
from inertiad.robot.description import Robot

WIDTH = 100
Schema = dict[str, Any]

INTRODUCTION = (
    "robot.toml: every key with its type, range, unit, default and meaning. Only name and the cables are required. "
    "SI units; anything else carries its unit in its name. W: world frame, z up; P: platform frame; I: IMU frame."
)


def _without_null(value: Any) -> Any:
    """TOML has no null: a key without a value is left out."""
    if isinstance(value, list):
        return [_without_null(item) for item in value]
    if not isinstance(value, dict):
        return value
    found = {key: _without_null(item) for key, item in value.items() if not (key == "default" and item is None)}
    choices = [item for item in found.get("anyOf", []) if item != {"type": "null"}]
    if len(choices) < len(found.get("anyOf", [])):
        del found["anyOf"]
        found = (choices[0] if len(choices) == 1 else {"anyOf": choices}) | found
    return found


def _with_units(table: Schema) -> None:
    """Each key's unit at the end of its description, where editors show it."""
    for key in table.get("properties", {}).values():
        unit = unit_of(key)
        if unit and "description" in key:
            key["description"] = f"{key['description']} [{unit}]"


def _whole() -> Schema:
    """The schema of a robot.toml without a base."""
    found: Schema = _without_null(Robot.model_json_schema())
    for table in (found, *found["$defs"].values()):
        _with_units(table)
    return found


def schema() -> Schema:
    """JSON schema (draft 2020-12) of robot.toml; "unit" is a keyword of its own. What needs arithmetic is not in it."""
    found = _whole()
    complete = {"required": found.pop("required")}
    found["$defs"]["Nominal"].pop("required")  # a file with a base may replace some of its keys
    whole = {"properties": {"nominal": {"required": ["mass", "cog", "inertia_cog"]}}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **found,
        "title": "robot.toml of inertiad",
        "if": {"not": {"required": ["base"]}},
        "then": complete | whole,
    }


def unit_of(key: Schema) -> str:
    """Unit of a key's number or numbers; "" for none."""
    return str(key.get("unit") or (unit_of(key["items"]) if "items" in key else ""))


def _limits(key: Schema) -> str:
    low, high = key.get("minimum"), key.get("maximum")
    return f"{low:g} to {high:g}" if low is not None and high is not None else ""


def allowed(key: Schema, tables: dict[str, Schema]) -> str:
    """Type, range and unit of a key in a few words."""
    if "enum" in key:
        return " | ".join(toml_value(value) for value in key["enum"])
    if "$ref" in key:
        inner = tables[key["$ref"].rpartition("/")[2]]["properties"]
        return f"{{ {', '.join(f'{name} = {allowed(k, tables)}' for name, k in inner.items())} }}"
    if key.get("type") == "array":
        item, n = key["items"], key.get("minItems")
        count = f"{n} " if n is not None and n == key.get("maxItems") else ""
        kind = {"number": "numbers", "string": "texts"}.get(item.get("type"), "rows")
        return " ".join(f"[{count}{kind}] {_limits(item)} {unit_of(key)}".split())
    if "type" not in key:
        return " or ".join(allowed(choice, tables) for choice in key["anyOf"])
    names = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true | false"}
    name = names[key["type"]]
    return " ".join(f"{name} {_limits(key)} {unit_of(key)}".split())


def _entry(name: str, key: Schema, tables: dict[str, Schema], is_required: bool) -> Iterator[str]:
    default = "required" if is_required else f"default {toml_value(key['default'])}" if "default" in key else "optional"
    yield f"  {name} = {allowed(key, tables)}; {default}"
    yield from textwrap.wrap(meaning(key), WIDTH, initial_indent="      ", subsequent_indent="      ")


def meaning(key: Schema) -> str:
    """A key's description without its unit."""
    return " ".join(key.get("description", "").removesuffix(f"[{unit_of(key)}]").split())


def table_of(key: Schema, tables: dict[str, Schema]) -> tuple[Schema, str] | None:
    """The table that a key of robot.toml holds, and its brackets; None: a value."""
    reference, brackets = (key["items"], "[[{}]]") if "items" in key else (key, "[{}]")
    return (tables[reference["$ref"].rpartition("/")[2]], brackets) if "$ref" in reference else None


def _table(path: str, table: Schema, brackets: str, tables: dict[str, Schema]) -> Iterator[str]:
    """One table, and those in it that have a name of their own."""
    yield ""
    yield f"{brackets.format(path)}"
    yield from textwrap.wrap(" ".join(table["description"].split()), WIDTH, initial_indent="  ", subsequent_indent="  ")
    inner = []
    known = tables["Cables"]["properties"] if path == "cable" else {}
    for name, key in table["properties"].items():
        if name in known:
            continue
        found = table_of(key, tables)
        if found is not None and "description" not in key:
            inner.append((f"{path}.{name}", *found))
        else:
            yield from _entry(name, key, tables, name in table.get("required", []))
    for place, below, form in inner:
        yield from _table(place, below, form, tables)


def text() -> str:
    """Every key, table by table, as `inertiactl help robot.toml` prints it."""
    whole = _whole()
    tables = whole["$defs"]
    lines = [*textwrap.wrap(INTRODUCTION, WIDTH), ""]
    places = []
    for name, key in whole["properties"].items():
        found = table_of(key, tables)
        if found is not None:
            places.append((name, *found))
        elif name == "signals":
            quantities = ", ".join(key["propertyNames"]["enum"])
            signals = {"description": key["description"], "properties": {}}
            places.append((name, signals | {"description": f"{key['description']} Quantities: {quantities}."}, "[{}]"))
        else:
            lines += _entry(name, key, tables, name in whole["required"])
    for place, table, brackets in places:
        lines += _table(place, table, brackets, tables)
    return "\n".join(lines)
