# SPDX-License-Identifier: Apache-2.0
"""The LCM network that daemon and tools meet on."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from inertiad.error import InputError

DEFAULT_URL: Final = "udpm://239.255.76.67:7667?ttl=0"
DEFAULT_PREFIX: Final = "INERTIAD_"
"""of channel names"""


@contextmanager
def _silent_library() -> Iterator[None]:
    """Keep what the C library itself writes to stderr from the terminal: the caller says it in one line."""
    sys.stderr.flush()
    kept = os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(sink)


def connect(url: str) -> Any:
    """An lcm.LCM. InputError if the URL is wrong or no interface carries multicast."""
    import lcm

    try:
        with _silent_library():
            return lcm.LCM(url)
    except RuntimeError:
        raise InputError(
            f"--lcm {url}: cannot open: allowed: an LCM URL; udpm needs a multicast route, "
            "for one machine: ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo"
        ) from None
