"""Result of a run: recording, summary, failure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from train_ato.control.gains import doubt
from train_ato.judge.metrics import (
    JERK_SPAN,
    differences,
    evaluated_ticks,
    excess_speed,
    mean_jerk_1s,
    place_of_front,
    position_errors,
    speed_errors,
    summarise,
)
from train_ato.judge.protection_record import protection_summary
from train_ato.judge.recording import Recording
from train_ato.judge.requirements import requirement_rows
from train_ato.judge.run_end import DONE, FAILED, INTERRUPTED, RunEnd
from train_ato.judge.stops import StopResult, stops_of_run
from train_ato.judge.tracking import INCOMPLETE, TRACKED, TrackingFinding, outcome_of, tracking_summary
from train_ato.judge.verdict import is_tracked, judge_run
from train_ato.messages.types import Array, AtoState
from train_ato.program.version import VERSION
from train_ato.scenario.changes import RunChanges
from train_ato.scenario.scenario import states_verdict
from train_ato.scenario.setup import RunSetup


def worst_places(setup: RunSetup, recording: Recording, metrics: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Return ``at_s`` [s] and ``km`` of the train's front at the worst value, by metric.

    Parameters
    ----------
    setup, recording
        Run with at least one complete tick.
    metrics
        Metrics of the run (:func:`train_ato.judge.metrics.summarise`) and of its protection.

    Returns
    -------
    dict
        A root mean square has the place of its largest error. A stop has the place of the standstill, or of the planned
        arrival if it was not made. Interventions have the place of the first one. A metric with the value 0 has no
        place.
    """
    return {
        metric: {"at_s": at_s, **place_of_front(setup, recording, at_s)}
        for metric, at_s in _worst_times(setup, recording, metrics)
        if at_s is not None and metrics.get(metric, 0) != 0
    }


def _worst_times(
    setup: RunSetup, recording: Recording, metrics: Mapping[str, Any]
) -> Iterator[tuple[str, float | None]]:
    """Yield every metric and the time of its worst value [s]."""
    time, part = recording.time, evaluated_ticks(setup, recording)
    yield from _stop_times(stops_of_run(setup, recording))
    yield "overspeed_max_kmh", _at_largest(time, excess_speed(setup, recording))
    yield "speed_rmse_kmh", _at_largest(time[part], np.abs(speed_errors(recording, part)))
    run = slice(part.start, None)
    yield "speed_error_run_max_kmh", _at_largest(time[run], np.abs(speed_errors(recording, run)))
    yield "position_error_max_m", _at_largest(time[part], np.abs(position_errors(setup, recording, part)))
    yield "coupler_draft_max_kn", _coupler_time(recording, "coupler_draft_max", recording.coupler_draft_max)
    yield "coupler_buff_max_kn", _coupler_time(recording, "coupler_buff_max", -recording.coupler_buff_max)
    acceleration, _ = differences(recording.front_velocity, setup.tick)
    jerk = mean_jerk_1s(acceleration, setup.tick)
    begins = time[:: max(1, round(JERK_SPAN / setup.tick))]
    second = (acceleration.size + 1 - jerk.size) // 2
    yield "acceleration_max", _at_largest((begins[:-1] + begins[1:]) / 2, np.abs(acceleration))
    yield "jerk_1s_max", _at_largest(begins[second : second + jerk.size], np.abs(jerk))
    yield "brake_interventions", metrics.get("first_intervention_s")


def _stop_times(stops: list[StopResult]) -> Iterator[tuple[str, float | None]]:
    """Yield the metrics of the stops with the time of the worst one, or of the first one that was not made."""
    missed = [stop.planned for stop in stops if stop.arrival is None]
    made = [(stop.error, stop.arrival, stop.planned) for stop in stops if stop.arrival is not None]
    worst = max(made, key=lambda stop: abs(stop[0] or 0.0), default=(0.0, None, 0.0))[1]
    latest = max(made, key=lambda stop: stop[1] - stop[2], default=(0.0, None, 0.0))[1]
    yield "stop_error_max_m", missed[0] if missed else worst
    yield "arrival_delay_max_s", missed[0] if missed else latest


