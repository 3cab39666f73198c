"""Bokeh heat map of all vehicles over time."""

from __future__ import annotations

import numpy as np
from bokeh.models import AdaptiveTicker, ColorBar, CustomJSHover, HoverTool, LinearColorMapper, Range1d

from train_ato.apps.report.downsample import LARGEST_CODE, HeatMap
from train_ato.apps.report.quantities import FONT, INK, Heat, buff_to_draft, none_to_full
from train_ato.apps.report.style import Figure, Linked

MAP_ROW = 2.6
"""Height per vehicle [pixels]; the height of the map is :data:`MAP_LEAST` to :data:`MAP_MOST`."""
MAP_LEAST, MAP_MOST = 150, 340
NOTHING = "#b9c0c7"
"""Colour of times without messages."""


def heat_figure(linked: Linked, picture: HeatMap, heat: Heat, largest: float | None = None) -> Figure:
    """Return a picture of all vehicles over time, the front of the train on top.

    ``largest`` is the value of the strongest colour; default: the largest of this picture.
    """
    picture = picture if largest is None else picture.scaled(largest)
    count = picture.codes.shape[0]
    height = int(np.clip(MAP_ROW * count, MAP_LEAST, MAP_MOST)) + 90
    plot = linked.over_time(
        heat.rows, height, tinted=False, y_range=Range1d(count - 0.5, -0.5, bounds=(-0.5, count - 0.5))
    )
    colours = buff_to_draft() if heat.signed else none_to_full()
    low = -LARGEST_CODE if heat.signed else 0
    image = plot.image(
        image=[picture.codes],
        x=picture.begin,
        y=-0.5,
        dw=picture.end - picture.begin,
        dh=count,
        color_mapper=LinearColorMapper(palette=colours, low=low, high=LARGEST_CODE, low_color=NOTHING),
        level="image",
    )
    scale = LinearColorMapper(palette=colours, low=-picture.largest if heat.signed else 0.0, high=picture.largest)
    plot.add_layout(_colour_bar(scale, f"{heat.words} in kN{': buff < 0 < draft' if heat.signed else ''}"), "above")
    cell = CustomJSHover(args={"unit": picture.unit}, code="return value < -127 ? '–' : (value * unit).toFixed(1)")
    plot.add_tools(
        HoverTool(
            tooltips=[
                ("time", "$x{custom}"),
                (heat.rows, "$y{custom}"),
                (heat.words, "@image{custom} kN"),
            ],
            formatters={
                "$x": linked.clock(),
                "$y": CustomJSHover(code="return String(Math.round(value))"),
                "@image": cell,
            },
            renderers=[image],
            attachment="horizontal",
        )
    )
    plot.yaxis.ticker = AdaptiveTicker(mantissas=[1, 2, 5], min_interval=1)
    plot.ygrid.visible = False
    plot.xgrid.visible = False
    return plot


def _colour_bar(mapper: LinearColorMapper, title: str) -> ColorBar:
    return ColorBar(
        color_mapper=mapper,
        orientation="horizontal",
        title=title,
        title_text_font=FONT,
        title_text_font_size="12px",
        title_text_font_style="normal",
        title_text_color=INK,
        title_standoff=4,
        major_label_text_font=FONT,
        major_label_text_font_size="11px",
        height=10,
        width=420,
        location="top_left",
        padding=4,
        background_fill_color=None,
        bar_line_color=None,
    )
