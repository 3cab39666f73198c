"""Figures of the page of one run, in their order."""

from dataclasses import dataclass

from bokeh.events import MouseLeave, MouseMove
from bokeh.models import ColumnDataSource, CustomJS, Span

from train_ato.program.display_units import display_unit
from train_ato.report.page import HEIGHT, Figure, Linked, PageSection, Placed
from train_ato.report.page_data import PageData
from train_ato.report.panels import (
    distance_figure,
    event_figure,
    heat_figure,
    line_figure,
    mark_stations,
    source_of,
    track_figure,
)
from train_ato.report.quantities import BOUNDS, HEAT, PANELS, VERMILION, traces_of

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


@dataclass(frozen=True)
class FigureSpec:
    """One figure: name of its curves or map, heading, caption, height."""

    name: str
    heading: str
    caption: str = ""
    height: int = HEIGHT


FIGURES: dict[tuple[str, str], tuple[FigureSpec, ...]] = {
    ("tracking", "Tracking"): (
        FigureSpec("speed_error", "Speed error", "Train minus reference at the same stamp.", 200),
        FigureSpec(
            "position_error", "Position error",
            "Train minus reference at the same stamp; > 0 is ahead of the profile.", 200,
        ),
    ),
    ("forces", "Forces"): (
        FigureSpec(
            "forces", "Command and applied force",
            "Sum of all power units: command as sent, force after delay, lag and saturation.", 250,
        ),
        FigureSpec("unit_forces", "Applied force of every power unit"),
    ),
    ("couplers", "Couplers"): (
        FigureSpec(
            "couplers", "Force along the train",
            "Front of the train on top. Each cell shows the force with the largest magnitude, so no peak is lost.",
        ),
        FigureSpec("coupler_extremes", "Extremes", "Largest values of all couplers at every tick.", 240),
    ),
    ("air-brake", "Air brake"): (
        FigureSpec("pipe", "Brake pipe", "Absolute pressure, at the tail as far as it is in the log.", 200),
        FigureSpec("shoes", "Shoe force along the train", "Brake force of the air brake of every vehicle."),
        FigureSpec("shoe_force", "Shoe force of the whole train", "", 180),
    ),
    ("disturbance", "Disturbance and delay"): (
        FigureSpec(
            "disturbance", "Disturbance: estimate and truth",
            "The estimate contains all effects missing in the nominal model; the truth is the external force only.",
        ),
        FigureSpec(
            "delay", "Delay from command to effect",
            "Identified in time windows: the shift of the command that fits the applied force best; the lag adds "
            "its time constant. Gaps: the force was nearly constant or saturated.", 190,
        ),
    ),
    ("signals", "Own signals"): (
        FigureSpec("signals", "Own signals", "Numbers of `on_tick` or of the caller of `ta.Env`, by name."),
    ),
    ("energy", "Energy"): (
        FigureSpec(
            "energy", "Work done on the train since the start",
            "> 0 accelerates the train. The sum of all parts is the kinetic energy.", 260,
        ),
    ),
}  # fmt: skip
"""Figures of each section by its anchor and title."""
ERRORS = ("speed_error", "position_error")
"""Figures whose metrics may leave out a part of the run."""
HERO = FigureSpec(
    "speed",
    "Speed against profile",
    "Front vehicle; the speed limit is that over the train length. Dashed lines and bands: see Events.",
    330,
)
"""Figure of the first screen."""
LIMITS = FigureSpec("speed", "Limits of the supervisor", "Speed of vehicle 0 and its ETCS limits.", 280)
SUPERVISED = tuple(name for name in BOUNDS if name.endswith("_speed"))
"""Curves of the supervisor; the first screen has the permitted speed only."""
READINGS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("speed", ("position_km", "speed", "measured_speed", "profile", "limit", "permitted_speed")),
    ("speed_error", ("speed_error",)),
    ("position_error", ("position_error",)),
    ("forces", ("demand", "applied")),
    ("coupler_extremes", ("draft", "buff")),
    ("pipe", ("pipe", "pipe_tail")),
)
"""Columns in the bar with the values at the cursor."""
SHORT = {
    "position_km": ("position", "km", 3), "speed": ("speed", "km/h", 1), "measured_speed": ("speed", "km/h", 1),
    "profile": ("profile", "km/h", 1), "limit": ("speed limit", "km/h", 0),
    "permitted_speed": ("permitted", "km/h", 0), "speed_error": ("speed error", "km/h", 2),
    "position_error": ("position error", "m", 2), "demand": ("command", "kN", 0),
    "applied": ("applied force", "kN", 0), "draft": ("draft", "kN", 0), "buff": ("buff", "kN", 0),
    "pipe": ("brake pipe, head", "kPa", 0), "pipe_tail": ("tail", "kPa", 0),
}  # fmt: skip
"""Labels, units and digits in the bar."""


