# SPDX-License-Identifier: Apache-2.0
"""Judgement of counters: which mean a lost sample, which must be 0 on a good run.

The pipeline's own come from the table in firmware/core/counter_table.h; those of buses, recorder and network, which
the daemon adds, are judged by their cause, the last part of the name.
"""

from collections.abc import Mapping
from typing import Final

import inertiad_core

PIPELINE: Final = {counter["name"]: counter for counter in inertiad_core.counter_table()}
REJECTED: Final = tuple(name for name, counter in PIPELINE.items() if counter["is_rejected"])
"""counters of rows lost or refused, as the daemon's estimate.json adds them up"""

BAD_CAUSES: Final = (
    *("dropped_by_kernel", "dropped_by_logger", "controller_overruns", "error_frames", "went_down"),
    *("bad_stamp", "bad_name", "bad_id", "bad_data", "bad_tail", "too_long", "cut", "stray_stamp", "stray_time"),
    *(
        "bad_frame",
        "bad_position",
        "bad_command",
        "bad_time",
        "bad_rows",
        "lost",
        "refused",
        "failed",
        "estimates_not_finite",
        "tracker_bad_message",
    ),
)
"""causes of the daemon's other counters that must be zero on a good run"""


def n_rejected(counters: Mapping[str, int]) -> int:
    """Rows lost or refused, all causes."""
    return sum(counters.get(name, 0) for name in REJECTED)


def is_bad(name: str) -> bool:
    """True if the counter of this name is 0 on a good run."""
    counter = PIPELINE.get(name)
    return bool(counter["is_bad"]) if counter else name.rpartition(".")[2] in BAD_CAUSES


def is_loss(name: str) -> bool:
    """True if the counter counts what is lost or refused, for any cause but a clock or tilt that settles."""
    cause = name.rpartition(".")[2]
    return cause != "unsettled" and (is_bad(name) or name in REJECTED or cause in ("late", "missing"))
