"""Ranges of the axes, pressure at head and tail, and one style of all figures."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from report_runs import drive

from train_ato.apps.report.axis_range import axis_range
from train_ato.apps.report.curves import CURVES
from train_ato.apps.report.page_data import page_data
from train_ato.apps.report.print_parts import SHEET_SIZE, STYLE, styled
from train_ato.apps.report.run_figure import run_figure
from train_ato.apps.report.run_page import run_sections
from train_ato.log.recorded import open_recording
from train_ato.loop.recording import BRAKE_PIPE_TAIL
from train_ato.loop.series import TopicSamples

ROOT = Path(__file__).resolve().parents[1]
SPEED = np.array([0.0, 20.0, 30.0])


@pytest.fixture(scope="module")
def braked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    events = "brake={policy: planned, events: [{time: 20, reduction_kpa: 50}, {time: 40, reduction_kpa: 0}]}"
    return drive(tmp_path_factory.mktemp("axes"), "braked", "demo", "--set=duration=60", f"--set={events}")


def test_a_bound_far_above_the_lines_does_not_set_the_range() -> None:
    """Breaks if a limit squashes the curve, or a near one is cut off."""
    far = axis_range("speed", [("speed", SPEED), ("limit", np.array([80.0, 80.0, 60.0]))])
    assert (far.low, far.high, far.from_zero) == (0.0, 30.0, True)
    assert far.remark("limit") == " (outside: 60 or more)" and far.remark("speed") == ""
    near = axis_range("speed", [("speed", SPEED), ("limit", np.full(3, 40.0))])
    assert (near.high, near.far, near.remark("limit")) == (40.0, {}, "")


def test_a_bound_that_crosses_the_frame_has_no_remark() -> None:
    """Breaks if a limit that comes down to the speed is said to be outside of the frame."""
    found = axis_range("speed", [("speed", SPEED), ("permitted_speed", np.array([80.0, 50.0, 10.0]))])
    assert found.far == {"permitted_speed": 10.0} and found.remark("permitted_speed") == ""


def test_only_quantities_without_negative_values_begin_at_zero() -> None:
    """Breaks if the speed of a train that runs backwards is cut off, or an error axis begins at zero."""
    assert not axis_range("speed", [("speed", -SPEED)]).from_zero
    assert not axis_range("speed_error", [("speed_error", SPEED)]).from_zero
    empty = axis_range("speed", [("speed", np.full(3, np.nan)), ("limit", np.full(3, 80.0))])
    assert (empty.low, empty.high, empty.far) == (0.0, 80.0, {})


def test_the_figure_of_a_run_has_the_ranges_of_the_page(braked: Path) -> None:
    """Breaks if figure.png is squashed by the limit of 80 km/h."""
    figure = run_figure(open_recording(braked))
    assert figure is not None
    low, high = figure.axes[0].get_ylim()
    assert low == 0.0 and high < 20.0
    assert any("outside: 80" in text.get_text() for text in figure.axes[0].get_legend().get_texts())


def test_the_pressure_at_the_tail_is_beside_that_at_the_head(braked: Path) -> None:
    """Breaks if a recorded tail pressure is not drawn, or a log without it has no figure."""
    base = open_recording(braked)
    time, head = base.of("train/brake_pipe", "pressure")
    tail = TopicSamples(time, {"pressure": head - 7e3})
    found = CURVES["pipe"](replace(base, topics={**base.topics, BRAKE_PIPE_TAIL: tail}))
    np.testing.assert_allclose(found.columns["pipe"] - found.columns["pipe_tail"], 7.0)
    topics = {name: samples for name, samples in base.topics.items() if name != BRAKE_PIPE_TAIL}
    assert set(CURVES["pipe"](replace(base, topics=topics)).columns) == {"pipe_demand", "pipe"}


def test_no_tooltip_covers_a_curve(braked: Path) -> None:
    """Breaks if a figure of lines has a tooltip at the cursor in place of the line above it."""
    sections, _ = run_sections(page_data(open_recording(braked)))
    plots = {placed.heading: placed.figure for section in sections for placed in section.placed}
    lines = ("Speed against profile", "Speed over distance", "Speed error", "Extremes", "Brake pipe")
    for heading in lines:
        plot = plots[heading]
        assert not [tool for tool in plot.toolbar.tools if type(tool).__name__ == "HoverTool"], heading
        assert "mousemove" in plot.js_event_callbacks, heading


def test_all_figures_take_their_colours_from_one_table() -> None:
    """Breaks if a figure declares a colour of its own, or draws its own grid."""
    folders = ("train_ato/papers", "train_ato/apps/replay", "train_ato/apps/curves", "train_ato/apps/report")
    found = []
    for folder in (*folders, "msgs_docs/generate/law_pages"):
        for path in (ROOT / folder).rglob("*.py"):
            if path.name not in ("quantities.py", "heat_panel.py"):
                text = path.read_text(encoding="utf-8")
                found += [f"{path.name}: {match}" for match in re.findall(r'"#[0-9a-f]{6}"|\.grid\(alpha', text)]
    assert found == []


def test_a_sheet_has_the_style_of_print_with_larger_text() -> None:
    """Breaks if the sizes are not scaled together, or the style stays after the figure."""
    before = mpl.rcParams["axes.labelsize"]
    with styled(SHEET_SIZE):
        assert mpl.rcParams["font.size"] == SHEET_SIZE
        assert mpl.rcParams["legend.fontsize"] == pytest.approx(STYLE["legend.fontsize"] * SHEET_SIZE / 8.0)
        assert mpl.rcParams["axes.grid"]
    assert mpl.rcParams["axes.labelsize"] == before
