"""Speed dial with needle, gauge of the supervision and profile arc; bar of the total force within its envelope."""

import math
from itertools import accumulate
from typing import Any

import numpy as np
from bokeh.models import BasicTickFormatter, ColumnDataSource, CustomJSHover, DataRange1d, HoverTool, Range1d
from bokeh.plotting import figure

from plant_sim.units import KMH
from train_ato.control.contract import LawPlan
from train_ato.report.page import time_formatter, time_ticker
from train_ato.report.page_data import after_jump
from train_ato.view import style
from train_ato.view.facts import Facts, ProfileCurve, is_current, plan_columns
from train_ato.view.feed import Mark
from train_ato.view.snapshot import DIAL_BEGIN, DIAL_SWEEP, LIMIT_NAMES, STRIP, angle

_CLOCK = """
const s = Math.abs(value), h = Math.floor(s / 3600), m = Math.floor(s / 60) % 60;
return (value < 0 ? "-" : "") + `${h}:${String(m).padStart(2, "0")}:${(s % 60).toFixed(1).padStart(4, "0")}`;
"""


def add_hover(plot: Any, renderer: Any, rows: list[tuple[str, str]], *, across: bool = True, clock: str = "") -> None:
    """Add the values of the nearest row of a renderer's source to a figure.

    Parameters
    ----------
    plot, renderer
        Figure, and the glyph whose source has the columns.
    rows
        Name and Bokeh format of every value.
    across
        True: the row at the abscissa of the pointer; False: the glyph under the pointer.
    clock
        Column in seconds that is shown as a time of the run.
    """
    time = [("time", f"@{clock}{{custom}}")] if clock else []
    tool = HoverTool(
        renderers=[renderer],
        tooltips=[*time, *rows],
        formatters={f"@{clock}": CustomJSHover(code=_CLOCK)} if clock else {},
        mode="vline" if across else "mouse",
        # Beside the line, not on it, and in no way under the pointer of a finger.
        attachment="horizontal",
        point_policy="follow_mouse",
        line_policy="nearest",
        muted_policy="ignore",
    )
    plot.add_tools(tool)


MAX_KNOTS = 4000
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
        speed.varea(x="place", y1=0, y2="speed", source=self._profile, fill_color=style.PROFILE, fill_alpha=0.10)
        profile = speed.line("place", "speed", source=self._profile, line_color=style.PROFILE, line_width=2.4)
        add_hover(speed, profile, [("front", "@place{0.000} km"), ("profile", "@speed{0.0} km/h")])
        speed.step("place", "speed", source=self._limit, mode="after", line_color=style.LIMIT, line_width=2.2)
        plan = speed.line("place", "speed", source=self._plan, line_color=style.DEMAND, line_width=2, line_dash=[5, 3])
        add_hover(speed, plan, [("plan of the law", "@speed{0.0} km/h")])
        speed.line("place", "speed", source=strip, line_color=style.TRAIN, line_width=1.6)
        speed.vspan(x="stop", source=now, line_color=style.STOP, line_width=3)
        speed.text(
            x="stop", y=0, text={"value": "STOP"}, source=now, x_offset=-6, y_offset=-4, text_align="right",
            text_color=style.STOP, text_font_size="12px", text_font_style="bold",
        )  # fmt: skip
        speed.vspan(x="place", source=now, line_color=style.TRAIN, line_width=1, line_dash=[2, 3])
        speed.segment(x0="rear", x1="place", y0=0, y1=0, source=now, line_color=style.TRAIN, line_width=9)
        speed.scatter(
            "place", "speed", source=now, marker="circle", size=11, fill_color=style.TRAIN, line_color=style.TEXT
        )
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
        chosen = np.unique(np.linspace(begin, last, min(last - begin + 1, MAX_KNOTS)).astype(int))
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
            "colour": [style.UPHILL if grade > 0 else style.DOWNHILL for grade in grades],
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
        text_baseline="top", text_font_size="10px", text_color=style.TEXT,
    )  # fmt: skip
    plot.segment(x0="rear", x1="place", y0=0, y1=0, source=now, line_color=style.TRAIN, line_width=5)
    plot.vspan(x="stop", source=now, line_color=style.STOP, line_width=3)
    plot.hspan(y=0, line_color=style.SOFT, line_width=1)
    return plot


LABEL_STEP, LABEL_LEVELS = 13, 5
"""Distance [px] and number of the levels of the event labels."""


