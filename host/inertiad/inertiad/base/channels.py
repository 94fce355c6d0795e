# SPDX-License-Identifier: Apache-2.0
"""Defaults of the LCM network and of channel names, for daemon and tools."""

from typing import Final

GROUP: Final = "239.255.76.67"
PORT: Final = 7667
DEFAULT_URL: Final = f"udpm://{GROUP}:{PORT}?ttl=0"
DEFAULT_PREFIX: Final = "INERTIAD_"
"""of channel names"""
