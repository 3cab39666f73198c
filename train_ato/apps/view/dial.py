"""Speed dial with needle, gauge of the supervision and profile arc; bar of the total force within its envelope."""

from __future__ import annotations

import math
from typing import Any

from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from train_ato.apps.view.snapshot import DIAL_BEGIN, DIAL_SWEEP, LIMIT_NAMES, angle
from train_ato.apps.view.style import (
    APPLIED,
    DEMAND,
    EDGE,
    EMERGENCY,
    FAINT,
    LIMIT,
    PANE,
    PROFILE,
    SERVICE,
    SOFT,
    TEXT,
    WARNING,
)

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
        x=0, y=0, length=1.07, angle="limit_angle", source=now, line_color=LIMIT, line_width=3, line_alpha="limited",
    )  # fmt: skip
    if supervised:
        _add_limits_of_supervisor(plot, ring)
    plot.circle(x=0, y=0, radius=0.87, fill_color=PANE, line_color=None)
    plot.annular_wedge(
        inner_radius=0.835, outer_radius=0.855, start_angle="profile_angle", end_angle=DIAL_BEGIN, fill_color=PROFILE,
        **ring,
    )  # fmt: skip
    plot.segment("x0", "y0", "x1", "y1", source=ticks, line_color=SOFT, line_width="width")
    plot.text(
        "x", "y", "text", source=ticks, text_align="center", text_baseline="middle", text_font_size="13px",
        text_color=TEXT,
    )  # fmt: skip
    plot.ray(x=0, y=0, length=0.66, angle="speed_angle", source=now, line_color="needle", line_width=9)
    plot.ray(x=0, y=0, length=0.91, angle="speed_angle", source=now, line_color="needle", line_width=3)
    plot.circle(x=0, y=0, radius=0.38, fill_color="#182838", line_color=EDGE, line_width=2)
    plot.text(
        x=0, y=0.03, text="speed_text", source=now, text_align="center", text_baseline="middle",
        text_font_size="44px", text_font_style="bold", text_color="needle",
    )  # fmt: skip
    plot.text(
        x=0, y=-0.235, text={"value": "km/h"}, text_align="center", text_baseline="middle", text_font_size="12px",
        text_color=SOFT,
    )  # fmt: skip
    return plot


def _add_limits_of_supervisor(plot: Any, ring: dict[str, Any]) -> None:
    """Add a ring outside the dial from the permitted speed over warning and service brake to the emergency brake."""
    for low, high, colour in zip(LIMIT_NAMES, LIMIT_NAMES[1:], (WARNING, SERVICE, EMERGENCY), strict=False):
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
    plot.hbar(y=0, left="least", right="most", height=1.5, source=now, fill_color=FAINT, line_color=EDGE)
    plot.hbar(y=0, left=0, right="applied", height=1.0, source=now, fill_color=APPLIED, line_color=None)
    plot.segment(
        x0="demand", x1="demand", y0=-0.95, y1=0.95, source=now, line_color=DEMAND, line_width=4,
    )  # fmt: skip
    plot.segment(x0=0, x1=0, y0=-1, y1=1, line_color=SOFT, line_width=1)
    return plot
