"""Time at the cursor: values in the bar below the title, and place in the figures over distance."""

from __future__ import annotations

from dataclasses import dataclass

from bokeh.events import MouseLeave, MouseMove
from bokeh.models import ColumnDataSource, CustomJS, Span

from train_ato.apps.report.quantities import VERMILION
from train_ato.apps.report.style import Figure, Linked

_FIND = """
    const nearest = (column, value) => {
        let low = 0, high = column.length - 1;
        while (high - low > 1) {
            const middle = (low + high) >> 1;
            if (column[middle] <= value) low = middle; else high = middle;
        }
        return value - column[low] <= column[high] - value ? low : high;
    };
"""
_OVER_TIME = (
    _FIND
    + """
    const time = cb_obj.x, values = [];
    let place = null;
    for (const [source, column, digits] of fields) {
        const row = nearest(source.data.time, time), value = source.data[column][row];
        values.push(Number.isFinite(value) ? value.toFixed(digits) : "–");
        if (column === "position_km") place = value;
    }
    window.trainAto?.show(time, values);
    for (const span of places) { span.location = place; span.visible = place !== null; }
"""
)
_OVER_DISTANCE = (
    _FIND
    + """
    const column = speed.data.position_km;
    let best = 0;
    for (let row = 1; row < column.length; row++)
        if (Math.abs(column[row] - cb_obj.x) < Math.abs(column[best] - cb_obj.x)) best = row;
    const time = speed.data.time[best], values = [];
    for (const [source, column, digits] of fields) {
        const value = source.data[column][nearest(source.data.time, time)];
        values.push(Number.isFinite(value) ? value.toFixed(digits) : "–");
    }
    window.trainAto?.show(time, values);
    for (const span of times) { span.location = time; span.visible = true; }
"""
)


@dataclass(frozen=True)
class Reading:
    """One value of the bar: source, column, label, unit and digits."""

    source: ColumnDataSource
    column: str
    words: str
    unit: str
    digits: int


def follow_cursor(linked: Linked, readings: list[Reading]) -> None:
    """Show the values at the cursor in the bar, and its time or place in the other figures.

    Parameters
    ----------
    linked
        The page's figures.
    readings
        Values of the bar; ``position_km`` among them converts between time and distance.
    """
    linked.readings = [(reading.words, reading.unit) for reading in readings]
    if not readings:
        return
    fields = [[reading.source, reading.column, reading.digits] for reading in readings]
    times, places = _spans(linked.figures_over_time), _spans(linked.figures_over_distance)
    show = CustomJS(args={"fields": fields, "places": places}, code=_OVER_TIME)
    hide = CustomJS(args={"spans": [*times, *places]}, code="for (const span of spans) span.visible = false")
    for plot in linked.figures_over_time:
        plot.js_on_event(MouseMove, show)
        plot.js_on_event(MouseLeave, hide)
    along = next((reading.source for reading in readings if reading.column == "position_km"), None)
    if along is None:
        return
    find = CustomJS(args={"fields": fields, "speed": along, "times": times}, code=_OVER_DISTANCE)
    for plot in linked.figures_over_distance:
        plot.js_on_event(MouseMove, find)
        plot.js_on_event(MouseLeave, hide)


def _spans(figures: list[Figure]) -> list[Span]:
    """Add a line for the cursor of another figure to every figure."""
    spans = []
    for plot in figures:
        span = Span(dimension="height", location=0, visible=False, line_color=VERMILION, line_width=1.5, line_alpha=0.8)
        plot.add_layout(span)
        spans.append(span)
    return spans