def _at_largest(time: Array, values: Array) -> float | None:
    """Return the time of the largest value, shape (k,) or (k, n); None without values."""
    return float(time[int(values.argmax()) // (values.size // time.size)]) if values.size and time.size else None


def _coupler_time(recording: Recording, key: str, forces: Array) -> float | None:
    """Return the time of the largest coupler force of the run.

    The plant has the largest force of all its steps since the start in its diagnostics, once a second; the tick with
    the largest force in the second of its last increase is less than a tick beside it. A run for its summary only
    keeps no forces of the ticks, and its coupler forces have no time.
    """
    reported = recording.reported("plant", key)
    if reported is None:
        return _at_largest(recording.time, forces)
    changed = np.flatnonzero(np.diff(reported[1])) + 1
    last = int(changed[-1]) if changed.size else 0
    end, begin = reported[0][last], reported[0][last - 1] if last else -np.inf
    rows = np.flatnonzero((recording.time >= begin) & (recording.time <= end))
    return None if np.isnan(forces[rows]).any() else _at_largest(recording.time[rows], forces[rows])


OF_COUPLERS = ("coupler_draft_max_kn", "coupler_buff_max_kn")


@dataclass(frozen=True)
class Progress:
    """Progress of a run: simulated time, its end and wall time [s]."""

    simulated: float
    duration: float
    wall: float

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time."""
        return self.simulated / self.wall if self.wall > 0 else 0.0

    @property
    def remaining(self) -> float:
        """Estimated remaining wall time [s]."""
        return (self.duration - self.simulated) / self.factor if self.factor > 0 else 0.0


@dataclass(frozen=True)
class RunResult:
    """End of a run.

    Attributes
    ----------
    recording
        Recording of the run, or None without a complete tick.
    summary
        Content of ``summary.json``.
    failure
        One line with the failed node and the reason, or None.
    changes
        Changes of laws and parameters, interventions and ATO requests during the run.
    domain
        ROS domain of a run that is to begin again there, else None.
    """

    recording: Recording | None
    summary: dict[str, Any]
    interrupted: bool = False
    failure: str | None = None
    published: dict[str, int] = field(default_factory=dict)
    changes: RunChanges = field(default_factory=RunChanges)
    domain: int | None = None

    def checked_against(self, recorded: dict[str, int]) -> RunResult:
        """Return this result, as failed if the numbers of recorded and published messages differ."""
        wrong = [topic for topic, count in self.published.items() if recorded.get(topic, 0) != count]
        if not wrong or self.failure:
            return self
        topic = wrong[0]
        text = f"recorder: {recorded.get(topic, 0)} of {self.published[topic]} messages of {topic} recorded"
        summary = {**self.summary, "status": FAILED, "failure": text}
        if summary.get("tracking") in (TRACKED, INTERRUPTED):
            lost = float(abs(self.published[topic] - recorded.get(topic, 0)))
            summary |= outcome_of([TrackingFinding(INCOMPLETE, lost, 0.0, "messages", text)])
        return replace(self, failure=text, summary=summary)

    @classmethod
    def of(
        cls,
        setup: RunSetup,
        recording: Recording,
        wall: float,
        ticks: int,
        step_times: Sequence[int],
        *,
        interrupted: bool,
        failure: str | None,
        published: dict[str, int] | None = None,
        interruption: str = "",
        outside: Mapping[str, str] | None = None,
    ) -> RunResult:
        """Return the result of a run from its recording.

        Parameters
        ----------
        step_times
            Wall time of every step of the controller [ns].
        interruption
            Signal or request that ended it.
        outside
            Nodes that were programs outside of this project, with their names.
        """
        changes = RunChanges.of(recording.changed_reports)
        failure = failure or (None if interrupted else failure_of_ato(recording))
        end = RunEnd.judged(ticks, setup.ticks, failure, interruption if interrupted else None)
        complete = recording.time.size > 0
        simulated = ticks * setup.tick
        median, p99 = (np.percentile(step_times, (50, 99)) / 1e3).tolist() if step_times else (None, None)
        summary: dict[str, Any] = {
            **identity(replace(setup, scenario=changes.at_start(setup.scenario)), ticks, outside or {}),
            "wall_s": wall,
            "real_time_factor": simulated / wall if wall > 0 else 0.0,
            **(summarise(setup, recording) if complete else {}),
            **(protection_summary(recording.changed_reports) if setup.layout.supervised else {}),
            "changes": changes.rows(setup.scenario),
            "step_time_us_median": median,
            "step_time_us_p99": p99,
            "status": end.status,
            "version": VERSION,
        }
        if end.reason:
            summary["failure" if failure else "interruption"] = end.reason
        if complete:
            summary |= tracking_summary(setup, recording, end.status)
            summary |= _judged(setup, recording, summary)
            summary |= _doubted(setup, summary)
        interrupted = end.status == INTERRUPTED
        return cls(recording if complete else None, summary, interrupted, failure, published or {}, changes)


def _doubted(setup: RunSetup, summary: Mapping[str, Any]) -> dict[str, str]:
    """Return ``advice`` on the own gains of a whole run that is not tracked or failed without a change; else {}."""
    tracked, name = is_tracked(summary), setup.scenario.law
    whole = summary["status"] == DONE and summary["controller"] == name
    if "advice" in summary or not whole or (tracked and summary.get("verdict") != "failed"):
        return {}
    if summary["changes"] or setup.scenario.faults:  # such as an emergency brake, a request, or another law
        return {}
    if states_verdict(setup.scenario):  # the cause is in its text
        return {}
    text = doubt(name, setup.gains(name), "failed" if tracked else f"ended as '{summary['tracking']}'")
    return {"advice": text} if text else {}


def _judged(setup: RunSetup, recording: Recording, metrics: dict[str, Any]) -> dict[str, Any]:
    """Return verdict and criteria of a run with at least one complete tick."""
    rows = requirement_rows(setup, recording)
    return judge_run(setup.scenario.criteria, metrics, rows, worst_places(setup, recording, metrics))


def failure_of_ato(recording: Recording) -> str | None:
    """Return the failure of an ATO that was in the state failure at the end of the run."""
    reports = [report for report in recording.changed_reports if report.node == "controller"]
    if not reports or reports[-1].values.get("ato_state") != AtoState.FAILURE.text:
        return None
    return f"node controller failed: {reports[-1].values['ato_reason']}; the train was stopped"


def completed_summary(recording: Recording) -> dict[str, Any]:
    """Return the summary of a recording, calculated for a killed run.

    A train of one vehicle has no figures of couplers.
    """
    summary, setup = recording.summary, recording.setup
    if setup is None:
        return summary
    if "speed_rmse_kmh" not in summary and not recording.measured_only and recording.time.size:
        protection = protection_summary(recording.changed_reports) if setup.layout.supervised else {}
        begun = replace(setup, scenario=RunChanges.of(recording.changed_reports).begun(setup.scenario))
        summary = {**identity(begun, recording.time.size), **summarise(setup, recording), **protection, **summary}
        summary = {**tracking_summary(setup, recording, summary.get("status", DONE)), **summary}
        summary |= _judged(setup, recording, summary)
    several = setup.layout.n_vehicles > 1
    return {key: value for key, value in summary.items() if several or key not in OF_COUPLERS}


def identity(setup: RunSetup, ticks: int, outside: Mapping[str, str] = MappingProxyType({})) -> dict[str, Any]:
    """Return the first entries of a summary: scenario, stack, nodes of other programs, seed and duration."""
    gains, external = setup.gains(setup.scenario.law), {node: f"external: {name}" for node, name in outside.items()}
    fit = {"gains": gains.source, "gains_reason": gains.reason} if gains.reason else {}
    fit |= {"advice": advice} if (advice := setup.advice()) else {}
    return {
        "scenario": setup.scenario.name,
        "controller": external.get("controller", setup.scenario.law),
        **({} if "controller" in external else fit),
        "observer": external.get("observer", setup.scenario.observer),
        "compensation": external.get("controller", setup.scenario.compensation),
        **({"external": dict(outside)} if outside else {}),
        "seed": setup.scenario.seed,
        "ticks": ticks,
        "simulated_s": ticks * setup.tick,
    }
