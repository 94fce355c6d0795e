# SPDX-License-Identifier: Apache-2.0
"""Messages of any bytes: decoded or counted, their text made safe for a terminal and a page."""

import math
import struct
import time
import unicodedata
from typing import Any, Final

from inertiad.run import estimate_message
from inertiad_lcm import estimate_t

TEXT_MAX: Final = 300
"""characters shown of any text"""


class Decoder:
    """Decodes messages; counts those that are none of their type."""

    def __init__(self) -> None:
        self.n_undecodable = 0

    def decode(self, kind: Any, data: bytes) -> Any | None:
        """The message; None, counted: it is no `kind` of this version."""
        try:
            return estimate_message.decode(data) if kind is estimate_t else kind.decode(data)
        except (ValueError, struct.error, IndexError, OverflowError, MemoryError):
            self.n_undecodable += 1
            return None


def plain(text: str, most: int = TEXT_MAX) -> str:
    """One line without control, format or unassigned characters: no escape reaches a terminal, no text turns around."""
    if text.isprintable():
        return text if len(text) <= most else text[:most] + "…"
    shown = "".join(
        " " if c in "\t\n" else "\N{REPLACEMENT CHARACTER}" if unicodedata.category(c)[0] == "C" else c
        for c in text[:most]
    )
    return shown + ("…" if len(text) > most else "")


def clock(t_ns: int) -> str:
    """Local time of day; "" for a stamp that no clock shows."""
    try:
        return time.strftime("%H:%M:%S", time.localtime(1e-9 * t_ns))
    except (OverflowError, ValueError, OSError):
        return ""


def finite(values: Any) -> bool:
    """True if every number is finite, and their sum."""
    return math.isfinite(sum(values))
