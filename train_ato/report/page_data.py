"""Data of a page: a few thousand points per figure, one-byte heat maps, events."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_sim.line import Line
from plant_sim.track import Track
from plant_sim.units import KMH
from train_ato.judge.metrics import FATIGUE_KEYS, coupler_fatigue
from train_ato.judge.motion_difference import DrivenMotion, MotionDifference, motion_difference
from train_ato.judge.recording import BRAKE_SHOES, TRUTH, Recording
from train_ato.judge.result import completed_summary
from train_ato.judge.series import seconds
from train_ato.messages.types import Array, Trajectory
from train_ato.program.display_units import display_unit
from train_ato.report.curves import KILO, NEVER_APPLIED, NO_COUPLER, Curves, NotAvailable, curves_of
from train_ato.report.events import Event, detect_events
from train_ato.report.quantities import NO_LINES, RUN_COLOURS
from train_ato.report.words import MODES, driven_laws, evaluation_note

MAX_CODE = 127
"""Largest magnitude of the codes of a heat map."""
NO_CODE = -128
"""Code of a cell without a value."""
MAX_STEP = 5.0
"""Largest difference of a step of a profile from that of its speed that is no jump [m]."""
GAP = 3.0
"""Number of steps for which a value is held; a longer pause is a gap."""


def after_jump(time: Array, position: Array, velocity: Array) -> int:
    """Return the first knot of a profile after its last jump, 0 without one.

    The plan after an engagement begins at the place of the train, not on the profile before it.

    Parameters
    ----------
    time, position, velocity : shape (k,)
        Knots [s, m, m/s].
    """
    steps = np.diff(position) - np.diff(time) * (velocity[1:] + velocity[:-1]) / 2.0
    jumps = np.flatnonzero(np.abs(steps) > MAX_STEP)
    return int(jumps[-1]) + 1 if jumps.size else 0


def kept(columns: list[Array], rows: int) -> NDArray[np.intp]:
    """Return rows of a table that contain the peaks of every column.

    The table is divided into equal bins.  The rows of the minimum and maximum of every column in every bin are kept,
    and the first and the last row.

    Parameters
    ----------
    columns
        Columns of one length k; NaN where there is no value.
    rows
        Maximum number of rows, at least ``2 len(columns) + 2``.

    Returns
    -------
    ndarray of intp
        Increasing row numbers; all rows of a table with at most ``rows``.  Rows at the ends of gaps are added.
    """
    count = columns[0].size if columns else 0
    if count <= rows:
        return np.arange(count)
    bins = max(1, (rows - 2) // (2 * len(columns)))
    edges = np.linspace(0, count, bins + 1).astype(np.intp)
    width = int(np.diff(edges).max())
    cells = np.minimum(edges[:-1, None] + np.arange(width), edges[1:, None] - 1)
    found = [np.array([0, count - 1])]
    for column in columns:
        values = column[cells]
        holes = np.isnan(values)
        found.append(cells[np.arange(bins), np.where(holes, np.inf, values).argmin(axis=1)])
        found.append(cells[np.arange(bins), np.where(holes, -np.inf, values).argmax(axis=1)])
    chosen = np.unique(np.concatenate(found))
    return np.union1d(chosen, _edges_of_gaps(columns, chosen))


def _edges_of_gaps(columns: list[Array], chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the rows at the ends of gaps, so that gaps stay visible; none if there are many."""
    edges: list[NDArray[np.intp]] = []
    for column in columns:
        changes = np.flatnonzero(np.diff(np.isnan(column).astype(np.int8)))
        edges += [changes, changes + 1]
    together = np.unique(np.concatenate(edges)) if edges else chosen[:0]
    return together if together.size <= chosen.size // 4 else chosen[:0]


@dataclass(frozen=True)
class HeatMap:
    """Values of all vehicles over time with one byte per cell.

    Attributes
    ----------
    codes : ndarray of int8, shape (places, columns)
        Value over ``unit``; -128: no value.
    unit : float
        Value of one step of the code.
    begin, end : float
        Time at the left and the right edge [s].
    """

    codes: NDArray[np.int8]
    unit: float
    begin: float
    end: float

    @property
    def largest(self) -> float:
        """Value of the largest code."""
        return MAX_CODE * self.unit

    def scaled(self, largest: float) -> "HeatMap":
        """Return the map with another scale, on which the largest code has the value ``largest``."""
        unit = largest / MAX_CODE
        codes = np.rint(np.clip(self.codes * (self.unit / unit), -MAX_CODE, MAX_CODE)).astype(np.int8)
        return HeatMap(np.where(self.codes == NO_CODE, np.int8(NO_CODE), codes), unit, self.begin, self.end)