class Strips:
    """Strip charts and their data sources.

    Attributes
    ----------
    source
        Rows of :data:`train_ato.view.snapshot.STRIP`.
    marks
        Events: time, label, and vertical offset of the label against overlap.
    span : Range1d
        Range of the times in view [s]; it moves in the browser.
    figures
        Charts from top to bottom.
    """

    def __init__(
        self, now: ColumnDataSource, *, several: bool, hours: bool, tools: dict[str, Any], supervised: bool = False
    ) -> None:
        self.source = ColumnDataSource({name: [] for name in STRIP})
        self.marks = ColumnDataSource({"time": [], "label": [], "drop": []})
        self.span = Range1d(0.0, 180.0)
        self._now = now
        self._hours = hours
        self._tools = tools
        speed = self._chart("km/h", "strip_speed")
        speed.line("time", "profile", source=self.source, line_color=style.PROFILE, line_width=3.2, line_alpha=0.7)
        speed.line("time", "limit", source=self.source, line_color=style.LIMIT, line_width=1.4, line_dash=[6, 4])
        if supervised:
            for name, colour in (("permitted", style.PERMITTED), ("emergency", style.EMERGENCY)):
                speed.line("time", name, source=self.source, line_color=colour, line_width=1.2)
        train = speed.line("time", "speed", source=self.source, line_color=style.TRAIN, line_width=1.6)
        # The labels have their own range: otherwise the range of the speed would include them.
        speed.extra_y_ranges = {"labels": Range1d(0.0, 1.0)}
        speed.text(
            x="time", y=1.0, y_range_name="labels", text="label", source=self.marks, x_offset=4, y_offset="drop",
            text_color=style.MARK, text_font_size="11px", text_baseline="top",
        )  # fmt: skip
        error = self._chart("error km/h", "strip_error")
        error.hspan(y=0, line_color=style.SOFT, line_width=1)
        deviation = error.line("time", "error", source=self.source, line_color=style.TRAIN, line_width=1.4)
        force = self._chart("force kN", "strip_force")
        force.varea("time", "least", "most", source=self.source, fill_color=style.FAINT, fill_alpha=0.7)
        force.line("time", "demand", source=self.source, line_color=style.DEMAND, line_width=1.2)
        applied = force.line("time", "applied", source=self.source, line_color=style.APPLIED, line_width=1.5)
        self.figures = [speed, error, force]
        limits = [("permitted", "@permitted{0.0} km/h"), ("EBI", "@emergency{0.0} km/h")] if supervised else []
        place = ("front", "@place{0.000} km")
        speeds = [("train", "@speed{0.0} km/h"), ("profile", "@profile{0.0} km/h"), ("limit", "@limit{0} km/h")]
        add_hover(speed, train, [place, *speeds, *limits], clock="time")
        add_hover(error, deviation, [place, ("error", "@error{+0.00} km/h")], clock="time")
        add_hover(force, applied, [("command", "@demand{0} kN"), ("applied", "@applied{0} kN")], clock="time")
        if several:
            coupler = self._chart("couplers kN", "strip_coupler")
            coupler.varea("time", "buff", "draft", source=self.source, fill_color=style.SOFT, fill_alpha=0.10)
            draft = coupler.line("time", "draft", source=self.source, line_color=style.DRAFT, line_width=1.3)
            coupler.line("time", "buff", source=self.source, line_color=style.BUFF, line_width=1.3)
            coupler.hspan(y=0, line_color=style.SOFT, line_width=1)
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
        plot.vspan(x="time", source=self.marks, line_color=style.MARK, line_width=1.2, line_dash=[4, 3])
        plot.vspan(x="time", source=self._now, line_color=style.SOFT, line_width=1)
        return plot


SIZE = 270
_TARGET = "#4b535b"
"""Gauge below the speed of the next target: dark grey of ERA_ERTMS_015560."""
DIAL_END = DIAL_BEGIN - DIAL_SWEEP


