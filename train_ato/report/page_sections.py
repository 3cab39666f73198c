"""Figures of the page of one run, and of that of several runs: lines in one figure with a colour per run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from bokeh.events import MouseLeave, MouseMove
from bokeh.models import ColumnDataSource, CustomJS, Span

from train_ato.messages.types import Array
from train_ato.program.display_units import display_unit
from train_ato.report import page_data, panels
from train_ato.report.curves import Curves, shown_curves
from train_ato.report.page import HEIGHT, Figure, Linked, PageSection, Placed
from train_ato.report.quantities import BOUNDS, HEAT, PANELS, TABLES, VERMILION, Trace, style_of, traces_of

_OVER_TIME = "window.trainAto?.overTime(fields, places, cb_obj.x)"
_OVER_DISTANCE = "window.trainAto?.overDistance(fields, speed, times, cb_obj.x)"


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
    """One figure: name of its curves or map, heading, caption, height, and of several runs the drawn column.

    ``{worst}`` in the caption of a column is replaced for several power units.
    """

    name: str
    heading: str
    caption: str = ""
    height: int = HEIGHT
    column: str = ""


FigureTable = Mapping[tuple[str, str], tuple[FigureSpec, ...]]
"""Figures of each section by its anchor and title."""


def _read_figures(kind: str) -> FigureTable:
    """Return a table of figures."""
    rows = TABLES[kind]
    return {(row["anchor"], row["title"]): tuple(FigureSpec(**figure) for figure in row["figures"]) for row in rows}


FIGURES, SHARED_FIGURES = _read_figures("run"), _read_figures("comparison")
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
READINGS: dict[str, tuple[str, str, str, int]] = TABLES["readings"]
"""Figure, label, unit and digits of the columns in the bar with the values at the cursor."""


def run_sections(data: page_data.PageData) -> tuple[list[PageSection], Linked]:
    """Return the figures of a run and their shared axes; figures without data are omitted."""
    linked = Linked(*data.span, data.events)
    sources = {name: panels.source_of(lines.time, lines.columns) for name, lines in data.curves.items()}
    sections = [*_speed_sections(linked, sources), *_over_distance(linked, data, sources)]
    if data.events:
        figure = panels.event_figure(linked, data.events)
        caption = "Marked in every figure over time; click on a kind to hide its marks."
        sections.append(PageSection("events", "Events", [Placed(figure, "", caption)]))
    sections += _filled(FIGURES, lambda spec: _figure(linked, data, sources, spec))
    readings = [
        Reading(sources[table], column, words, display_unit(unit)[0], digits)
        for column, (table, words, unit, digits) in READINGS.items()
        if table in sources and column in sources[table].data
    ]
    follow_cursor(linked, readings)
    return sections, linked


def _filled(figures: FigureTable, draw: Callable[[FigureSpec], list[Placed]]) -> list[PageSection]:
    """Return the sections of a table that have a figure."""
    drawn = {key: [placed for spec in specs for placed in draw(spec)] for key, specs in figures.items()}
    return [PageSection(*key, placed) for key, placed in drawn.items() if placed]


def _left_out(spec: FigureSpec, pages: Sequence[page_data.PageData]) -> str:
    """Return the sentences of a caption on the part of the runs that the error metrics leave out."""
    notes = {data.evaluation for data in pages if data.evaluation} if spec.name in ERRORS else set()
    return "".join(f" The {note}." for note in sorted(notes))


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
            figure = panels.line_figure(linked, PANELS["speed"][0], tables, wanted.height, whole=wanted is LIMITS)
            sections.append(PageSection(anchor, title, [Placed(figure, wanted.heading, wanted.caption)]))
    return sections


def _figure(
    linked: Linked, data: page_data.PageData, sources: dict[str, ColumnDataSource], spec: FigureSpec
) -> list[Placed]:
    """Return a figure of one run; none without data."""
    name = spec.name
    if name in data.maps:
        figure = panels.heat_figure(linked, data.maps[name], HEAT[name])
    elif name in sources:
        tables = [(sources[name], traces_of(sources[name].data))]
        figure = panels.line_figure(linked, PANELS[name][0], tables, spec.height)
    else:
        return []
    return [Placed(figure, spec.heading, spec.caption + _left_out(spec, [data]))]


def _over_distance(linked: Linked, data: page_data.PageData, sources: dict[str, ColumnDataSource]) -> list[PageSection]:
    speed = sources.get("speed")
    if speed is None or "position_km" not in speed.data:
        return []
    columns = [column for column in ("speed", "measured_speed") if column in speed.data]
    caption = "The profile is complete, also beyond the distance of the run."
    places = [data.curves["speed"].columns["position_km"], *(profile[0] for profile in data.profiles)]
    tables = [(speed, traces_of(columns))]
    return [_line_section(linked, tables, places, data, profiles=data.profiles, captions=(caption, ""))]


def _line_section(
    linked: Linked,
    tables: Sequence[panels.Table],
    places: Sequence[Array],
    data: page_data.PageData,
    *,
    profiles: Sequence[tuple[Array, Array]],
    captions: tuple[str, str],
) -> PageSection:
    """Return the figures over distance with profiles, limits and track of a run, and their captions."""
    linked.set_places(min(float(np.nanmin(p)) for p in places), max(float(np.nanmax(p)) for p in places))
    speed = panels.mark_stations(panels.distance_figure(linked, tables, profiles, data.limits), data.stations)
    placed = [Placed(speed, "Speed over distance", captions[0])]
    if data.track is not None:
        placed.append(Placed(panels.track_figure(linked, data.track), "Grade and curves", captions[1]))
    return PageSection("line", "Along the line", placed)


ColouredRun = tuple[page_data.PageData, str]
"""Run with its colour."""


def comparison_sections(pages: Sequence[page_data.PageData]) -> tuple[list[PageSection], Linked]:
    """Return the figures of several runs and their shared axes; figures without data are omitted."""
    drawn = [data for data in pages if data.curves]
    begin = min((data.span[0] for data in drawn), default=0.0)
    linked = Linked(begin, max((data.span[1] for data in drawn), default=1.0), page_data.common_events(drawn))
    colours = page_data.run_colours(len(pages))
    runs = [(data, colours[index]) for index, data in enumerate(pages) if data.curves]
    hero = _overlaid(linked, runs, replace(HERO, caption="Front vehicle.", column="speed"))
    sections = [PageSection("verdict", "Verdict", hero)] if hero else []
    sections += _runs_over_distance(linked, runs)
    sections += _difference_section(linked, runs)
    if any(data.events for data, _ in runs):
        caption = "One row per run. Events common to all runs are marked in every figure over time."
        named = [(data.label, data.events) for data, _ in runs]
        sections.append(PageSection("events", "Events", [Placed(panels.run_events_figure(linked, named), "", caption)]))
    sections += _filled(SHARED_FIGURES, lambda spec: (_overlaid if spec.column else _maps)(linked, runs, spec))
    return sections, linked


def _caption(spec: FigureSpec, runs: Sequence[ColouredRun]) -> str:
    """Return the caption; for several power units it names the value that is drawn."""
    several = any(f"{spec.column}:1" in data.curves[spec.name].columns for data, _ in runs if spec.name in data.curves)
    worst = "; the value with the largest magnitude of all power units" if several else ""
    return (spec.caption + _left_out(spec, [data for data, _ in runs])).format(worst=worst)


def _look(column: str, words: str, colour: str, index: int) -> list[Trace]:
    """Return the line of a run by its number."""
    return [
        Trace(column, replace(style_of(column), words=words, colour=colour, width=1.3, dash=page_data.run_dash(index)))
    ]


def _overlaid(linked: Linked, runs: Sequence[ColouredRun], spec: FigureSpec) -> list[Placed]:
    """Return one quantity of all runs in one figure."""
    tables: list[panels.Table] = []
    for index, (data, colour) in enumerate(runs):
        lines = data.curves.get(spec.name)
        values = _driven_speed(lines) if spec.column == "speed" else page_data.largest_magnitude(lines, spec.column)
        if lines is None or values is None:
            continue
        if spec.column == "speed" and not tables and "profile" in lines.columns:
            tables.append((panels.source_of(lines.time, {"profile": lines.columns["profile"]}), traces_of(["profile"])))
        tables.append(
            (panels.source_of(lines.time, {spec.column: values}), _look(spec.column, data.label, colour, index))
        )
    if not tables:
        return []
    return [
        Placed(
            panels.line_figure(linked, PANELS[spec.name][0], tables, spec.height), spec.heading, _caption(spec, runs)
        )
    ]


def _driven_speed(lines: Curves | None) -> Array | None:
    """Return the true speed, else the measured one."""
    speed = page_data.largest_magnitude(lines, "speed")
    return page_data.largest_magnitude(lines, "measured_speed") if speed is None else speed


def _maps(linked: Linked, runs: Sequence[ColouredRun], spec: FigureSpec) -> list[Placed]:
    """Return the heat maps of all runs on one scale."""
    found = {data.label: data.maps[spec.name] for data, _ in runs if spec.name in data.maps}
    largest = max((picture.largest for picture in found.values()), default=1.0)
    return [
        Placed(
            panels.heat_figure(linked, one, HEAT[spec.name], largest=largest), f"{spec.heading}: {label}", spec.caption
        )
        for label, one in found.items()
    ]


def _runs_over_distance(linked: Linked, runs: Sequence[ColouredRun]) -> list[PageSection]:
    tables: list[panels.Table] = []
    places: list[Array] = []
    for index, (data, colour) in enumerate(runs):
        lines = data.curves.get("speed")
        speed = _driven_speed(lines)
        if lines is None or speed is None or "position_km" not in lines.columns:
            continue
        place = lines.columns["position_km"]
        places += [place, *(profile[0] for profile in data.profiles)]
        source = panels.source_of(lines.time, {"speed": speed, "position_km": place})
        tables.append((source, _look("speed", data.label, colour, index)))
    if not tables:
        return []
    first = next(data for data, _ in runs if "speed" in data.curves)
    captions = (f"Profile and limits are those of {first.label}.", f"Line of {first.label}.")
    return [_line_section(linked, tables, places, first, profiles=first.profiles[:1], captions=captions)]


def _difference_section(linked: Linked, runs: Sequence[ColouredRun]) -> list[PageSection]:
    """Return the figures of the difference from the first run."""
    found = page_data.motion_differences([data for data, _ in runs])
    if not found:
        return []
    cells = round(page_data.share_of(len(runs)) * page_data.CELLS)
    km = display_unit("km")[1] / 1e3
    reduced = {
        label: {
            "time": page_data.downsampled(shown_curves(Curves(one.time, one.over_time)), cells),
            "place": page_data.downsampled(shown_curves(Curves(km * one.place, one.over_place)), cells),
        }
        for label, one in found.items()
    }
    looks = {data.label: (colour, index) for index, (data, colour) in enumerate(runs)}
    first = runs[0][0].label
    placed = []
    for over, column, axis, heading in TABLES["differences"]:
        tables = []
        for label, curves in reduced.items():
            lines = curves[over]
            columns = {column: lines.columns[column]} | ({"position_km": lines.time} if over == "place" else {})
            tables.append((panels.source_of(lines.time, columns), _look(column, label, *looks[label])))
        figure = (
            panels.distance_figure(linked, tables, (), None, axis, 200)
            if over == "place"
            else panels.line_figure(linked, axis, tables, 200)
        )
        caption = " > 0: later than the first run." if column == "time_s" else ""
        placed.append(Placed(figure, heading, f"Each run minus {first}.{caption}"))
    return [PageSection("difference", f"Difference from {first}", placed)]