def heat_map(time: Array, values: NDArray[np.floating], columns: int) -> HeatMap:
    """Return a heat map of values over time; a cell has the value with the largest magnitude.

    Parameters
    ----------
    time : shape (k,)
        Increasing times [s].
    values : shape (k, places)
        Values.
    columns
        Maximum number of columns.
    """
    begin, end = float(time[0]), float(time[-1])
    step = (end - begin) / max(1, time.size - 1) or 1.0
    end += step
    count = max(1, min(columns, time.size))
    width = (end - begin) / count
    column = np.minimum(((time - begin) / width + 1e-6).astype(np.intp), count - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    finite = np.nan_to_num(values, nan=0.0)
    high, low = np.maximum.reduceat(finite, starts, axis=0), np.minimum.reduceat(finite, starts, axis=0)
    extreme = np.where(high >= -low, high, low)
    top = float(np.abs(extreme).max())
    unit = top / MAX_CODE if top > 0 else 1.0
    codes = np.rint(np.clip(extreme.T / unit, -MAX_CODE, MAX_CODE)).astype(np.int8)
    held = np.searchsorted(column[starts], np.arange(count), side="right") - 1
    picture = codes[:, held]
    middles: Array = np.asarray(begin + width * (np.arange(count) + 0.5), dtype=np.float64)
    before = np.maximum(np.searchsorted(time, middles, side="right") - 1, 0)
    picture[:, middles - time[before] > GAP * max(width, step)] = NO_CODE  # the last value is too old
    return HeatMap(picture, unit, begin, end)


@dataclass(frozen=True)
class TrackShape:
    """Part of a line between two places.

    Attributes
    ----------
    place, grade : Array, shape (m,)
        Step function: places [km], grade from there on [‰], > 0 uphill; the last entry is the end.
    height : Array, shape (m,)
        Height above the first place [m].
    curves : list of (begin km, end km, radius m)
    tunnels : list of (begin km, end km)
    """

    place: Array
    grade: Array
    height: Array
    curves: list[tuple[float, float, float]]
    tunnels: list[tuple[float, float]]

    @property
    def is_plain(self) -> bool:
        """True for a level, straight line without tunnels."""
        return not (np.any(self.grade) or self.curves or self.tunnels)

    def shown(self) -> "TrackShape":
        """Return the part in the units of display."""
        km, metre = display_unit("km")[1], display_unit("m")[1]
        return TrackShape(
            km * self.place,
            self.grade,
            metre * self.height,
            [(km * begin, km * end, metre * radius) for begin, end, radius in self.curves],
            [(km * begin, km * end) for begin, end in self.tunnels],
        )


def track_shape(line: Line, begin: float, end: float) -> TrackShape:
    """Return the part of a line between two places [m]."""
    track = Track(line)
    inside = track.breaks[(track.breaks > begin) & (track.breaks < end)]
    changes = np.diff(track.grade[np.searchsorted(track.breaks, inside, side="right")], prepend=np.nan) != 0
    place = np.concatenate(([begin], inside[changes], [end]))
    grade = track.grade[np.searchsorted(track.breaks, place, side="right")]
    grade[-1] = grade[-2]
    height = track.elevation(place)
    return TrackShape(
        place / 1e3,
        1e3 * grade,
        height - height[0],
        [
            (max(curve.begin, begin) / 1e3, min(curve.end, end) / 1e3, curve.radius)
            for curve in line.curves
            if curve.end > begin and curve.begin < end
        ],
        [
            (max(tunnel.begin, begin) / 1e3, min(tunnel.end, end) / 1e3)
            for tunnel in line.tunnels
            if tunnel.end > begin and tunnel.begin < end
        ],
    )


CELLS = 40_000
"""Numbers in one figure of one run, with the times."""
MAP_CELLS = 260_000
"""Cells of one heat map."""
MIN_COLUMNS, MAX_COLUMNS = 400, 6000
"""Limits of the columns of a heat map."""
MIN_ROWS, PROFILE_ROWS = 600, 3000
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
    motion
        DrivenMotion for the difference from another run; None without train and line.
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
    motion: DrivenMotion | None = None
    stations: list[tuple[float, str]] = field(default_factory=list)


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
    fatigue, summary = coupler_fatigue(recording), completed_summary(recording)
    if fatigue is not None:
        summary = summary | {key: value for key, value in fatigue.summary().items() if key in FATIGUE_KEYS}
    recording = replace(recording.within_span(), summary=summary)
    curves, left_out = curves_of(recording, reduced=lambda lines: downsampled(lines, round(share * CELLS)))
    left_out.pop("signals", None)  # a run without them lacks nothing
    maps: dict[str, HeatMap] = {}
    for name, gather in MAPS.items():
        try:
            time, values = gather(recording)
            columns = np.clip(share * MAP_CELLS / max(1, values.shape[1]), MIN_COLUMNS, MAX_COLUMNS)
            maps[name] = heat_map(time, values, round(float(columns)))
        except NotAvailable as reason:
            left_out[name] = str(reason)
    per_km, per_speed, per_kn = (display_unit(unit)[1] for unit in ("km", "km/h", "kN"))
    profiles = [_over_distance(plan) for plan in recording.profiles]
    limits, shape = _steps(recording), _track(recording)
    return PageData(
        label or recording.name,
        recording.summary,
        fact_texts(recording),
        recording.span,
        curves,
        {name: replace(picture, unit=per_kn * picture.unit) for name, picture in maps.items()},
        detect_events(recording),
        [(per_km * place, per_speed * speed) for place, speed in profiles],
        None if limits is None else (per_km * limits[0], per_speed * limits[1]),
        None if shape is None else shape.shown(),
        recording.setup.scenario.summary if recording.setup is not None else "",
        remarks_of(recording),
        left_out,
        evaluation_note(recording.setup.scenario.evaluation) if recording.setup is not None else "",
        DrivenMotion.of(recording, recording.summary),
        [(per_km * place, name) for place, name in _stations(recording)],
    )


def empty_page_data(label: str, summary: dict[str, Any], reason: str) -> PageData:
    """Return the data of a run without recording: a column in the tables and no curves."""
    return PageData(label, summary, {}, (0.0, 0.0), {}, {}, [], [], None, None, remarks=[f"{label}: {reason}"])


def share_of(runs: int) -> float:
    """Return the fraction of a page's numbers for each run; the page grows slowly with the number of runs."""
    return 1.0 if runs == 1 else 2.0 / (runs + 1.0)


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
    rows = max(MIN_ROWS, cells // (1 + len(lines.columns)))
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


def _stations(recording: Recording) -> list[tuple[float, str]]:
    reach = run_reach(recording)
    if recording.setup is None or reach is None:
        return []
    half = recording.setup.consist.vehicles[0].length / 2.0
    places = [(stop.at - half, stop.name) for stop in recording.setup.line.stops]
    return [(place / 1e3, name) for place, name in places if reach[0] - half <= place <= reach[1] + half]


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
        facts["law"] = driven_laws(summary) or setup.scenario.law
        facts["observer"] = setup.scenario.observer
        facts["compensation"] = setup.scenario.compensation
        facts["seed"] = str(setup.scenario.seed)
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


def run_colours(count: int) -> list[str]:
    """Return a colour for every run."""
    return [RUN_COLOURS[index % len(RUN_COLOURS)] for index in range(count)]


def common_events(pages: Sequence[PageData]) -> list[Event]:
    """Return the events that are in every run at the same time."""
    if not pages:
        return []

    def key(event: Event) -> tuple[str, str, int]:
        return event.kind, event.text, round(event.begin)

    shared = set.intersection(*({key(event) for event in data.events} for data in pages))
    return [event for event in pages[0].events if key(event) in shared and event.kind != "limit"]


def run_dash(index: int) -> str:
    """Return the line style of a run; runs with the same colour differ in it."""
    return ("solid", "dashed", "dotted")[index // len(RUN_COLOURS) % 3]


def largest_magnitude(lines: Curves | None, column: str) -> Array | None:
    """Return a column; for several power units, the value with the largest magnitude at every time."""
    if lines is None:
        return None
    of_units = [values for name, values in lines.columns.items() if name.partition(":")[0] == column]
    if not of_units:
        return None
    table = np.array(of_units)
    return np.asarray(table[np.nan_to_num(np.abs(table)).argmax(axis=0), np.arange(table.shape[1])])


def motion_differences(pages: Sequence[PageData]) -> dict[str, MotionDifference]:
    """Return the difference of every later run from the first one by label; without runs that have none in common."""
    found: dict[str, MotionDifference] = {}
    for data in pages[1:]:
        if pages[0].motion is None or data.motion is None:
            continue
        with contextlib.suppress(ValueError):  # no common time or place
            found[data.label] = motion_difference(pages[0].motion, data.motion)
    return found
