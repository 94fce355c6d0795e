# SPDX-License-Identifier: Apache-2.0
"""Recognise the quantity of a channel by its name and unit: proposals for DBC signals and columns of foreign files."""

import re
from typing import Final

from inertiad.base import quantity, units

_VECTORS: Final[tuple[tuple[tuple[str, ...], quantity.Dimension, str], ...]] = (
    (quantity.ACC, "acceleration", r"acc|accel|acceleration|linacc|specific|a"),
    (quantity.GYRO, "rate", r"gyro|gyr|rate|omega|angvel|angular|w"),
    (quantity.POSITION, "length", r"pos|position|tracker|reflector|marker|target|p"),
)
_ATTITUDE = r"q|quat|quaternion|orientation|attitude|rotation|rot"
_ANGLES = {"roll": "roll", "pitch": "pitch", "yaw": "yaw", "heading": "yaw"}
_FORCE = r"f|fc|force|forces|load|tension|cell|lc|loadcell|channel|ch|cable|dms"
_TIME = r"t|time|timestamp|zeit|sec|seconds|stamp"
_COUNTER = r"counter|count|cnt|seq|sequence|samplecounter|packetcounter"


def words(name: str) -> list[str]:
    """The words and numbers of a name in lower case: "accX", "Acc_x" and "ACC-X" -> acc, x."""
    split = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    found = re.findall(r"[a-z]+|\d+", split.lower())
    last = found[-1] if found else ""
    if len(last) > 1 and last[-1] in "xyz" and re.fullmatch(r"acc|gyr|gyro|omega|pos|quat|q|a|w|p", last[:-1]):
        found[-1:] = [last[:-1], last[-1]]  # accx, gyrox
    return ["q", "w"] if found == ["qw"] else found


def _measures(unit: str, dimension: quantity.Dimension) -> bool:
    """Whether a unit is of a dimension; no unit fits each."""
    try:
        units.unit_factor(unit, dimension)
    except KeyError:
        return False
    return True


def _vector(found: list[str], unit: str) -> str | None:
    axis = found[-1] if found[-1] in quantity.AXES else None
    if axis is None:
        return None
    for names, dimension, pattern in _VECTORS:
        is_named = any(re.fullmatch(pattern, word) for word in found[:-1])
        is_alone = not found[:-1] and dimension == "length"
        if (is_named or is_alone) and _measures(unit, dimension):
            return names[quantity.AXES.index(axis)]
    return None


def _quaternion(found: list[str], unit: str) -> str | None:
    if not (any(re.fullmatch(_ATTITUDE, word) for word in found[:-1]) and _measures(unit, "none")):
        return None
    last = found[-1]
    if last in ("0", "1", "2", "3"):
        return quantity.QUATERNION[int(last)]
    return f"q_{last}" if last in ("w", "x", "y", "z") else None


def recognise(name: str, unit: str = "") -> str | None:
    """The quantity, "t" or "counter" that a channel of such a name and unit most likely is; None: no idea."""
    found = words(name)
    if not found:
        return None
    if (quaternion := _quaternion(found, unit)) is not None:
        return quaternion
    if (vector := _vector(found, unit)) is not None:
        return vector
    if found[-1] in _ANGLES and _measures(unit, "angle"):
        return _ANGLES[found[-1]]
    if found[-1] == "norm" and "force" in found:  # /cable_1/wrench.wrench.force.norm
        while found and not found[-1].isdigit():
            found.pop()
        return recognise(" ".join(found), unit)
    if found[-1].isdigit() and any(re.fullmatch(_FORCE, word) for word in found[:-1]) and _measures(unit, "force"):
        number = int(found[-1])
        return f"f_{number}" if 1 <= number <= quantity.CABLES_MAX else None
    if any(re.fullmatch(_COUNTER, word) for word in found):
        return "counter"
    return "t" if any(re.fullmatch(_TIME, word) for word in found) and _measures(unit, "time") else None
