"""Figures of several runs: lines in one figure with a colour per run, one heat map per run."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from bokeh.models import ColumnDataSource

from train_ato.program.display_units import display_unit
from train_ato.report.curves import Curves, shown_curves
from train_ato.report.page import Figure, Linked, PageSection, Placed
from train_ato.report.page_data import (
    CELLS,
    PageData,
    common_events,
    downsampled,
    largest_magnitude,
    motion_differences,
    run_colours,
    run_dash,
    share_of,
)
from train_ato.report.panels import (
    distance_figure,
    heat_figure,
    line_figure,
    mark_stations,
    run_events_figure,
    source_of,
    track_figure,
)
from train_ato.report.quantities import HEAT, PANELS, Trace, style_of, traces_of


@dataclass(frozen=True)
class Shared:
    """One figure of all runs: its name among the lines or maps, which of its columns, heading, caption, height.

    Without columns it is a heat map per run.  ``{worst}`` in the caption is replaced for several power units.
    """

    name: str
    columns: tuple[str, ...]
    heading: str
    caption: str = ""
    height: int = 200


FIGURES: dict[tuple[str, str], tuple[Shared, ...]] = {
    ("tracking", "Tracking"): (
        Shared("speed_error", ("speed_error",), "Speed error", "Train minus reference{worst}.", 220),
        Shared(
            "position_error",
            ("position_error",),
            "Position error",
            "Train minus reference{worst}; > 0 is ahead of the profile.",
            220,
        ),
    ),
    ("forces", "Forces"): (
        Shared("forces", ("applied",), "Applied force", "All power units together.", 240),
        Shared("forces", ("demand",), "Command", "All power units together, as sent.", 240),
    ),
    ("couplers", "Couplers"): (
        Shared("couplers", (), "Force along the train", "One scale for all runs; front of the train on top."),
        Shared("coupler_extremes", ("draft",), "Largest draft along the train"),
        Shared("coupler_extremes", ("buff",), "Largest buff along the train"),
    ),
    ("air-brake", "Air brake"): (
        Shared("pipe", ("pipe",), "Brake pipe at the head", "Absolute pressure."),
        Shared("pipe", ("pipe_tail",), "Brake pipe at the tail", "Absolute pressure."),
        Shared("shoes", (), "Shoe force along the train", "One scale for all runs."),
        Shared("shoe_force", ("shoe_force",), "Shoe force of the whole train"),
    ),
    ("disturbance", "Disturbance and delay"): (
        Shared("disturbance", ("estimate",), "Disturbance, estimate", "Of a power unit{worst}."),
        Shared("disturbance", ("truth",), "Disturbance, truth", "On a power unit's vehicle{worst}."),
        Shared("delay", ("delay",), "Delay from command to effect", "As found in the log."),
    ),
    ("energy", "Energy"): (
        Shared("energy", ("traction",), "Work of traction"),
        Shared("energy", ("regenerated",), "Work of the electric brake", "< 0: taken from the train."),
    ),
}
"""Figures of each section by its anchor and title."""
ERRORS = ("speed_error", "position_error")
"""Figures whose metrics may leave out a part of the run."""
HERO = Shared("speed", ("speed", "measured_speed"), "Speed against profile", "Front vehicle.", 330)
"""Figure of the first screen."""


def comparison_sections(pages: Sequence[PageData]) -> tuple[list[PageSection], Linked]:
    """Return the figures of several runs and their shared axes; figures without data are omitted."""
    drawn = [data for data in pages if data.curves]
    begin = min((data.span[0] for data in drawn), default=0.0)
    linked = Linked(begin, max((data.span[1] for data in drawn), default=1.0), common_events(drawn))
    colours = run_colours(len(pages))
    runs = [(data, colours[index]) for index, data in enumerate(pages) if data.curves]
    hero = _overlaid(linked, runs, HERO)
    sections = [] if hero is None else [PageSection("verdict", "Verdict", [Placed(hero, HERO.heading, HERO.caption)])]
    sections += _over_distance(linked, runs)
    sections += _difference_section(linked, runs)
    if any(data.events for data, _ in runs):
        caption = "One row per run. Events common to all runs are marked in every figure over time."
        named = [(data.label, data.events) for data, _ in runs]
        sections.append(PageSection("events", "Events", [Placed(run_events_figure(linked, named), "", caption)]))
    for (anchor, title), entries in FIGURES.items():
        placed: list[Placed] = []
        for shared in entries:
            if not shared.columns:
                placed += _maps(linked, runs, shared)
            elif (figure := _overlaid(linked, runs, shared)) is not None:
                placed.append(Placed(figure, shared.heading, _caption(shared, runs)))
        if placed:
            sections.append(PageSection(anchor, title, placed))
    return sections, linked


def _caption(shared: Shared, runs: Sequence[tuple[PageData, str]]) -> str:
    """Return the caption; for several power units it names the value that is drawn."""
    lines = [data.curves[shared.name] for data, _ in runs if shared.name in data.curves]
    several = any(f"{shared.columns[0]}:1" in entry.columns for entry in lines)
    notes = {data.evaluation for data, _ in runs if data.evaluation} if shared.name in ERRORS else set()
    left_out = "".join(f" The {note}." for note in sorted(notes))
    return (shared.caption + left_out).format(
        worst="; the value with the largest magnitude of all power units" if several else ""
    )


def _overlaid(linked: Linked, runs: Sequence[tuple[PageData, str]], shared: Shared) -> Figure | None:
    """Return one quantity of all runs in one figure."""
    name, columns = shared.name, shared.columns
    tables: list[tuple[ColumnDataSource, list[Trace]]] = []
    for index, (data, colour) in enumerate(runs):
        lines = data.curves.get(name)
        values = next((found for column in columns if (found := largest_magnitude(lines, column)) is not None), None)
        if lines is None or values is None:
            continue
        if name == "speed" and not tables and "profile" in lines.columns:
            profile = source_of(lines.time, {"profile": lines.columns["profile"]})
            tables.append((profile, traces_of(["profile"])))
        look = replace(style_of(columns[0]), words=data.label, colour=colour, width=1.3, dash=run_dash(index))
        tables.append((source_of(lines.time, {columns[0]: values}), [Trace(columns[0], look)]))
    return line_figure(linked, PANELS[shared.name][0], tables, shared.height) if tables else None


def _maps(linked: Linked, runs: Sequence[tuple[PageData, str]], shared: Shared) -> list[Placed]:
    """Return the heat maps of all runs on one scale."""
    name = shared.name
    having = [data for data, _ in runs if name in data.maps]
    largest = max((data.maps[name].largest for data in having), default=1.0)
    placed = []
    for data in having:
        figure = heat_figure(linked, data.maps[name], HEAT[name], largest=largest)
        placed.append(Placed(figure, f"{shared.heading}: {data.label}", shared.caption))
    return placed


def _over_distance(linked: Linked, runs: Sequence[tuple[PageData, str]]) -> list[PageSection]:
    tables, ends = [], []
    for index, (data, colour) in enumerate(runs):
        lines = data.curves.get("speed")
        speed = largest_magnitude(lines, "speed")
        speed = largest_magnitude(lines, "measured_speed") if speed is None else speed
        if lines is None or speed is None or "position_km" not in lines.columns:
            continue
        place = lines.columns["position_km"]
        ends += [place, *(profile[0] for profile in data.profiles)]
        look = replace(style_of("speed"), words=data.label, colour=colour, width=1.3, dash=run_dash(index))
        tables.append((source_of(lines.time, {"speed": speed, "position_km": place}), [Trace("speed", look)]))
    if not tables:
        return []
    linked.set_places(min(float(np.nanmin(p)) for p in ends), max(float(np.nanmax(p)) for p in ends))
    first = next(data for data, _ in runs if "speed" in data.curves)
    figure = mark_stations(distance_figure(linked, tables, first.profiles[:1], first.limits), first.stations)
    placed = [Placed(figure, "Speed over distance", f"Profile and limits are those of {first.label}.")]
    if first.track is not None:
        placed.append(Placed(track_figure(linked, first.track), "Grade and curves", f"Line of {first.label}."))
    return [PageSection("line", "Along the line", placed)]


DIFFERENCES: tuple[tuple[str, str, str, str], ...] = (
    ("place", "speed_kmh", "speed_difference", "Speed over distance"),
    ("place", "time_s", "time_difference", "Time at a place"),
    ("time", "speed_kmh", "speed_difference", "Speed over time"),
    ("time", "position_m", "position_difference", "Place over time"),
    ("time", "force_kn", "force_difference", "Force of all power units over time"),
)
"""Figures of the difference: horizontal axis, column, title of the vertical axis, heading."""


def _difference_section(linked: Linked, runs: Sequence[tuple[PageData, str]]) -> list[PageSection]:
    """Return the figures of the difference from the first run."""
    found = motion_differences([data for data, _ in runs])
    if not found:
        return []
    cells = round(share_of(len(runs)) * CELLS)
    km = display_unit("km")[1] / 1e3
    reduced = {
        label: {
            "time": downsampled(shown_curves(Curves(one.time, one.over_time)), cells),
            "place": downsampled(shown_curves(Curves(km * one.place, one.over_place)), cells),
        }
        for label, one in found.items()
    }
    colours = {data.label: (colour, run_dash(index)) for index, (data, colour) in enumerate(runs)}
    first = runs[0][0].label
    placed = []
    for over, column, axis, heading in DIFFERENCES:
        tables = []
        for label, curves in reduced.items():
            colour, dash = colours[label]
            look = replace(style_of(column), words=label, colour=colour, width=1.3, dash=dash)
            lines = curves[over]
            columns = {column: lines.columns[column]} | ({"position_km": lines.time} if over == "place" else {})
            tables.append((source_of(lines.time, columns), [Trace(column, look)]))
        figure = (
            distance_figure(linked, tables, (), None, axis, 200)
            if over == "place"
            else line_figure(linked, axis, tables, 200)
        )
        caption = " > 0: later than the first run." if column == "time_s" else ""
        placed.append(Placed(figure, heading, f"Each run minus {first}.{caption}"))
    return [PageSection("difference", f"Difference from {first}", placed)]
