"""A run reduced to what a page holds: a few thousand points a figure, pictures of a byte a cell, its events."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from train_ato.report.events import Event
from train_ato.report.happened import events_of
from train_ato.report.lines import KMH, LINES, MAPS, LeftOut, Lines
from train_ato.report.log_summary import completed_summary
from train_ato.report.recording import Recording
from train_ato.report.thin import HeatMap, heat_map, kept
from train_ato.report.track_shape import TrackShape, track_shape
from train_ato.report.words import WAYS
from train_ato.types import Array

CELLS = 40_000
"""Numbers of one figure of one run, times included."""
MAP_CELLS = 260_000
"""Cells of one heat map."""
LEAST_COLUMNS, MOST_COLUMNS = 400, 6000
"""Columns of a heat map, however many vehicles there are."""
LEAST_ROWS, PROFILE_ROWS = 600, 3000
MEASURED = ("measured_file", "measured_columns", "measured_resampled", "measured_profile", "measured_command",
            "measured_reference", "measured_notes")  # fmt: skip
"""What the summary of a measured run says of its origin."""
MEASURES = ("position_km", "envelope_high", "envelope_low")
"""Columns that go along smoothly with others: no point is kept for them."""


@dataclass(frozen=True)
class Digest:
    """One run, ready to be drawn.

    Attributes
    ----------
    label
        What the run is called on the page.
    summary
        Its figures.
    facts
        Words about train, line and way of running, by title.
    lines, maps
        Figures by name; heat maps in kN.
    profiles
        Place [km] and speed [km/h] of every profile, in the order in which they were planned.
    limits
        Place [km] and speed limit [km/h] of the line as steps.
    subtitle
        What the scenario is about.
    remarks
        What a reader must know before the figures.
    left_out
        Figures that the run cannot fill, and why.
    """

    label: str
    summary: dict[str, Any]
    facts: dict[str, str]
    span: tuple[float, float]
    lines: dict[str, Lines]
    maps: dict[str, HeatMap]
    events: list[Event]
    profiles: list[tuple[Array, Array]]
    limits: tuple[Array, Array] | None
    track: TrackShape | None
    subtitle: str = ""
    remarks: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


def digest(recording: Recording, label: str = "", share: float = 1.0) -> Digest:
    """Reduce a run.

    Parameters
    ----------
    recording
        The run.
    label
        What it is called; default: the name of its folder.
    share
        Part of a page that the run may take, see :func:`share_of`.
    """
    recording = replace(recording, summary=completed_summary(recording))
    lines: dict[str, Lines] = {}
    maps: dict[str, HeatMap] = {}
    left_out: dict[str, str] = {}
    for name, make in LINES.items():
        try:
            lines[name] = thinned(make(recording), round(share * CELLS))
        except LeftOut as reason:
            left_out[name] = str(reason)
    for name, gather in MAPS.items():
        try:
            time, values = gather(recording)
            maps[name] = heat_map(time, values, columns_for(values.shape[1], share))
        except LeftOut as reason:
            left_out[name] = str(reason)
    return Digest(
        label or recording.name,
        recording.summary,
        facts_of(recording),
        recording.span,
        lines,
        maps,
        events_of(recording),
        [_over_distance(plan.position, plan.speed) for plan in recording.profiles],
        _steps(recording),
        _track(recording),
        recording.setup.scenario.summary if recording.setup is not None else "",
        remarks_of(recording),
        left_out,
    )


def empty_digest(label: str, summary: dict[str, Any], reason: str) -> Digest:
    """Return a run of which nothing was recorded: a column in the tables and no line."""
    return Digest(label, summary, {}, (0.0, 0.0), {}, {}, [], [], None, None, remarks=[f"{label}: {reason}"])


def share_of(runs: int) -> float:
    """Return what part of a page's numbers each of so many runs may have, so that the page grows slowly with them."""
    return 1.0 if runs == 1 else 2.0 / (runs + 1.0)


