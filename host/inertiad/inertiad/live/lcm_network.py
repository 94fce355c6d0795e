# SPDX-License-Identifier: Apache-2.0
"""Connections to the LCM network."""

import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final
from urllib.parse import parse_qs

from inertiad.base.channels import GROUP, PORT
from inertiad.base.error import InputError

QUEUE: Final = 200_000
"""messages that may wait in a listener"""
RECEIVE_BUFFER: Final = 8_000_000
"""bytes that may wait in the kernel for a listener"""
ROUTE: Final = "with a multicast route, for one machine: ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo"


@contextmanager
def _silent_library() -> Iterator[None]:
    """Keep the C library's own stderr from the terminal: the caller reports the error in one line."""
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


def connect(url: str, parameters: str = "") -> Any:
    """An lcm.LCM. parameters: added to the URL. InputError if it is wrong or no interface carries multicast."""
    import lcm

    try:
        with _silent_library():
            return lcm.LCM(f"{url}{'&' if '?' in url else '?'}{parameters}" if parameters else url)
    except RuntimeError:
        raise InputError(f"--lcm {url}: cannot open: allowed: an LCM URL; udpm only {ROUTE}") from None


def handle(link: Any, wait_ms: int) -> None:
    """Hand out the messages of an lcm.LCM that come within wait_ms; one whose channel is no text is left out."""
    with suppress(UnicodeDecodeError):
        link.handle_timeout(wait_ms)


class Listener(threading.Thread):
    """Hands every message whose channel matches a regular expression to take(channel, data), in a thread of its own.

    With queues raised, so that bursts are not lost. InputError: see connect().
    """

    def __init__(self, url: str, channels: str, take: Callable[[str, bytes], None]) -> None:
        super().__init__(daemon=True)
        self._is_over = threading.Event()
        self._link = connect(url, f"recv_buf_size={RECEIVE_BUFFER}")
        self._link.subscribe(channels, take).set_queue_capacity(QUEUE)

    def run(self) -> None:
        while not self._is_over.is_set():
            handle(self._link, 50)

    def stop(self) -> None:
        """Take nothing more; back once the thread has ended."""
        self._is_over.set()
        self.join()


def udp_of(url: str) -> tuple[str, int, int]:
    """Address, port and time to live of an LCM URL. InputError: not udpm."""
    scheme, _, rest = url.partition("://")
    place, _, query = rest.partition("?")
    host, _, port = place.partition(":")
    try:
        socket.inet_aton(host or GROUP)
        ttl = int(parse_qs(query).get("ttl", ["0"])[0])
        if scheme != "udpm" or not 0 <= ttl <= 255:
            raise ValueError
        return host or GROUP, int(port or PORT), ttl
    except (ValueError, OSError):
        raise InputError(f"--lcm {url}: allowed: udpm://ADDRESS:PORT?ttl=N") from None


def udp_socket(url: str) -> socket.socket:
    """A UDP socket that sends to an LCM network. InputError: not udpm, or no interface carries multicast."""
    host, port, ttl = udp_of(url)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, ttl)
    try:
        link.connect((host, port))
    except OSError as error:
        link.close()
        raise InputError(f"--lcm {url}: {error.strerror}: allowed: {ROUTE}; or without: --tracker none") from None
    return link
