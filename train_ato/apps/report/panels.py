"""Figures of lines for a browser, made from arrays.

They know nothing of runs and pages; whoever has arrays can use them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from bokeh.models import (
    ColumnDataSource,
    HoverTool,
    LegendItem,
)

from train_ato.report.quantities import (
    FROM_ZERO,
    GREY,
    OF_ONE,
    QUANTITIES,
    RUN_COLOURS,
    Quantity,
)
from train_ato.report.style import HEIGHT, Figure, Linked, legend_above, number
from train_ato.types import Array

FILLED = ("draft", "buff")
"""Lines with the ground down to zero tinted."""


@dataclass(frozen=True)
class Trace:
    """One line of a figure: which column, and how it is shown."""

    column: str
    look: Quantity


def traces_of(columns: Sequence[str]) -> list[Trace]:
    """Return the looks of columns that are named by their quantity, ``quantity:3`` being that of unit 3."""
    traces = []
    for column in columns:
        name, _, unit = column.partition(":")
        look = QUANTITIES.get(name)
        if look is None:
            continue
        if unit:
            colour = RUN_COLOURS[int(unit) % len(RUN_COLOURS)]
            dash = "dashed" if name == "truth" else look.dash
            look = replace(look, words=f"{look.words.removesuffix(OF_ONE)}, unit {unit}", colour=colour, dash=dash)
        traces.append(Trace(column, look))
    return traces


def source_of(time: Array, columns: dict[str, Array]) -> ColumnDataSource:
    """Return a table of single-precision columns; the page carries it as bytes, not as text."""
    data = {"time": time, **columns}
    return ColumnDataSource({name: np.asarray(values, dtype=np.float32) for name, values in data.items()})


def line_figure(
    linked: Linked,
    axis: str,
    tables: Sequence[tuple[ColumnDataSource, Sequence[Trace]]],
    height: int = HEIGHT,
    *,
    over: str = "time",
    title: str = "",
) -> Figure:
    """Return a figure of lines.

    Parameters
    ----------
    linked
        What the page's figures share.
    axis
        Key of the y axis' title in ``quantities``, or the title.
    tables
        Tables with a column ``time`` [s] (over distance ``position_km``), and which lines to draw of each.
    over
        ``time`` or ``position_km``.
    title
        Said in the hover before the values, for example the name of a run; with one table it is not needed.
    """
    plot = linked.over_time(axis, height) if over == "time" else linked.over_distance(axis, height)
    if axis in FROM_ZERO:
        plot.y_range.start = 0.0
    items: list[Any] = []
    for source, traces in tables:
        items += _band(plot, source, over)
        drawn = [_line(plot, source, trace, over) for trace in traces]
        items += [LegendItem(label=t.look.words, renderers=[r]) for t, r in zip(traces, drawn, strict=True)]
        if drawn:
            plot.add_tools(_hover(linked, source, traces, drawn, title))
    legend_above(plot, items)
    return plot


def _line(plot: Figure, source: ColumnDataSource, trace: Trace, over: str) -> Any:
    look = trace.look
    if trace.column in FILLED and look == QUANTITIES[trace.column]:
        plot.varea(x=over, y1=0, y2=trace.column, source=source, fill_color=look.colour, fill_alpha=0.22)
    return plot.line(
        x=over, y=trace.column, source=source, line_color=look.colour, line_width=look.width, line_dash=look.dash,
        line_join="round", line_alpha=0.65 if look.width > 2.5 else 1.0,
    )  # fmt: skip


def _band(plot: Figure, source: ColumnDataSource, over: str) -> list[LegendItem]:
    """Tint the envelope, where the table has one."""
    if "envelope_high" not in source.data:
        return []
    band = plot.varea(
        x=over, y1="envelope_low", y2="envelope_high", source=source, fill_color=GREY, fill_alpha=0.16, level="underlay"
    )
    return [LegendItem(label="envelope (nominal)", renderers=[band])]


def _hover(
    linked: Linked, source: ColumnDataSource, traces: Sequence[Trace], drawn: Sequence[Any], title: str
) -> HoverTool:
    """Return a hover that says all values of a table at the cursor."""
    filled = [int(np.isfinite(np.asarray(source.data[trace.column])).sum()) for trace in traces]
    tips = [(title or "time", "@time{custom}")]
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
    height: int = 300,
) -> Figure:
    """Return speed over distance with the whole profiles, also where they were not driven, and the line's limits."""
    plot = linked.over_distance("speed", height)
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
            plot.add_tools(_hover(linked, source, traces, drawn_traces, ""))
    legend_above(plot, items)
    return plot
