# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium, driven over its DevTools protocol: open a page, ask it, look at it."""

import base64
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

PATIENCE = 120.0
"""s for a page to be drawn, on a busy machine"""
OPTIONS = (
    *("--headless=new", "--no-first-run", "--disable-gpu-sandbox", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--remote-debugging-port=0", "--hide-scrollbars"),
)


def program() -> str:
    """The browser. tools/setup installs it with the test packages."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    assert found, "no Chromium: tools/setup test installs it"
    return found


class Browser:
    """One page of a running browser. complaints: everything it logged as an error or threw, and every request."""

    def __init__(self, link: ClientConnection) -> None:
        self._link = link
        self._number = itertools.count(1)
        self.complaints: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        """Result of one DevTools command; events meanwhile are kept."""
        number = next(self._number)
        self._link.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._link.recv(timeout=PATIENCE))
            if message.get("id") == number:
                assert "error" not in message, f"{method}: {message['error']}"
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        match message.get("method"):
            case "Runtime.exceptionThrown":
                details = parameters["exceptionDetails"]
                self.complaints.append(details.get("exception", {}).get("description", details["text"]))
            case "Runtime.consoleAPICalled" if parameters["type"] in ("error", "assert"):
                self.complaints.append(" ".join(str(a.get("value", a)) for a in parameters["args"]))
            case "Log.entryAdded" if parameters["entry"]["level"] == "error":
                self.complaints.append(parameters["entry"]["text"])
            case "Network.requestWillBeSent":
                self.requests.append(parameters["request"]["url"])

    def ask(self, expression: str) -> Any:
        """Value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def show(self, width: int, height: int, theme: str = "light") -> None:
        """Size of the window, and the theme the reader asks for."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": theme}])

    def open(self, page: Path) -> None:
        """Open a file and wait until everything is drawn."""
        self.call("Page.navigate", url=page.resolve().as_uri())
        self.wait("document.documentElement?.dataset.drawn !== undefined")

    def wait(self, condition: str) -> None:
        """Until a JavaScript expression is true."""
        end = time.monotonic() + PATIENCE
        while not self.ask(condition):
            assert time.monotonic() < end, f"never: {condition}; {self.complaints}"
            time.sleep(0.05)

    def screenshot(self, path: Path) -> None:
        """The whole page as PNG."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}
        shot = self.call("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(shot["data"]))

    def print(self, path: Path) -> None:
        """The page on paper, as PDF."""
        printed = self.call("Page.printToPDF", printBackground=False, paperWidth=8.27, paperHeight=11.69)
        path.write_bytes(base64.b64decode(printed["data"]))


def drawings(page: Path) -> dict[str, Any]:
    """What a page hands to plotly.js, by figure."""
    text = (
        page.read_text(encoding="utf-8")
        .partition('id="drawings" type="application/json">')[2]
        .partition("</script>")[0]
    )
    found: dict[str, Any] = json.loads(text)
    return found


def _address(profile: Path) -> str:
    """DevTools address of the browser's only page."""
    from urllib.request import urlopen

    file, end = profile / "DevToolsActivePort", time.monotonic() + PATIENCE
    while not file.exists() or len(file.read_text().split()) < 2:
        assert time.monotonic() < end, "Chromium does not start"
        time.sleep(0.05)
    port = file.read_text().split()[0]
    pages = json.load(urlopen(f"http://127.0.0.1:{port}/json/list", timeout=PATIENCE))
    return str(next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page"))


@contextmanager
def browser() -> Iterator[Browser]:
    """A browser with a fresh profile, ended at the end."""
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program(), *OPTIONS, *sandbox, f"--user-data-dir={profile}", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            with connect(_address(Path(profile)), max_size=None) as link:
                yield Browser(link)
        finally:
            process.terminate()
            process.wait(timeout=PATIENCE)
