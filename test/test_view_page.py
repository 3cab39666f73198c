"""Live page in a real browser: drawing, the display, following the train, requests, the end of a run and its server."""

import contextlib
import json
import os
import re
import signal
import subprocess
from pathlib import Path
from urllib.request import urlopen

import pytest
from bokeh.client import pull_session
from bokeh.document import Document
from bokeh.document.models import DocumentModelManager
from bokeh.util.token import get_session_id

pytest.importorskip("rclpy")

from chromium import Page, browser
from programs import begun
from view_browser import answer, choose, click, number, opened, strangers, text, viewing
from waiting import LIMIT_S, still, wait_for

from train_ato.log.bag_layout import PARTIAL
from train_ato.ros.graph.environment import claim_domain, held_domains
from train_ato.view.page import ViewPage
from train_ato.view.recorded import RecordedFeed
from train_ato.view.snapshot import LIMIT_NAMES

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
    """Breaks if slider, play or list of events have no effect, or each browser has its own time.

    The axis shows times before the begin as -1:-1:10 otherwise, and an event label extends the scale of the speed.
    """
    with browser() as page, browser() as other, viewing(str(recorded)) as view:
        for each in (page, other):
            opened(each, view.url, frames=1)
        assert clock_of(page) > 0.0  # where something happens
        place = page.evaluate("(() => { const b = document.getElementById('overview').getBoundingClientRect();"
                              " return [b.left + overview.across(60, b.width), b.top + 20] })()")  # fmt: skip
        page.mouse("mousePressed", *place, clicks=1)
        page.mouse("mouseReleased", *place, clicks=1)
        wait_for(lambda: clock_of(page) == pytest.approx(60.0, abs=0.5), "the moment of the click")
        page.evaluate("model('time').value = 120.04")
        wait_for(lambda: clock_of(page) == clock_of(other) == 120.0)
        assert text(page, "law") == "smc"
        swap = "model('events').options.find(([number, text]) => text.includes('smc'))"
        page.evaluate(f"model('events').value = [{swap}[0]]")
        wait_for(lambda: clock_of(page) == 100.0, "the moment of the event")
        labels = "model('strip_speed').renderers.find(r => r.glyph.type == 'Text')"
        assert page.evaluate(f"{labels}.y_range_name") == "labels"
        assert page.evaluate(f"{labels}.data_source.data.label.length") > 0
        told = page.evaluate("model('strip_error').below[0].formatter.doFormat([-90, -60, 0, 90], {loc: 0})")
        assert told == ["-1:30", "-1:00", "0:00", "1:30"]
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


SAID = "document.getElementById('verdict').innerText"


def test_a_run_waits_for_its_page_ends_with_a_verdict_and_is_run_again(tmp_path: Path) -> None:
    """Breaks if ticks pass before the page, the end has no verdict, report or locked controls, or no run follows."""
    short = ("--set=duration=60", "--set=profile.phases=[{cruise_for: 5}, {accelerate_to_kmh: 10}, {brake_to: 0}]")
    options = ("--scenario", "demo", "--rate", "20", "--out", str(tmp_path / "run"), *short)
    with browser() as page, viewing(*options) as view:
        opened(page, view.url, frames=1)
        page.wait_for("document.body.dataset.state == 'finished'")
        page.wait_for(f"{SAID}.includes('stop')")
        assert "finished" in page.evaluate(SAID)
        begin = "model('strip_error').renderers[3].data_source.data.time[0]"
        assert page.evaluate(begin) < 2.0, "the page has the first seconds of the run"
        assert page.evaluate('deep(e => e.tagName == "BUTTON" && e.textContent.trim() == "EMERGENCY BRAKE").disabled')
        assert "m/s" in page.evaluate("model('gust.acceleration').html_attributes.title")
        report = page.evaluate("fetch(document.querySelector('#verdict a').href).then(answer => answer.text())")
        assert "<html" in report
        assert (tmp_path / "run" / "report.html").is_file()
        assert page.console == []
        assert strangers(page, view.url) == []
        page.evaluate("window.former = true")
        click(page, "run again")
        page.wait_for("!window.former && window.trainAto && window.trainAto.frames >= 1")
        page.wait_for("document.body.dataset.state == 'running'")
        assert view.end() == 0
    assert (tmp_path / "run-2" / "run.mcap").is_file()


