# SPDX-License-Identifier: Apache-2.0
"""LCM logs, read up to their first damage: a log cut off in the middle of a record stays readable up to there.

A record: sync word EDA1DA01, event number u64, stamp [us] u64, lengths of channel and data u32 each, channel, data;
big-endian.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

from inertiad.base.error import InputError
from inertiad.run import estimate_message
from inertiad_lcm import estimate_t

HEAD: Final = struct.Struct(">IQQII")
SYNC: Final = 0xEDA1DA01
CHANNEL_MAX: Final = 63
DATA_MAX: Final = 1 << 28
"""bytes; a length beyond this is damage"""


@dataclass(frozen=True)
class Event:
    """One message of a log."""

    number: int
    t_us: int
    """host time at which it was logged, us"""
    channel: str
    data: bytes


def _next(file: BinaryIO) -> Event | None:
    """The next record; None at the end. ValueError: it is damaged."""
    head = file.read(HEAD.size)
    if not head:
        return None
    if len(head) < HEAD.size:
        raise ValueError("cut off in the middle of a record")
    sync, number, t_us, n_channel, n_data = HEAD.unpack(head)
    if sync != SYNC or n_channel > CHANNEL_MAX or n_data > DATA_MAX:
        raise ValueError("no record begins here")
    body = file.read(n_channel + n_data)
    if len(body) < n_channel + n_data:
        raise ValueError("cut off in the middle of a record")
    return Event(number, t_us, body[:n_channel].decode(errors="replace"), body[n_channel:])


def read(path: Path, remarks: list[str] | None = None) -> Iterator[Event]:
    """Every message up to the end or to the first damage, which remarks name in one line."""
    with path.open("rb") as file:
        n = 0
        while True:
            at = file.tell()
            try:
                event = _next(file)
            except ValueError as error:
                if remarks is not None:
                    remarks.append(f"{path}: byte {at}: {error}; {n} messages before it were read")
                return
            if event is None:
                return
            yield event
            n += 1


def decode(kind: Any, event: Event, path: Path | str) -> Any:
    """The message of an event; an ESTIMATE may be of an earlier version. InputError: of a type that is not known."""
    try:
        return estimate_message.decode(event.data) if kind is estimate_t else kind.decode(event.data)
    except (ValueError, struct.error, IndexError):
        raise InputError(
            f"{path}: message {event.number} on {event.channel} is no {kind.__name__} of this version; "
            "read the log with the version that wrote it"
        ) from None


class Writer:
    """Write records; records that could not be written (disk full) are counted, and reported once by the caller."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.n_events = 0
        self.n_failed = 0
        self.error = ""
        self._file = path.open("wb", buffering=1 << 20)

    def write(self, t_us: int, channel: str, data: bytes) -> None:
        """Append one message. Never raises: a full disk must not stop the recording of the rest."""
        name = channel.encode()
        head = HEAD.pack(SYNC, self.n_events, t_us, len(name), len(data))
        try:
            self._file.write(head + name + data)
            self.n_events += 1
        except OSError as error:
            self.n_failed += 1
            self.error = error.strerror or str(error)

    def flush(self) -> None:
        """Hand everything to the kernel."""
        try:
            self._file.flush()
        except OSError as error:
            self.error = error.strerror or str(error)

    def close(self) -> None:
        """Flush and close."""
        try:
            self._file.close()
        except OSError as error:
            self.error = error.strerror or str(error)
