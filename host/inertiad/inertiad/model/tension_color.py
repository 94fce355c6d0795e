# SPDX-License-Identifier: Apache-2.0
"""Colour of a cable by its tension against its limits, in every picture of a robot in motion."""

import math
from typing import Final

Rgb = tuple[int, int, int]

RAMP: Final[tuple[tuple[float, Rgb], ...]] = (
    (0.0, (37, 99, 200)),
    (0.4, (20, 160, 170)),
    (0.7, (215, 160, 20)),
    (1.0, (214, 78, 18)),
)
"""colours from tension_min, 0, to tension_max, 1"""
SLACK: Final[Rgb] = (138, 63, 252)
OVERLOAD: Final[Rgb] = (192, 28, 40)
DECADE: Final = 3.0
"""tension_max over tension_min from which the scale is logarithmic"""


def color(f: float, low: float, high: float) -> Rgb:
    """Colour of a tension f between tension_min low and tension_max high, N."""
    if f < low or f > high:
        return SLACK if f < low else OVERLOAD
    is_log = low > 0.0 and high / low > DECADE
    share = math.log(f / low) / math.log(high / low) if is_log else (f - low) / max(high - low, 1e-9)
    at = next(k for k in range(1, len(RAMP)) if share <= RAMP[k][0] or k == len(RAMP) - 1)
    (begin, a), (end, b) = RAMP[at - 1], RAMP[at]
    k = (share - begin) / (end - begin)
    red, green, blue = (round(u + k * (v - u)) for u, v in zip(a, b, strict=True))
    return red, green, blue
