"""Recording of one run: every topic as arrays at full resolution, from the engine's memory or from a log."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from train_ato.judge.repeated_reports import Report, all_reports, changed_reports
from train_ato.judge.series import DiagnosticSeries, TopicSamples, aligned, diagnostic_series, held
from train_ato.messages.topic import Owner
from train_ato.messages.topics import TOPICS, Place, Rate, Topic
from train_ato.messages.types import Array, Diagnostic, Trajectory
from train_ato.profile.profile import profile_of
from train_ato.scenario.setup import RunSetup

TRUTH, MEASUREMENT, DISTURBANCE = "train/vehicles", "train/measurement", "train/disturbance"
BRAKE_PIPE, BRAKE_SHOES, BRAKE_PIPE_COMMAND = "train/brake_pipe", "train/brake_shoes", "ato/brake_pipe_command"
BRAKE_PIPE_TAIL = "train/brake_pipe_tail"
REFERENCE, ESTIMATE, COMMAND = "ato/reference", "ato/estimate", "ato/command"
SUPERVISED_SPEEDS, ATO_STATE = "atp/speeds", "ato/state"
PROFILE, LIMITS, DIAGNOSTICS = "ato/profile", "ato/limits", "/diagnostics"
LOST_KEY = "lost"
"""Key in the diagnostics of the plant: nodes without an answer, whose messages it does not take, and the reason."""
OUTSIDE_KEY = "outside"
"""Key in the diagnostics of the plant: nodes that are programs outside of this project, with spaces between them."""


def fields_of(topic: Topic) -> dict[str, Place]:
    """Return the places of a topic by the field of its dataclass, without times and coupler sensors."""
    found: dict[str, Place] = {}
    for place in topic.places:
        if place.owner is not Owner.COUPLER and topic.description(place).unit != "s":
            found.setdefault(place.field, place)
    return found


FIELDS: dict[str, tuple[str, ...]] = {
    topic.name: tuple(fields)
    for topic in TOPICS
    if topic.rate in (Rate.TICK, Rate.SUPERVISION) and (fields := fields_of(topic))
}
"""Topics with arrays: fields of the dataclass, without times and coupler sensors."""
KEPT = 8 * 2**20
"""Size up to which a property of a recording is kept [bytes]."""
ROUNDING_S = 1e-6
"""Difference of two stamps of one tick by rounding [s]."""
LAST_REPORT_S = 2.0
"""Time after the last tick up to which a diagnostic, sent once a second, belongs to the run [s]."""
T = TypeVar("T")
COUNTED = {"profile": ("replans",), "controller": ("held_steps", "unsound_measurements")}
"""Counters in the diagnostics of a node, added to the totals of a run."""


class _kept(Generic[T]):  # noqa: N801
    """Property that is kept like a ``cached_property``, except large ones: a long run has many of them."""

    def __init__(self, function: Callable[[Recording], T]) -> None:
        self._function, self.__doc__ = function, function.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, recording: Recording | None, owner: type | None = None) -> T:
        if recording is None:
            return self  # type: ignore[return-value]
        found = self._function(recording)
        parts: Any = found.values.values() if isinstance(found, TopicSamples) else (found,)
        if sum(part.nbytes for part in parts if part is not None) <= KEPT:
            recording.__dict__[self._name] = found
        return found


def _at_ticks(
    topic: str, name: str, column: int | None = None, without_truth: tuple[str, str] | None = None
) -> _kept[Array]:
    """Return a property of a recording for one value of a topic at the complete ticks.

    Parameters
    ----------
    topic, name
        Topic and name of the samples.
    column
        Column of a single number; None keeps shape (k, n).
    without_truth
        Topic and name of the samples for a log without truth.
    """

    def values(recording: Recording) -> Array:
        found = recording.of(topic, name)
        if found is None and without_truth is not None:
            found = recording.of(*without_truth)
        if found is None:  # no estimate, no disturbance
            return np.zeros((recording.time.size, recording.units) if column is None else recording.time.size)
        series = aligned(recording.time, *found)
        return series if column is None else series[:, column]

    return _kept(values)


def _of_reference(place: int) -> _kept[Array]:
    """Return a property of a recording for position, speed or acceleration of the reference."""
    return _kept(lambda recording: recording.reference(place))


@dataclass(frozen=True)
class Recording:
    """One run; k complete ticks, u power units, n vehicles.

    A complete tick has measurement and motion at its begin, and a command or motion at its end. In a log without truth
    it has measurement, reference and command of one stamp. A tick without a command keeps the last one. A tick without
    a reference has the reference of the last profile.

    Attributes
    ----------
    topics : dict of TopicSamples
        Samples by the name in the topic table, without the topics that were not recorded; vehicles are reduced by
        :func:`train_ato.judge.recording_builder.reduced`.
    profiles : tuple of Trajectory
        Profiles in the order of their planning.
    limits : Trajectory or None
        Speed limits of the line.
    kept_reports : tuple of Diagnostic or RepeatedReport
        Diagnostics of all nodes; :attr:`reports` are the single messages.
    setup : RunSetup or None
        Scenario, train and line; if None, ``setup_missing`` is the reason.
    summary
        Content of ``summary.json``, empty if it was not read.
    name, path
        Name and folder of a run that was read from a log.
    position, velocity : Array, shape (k, u)
        Truth of every power unit [m, m/s]; the measurement for a log without truth.
    front_position, front_velocity : Array, shape (k,)
        Truth of the centre of vehicle 0 [m, m/s]; for a measured run the position on its profile.
    coupler_draft_max, coupler_buff_max : Array, shape (k,)
        Maximum draft (> 0) and buff (< 0) along the train at the tick [N].
    coupler_samples : Array, shape (k, 3)
        Force behind the first, the middle and the last but one vehicle [N].
    applied, command, estimate : Array, shape (k, u)
        Measured applied force, command as sent, disturbance estimate [N].
    disturbance : Array, shape (k, u)
        True disturbance force on the vehicle of every power unit [N]; zeros without disturbances.
    reference_position, reference_velocity, reference_acceleration : Array, shape (k,)
        Reference of the centre of vehicle 0 [m, m/s, m/s²].
    """

    topics: dict[str, TopicSamples] = field(default_factory=dict)
    profiles: tuple[Trajectory, ...] = ()
    limits: Trajectory | None = None
    kept_reports: tuple[Report, ...] = ()
    setup: RunSetup | None = None
    setup_missing: str = ""
    summary: dict[str, Any] = field(default_factory=dict)
    name: str = ""
    path: Path = Path()

    position = _at_ticks(TRUTH, "unit_position", without_truth=(MEASUREMENT, "position"))
    velocity = _at_ticks(TRUTH, "unit_velocity", without_truth=(MEASUREMENT, "velocity"))
    front_position = _at_ticks(TRUTH, "front_position", 0, without_truth=(REFERENCE, "position"))
    front_velocity = _at_ticks(TRUTH, "front_velocity", 0, without_truth=(MEASUREMENT, "velocity"))
    coupler_draft_max = _at_ticks(TRUTH, "coupler_draft_max", 0)
    coupler_buff_max = _at_ticks(TRUTH, "coupler_buff_max", 0)
    coupler_samples = _at_ticks(TRUTH, "coupler_samples")
    applied = _at_ticks(MEASUREMENT, "applied")
    estimate = _at_ticks(ESTIMATE, "force")
    disturbance = _at_ticks(DISTURBANCE, "unit_force")

    @_kept
    def command(self) -> Array:
        """Command of every tick as sent, shape (k, u); a tick without one holds the last, 0 before the first."""
        found = self.of(COMMAND, "force")
        return np.zeros((self.time.size, self.units)) if found is None else held(self.time, *found)

    @cached_property
    def commanded(self) -> NDArray[np.bool_]:
        """True for the ticks with a command of their own that the train has taken, shape (k,)."""
        found = self.of(COMMAND, "force")
        sent = np.isin(self.time, () if found is None else found[0])
        since = math.inf  # of the loss of the controller that ended the run
        for report in self.changed_reports:
            if report.node == "plant":
                lost = "controller" in report.values.get(LOST_KEY, "").partition(":")[0]
                since = min(since, report.stamp * 1e-9) if lost else math.inf
        return sent & (self.time < since)

    def reference(self, place: int) -> Array:
        """Return position, speed or acceleration of the reference at every tick, shape (k,)."""
        found, name = self.topics.get(REFERENCE), ("position", "velocity", "acceleration")[place]
        if found is None:
            return np.zeros(self.time.size)
        column = aligned(self.time, found.time, found[name][:, 0]) if name in found else np.zeros(self.time.size)
        missing = self._without_reference
        if missing.size and self.profiles:
            column = column.copy()
            column[missing] = profile_of(self.profiles[-1]).at_times(self.time[missing])[place]
        return column

    @cached_property
    def _without_reference(self) -> NDArray[np.intp]:
        """Ticks without a reference of their own."""
        return np.flatnonzero(~np.isin(self.time, self.topics[REFERENCE].time))

    reference_position = _of_reference(0)
    reference_velocity = _of_reference(1)
    reference_acceleration = _of_reference(2)

    def of(self, topic: str, name: str) -> tuple[Array, Array] | None:
        """Return time and values of a topic, shapes (k,) and (k, n), or None."""
        samples = self.topics.get(topic)
        return None if samples is None or name not in samples else (samples.time, samples[name])

    @cached_property
    def time(self) -> Array:
        """Stamps of the complete ticks [s], shape (k,)."""
        motion = self.motion
        if {TRUTH, MEASUREMENT, REFERENCE, COMMAND} <= self.topics.keys() and motion is not None:
            begun = self.topics[MEASUREMENT].time
            complete = (begun < motion.time[-1]) | np.isin(begun, self.topics[COMMAND].time)
            return np.intersect1d(begun[complete], motion.time)
        times = [] if motion is None else [motion.time]
        times += [self.topics[topic].time for topic in (MEASUREMENT, REFERENCE, COMMAND) if topic in self.topics]
        if len(times) < 4:
            return np.empty(0)
        common = times[0]
        for other in times[1:]:
            count = min(common.size, other.size)
            same = np.array_equal(common[:count], other[:count])
            common = common[:count] if same else np.intersect1d(common, other)
        return common

    @property
    def units(self) -> int:
        """Number of power units in the commands."""
        return self.topics[COMMAND]["force"].shape[1] if COMMAND in self.topics else 0

    @property
    def final(self) -> tuple[float, float]:
        """Position [m] and speed [m/s] of vehicle 0 after the last complete tick."""
        motion = self.motion
        assert motion is not None
        row = min(int(np.searchsorted(motion.time, self.time[-1], side="right")), motion.time.size - 1)
        return float(motion["position"][row, 0]), float(motion["velocity"][row, 0])

    @_kept
    def motion(self) -> TopicSamples | None:
        """Position and speed of vehicle 0 and position of the last vehicle: the truth, else the measurement."""
        truth, measured = self.topics.get(TRUTH), self.topics.get(MEASUREMENT)
        if truth is not None and truth.time.size and "front_velocity" in truth:
            names = {"position": "front_position", "velocity": "front_velocity", "rear_position": "rear_position"}
            return TopicSamples(truth.time, {name: truth[key] for name, key in names.items() if key in truth})
        if measured is None or not measured.time.size or "velocity" not in measured or not measured["velocity"].size:
            return None
        values = {"velocity": measured["velocity"][:, :1]}
        if "position" in measured:
            values |= {"position": measured["position"][:, :1], "rear_position": measured["position"][:, -1:]}
        return TopicSamples(measured.time, values)

    @cached_property
    def diagnostics(self) -> dict[str, DiagnosticSeries]:
        """Diagnostics by node."""
        return diagnostic_series(self.kept_reports)

    @property
    def reports(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of all nodes; gigabytes for a run of days, of which :attr:`changed_reports` has the texts."""
        return all_reports(self.kept_reports)

    @cached_property
    def changed_reports(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of all nodes without those between the first and the last one of equal texts."""
        return changed_reports(self.kept_reports)

    def reported(self, node: str, key: str) -> tuple[Array, Array] | None:
        """Return time [s] and values of a number in the diagnostics of a node, shape (k,) each, or None."""
        series = self.diagnostics.get(node)
        values = None if series is None else series.numbers(key)
        return None if series is None or values is None else (series.time, values)

    @cached_property
    def totals(self) -> dict[str, float]:
        """Totals of the plant at the end, and counters of profile and controller, from the diagnostics."""
        texts: dict[str, str] = {}
        counts: dict[str, str] = {}
        for message in self.changed_reports:
            if message.node == "plant":
                texts = message.values
            elif message.node in COUNTED:
                counts |= {key: message.values[key] for key in COUNTED[message.node] if key in message.values}
        numbers = {name: _number(text) for name, text in {**texts, **counts}.items()}
        return {name: value for name, value in numbers.items() if value is not None}

    @property
    def measured_only(self) -> bool:
        """True for a log without truth, as that of a measured run."""
        return TRUTH not in self.topics

    def recorded(self, what: str) -> bool:
        """Return True if ``command`` or ``reference`` is in the log; a measured run may lack them."""
        return not str(self.summary.get(f"measured_{what}", "")).startswith("not recorded")

    @property
    def without_brake(self) -> str:
        """Reason for the missing air brake: no air brake on the train, or no data of it in the log."""
        braked = self.setup is None or self.setup.consist.air_brake is not None
        return "the log has nothing of an air brake" if braked else "the train has no air brake"

    @cached_property
    def span(self) -> tuple[float, float]:
        """First and last stamp of the run [s].

        A single topic beyond all others, as with a message of a foreign node, and stamps beyond the planned duration
        do not count.
        """
        limits = (-math.inf, math.inf)
        if self.setup is not None and not self.measured_only:
            limits = (-self.setup.tick, (self.setup.ticks + 1) * self.setup.tick)
        times = [
            inside
            for samples in self.topics.values()
            if (inside := samples.time[(samples.time >= limits[0]) & (samples.time <= limits[1])]).size
        ]
        if not times:
            return 0.0, 0.0
        first, last = sorted(float(t[0]) for t in times), sorted(float(t[-1]) for t in times)
        return (first[0], last[0]) if len(times) == 1 else (first[1], last[-2])

    def within_span(self) -> Recording:
        """Return the recording without the samples, diagnostics and profiles with a stamp outside of its span."""
        begin, end = self.span[0] - ROUNDING_S, self.span[1] + LAST_REPORT_S
        topics, cut = {}, False
        for topic, samples in self.topics.items():
            inside = (samples.time >= begin) & (samples.time <= end)
            topics[topic] = samples
            if not inside.all():
                cut, kept = True, {name: values[inside] for name, values in samples.values.items()}
                topics[topic] = TopicSamples(samples.time[inside], kept)
        reports = [
            part for report in self.kept_reports if (part := _between(report, begin * 1e9, end * 1e9)) is not None
        ]
        plans = [plan for plan in self.profiles if begin <= plan.stamp / 1e9 <= end]
        cut = cut or any(one is not other for one, other in zip_longest(reports, self.kept_reports))
        if not cut and len(plans) == len(self.profiles):
            return self
        return replace(self, topics=topics, kept_reports=tuple(reports), profiles=tuple(plans))


def _between(report: Report, begin: float, end: float) -> Report | None:
    """Return the messages of a report from one stamp to another [ns], None without one."""
    first, last = (report.stamp,) * 2 if isinstance(report, Diagnostic) else (report.stamps[0], report.stamps[-1])
    if begin <= first and last <= end:
        return report
    part = None if isinstance(report, Diagnostic) else report.between(begin, end)
    return part if part is not None and part.stamps else None


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
