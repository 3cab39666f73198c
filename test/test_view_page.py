"""Live page in a real browser: drawing, following the train, and requests to the running nodes."""

import asyncio
import json
import re
import socket
from pathlib import Path
from urllib.request import urlopen

import pytest
from bokeh.client import pull_session
from bokeh.document import Document
from bokeh.document.models import DocumentModelManager
from bokeh.util.token import get_session_id
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

pytest.importorskip("rclpy")

from chromium import browser
from view_browser import answer, choose, click, number, opened, strangers, text, viewing
from waiting import still, wait_for

from train_ato.ros.graph.environment import held_domains
from train_ato.view.page import ViewPage
from train_ato.view.recorded import RecordedFeed

pytestmark = pytest.mark.graph
LONG = ("duration=4000", "profile.phases=[{cruise_for: 5}, {accelerate_to_kmh: 30}, {cruise_for: 3000}, {brake_to: 0}]")
"""The demo with 50 minutes at 30 km/h: at ten times real time it is longer than any test of a page."""


@pytest.fixture(scope="module")
def recorded(demo_run) -> Path:
    return demo_run("duration=180", "law_changes=[{at: 100, law: smc}]")


def test_a_request_of_the_page_makes_no_session(recorded):
    """Breaks if every request makes the figures anew, two browsers share a session, or the figures find no place."""
    with viewing(str(recorded)) as view:
        texts = [urlopen(view.url).read().decode() for _ in range(3)]
        tokens = [re.search('"token":"([^"]+)"', text)[1] for text in texts]
        assert len(set(tokens)) == 3
        assert len({text.replace(token, "") for text, token in zip(texts, tokens, strict=True)}) == 1
        places = json.loads(re.search(r'"roots":({[^}]+})', texts[2])[1])
        with pull_session(session_id=get_session_id(tokens[2]), url=view.url) as session:
            assert {root.id for root in session.document.roots} == {*places}
        assert all(f'id="{place}"' in texts[2] for place in places.values())


def test_the_models_of_a_page_are_collected_once(recorded, monkeypatch):
    """Breaks if a page costs four times its figures: bokeh collects all models after every change of an open one."""
    collected = []
    monkeypatch.setattr(DocumentModelManager, "recompute", lambda models: collected.append(models))
    ViewPage(Document(), RecordedFeed(recorded))
    assert len(collected) == 1


def clock_of(page) -> float:
    hours, minutes, seconds = text(page, "clock_text").split(":")
    return 3600 * int(hours) + 60 * int(minutes) + float(seconds)


def test_a_train_is_watched_and_acted_on(tmp_path):
    """Breaks if the page does not draw or follow, a button has no effect on the node, or a rejection is not shown."""
    folder = tmp_path / "run"
    changes = [f"--set={change}" for change in (*LONG, "laws.smc.gains=printed")]
    options = ["--scenario", "demo", "--rate", "10", "--out", str(folder), *changes]
    with browser() as page, viewing(*options) as view:
        opened(page, view.url)
        wait_for(lambda: clock_of(page) > 100.0, "a train that moves")
        assert number(page, "place_text") > 0.0
        drawn = page.evaluate("model('now').data.speed_angle[0]")
        points = page.evaluate("model('strip_error').renderers[3].data_source.get_length()")
        wait_for(lambda: page.evaluate("model('now').data.speed_angle[0]") != drawn, "a needle that moves")
        wait_for(
            lambda: page.evaluate("model('strip_error').renderers[3].data_source.get_length()") > points,
            "more points in the strip charts",
        )
        coupler = page.evaluate("Math.max(...model('along').renderers[0].data_source.data.coupler)")
        assert coupler > 100.0

        before = abs(number(page, "error_text"))
        page.evaluate("model('gust.acceleration').value = -0.04; model('gust.acceleration').value_throttled = -0.04")
        answer(page, "gust.acceleration = -0.04")
        click(page, "gust")
        assert "gust: acceleration -0.04" in answer(page, "gust: ")
        least = "Math.min(...model('strip_error').renderers[3].data_source.data.error)"
        wait_for(lambda: page.evaluate(least) < -0.3 - before, "the gust in the error")

        choose(page, "smc")
        assert "try --set laws.smc.gains=model" in answer(page, "smc: printed gains")
        wait_for(lambda: text(page, "law") == "smc", "the other law")
        page.wait_for("!!model('smc.l1')")
        page.evaluate("model('smc.l1').value_throttled = 1.5")
        answer(page, "smc.l1 = 1.5")
        choose(page, "fixed_time_smc")
        refused = answer(page, "fixed_time_smc") if text(page, "law") != "fixed_time_smc" else ""
        choose(page, "pid")
        wait_for(lambda: text(page, "law") == "pid", refused)

        click(page, "pause")
        page.wait_for("document.body.dataset.state == 'paused'")
        standing = still(lambda: clock_of(page))
        click(page, "tick")
        wait_for(lambda: clock_of(page) == pytest.approx(standing + 0.1), "a step of one tick")

        click(page, "EMERGENCY BRAKE")
        answer(page, "emergency brake applied")
        for tick in (1, 2):  # the brake acts in the first and is reported in the second
            click(page, "tick")
            wait_for(lambda tick=tick: clock_of(page) == pytest.approx(standing + 0.1 + 0.1 * tick), "a tick")
        page.wait_for("document.body.dataset.state == 'emergency brake'")
        click(page, "release the emergency brake")
        assert "standstill only; the train runs" in answer(page, "released at standstill")
        page.screenshot(tmp_path / "page.png")
        assert (tmp_path / "page.png").stat().st_size > 50_000
        click(page, "resume")
        wait_for(lambda: abs(page.evaluate("model('where').data.speed[0]")) < 0.01, "the stop by the emergency brake")
        assert number(page, "pipe_text") == 101
        click(page, "release the emergency brake")
        page.wait_for("document.body.dataset.state == 'running'")
        assert page.console == []
        assert strangers(page, view.url) == []
        assert view.end() == 0
    assert held_domains() == [] or (folder / "run.mcap").is_file()
    told = {row["name"]: row for row in json.loads((folder / "summary.json").read_text())["changes"]}
    assert {"gust", "emergency_brake", "controller", "smc.l1"} <= set(told)
    assert told["gust"]["value"]["acceleration"] == -0.04


