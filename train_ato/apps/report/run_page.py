"""The figures of one run, in the order in which an engineer looks at them."""

from __future__ import annotations

from dataclasses import dataclass

from bokeh.models import ColumnDataSource

from train_ato.report.cursor import Reading, follow_cursor
from train_ato.report.digest import Digest
from train_ato.report.event_panels import event_figure
from train_ato.report.heat_panel import heat_figure
from train_ato.report.page import Placed, Section
from train_ato.report.panels import distance_figure, line_figure, source_of, traces_of
from train_ato.report.quantities import QUANTITIES
from train_ato.report.style import HEIGHT, Figure, Linked
from train_ato.report.track_panel import track_figure

HIDDEN = ("position_km", "envelope_high", "envelope_low")
"""Columns that are no lines of their own."""


@dataclass(frozen=True)
class Wanted:
    """One figure: its name among the lines or maps, y axis, heading, a line that says what it shows, height."""

    name: str
    axis: str
    heading: str
    caption: str = ""
    height: int = HEIGHT


FIGURES: tuple[tuple[str, str, tuple[Wanted, ...]], ...] = (
    (
        "tracking",
        "Tracking",
        (
            Wanted("speed", "speed", "Speed", "Of vehicle 0's centre; the limit is the lowest under the train.", 280),
            Wanted("speed_error", "speed_error", "Speed error", "Train minus reference at the same stamp.", 200),
            Wanted(
                "position_error",
                "position_error",
                "Position error",
                "Train minus reference at the same stamp; > 0 is ahead of the profile.",
                200,
            ),
        ),
    ),
    (
        "forces",
        "Forces",
        (
            Wanted(
                "forces",
                "force",
                "Demand and applied force",
                "All power units together; the demand as sent, the force after delay, lag and limit.",
                250,
            ),
            Wanted("unit_forces", "applied force in kN", "Applied force of every power unit"),
        ),
    ),
    (
        "couplers",
        "Couplers",
        (
            Wanted(
                "couplers",
                "",
                "Force along the train",
                "Front of the train on top. Of every cell the force farthest from zero, so that no peak is lost.",
            ),
            Wanted("coupler_extremes", "coupler", "Extremes", "At every tick the largest of all couplers.", 240),
        ),
    ),
    (
        "air-brake",
        "Air brake",
        (
            Wanted("pipe", "pressure", "Brake pipe", "Absolute pressure at the head.", 200),
            Wanted("shoes", "", "Shoe force along the train", "Retarding force of every vehicle's air brake."),
            Wanted("shoe_force", "shoe_force", "Shoe force of the whole train", "", 180),
        ),
    ),
    (
        "disturbance",
        "Disturbance and delay",
        (
            Wanted(
                "disturbance",
                "disturbance",
                "Disturbance: estimate and truth",
                "The estimate lumps everything that the model does not explain; the truth is the outside force alone.",
            ),
            Wanted(
                "delay",
                "delay",
                "Delay from command to effect",
                "Found by shifting the demand until it explains the applied force, window by window; the lag counts "
                "with its time constant. Gaps: the force hardly changed, or was at its limit.",
                190,
            ),
        ),
    ),
    (
        "energy",
        "Energy",
        (
            Wanted(
                "energy",
                "energy",
                "Work done on the train since the start",
                "Positive drives it. Traction, electric brake and all resistances together are the kinetic energy.",
                260,
            ),
        ),
    ),
)
"""Sections: anchor, title, and their figures."""
READINGS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("speed", ("position_km", "speed", "measured_speed", "profile", "limit")),
    ("speed_error", ("speed_error",)),
    ("position_error", ("position_error",)),
    ("forces", ("demand", "applied")),
    ("coupler_extremes", ("draft", "buff")),
    ("pipe", ("pipe",)),
)
"""What the bar under the title says of the moment under the cursor."""
SHORT = {
    "position_km": ("km", "", 3),
    "speed": ("speed", "km/h", 1),
    "measured_speed": ("speed", "km/h", 1),
    "profile": ("profile", "km/h", 1),
    "limit": ("limit", "km/h", 0),
    "speed_error": ("error", "km/h", 2),
    "position_error": ("error", "m", 2),
    "demand": ("demand", "kN", 0),
    "applied": ("applied", "kN", 0),
    "draft": ("draft", "kN", 0),
    "buff": ("buff", "kN", 0),
    "pipe": ("brake pipe", "kPa", 0),
}
"""Its words, units and digits."""


def run_sections(digest: Digest) -> tuple[list[Section], Linked]:
    """Return the figures of a run, those without material left out, and what ties them together."""
    linked = Linked(*digest.span, digest.events)
    sources = {name: source_of(lines.time, lines.columns) for name, lines in digest.lines.items()}
    sections = [*_over_distance(linked, digest, sources)]
    if digest.events:
        figure = event_figure(linked, digest.events)
        caption = "Marked on every figure over time; click on a kind to hide it."
        sections.append(Section("events", "Events", [Placed(figure, "", caption)]))
    for anchor, title, entries in FIGURES:
        placed = []
        for wanted in entries:
            figure = _figure(linked, digest, sources, wanted)
            if figure is not None:
                placed.append(Placed(figure, wanted.heading, wanted.caption))
        if placed:
            sections.append(Section(anchor, title, placed))
    follow_cursor(linked, _readings(sources))
    return sections, linked


def _figure(linked: Linked, digest: Digest, sources: dict[str, ColumnDataSource], wanted: Wanted) -> Figure | None:
    name = wanted.name
    if name == "couplers" and name in digest.maps:
        rows = "coupler behind vehicle"
        return heat_figure(linked, digest.maps[name], "coupler force", "kN", rows, signed=True)
    if name == "shoes" and name in digest.maps:
        return heat_figure(linked, digest.maps[name], "shoe force", "kN", "vehicle", signed=False)
    if name not in sources:
        return None
    columns = [column for column in sources[name].data if column not in HIDDEN]
    return line_figure(linked, wanted.axis, [(sources[name], traces_of(_in_order(columns)))], wanted.height)


def _in_order(columns: list[str]) -> list[str]:
    """Put the columns in the order of the quantities: what comes later lies above."""
    order = {name: place for place, name in enumerate(QUANTITIES)}
    known = [column for column in columns if column.partition(":")[0] in order]
    return sorted(known, key=lambda column: order[column.partition(":")[0]])


def _over_distance(linked: Linked, digest: Digest, sources: dict[str, ColumnDataSource]) -> list[Section]:
    speed = sources.get("speed")
    if speed is None or "position_km" not in speed.data:
        return []
    place = digest.lines["speed"].columns["position_km"]
    ends = [place, *(profile[0] for profile in digest.profiles)]
    linked.set_places(min(float(p.min()) for p in ends), max(float(p.max()) for p in ends))
    columns = [column for column in ("speed", "measured_speed") if column in speed.data]
    placed = [
        Placed(
            distance_figure(linked, [(speed, traces_of(columns))], digest.profiles, digest.limits),
            "Speed over distance",
            "The whole profile is drawn, also where it was not driven.",
        )
    ]
    if digest.track is not None:
        placed.append(Placed(track_figure(linked, digest.track), "Grade and curves", ""))
    return [Section("line", "Along the line", placed)]


def _readings(sources: dict[str, ColumnDataSource]) -> list[Reading]:
    return [
        Reading(sources[table], column, *SHORT[column])
        for table, columns in READINGS
        if table in sources
        for column in columns
        if column in sources[table].data
    ]
