# SPDX-License-Identifier: Apache-2.0
"""Tables of checked keys, and one line for each key that is wrong: source: key = value: allowed: ..."""

import difflib
from collections.abc import Iterable
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.base.text_files import toml_value


class Strict(BaseModel):
    """Base of every table: unknown keys, wrong types, NaN and infinity are refused."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


def nearest(key: str, known: Iterable[str]) -> str:
    """ "; did you mean ...?" where a known key is alike, else nothing."""
    near = difflib.get_close_matches(key, list(known), n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else ""


def nearest_or_known(key: str, known: list[str]) -> str:
    return nearest(key, known) or f"; known: {', '.join(known[:24])}"


def _key(loc: tuple[int | str, ...]) -> str:
    """("cable", 2, "anchor", 0) -> cable[3].anchor[1], counted from one as cables are."""
    text = ""
    for part in loc:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        elif not part.startswith(("list[", "function-", "str", "float")) and part not in ("text", "list", "table"):
            text += f".{part}" if text else part
    return text


def shown(value: Any) -> str:
    text = "a table" if isinstance(value, dict) else toml_value(value)
    return text if len(text) <= 60 else text[:57] + "..."


_TYPE_NAMES = {
    "float_type": "a number",
    "int_type": "a whole number",
    "string_type": "a text in quotes",
    "list_type": "a list",
    "bool_type": "true or false",
    "dict_type": "a table",
    "model_type": "a table",
    "finite_number": "a finite number",
}


def _allowed(error: dict[str, Any]) -> str:
    """The allowed values, in a few words."""
    kind, ctx = error["type"], error.get("ctx", {})
    if kind == "value_error":
        return str(ctx["error"])
    if kind == "literal_error":
        return str(ctx["expected"]).replace("'", '"')
    if kind in ("too_short", "too_long"):
        low, high = ctx.get("min_length"), ctx.get("max_length")
        return f"{low if low == high or high is None else high} entries, not {ctx['actual_length']}"
    if kind == "string_too_short":
        return "not empty"
    return _TYPE_NAMES.get(kind, error["msg"])


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The table an annotation speaks of, however deep inside lists, dicts and unions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for inner in get_args(annotation) if (found := _model_in(inner))), None)


def _fields_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Names of the keys allowed in the table at loc."""
    current: type[BaseModel] | None = model
    for part in loc:
        if current is None or (isinstance(part, str) and part not in current.model_fields):
            break
        if isinstance(part, str):
            current = _model_in(current.model_fields[part].annotation)
    return list(current.model_fields) if current is not None else []


def _message(model: type[BaseModel], error: dict[str, Any]) -> str:
    loc = error["loc"]
    if error["type"] == "extra_forbidden":
        return f"{_key(loc)}: unknown key{nearest_or_known(str(loc[-1]), _fields_at(model, loc[:-1]))}"
    if error["type"] == "missing":
        return f"{_key(loc)}: missing, and it has no default"
    if error["type"] in ("too_short", "too_long") and loc[-1] == "cable":
        return f"cable: {error['ctx']['actual_length']} cables: allowed: 1 to {quantity.CABLES_MAX}"
    if error["type"] == "value_error" and isinstance(error["input"], dict):
        return f"{_key(loc)}: allowed: {_allowed(error)}".removeprefix(": allowed: ")
    return f"{_key(loc)} = {shown(error['input'])}: allowed: {_allowed(error)}"


Model = TypeVar("Model", bound=BaseModel)


def validate(model: type[Model], data: dict[str, Any], source: str) -> Model:
    """data as model; InputError with a line "source: key = value: allowed: ..." for every key that does not fit."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        errors = error.errors()
        if any(e["loc"][:1] == ("cables",) for e in errors):  # each cable repeats what it takes from [cables]
            errors = [e for e in errors if e["loc"][:1] != ("cable",)]
        texts = [text for e in errors for text in _message(model, dict(e)).splitlines()]
        raise InputError(*(f"{source}: {' '.join(text.split())}" for text in dict.fromkeys(texts))) from None
