"""The report in a real browser, without a network: it opens, follows the mouse, zooms together, hides its marks."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium import Page, browser
from report_runs import EVENTFUL, drive

from train_ato.cli import main
from train_ato.report.recording import Recording, read_recording

pytestmark = pytest.mark.slow

FIGURES = "[...Bokeh.index].filter(view => view.model.type === 'Figure')"
AXES = f"{FIGURES}.map(view => view.model.left[0].axis_label)"
FRAME = f"""(() => {{
    const view = {FIGURES}[%d];
    view.el.scrollIntoView({{block: "center"}});
    const box = view.canvas_view?.el.getBoundingClientRect() ?? view.canvas.el.getBoundingClientRect();
    const frame = view.frame.bbox;
    return [box.left + frame.left, box.top + frame.top, frame.width, frame.height];
}})()"""
TOOLTIPS = """(() => {
    const found = [], walk = (node) => {
        if (node.classList?.contains("bk-Tooltip")) found.push(node.shadowRoot.textContent);
        for (const root of [node, node.shadowRoot]) for (const child of root?.children ?? []) walk(child);
    };
    walk(document.body);
    return found;
})()"""
RANGE = f"{FIGURES}.map(view => [view.model.x_range.start, view.model.x_range.end])"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("page"), "eventful", "demo", *EVENTFUL)


@pytest.fixture(scope="module")
def recording(run: Path) -> Recording:
    return read_recording(run)


@pytest.fixture(scope="module")
def page(run: Path) -> Iterator[Page]:
    assert main(["report", str(run)]) == 0
    with browser() as opened:
        show(opened, run / "report.html")
        yield opened


def show(page: Page, file: Path) -> None:
    page.console.clear()
    page.requests.clear()
    page.open(file.as_uri())
    page.wait_for("Bokeh.documents.length > 0 && Bokeh.documents[0].is_idle")


def frame(page: Page, axis: str) -> tuple[float, float, float, float]:
    """Bring the figure of an axis into view and return its frame: left, top, width, height."""
    number = page.evaluate(AXES).index(axis)
    page.evaluate(FRAME % number)
    time.sleep(0.3)
    left, top, width, height = page.evaluate(FRAME % number)
    return left, top, width, height


def reading(page: Page, words: str, unit: str) -> float:
    """Return a value of the bar."""
    found = page.evaluate(
        f"""[...document.querySelectorAll(".reading")].filter(cell => {{
            const told = [...cell.querySelectorAll("i")].map(part => part.textContent);
            return told[0] === "{words}" && (told[1] ?? "") === "{unit}";
        }}).map(cell => cell.querySelector("b").textContent)"""
    )
    assert len(found) == 1, (words, unit, found)
    return float(found[0].replace("−", "-"))


def test_the_page_opens_without_errors_and_asks_for_nothing(page: Page) -> None:
    """Breaks if a figure cannot be drawn, or the page needs a network."""
    assert page.console == []
    assert [address for address in page.requests if not address.startswith(("file:", "data:", "blob:"))] == []
    assert len([address for address in page.requests if address.startswith("file:")]) == 1
    axes = page.evaluate(AXES)
    assert len(axes) == 15
    for axis in ("speed in km/h", "coupler behind vehicle", "pressure in kPa", "delay in s", "energy in kWh"):
        assert axis in axes


def test_equal_times_stand_above_each_other(page: Page) -> None:
    """Breaks if one figure's frame is wider than another's: then the eye compares different moments."""
    frames = page.evaluate(
        f"{FIGURES}.map(view => [view.model.x_range.id, view.frame.bbox.left, view.frame.bbox.width])"
    )
    for shared in {entry[0] for entry in frames}:
        assert len({(left, width) for number, left, width in frames if number == shared}) == 1


def test_the_bar_tells_the_log_at_the_cursor(page: Page, recording: Recording) -> None:
    """Breaks if the cursor reads another time, another quantity or another unit than the log has."""
    left, top, width, height = frame(page, "speed error in km/h")
    begin, end = page.evaluate(RANGE)[page.evaluate(AXES).index("speed error in km/h")]
    for part in (0.31, 0.77):
        moment = begin + part * (end - begin)
        page.mouse("mouseMoved", left + part * width - 2, top + height / 2)
        page.mouse("mouseMoved", left + part * width, top + height / 2)
        page.wait_for("document.querySelector('.moment').textContent.startsWith('at ')")
        time.sleep(0.2)
        cars, command = recording.topics["train/cars"], recording.topics["ato/command"]
        slack = 0.1  # of a tick's length: the nearest tick is told
        row = int(np.abs(cars.time - moment).argmin())
        rows = slice(max(0, row - 1), row + 2)
        assert reading(page, "speed", "km/h") == pytest.approx(3.6 * cars["speed"][row, 0], abs=0.06 + slack)
        assert reading(page, "km", "") == pytest.approx(cars["position"][row, 0] / 1e3, abs=0.0015)
        draft = cars["coupler"][rows].max(axis=1) / 1e3
        assert draft.min() - 1 <= reading(page, "draft", "kN") <= draft.max() + 1
        demand = command["force"][rows, 0] / 1e3
        assert demand.min() - 1 <= reading(page, "demand", "kN") <= demand.max() + 1
    marks = page.evaluate(
        f"""{FIGURES}.flatMap(view => [...view.model.center, ...view.model.renderers]
            .filter(part => part.type === "Span" && part.visible).map(part => part.location))"""
    )
    assert marks == pytest.approx([np.interp(moment, cars.time, cars["position"][:, 0]) / 1e3] * 2, abs=0.002)


def test_a_drag_zooms_every_figure_over_time_and_a_double_click_ends_it(page: Page) -> None:
    """Breaks if the figures do not zoom together, or those over distance follow."""
    before, axes = page.evaluate(RANGE), page.evaluate(AXES)
    left, top, width, height = frame(page, "coupler force in kN (draft > 0)")
    page.mouse("mouseMoved", left + 0.25 * width, top + height / 2)
    page.mouse("mousePressed", left + 0.25 * width, top + height / 2, 1)
    for part in np.linspace(0.25, 0.5, 8):
        page.mouse("mouseMoved", left + part * width, top + height / 2, 1)
    page.mouse("mouseReleased", left + 0.5 * width, top + height / 2, 1)
    time.sleep(0.3)
    after = page.evaluate(RANGE)
    over_time = [index for index, entry in enumerate(before) if entry == before[axes.index("delay in s")]]
    assert len(over_time) == 13
    span = before[over_time[0]][1] - before[over_time[0]][0]
    for index, (begin, end) in enumerate(after):
        if index in over_time:
            assert (end - begin) / span == pytest.approx(0.25, abs=0.01)
        else:
            assert [begin, end] == before[index]
    for clicks in (1, 2):
        page.mouse("mousePressed", left + 0.4 * width, top + height / 2, clicks)
        page.mouse("mouseReleased", left + 0.4 * width, top + height / 2, clicks)
    page.wait_for(f"Math.abs({RANGE}[{over_time[0]}][1] - {before[over_time[0]][1]}) < 1e-9")
    assert page.evaluate(RANGE) == before
    assert page.console == []


def test_a_hover_tells_force_and_vehicle_of_the_heat_map(page: Page, recording: Recording) -> None:
    """Breaks if the codes of the picture are told instead of kN, or the train stands on its head."""
    left, top, width, height = frame(page, "coupler behind vehicle")
    begin, end = page.evaluate(RANGE)[page.evaluate(AXES).index("coupler behind vehicle")]
    page.mouse("mouseMoved", left + 0.38 * width, top + (10.5 / 105) * height)
    page.mouse("mouseMoved", left + 0.4 * width, top + (10.5 / 105) * height)
    told = page.wait_for(TOOLTIPS + '.find(text => text.includes("coupler behind vehicle"))')
    force = float(told.split("coupler force")[1].split("kN")[0].strip(" :"))
    vehicle = int(told.split("coupler behind vehicle")[1].split("coupler force")[0].strip(" :"))
    assert vehicle == 10
    cars = recording.topics["train/cars"]
    row = int(np.abs(cars.time - (begin + 0.4 * (end - begin))).argmin())
    near = cars["coupler"][max(0, row - 2) : row + 3, 10] / 1e3
    step = np.abs(cars["coupler"]).max() / 1e3 / 127
    assert near.min() - step <= force <= near.max() + step


def test_hiding_a_kind_of_event_hides_its_marks_everywhere(page: Page) -> None:
    """Breaks if the legend of the events is an ornament."""
    marks = f"""{FIGURES}.map(view => view.model.renderers
        .filter(part => ["VSpan", "VStrip"].includes(part.glyph?.type) && part.visible).length)
        .reduce((sum, count) => sum + count, 0)"""
    before = page.evaluate(marks)
    assert before > 40
    page.evaluate(
        f"""{FIGURES}.flatMap(view => view.model.renderers)
            .find(part => part.glyph?.type === "Scatter" && part.data_source.data.begin.length === 2).visible = false"""
    )
    time.sleep(0.2)
    assert before - page.evaluate(marks) == 12


def test_runs_side_by_side_open_too(run: Path, tmp_path: Path) -> None:
    """Breaks if the page of several runs has an error that only a browser sees."""
    other = drive(tmp_path, "other", "demo", *EVENTFUL, "--controller=smc", "--set=duration=40")
    file = tmp_path / "both.html"
    assert main(["report", str(run), str(other), f"--out={file}"]) == 0
    with browser() as page:
        show(page, file)
        assert page.console == []
        assert [address for address in page.requests if not address.startswith(("file:", "data:", "blob:"))] == []
        legends = page.evaluate(
            f"""{FIGURES}.flatMap(view => view.model.above).filter(part => part.type === "Legend")
                .flatMap(legend => legend.items.map(item => item.label.value ?? item.label))"""
        )
        assert {"eventful", "other"} <= set(legends)
        assert page.evaluate(AXES).count("coupler behind vehicle") == 2
