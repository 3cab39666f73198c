"""``train-ato view`` in a process of its own, and hands on its page in a headless Chromium."""

from __future__ import annotations

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

STARTING_S = 120.0
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
"""Widgets live in shadow roots: what is looked for is looked for in all of them."""


class View:
    """A running ``train-ato view``.

    Attributes
    ----------
    url : str
        What it printed.
    process : subprocess.Popen
    """

    def __init__(self, process: subprocess.Popen[str], lines: list[str]) -> None:
        self.process = process
        self.lines = lines
        self.url = lines[0]

    def end(self) -> int:
        """Send Ctrl-C and return the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=60)


@contextmanager
def viewing(*arguments: str, lines: int = 1) -> Iterator[View]:
    """Start the command on a free port, wait until it has printed so many lines, end it."""
    command = [sys.executable, "-m", "train_ato", "view", *arguments, "--port", "0", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        os.set_blocking(process.stdout.fileno(), False)
        printed, last = "", time.monotonic() + STARTING_S
        while printed.count("\n") < lines:
            with contextlib.suppress(BlockingIOError):
                printed += os.read(process.stdout.fileno(), 4096).decode()
            if process.poll() is not None or time.monotonic() > last:
                process.kill()
                raise AssertionError(f"no page: {process.stderr.read()}")
            time.sleep(0.05)
        yield View(process, printed.splitlines())
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


def opened(page: Page, url: str, frames: int = 3) -> None:
    """Open the live page and wait until it has drawn so often; a recorded run that stands is drawn once."""
    page.open(url, 1720, 1000)
    page.wait_for(f"window.trainAto && window.trainAto.frames >= {frames}")
    page.evaluate(_DEEP)


def text(page: Page, field: str) -> str:
    """Return what a field of the driver's display says."""
    return str(page.evaluate(f"document.querySelector('[data-from={field}]').textContent"))


def number(page: Page, field: str) -> float:
    """Return a number of the driver's display."""
    return float(text(page, field).split()[0])


def click(page: Page, label: str) -> None:
    """Click the button with a label, where it is."""
    button = f'deep(e => e.tagName == "BUTTON" && e.textContent.trim() == {json.dumps(label)})'
    page.wait_for(f"!!{button}")
    x, y = page.evaluate(
        f"(() => {{ const r = {button}.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2] }})()"
    )
    for kind, clicks in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 1)):
        page.mouse(kind, x, y, clicks)


def choose(page: Page, option: str) -> None:
    """Choose an option in the list that has it."""
    wanted = json.dumps(option)
    page.evaluate(
        f"""(() => {{
            const list = deep(e => e.tagName == "SELECT" && [...e.options].some(o => o.value == {wanted}));
            list.value = {wanted};
            list.dispatchEvent(new Event("change"));
        }})()"""
    )


def answer(page: Page, part: str) -> str:
    """Wait until the page says something that has a part, and return all of it."""
    page.wait_for(f'document.getElementById("answer").textContent.includes({json.dumps(part)})')
    return str(page.evaluate('document.getElementById("answer").textContent'))


def said_wrong(page: Page) -> list[str]:
    """Return what went wrong in the page."""
    return list(page.console)


def strangers(page: Page, url: str) -> list[str]:
    """Return the addresses that the page asked for and that are not its server's."""
    return [asked for asked in page.requests if not asked.startswith((url, "data:", "blob:"))]


__all__: list[str] = [
    "View", "answer", "choose", "click", "number", "opened", "said_wrong", "strangers", "text", "viewing",
]  # fmt: skip
