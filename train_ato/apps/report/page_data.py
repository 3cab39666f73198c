"""Data of a page: a few thousand points per figure, one-byte heat maps, events."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from plant_sim.units import KMH
from train_ato.apps.report.curves import KILO, NEVER_APPLIED, NO_COUPLER, Curves, NotAvailable, curves_of
from train_ato.apps.report.downsample import HeatMap, after_jump, heat_map, kept
from train_ato.apps.report.event import Event
from train_ato.apps.report.events import detect_events
from train_ato.apps.report.quantities import NO_LINES
from train_ato.apps.report.track_shape import TrackShape, track_shape
from train_ato.apps.report.words import MODES, driven_laws, evaluation_note
from train_ato.apps.runs.coupler_fatigue import KEYS, coupler_fatigue
from train_ato.loop.recording import BRAKE_SHOES, TRUTH, Recording
from train_ato.loop.result import completed_summary
from train_ato.loop.series import seconds
from train_ato.messages.types import Array, Trajectory

CELLS = 40_000
"""Numbers in one figure of one run, with the times."""
MAP_CELLS = 260_000
"""Cells of one heat map."""
LEAST_COLUMNS, MOST_COLUMNS = 400, 6000
"""Limits of the columns of a heat map."""
LEAST_ROWS, PROFILE_ROWS = 600, 3000
MEASURED = ("measured_file", "measured_columns", "measured_resampled", "measured_profile", "measured_command",
            "measured_reference", "measured_notes")  # fmt: skip
"""Keys of the summary of a measured run with its origin."""


@dataclass(frozen=True)
class PageData:
    """Data of one run for drawing.

    Attributes
    ----------
    label
        Name of the run on the page.
    summary
        Figures of ``summary.json``.
    facts
        Texts on train, line and mode, by title.
    curves, maps
        Figures by name; heat maps in kN.
    profiles
        Place [km] and speed [km/h] of every profile, in the order of planning.
    limits
        Place [km] and speed limit [km/h] of the line as steps.
    subtitle
        Summary of the scenario.
    remarks
        Warnings on missing or measured data.
    left_out
        Figures without data, and the reason.
    evaluation
        Part of the run that the error metrics leave out, "" for none.
    """

    label: str
    summary: dict[str, Any]
    facts: dict[str, str]
    span: tuple[float, float]
    curves: dict[str, Curves]
    maps: dict[str, HeatMap]
    events: list[Event]
    profiles: list[tuple[Array, Array]]
    limits: tuple[Array, Array] | None
    track: TrackShape | None
    subtitle: str = ""
    remarks: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    evaluation: str = ""


def page_data(recording: Recording, label: str = "", share: float = 1.0) -> PageData:
    """Return the data of a page from a recording.

    Parameters
    ----------
    recording
        The run.
    label
        Name on the page; default: the name of its folder.
    share
        Fraction of the page for this run, see :func:`share_of`.
    """
    recording = replace(recording.within_span(), summary={**completed_summary(recording), **_damage(recording)})
    curves, left_out = curves_of(recording, reduced=lambda lines: downsampled(lines, round(share * CELLS)))
    maps: dict[str, HeatMap] = {}
    for name, gather in MAPS.items():
        try:
            time, values = gather(recording)
            maps[name] = heat_map(time, values, columns_for(values.shape[1], share))
        except NotAvailable as reason:
            left_out[name] = str(reason)
    return PageData(
        label or recording.name,
        recording.summary,
        fact_texts(recording),
        recording.span,
        curves,
        maps,
        detect_events(recording),
        [_over_distance(plan) for plan in recording.profiles],
        _steps(recording),
        _track(recording),
        recording.setup.scenario.summary if recording.setup is not None else "",
        remarks_of(recording),
        left_out,
        evaluation_note(recording.setup.scenario.evaluation) if recording.setup is not None else "",
    )


def _damage(recording: Recording) -> dict[str, float | int]:
    """Return the fatigue damage of the couplers, {} without couplers."""
    fatigue = coupler_fatigue(recording)
    return {} if fatigue is None else {key: value for key, value in fatigue.summary().items() if key in KEYS}


def empty_page_data(label: str, summary: dict[str, Any], reason: str) -> PageData:
    """Return the data of a run without recording: a column in the tables and no curves."""
    return PageData(label, summary, {}, (0.0, 0.0), {}, {}, [], [], None, None, remarks=[f"{label}: {reason}"])


def share_of(runs: int) -> float:
    """Return the fraction of a page's numbers for each run; the page grows slowly with the number of runs."""
    return 1.0 if runs == 1 else 2.0 / (runs + 1.0)


