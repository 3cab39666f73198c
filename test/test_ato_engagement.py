"""Runs with a disengaged ATO: emergency brake, failed law, takeover by the braking law, and the next engagement."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from train_ato.control.laws.pid import Pid
from train_ato.loop.engine import run_engine
from train_ato.loop.recording import Recording
from train_ato.loop.result import RunResult
from train_ato.loop.setup import prepare
from train_ato.messages.types import AtoState
from train_ato.ros.graph.runner import run_graph
from train_ato.scenario.scenario import load_scenario

METRO = "xuzhou_metro:disturbed"
TICK_S, LAG_S, PERIOD_S = 0.05, 0.4, 0.4
BRAKED = (
    "interventions=[{at: 60, do: emergency_brake}, {at: 90, do: emergency_brake, applied: false}]",
    "ato_requests=[{at: 95, do: engage}]",
)


def driven(name: str, *changes: str) -> tuple[RunResult, Recording]:
    result = run_engine(prepare(*load_scenario(name, changes)))
    assert result.recording is not None
    return result, result.recording


def states(recording: Recording) -> list[tuple[float, AtoState]]:
    """Return the changes of the ATO's state with their times [s]."""
    topic = recording.topics["ato/state"]
    values = topic.values["state"][:, 0]
    changed = np.flatnonzero(np.diff(values, prepend=-1.0))
    return [(float(topic.time[i]), AtoState(int(values[i]))) for i in changed]


def test_the_demo_with_an_emergency_brake_on_its_way_stops_at_its_place() -> None:
    """Breaks if the ATO is not disengaged, drives on by itself, or plans from another place than that of the train."""
    brake = "interventions=[{at: 200, do: emergency_brake}, {at: 260, do: emergency_brake, applied: false}]"
    result, recording = driven("demo", brake, "ato_requests=[{at: 270, do: engage}]", "duration=1250")
    assert [state for _, state in states(recording)] == [
        AtoState.ENGAGED, AtoState.DISENGAGING, AtoState.AVAILABLE, AtoState.READY, AtoState.ENGAGED,
    ]  # fmt: skip
    assert abs(result.summary["stop_error_m"]) < 0.5
    assert result.summary["status"] == "done"


def test_the_emergency_brake_cuts_the_traction_at_once() -> None:
    """Breaks if the drive still gets the command of the law, or the ATO goes on commanding it."""
    _, recording = driven(METRO, "interventions=[{at: 20, do: emergency_brake}]", "duration=60")
    time, sent = recording.time, np.asarray(recording.command)
    assert float(sent[np.searchsorted(time, 19.5)].max()) > 50e3
    begin = 20.0 + TICK_S
    later = time >= begin
    decay = float(recording.applied.max()) * np.exp(-(time[later] - begin) / LAG_S)
    assert (recording.applied[later, 0] <= decay + 1e-6).all(), "only the lag of the actuators is left"
    assert float(sent[time > 20.0 + PERIOD_S].max()) <= 0.0, "a disengaged ATO coasts or brakes"


def test_an_engagement_is_refused_while_a_brake_is_in_effect() -> None:
    """Breaks if a planned engagement does not wait for the release."""
    brake = "interventions=[{at: 30, do: emergency_brake}, {at: 80, do: emergency_brake, applied: false}]"
    _, recording = driven(METRO, brake, "ato_requests=[{at: 40, do: engage}]", "duration=100")
    engaged = [time for time, state in states(recording) if state is AtoState.ENGAGED]
    assert engaged[0] == 0.0
    assert engaged[1] > 80.0


def test_the_ways_of_running_agree_over_a_disengagement(tmp_path: Path) -> None:
    """Breaks if a state of the ATO or a new plan reaches a node at another tick than in the engine."""
    setup = prepare(*load_scenario(METRO, (*BRAKED, "duration=120")))
    engine, graph = run_engine(setup), run_graph(setup, tmp_path, mode="composed")
    assert graph.failure is None
    assert graph.recording is not None
    assert engine.recording is not None
    for topic, samples in engine.recording.topics.items():
        for name, values in samples.values.items():
            np.testing.assert_array_equal(values, graph.recording.topics[topic].values[name], err_msg=topic)


def test_a_law_that_raises_stops_the_train_before_the_run_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a dead law ends the run while the train moves."""
    step = Pid.step

    def failing(self: Pid, inputs: Any) -> Any:
        if inputs.t > 30.0:
            raise ZeroDivisionError("gain is 0")
        return step(self, inputs)

    monkeypatch.setattr(Pid, "step", failing)
    result, recording = driven(METRO, "law=pid", "duration=120")
    assert result.failure is not None
    assert result.failure.startswith("node controller failed: law pid: ZeroDivisionError: gain is 0, ")
    assert recording.front_velocity[-1] < 0.1
    assert 30.0 < recording.time[-1] < 80.0


def test_the_braking_law_keeps_a_bad_law_below_the_warning_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the takeover is late: the supervisor would intervene."""
    step = Pid.step

    def eager(self: Pid, inputs: Any) -> Any:
        output = step(self, inputs)
        output.force[:] = np.maximum(output.force, 60e3)
        return output

    monkeypatch.setattr(Pid, "step", eager)
    _, bad = driven(METRO, "law=pid", "duration=150", "supervision.assurance=false")
    _, kept = driven(METRO, "law=pid", "duration=150")

    def interventions(recording: Recording) -> int:
        reports = [report for report in recording.reports if report.node == "supervisor"]
        return int(reports[-1].values["brake_interventions"])

    assert interventions(bad) > 0
    assert interventions(kept) == 0
    assert max(int(report.values.get("takeovers", 0)) for report in kept.reports) > 0
