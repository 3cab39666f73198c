"""Feed from a recorded run, with seek, steps and playback at a selected rate."""

import math
import threading
import time
from bisect import bisect_right
from dataclasses import replace
from pathlib import Path

import numpy as np

from plant_sim.units import KMH
from train_ato.control.contract import LawPlan
from train_ato.judge import recording as rec
from train_ato.judge.result import completed_summary
from train_ato.judge.series import TopicSamples, seconds
from train_ato.judge.verdict import verdict_line
from train_ato.log.recorded import open_recording
from train_ato.messages.topic import TrainLayout
from train_ato.messages.types import Array
from train_ato.report.events import detect_events
from train_ato.view.facts import Facts, ProfileCurve, facts_of, plan_of_row
from train_ato.view.feed import FRAMES_PER_SECOND, REPORT_PAGE, Ending, Feed, Mark, WholeRun, protection_history
from train_ato.view.feed import MAX_POINTS as POINTS_OF_OVERVIEW
from train_ato.view.snapshot import STRIP, Snapshot

MAX_POINTS = 1500
"""Largest number of points of a strip chart in one message."""
LABELS = {"limit": "force limit", "air_brake": "air brake"}
"""Labels of kinds of event that differ from the name of the kind."""
PROTECTION_KINDS = ("supervision", "protection", "ato")
"""Kinds of event whose marks come from the changes of the states."""


