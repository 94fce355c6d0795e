# SPDX-License-Identifier: Apache-2.0
"""header.json of a run: host, time and command of the recording, and the synchronisation of that host's clock.

The kernel's own view (adjtimex) is always there, whoever disciplines the clock: chrony, ntpd, phc2sys, nobody. What
chronyc and pmc (linuxptp) say comes beside it where they are installed and answer.
"""

import ctypes
import json
import platform
import shutil
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from inertiad.base.text_files import read_json

NAME: Final = "header.json"
PATIENCE: Final = 2.0
"""s to wait for chronyc and pmc"""
TIME_ERROR: Final = 5
STA_UNSYNC: Final = 0x40


class _Timex(ctypes.Structure):
    """struct timex of Linux, as far as it is read here."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 256),
    )


def _kernel() -> dict[str, Any]:
    timex = _Timex()
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    is_synchronised = state not in (-1, TIME_ERROR) and not timex.status & STA_UNSYNC
    return {
        "synchronised": is_synchronised,
        "error_max_s": 1e-6 * timex.maxerror,
        "error_estimated_s": 1e-6 * timex.esterror,
    }


def _output(*command: str) -> str:
    """stdout of a program; "" where it is missing, fails or hangs."""
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    except (subprocess.SubprocessError, OSError):
        return ""
    return done.stdout


def _chrony() -> dict[str, Any] | None:
    cells = _output("chronyc", "-c", "tracking").strip().split(",")
    if len(cells) < 14:
        return None
    offset, rms, delay, dispersion = (float(cells[k]) for k in (4, 6, 10, 11))
    return {
        "reference": cells[1],
        "stratum": int(cells[2]),
        "offset_s": offset,
        "offset_rms_s": rms,
        "error_max_s": abs(offset) + dispersion + 0.5 * delay,
        "state": cells[13],
    }


def _ptp() -> dict[str, Any] | None:
    words = _output("pmc", "-u", "-b", "0", "GET TIME_STATUS_NP").split()
    found = dict(pairwise(words))
    if "master_offset" not in found:
        return None
    return {
        "offset_s": 1e-9 * float(found["master_offset"]),
        "master_present": found.get("gmPresent") == "true",
        "master": found.get("gmIdentity", ""),
    }


def clock() -> dict[str, Any]:
    """Synchronisation of this host's clock, s. Keys kernel and, where they answer, chrony and ptp."""
    found: dict[str, Any] = {"kernel": _kernel()}
    for name, state in (("chrony", _chrony()), ("ptp", _ptp())):
        if state is not None:
            found[name] = state
    return found


def describe() -> dict[str, Any]:
    """Contents of header.json."""
    return {
        "host": platform.node(),
        "kernel": platform.release(),
        "command": sys.argv,
        "started_ns": time.time_ns(),
        "clock": clock(),
    }


def write(run: Path) -> None:
    """Write RUN/header.json."""
    (run / NAME).write_text(json.dumps(describe(), indent=1) + "\n", encoding="utf-8")


def clock_in_words(run: Path) -> tuple[bool, str]:
    """Whether the recording host's clock was synchronised, and its state as text. InputError: an unusable header."""
    path = run / NAME
    if not path.exists():
        return False, f"no {NAME}: the run does not say how its host's clock was kept"
    header = read_json(path)
    state = header.get("clock", {})
    kernel, chrony, ptp = (state.get(name, {}) for name in ("kernel", "chrony", "ptp"))
    parts = []
    if chrony:
        parts.append(f"chrony from {chrony['reference']}, {1e6 * chrony['offset_rms_s']:.0f} us rms")
    if ptp:
        present = "" if ptp["master_present"] else ", no master"
        parts.append(f"PTP, {1e6 * ptp['offset_s']:.1f} us off its master{present}")
    good = bool(kernel.get("synchronised"))
    bound = min([s["error_max_s"] for s in (kernel, chrony) if "error_max_s" in s], default=float("inf"))
    parts.append(f"error at most {1e3 * bound:.2f} ms" if good else "not synchronised, by the kernel's account")
    return good, f"{header.get('host', '?')}: {'; '.join(parts)}"