def columns_for(places: int, share: float) -> int:
    """Return the maximum number of columns of a heat map."""
    return round(float(np.clip(share * MAP_CELLS / max(1, places), LEAST_COLUMNS, MOST_COLUMNS)))


def remarks_of(recording: Recording) -> list[str]:
    """Return warnings on missing or measured data."""
    remarks = []
    if recording.setup is None:
        remarks.append(f"No scenario: train, line and envelope are missing ({recording.setup_missing})")
    if recording.measured_only:
        remarks.append("The log has no true vehicle states; speeds and positions are measured values.")
    return remarks


def downsampled(lines: Curves, cells: int) -> Curves:
    """Return curves reduced to about ``cells`` numbers; peaks are kept."""
    rows = max(LEAST_ROWS, cells // (1 + len(lines.columns)))
    chosen = kept([values for name, values in lines.columns.items() if name not in NO_LINES], rows)
    return Curves(lines.time[chosen], {name: values[chosen] for name, values in lines.columns.items()})


def _over_distance(plan: Trajectory) -> tuple[Array, Array]:
    begin = after_jump(seconds(plan.time), plan.position, plan.velocity)
    position, speed = plan.position[begin:], plan.velocity[begin:]
    chosen = kept([KMH * speed], PROFILE_ROWS)
    return position[chosen] / 1e3, KMH * speed[chosen]


def run_reach(recording: Recording) -> tuple[float, float] | None:
    """Return the first and the last place of the run and of its profiles [m]."""
    places = [plan.position for plan in recording.profiles if plan.position.size]
    motion = recording.motion
    if motion is not None and "position" in motion:
        places.append(motion["position"][:, 0])
    if not places:
        return None
    begin, end = min(float(np.nanmin(p)) for p in places), max(float(np.nanmax(p)) for p in places)
    return (begin, end) if end - begin > 1.0 else None


def _steps(recording: Recording) -> tuple[Array, Array] | None:
    """Return the speed limits within reach as corners of a step line."""
    reach = run_reach(recording)
    if recording.limits is None or not recording.limits.position.size or reach is None:
        return None
    places, speeds = recording.limits.position, recording.limits.velocity
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


def fact_texts(recording: Recording) -> dict[str, str]:
    """Return train, line, law, seed and mode of a run as texts."""
    summary, setup = recording.summary, recording.setup
    facts: dict[str, str] = {}
    if setup is not None:
        consist, units = setup.consist, setup.layout.n_units
        vehicles = f"{setup.layout.n_vehicles} vehicle{'s' if setup.layout.n_vehicles > 1 else ''}"
        powered = f"{units} power unit{'s' if units != 1 else ''}"
        size = f"{vehicles}, {powered}, {consist.mass / 1e3:.0f} t, {consist.length:.0f} m"
        facts["train"] = f"{consist.name} ({size})"
        facts["line"] = setup.line.name
        facts["law"] = driven_laws(summary) or setup.controller
        facts["observer"] = setup.observer
        facts["compensation"] = setup.compensation
        facts["seed"] = str(setup.seed)
        facts["tick"] = f"{setup.tick:g} s"
    if "controller" in summary:
        facts["law"] = driven_laws(summary)
    for key in ("observer", "compensation", "seed"):
        if key in summary:
            facts[key] = str(summary[key])
    facts |= {key.replace("_", " "): str(summary[key]) for key in MEASURED if summary.get(key)}
    mode = "measured run" if "measured_file" in summary else str(summary.get("mode") or "not recorded")
    facts["mode"] = MODES.get(mode, mode)
    facts["run"] = str(recording.path)
    if "version" in summary:
        facts["version"] = f"train_ato {summary['version']}"
    return facts


def coupler_map(recording: Recording) -> tuple[Array, Array]:
    """Return time [s] and the force of every coupler [kN], shape (k, vehicles - 1), > 0 draft."""
    found = recording.of(TRUTH, "coupler_force")
    if found is None:
        raise NotAvailable("the log has no train/vehicles")
    if found[1].shape[1] < 2:
        raise NotAvailable(NO_COUPLER)
    return found[0], found[1][:, :-1] / KILO


def shoe_map(recording: Recording) -> tuple[Array, Array]:
    """Return time [s] and the shoe force of every vehicle [kN], shape (k, vehicles)."""
    found = recording.of(BRAKE_SHOES, "shoe_force")
    if found is None:
        raise NotAvailable(recording.without_brake)
    if not np.any(found[1]):
        raise NotAvailable(NEVER_APPLIED)
    return found[0], found[1] / KILO


MAPS: dict[str, Callable[[Recording], tuple[Array, Array]]] = {"couplers": coupler_map, "shoes": shoe_map}
"""Figures of all vehicles over time."""
