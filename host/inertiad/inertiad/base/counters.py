# SPDX-License-Identifier: Apache-2.0
"""Meaning of the daemon's counters: those of rejected rows, those that stay zero on a good run."""

from collections.abc import Mapping
from typing import Final

REJECTED: Final = (
    *("align.force.missing", "align.force.late", "align.position.missing", "align.position.late", "align.overrun"),
    *("align.imu.backwards", "align.imu.duplicate", "align.imu.not_finite", "align.imu.bad_quaternion"),
    *("pace.imu.dropped", "stuck.imu.refused", "clock.unsettled", "wrench.bad_geometry", "window.backwards"),
)
"""rows lost or refused, as the daemon's estimate.json adds them up"""

BAD: Final = (
    "dropped_by_kernel",
    "dropped_by_logger",
    "controller_overruns",
    "error_frames",
    "bad_stamp",
    "bad_name",
    "bad_id",
    "bad_data",
    "bad_tail",
    "too_long",
    "cut",
    "stray_stamp",
    "stray_time",
    "went_down",
    "bad_rows",
    "bad_length",
    "signal_not_finite",
    "signal_out_of_range",
    "incomplete",
    "lost",
    "counter_jumps",
    "duplicate_frames",
    "duplicate",
    "refused",
    "steps",
    "backwards",
    "restarts",
    "not_finite",
    "bad_quaternion",
    "overrun",
    "bad_geometry",
    "failed",
    "estimates_not_finite",
    "tracker_bad_message",
)
"""last parts of the names of those that stay zero on a good run, whatever bus or sensor they count for"""


def n_rejected(counters: Mapping[str, int]) -> int:
    """Rows lost or refused, all causes."""
    return sum(counters.get(name, 0) for name in REJECTED)


def is_bad(name: str) -> bool:
    """True if the counter stays zero on a good run."""
    return name.rpartition(".")[2] in BAD
