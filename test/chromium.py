"""Headless Chromium for tests, controlled over a pipe; no port is opened, and only the page is loaded."""

import base64
import contextlib
import json
import os
import select
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from waiting import LIMIT_S, LOOK_S, pause

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--no-first-run", "--hide-scrollbars", "--disable-dev-shm-usage", "--remote-debugging-pipe",
)  # fmt: skip


class Page:
    """One page: its console (warnings, errors, uncaught exceptions) and its requests (addresses)."""

    def __init__(self, reading: int, writing: int) -> None:
        self.console: list[str] = []
        self.requests: list[str] = []
        self._reading, self._writing = reading, writing
        self._rest = b""
        self._number = 0
        self._session: str | None = None
        self._loaded = False
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its result; earlier events are stored."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._writing, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return dict(answer["result"])
            self._note(answer)

    def _receive(self) -> dict[str, Any]:
        limit = time.monotonic() + LIMIT_S
        while b"\0" not in self._rest:
            if not select.select([self._reading], [], [], max(0.0, limit - time.monotonic()))[0]:
                raise TimeoutError("Chromium does not answer")
            part = os.read(self._reading, 1 << 20)
            if not part:
                raise RuntimeError("Chromium ended")
            self._rest += part
        text, self._rest = self._rest.split(b"\0", 1)
        return dict(json.loads(text))

    def _note(self, event: dict[str, Any]) -> None:
        method, told = event.get("method"), event.get("params", {})
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.console.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning", "assert"):
            self.console.append(" ".join(str(entry.get("value", "")) for entry in told["args"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.console.append(told["entry"]["text"])

    def open(self, address: str, width: int = 1400, height: int = 1000) -> None:
        """Load a page and wait for its completion."""
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self._loaded = False
        self.send("Page.navigate", url=address)
        while not self._loaded:
            self._note(self._receive())

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, awaited if it is a promise."""
        result = self.send("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in result:
            raise RuntimeError(result["exceptionDetails"].get("exception", {}).get("description", "failed"))
        found = result["result"]
        unfit = found.get("unserializableValue")  # of a number that JSON does not have: -0, NaN or an infinite one
        return found.get("value") if unfit is None else float(unfit)

    def wait_for(self, expression: str) -> Any:
        """Wait until an expression is true and return it."""
        limit = time.monotonic() + LIMIT_S
        while not (value := self.evaluate(expression)):
            if time.monotonic() > limit:
                raise TimeoutError(f"never true: {expression}; the page said {self.console}")
            pause(LOOK_S)
        return value

    def mouse(self, kind: str, x: float, y: float, clicks: int = 0) -> None:
        """Move, press or release (``mouseMoved``, ``mousePressed``, ``mouseReleased``) at a place of the window."""
        button = "none" if kind == "mouseMoved" and not clicks else "left"
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=clicks)

    def close(self) -> None:
        """Close the browser."""
        self._session = None
        with contextlib.suppress(RuntimeError, OSError):
            self.send("Browser.close")

    def screenshot(self, path: Path) -> None:
        """Write the content of the window as PNG."""
        path.write_bytes(base64.b64decode(self.send("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def browser() -> Iterator[Page]:
    """Start Chromium and yield an empty page; the test is skipped without Chromium."""
    program = next((found for name in PROGRAMS if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no Chromium here (looked for {', '.join(PROGRAMS)}); on Debian: apt-get install chromium")
    to_read, to_write = os.pipe(), os.pipe()
    with tempfile.TemporaryDirectory(prefix="train_ato_chromium_", ignore_cleanup_errors=True) as profile:
        quiet = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_RDWR, 0o600) for number in (1, 2)]
        process = os.posix_spawn(
            program,
            [program, *OPTIONS, f"--user-data-dir={profile}", "about:blank"],
            os.environ,
            file_actions=[(os.POSIX_SPAWN_DUP2, to_read[0], 3), (os.POSIX_SPAWN_DUP2, to_write[1], 4), *quiet],
            setpgroup=0,
        )
        os.close(to_read[0])
        os.close(to_write[1])
        try:
            page = Page(to_write[0], to_read[1])
            yield page
            page.close()
        finally:
            _end(process)
            os.close(to_read[1])
            os.close(to_write[0])


def _end(process: int) -> None:
    """Wait for the end of the browser, so that it writes no more into its folder; then kill it."""
    limit = time.monotonic() + 5.0
    while os.waitpid(process, os.WNOHANG) == (0, 0):
        if time.monotonic() > limit:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process, signal.SIGKILL)
            os.waitpid(process, 0)
            return
        pause(LOOK_S)
