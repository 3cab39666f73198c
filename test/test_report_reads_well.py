"""Readability of a report: digits of small numbers, colours of heat maps, width of tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chromium import browser
from report_runs import drive

from train_ato.apps.report.delays import _without_saturation
from train_ato.apps.report.page_data import PageData, page_data
from train_ato.apps.report.run_page import run_sections
from train_ato.apps.report.summary_rows import GROUPS, filled_groups, shown
from train_ato.apps.report.words import longer
from train_ato.apps.report.writing import write_comparison_page
from train_ato.cli import main
from train_ato.log.recorded import open_recording
from train_ato.loop.recording import Recording
from train_ato.messages.types import Diagnostic

ROWS = {row.key: row for _, rows in GROUPS for row in rows}
GUST = "--set=plant.disturbances=[{kind: gust, begin: 4, end: 8, acceleration: -0.02}]"


@pytest.fixture(scope="module")
def gusty(tmp_path_factory: pytest.TempPathFactory) -> PageData:
    """Run twelve seconds of the demo with a gust."""
    return page_data(open_recording(drive(tmp_path_factory.mktemp("gusty"), "run", "demo", "--set=duration=12", GUST)))


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("coupler_draft_max_kn", 552.4, "552"),
        ("coupler_draft_max_kn", 0.1649, "0.16"),
        ("position_rmse_m", 0.00342, "0.0034"),
        ("position_rmse_m", 1e-12, "0.00"),
        ("stop_error_m", -0.000117, "−0.00012"),
        ("replans", 0, "0"),
        ("stop_error_m", None, "–"),
    ],
)
def test_a_small_figure_is_no_nought(key: str, value: float | None, text: str) -> None:
    """Breaks if an error of 3 mm is shown as 0.00 m."""
    assert shown(ROWS[key], {key: value}) == text


def test_a_train_of_one_vehicle_has_no_figures_of_couplers(tmp_path: Path) -> None:
    """Breaks if the report of a train without couplers shows coupler forces of 0 kN."""
    summary = page_data(open_recording(drive(tmp_path, "metro", "xuzhou_metro", "--set=duration=5"))).summary
    found = {row.key for _, rows in filled_groups([summary]) for row, _ in rows}
    assert "energy_traction_kwh" in found
    assert not {"coupler_draft_max_kn", "coupler_buff_max_kn"} & found


def test_events_leave_the_colours_of_a_heat_map_alone(gusty: PageData) -> None:
    """Breaks if the band of a gust covers the coupler forces and changes their colours."""
    sections, _ = run_sections(gusty)
    figures = [placed.figure for section in sections for placed in section.placed]
    fills: dict[bool, set[str | None]] = {True: set(), False: set()}
    for figure in figures:
        kinds = [(type(drawn.glyph).__name__, drawn.glyph) for drawn in figure.renderers]
        fills["Image" in dict(kinds)] |= {glyph.fill_color for kind, glyph in kinds if kind == "VStrip"}
    assert fills[True] == {None}
    assert fills[False]
    assert None not in fills[False]


def test_no_delay_is_told_of_a_force_that_a_limit_cut() -> None:
    """Breaks if a force that follows its envelope to standstill is identified as a force without delay."""
    totals = zip((0, 10, 20, 30, 40), ("0.0", "0.0", "0.0", "8.0", "8.0"), strict=True)
    reports = tuple(Diagnostic(at * 10**9, "plant", 0, "", {"saturated": total}) for at, total in totals)
    _, delay = _without_saturation(Recording(kept_reports=reports), np.array([5.0, 15.0, 25.0, 35.0]), np.full(4, 0.4))
    assert np.isnan(delay).tolist() == [False, False, True, False]


@pytest.mark.parametrize(
    ("factor", "add", "words"),
    [
        (1.0, 0.4, "command delay 0.4 s longer"),
        (1.0, -0.2, "command delay 0.2 s shorter"),
        (1.5, 0.0, "command delay times 1.5"),
        (2.0, 0.1, "command delay times 2, then 0.1 s longer"),
    ],
)
def test_a_longer_delay_in_words(factor: float, add: float, words: str) -> None:
    """Breaks if the text of an addition contains the factor 1."""
    assert longer(factor, add) == words


@pytest.mark.campaign
def test_the_table_of_many_runs_can_be_read(gusty: PageData, tmp_path: Path) -> None:
    """Breaks if the columns of seven runs are too narrow for their names."""
    names = [f"line_of_a_long_name_{letter}" for letter in "abcdefg"]
    runs = [replace(gusty, label=f"run {name[-1]}", facts={**gusty.facts, "line": name}) for name in names]
    write_comparison_page(runs, tmp_path / "seven.html")
    with browser() as page:
        page.open((tmp_path / "seven.html").as_uri(), 1720, 1000)
        page.wait_for("document.querySelectorAll('.facts td').length > 0")
        cells = page.evaluate(
            "[...document.querySelectorAll('.facts tr')].map(r => [...r.cells].map(c => c.innerText))"
        )
        rows = {row[0]: row[1:] for row in cells}
        assert rows["run"] == [run.label for run in runs]
        assert rows["line"] == names
        assert rows["seed"] == ["1 in all runs"]
        line = "[...document.querySelectorAll('.facts tr')].find(r => r.cells[0].innerText == 'line')"
        assert page.evaluate(f"{line}.getBoundingClientRect().height") < 30, "a name is cut into pieces"
        assert page.console == []


@pytest.mark.campaign
def test_compare_names_no_folder_that_is_gone(tmp_path: Path) -> None:
    """Breaks if the page of a comparison has the paths of temporary folders."""
    out = tmp_path / "compared"
    assert main(["compare", "demo", "--laws=pid,smc", "--set=duration=5", f"--out={out}", "--json"]) == 0
    assert "train_ato_compare_" not in (out / "comparison.html").read_text()