def run_sections(data: PageData) -> tuple[list[PageSection], Linked]:
    """Return the figures of a run and their shared axes; figures without data are omitted."""
    linked = Linked(*data.span, data.events)
    sources = {name: source_of(lines.time, lines.columns) for name, lines in data.curves.items()}
    sections = [*_speed_sections(linked, sources), *_over_distance(linked, data, sources)]
    if data.events:
        figure = event_figure(linked, data.events)
        caption = "Marked in every figure over time; click on a kind to hide its marks."
        sections.append(PageSection("events", "Events", [Placed(figure, "", caption)]))
    for (anchor, title), entries in FIGURES.items():
        placed = []
        for wanted in entries:
            figure = _figure(linked, data, sources, wanted)
            if figure is not None:
                left_out = f" The {data.evaluation}." if data.evaluation and wanted.name in ERRORS else ""
                placed.append(Placed(figure, wanted.heading, wanted.caption + left_out))
        if placed:
            sections.append(PageSection(anchor, title, placed))
    follow_cursor(linked, _readings(sources))
    return sections, linked


def _speed_sections(linked: Linked, sources: dict[str, ColumnDataSource]) -> list[PageSection]:
    """Return the figure of the first screen, and that of the supervisor's limits if the run has them."""
    source = sources.get("speed")
    if source is None:
        return []
    sections = []
    supervised = [name for name in SUPERVISED if name in source.data]
    plain = [name for name in source.data if name not in supervised or name == "permitted_speed"]
    for anchor, title, wanted, columns in (
        ("verdict", "Verdict", HERO, plain),
        ("supervision", "Supervision", LIMITS, [name for name in source.data if name != "profile"]),
    ):
        if anchor == "verdict" or supervised:
            tables = [(source, traces_of(columns))]
            figure = line_figure(linked, PANELS["speed"][0], tables, wanted.height, whole=wanted is LIMITS)
            sections.append(PageSection(anchor, title, [Placed(figure, wanted.heading, wanted.caption)]))
    return sections


def _figure(linked: Linked, data: PageData, sources: dict[str, ColumnDataSource], wanted: FigureSpec) -> Figure | None:
    name = wanted.name
    if name in data.maps:
        return heat_figure(linked, data.maps[name], HEAT[name])
    if name not in sources:
        return None
    return line_figure(linked, PANELS[name][0], [(sources[name], traces_of(sources[name].data))], wanted.height)


def _over_distance(linked: Linked, data: PageData, sources: dict[str, ColumnDataSource]) -> list[PageSection]:
    speed = sources.get("speed")
    if speed is None or "position_km" not in speed.data:
        return []
    place = data.curves["speed"].columns["position_km"]
    ends = [place, *(profile[0] for profile in data.profiles)]
    linked.set_places(min(float(p.min()) for p in ends), max(float(p.max()) for p in ends))
    columns = [column for column in ("speed", "measured_speed") if column in speed.data]
    placed = [
        Placed(
            mark_stations(
                distance_figure(linked, [(speed, traces_of(columns))], data.profiles, data.limits), data.stations
            ),
            "Speed over distance",
            "The profile is complete, also beyond the distance of the run.",
        )
    ]
    if data.track is not None:
        placed.append(Placed(track_figure(linked, data.track), "Grade and curves", ""))
    return [PageSection("line", "Along the line", placed)]


def _readings(sources: dict[str, ColumnDataSource]) -> list[Reading]:
    return [
        Reading(sources[table], column, words, display_unit(unit)[0], digits)
        for table, columns in READINGS
        if table in sources
        for column in columns
        if column in sources[table].data
        for words, unit, digits in (SHORT[column],)
    ]
