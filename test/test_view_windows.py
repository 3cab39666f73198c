"""Live page in windows of many sizes, and with a killed or replaced run."""

import contextlib
import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from programs import begun

pytest.importorskip("rclpy")

from chromium import browser
from view_browser import answer, opened, text, viewing
from waiting import LIMIT_S, wait_for

from train_ato.log.bag_layout import PARTIAL
from train_ato.messages.topic import TrainLayout
from train_ato.ros.graph.environment import claim_domain
from train_ato.view.facts import Facts
from train_ato.view.snapshot import Snapshot, now, signed

BOX = """(() => {{ const r = {0}.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom] }})()"""


@pytest.fixture(scope="module")
def short(demo_run) -> Path:
    return demo_run("duration=70", "law_changes=[{at: 60, law: smc}]")


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


@pytest.mark.graph
def test_the_emergency_brake_is_in_sight_and_nothing_covers_anything():
    """Breaks if a small window hides the emergency brake or covers the title, or a large one has empty space."""
    with browser() as page, viewing("--scenario", "demo", "--rate", "5") as view:
        opened(page, view.url)
        brake = BOX.format('deep(e => e.tagName == "BUTTON" && e.textContent.trim() == "EMERGENCY BRAKE")')
        for width, height in ((900, 700), (1280, 720), (1720, 1000), (2560, 1440)):
            resized(page, width, height)
            page.wait_for(f"window.innerWidth == {width}")
            box = page.evaluate(brake)
            assert box[2] <= width, (width, box)
            assert box[3] <= height, (width, box)
            title = page.evaluate(BOX.format('document.querySelector(".run b")'))
            pause = page.evaluate(BOX.format('deep(e => e.tagName == "BUTTON" && e.textContent.trim() == "pause")'))
            assert title[2] <= pause[0] or title[3] <= pause[1], (width, title, pause)
            page.wait_for(f"document.documentElement.scrollWidth <= {width}")
        page.wait_for("document.querySelector('.strips').getBoundingClientRect().bottom > 1400")
        page.wait_for("document.documentElement.scrollHeight <= 1440")
        page.wait_for("model('strip_error').inner_height > 150")
        resized(page, 2560, 1000)
        page.wait_for("document.documentElement.scrollHeight < 1200")
        assert page.console == []


@pytest.mark.graph
def test_times_before_the_begin_are_times_and_labels_pull_no_axis(short):
    """Breaks if the axis shows -1:-1:10, or an event label extends the scale of the speed."""
    with browser() as page, viewing(str(short)) as view:
        opened(page, view.url, frames=1)
        told = page.evaluate("model('strip_error').below[0].formatter.doFormat([-90, -60, 0, 90], {loc: 0})")
        assert told == ["-1:30", "-1:00", "0:00", "1:30"]
        labels = "model('strip_speed').renderers.find(r => r.glyph.type == 'Text')"
        assert page.evaluate(f"{labels}.y_range_name") == "labels"
        assert page.evaluate(f"{labels}.data_source.data.label.length") > 0


@pytest.mark.graph
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


def test_without_a_limit_the_dial_has_no_hook():
    """Breaks if a line without limits shows a limit at the end of the dial."""
    values = {name: np.zeros(1) for name in ("position", "velocity", "coupler", "applied", "command", "estimate")}
    standing = Snapshot(time=0.0, shoe=None, reference=(0.0, 0.0, 0.0), **values)
    row = now(standing, Facts("none", TrainLayout(1, 1)), None, 60.0)
    assert (row["limited"], row["limit_text"]) == ([0.0], ["–"])


@pytest.mark.parametrize(("value", "digits", "shown"), [(-0.004, 2, "+0.00"), (-0.04, 1, "+0.0"), (-1.25, 1, "-1.2")])
def test_nothing_has_no_minus(value, digits, shown):
    """Breaks if an error that rounds to zero is shown as -0.0."""
    assert signed(value, digits) == shown