def test_a_recorded_run_is_played(recorded, tmp_path):
    """Breaks if slider, play and pause or the list of events have no effect, or the browser reports an error."""
    with browser() as page, viewing(str(recorded)) as view:
        opened(page, view.url, frames=1)
        assert clock_of(page) > 0.0  # where something happens
        place = page.evaluate("(() => { const b = document.getElementById('overview').getBoundingClientRect();"
                              " return [b.left + overview.across(60, b.width), b.top + 20] })()")  # fmt: skip
        page.mouse("mousePressed", *place, clicks=1)
        page.mouse("mouseReleased", *place, clicks=1)
        wait_for(lambda: clock_of(page) == pytest.approx(60.0, abs=0.5), "the moment of the click")
        page.evaluate("model('time').value = 120.04")
        wait_for(lambda: clock_of(page) == 120.0)
        assert text(page, "law") == "smc"
        swap = "model('events').options.find(([number, text]) => text.includes('smc'))"
        page.evaluate(f"model('events').value = [{swap}[0]]")
        wait_for(lambda: clock_of(page) == 100.0, "the moment of the event")
        choose(page, "20 ×")
        click(page, "play")
        wait_for(lambda: clock_of(page) > 130.0, "time that goes on")
        click(page, "pause")
        page.wait_for("!!deep(e => e.tagName == 'BUTTON' && e.textContent.trim() == 'play')")
        standing = still(lambda: clock_of(page))
        click(page, "◀ tick")
        wait_for(lambda: clock_of(page) == pytest.approx(standing - 0.1))
        inside = page.evaluate("(() => { const s = model('strip_speed'); return [s.x_range.start, s.x_range.end] })()")
        assert inside[0] < standing < inside[1]
        page.screenshot(tmp_path / "recorded.png")
        assert page.console == []
        assert strangers(page, view.url) == []
        assert view.end() == 0


def test_two_browsers_see_the_same(recorded):
    """Breaks if each browser has its own time, or the second one receives no data."""
    with browser() as one, browser() as other, viewing(str(recorded)) as view:
        for page in (one, other):
            opened(page, view.url, frames=1)
        one.evaluate("model('time').value = 66.0")
        wait_for(lambda: clock_of(other) == 66.0)


async def handshake(address: str, origin: str) -> bool:
    """Return True if a page of an origin gets a WebSocket."""
    try:
        asked = HTTPRequest(address, headers={"Origin": origin})
        (await websocket_connect(asked, subprotocols=["bokeh", "no token"])).close()
    except HTTPClientError as error:
        assert error.code == 403
        return False
    return True


def test_pages_of_other_origins_are_refused(recorded):
    """Breaks if any page in the browser can control the train, or other machines can connect."""
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
