# SPDX-License-Identifier: Apache-2.0
"""The HTTP server of the live page: three files, a stream of server-sent events, and commands where they are allowed.

A command must carry the token that only the page has, and come from the page's own origin; every request must name this
server as its host, so that no other name that resolves to it gives another site a way in.
"""

import ipaddress
import json
import secrets
import socket
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, Final

from inertiad.base.error import InputError
from inertiad.live.feed import NONE_SEEN, Feed

STREAMS_MAX: Final = 32
BODY_MAX: Final = 4096
"""bytes of a request"""
STALL: Final = 10.0
"""s after which a browser that takes nothing is dropped"""
HEARTBEAT: Final = 2.0
"""s of silence after which a stream shows that it lives"""
COMMANDS: Final = ("freeze", "resume", "reset", "tare", "mark")
TYPES: Final = {
    "page.html": "text/html; charset=utf-8",
    "page.css": "text/css; charset=utf-8",
    "view3d.js": "text/javascript; charset=utf-8",
    "charts.js": "text/javascript; charset=utf-8",
    "page.js": "text/javascript; charset=utf-8",
}
HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
Command = Callable[[str, str | None], tuple[bool, str]]
"""name and text of a command -> whether it was done, and the answer"""


def is_loopback(host: str) -> bool:
    """True if nothing but this machine reaches the address."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = STALL
    server: "LiveServer"

    def log_message(self, format: str, *arguments: Any) -> None:
        """Requests are no news."""

    def _answer(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        for name, value in (HEADERS | {"Content-Type": kind, "Content-Length": str(len(body))}).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _refuse(self, status: HTTPStatus, why: str) -> None:
        self.close_connection = True  # a body that was not read would be taken for the next request
        self._answer(status, "text/plain; charset=utf-8", f"{why}\n".encode())

    def _is_for_us(self) -> bool:
        return self.server.hosts is None or self.headers.get("Host", "").lower() in self.server.hosts

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        name = "page.html" if path == "/" else path.removeprefix("/")
        if not self._is_for_us():
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST, "this server has another name")
        elif path == "/events":
            self._stream()
        elif name in TYPES:
            self._answer(HTTPStatus.OK, TYPES[name], self.server.page[name])
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "not here")

    def _stream(self) -> None:
        if not self.server.streams.acquire(blocking=False):
            return self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, f"{STREAMS_MAX} pages are open; close one")
        try:
            self.send_response(HTTPStatus.OK)
            for name, value in (HEADERS | {"Content-Type": "text/event-stream", "Connection": "close"}).items():
                self.send_header(name, value)
            self.end_headers()
            self.close_connection = True
            self.wfile.write(b"retry: 1000\n\n")
            seen = NONE_SEEN
            while not self.server.is_over.is_set():
                text, last = self.server.feed.since(seen, HEARTBEAT)
                self.wfile.write(b": alive\n\n" if last == seen else b"data: " + text.encode() + b"\n\n")
                seen = last
        except OSError:
            pass  # the browser has gone, or takes nothing
        finally:
            self.server.streams.release()

    def do_POST(self) -> None:
        wanted, given = self.server.token, self.headers.get("X-Token", "")
        origin = self.headers.get("Origin")
        if not self._is_for_us() or self.path != "/command" or self.server.execute is None:
            self._refuse(HTTPStatus.NOT_FOUND, "not here")
        elif not secrets.compare_digest(wanted.encode(), given.encode()):
            self._refuse(HTTPStatus.FORBIDDEN, "the page's token is missing; reload the page")
        elif origin is not None and origin not in self.server.origins:
            self._refuse(HTTPStatus.FORBIDDEN, "from another site")
        elif not self.headers.get("Content-Length", "").isdigit() or int(self.headers["Content-Length"]) > BODY_MAX:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"at most {BODY_MAX} bytes")
        else:
            self._command(self.rfile.read(int(self.headers["Content-Length"])))

    def _command(self, body: bytes) -> None:
        try:
            asked = json.loads(body)
            name, text = asked["name"], asked.get("text")
            if name not in COMMANDS or not isinstance(text, str | None):
                raise ValueError
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return self._refuse(HTTPStatus.BAD_REQUEST, f"allowed: {', '.join(COMMANDS)}")
        assert self.server.execute is not None
        try:
            done, answer = self.server.execute(name, text)
        except InputError as error:
            done, answer = False, str(error)
        self._answer(HTTPStatus.OK, "application/json", json.dumps({"done": done, "answer": answer}).encode())


class LiveServer(ThreadingHTTPServer):
    """Serves a Feed to any number of browsers, each in a thread of its own. is_over ends their streams."""

    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = 64

    def __init__(self, host: str, port: int, feed: Feed, execute: Command | None) -> None:
        """execute: None where commands are not allowed. InputError: the address cannot be used."""
        self.feed, self.is_over, self.streams = feed, threading.Event(), threading.BoundedSemaphore(STREAMS_MAX)
        self.execute = execute if is_loopback(host) else None
        self.token = secrets.token_urlsafe(24)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"--host {host} --port {port}: {reason}; choose another, --port 0: any free one") from None
        names = {f"{name}:{self.server_port}" for name in ("localhost", "127.0.0.1", "[::1]", self._bracketed(host))}
        self.hosts = names if is_loopback(host) else None
        self.origins = {f"http://{name}" for name in names}
        self.page = self._files()

    @staticmethod
    def _bracketed(host: str) -> str:
        return f"[{host}]" if ":" in host else host

    @property
    def url(self) -> str:
        """Of the page."""
        return f"http://{self._bracketed(str(self.server_address[0]))}:{self.server_port}/"

    def _files(self) -> dict[str, bytes]:
        here = files("inertiad.live") / "page"
        found = {name: (here / name).read_bytes() for name in TYPES}
        token = self.token if self.execute is not None else ""
        found["page.html"] = found["page.html"].replace(b"@TOKEN@", token.encode())
        return found

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away in the middle of a request is no news."""
