# SPDX-License-Identifier: Apache-2.0
"""Byte sources of a position instrument: UDP, TCP, a serial line, a growing file."""

import contextlib
import ipaddress
import os
import selectors
import socket
import time
from collections.abc import Callable
from typing import Any, Final, Protocol

from inertiad.base.error import InputError
from inertiad.live import lcm_network

SILENT: Final = 10.0
"""s without a byte after which a peer that was sending counts as hanging and is connected anew"""
START: Final = 60.0
"""the same for a peer that has not sent yet: an instrument waits for its operator"""
KEEPALIVE: Final = {socket.TCP_KEEPIDLE: 1, socket.TCP_KEEPINTVL: 1, socket.TCP_KEEPCNT: 3}
"""s, s, probes after which the kernel ends a connection whose other machine is gone, however long it may be silent"""
RETRY: Final = 0.5
"""s between attempts to connect"""
POLL: Final = 0.05


class Input(Protocol):
    """A source of bytes. receive() returns waiting bytes, [] after POLL s without any."""

    is_connected: bool
    n_connected: int
    n_foreign: int

    def receive(self) -> list[tuple[bytes, bool]]:
        """Pieces, each with whether it ends what came before it (datagram, connection)."""

    def close(self) -> None:
        """Let go."""


def _is_multicast(host: str) -> bool:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_multicast
    return False


class Udp:
    """Datagrams from the first sender heard; those of others are counted and left out. Joins a multicast address."""

    def __init__(self, host: str, port: int) -> None:
        self.is_connected, self.n_connected, self.n_foreign = False, 0, 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, lcm_network.RECEIVE_BUFFER)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(_is_multicast(host)))
        self._socket.bind((host, port))
        if _is_multicast(host):
            member = socket.inet_aton(host) + socket.inet_aton("0.0.0.0")  # noqa: S104 of the route, no address to bind
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        self._socket.settimeout(POLL)
        self._peer: Any = None

    def receive(self) -> list[tuple[bytes, bool]]:
        try:
            data, peer = self._socket.recvfrom(65536)
        except TimeoutError:
            return []
        if self._peer is None:
            self._peer, self.is_connected, self.n_connected = peer, True, 1
        if peer != self._peer:
            self.n_foreign += 1
            return []
        return [(data, True)]

    def close(self) -> None:
        self._socket.close()


def _kept_alive(link: socket.socket) -> socket.socket:
    link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in KEEPALIVE.items():
        link.setsockopt(socket.IPPROTO_TCP, option, value)
    return link


class Stream:
    """A connection that is made again whenever it ends or falls silent."""

    def __init__(self, connect: Callable[[], Any], can_hang: bool) -> None:
        self.is_connected, self.n_connected, self.n_foreign = False, 0, 0
        self._connect, self._can_hang = connect, can_hang
        self._peer: Any = None
        self._heard = self._tried = 0.0
        self._patience = START

    def _try(self) -> None:
        now = time.monotonic()
        if now - self._tried < RETRY:
            time.sleep(POLL)
            return
        self._tried = now
        with contextlib.suppress(OSError):
            self._peer = self._connect()
        if self._peer is not None:
            self._heard, self._patience, self.is_connected = time.monotonic(), START, True
            self.n_connected += 1

    def receive(self) -> list[tuple[bytes, bool]]:
        if self._peer is None:
            self._try()
            return []
        with selectors.DefaultSelector() as selector:
            selector.register(self._peer, selectors.EVENT_READ)
            if not selector.select(POLL):
                is_silent = self._can_hang and time.monotonic() - self._heard > self._patience
                return self._lose() if is_silent else []
        try:
            data = os.read(self._peer.fileno(), 65536)
        except OSError:
            data = b""
        if not data:
            return self._lose()
        self._heard, self._patience = time.monotonic(), SILENT
        return [(data, False)]

    def _lose(self) -> list[tuple[bytes, bool]]:
        self._peer.close()
        self._peer, self.is_connected = None, False
        return [(b"", True)]

    def close(self) -> None:
        if self._peer is not None:
            self._peer.close()


class Server(Stream):
    """A listening socket; one peer at a time."""

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.create_server((host, port))
        self._listener.settimeout(POLL)
        super().__init__(lambda: _kept_alive(self._listener.accept()[0]), can_hang=True)

    def close(self) -> None:
        super().close()
        self._listener.close()


class Tail:
    """A file that grows, from its beginning."""

    def __init__(self, path: str) -> None:
        self.is_connected, self.n_connected, self.n_foreign = True, 1, 0
        self._file = open(path, "rb")  # noqa: SIM115 - closed by close()

    def receive(self) -> list[tuple[bytes, bool]]:
        data = self._file.read(65536)
        if not data:
            time.sleep(POLL)
            return []
        return [(data, False)]

    def close(self) -> None:
        self._file.close()


ADDRESSES: Final = "udp:[HOST:]PORT, tcp:HOST:PORT, tcp-listen:[HOST:]PORT, serial:DEVICE[@BAUD], file:PATH"


def _serial(device: str, baud: int) -> Any:
    import serial

    return serial.Serial(device, baud, timeout=0)


def _host_port(place: str, address: str) -> tuple[str, int]:
    host, _, port = place.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"--from {address}: port: allowed: 1 to 65535")
    return host, int(port)


def open_input(address: str) -> Input:
    """An input by its address, see ADDRESSES. InputError: none of them, or it cannot be opened."""
    scheme, _, place = address.partition(":")
    try:
        match scheme:
            case "udp":
                return Udp(*_host_port(place, address))
            case "tcp":
                host, port = _host_port(place, address)
                peer = host or "127.0.0.1", port
                return Stream(lambda: _kept_alive(socket.create_connection(peer, timeout=RETRY)), can_hang=True)
            case "tcp-listen":
                return Server(*_host_port(place, address))
            case "serial":
                device, _, baud = place.partition("@")
                return Stream(lambda: _serial(device, int(baud or 115200)), can_hang=False)
            case "file":
                return Tail(place)
    except OSError as error:
        raise InputError(f"--from {address}: {error.strerror}") from None
    raise InputError(f"--from {address}: allowed: {ADDRESSES}")
