"""Bokeh figure of grade, height, curves and tunnels over distance."""

from __future__ import annotations

import numpy as np
from bokeh.models import ColumnDataSource, HoverTool, LegendItem, LinearAxis, Range1d

from train_ato.apps.report.quantities import GREY, INK, PURPLE, QUANTITIES
from train_ato.apps.report.style import Figure, Linked, add_page_legend, style_axis
from train_ato.apps.report.track_shape import TrackShape


def track_figure(linked: Linked, shape: TrackShape) -> Figure:
    """Return grade, height and curves over distance."""
    plot = linked.over_distance("grade", 200)
    steps = ColumnDataSource(
        {
            "left": shape.place[:-1],
            "right": shape.place[1:],
            "grade": shape.grade[:-1],
            "height": shape.height[:-1],
            "height_end": shape.height[1:],
        }
    )
    bars = plot.quad(
        left="left", right="right", top="grade", bottom=0, source=steps, fill_color=GREY, fill_alpha=0.45,
        line_color=INK, line_alpha=0.5,
    )  # fmt: skip
    span = max(float(np.ptp(shape.height)), 1.0)
    plot.extra_y_ranges = {
        "height": Range1d(float(shape.height.min()) - 0.1 * span, float(shape.height.max()) + 0.1 * span)
    }
    side = LinearAxis(y_range_name="height", axis_label="height in m")
    style_axis(side)
    plot.add_layout(side, "right")
    look = QUANTITIES["height"]
    heights = plot.line(shape.place, shape.height, line_color=look.colour, line_width=1.8, y_range_name="height")
    items = [
        LegendItem(label="grade (left)", renderers=[bars]),
        LegendItem(label="height above the start (right)", renderers=[heights]),
    ]
    plot.add_tools(
        HoverTool(
            renderers=[bars],
            mode="vline",
            tooltips=[
                ("from", "@left{0.000} km"),
                ("to", "@right{0.000} km"),
                ("grade", "@grade{0.0} ‰"),
                ("height at its start", "@height{0.0} m"),
            ],
            point_policy="follow_mouse",
        )
    )
    strips = _curves(plot, shape)
    items += strips
    plot.y_range.renderers = [bars, *(item.renderers[0] for item in strips)]
    add_page_legend(plot, items)
    return plot


def _curves(plot: Figure, shape: TrackShape) -> list[LegendItem]:
    """Draw curves and tunnels as strips along the bottom."""
    items = []
    low = min(0.0, float(shape.grade.min()))
    band = 0.07 * max(float(np.ptp(np.append(shape.grade, 0.0))), 1.0)
    if shape.curves:
        begin, end, radius = (np.array(part) for part in zip(*shape.curves, strict=True))
        source = ColumnDataSource({"begin": begin, "end": end, "radius": radius})
        strip = plot.quad(left="begin", right="end", bottom=low - 2 * band, top=low - band, source=source, color=PURPLE)
        plot.add_tools(
            HoverTool(
                renderers=[strip],
                tooltips=[("curve", "@begin{0.000} … @end{0.000} km"), ("radius", "@radius{0} m")],
            )
        )
        items.append(LegendItem(label="curve", renderers=[strip]))
    if shape.tunnels:
        begin, end = (np.array(part) for part in zip(*shape.tunnels, strict=True))
        source = ColumnDataSource({"begin": begin, "end": end})
        strip = plot.quad(
            left="begin", right="end", bottom=low - 3.4 * band, top=low - 2.4 * band, source=source, color=INK
        )
        plot.add_tools(HoverTool(renderers=[strip], tooltips=[("tunnel", "@begin{0.000} … @end{0.000} km")]))
        items.append(LegendItem(label="tunnel", renderers=[strip]))
    return items