def test_a_page_without_its_server_says_so(demo_run) -> None:
    """Breaks if the page of a stopped server looks alive, or that of a server that goes on looks dead."""
    run = demo_run("duration=5")
    with browser() as page, viewing(str(run)) as view:
        opened(page, view.url, frames=1)
        lost = "document.body.classList.contains('unserved')"
        assert page.evaluate("document.getElementById('lost').hidden")
        view.process.send_signal(signal.SIGSTOP)
        try:
            page.wait_for(lost)
            assert "No server" in page.evaluate("document.getElementById('lost').innerText")
        finally:
            view.process.send_signal(signal.SIGCONT)
        page.wait_for(f"!{lost}")
        os.kill(view.process.pid, signal.SIGKILL)
        view.process.wait()
        page.wait_for(lost)


COLOURS = """(name => {{
  const shown = document.getElementById(name), canvas = document.createElement("canvas");
  canvas.width = shown.width;
  canvas.height = shown.height;
  if (!canvas.width || !canvas.height) return [];
  const pen = canvas.getContext("2d", {{willReadFrequently: true}});
  pen.drawImage(shown, 0, 0);
  const pixels = pen.getImageData(0, 0, canvas.width, canvas.height).data, found = new Set();
  for (let i = 0; i < pixels.length; i += 4) found.add([...pixels.slice(i, i + 3)].join());
  return [...found];
}})("{0}")"""
STOP, TRAIN, ZONE = "255,210,74", "86,180,233", "31,143,95"


def colours(page: Page, name: str) -> set[str]:
    """Return the colours of the pixels of a canvas."""
    return set(page.evaluate(COLOURS.format(name)))


