"""Strip charts of speed, speed error, force and coupler forces over the last minutes."""

from __future__ import annotations

from itertools import accumulate
from typing import Any

from bokeh.models import BasicTickFormatter, ColumnDataSource, DataRange1d, Range1d
from bokeh.plotting import figure

from train_ato.apps.report.style import time_formatter, time_ticker
from train_ato.apps.view.feed import Mark
from train_ato.apps.view.hover import add_hover
from train_ato.apps.view.snapshot import STRIP
from train_ato.apps.view.style import (
    APPLIED,
    BUFF,
    DEMAND,
    DRAFT,
    EMERGENCY,
    FAINT,
    LIMIT,
    MARK,
    PERMITTED,
    PROFILE,
    SOFT,
    TRAIN,
)

LABEL_STEP, LABEL_LEVELS = 13, 5
"""Distance [px] and number of the levels of the event labels."""


class Strips:
    """Strip charts and their data sources.

    Attributes
    ----------
    source
        Rows of :data:`train_ato.apps.view.snapshot.STRIP`.
    marks
        Events: time, label, and vertical offset of the label against overlap.
    span : Range1d
        Range of the times in view [s]; it moves in the browser.
    figures
        Charts from top to bottom.
    """

    def __init__(
        self, now: ColumnDataSource, several: bool, hours: bool, tools: dict[str, Any], *, supervised: bool = False
    ) -> None:
        self.source = ColumnDataSource({name: [] for name in STRIP})
        self.marks = ColumnDataSource({"time": [], "label": [], "drop": []})
        self.span = Range1d(0.0, 180.0)
        self._now = now
        self._hours = hours
        self._tools = tools
        speed = self._chart("km/h", "strip_speed")
        speed.line("time", "profile", source=self.source, line_color=PROFILE, line_width=3.2, line_alpha=0.7)
        speed.line("time", "limit", source=self.source, line_color=LIMIT, line_width=1.4, line_dash=[6, 4])
        if supervised:
            for name, colour in (("permitted", PERMITTED), ("emergency", EMERGENCY)):
                speed.line("time", name, source=self.source, line_color=colour, line_width=1.2)
        train = speed.line("time", "speed", source=self.source, line_color=TRAIN, line_width=1.6)
        # The labels have their own range: otherwise the range of the speed would include them.
        speed.extra_y_ranges = {"labels": Range1d(0.0, 1.0)}
        speed.text(
            x="time", y=1.0, y_range_name="labels", text="label", source=self.marks, x_offset=4, y_offset="drop",
            text_color=MARK, text_font_size="11px", text_baseline="top",
        )  # fmt: skip
        error = self._chart("error km/h", "strip_error")
        error.hspan(y=0, line_color=SOFT, line_width=1)
        deviation = error.line("time", "error", source=self.source, line_color=TRAIN, line_width=1.4)
        force = self._chart("force kN", "strip_force")
        force.varea("time", "least", "most", source=self.source, fill_color=FAINT, fill_alpha=0.7)
        force.line("time", "demand", source=self.source, line_color=DEMAND, line_width=1.2)
        applied = force.line("time", "applied", source=self.source, line_color=APPLIED, line_width=1.5)
        self.figures = [speed, error, force]
        limits = [("permitted", "@permitted{0.0} km/h"), ("EBI", "@emergency{0.0} km/h")] if supervised else []
        place = ("front", "@place{0.000} km")
        speeds = [("train", "@speed{0.0} km/h"), ("profile", "@profile{0.0} km/h"), ("limit", "@limit{0} km/h")]
        add_hover(speed, train, [place, *speeds, *limits], clock="time")
        add_hover(error, deviation, [place, ("error", "@error{+0.00} km/h")], clock="time")
        add_hover(force, applied, [("command", "@demand{0} kN"), ("applied", "@applied{0} kN")], clock="time")
        if several:
            coupler = self._chart("couplers kN", "strip_coupler")
            coupler.varea("time", "buff", "draft", source=self.source, fill_color=SOFT, fill_alpha=0.10)
            draft = coupler.line("time", "draft", source=self.source, line_color=DRAFT, line_width=1.3)
            coupler.line("time", "buff", source=self.source, line_color=BUFF, line_width=1.3)
            coupler.hspan(y=0, line_color=SOFT, line_width=1)
            self.figures.append(coupler)
            add_hover(coupler, draft, [("draft", "@draft{0} kN"), ("buff", "@buff{0} kN")], clock="time")
        for plot in self.figures[:-1]:
            plot.xaxis.visible = False

    def show_marks(self, marks: list[Mark]) -> None:
        """Show the events; labels that follow each other are on different levels."""
        numbers = accumulate(bool(mark.label) for mark in marks)
        self.marks.data = {
            "time": [mark.time for mark in marks],
            "label": [mark.label for mark in marks],
            "drop": [2 + LABEL_STEP * ((number - 1) % LABEL_LEVELS) for number in numbers],
        }

    def _chart(self, label: str, name: str) -> Any:
        plot = figure(
            x_range=self.span,
            y_range=DataRange1d(only_visible=True, range_padding=0.15, min_interval=0.2),
            y_axis_label=label,
            window_axis="x",
            name=name,
            min_border_left=66,
            **self._tools,
        )
        plot.xaxis.ticker = time_ticker()
        plot.xaxis.formatter = time_formatter(hours=self._hours)
        plot.yaxis.formatter = BasicTickFormatter(use_scientific=False)
        plot.yaxis.ticker.desired_num_ticks = 4
        plot.vspan(x="time", source=self.marks, line_color=MARK, line_width=1.2, line_dash=[4, 3])
        plot.vspan(x="time", source=self._now, line_color=SOFT, line_width=1)
        return plot
