"""First screen of a report: verdict, criteria, speed against profile; best values of a comparison."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from chromium import Page, browser
from report_runs import drive

import train_ato as ta
from train_ato.cli import main
from train_ato.cli.info import print_summary
from train_ato.judge.ranking import best_value, difference_from_best, rank_of
from train_ato.log.recorded import open_recording
from train_ato.report.page_data import PageData, empty_page_data, page_data
from train_ato.report.page_sections import run_sections
from train_ato.report.summary_rows import best_text, criterion_cells, typeset, verdict_texts
from train_ato.report.writing import write_comparison_page


def judged(label: str, error: float, verdict: str | None = "passed", **more: object) -> PageData:
    """Return the page of a run without data."""
    failed = [{"criterion": "overspeed", "metric": "x", "value": 2.0, "limit": 0.5, "passed": verdict != "failed"}]
    summary = {"scenario": "demo", "speed_rmse_kmh": error, "status": "done", "criteria": failed, "verdict": verdict}
    return empty_page_data(label, {**summary, **more}, "no log")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("verdict"), "short", "demo", "--set=duration=60")


def test_the_first_screen_has_verdict_criteria_and_speed_against_profile(run: Path) -> None:
    """Breaks if the page begins with anything else, or a criterion is missing."""
    data = page_data(open_recording(run))
    sections, _ = run_sections(data)
    assert sections[0].anchor == "verdict"
    labels = [item.label.value.partition(" (")[0] for item in sections[0].placed[0].figure.above[0].items]
    assert {"train", "profile", "permitted speed"} <= set(labels) and len(labels) == 4
    assert main(["report", str(run)]) == 0
    page = (run / "report.html").read_text()
    first = page[page.index("<main>") : page.index('<section id="summary">')]
    (text,) = re.findall(r'<p class="verdict incomplete">(.*?)</p>', first)
    assert text.startswith("incomplete: no stop was due; overspeed 0 km/h; couplers ")
    assert len(re.findall(r'<div class="card ', first)) == len(criterion_cells([data])) == 6
    assert first.count('<div class="readout"') == 1


def test_a_far_limit_does_not_squash_the_speed(run: Path) -> None:
    """Breaks if the limit of 80 km/h sets the axis of a train at 8 km/h, or the figure does not say where it is."""
    sections, _ = run_sections(page_data(open_recording(run)))
    plot = sections[0].placed[0].figure
    named = {item.label.value: item.renderers[0] for item in plot.above[0].items}
    (limit,) = [renderer for label, renderer in named.items() if label.startswith("speed limit (outside: 80")]
    assert limit not in plot.y_range.renderers
    assert named["train"] in plot.y_range.renderers and named["profile"] in plot.y_range.renderers
    assert plot.y_range.start == 0.0


def test_a_train_that_runs_backwards_has_an_axis_below_zero(tmp_path: Path) -> None:
    """Breaks if a negative speed is cut off."""
    back = drive(tmp_path, "back", "freight_consensus", "--set=duration=22")
    sections, _ = run_sections(page_data(open_recording(back)))
    assert sections[0].placed[0].figure.y_range.start != 0.0


def test_failed_criteria_are_first_with_time_and_place(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a failed criterion is behind a passed one, or the page or ``info`` has no place of its worst value."""
    kept = {"criterion": "stop_window", "metric": "stop_error_max_m", "value": 0.1, "limit": 0.5, "passed": True}
    broken = {"criterion": "jerk", "metric": "jerk_1s_max", "value": 0.2, "limit": 0.1, "passed": False}
    places = {"at_s": 1234.56, "km": 123.4567}
    page = judged("one", 0.1, "failed", criteria=[kept, {**broken, **places}])
    first, second = criterion_cells([page, judged("other", 0.2)])[:2]
    assert first.words == "jerk over 1 s, largest"
    assert first.cells[0] == ("0.2 m/s³", "failed", " at 1234.6 s, km 123.457")
    assert second.cells[0] == ("0.1 m", "passed", "")
    print_summary({**page.summary, "stops": []}, "one")
    printed = capsys.readouterr().out
    assert "jerk over 1 s 0.2 m/s³ (limit 0.1) at 1234.6 s, km 123.457; no stop was due" in printed
    (line,) = [line for line in printed.splitlines() if line.startswith("jerk_1s_max")]
    assert line.split() == ["jerk_1s_max", "0.2", "0.1", "1234.6", "123.457", "failed"]