def test_the_display_has_line_target_and_messages_of_its_time(demo_run) -> None:
    """Breaks if planning area, target bar, train on the elevation profile, gauge, limits or messages are not drawn."""
    run = demo_run("duration=280", "interventions=[{at: 150, do: gust, acceleration: 0.5, duration: 60}]")
    with browser() as page, viewing(str(run)) as view:
        opened(page, view.url, frames=1)
        page.evaluate("model('time').value = 193.5")
        page.wait_for("document.body.dataset.supervision == 'service brake'")
        page.wait_for("dmi.row.guidance[0] == 'service brake'")
        wait_for(lambda: STOP in colours(page, "planning"), "the stop in the planning area")
        assert page.evaluate("dmi.row.needle[0]") == "#e8202a"
        page.wait_for("document.body.dataset.ato == 'disengaging'")
        assert text(page, "supervision_text") == "service brake"
        assert number(page, "permitted_text") < number(page, "warning_text") < number(page, "emergency_text")
        assert page.evaluate("model('now').data.emergency_angle[0] < model('now').data.permitted_angle[0]")
        rings = page.evaluate("model('dial').renderers.length")
        wait_for(lambda: "232,32,42" in colours(page, "target"), "the bar in the colour of the state")
        wait_for(lambda: len(colours(page, "elevation") - colours(page, "planning")) > 5, "vehicles of many colours")
        first = "document.querySelector('#messages > *').textContent"
        page.wait_for(f"{first}.includes('ATO disengaging')")
        assert page.evaluate("document.querySelectorAll('#messages .waiting').length") == 0
        page.evaluate("dmi.zoom(32000)")
        parts = page.evaluate("[0, 800, 16000, 32000].map(metres => dmi.part(metres, 32000))")
        assert parts == pytest.approx([0.0, 0.125, 0.8356, 1.0], abs=1e-3)
        lost = "elevation.at([[0, 0, 0], [400, -10, 0], [900, 5, -5]], 1000)"
        assert page.evaluate(lost) == pytest.approx(-4.5)
        for width in (390, 1280, 1920):
            page.send("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
            page.wait_for(f"window.innerWidth == {width}")
            page.wait_for(f"document.documentElement.scrollWidth <= {width}")
        assert page.console == []
        assert view.end() == 0
    with browser() as page, viewing(str(demo_run("duration=5", "supervision.enabled=false"))) as view:
        opened(page, view.url, frames=1)
        assert page.evaluate("document.querySelector('.protection')") is None
        assert rings - page.evaluate("model('dial').renderers.length") == len(LIMIT_NAMES) - 1
        assert page.console == []


def test_the_stop_window_appears_before_the_stop(demo_run) -> None:
    """Breaks if the last metres have no scale, or the scale is there on the open line."""
    slow = "profile.phases=[{cruise_for: 5}, {accelerate_to_kmh: 10}, {brake_to: 0}]"
    run = demo_run(slow, "duration=400", "criteria.stop_window=10")  # it stops 5.8 m short of its target
    with browser() as page, viewing(str(run)) as view:
        opened(page, view.url, frames=1)
        page.evaluate("model('time').value = 60.0")
        page.wait_for("dmi.row && dmi.row.front_m && dmi.row.clock_text[0] == '0:01:00.0'")
        page.wait_for("document.getElementById('stopping').hidden")
        page.evaluate("model('time').value = 400.0")
        page.wait_for("!document.getElementById('stopping').hidden")
        wait_for(lambda: {TRAIN, ZONE} <= colours(page, "window"), "the train in the window")
        assert page.console == []


BOX = """(() => {{ const r = {0}.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom] }})()"""


@contextlib.contextmanager
def running(domain: int, out: Path, scenario: str = "demo", rate: str = "5"):
    """Start a run on a domain in a new session, longer than a loaded machine needs for a view and a browser."""
    words = ["run", scenario, "--no-lockstep", f"--rate={rate}", f"--domain={domain}", "--set=duration=7200"]
    process = begun(*words, f"--out={out}", stdout=None, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
            process.wait(timeout=LIMIT_S)


def resized(page, width: int, height: int) -> None:
    page.send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)


def test_the_emergency_brake_is_in_sight_and_nothing_covers_anything():
    """Breaks if a small window hides the emergency brake or covers the title, or a large one has empty space.

    The brake leaves a message, and a click on it has its effect.
    """
    with browser() as page, viewing("--scenario", "demo", "--rate", "5") as view:
        opened(page, view.url)
        brake = BOX.format('deep(e => e.tagName == "BUTTON" && e.textContent.trim() == "EMERGENCY BRAKE")')
        panel = BOX.format('document.querySelector(".ahead")')
        farthest = BOX.format('deep(e => e.tagName == "BUTTON" && e.textContent.trim() == "8 km")')
        for width, height in ((900, 700), (1280, 720), (1366, 768), (1520, 800), (1720, 1000), (2560, 1440)):
            resized(page, width, height)
            page.wait_for(f"window.innerWidth == {width}")
            box = page.evaluate(brake)
            assert box[2] <= width, (width, box)
            assert box[3] <= height, (width, box)
            title = page.evaluate(BOX.format('document.querySelector(".run b")'))
            pause = page.evaluate(BOX.format('deep(e => e.tagName == "BUTTON" && e.textContent.trim() == "pause")'))
            assert title[2] <= pause[0] or title[3] <= pause[1], (width, title, pause)
            page.wait_for(f"document.documentElement.scrollWidth <= {width}")
            page.wait_for(f"{farthest}[2] <= {panel}[2]")
        page.wait_for("document.querySelector('.strips').getBoundingClientRect().bottom > 1400")
        page.wait_for("document.documentElement.scrollHeight <= 1440")
        page.wait_for("model('strip_error').inner_height > 150")
        resized(page, 2560, 1000)
        page.wait_for("document.documentElement.scrollHeight < 1200")
        click(page, "EMERGENCY BRAKE")
        page.wait_for("[...document.querySelectorAll('#messages > *')].some(e => e.textContent.includes('emergency'))")
        waiting = "document.querySelectorAll('#messages .waiting').length"
        page.wait_for(f"{waiting} > 0")
        page.evaluate("document.querySelector('#messages .waiting').click()")
        page.wait_for(f"{waiting} == 0")
        assert page.console == []
        assert view.end() == 0


def test_a_killed_run_is_gone_and_the_next_one_is_not_taken_for_it(tmp_path):
    """Breaks if the page of a killed run appears to run, or sends requests to the next run."""
    first, second = tmp_path / "first", tmp_path / "second"
    with claim_domain() as domain:
        pass
    with running(domain, first) as process, browser() as page, _when_there(domain, first) as shown:
        opened(page, shown.url)
        os.killpg(process.pid, signal.SIGKILL)
        page.wait_for("['no data', 'run ended'].includes(document.body.dataset.state)")
        profile = "Math.max(...model('ahead').renderers[1].data_source.data.speed)"
        standing = (text(page, "clock_text"), page.evaluate(profile))
        with running(domain, second, "xuzhou_metro", "20"):  # it overtakes the time of the first
            page.wait_for("document.body.dataset.state == 'run ended'")
            with _when_there(domain, second) as other:
                assert other.process.poll() is None
            page.wait_for('deep(e => e.tagName == "BUTTON" && e.textContent.trim() == "EMERGENCY BRAKE").disabled')
            page.evaluate("model('gust.duration').value_throttled = 7.0")
            assert "restart the view" in answer(page, "ended")
            assert text(page, "state") == "run ended"
            assert (text(page, "clock_text"), page.evaluate(profile)) == standing
        assert shown.end() == 0


def _when_there(domain: int, out: Path):
    """Show a run after its recording has started."""
    wait_for((out / PARTIAL).exists, "the run")
    return viewing("--domain", str(domain))
