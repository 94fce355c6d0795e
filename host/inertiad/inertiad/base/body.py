# SPDX-License-Identifier: Apache-2.0
"""The ten numbers of a body, estimated or true: by name, with unit and standard deviation."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from inertiad.base.error import InputError
from inertiad.base.text_files import read_json

KEYS: Final = ("mass", "cog", "inertia_cog")
NAMES: Final = ("mass", "cog x", "cog y", "cog z", "J xx", "J yy", "J zz", "J yz", "J xz", "J xy")
UNITS: Final = ("kg", "m", "m", "m", "kg m2", "kg m2", "kg m2", "kg m2", "kg m2", "kg m2")


@dataclass(frozen=True)
class Body:
    """Mass [kg], CoG [m] in P, inertia about it [kg m2] xx yy zz yz xz xy: ten values in the order of NAMES."""

    value: tuple[float, ...]
    std: tuple[float, ...]
    """one standard deviation each; zeros for a truth, NaN where the method gives none"""


def _ten(data: dict[str, Any], path: Path, may_lack: bool = False) -> list[float]:
    """The ten values; may_lack: null is NaN."""
    try:
        values = [data["mass"], *data["cog"], *data["inertia_cog"]]
        ten = [float("nan") if v is None and may_lack else float(v) for v in values]
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: allowed: mass, cog with 3 and inertia_cog with 6 numbers") from None
    if len(ten) != len(NAMES):
        raise InputError(f"{path}: {len(ten)} numbers in mass, cog, inertia_cog: allowed: {len(NAMES)}")
    return ten


def read(path: Path) -> Body:
    """estimate.json as a Body. InputError if it is not such a file."""
    data = read_json(path)
    try:
        value = {key: data[key]["value"] for key in KEYS}
        std = {key: data[key]["std"] for key in KEYS}
    except (KeyError, TypeError):
        raise InputError(f'{path}: allowed: {", ".join(KEYS)}, each with "value" and "std"') from None
    return Body(tuple(_ten(value, path)), tuple(_ten(std, path, may_lack=True)))


def read_truth(path: Path) -> Body:
    """truth.json as a Body. InputError if it is not such a file."""
    return Body(tuple(_ten(read_json(path), path)), (0.0,) * len(NAMES))


def of_message(message: Any) -> Body:
    """An estimate_t as a Body."""
    value = (message.mass, *message.cog, *message.inertia_cog)
    return Body(value, (message.mass_std, *message.cog_std, *message.inertia_cog_std))


def errors(estimate: Body, truth: Body) -> tuple[float, ...]:
    """Estimate minus truth, ten values in the order of NAMES."""
    return tuple(e - t for e, t in zip(estimate.value, truth.value, strict=True))
