"""The live page in a real browser: it draws, follows the train, and what is done on it reaches the running nodes."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from pathlib import Path

import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

pytest.importorskip("rclpy")

from chromium import browser
from view_browser import (
    answer,
    choose,
    click,
    number,
    opened,
    said_wrong,
    strangers,
    text,
    viewing,
)

from train_ato.engine import run_engine
from train_ato.graph.environment import held_domains
from train_ato.run_folder import RunFolder
from train_ato.run_setup import prepare
from train_ato.scenario import load

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """Record the first three minutes of the demo."""
    setup = prepare(*load("demo", ("duration=180", "swaps=[{at: 100, controller: smc}]")))
    folder = RunFolder.make(tmp_path_factory.mktemp("recorded") / "run", "demo")
    folder.begin(setup)
    with folder.sink(setup) as sink:
        outcome = run_engine(setup, sink=sink)
    folder.finish(setup, outcome)
    return folder.path


def clock_of(page) -> float:
    hours, minutes, seconds = text(page, "clock_text").split(":")
    return 3600 * int(hours) + 60 * int(minutes) + float(seconds)


def wait_until(condition, limit=60.0):
    """Wait for a condition; return whether it came true."""
    last = time.monotonic() + limit
    while not condition():
        if time.monotonic() > last:
            return False
        time.sleep(0.1)
    return True


@pytest.mark.timeout(600)
def test_a_train_is_watched_and_acted_on(tmp_path):
    """Breaks if the page does not draw, does not follow, or a button does not reach the node or hides its refusal."""
    folder = tmp_path / "run"
    with browser() as page, viewing("--scenario", "demo", "--pace", "10", "--out", str(folder)) as view:
        opened(page, view.url)
        assert wait_until(lambda: clock_of(page) > 100.0), "the train does not move"
        assert number(page, "place_text") > 0.0
        drawn = page.evaluate("model('now').data.speed_angle[0]")
        points = page.evaluate("model('strip_error').renderers[3].data_source.get_length()")
        assert wait_until(lambda: page.evaluate("model('now').data.speed_angle[0]") != drawn), "the needle stands still"
        assert wait_until(
            lambda: page.evaluate("model('strip_error').renderers[3].data_source.get_length()") > points
        ), "the strip charts stand still"
        coupler = page.evaluate("Math.max(...model('along').renderers[0].data_source.data.coupler)")
        assert coupler > 100.0

        before = abs(number(page, "error_text"))
        page.evaluate("model('gust.acceleration').value = -0.04; model('gust.acceleration').value_throttled = -0.04")
        answer(page, "gust.acceleration = -0.04")
        click(page, "gust")
        assert "gust: acceleration -0.04" in answer(page, "gust: ")
        assert wait_until(lambda: number(page, "error_text") < -0.3 - before), "the gust is not seen in the error"

        choose(page, "smc")
        assert wait_until(lambda: text(page, "law") == "smc"), "the law is not swapped"
        page.wait_for("!!model('smc.l1')")
        page.evaluate("model('smc.l1').value_throttled = 1.5")
        answer(page, "smc.l1 = 1.5")
        choose(page, "fixed_time_smc")
        refused = answer(page, "fixed_time_smc") if text(page, "law") != "fixed_time_smc" else ""
        choose(page, "pid")
        assert wait_until(lambda: text(page, "law") == "pid"), refused

        click(page, "pause")
        page.wait_for("document.body.dataset.state == 'paused'")
        time.sleep(0.5)
        standing = clock_of(page)
        click(page, "step")
        assert wait_until(lambda: clock_of(page) == pytest.approx(standing + 0.1)), "a step is not one tick"

        click(page, "EMERGENCY BRAKE")
        answer(page, "emergency brake applied")
        click(page, "step")
        page.wait_for("document.body.dataset.state == 'emergency brake'")
        click(page, "release the emergency brake")
        assert "standstill only; the train runs" in answer(page, "released at standstill")
        page.screenshot(tmp_path / "page.png")
        assert (tmp_path / "page.png").stat().st_size > 50_000
        click(page, "resume")
        assert wait_until(lambda: abs(page.evaluate("model('where').data.speed[0]")) < 0.01), (
            "the emergency brake does not stop the train"
        )
        assert number(page, "pipe_text") == 101
        click(page, "release the emergency brake")
        page.wait_for("document.body.dataset.state == 'running'")
        assert said_wrong(page) == []
        assert strangers(page, view.url) == []
        assert view.end() == 0
    assert held_domains() == [] or (folder / "run.mcap").is_file()
    told = {row["name"]: row for row in json.loads((folder / "summary.json").read_text())["changes"]}
    assert {"gust", "emergency_brake", "controller", "smc.l1"} <= set(told)
    assert told["gust"]["value"]["acceleration"] == -0.04


def test_a_recorded_run_is_played(recorded, tmp_path):
    """Breaks if the slider, play and pause or the list of events do not move the page, or the browser complains."""
    with browser() as page, viewing(str(recorded)) as view:
        opened(page, view.url, frames=1)
        assert text(page, "clock_text") == "0:00:00.0"
        page.evaluate("model('time').value = 120.04")
        assert wait_until(lambda: clock_of(page) == 120.0)
        assert text(page, "law") == "smc"
        page.evaluate("model('events').value = ['0']")
        assert wait_until(lambda: clock_of(page) == 100.0), "an event is not gone to"
        choose(page, "20 ×")
        click(page, "play")
        assert wait_until(lambda: clock_of(page) > 130.0), "time does not go on"
        click(page, "pause")
        page.wait_for("!!deep(e => e.tagName == 'BUTTON' && e.textContent.trim() == 'play')")
        time.sleep(0.5)
        standing = clock_of(page)
        click(page, "◀ tick")
        assert wait_until(lambda: clock_of(page) == pytest.approx(standing - 0.1))
        inside = page.evaluate("(() => { const s = model('strip_speed'); return [s.x_range.start, s.x_range.end] })()")
        assert inside[0] < standing < inside[1]
        page.screenshot(tmp_path / "recorded.png")
        assert said_wrong(page) == []
        assert strangers(page, view.url) == []
        assert view.end() == 0


def test_two_browsers_see_the_same(recorded):
    """Breaks if each browser has a time of its own, or the second one gets nothing."""
    with browser() as one, browser() as other, viewing(str(recorded)) as view:
        for page in (one, other):
            opened(page, view.url, frames=1)
        one.evaluate("model('time').value = 66.0")
        assert wait_until(lambda: clock_of(other) == 66.0)


async def handshake(address: str, origin: str) -> bool:
    """Tell whether a page of an origin gets a WebSocket."""
    try:
        connection = await websocket_connect(
            HTTPRequest(address, headers={"Origin": origin}), subprotocols=["bokeh", "no token"]
        )
    except HTTPClientError as error:
        assert error.code == 403
        return False
    connection.close()
    return True


def test_pages_of_other_origins_are_refused(recorded):
    """Breaks if any page in the user's browser may talk to the train, or the server listens beyond this machine."""
    with viewing(str(recorded)) as view:
        port = int(view.url.rstrip("/").rpartition(":")[2])
        for origin, allowed in (("http://evil.example", False), (view.url.rstrip("/"), True)):
            assert asyncio.run(handshake(f"ws://127.0.0.1:{port}/ws", origin)) is allowed, origin
        others = {found[4][0] for found in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
        for address in others - {"127.0.0.1"}:
            if not address.startswith("127."):
                with socket.socket() as outside:
                    outside.settimeout(5)
                    assert outside.connect_ex((address, port)) != 0
