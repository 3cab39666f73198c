"""Page as one HTML file without network access: text, tables, figures and the Bokeh library."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bokeh import models
from bokeh.events import DoubleTap
from bokeh.plotting import figure as bokeh_figure

from train_ato.program.display_units import display_unit, shown_name, shown_texts
from train_ato.report.events import Event
from train_ato.report.quantities import FAINT, FONT, INK, KINDS, axis_title

Figure = Any
"""A Bokeh figure; its classes are created at run time."""

LEFT, RIGHT = 92, 64
"""Margins of every frame [pixels]; they are equal, so equal times are above each other."""
SECOND_AXIS = 32
"""Additional right margin of figures over distance, for a second axis [pixels]."""
HEIGHT = 230
CURSOR = {"line_color": INK, "line_width": 1, "line_alpha": 0.75, "line_dash": "dotted"}
_LABEL = {"text_font": FONT, "text_font_size": "12px", "text_color": INK}
STYLE: dict[str, dict[str, Any]] = {
    "Plot": {"outline_line_color": INK, "outline_line_alpha": 0.35, "border_fill_color": None},
    "Axis": {
        **{f"{part}_{key}": value for part in ("axis_label", "major_label") for key, value in _LABEL.items()},
        "axis_label_text_font_style": "normal", "axis_line_color": INK, "major_tick_line_color": INK,
        "minor_tick_line_color": None,
    },
    "Grid": {"grid_line_color": FAINT, "grid_line_alpha": 0.9},
    "Legend": {
        **{f"label_{key}": value for key, value in _LABEL.items()}, "border_line_color": None,
        "background_fill_color": None, "glyph_width": 24, "label_height": 14, "glyph_height": 14, "padding": 2,
        "margin": 2, "spacing": 14,
    },
    "ColorBar": {
        **{f"title_{key}": value for key, value in _LABEL.items()}, "title_text_font_style": "normal",
        "title_standoff": 4, "major_label_text_font": FONT, "major_label_text_font_size": "11px", "height": 10,
        "width": 250, "padding": 4, "background_fill_color": None, "bar_line_color": None,
    },
}  # fmt: skip
"""Bokeh theme of every figure on the page; the width of a colour bar fits a phone."""
_CLOCK = """
    const sign = value < 0 ? "-" : "", all = Math.abs(value);
    const h = Math.floor(all / 3600), m = Math.floor(all / 60) % 60, s = all - 60 * Math.floor(all / 60);
    const two = (n) => String(n).padStart(2, "0");
    let text = s.toFixed(digits).padStart(digits > 0 ? 3 + digits : 2, "0");
    if (text.startsWith("60")) text = s.toFixed(3);
    return sign + (hours ? h + ":" + two(m) : String(60 * h + m)) + ":" + text;
