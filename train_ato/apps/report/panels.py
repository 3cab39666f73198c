"""Bokeh figures of lines from arrays, independent of runs and pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.events import MouseLeave, MouseMove, Tap
from bokeh.models import ColumnDataSource, CustomJS, LegendItem

from train_ato.apps.report.axis_range import axis_range
from train_ato.apps.report.quantities import FILLED, GREY, QUANTITIES, Trace
from train_ato.apps.report.style import HEIGHT, Figure, Linked, add_page_legend
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
    *,
    whole: bool = False,
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
    whole
        True for a figure of limits: the axis holds all of them.
    """
    plot = linked.over_time(axis, height)
    items: list[Any] = []
    lines: list[tuple[str, Array, Any]] = []
    for source, traces in tables:
        bands = _band(plot, source)
        items += bands
        drawn = [_line(plot, source, trace, "time") for trace in traces]
        items += [LegendItem(label=t.look.words, renderers=[r]) for t, r in zip(traces, drawn, strict=True)]
        lines += [(t.column, np.asarray(source.data[t.column]), r) for t, r in zip(traces, drawn, strict=True)]
        sides = ("envelope_low", "envelope_high") if bands else ()
        lines += [(side, np.asarray(source.data[side]), bands[0].renderers[0]) for side in sides]
    add_readout(plot, tables)
    if not whole:
        _fit_range(plot, axis, lines, items)
    add_page_legend(plot, items)
    return plot


def _fit_range(plot: Figure, axis: str, lines: Sequence[tuple[str, Array, Any]], items: list[Any]) -> None:
    """Set the begin of the axis and the lines that it follows; a bound outside of the frame has its value as label."""
    found = axis_range(axis, [(column, values) for column, values, _ in lines])
    if found.from_zero:
        plot.y_range.start = 0.0
    if not found.far:
        return
    far = {id(drawn) for column, _, drawn in lines if column in found.far}
    plot.y_range.renderers = list({id(drawn): drawn for _, _, drawn in lines if id(drawn) not in far}.values())
    remarks = {id(drawn): found.remark(column) for column, _, drawn in lines}
    for item in items:
        if remark := remarks.get(id(item.renderers[0])):
            item.label = {"value": f"{item.label.value}{remark}"}


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
    add_readout(plot, tables, "position_km")
    if all(float(np.nanmin(speed)) > -1.0 for _, speed in profiles):
        plot.y_range.start = 0.0
    add_page_legend(plot, items)
    return plot


Table = tuple[ColumnDataSource, Sequence[Trace]]
_SHOW = "window.trainAto?.readout(name, tables, cb_obj.x, over)"
_HIDE = "window.trainAto?.readout(name, [], null, over)"


def add_readout(plot: Figure, tables: Sequence[Table], over: str = "time") -> None:
    """Show the values of all lines at the cursor above the figure.

    Parameters
    ----------
    plot
        The figure; the element ``readout-ID`` of the page belongs to it.
    tables
        Tables and the lines of each.
    over
        Column of the horizontal axis: ``time`` [s] or ``position_km``.
    """
    listed = [
        [source, [[t.column, t.look.words, t.look.unit, t.look.digits, t.look.colour] for t in traces]]
        for source, traces in tables
        if traces
    ]
    arguments = {"name": plot.id, "tables": listed, "over": over}
    show = CustomJS(args=arguments, code=_SHOW)
    plot.js_on_event(MouseMove, show)
    plot.js_on_event(Tap, show)
    plot.js_on_event(MouseLeave, CustomJS(args={"name": plot.id, "over": over}, code=_HIDE))
