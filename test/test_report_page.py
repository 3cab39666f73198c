"""Report in a browser without network: loading, cursor, common zoom, hidden marks."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium import Page, browser
from report_runs import EVENTFUL, drive
from waiting import still, wait_for

from train_ato.cli import main
from train_ato.log.recorded import open_recording

pytestmark = pytest.mark.campaign

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
    left, top, width, height = still(lambda: page.evaluate(FRAME % number))
    return left, top, width, height


def reading(page: Page, words: str, unit: str) -> float:
    """Return a value of the bar."""
    found = page.evaluate(
        f"""[...document.querySelectorAll(".reading")].filter(cell => {{
            const found = [...cell.querySelectorAll("i")].map(part => part.textContent);
            return found[0] === "{words}" && (found[1] ?? "") === "{unit}";
        }}).map(cell => cell.querySelector("b").textContent)"""
    )
    (value,) = found
    return float(value.replace("−", "-"))


def test_the_page_opens_without_errors_and_asks_for_nothing(page: Page) -> None:
    """Breaks if a figure cannot be drawn, or the page needs a network."""
    assert page.console == []
    assert [address for address in page.requests if not address.startswith(("file:", "data:", "blob:"))] == []
    assert len([address for address in page.requests if address.startswith("file:")]) == 1
    axes = page.evaluate(AXES)
    assert len(axes) == 16
    for axis in ("speed in km/h", "coupler behind vehicle", "pressure in kPa", "delay in s", "energy in kWh"):
        assert axis in axes


def test_equal_times_stand_above_each_other(page: Page) -> None:
    """Breaks if the frames have different widths, so that equal times are not above each other."""
    frames = page.evaluate(
        f"{FIGURES}.map(view => [view.model.x_range.id, view.frame.bbox.left, view.frame.bbox.width])"
    )
    for shared in {entry[0] for entry in frames}:
        assert len({(left, width) for number, left, width in frames if number == shared}) == 1


def test_the_bar_tells_the_log_at_the_cursor(page: Page, run: Path) -> None:
    """Breaks if a value at the cursor differs from the log in time, quantity or unit."""
    left, top, width, height = frame(page, "speed error in km/h")
    begin, end = page.evaluate(RANGE)[page.evaluate(AXES).index("speed error in km/h")]
    topics = open_recording(run).topics
    for part in (0.31, 0.77):
        moment = begin + part * (end - begin)
        page.mouse("mouseMoved", left + part * width - 2, top + height / 2)
        page.mouse("mouseMoved", left + part * width, top + height / 2)
        page.wait_for("document.querySelector('.moment').textContent.startsWith('at ')")
        cars, command = topics["train/vehicles"], topics["ato/command"]
        slack = 0.1  # of a tick's length: the nearest tick is found
        row = int(np.abs(cars.time - moment).argmin())
        rows = slice(max(0, row - 1), row + 2)
        speed = pytest.approx(3.6 * cars["velocity"][row, 0], abs=0.06 + slack)
        wait_for(lambda speed=speed: reading(page, "speed", "km/h") == speed, "the speed at the cursor")
        assert reading(page, "position", "km") == pytest.approx(cars["position"][row, 0] / 1e3, abs=0.0015)
        draft = cars["coupler_force"][rows].max(axis=1) / 1e3
        assert draft.min() - 1 <= reading(page, "draft", "kN") <= draft.max() + 1
        demand = command["force"][rows, 0] / 1e3
        assert demand.min() - 1 <= reading(page, "command", "kN") <= demand.max() + 1
    marks = page.evaluate(
        f"""{FIGURES}.flatMap(view => [...view.model.center, ...view.model.renderers]
            .filter(part => part.type === "Span" && part.visible).map(part => part.location))"""
    )
    assert marks == pytest.approx([np.interp(moment, cars.time, cars["position"][:, 0]) / 1e3] * 2, abs=0.002)


def test_a_drag_zooms_every_figure_over_time_and_a_double_click_ends_it(page: Page) -> None:
    """Breaks if the figures over time do not zoom together, or figures over distance zoom too."""
    before, axes = page.evaluate(RANGE), page.evaluate(AXES)
    left, top, width, height = frame(page, "coupler force in kN (draft > 0)")
    page.mouse("mouseMoved", left + 0.25 * width, top + height / 2)
    page.mouse("mousePressed", left + 0.25 * width, top + height / 2, 1)
    for part in np.linspace(0.25, 0.5, 8):
        page.mouse("mouseMoved", left + part * width, top + height / 2, 1)
    page.mouse("mouseReleased", left + 0.5 * width, top + height / 2, 1)
    over_time = [index for index, entry in enumerate(before) if entry == before[axes.index("delay in s")]]
    assert len(over_time) == 14
    span = before[over_time[0]][1] - before[over_time[0]][0]
    shares = lambda ranges: [(ranges[index][1] - ranges[index][0]) / span for index in over_time]  # noqa: E731
    wait_for(lambda: shares(page.evaluate(RANGE)) == pytest.approx([0.25] * 14, abs=0.01), "the zoom")
    after = page.evaluate(RANGE)
    assert all(after[index] == before[index] for index in range(len(before)) if index not in over_time)
    for clicks in (1, 2):
        page.mouse("mousePressed", left + 0.4 * width, top + height / 2, clicks)
        page.mouse("mouseReleased", left + 0.4 * width, top + height / 2, clicks)
    page.wait_for(f"Math.abs({RANGE}[{over_time[0]}][1] - {before[over_time[0]][1]}) < 1e-9")
    assert page.evaluate(RANGE) == before
    assert page.console == []


def test_a_hover_tells_force_and_vehicle_of_the_heat_map(page: Page, run: Path) -> None:
    """Breaks if the tooltip shows codes instead of kN, or the order of the vehicles is reversed."""
    left, top, width, height = frame(page, "coupler behind vehicle")
    begin, end = page.evaluate(RANGE)[page.evaluate(AXES).index("coupler behind vehicle")]
    page.mouse("mouseMoved", left + 0.38 * width, top + (10.5 / 105) * height)
    page.mouse("mouseMoved", left + 0.4 * width, top + (10.5 / 105) * height)
    found = page.wait_for(TOOLTIPS + '.find(text => text.includes("coupler behind vehicle"))')
    force = float(found.split("coupler force")[1].split("kN")[0].strip(" :"))
    vehicle = int(found.split("coupler behind vehicle")[1].split("coupler force")[0].strip(" :"))
    assert vehicle == 10
    cars = open_recording(run).topics["train/vehicles"]
    row = int(np.abs(cars.time - (begin + 0.4 * (end - begin))).argmin())
    near = cars["coupler_force"][max(0, row - 2) : row + 3, 10] / 1e3
    step = np.abs(cars["coupler_force"]).max() / 1e3 / 127
    assert near.min() - step <= force <= near.max() + step


def test_hiding_a_kind_of_event_hides_its_marks_everywhere(page: Page) -> None:
    """Breaks if a click on the legend of the events does not hide marks."""
    marks = f"""{FIGURES}.map(view => view.model.renderers
        .filter(part => ["VSpan", "VStrip"].includes(part.glyph?.type) && part.visible).length)"""
    before = page.evaluate(marks)
    assert sum(before) > 40
    page.evaluate(
        f"""{FIGURES}.flatMap(view => view.model.renderers)
            .find(part => part.glyph?.type === "Scatter" && part.data_source.data.begin.length === 2).visible = false"""
    )
    without = [max(0, count - 1) for count in before]
    wait_for(lambda: page.evaluate(marks) == without, "the marks without their kind in every figure")


def test_runs_side_by_side_open_too(run: Path, tmp_path: Path) -> None:
    """Breaks if the page of several runs causes an error in the browser, or is wider than a phone."""
    other = drive(tmp_path, "other", "demo", *EVENTFUL, "--law=smc", "--set=duration=40")
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
        page.open(file.as_uri(), width=390)
        assert page.evaluate("document.documentElement.scrollWidth") == 390
