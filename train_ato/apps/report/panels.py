"""Bokeh figures of lines from arrays, independent of runs and pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import (
    ColumnDataSource,
    HoverTool,
    LegendItem,
)

from train_ato.apps.report.quantities import (
    FILLED,
    FROM_ZERO,
    GREY,
    QUANTITIES,
    Trace,
)
from train_ato.apps.report.style import HEIGHT, Figure, Linked, add_page_legend, number
from train_ato.messages.types import Array


def source_of(time: Array, columns: dict[str, Array]) -> ColumnDataSource:
    """Return a table of single-precision columns; the page stores it as bytes."""
    data = {"time": time, **columns}
    return ColumnDataSource({name: np.asarray(values, dtype=np.float32) for name, values in data.items()})


def line_figure(
    linked: Linked,
    axis: str,
    tables: Sequence[tuple[ColumnDataSource, Sequence[Trace]]],
    height: int = HEIGHT,
) -> Figure:
    """Return a figure of lines.

    Parameters
    ----------
    linked
        Shared axes and events of the page.
    axis
        Key of the y axis' title in ``quantities``, or the title.
    tables
        Tables with a column ``time`` [s], and the lines of each.
    """
    plot = linked.over_time(axis, height)
    if axis in FROM_ZERO:
        plot.y_range.start = 0.0
    items: list[Any] = []
    for source, traces in tables:
        items += _band(plot, source)
        drawn = [_line(plot, source, trace, "time") for trace in traces]
        items += [LegendItem(label=t.look.words, renderers=[r]) for t, r in zip(traces, drawn, strict=True)]
        if drawn:
            plot.add_tools(_hover(linked, source, traces, drawn))
    add_page_legend(plot, items)
    return plot


def _line(plot: Figure, source: ColumnDataSource, trace: Trace, over: str) -> Any:
    look = trace.look
    if trace.column in FILLED and look == QUANTITIES[trace.column]:
        plot.varea(x=over, y1=0, y2=trace.column, source=source, fill_color=look.colour, fill_alpha=0.22)
    return plot.line(
        x=over, y=trace.column, source=source, line_color=look.colour, line_width=look.width, line_dash=look.dash,
        line_join="round", line_alpha=0.65 if look.width > 2.5 else 1.0,
    )  # fmt: skip


def _band(plot: Figure, source: ColumnDataSource) -> list[LegendItem]:
    """Draw the envelope of the table as a band."""
    if "envelope_high" not in source.data:
        return []
    band = plot.varea(
        x="time", y1="envelope_low", y2="envelope_high", source=source, fill_color=GREY, fill_alpha=0.16,
        level="underlay",
    )  # fmt: skip
    return [LegendItem(label="envelope (nominal)", renderers=[band])]


def _hover(linked: Linked, source: ColumnDataSource, traces: Sequence[Trace], drawn: Sequence[Any]) -> HoverTool:
    """Return a tooltip with all values of a table at the cursor."""
    filled = [int(np.isfinite(np.asarray(source.data[trace.column])).sum()) for trace in traces]
    tips = [("time", "@time{custom}")]
    formatters: dict[str, Any] = {"@time": linked.clock()}
    if "position_km" in source.data:
        tips.append(("position", "@position_km{0.000} km"))
    for trace in traces:
        tips.append((trace.look.words, f"@{{{trace.column}}}{{custom}} {trace.look.unit}"))
        formatters[f"@{{{trace.column}}}"] = number(trace.look.digits)
    return HoverTool(
        tooltips=tips,
        formatters=formatters,
        mode="vline",
        line_policy="nearest",
        renderers=[drawn[int(np.argmax(filled))]],
        point_policy="follow_mouse",
        attachment="horizontal",
    )


def distance_figure(
    linked: Linked,
    tables: Sequence[tuple[ColumnDataSource, Sequence[Trace]]],
    profiles: Sequence[tuple[Array, Array]],
    limits: tuple[Array, Array] | None,
) -> Figure:
    """Return speed over distance with the complete profiles and the limits of the line."""
    plot = linked.over_distance("speed", 300)
    items: list[Any] = []
    if limits is not None:
        look = QUANTITIES["line_limit"]
        drawn = plot.line(*limits, line_color=look.colour, line_dash=look.dash, line_width=look.width)
        items.append(LegendItem(label=look.words, renderers=[drawn]))
    for index, (place, speed) in enumerate(profiles):
        look = QUANTITIES["profile" if index == 0 else "replanned"]
        drawn = plot.line(
            np.asarray(place, np.float32), np.asarray(speed, np.float32), line_color=look.colour,
            line_dash=look.dash, line_width=look.width, line_alpha=0.65,
        )  # fmt: skip
        if index < 2:
            items.append(LegendItem(label=look.words, renderers=[drawn]))
    for source, traces in tables:
        drawn_traces = [_line(plot, source, trace, "position_km") for trace in traces]
        items += [LegendItem(label=t.look.words, renderers=[r]) for t, r in zip(traces, drawn_traces, strict=True)]
        if drawn_traces:
            plot.add_tools(_hover(linked, source, traces, drawn_traces))
    add_page_legend(plot, items)
    return plot
