# SPDX-License-Identifier: Apache-2.0
"""Messages and channels of an MCAP file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from inertiad.base import extras
from inertiad.base.error import InputError


@contextmanager
def _mcap_guarded(path: Path) -> Iterator[None]:
    """InputError: what is read within is damaged."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # its reader and the compressions raise many unrelated types on damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a usable MCAP file: {reason}") from None


def mcap_messages(path: Path) -> Iterator[tuple[Any, Any, Any]]:
    """Schema, channel and message of each message, checksums checked. InputError: damaged."""
    make_reader = extras.load("mcap.reader", "mcap").make_reader
    with path.open("rb") as file, _mcap_guarded(path):
        yield from make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)


def mcap_channels(path: Path) -> list[Any]:
    """The file's channels. InputError: damaged."""
    make_reader = extras.load("mcap.reader", "mcap").make_reader
    with path.open("rb") as file, _mcap_guarded(path):
        summary = make_reader(file, validate_crcs=True).get_summary()
        if summary is not None and summary.channels:
            return list(summary.channels.values())
    return list({channel.id: channel for _, channel, _ in mcap_messages(path)}.values())