def dial(now: ColumnDataSource, ticks: ColumnDataSource, *, supervised: bool = False) -> Any:
    """Return the speed dial, bound to the row of the snapshot and to the ticks of its scale.

    The rim has permitted, target and intervention speed in the colours of the state, the thin arc inside the profile;
    ``supervised`` adds a ring outside with all limits of the supervisor.
    """
    plot = figure(
        frame_width=SIZE,
        frame_height=round(SIZE * 0.9),
        x_range=Range1d(-1.10, 1.10),
        y_range=Range1d(-0.88, 1.10),
        tools="",
        toolbar_location=None,
        min_border_left=0,
        min_border_right=0,
        min_border_top=0,
        min_border_bottom=0,
        outline_line_color=None,
        name="dial",
    )
    plot.below, plot.left, plot.center = [], [], []
    ring = {"x": 0, "y": 0, "source": now, "line_color": None}
    plot.annular_wedge(
        x=0, y=0, inner_radius=0.93, outer_radius=1.0, start_angle=DIAL_END, end_angle=DIAL_BEGIN,
        fill_color="#22384c", line_color=None,
    )  # fmt: skip
    # after ERA_ERTMS_015560, 8.2.1: permitted speed with its hook, target, and the range up to the intervention
    for begin, end, colour in (
        ("above_angle", "gauge_angle", {"fill_color": "above_colour", "fill_alpha": "above_alpha"}),
        ("target_angle", DIAL_BEGIN, {"fill_color": _TARGET}),
        ("gauge_angle", "target_angle", {"fill_color": "gauge_colour"}),
    ):
        plot.annular_wedge(inner_radius=0.93, outer_radius=1.0, start_angle=begin, end_angle=end, **colour, **ring)
    plot.ray(
        x=0, y=0, length=1.0, angle="gauge_angle", source=now, line_color="gauge_colour", line_width=6,
        line_alpha="hooked",
    )  # fmt: skip
    plot.ray(
        x=0, y=0, length=1.07, angle="limit_angle", source=now, line_color=style.LIMIT, line_width=3,
        line_alpha="limited",
    )  # fmt: skip
    if supervised:
        _add_limits_of_supervisor(plot, ring)
    plot.circle(x=0, y=0, radius=0.87, fill_color=style.PANE, line_color=None)
    plot.annular_wedge(
        inner_radius=0.835, outer_radius=0.855, start_angle="profile_angle", end_angle=DIAL_BEGIN,
        fill_color=style.PROFILE, **ring,
    )  # fmt: skip
    plot.segment("x0", "y0", "x1", "y1", source=ticks, line_color=style.SOFT, line_width="width")
    plot.text(
        "x", "y", "text", source=ticks, text_align="center", text_baseline="middle", text_font_size="13px",
        text_color=style.TEXT,
    )  # fmt: skip
    plot.ray(x=0, y=0, length=0.66, angle="speed_angle", source=now, line_color="needle", line_width=9)
    plot.ray(x=0, y=0, length=0.91, angle="speed_angle", source=now, line_color="needle", line_width=3)
    plot.circle(x=0, y=0, radius=0.38, fill_color="#182838", line_color=style.EDGE, line_width=2)
    plot.text(
        x=0, y=0.03, text="speed_text", source=now, text_align="center", text_baseline="middle",
        text_font_size="44px", text_font_style="bold", text_color="needle",
    )  # fmt: skip
    plot.text(
        x=0, y=-0.235, text={"value": "km/h"}, text_align="center", text_baseline="middle", text_font_size="12px",
        text_color=style.SOFT,
    )  # fmt: skip
    return plot


def _add_limits_of_supervisor(plot: Any, ring: dict[str, Any]) -> None:
    """Add a ring outside the dial from the permitted speed over warning and service brake to the emergency brake."""
    for low, high, colour in zip(
        LIMIT_NAMES, LIMIT_NAMES[1:], (style.WARNING, style.SERVICE, style.EMERGENCY), strict=False
    ):
        plot.annular_wedge(
            inner_radius=1.015, outer_radius=1.075, start_angle=f"{high}_angle", end_angle=f"{low}_angle",
            fill_color=colour, **ring,
        )  # fmt: skip


def tick_columns(scale: float) -> dict[str, list[Any]]:
    """Return the ticks and numbers of a dial up to ``scale`` [km/h]."""
    step = next(step for step in (10, 20, 50, 100) if scale / step <= 10)
    minor = step // 2 if step > 10 else step / 2
    columns: dict[str, list[Any]] = {name: [] for name in ("x0", "y0", "x1", "y1", "width", "x", "y", "text")}
    for number in range(round(scale / minor) + 1):
        speed = number * minor
        major = number % round(step / minor) == 0
        at, inner = angle(speed, scale), 0.80 if major else 0.85
        cosine, sine = math.cos(at), math.sin(at)
        values = (inner * cosine, inner * sine, 0.905 * cosine, 0.905 * sine, 2.0 if major else 1.0)
        for name, value in zip(("x0", "y0", "x1", "y1", "width"), values, strict=True):
            columns[name].append(value)
        columns["x"].append(0.68 * cosine)
        columns["y"].append(0.68 * sine)
        columns["text"].append(f"{speed:g}" if major else "")
    return columns


def force_bar(now: ColumnDataSource, most: float, least: float) -> Any:
    """Return the bar of the force of all power units, from the largest brake to the largest traction force [N]."""
    known = math.isfinite(most) and math.isfinite(least)
    reach = (1.08 * least / 1e3, 1.08 * most / 1e3) if known and most > least else (-1000.0, 1000.0)
    plot = figure(
        width=SIZE + 12,
        height=52,
        x_range=Range1d(*reach),
        y_range=Range1d(-1, 1),
        tools="",
        toolbar_location=None,
        min_border_left=8,
        min_border_right=8,
        name="force",
    )
    plot.left, plot.center = [], []
    plot.xaxis.ticker.desired_num_ticks = 6
    plot.hbar(y=0, left="least", right="most", height=1.5, source=now, fill_color=style.FAINT, line_color=style.EDGE)
    plot.hbar(y=0, left=0, right="applied", height=1.0, source=now, fill_color=style.APPLIED, line_color=None)
    plot.segment(
        x0="demand", x1="demand", y0=-0.95, y1=0.95, source=now, line_color=style.DEMAND, line_width=4,
    )  # fmt: skip
    plot.segment(x0=0, x1=0, y0=-1, y1=1, line_color=style.SOFT, line_width=1)
    return plot
