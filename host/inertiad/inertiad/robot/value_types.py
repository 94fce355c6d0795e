# SPDX-License-Identifier: Apache-2.0
"""Types of the values in robot.toml: numbers and vectors with their ranges and units."""

import math
from typing import Annotated

from pydantic import AfterValidator, Field

from inertiad.robot.messages import Range


def unit_norm(value: list[float]) -> list[float]:
    norm = math.hypot(*value)
    if abs(norm - 1.0) > 1e-6:
        raise ValueError(f"a unit vector, this one has length {norm:.9g}")
    return value


Number3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Number4 = Annotated[list[float], Field(min_length=4, max_length=4)]
Inertia = Annotated[
    list[Annotated[float, AfterValidator(Range(-1e9, 1e9, "kg m2"))]], Field(min_length=6, max_length=6)
]
Far3 = Annotated[list[Annotated[float, AfterValidator(Range(-1e4, 1e4, "m"))]], Field(min_length=3, max_length=3)]
Near3 = Annotated[list[Annotated[float, AfterValidator(Range(-1e3, 1e3, "m"))]], Field(min_length=3, max_length=3)]
Axis = Annotated[Number3, AfterValidator(unit_norm)]
Quaternion = Annotated[Number4, AfterValidator(unit_norm)]
Delay = Annotated[float, AfterValidator(Range(-1, 1, "s"))]
Age = Annotated[float, AfterValidator(Range(1e-6, 10, "s"))]
Sigma = Annotated[float, AfterValidator(Range(0, 1e6))]
PositiveSigma = Annotated[float, AfterValidator(Range(1e-9, 1e6))]