def columns_for(places: int, share: float) -> int:
    """Return the most columns of a heat map of so many vehicles."""
    return round(float(np.clip(share * MAP_CELLS / max(1, places), LEAST_COLUMNS, MOST_COLUMNS)))


def remarks_of(recording: Recording) -> list[str]:
    """Return what a reader must know of a recording that is no whole run of ours."""
    remarks = []
    if recording.setup is None:
        remarks.append(f"Without scenario: no train, line or envelope is known ({recording.setup_missing})")
    if recording.measured_only:
        remarks.append("The log holds no truth of the vehicles: speeds and positions are those measured.")
    return remarks


def thinned(lines: Lines, cells: int) -> Lines:
    """Return lines with at most about so many numbers altogether, peaks kept."""
    rows = max(LEAST_ROWS, cells // (1 + len(lines.columns)))
    chosen = kept([values for name, values in lines.columns.items() if name not in MEASURES], rows)
    return Lines(lines.time[chosen], {name: values[chosen] for name, values in lines.columns.items()})


def _over_distance(position: Array, speed: Array) -> tuple[Array, Array]:
    chosen = kept([KMH * speed], PROFILE_ROWS)
    return position[chosen] / 1e3, KMH * speed[chosen]


def run_reach(recording: Recording) -> tuple[float, float] | None:
    """Return the first and the last place that matter [m]: those run, and those planned."""
    places = [plan.position for plan in recording.profiles if plan.position.size]
    motion = recording.motion
    if motion is not None and "position" in motion:
        places.append(motion["position"][:, 0])
    if not places:
        return None
    begin, end = min(float(np.nanmin(p)) for p in places), max(float(np.nanmax(p)) for p in places)
    return (begin, end) if end - begin > 1.0 else None


def _steps(recording: Recording) -> tuple[Array, Array] | None:
    """Return the speed limits within reach as corners of a line."""
    reach = run_reach(recording)
    if recording.limits is None or reach is None:
        return None
    places, speeds = recording.limits
    inside = (places > reach[0]) & (places < reach[1])
    first = max(0, int(np.searchsorted(places, reach[0], side="right")) - 1)
    corners = np.concatenate(([max(reach[0], float(places[first]))], places[inside], [reach[1]]))
    values = speeds[np.maximum(np.searchsorted(places, corners, side="right") - 1, 0)]
    return np.repeat(corners, 2)[1:-1] / 1e3, KMH * np.repeat(values[:-1], 2)


def _track(recording: Recording) -> TrackShape | None:
    reach = run_reach(recording)
    if recording.setup is None or reach is None:
        return None
    shape = track_shape(recording.setup.line, *reach)
    return None if shape.is_plain else shape


def facts_of(recording: Recording) -> dict[str, str]:
    """Return what a reader wants to know of a run before its figures."""
    summary, setup = recording.summary, recording.setup
    facts: dict[str, str] = {}
    if setup is not None:
        consist, units = setup.consist, setup.shape.n_units
        vehicles = f"{setup.shape.n_vehicles} vehicle{'s' if setup.shape.n_vehicles > 1 else ''}"
        size = f"{vehicles}, {units} driven, {consist.mass / 1e3:.0f} t, {consist.length:.0f} m"
        facts["train"] = f"{consist.name} ({size})"
        facts["line"] = setup.line.name
        facts["law"] = setup.controller
        facts["observer"] = setup.observer
        facts["compensation"] = setup.compensation
        facts["seed"] = str(setup.seed)
        facts["tick"] = f"{setup.tick:g} s"
    for key in ("controller", "observer", "compensation", "seed"):
        if key in summary:
            facts[{"controller": "law"}.get(key, key)] = str(summary[key])
    facts |= {key.replace("_", " "): str(summary[key]) for key in MEASURED if summary.get(key)}
    way = "a measured run" if "measured_file" in summary else str(summary.get("way") or "not recorded")
    facts["run as"] = WAYS.get(way, way)
    facts["run"] = str(recording.path)
    if "version" in summary:
        facts["version"] = f"train_ato {summary['version']}"
    return facts
