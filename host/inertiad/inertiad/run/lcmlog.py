# SPDX-License-Identifier: Apache-2.0
"""LCM logs. A log cut off in the middle of a record stays readable up to there; damage is found by checksums.

A record: sync word EDA1DA01, event number u64, stamp [us] u64, lengths of channel and data u32 each, channel, data;
big-endian. A record on CHECK covers the records since the one before it: its own number and stamp, the place of the
first byte covered, u64 each, and the CRC-32 of the bytes from there to itself, u32.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
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


CHECK: Final = "INERTIAD_CHECK"
"""channel of the checksums that the daemon and `inertiactl record` write; no daemon publishes on it"""
_CHECK: Final = struct.Struct(">QQQI")
_CHECK_EACH: Final = 1 << 18
"""bytes that a checksum of Writer covers"""
_UNCHECKED_MAX: Final = 1 << 24
"""bytes after which a log without a checksum is one of another program"""


@dataclass(frozen=True)
class Event:
    """One message of a log."""

    number: int
    t_us: int
    """host time at which it was logged, us"""
    channel: str
    data: bytes


@dataclass
class _Block:
    """Messages that the next checksum covers."""

    begin: int = 0
    """byte of the file"""
    crc: int = 0
    events: list[Event] = field(default_factory=list)


def _next(file: BinaryIO, block: _Block) -> Event | None:
    """The next record, its bytes in block.crc unless it is a checksum; None at the end. ValueError: it is damaged."""
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
    event = Event(number, t_us, body[:n_channel].decode(errors="replace"), body[n_channel:])
    if event.channel != CHECK:
        block.crc = zlib.crc32(body, zlib.crc32(head, block.crc))
    return event


class _Reader:
    """Records of a log, each block of them once its checksum is known to be right."""

    def __init__(self, path: Path, remarks: list[str]) -> None:
        self.path = path
        self._remarks = remarks
        self._is_checked: bool | None = None
        """None: not known yet"""
        self._n = 0

    def _remark(self, text: str) -> None:
        self._remarks.append(f"{self.path}: {text}; {self._n} messages before it were read")

    def _judge(self, event: Event, block: _Block, at: int) -> bool:
        """Does a checksum that begins at byte `at` say that its block is whole?"""
        if len(event.data) != _CHECK.size:
            return False
        number, t_us, begin, crc = _CHECK.unpack(event.data)
        if self._is_checked is None:  # one that was copied from another log fits none of its own fields
            self._is_checked = (number, t_us) == (event.number, event.t_us) or (begin, crc) == (block.begin, block.crc)
        if not self._is_checked:
            return True
        return (number, t_us, begin, crc) == (event.number, event.t_us, block.begin, block.crc)

    def _release(self, block: _Block, is_whole: bool, end: int) -> Iterator[Event]:
        if is_whole:
            yield from block.events
            self._n += len(block.events)
        else:
            self._remark(
                f"bytes {block.begin} to {end} are damaged, their checksum differs: "
                f"{len(block.events)} messages are left out"
            )

    def read(self, file: BinaryIO) -> Iterator[Event]:
        """Every message but the checksums."""
        block = _Block()
        while True:
            at = file.tell()
            try:
                event = _next(file, block)
            except ValueError as error:
                yield from self._release(block, True, at)
                self._remark(f"byte {at}: {error}")
                return
            if event is None:
                break
            if event.channel != CHECK:
                block.events.append(event)
                if self._is_checked is False or (self._is_checked is None and at - block.begin > _UNCHECKED_MAX):
                    self._is_checked = False
                    yield from self._release(block, True, at)
                    block.events.clear()
                continue
            yield from self._release(block, self._judge(event, block, at), at)
            block = _Block(file.tell())
        yield from self._release(block, True, at)
        if block.events and self._is_checked:
            last = f"the last {len(block.events)} of {self._n} messages have no checksum"
            self._remarks.append(f"{self.path}: cut off: {last}")


def read(path: Path, remarks: list[str] | None = None) -> Iterator[Event]:
    """Every message up to the end or to the first record that is none.

    Messages whose checksum differs are left out. remarks: what is damaged, a line each. A log without checksums, of an
    earlier version or another program, is read as it is.
    """
    with path.open("rb") as file:
        yield from _Reader(path, [] if remarks is None else remarks).read(file)


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
    """Write records and their checksums; what could not be written (disk full) is counted for the caller."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.n_events = 0
        self.n_failed = 0
        self.error = ""
        self._file = path.open("wb", buffering=1 << 20)
        self._number = self._at = self._checked = self._crc = self._t_us = 0

    def _append(self, t_us: int, channel: str, data: bytes) -> None:
        """OSError: not written, or not whole."""
        name = channel.encode()
        record = HEAD.pack(SYNC, self._number, t_us, len(name), len(data)) + name + data
        self._file.write(record)
        self._at += len(record)
        self._crc = zlib.crc32(record, self._crc)
        self._t_us = t_us
        self._number += 1

    def _check(self) -> None:
        """A checksum of what was written since the last one."""
        if self._at == self._checked:
            return
        self._append(self._t_us, CHECK, _CHECK.pack(self._number, self._t_us, self._checked, self._crc))
        self._checked, self._crc = self._at, 0

    def write(self, t_us: int, channel: str, data: bytes) -> None:
        """Append one message. Never raises: a full disk must not stop the recording of the rest."""
        try:
            self._append(t_us, channel, data)
            self.n_events += 1
            if self._at - self._checked >= _CHECK_EACH:
                self._check()
        except OSError as error:
            self.n_failed += 1
            self.error = error.strerror or str(error)

    def flush(self) -> None:
        """Hand everything to the kernel."""
        try:
            self._check()
            self._file.flush()
        except OSError as error:
            self.error = error.strerror or str(error)

    def close(self) -> None:
        """Flush and close."""
        self.flush()
        try:
            self._file.close()
        except OSError as error:
            self.error = error.strerror or str(error)