class RecordedFeed(Feed):
    """Data of a run folder or a log for playback.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    namespace
        Namespace of one of several trains in the log; without it the first one is shown.

    Attributes
    ----------
    playing : bool
    speed : float
        Simulated seconds per second of wall time.
    tick : float
        Tick of the run [s].
    time : float
        Simulated time on the page [s].
    span : tuple of float
        First and last simulated time [s].

    Raises
    ------
    ValueError
        One line: no run, an incomplete run, a damaged log, or a log without the motion of the train.
    """

    def __init__(self, run: Path, namespace: str = "") -> None:
        self.recording = recording = open_recording(run, namespace=namespace).within_span()
        self._cars = cars = _cars(recording)
        if rec.REFERENCE not in recording.topics:
            raise ValueError(f"{run}: no ato/reference in the log; use `train-ato report` for the recorded topics")
        super().__init__(_facts(recording, cars))
        self.folder = run if run.is_dir() else None
        self.ending = Ending("", verdict_line(completed_summary(recording)), REPORT_PAGE if self.folder else "")
        self.span = (float(self._cars.time[0]), float(self._cars.time[-1]))
        self.tick = float(np.median(np.diff(self._cars.time))) if self._cars.time.size > 1 else 1.0
        self.playing, self.speed, self.time = False, 1.0, self.span[0]
        self._turn = threading.RLock()
        self._looked = time.monotonic()
        self._row = -1
        self._plan: tuple[int, LawPlan | None] = (-1, None)
        self._profiles = [
            ProfileCurve(seconds(found.time), found.position, found.velocity) for found in recording.profiles
        ]
        self.timetable = self._profiles[0] if self._profiles else None
        self._planned = np.array([found.stamp * 1e-9 for found in recording.profiles])
        self._table = _table(recording, cars, self.facts)
        self._changed, self._states, marks = protection_history(recording.changed_reports)
        events = [event for event in detect_events(recording) if event.kind not in PROTECTION_KINDS]
        labels = LABELS | {"outside": ""}  # of an intervention its first word
        marks += [
            Mark(event.begin, labels.get(event.kind, event.kind) or event.text.partition(" ")[0], event.text)
            for event in events
        ]
        self.marks = sorted(marks, key=lambda mark: mark.time)
        self.overview = self._whole()
        urgent = [mark.time for mark in self.marks if mark.acknowledge]  # first intervention or failure
        largest = int(np.abs(np.nan_to_num(self._table["error"])).argmax())
        self.seek(urgent[0] if urgent else float(self._table["time"][largest]))

    def _whole(self) -> WholeRun:
        """Return the overview of the whole run."""
        whole, table = WholeRun(self.span), self._table
        reports = self.recording.diagnostics.get("controller")
        laws = [] if reports is None else reports.texts("controller")
        for row in range(0, table["time"].size, max(1, table["time"].size // (2 * POINTS_OF_OVERVIEW))):
            at = float(table["time"][row])
            law = "" if reports is None else str(laws[_before(reports.time, at)] or "")
            ato = self._states[max(0, bisect_right(self._changed, at + 1e-9) - 1)].ato
            whole.add(at, float(table["speed"][row]), float(table["limit"][row]), law=law, ato=ato)
        return whole

    def seek(self, moment: float) -> None:
        """Show the run at a time [s]."""
        with self._turn:
            self.time = min(max(moment, self.span[0]), self.span[1])
            self._looked = time.monotonic()
            self._show()

    def set_playing(self, *, playing: bool) -> None:
        """Start or stop playback; at the end it starts again from the beginning."""
        if playing and not self.playing and self.time >= self.span[1]:
            self.seek(self.span[0])
        self.seek(self.time)
        self.playing = playing

    def step(self, ticks: int) -> None:
        """Move by a number of ticks."""
        row = min(max(self._row + ticks, 0), self._cars.time.size - 1)
        self.seek(float(self._cars.time[row]))

    def advance(self) -> None:
        """Advance the time by the wall time since the last call; any number of pages may call it."""
        with self._turn:
            now = time.monotonic()
            passed = now - self._looked
            if passed < 0.9 / FRAMES_PER_SECOND:
                return
            self._looked = now
            if self.playing:
                self.time = min(self.time + self.speed * passed, self.span[1])
                self.playing = self.time < self.span[1]
                self._show()

    def _show(self) -> None:
        row = _before(self._cars.time, self.time)
        if row == self._row:
            return
        self._row = row
        moment = float(self._cars.time[row])
        if self._profiles:
            newest = self._profiles[max(0, int(np.searchsorted(self._planned, moment, side="right")) - 1)]
            if newest is not self.profile:
                self.take_profile(newest)
        self.show(self._moment(row), kept=False)

    def _moment(self, row: int) -> Snapshot:
        cars, at = self._cars, float(self._cars.time[row])
        nothing = np.full(self.facts.layout.n_units, np.nan)
        reference = self.recording.topics[rec.REFERENCE]
        where = _before(reference.time, at)
        position, speed, acceleration = (
            float(reference.row(name, where)[0]) for name in ("position", "velocity", "acceleration")
        )
        shoe, pipe = self._at(rec.BRAKE_SHOES, "shoe_force", at), self._at(rec.BRAKE_PIPE, "pressure", at)
        wanted, speeds = self._at(rec.BRAKE_PIPE_COMMAND, "pressure", at), self._at(rec.SUPERVISED_SPEEDS, "speed", at)
        applied, command, estimate = (
            self._at(topic, name, at)
            for topic, name in ((rec.MEASUREMENT, "applied"), (rec.COMMAND, "force"), (rec.ESTIMATE, "force"))
        )
        return Snapshot(
            time=at,
            position=cars.row("position", row),
            velocity=cars.row("velocity", row),
            coupler=cars.row("coupler_force", row),
            shoe=shoe,
            applied=nothing if applied is None else applied,
            command=nothing if command is None else command,
            estimate=nothing if estimate is None else estimate,
            reference=(position, speed, acceleration),
            pipe=math.nan if pipe is None else float(pipe[0]),
            pipe_demand=math.nan if wanted is None else float(wanted[0]),
            law=self._reported("controller", at, "controller"),
            state=self._reported("plant", at),
            factor=self.speed if self.playing else math.nan,
            limits=None if speeds is None else speeds[1:],
            states=self._states[max(0, bisect_right(self._changed, at + 1e-9) - 1)],
            plan=self._plan_at(at),
        )

    def _plan_at(self, at: float) -> LawPlan | None:
        """Return the newest plan of the law at a time [s]."""
        series = self.recording.diagnostics.get("controller")
        if series is None:
            return None
        row = _before(series.time, at)
        if row != self._plan[0]:
            self._plan = row, plan_of_row(series, row)
        return self._plan[1]

    def _at(self, topic: str, name: str, at: float) -> Array | None:
        found = self.recording.topics.get(topic)
        return None if found is None or name not in found else found.row(name, _before(found.time, at))

    def _reported(self, node: str, at: float, key: str | None = None) -> str:
        series = self.recording.diagnostics.get(node)
        if series is None:
            return ""
        row = _before(series.time, at)
        return series.message[row] if key is None else str(series.texts(key)[row] or "")

    def part(self, begin: float, end: float) -> dict[str, Array]:
        """Return the columns of the strip charts between two times [s], downsampled by a constant stride."""
        times = self._table["time"]
        first, last = np.searchsorted(times, (begin, end))
        stride = max(1, math.ceil((last - first) / MAX_POINTS))
        return {name: column[first:last:stride] for name, column in self._table.items()}


def _before(times: Array, at: float) -> int:
    """Return the row of the last sample at or before a time."""
    return max(0, int(np.searchsorted(times, at + 1e-9, side="right")) - 1)


def _cars(recording: rec.Recording) -> TopicSamples:
    """Return the motion of the vehicles; for a measured run that of the first one, from the measurement."""
    cars, measured, setup = (recording.topics.get(rec.TRUTH), recording.topics.get(rec.MEASUREMENT), recording.setup)
    if cars is not None:
        return cars
    if setup is None or measured is None or not {"position", "velocity"} <= measured.values.keys():
        raise ValueError(
            f"{recording.path}: no train/vehicles in the log; use `train-ato report` for the recorded topics"
        )
    first = measured["position"][:, :1] + setup.model.offsets[0]
    values = {"position": first, "velocity": measured["velocity"][:, :1], "coupler_force": np.zeros_like(first)}
    return TopicSamples(measured.time, values)


def _facts(recording: rec.Recording, cars: TopicSamples) -> Facts:
    supervised = rec.SUPERVISED_SPEEDS in recording.topics
    if recording.setup is not None:
        facts = facts_of(recording.setup)
        layout = replace(facts.layout, supervised=supervised)
        known = cars.row("velocity", 0).size
        return replace(facts, layout=replace(layout, n_vehicles=known) if recording.measured_only else layout)
    measured = recording.topics.get(rec.MEASUREMENT)
    units = measured["applied"].shape[1] if measured is not None and "applied" in measured else 0
    layout = TrainLayout(cars.row("velocity", 0).size, units, (), rec.BRAKE_PIPE in recording.topics, False, supervised)
    limits = recording.limits
    places, speeds = (limits.position, limits.velocity) if limits is not None else (np.zeros(0), np.zeros(0))
    span = recording.span
    return Facts(recording.name, layout, span[1] - span[0], limit_places=places, limit_speeds=speeds)


def _table(recording: rec.Recording, cars: TopicSamples, facts: Facts) -> dict[str, Array]:
    """Return the columns :data:`train_ato.view.snapshot.STRIP` of the whole run."""
    reference = recording.topics[rec.REFERENCE]
    at = cars.time
    front = _front(cars, "position") + facts.nose
    speed = KMH * _front(cars, "velocity")
    profile = KMH * np.interp(at, reference.time, reference["velocity"][:, 0])

    def units(topic: str, name: str) -> Array:
        found = recording.of(topic, name)
        return np.full(at.size, np.nan) if found is None else np.interp(at, found[0], found[1].sum(axis=1)) / 1e3

    columns = {
        "time": at,
        "speed": speed,
        "profile": profile,
        "limit": _limits(facts, front),
        "error": speed - profile,
        "applied": units(rec.MEASUREMENT, "applied"),
        "demand": units(rec.COMMAND, "force"),
        "most": _envelope(facts, speed, facts.most),
        "least": _envelope(facts, speed, facts.least),
        "draft": np.maximum(_extreme(cars, "coupler_draft_max"), 0.0) / 1e3,
        "buff": np.minimum(_extreme(cars, "coupler_buff_max"), 0.0) / 1e3,
        "place": front / 1e3,
        "permitted": _limit_speed(recording, at, 1),
        "emergency": _limit_speed(recording, at, -1),
    }
    return {name: columns[name] for name in STRIP}


def _front(cars: TopicSamples, name: str) -> Array:
    """Return a value of the first vehicle; the values of all vehicles of a long run do not fit into the memory."""
    return cars[f"front_{name}" if f"front_{name}" in cars else name][:, 0]


def _extreme(cars: TopicSamples, name: str) -> Array:
    """Return an extreme of the coupler forces; 0 for a single vehicle."""
    return cars[name][:, 0] if name in cars else np.zeros(cars.time.size)


def _limit_speed(recording: rec.Recording, at: Array, column: int) -> Array:
    """Return a speed of the supervisor [km/h] at these times; NaN without one."""
    found = recording.of(rec.SUPERVISED_SPEEDS, "speed")
    if found is None:
        return np.full(at.size, np.nan)
    rows = np.searchsorted(found[0], at + 1e-9, side="right") - 1
    return np.asarray(KMH * found[1][np.maximum(rows, 0), column])


def _limits(facts: Facts, front: Array) -> Array:
    if not facts.limit_places.size:
        return np.full(front.size, np.nan)
    limit = KMH * np.array([facts.limit_now(place) for place in front[:: max(1, front.size // 20_000)]])
    return np.interp(np.arange(front.size), np.linspace(0, front.size - 1, limit.size), limit)


def _envelope(facts: Facts, speed: Array, force: Array) -> Array:
    if not facts.speeds.size:
        return np.full(speed.size, np.nan)
    return np.interp(np.abs(speed) / KMH, facts.speeds, force) / 1e3
