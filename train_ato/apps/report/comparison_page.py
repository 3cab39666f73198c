"""The figures of several runs side by side: lines over each other in the colours of the runs, heat maps one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from bokeh.models import ColumnDataSource

from train_ato.report.comparison_lines import common_events, farthest, run_colours, run_dash
from train_ato.report.digest import Digest
from train_ato.report.event_panels import run_events_figure
from train_ato.report.heat_panel import heat_figure
from train_ato.report.page import Placed, Section
from train_ato.report.panels import Trace, distance_figure, line_figure, source_of, traces_of
from train_ato.report.quantities import QUANTITIES
from train_ato.report.style import Figure, Linked
from train_ato.report.track_panel import track_figure


@dataclass(frozen=True)
class Shared:
    """One figure of all runs: its name among the lines or maps, which of its columns, y axis, heading, caption, height.

    Without columns it is a heat map, one for each run.  ``{worst}`` in the caption is filled for several power units.
    """

    name: str
    columns: tuple[str, ...]
    axis: str
    heading: str
    caption: str = ""
    height: int = 200


FIGURES: tuple[tuple[str, str, tuple[Shared, ...]], ...] = (
    (
        "tracking",
        "Tracking",
        (
            Shared("speed", ("speed", "measured_speed"), "speed", "Speed", "Of vehicle 0's centre.", 280),
            Shared("speed_error", ("speed_error",), "speed_error", "Speed error", "Train minus reference{worst}.", 220),
            Shared(
                "position_error",
                ("position_error",),
                "position_error",
                "Position error",
                "Train minus reference{worst}; > 0 is ahead of the profile.",
                220,
            ),
        ),
    ),
    (
        "forces",
        "Forces",
        (
            Shared("forces", ("applied",), "force", "Applied force", "All power units together.", 240),
            Shared("forces", ("demand",), "force", "Demand", "All power units together, as sent.", 240),
        ),
    ),
    (
        "couplers",
        "Couplers",
        (
            Shared("couplers", (), "", "Force along the train", "One scale for all runs; front of the train on top."),
            Shared("coupler_extremes", ("draft",), "coupler", "Largest draft along the train"),
            Shared("coupler_extremes", ("buff",), "coupler", "Largest buff along the train"),
        ),
    ),
    (
        "air-brake",
        "Air brake",
        (
            Shared("pipe", ("pipe",), "pressure", "Brake pipe at the head", "Absolute pressure."),
            Shared("shoes", (), "", "Shoe force along the train", "One scale for all runs."),
            Shared("shoe_force", ("shoe_force",), "shoe_force", "Shoe force of the whole train"),
        ),
    ),
    (
        "disturbance",
        "Disturbance and delay",
        (
            Shared("disturbance", ("estimate",), "disturbance", "Disturbance, estimate", "Of a power unit{worst}."),
            Shared("disturbance", ("truth",), "disturbance", "Disturbance, truth", "On a power unit's vehicle{worst}."),
            Shared("delay", ("delay",), "delay", "Delay from command to effect", "As found in the log."),
        ),
    ),
    (
        "energy",
        "Energy",
        (
            Shared("energy", ("traction",), "energy", "Work of traction"),
            Shared("energy", ("regenerated",), "energy", "Work of the electric brake", "< 0: taken from the train."),
        ),
    ),
)
"""Sections: anchor, title, and their figures."""


def comparison_sections(digests: Sequence[Digest]) -> tuple[list[Section], Linked]:
    """Return the figures of several runs, those that no run can fill left out, and what ties them together."""
    drawn = [digest for digest in digests if digest.lines]
    begin = min((digest.span[0] for digest in drawn), default=0.0)
    linked = Linked(begin, max((digest.span[1] for digest in drawn), default=1.0), common_events(drawn))
    colours = run_colours(len(digests))
    runs = [(digest, colours[index]) for index, digest in enumerate(digests) if digest.lines]
    sections = _over_distance(linked, runs)
    if any(digest.events for digest, _ in runs):
        caption = "A row for each run. What happens in all runs alike is marked on every figure over time."
        named = [(digest.label, digest.events) for digest, _ in runs]
        sections.append(Section("events", "Events", [Placed(run_events_figure(linked, named), "", caption)]))
    for anchor, title, entries in FIGURES:
        placed: list[Placed] = []
        for shared in entries:
            if not shared.columns:
                placed += _maps(linked, runs, shared)
            elif (figure := _overlaid(linked, runs, shared)) is not None:
                placed.append(Placed(figure, shared.heading, _caption(shared, runs)))
        if placed:
            sections.append(Section(anchor, title, placed))
    return sections, linked


def _caption(shared: Shared, runs: Sequence[tuple[Digest, str]]) -> str:
    """Return the caption; with several power units it says which one is drawn."""
    lines = [digest.lines[shared.name] for digest, _ in runs if shared.name in digest.lines]
    several = any(f"{shared.columns[0]}:1" in entry.columns for entry in lines)
    return shared.caption.format(worst=", of all the one farthest from zero" if several else "")


def _overlaid(linked: Linked, runs: Sequence[tuple[Digest, str]], shared: Shared) -> Figure | None:
    """Return one quantity of all runs over each other."""
    name, columns = shared.name, shared.columns
    tables: list[tuple[ColumnDataSource, list[Trace]]] = []
    for index, (digest, colour) in enumerate(runs):
        lines = digest.lines.get(name)
        values = next((found for column in columns if (found := farthest(lines, column)) is not None), None)
        if lines is None or values is None:
            continue
        if name == "speed" and not tables and "profile" in lines.columns:
            profile = source_of(lines.time, {"profile": lines.columns["profile"]})
            tables.append((profile, traces_of(["profile"])))
        look = replace(QUANTITIES[columns[0]], words=digest.label, colour=colour, width=1.3, dash=run_dash(index))
        tables.append((source_of(lines.time, {columns[0]: values}), [Trace(columns[0], look)]))
    return line_figure(linked, shared.axis, tables, shared.height) if tables else None


def _maps(linked: Linked, runs: Sequence[tuple[Digest, str]], shared: Shared) -> list[Placed]:
    """Return the heat maps of all runs on one scale."""
    name, signed = shared.name, shared.name == "couplers"
    what, rows = ("coupler force", "coupler behind vehicle") if signed else ("shoe force", "vehicle")
    having = [digest for digest, _ in runs if name in digest.maps]
    largest = max((digest.maps[name].largest for digest in having), default=1.0)
    placed = []
    for digest in having:
        picture = digest.maps[name]
        figure = heat_figure(linked, picture, what, "kN", rows, signed=signed, largest=largest)
        placed.append(Placed(figure, f"{shared.heading}: {digest.label}", shared.caption))
    return placed


def _over_distance(linked: Linked, runs: Sequence[tuple[Digest, str]]) -> list[Section]:
    tables, ends = [], []
    for index, (digest, colour) in enumerate(runs):
        lines = digest.lines.get("speed")
        speed = farthest(lines, "speed")
        speed = farthest(lines, "measured_speed") if speed is None else speed
        if lines is None or speed is None or "position_km" not in lines.columns:
            continue
        place = lines.columns["position_km"]
        ends += [place, *(profile[0] for profile in digest.profiles)]
        look = replace(QUANTITIES["speed"], words=digest.label, colour=colour, width=1.3, dash=run_dash(index))
        tables.append((source_of(lines.time, {"speed": speed, "position_km": place}), [Trace("speed", look)]))
    if not tables:
        return []
    linked.set_places(min(float(np.nanmin(p)) for p in ends), max(float(np.nanmax(p)) for p in ends))
    first = next(digest for digest, _ in runs if "speed" in digest.lines)
    figure = distance_figure(linked, tables, first.profiles[:1], first.limits)
    placed = [Placed(figure, "Speed over distance", f"Profile and limits are those of {first.label}.")]
    if first.track is not None:
        placed.append(
            Placed(track_figure(linked, first.track), "Grade and curves", f"Of the line that {first.label} runs on.")
        )
    return [Section("line", "Along the line", placed)]
