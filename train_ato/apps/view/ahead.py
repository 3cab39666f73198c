"""Figures of the line ahead: profile, speed limits, stop, grades and train over the place."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from plant_sim.units import KMH
from train_ato.apps.report.downsample import after_jump
from train_ato.apps.view.facts import Facts, ProfileCurve
from train_ato.apps.view.hover import add_hover
from train_ato.apps.view.planned import is_current, plan_columns
from train_ato.apps.view.style import DEMAND, DOWNHILL, LIMIT, PROFILE, SOFT, STOP, TEXT, TRAIN, UPHILL
from train_ato.control.contract import LawPlan

MOST_KNOTS = 4000
FAR = 1e4
"""Place to which the last step of limit and grade is drawn [km]."""


class Ahead:
    """Figures of speed and grade over the place.

    Attributes
    ----------
    figures
        Speed over the place, and grade over the place.
    span : Range1d
        Range of the places in view [km]; it moves with the train in the browser.
    """

    def __init__(self, now: ColumnDataSource, strip: ColumnDataSource, facts: Facts, tools: dict[str, Any]) -> None:
        self.span = Range1d(-0.3, 2.0)
        self._profile = ColumnDataSource({"place": [], "speed": []})
        self._limit = ColumnDataSource({"place": [], "speed": []})
        self._plan = ColumnDataSource({"place": [], "speed": []}, name="plan")
        self._planned: LawPlan | None = None
        self.heights = Range1d(0.0, 100.0)
        speed = figure(x_range=self.span, y_range=self.heights, y_axis_label="km/h", name="ahead", **tools)
        speed.varea(x="place", y1=0, y2="speed", source=self._profile, fill_color=PROFILE, fill_alpha=0.10)
        profile = speed.line("place", "speed", source=self._profile, line_color=PROFILE, line_width=2.4)
        add_hover(speed, profile, [("front", "@place{0.000} km"), ("profile", "@speed{0.0} km/h")])
        speed.step("place", "speed", source=self._limit, mode="after", line_color=LIMIT, line_width=2.2)
        plan = speed.line("place", "speed", source=self._plan, line_color=DEMAND, line_width=2, line_dash=[5, 3])
        add_hover(speed, plan, [("plan of the law", "@speed{0.0} km/h")])
        speed.line("place", "speed", source=strip, line_color=TRAIN, line_width=1.6)
        speed.vspan(x="stop", source=now, line_color=STOP, line_width=3)
        speed.text(
            x="stop", y=0, text={"value": "STOP"}, source=now, x_offset=-6, y_offset=-4, text_align="right",
            text_color=STOP, text_font_size="12px", text_font_style="bold",
        )  # fmt: skip
        speed.vspan(x="place", source=now, line_color=TRAIN, line_width=1, line_dash=[2, 3])
        speed.segment(x0="rear", x1="place", y0=0, y1=0, source=now, line_color=TRAIN, line_width=9)
        speed.scatter("place", "speed", source=now, marker="circle", size=11, fill_color=TRAIN, line_color=TEXT)
        speed.xaxis.visible = False
        self.figures = (speed, _grade(self.span, facts, now, tools))
        self.show_limits(facts)

    def show_limits(self, facts: Facts) -> None:
        """Draw the speed limits."""
        if facts.limit_places.size:
            places = np.concatenate((facts.limit_places / 1e3, [FAR]))
            speeds = np.concatenate((facts.limit_speeds, facts.limit_speeds[-1:])) * KMH
            self._limit.data = {"place": places, "speed": speeds}

    def show_plan(self, plan: LawPlan | None, time: float, facts: Facts) -> None:
        """Draw the planned speed of the law at a simulated time [s]; one that does not hold any more disappears."""
        shown = plan if plan is not None and is_current(plan, time) else None
        if shown is not self._planned:
            self._planned = shown
            self._plan.data = plan_columns(shown, time, facts)

    def show_profile(self, profile: ProfileCurve, facts: Facts, scale: float) -> None:
        """Draw a profile over the place of the front of the train, downsampled; the last knot is kept."""
        begin, last = after_jump(profile.time, profile.position, profile.velocity), profile.time.size - 1
        chosen = np.unique(np.linspace(begin, last, min(last - begin + 1, MOST_KNOTS)).astype(int))
        self._profile.data = {
            "place": (profile.position[chosen] + facts.nose) / 1e3,
            "speed": KMH * profile.velocity[chosen],
        }
        low = KMH * float(profile.velocity.min())
        self.heights.start = min(-0.04 * scale, 1.1 * low)
        self.heights.end = 1.06 * scale


def _grade(span: Range1d, facts: Facts, now: ColumnDataSource, tools: dict[str, Any]) -> Any:
    """Return the figure of the grades; empty for an unknown line."""
    begins = facts.grade_places / 1e3
    ends = np.concatenate((begins[1:], [FAR])) if begins.size else begins
    grades = facts.grades
    source = ColumnDataSource(
        {
            "begin": begins,
            "end": ends,
            "grade": grades,
            "middle": (begins + np.minimum(ends, begins + 2.0)) / 2,
            "colour": [UPHILL if grade > 0 else DOWNHILL for grade in grades],
            "text": [f"{grade:+.1f}".replace("+0.0", "0").replace("-0.0", "0") for grade in grades],
        }
    )
    lowest = 1.3 * min(-2.0, float(grades.min(initial=0.0)))
    highest = 1.6 * max(2.0, float(grades.max(initial=0.0)))
    plot = figure(
        x_range=span,
        y_range=Range1d(lowest, max(highest, -0.5 * lowest)),
        y_axis_label="‰",
        x_axis_label="km",
        name="grade",
        **tools,
    )
    plot.yaxis.ticker.desired_num_ticks = 3
    steps = plot.quad(
        left="begin", right="end", bottom=0, top="grade", source=source, fill_color="colour", line_color=None
    )
    add_hover(plot, steps, [("from", "@begin{0.000} km"), ("grade", "@grade{+0.0} ‰")], across=False)
    plot.text(
        x="middle", y=plot.y_range.end, text="text", source=source, y_offset=3, text_align="center",
        text_baseline="top", text_font_size="10px", text_color=TEXT,
    )  # fmt: skip
    plot.segment(x0="rear", x1="place", y0=0, y1=0, source=now, line_color=TRAIN, line_width=5)
    plot.vspan(x="stop", source=now, line_color=STOP, line_width=3)
    plot.hspan(y=0, line_color=SOFT, line_width=1)
    return plot