"""


class Linked:
    """Shared axes, cursor and events of the figures of one page.

    Parameters
    ----------
    begin, end
        Times at the edges [s].
    events
        Events to mark in every figure over time.

    Attributes
    ----------
    time, place : Range1d
        Time [s] and place [km] in view.
    marks
        Tables of the events without and with a duration, by kind.
    marked
        Renderers of the marks, by kind.
    figures_over_time, figures_over_distance
        All figures.
    readings
        Labels and units of the values at the cursor.
    """

    def __init__(self, begin: float, end: float, events: list[Event] | None = None) -> None:
        margin = 0.004 * max(end - begin, 1.0)
        self.time = models.Range1d(begin - margin, end + margin, bounds=(begin - 20 * margin, end + 20 * margin))
        self.place = models.Range1d(0.0, 1.0)
        self.hours = end >= 3600.0
        self._time_cursor = models.Span(dimension="height", **CURSOR)
        self._place_cursor = models.Span(dimension="height", **CURSOR)
        self.marks = _sources(events or [])
        self.marked: dict[str, list[Any]] = {kind: [] for kind in self.marks}
        self.figures_over_time: list[Figure] = []
        self.figures_over_distance: list[Figure] = []
        self.readings: list[tuple[str, str]] = []
        self.time_words = f"time in {'h:min:s' if self.hours else 'min:s'}"

    def set_places(self, begin: float, end: float) -> None:
        """Set the places at the edges [km]."""
        margin = 0.004 * max(end - begin, 0.1)
        self.place.update(start=begin - margin, end=end + margin, bounds=(begin - 20 * margin, end + 20 * margin))
        self.place.reset_start, self.place.reset_end = begin - margin, end + margin

    def over_time(
        self, axis: str, height: int = HEIGHT, *, marked: bool = True, tinted: bool = True, **options: Any
    ) -> Figure:
        """Return an empty figure over time; ``axis`` names the title of its y axis, or is that title.

        ``tinted=False`` marks only the ends of an event and does not change the colours of a heat map.
        """
        plot = _plain(axis, height, x_range=self.time, **options)
        plot.xaxis.axis_label = self.time_words
        plot.xaxis.ticker = time_ticker()
        plot.xaxis.formatter = time_formatter(hours=self.hours)
        plot.add_tools(models.CrosshairTool(overlay=self._time_cursor))
        if marked:
            self._mark(plot, tinted=tinted)
        self.figures_over_time.append(plot)
        return plot

    def over_distance(self, axis: str, height: int = HEIGHT, **options: Any) -> Figure:
        """Return an empty figure over the position of vehicle 0 [km]."""
        plot = _plain(axis, height, x_range=self.place, **options)
        plot.min_border_right = RIGHT + SECOND_AXIS
        plot.xaxis.axis_label = axis_title("distance")
        plot.add_tools(models.CrosshairTool(overlay=self._place_cursor))
        self.figures_over_distance.append(plot)
        return plot

    def clock(self, digits: int = 1) -> models.CustomJSHover:
        """Return the time format of a tooltip."""
        return models.CustomJSHover(args={"hours": self.hours, "digits": digits}, code=_CLOCK)

    def _mark(self, plot: Figure, *, tinted: bool) -> None:
        """Mark events without duration by lines, others by tinted bands."""
        for kind, (moments, stretches) in self.marks.items():
            colour = KINDS[kind].colour
            drawn = self.marked[kind]
            if stretches.data["begin"]:
                drawn.append(plot.vstrip(
                    x0="begin", x1="end", source=stretches, fill_color=colour if tinted else None, fill_alpha=0.13,
                    line_color=None if tinted else colour, line_alpha=0.7, level="underlay",
                ))  # fmt: skip
            if moments.data["begin"]:
                drawn.append(plot.vspan(
                    x="begin", source=moments, line_color=colour, line_width=1.3, line_dash="5 3", line_alpha=0.9,
                    level="underlay",
                ))  # fmt: skip


def _sources(events: list[Event]) -> dict[str, tuple[models.ColumnDataSource, models.ColumnDataSource]]:
    """Return tables of the events without and with a duration, by kind."""
    result = {}
    for kind in KINDS:
        of_kind = [event for event in events if event.kind == kind]
        if of_kind:
            moments = [event for event in of_kind if event.end is None]
            stretches = [event for event in of_kind if event.end is not None]
            result[kind] = (_table(moments, "begin", "text"), _table(stretches, "begin", "end", "text"))
    return result


def _table(events: list[Event], *names: str) -> models.ColumnDataSource:
    return models.ColumnDataSource({name: [getattr(event, name) for event in events] for name in names})


def _plain(axis: str, height: int, **options: Any) -> Figure:
    """Return a figure in the common style."""
    zoom = models.BoxZoomTool(dimensions="width")
    plot = bokeh_figure(
        height=height,
        sizing_mode="stretch_width",
        tools=[
            zoom,
            models.BoxZoomTool(),
            models.PanTool(),
            models.WheelZoomTool(dimensions="width"),
            models.ResetTool(),
            models.SaveTool(),
        ],
        active_drag=zoom,
        active_scroll=None,
        toolbar_location="right",
        min_border_left=LEFT,
        min_border_right=RIGHT,
        min_border_top=4,
        output_backend="canvas",
        window_axis="x",
        **options,
    )
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.js_on_event(DoubleTap, models.CustomJS(args={"plot": plot}, code="plot.reset.emit()"))
    plot.yaxis.axis_label = axis_title(axis)
    plot.yaxis.formatter = models.BasicTickFormatter(use_scientific=False)
    if hasattr(plot.y_range, "range_padding"):
        plot.y_range.range_padding = 0.14
    return plot


def add_page_legend(plot: Figure, items: list[Any]) -> None:
    """Add a legend above the frame; a click on an entry hides its line."""
    columns = _columns([item.label.value for item in items])
    plot.height += LEGEND_ROW * (math.ceil(len(items) / columns) - 1)
    legend = models.Legend(
        items=items, orientation="horizontal", location=(0, LEGEND_GAP), click_policy="hide", ncols=columns
    )
    plot.add_layout(legend, "above")


def _columns(labels: list[str]) -> int:
    """Return the number of legend columns: all entries, or as many as the usual width holds."""
    widest = max((len(label) for label in labels), default=0)
    if sum(54.0 + LETTER * len(label) for label in labels) < LEGEND_WIDTH:
        return max(1, len(labels))
    return max(1, int(LEGEND_WIDTH / (54.0 + LETTER * widest)))


LEGEND_WIDTH, LETTER, LEGEND_ROW, LEGEND_GAP = 1000.0, 6.2, 28, 3
"""Width of a legend, mean width of a letter, height of a row, gap between legend and frame [pixels]."""


def time_formatter(*, hours: bool) -> models.CustomJSTickFormatter:
    """Return the time format of an axis, with decimals according to the tick distance."""
    code = """
        const gap = ticks.length > 1 ? ticks[1] - ticks[0] : 1;
        const digits = gap >= 1 ? 0 : Math.min(3, Math.ceil(-Math.log10(gap))), value = tick;"""
    return models.CustomJSTickFormatter(args={"hours": hours}, code=code + _CLOCK)


def time_ticker() -> models.CompositeTicker:
    """Return ticks at whole seconds, minutes and hours."""
    return models.CompositeTicker(
        tickers=[
            models.AdaptiveTicker(
                base=10, mantissas=[1, 2, 5], min_interval=0.001, max_interval=0.5, num_minor_ticks=0
            ),
            models.AdaptiveTicker(
                base=60, mantissas=[1, 2, 5, 10, 15, 30], min_interval=1.0, max_interval=1800.0, num_minor_ticks=0
            ),
            models.AdaptiveTicker(base=24, mantissas=[1, 2, 4, 6, 12], min_interval=3600.0, num_minor_ticks=0),
        ]
    )


HERE = Path(__file__).parent


@dataclass(frozen=True)
class Placed:
    """Figure on the page with heading and caption."""

    figure: Figure
    heading: str
    caption: str


@dataclass(frozen=True)
class PageSection:
    """Figures under one title; ``anchor`` is the target of the navigation."""

    anchor: str
    title: str
    placed: list[Placed]


MARKS = {"passed": "✓ passed", "failed": "✗ failed", "incomplete": "not evaluated", "none": ""}


def render(page: dict[str, Any], sections: list[PageSection]) -> str:
    """Return the HTML of a page from the texts and tables that its template names."""
    from bokeh.document import Document
    from bokeh.embed import components
    from bokeh.resources import Resources
    from bokeh.settings import settings
    from bokeh.themes import Theme
    from jinja2 import Environment, FileSystemLoader
    from markupsafe import Markup

    figures = [placed.figure for section in sections for placed in section.placed]
    theme = Theme(json={"attrs": STYLE})
    document = Document(theme=theme)
    for figure in figures:
        columns = next((part.ncols for part in figure.above if part.__class__.__name__ == "Legend"), 1)
        figure.tags = [[figure.min_border_left, figure.min_border_right, figure.height, columns]]  # for page.js
    with document.models.freeze():  # otherwise Bokeh searches all figures again for every added one
        for figure in figures:
            document.add_root(figure)
    settings.perform_document_validation.set_value(False)  # a sixth of the time of the page
    try:
        script, places = components(tuple(figures), theme=theme) if figures else ("", ())
    finally:
        settings.perform_document_validation.unset_value()
    library = Resources(mode="inline", components=["bokeh"]).render_js() if figures else ""
    divided, rest = [], iter(places)
    for section in sections:
        blocks = [(placed.heading, placed.caption, placed.figure.id, Markup(next(rest))) for placed in section.placed]
        divided.append((section.anchor, section.title, blocks))
    files = Environment(loader=FileSystemLoader(HERE), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    files.filters["name"] = shown_name
    return files.get_template("page.html").render(
        page=shown_texts(page),
        marks=MARKS,
        sections=divided,
        script=Markup(script),
        library=Markup(library),
        style=Markup((HERE / "page.css").read_text(encoding="utf-8")),
        behaviour=Markup((HERE / "page.js").read_text(encoding="utf-8").replace('"km"', f'"{display_unit("km")[0]}"')),
    )
