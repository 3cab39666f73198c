"""Bokeh figures of lines from arrays, independent of runs and pages."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh import models
from bokeh.events import MouseLeave, MouseMove, Tap

from train_ato.messages.types import Array
from train_ato.program.display_units import shown_name
from train_ato.report import quantities as q
from train_ato.report.events import Event
from train_ato.report.page import HEIGHT, Figure, Linked, add_page_legend
from train_ato.report.page_data import MAX_CODE, HeatMap, TrackShape

Table = tuple[models.ColumnDataSource, Sequence[q.Trace]]
"""Table with a horizontal column and the lines of a figure."""


def source_of(time: Array, columns: dict[str, Array]) -> models.ColumnDataSource:
    """Return a table of single-precision columns; the page stores it as bytes."""
    data = {"time": time, **columns}
    return models.ColumnDataSource({name: np.asarray(values, dtype=np.float32) for name, values in data.items()})


def _add_tips(plot: Figure, drawn: Any, tips: Sequence[tuple[str, str]], linked: Linked | None = None) -> None:
    """Show values of a glyph under the pointer; ``linked`` shows ``begin`` and ``end`` as times of the run."""
    clocks = {f"@{name}": linked.clock() for name in ("begin", "end")} if linked else {}
    plot.add_tools(models.HoverTool(renderers=[drawn], tooltips=list(tips), formatters=clocks))


def line_figure(
    linked: Linked, axis: str, tables: Sequence[Table], height: int = HEIGHT, *, whole: bool = False
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
        for trace in traces:
            drawn = _line(plot, source, trace, "time")
            items.append(models.LegendItem(label=trace.look.words, renderers=[drawn]))
            lines.append((trace.column, np.asarray(source.data[trace.column]), drawn))
        sides = ("envelope_low", "envelope_high") if bands else ()
        lines += [(side, np.asarray(source.data[side]), bands[0].renderers[0]) for side in sides]
    add_readout(plot, tables)
    if not whole:
        _fit_range(plot, axis, lines, items)
    add_page_legend(plot, items)
    return plot


def _fit_range(plot: Figure, axis: str, lines: Sequence[tuple[str, Array, Any]], items: list[Any]) -> None:
    """Set the begin of the axis and the lines that it follows; a bound outside of the frame has its value as label."""
    found = q.axis_range(axis, [(column, values) for column, values, _ in lines])
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


def _line(plot: Figure, source: models.ColumnDataSource, trace: q.Trace, over: str) -> Any:
    look = trace.look
    if trace.column in q.FILLED and look == q.style_of(trace.column):
        plot.varea(x=over, y1=0, y2=trace.column, source=source, fill_color=look.colour, fill_alpha=0.22)
    return plot.line(
        x=over, y=trace.column, source=source, line_color=look.colour, line_width=look.width, line_dash=look.dash,
        line_join="round", line_alpha=0.65 if look.width > 2.5 else 1.0,
    )  # fmt: skip


def _band(plot: Figure, source: models.ColumnDataSource) -> list[models.LegendItem]:
    """Draw the envelope of the table as a band."""
    if "envelope_high" not in source.data:
        return []
    band = plot.varea(
        x="time", y1="envelope_low", y2="envelope_high", source=source, fill_color=q.GREY, fill_alpha=0.16,
        level="underlay",
    )  # fmt: skip
    return [models.LegendItem(label="envelope (nominal)", renderers=[band])]


def distance_figure(
    linked: Linked,
    tables: Sequence[Table],
    profiles: Sequence[tuple[Array, Array]],
    limits: tuple[Array, Array] | None,
    axis: str = "speed",
    height: int = 300,
) -> Figure:
    """Return speed over distance with the complete profiles and the limits of the line, or another quantity."""
    plot = linked.over_distance(axis, height)
    items: list[Any] = []
    if limits is not None:
        look = q.QUANTITIES["line_limit"]
        drawn = plot.line(*limits, line_color=look.colour, line_dash=look.dash, line_width=look.width)
        items.append(models.LegendItem(label=look.words, renderers=[drawn]))
    for index, (place, speed) in enumerate(profiles):
        look = q.QUANTITIES["profile" if index == 0 else "replanned"]
        drawn = plot.line(
            np.asarray(place, np.float32), np.asarray(speed, np.float32), line_color=look.colour,
            line_dash=look.dash, line_width=look.width, line_alpha=0.65,
        )  # fmt: skip
        if index < 2:
            items.append(models.LegendItem(label=look.words, renderers=[drawn]))
    for source, traces in tables:
        lines = ((trace, _line(plot, source, trace, "position_km")) for trace in traces)
        items += [models.LegendItem(label=trace.look.words, renderers=[drawn]) for trace, drawn in lines]
    add_readout(plot, tables, "position_km")
    if axis == "speed" and all(float(np.nanmin(speed)) > -1.0 for _, speed in profiles):
        plot.y_range.start = 0.0
    add_page_legend(plot, items)
    return plot


def mark_stations(plot: Figure, stations: Sequence[tuple[float, str]]) -> Figure:
    """Mark the stations of the line in a figure over distance, with their names; return the figure."""
    for place, name in stations:
        inside = place > stations[0][0] and place == stations[-1][0]  # left of the line that ends the figure
        plot.add_layout(
            models.Span(location=place, dimension="height", line_color=q.INK, line_dash="dotted", line_width=1)
        )
        label = models.Label(
            x=place, y=4, y_units="screen", text=name, angle=90, angle_units="deg", x_offset=-2 if inside else 12,
            text_font=q.FONT, text_font_size="11px", text_color=q.INK,
        )  # fmt: skip
        plot.add_layout(label)
    return plot


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
    show = models.CustomJS(args=arguments, code=_SHOW)
    plot.js_on_event(MouseMove, show)
    plot.js_on_event(Tap, show)
    plot.js_on_event(MouseLeave, models.CustomJS(args={"name": plot.id, "over": over}, code=_HIDE))


MAP_ROW = 2.6
"""Height per vehicle [pixels]; the height of the map is :data:`MAP_LEAST` to :data:`MAP_MOST`."""
MAP_LEAST, MAP_MOST = 150, 340


def heat_figure(linked: Linked, picture: HeatMap, heat: q.Heat, largest: float | None = None) -> Figure:
    """Return a picture of all vehicles over time, the front of the train on top.

    ``largest`` is the value of the strongest colour; default: the largest of this picture.
    """
    picture = picture if largest is None else picture.scaled(largest)
    count = picture.codes.shape[0]
    height = int(np.clip(MAP_ROW * count, MAP_LEAST, MAP_MOST)) + 90
    plot = linked.over_time(
        heat.rows, height, tinted=False, y_range=models.Range1d(count - 0.5, -0.5, bounds=(-0.5, count - 0.5))
    )
    colours = q.buff_to_draft() if heat.signed else q.none_to_full()
    low = -MAX_CODE if heat.signed else 0
    image = plot.image(
        image=[picture.codes],
        x=picture.begin,
        y=-0.5,
        dw=picture.end - picture.begin,
        dh=count,
        color_mapper=models.LinearColorMapper(palette=colours, low=low, high=MAX_CODE, low_color=q.NOTHING),
        level="image",
    )
    scale = models.LinearColorMapper(
        palette=colours, low=-picture.largest if heat.signed else 0.0, high=picture.largest
    )
    title = q.axis_title(f"{heat.words} in kN{': buff < 0 < draft' if heat.signed else ''}")
    bar = models.ColorBar(color_mapper=scale, title=title, location="top_left", orientation="horizontal")
    plot.add_layout(bar, "above")
    cell = models.CustomJSHover(
        args={"unit": picture.unit}, code="return value < -127 ? '–' : (value * unit).toFixed(1)"
    )
    plot.add_tools(
        models.HoverTool(
            tooltips=[("time", "$x{custom}"), (heat.rows, "$y{custom}"), (heat.words, shown_name("@image{custom} kN"))],
            formatters={
                "$x": linked.clock(),
                "$y": models.CustomJSHover(code="return String(Math.round(value))"),
                "@image": cell,
            },
            renderers=[image],
            attachment="horizontal",
        )
    )
    plot.yaxis.ticker = models.AdaptiveTicker(mantissas=[1, 2, 5], min_interval=1)
    plot.ygrid.visible = False
    plot.xgrid.visible = False
    return plot


def event_figure(linked: Linked, events: Sequence[Event]) -> Figure:
    """Return the events over time, one row per kind; hiding a kind hides its marks in all figures."""
    kinds = [kind for kind in q.KINDS if any(event.kind == kind for event in events)]
    y_range = models.Range1d(len(kinds) - 0.4, -0.6)
    plot = linked.over_time("", 76 + 22 * len(kinds), marked=False, y_range=y_range)
    plot.yaxis.ticker = models.FixedTicker(ticks=[])
    plot.ygrid.visible = False
    items = []
    for row, kind in enumerate(kinds):
        moments, stretches = linked.marks[kind]
        colour = q.KINDS[kind].colour
        dots = plot.scatter(
            x="begin", y=row, source=moments, marker="inverted_triangle", size=11, color=colour, line_color=None
        )
        bars = plot.hbar(y=row, left="begin", right="end", height=0.5, source=stretches, color=colour, line_width=2)
        dots.js_on_change("visible", models.CustomJS(args={"marks": linked.marked[kind]}, code=_HIDE_MARKS))
        shown = [dots, bars] if moments.data["begin"] else [bars, dots]
        items.append(models.LegendItem(label=q.KINDS[kind].words, renderers=shown))
        for renderer, tips in ((dots, [("at", "@begin{custom}")]), (bars, _FROM_TO)):
            _add_tips(plot, renderer, [("", "@text"), *tips], linked)
    add_page_legend(plot, items)
    return plot


def run_events_figure(linked: Linked, runs: Sequence[tuple[str, Sequence[Event]]]) -> Figure:
    """Return the events of several runs, one row per run, one colour per kind."""
    y_range = models.Range1d(len(runs) - 0.4, -0.6)
    plot = linked.over_time("", 76 + 24 * len(runs), y_range=y_range)
    plot.yaxis.ticker = models.FixedTicker(ticks=list(range(len(runs))))
    plot.yaxis.major_label_overrides = {
        row: name if len(name) <= 11 else f"{name[:10]}…" for row, (name, _) in enumerate(runs)
    }
    plot.ygrid.visible = False
    items = []
    for kind, words in q.KINDS.items():
        rows = [(row, event) for row, (_, events) in enumerate(runs) for event in events if event.kind == kind]
        if not rows:
            continue
        source = models.ColumnDataSource(
            {
                "row": [row for row, _ in rows],
                "begin": [event.begin for _, event in rows],
                "end": [event.begin if event.end is None else event.end for _, event in rows],
                "text": [event.text for _, event in rows],
                "run": [runs[row][0] for row, _ in rows],
            }
        )
        bars = plot.hbar(
            y="row", left="begin", right="end", height=0.5, source=source, fill_color=words.colour,
            line_color=words.colour, line_width=3,
        )  # fmt: skip
        items.append(models.LegendItem(label=words.words, renderers=[bars]))
        _add_tips(plot, bars, [("", "@text"), ("run", "@run"), *_FROM_TO], linked)
    add_page_legend(plot, items)
    return plot


_HIDE_MARKS = "for (const mark of marks) mark.visible = cb_obj.visible"
_FROM_TO = [("from", "@begin{custom}"), ("to", "@end{custom}")]


def track_figure(linked: Linked, shape: TrackShape) -> Figure:
    """Return grade, height and curves over distance."""
    plot = linked.over_distance("grade", 200)
    steps = models.ColumnDataSource(
        {
            "left": shape.place[:-1],
            "right": shape.place[1:],
            "grade": shape.grade[:-1],
            "height": shape.height[:-1],
            "height_end": shape.height[1:],
        }
    )
    bars = plot.quad(
        left="left", right="right", top="grade", bottom=0, source=steps, fill_color=q.GREY, fill_alpha=0.45,
        line_color=q.INK, line_alpha=0.5,
    )  # fmt: skip
    span = max(float(np.ptp(shape.height)), 1.0)
    plot.extra_y_ranges = {
        "height": models.Range1d(float(shape.height.min()) - 0.1 * span, float(shape.height.max()) + 0.1 * span)
    }
    plot.add_layout(models.LinearAxis(y_range_name="height", axis_label=q.axis_title("height in m")), "right")
    look = q.QUANTITIES["height"]
    heights = plot.line(shape.place, shape.height, line_color=look.colour, line_width=1.8, y_range_name="height")
    items = [
        models.LegendItem(label="grade (left)", renderers=[bars]),
        models.LegendItem(label="height above the start (right)", renderers=[heights]),
    ]
    plot.add_tools(
        models.HoverTool(
            renderers=[bars],
            mode="vline",
            tooltips=[
                ("from", shown_name("@left{0.000} km")),
                ("to", shown_name("@right{0.000} km")),
                ("grade", "@grade{0.0} ‰"),
                ("height at its start", shown_name("@height{0.0} m")),
            ],
            point_policy="follow_mouse",
        )
    )
    strips = _curves(plot, shape)
    items += strips
    plot.y_range.renderers = [bars, *(item.renderers[0] for item in strips)]
    add_page_legend(plot, items)
    return plot


def _curves(plot: Figure, shape: TrackShape) -> list[models.LegendItem]:
    """Draw curves and tunnels as strips along the bottom."""
    items = []
    low = min(0.0, float(shape.grade.min()))
    band = 0.07 * max(float(np.ptp(np.append(shape.grade, 0.0))), 1.0)
    rows: Sequence[Sequence[float]]
    for label, rows, below, color in (("curve", shape.curves, 1.0, q.PURPLE), ("tunnel", shape.tunnels, 2.4, q.INK)):
        if rows:
            columns = zip(("begin", "end", "radius"), map(np.array, zip(*rows, strict=True)), strict=False)
            source = models.ColumnDataSource(dict(columns))
            ends = {"bottom": low - (below + 1.0) * band, "top": low - below * band}
            strip = plot.quad(left="begin", right="end", **ends, source=source, color=color)
            tips = [(label, shown_name("@begin{0.000} … @end{0.000} km")), ("radius", shown_name("@radius{0} m"))]
            _add_tips(plot, strip, tips[: len(rows[0]) - 1])
            items.append(models.LegendItem(label=label, renderers=[strip]))
    return items
