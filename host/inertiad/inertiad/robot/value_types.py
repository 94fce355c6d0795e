# SPDX-License-Identifier: Apache-2.0
"""Types of the values in robot.toml and other tables: numbers and vectors with their ranges and units.

A range checks a value and, in the JSON schema of its key, states minimum, maximum and unit.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema


@dataclass(frozen=True)
class Unit:
    """The unit of a key, for its JSON schema."""

    unit: str

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return handler(schema) | {"unit": self.unit}


@dataclass(frozen=True)
class Range:
    """A closed interval with a unit; the error it raises names both."""

    low: float
    high: float
    unit: str = ""

    def __call__(self, value: float) -> float:
        if not self.low <= value <= self.high:
            raise ValueError(f"{self.low:g} to {self.high:g} {self.unit}".rstrip())
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        unit = {"unit": self.unit} if self.unit else {}
        return handler(schema) | {"minimum": self.low, "maximum": self.high} | unit


def unit_norm(value: list[float]) -> list[float]:
    norm = math.hypot(*value)
    if abs(norm - 1.0) > 1e-6:
        raise ValueError(f"a unit vector, this one has length {norm:.9g}")
    return value


def zero_or_10_to_1e9(value: float) -> float:
    return value if value == 0.0 else Range(10, 1e9, "s, or 0: for ever")(value)


Number3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Number4 = Annotated[list[float], Field(min_length=4, max_length=4)]
Inertia = Annotated[list[Annotated[float, Range(-1e9, 1e9, "kg m2")]], Field(min_length=6, max_length=6)]
Far3 = Annotated[list[Annotated[float, Range(-1e4, 1e4, "m")]], Field(min_length=3, max_length=3)]
Near3 = Annotated[list[Annotated[float, Range(-1e3, 1e3, "m")]], Field(min_length=3, max_length=3)]
Axis = Annotated[Number3, AfterValidator(unit_norm)]
Quaternion = Annotated[Number4, AfterValidator(unit_norm)]
Delay = Annotated[float, Range(-1, 1, "s")]
Age = Annotated[float, Range(1e-6, 10, "s")]
Memory = Annotated[
    float,
    AfterValidator(zero_or_10_to_1e9),
    Unit("s"),
    Field(json_schema_extra={"anyOf": [{"const": 0}, {"minimum": 10, "maximum": 1e9}]}),
]
"""0: for ever, or 10 to 1e9 s"""
