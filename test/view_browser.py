"""``train-ato view`` in a separate process, with its page in a headless Chromium."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from chromium import Page
from programs import begun
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect
from waiting import LIMIT_S, LOOK_S, pause

_DEEP = """
window.deep = (test, root = document) => {
  for (const element of root.querySelectorAll("*")) {
    if (test(element)) return element;
    const inside = element.shadowRoot && window.deep(test, element.shadowRoot);
    if (inside) return inside;
  }
  return null;
};
window.model = (name) => Bokeh.documents[0].get_model_by_name(name);
true
"""
"""Search in all shadow roots, because every widget has its own."""


class View:
    """A running ``train-ato view`` with the lines of its output, the first of which is its address."""

    def __init__(self, process: subprocess.Popen[str], lines: list[str]) -> None:
        self.process, self.lines, self.url = process, lines, lines[0]

    def end(self) -> int:
        """Send Ctrl-C and return the exit status; errors of the command are printed."""
        self.process.send_signal(signal.SIGINT)
        status = self.process.wait(timeout=LIMIT_S)
        if status and self.process.stderr is not None:
            sys.stderr.write(self.process.stderr.read())
        return status


@contextmanager
def viewing(*arguments: str, lines: int = 1) -> Iterator[View]:
    """Start the command on a free port, wait for a number of output lines, stop it at the end."""
    process = begun("view", *arguments, "--port=0", "--no-browser")
    try:
        os.set_blocking(process.stdout.fileno(), False)
        printed, last = "", time.monotonic() + LIMIT_S
        while printed.count("\n") < lines:
            with contextlib.suppress(BlockingIOError):
                printed += os.read(process.stdout.fileno(), 4096).decode()
            if process.poll() is not None or time.monotonic() > last:
                process.kill()
                raise AssertionError(f"no page: {process.stderr.read()}")
            pause(LOOK_S)
        yield View(process, printed.splitlines())
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=LIMIT_S)
            except subprocess.TimeoutExpired:
                process.kill()
        process.stdout.close()
        process.stderr.close()


def opened(page: Page, url: str, frames: int = 3) -> None:
    """Open the page and wait for a number of frames; a paused recorded run draws one."""
    page.open(url, 1720, 1000)
    page.wait_for(f"window.trainAto && window.trainAto.frames >= {frames}")
    page.evaluate(_DEEP)


def text(page: Page, field: str) -> str:
    """Return the text of a field of the driver's display."""
    return str(page.evaluate(f"document.querySelector('[data-from={field}]').textContent"))


def number(page: Page, field: str) -> float:
    """Return a number of the driver's display."""
    return float(text(page, field).split()[0])


def click(page: Page, label: str) -> None:
    """Click the button with a label, at its position."""
    button = f'deep(e => e.tagName == "BUTTON" && e.textContent.trim() == {json.dumps(label)})'
    page.wait_for(f"!!{button}")
    x, y = page.evaluate(
        f"(() => {{ const r = {button}.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2] }})()"
    )
    for kind, clicks in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 1)):
        page.mouse(kind, x, y, clicks)


def choose(page: Page, option: str) -> None:
    """Select an option in its list."""
    wanted = json.dumps(option)
    found = f'deep(e => e.tagName == "SELECT" && [...e.options].some(o => o.value == {wanted}))'
    page.evaluate(f'(list => {{ list.value = {wanted}; list.dispatchEvent(new Event("change")); }})({found})')


def answer(page: Page, part: str) -> str:
    """Wait for an answer on the page that contains a text; return the answer."""
    page.wait_for(f'document.getElementById("answer").textContent.includes({json.dumps(part)})')
    return str(page.evaluate('document.getElementById("answer").textContent'))


def strangers(page: Page, url: str) -> list[str]:
    """Return the addresses requested by the page from other servers."""
    return [asked for asked in page.requests if not asked.startswith((url, "data:", "blob:"))]


async def connects(url: str, origin: str | None, *protocols: str, host: str = "") -> bool:
    """Return True if a WebSocket is accepted."""
    headers = ({} if origin is None else {"Origin": origin}) | ({"Host": host} if host else {})
    try:
        (await websocket_connect(HTTPRequest(url, headers=headers), subprotocols=list(protocols))).close()
    except HTTPClientError as error:
        assert error.code == 403
        return False
    return True
