"""Driver's display in a real browser: planning area, target bar, stop window, elevation profile, messages, sizes."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from chromium import Page, browser
from view_browser import click, opened, viewing
from waiting import wait_for

pytestmark = pytest.mark.graph
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
    """Breaks if planning area, target bar, train on the elevation profile, gauge or messages are not drawn."""
    run = demo_run("duration=220", "interventions=[{at: 150, do: gust, acceleration: 0.5, duration: 60}]")
    with browser() as page, viewing(str(run)) as view:
        opened(page, view.url, frames=1)
        page.evaluate("model('time').value = 193.5")
        page.wait_for("document.body.dataset.supervision == 'service brake'")
        page.wait_for("dmi.row.guidance[0] == 'service brake'")
        wait_for(lambda: STOP in colours(page, "planning"), "the stop in the planning area")
        assert page.evaluate("dmi.row.needle[0]") == "#e8202a"
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


def test_an_intervention_is_acknowledged_on_the_page(tmp_path: Path) -> None:
    """Breaks if an emergency brake leaves no message, or a click on it has no effect in the run's display."""
    with browser() as page, viewing("--scenario", "demo", "--rate", "5", "--out", str(tmp_path / "run")) as view:
        opened(page, view.url)
        click(page, "EMERGENCY BRAKE")
        page.wait_for("[...document.querySelectorAll('#messages > *')].some(e => e.textContent.includes('emergency'))")
        waiting = "document.querySelectorAll('#messages .waiting').length"
        page.wait_for(f"{waiting} > 0")
        page.evaluate("document.querySelector('#messages .waiting').click()")
        page.wait_for(f"{waiting} == 0")
        assert page.console == []
        assert view.end() == 0
