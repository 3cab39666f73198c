"""A feed from a recorded run: every moment of it can be shown, and time runs at the pace that is asked for."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from train_ato.report.events import Event
from train_ato.report.happened import events_of
from train_ato.report.recording import Recording, Samples, read_recording
from train_ato.shape import Shape
from train_ato.types import Array
from train_ato.view.facts import KMH, Facts, Profile, facts_of
from train_ato.view.feed import FRAMES_PER_SECOND, Feed, Mark
from train_ato.view.moment import STRIP, Moment

MOST_POINTS = 1500
"""Points of a strip chart that are sent at once."""
LABELS = {"limit": "force limit", "air_brake": "air brake"}
"""Kinds of event as the strip charts call them, where their own name would not do."""


class RecordedFeed(Feed):
    """Figures of a run folder or a log, played back.

    Parameters
    ----------
    run
        Run folder or MCAP file.

    Attributes
    ----------
    playing : bool
    speed : float
        Simulated seconds per second of wall time.
    tick : float
        Period of the run's loop [s].
    time : float
        Simulated time that is shown [s].
    span : tuple of float
        First and last simulated time [s].

    Raises
    ------
    ValueError
        One line: no run, a killed one, a damaged log, or one without the motion of the train.
    """

    def __init__(self, run: Path) -> None:
        self.recording = recording = read_recording(run)
        self._cars = cars = _cars(recording)
        if "ato/reference" not in recording.topics:
            raise ValueError(f"{run}: no ato/reference in the log; `train-ato report` shows what there is")
        super().__init__(_facts(recording, cars))
        self._reference = recording.topics["ato/reference"]
        self.span = (float(self._cars.time[0]), float(self._cars.time[-1]))
        self.tick = float(np.median(np.diff(self._cars.time))) if self._cars.time.size > 1 else 1.0
        self.playing, self.speed, self.time = False, 1.0, self.span[0]
        self._turn = threading.RLock()
        self._looked = time.monotonic()
        self._row = -1
        self._profiles = [Profile(found.time, found.position, found.speed) for found in recording.profiles]
        self._planned = np.array([found.at for found in recording.profiles])
        self._table = _table(recording, cars, self.facts)
        self.marks = [Mark(event.begin, _label(event), event.text) for event in events_of(recording)]
        self.seek(self.span[0])

    def seek(self, moment: float) -> None:
        """Show a moment of the run."""
        with self._turn:
            self.time = min(max(moment, self.span[0]), self.span[1])
            self._looked = time.monotonic()
            self._show()

    def set_playing(self, playing: bool) -> None:
        """Let time go on from here, from the beginning where it had ended, or let it stand."""
        if playing and not self.playing and self.time >= self.span[1]:
            self.seek(self.span[0])
        self.seek(self.time)
        self.playing = playing

    def step(self, ticks: int) -> None:
        """Show the moment so many ticks later, or earlier."""
        row = min(max(self._row + ticks, 0), self._cars.time.size - 1)
        self.seek(float(self._cars.time[row]))

    def advance(self) -> None:
        """Let time go on as far as the wall clock did since the last look; any number of pages may call this."""
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

    def _moment(self, row: int) -> Moment:
        cars, at = self._cars, float(self._cars.time[row])
        nothing = np.full(self.facts.shape.n_units, np.nan)
        where = _before(self._reference.time, at)
        position, speed, acceleration = (
            float(self._reference[name][where, 0]) for name in ("position", "speed", "acceleration")
        )
        shoe, pipe = self._at("train/brake_cylinders", "shoe_force", at), self._at("train/brake_pipe", "pressure", at)
        wanted = self._at("ato/brake_pipe", "pressure", at)
        applied, command, estimate = (
            self._at(topic, name, at)
            for topic, name in (("train/measurement", "applied"), ("ato/command", "force"), ("ato/estimate", "force"))
        )
        return Moment(
            time=at,
            position=cars["position"][row],
            velocity=cars["speed"][row],
            coupler=cars["coupler"][row],
            shoe=shoe,
            applied=nothing if applied is None else applied,
            command=nothing if command is None else command,
            estimate=nothing if estimate is None else estimate,
            reference=(position, speed, acceleration),
            pipe=math.nan if pipe is None else float(pipe[0]),
            pipe_demand=math.nan if wanted is None else float(wanted[0]),
            law=self._said("controller", at, "controller"),
            state=self._said("plant", at),
            factor=self.speed if self.playing else math.nan,
        )

    def _at(self, topic: str, name: str, at: float) -> Array | None:
        found = self.recording.of(topic, name)
        return None if found is None else found[1][_before(found[0], at)]

    def _said(self, node: str, at: float, key: str | None = None) -> str:
        said = self.recording.said.get(node)
        if said is None or not said.time.size:
            return ""
        row = _before(said.time, at)
        return said.message[row] if key is None else str(said.texts(key)[row] or "")

    def part(self, begin: float, end: float) -> dict[str, Array]:
        """Return the strip charts between two times [s], thinned to what a page can draw; extremes are kept."""
        times = self._table["time"]
        first, last = np.searchsorted(times, (begin, end))
        stride = max(1, math.ceil((last - first) / MOST_POINTS))
        return {name: column[first:last:stride] for name, column in self._table.items()}


def _label(event: Event) -> str:
    """Return a word or two for the strip charts."""
    if event.kind == "outside":
        return event.text.partition(" ")[0]
    return LABELS.get(event.kind, event.kind)


def _before(times: Array, at: float) -> int:
    """Return the row of the newest sample at a time."""
    return max(0, int(np.searchsorted(times, at + 1e-9, side="right")) - 1)


def _cars(recording: Recording) -> Samples:
    """Return the motion of the vehicles; of a measured run only the first one's is known, as the measurement says it.

    Raises
    ------
    ValueError
        If the log says neither.
    """
    cars, measured, setup = (
        recording.topics.get("train/cars"),
        recording.topics.get("train/measurement"),
        recording.setup,
    )
    if cars is not None:
        return cars
    if setup is None or measured is None or not {"position", "speed"} <= measured.values.keys():
        raise ValueError(f"{recording.path}: no train/cars in the log; `train-ato report` shows what there is")
    first = measured["position"][:, :1] + setup.model.offsets[0]
    values = {"position": first, "speed": measured["speed"][:, :1], "coupler": np.zeros_like(first)}
    return Samples(measured.time, values)


def _facts(recording: Recording, cars: Samples) -> Facts:
    if recording.setup is not None:
        facts = facts_of(recording.setup)
        known = cars["speed"].shape[1]
        return replace(facts, shape=replace(facts.shape, n_vehicles=known)) if recording.measured_only else facts
    measured = recording.topics.get("train/measurement")
    units = measured["applied"].shape[1] if measured is not None and "applied" in measured else 0
    shape = Shape(cars["speed"].shape[1], units, (), "train/brake_pipe" in recording.topics, False)
    places, speeds = recording.limits or (np.zeros(0), np.zeros(0))
    span = recording.span
    return Facts(recording.name, shape, span[1] - span[0], limit_places=places, limit_speeds=speeds)


def _table(recording: Recording, cars: Samples, facts: Facts) -> dict[str, Array]:
    """Return the strip charts of the whole run, by the names of :data:`train_ato.view.moment.STRIP`."""
    reference = recording.topics["ato/reference"]
    at = cars.time
    front = cars["position"][:, 0] + facts.nose
    speed = KMH * cars["speed"][:, 0]
    profile = KMH * np.interp(at, reference.time, reference["speed"][:, 0])

    def units(topic: str, name: str) -> Array:
        found = recording.of(topic, name)
        return np.full(at.size, np.nan) if found is None else np.interp(at, found[0], found[1].sum(axis=1)) / 1e3

    columns = {
        "time": at,
        "speed": speed,
        "profile": profile,
        "limit": _limits(facts, front),
        "error": speed - profile,
        "applied": units("train/measurement", "applied"),
        "demand": units("ato/command", "force"),
        "most": _envelope(facts, speed, facts.most),
        "least": _envelope(facts, speed, facts.least),
        "draft": np.maximum(cars["coupler"].max(axis=1), 0.0) / 1e3,
        "buff": np.minimum(cars["coupler"].min(axis=1), 0.0) / 1e3,
        "place": front / 1e3,
    }
    return {name: columns[name] for name in STRIP}


def _limits(facts: Facts, front: Array) -> Array:
    if not facts.limit_places.size:
        return np.full(front.size, np.nan)
    limit = KMH * np.array([facts.limit_now(place) for place in front[:: max(1, front.size // 20_000)]])
    return np.interp(np.arange(front.size), np.linspace(0, front.size - 1, limit.size), limit)


def _envelope(facts: Facts, speed: Array, force: Array) -> Array:
    if not facts.speeds.size:
        return np.full(speed.size, np.nan)
    return np.interp(np.abs(speed) / KMH, facts.speeds, force) / 1e3