def test_the_best_run_passes_and_then_has_the_smallest_error() -> None:
    """Breaks if a failed run with a small error is the best, or an unfinished one."""
    good, better, failed = judged("good", 0.3), judged("better", 0.2), judged("failed", 0.1, "failed")
    killed = judged("killed", 0.01, status="interrupted")
    pages = [failed, good, killed, better]
    assert best_text(pages).startswith("Best: better (passed, speed error 0.2 km/h rms)")
    ranked = sorted(pages, key=lambda data: rank_of(data.summary))
    assert [data.label for data in ranked] == ["better", "good", "failed", "killed"]
    lost = judged("lost", 0.05, tracking="lost", tracking_findings=[{"outcome": "lost", "text": "900 m behind"}])
    ranked = sorted([lost, *pages], key=lambda data: rank_of(data.summary))
    assert [data.label for data in ranked][-2:] == ["lost", "killed"]
    assert best_text([good]) == "" and best_text([good, judged("other", 0.4, scenario="metro")]) == ""


def test_the_best_value_has_the_smallest_magnitude() -> None:
    """Breaks if a buff of -900 kN is better than -400 kN, or a metric without a good direction has a best value."""
    runs = [{"coupler_buff_max_kn": -900.0, "wall_s": 1.0}, {"coupler_buff_max_kn": -400.0, "wall_s": 2.0}, {}]
    assert best_value("coupler_buff_max_kn", runs) == 400.0
    assert [difference_from_best("coupler_buff_max_kn", run, runs) for run in runs] == [500.0, 0.0, None]
    assert best_value("wall_s", runs) is None
    assert best_value("coupler_buff_max_kn", [runs[0], runs[0]]) is None


def test_a_comparison_marks_the_best_values(tmp_path: Path) -> None:
    """Breaks if no value, or that of another run, is marked."""
    pages = [judged("one", 0.25), judged("two", 0.125)]
    write_comparison_page(pages, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    row = re.search(r"<tr[^>]*><td>speed error, rms</td>(.*?)</tr>", page, re.DOTALL)
    assert row is not None
    cells = re.findall(r'<td class="value( best)?">([^<]*)<span class="delta">([^<]*)</span>', row[1])
    assert cells == [("", "0.250", "+0.125"), (" best", "0.125", "best")]
    assert [entry.label for entry in verdict_texts(pages)] == ["one", "two"]


def test_laws_of_a_comparison_are_sorted() -> None:
    """Breaks if the table has the order of the arguments."""
    laws = ta.compare("demo", ["pid", "smc"], set={"duration": 30}, progress=False).laws
    errors = [law.metrics["speed_rmse_kmh"] for law in laws]
    assert len(errors) == 2 and errors == sorted(errors)


def test_signs_of_a_page() -> None:
    """Breaks if a hyphen in a word becomes a minus."""
    assert typeset("couplers -413 ... +505 kN (limits -1400)") == "couplers −413 … +505 kN (limits −1400)"
    assert typeset("hxd1-c80 2-3") == "hxd1-c80 2-3"


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with browser() as opened:
        yield opened


@pytest.mark.campaign
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_the_page_fits_the_screen_and_its_colours(run: Path, page: Page, width: int, scheme: str) -> None:
    """Breaks if the page scrolls sideways, or a figure is white on a dark page; the cursor fills the line above it."""
    assert main(["report", str(run)]) == 0
    page.console.clear()
    page.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    page.open((run / "report.html").as_uri(), width, 900)
    page.wait_for("Bokeh.documents.length > 0 && Bokeh.documents[0].is_idle")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    wanted = "#1a2027" if scheme == "dark" else "#ffffff"
    page.wait_for(f"[...Bokeh.index].find(v => v.model.type === 'Figure').model.background_fill_color === '{wanted}'")
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(18, 23, 28)") == (scheme == "dark")
    left, top, wide, high = page.evaluate(
        "(() => { const box = document.querySelector('.figure').getBoundingClientRect();"
        " return [box.left, box.top, box.width, box.height]; })()"
    )
    page.mouse("mouseMoved", left + wide / 2, top + 0.7 * high)
    readout = "[...document.querySelectorAll('.readout')].map(line => line.textContent).join('')"
    assert "profile" in page.wait_for(readout)
    assert page.console == []


def test_a_run_that_is_not_tracked_is_marked_as_failed() -> None:
    """Breaks if a lost train with passed criteria has a green line, or its line lacks the outcome."""
    lost = judged("lost", 0.05, tracking="lost", tracking_findings=[{"outcome": "lost", "text": "900 m behind"}])
    (text,) = verdict_texts([lost])
    assert text.state == "failed" and text.text.startswith("lost: 900 m behind; passed (1 criterion): ")
    (text,) = verdict_texts([judged("good", 0.05, tracking="tracked", tracking_findings=[])])
    assert text.state == "passed" and text.text.startswith("passed (1 criterion): ")
