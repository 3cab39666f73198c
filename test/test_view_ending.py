"""Live page before, at and after the end of a run, and without its server."""

import os
import signal
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from chromium import browser
from view_browser import click, opened, strangers, viewing

pytestmark = pytest.mark.graph
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
