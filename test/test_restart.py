"""Restart of nodes whose process has ended, in runs with one process per node."""

import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from engine_runs import setup_of

pytest.importorskip("rclpy")

from test_processes import nothing_left, processes_of
from waiting import LIMIT_S, wait_for

import train_ato as ta
from train_ato.judge.result import Progress, RunResult
from train_ato.log.reading import iter_raw, read_log
from train_ato.log.recorded import open_recording
from train_ato.log.run_folder import RunFolder
from train_ato.messages.codec import Wire
from train_ato.messages.topics import Role, published_by, tick_topics
from train_ato.messages.types import AtoState
from train_ato.report.events import detect_events
from train_ato.ros.graph import shared_memory
from train_ato.ros.graph.runner import run_graph
from train_ato.scenario.setup import RunSetup

STRUCK_S, BRAKED_S = 30.0, 5.0
"""Simulated time of the kill, and time after the takeover in which the applied force is checked [s]."""
RATE = 20.0
"""Simulated seconds per second: a node that returns late on a loaded machine finds the run in its time."""


def metro(*changes: str) -> RunSetup:
    return setup_of("xuzhou_metro:disturbed", *changes)


def struck(setup: RunSetup, folder: Path, victims: tuple[str, ...], restarts: int = 3) -> RunResult:
    """Return a run whose nodes were killed on the way, one after the other; no process may be left."""
    waiting = list(victims)

    def strike(progress: Progress) -> None:
        if waiting and progress.simulated > STRUCK_S:
            os.kill(processes_of(folder)[waiting.pop(0)], signal.SIGKILL)

    home = RunFolder(folder)
    home.begin(setup)
    outcome = run_graph(setup, folder, mode="processes", progress=strike, restarts=restarts, timeout=LIMIT_S, rate=RATE)
    home.finish(setup, outcome)
    assert not waiting
    assert nothing_left(folder)
    wait_for(lambda: not shared_memory.abandoned())
    return outcome


def messages(folder: Path, setup: RunSetup, topic: str) -> list:
    return [message for _, _, message in read_log(folder, Wire(setup.layout).decode, (topic,))]


def takeover(folder: Path, setup: RunSetup) -> tuple[float, float, float]:
    """Return the largest step of the demand after the takeover, the one from the applied force, and their limit [N]."""
    # The limit is a tick of the largest jerk of the profile. The demand that acts follows from the applied force and
    # the lag. It is that of coasting, 0, until the first command acts. Then it lies between the applied force at the
    # begin and the commands sent so far: a loaded machine delays commands, and their steps act at once. With a node
    # away the commands lack one period or more, because the plant makes few ticks until the node returns.
    measured = messages(folder, setup, "train/measurement")
    commands = messages(folder, setup, "ato/command")
    sent = np.array([command.stamp for command in commands])
    gap = int(np.argmax(np.diff(sent)))
    assert sent[gap + 1] - sent[gap] > 1.5e9 * setup.control_period, "the node was not away"
    first = int(sent[gap + 1] // setup.tick_ns)
    applied = np.array([measurement.applied.sum() for measurement in measured])
    model = setup.model
    limit = float(np.abs(setup.profile.jerk()).max()) * model.inertia * setup.tick
    demand = np.array([command.force.sum() for command in commands])[gap + 1 :]
    ramp = demand[: int(demand.argmin()) + 1]
    assert ramp.size > 10, "the train was at standstill at the takeover"
    assert ramp[-1] < -100e3
    around = applied[first : first + round(BRAKED_S / setup.tick)]
    acting = around[:-1] + np.diff(around) / (1.0 - np.exp(-setup.tick / model.lag))
    latest = np.searchsorted(sent[gap + 1 :], setup.tick_ns * (first + np.arange(acting.size)), side="right") - 1
    lowest = np.minimum.accumulate(np.minimum(demand, around[0]))[latest]
    highest = np.maximum.accumulate(np.maximum(demand, around[0]))[latest]
    acts = int(np.argmax(np.abs(acting) > 1e-3))
    assert (acting[acts:] >= lowest[acts:] - 1e-3).all() and (acting[acts:] <= highest[acts:] + 1e-3).all()
    return float(np.abs(np.diff(ramp)).max()), abs(float(demand[0]) - applied[first]), limit


@pytest.mark.graph
@pytest.mark.parametrize("victim", ["controller", "observer", "profile"])
def test_a_killed_node_takes_over_without_a_jump(victim: str, tmp_path: Path) -> None:
    """Breaks if the run fails, the force jumps at the takeover, a message of the plant is lost or the ATO drives on."""
    # The train coasts until the node returns, however long its process takes to start on a loaded machine.
    setup = metro("duration=165", "supervision.failsafe.coast=600", "supervision.failsafe.service=600")
    outcome = struck(setup, tmp_path, (victim,))
    assert outcome.failure is None
    assert (outcome.summary["status"], outcome.summary["restarts"]) == ("done", {victim: 1})
    assert outcome.summary["ato_disengaged"].startswith(f"node {victim} restarted")
    names = {topic.name for topic in published_by(Role.PLANT)} & set(tick_topics(setup.layout))
    found: dict[str, list[int]] = {name: [] for name in names}
    for topic, stamp, _ in iter_raw(tmp_path, found):
        found[topic].append(stamp)
    for topic, stamps in found.items():
        count = setup.ticks + (topic != "train/measurement")
        assert stamps == [tick * setup.tick_ns for tick in range(count)], topic
    step, begin, limit = takeover(tmp_path, setup)
    assert max(step, begin) <= limit * (1 + 1e-9)
    events = [event.text for event in detect_events(open_recording(tmp_path)) if "restarted" in event.text]
    assert f"node {victim} restarted (node {victim}: its process was ended by SIGKILL)" in events


@pytest.mark.graph
def test_a_killed_supervisor_releases_the_brakes_at_standstill(tmp_path: Path) -> None:
    """Breaks if the train is released while it moves, or never."""
    setup = metro("duration=165")
    outcome = struck(setup, tmp_path, ("supervisor",))
    assert outcome.failure is None
    assert outcome.summary["restarts"] == {"supervisor": 1}
    assert outcome.summary["strongest_reaction"] == "emergency brake"
    active = {state.stamp: state.active[2] for state in messages(tmp_path, setup, "train/protection")}
    speeds = {truth.stamp: abs(truth.velocity[0]) for truth in messages(tmp_path, setup, "train/vehicles")}
    braked = [stamp for stamp, emergency in active.items() if emergency]
    released = min(stamp for stamp in active if stamp > max(braked))
    assert speeds[released] < 0.1
    assert min(braked) * 1e-9 < STRUCK_S + RATE


@pytest.mark.graph
def test_the_ato_is_engaged_again_after_a_restart(tmp_path: Path) -> None:
    """Breaks if a planned request after the kill is lost, or the law drives before it."""
    setup = metro("duration=165", "ato_requests=[{at: 80, do: engage}]")
    outcome = struck(setup, tmp_path, ("controller",))
    assert outcome.failure is None
    reports = messages(tmp_path, setup, "ato/state")
    engaged = [report.stamp * 1e-9 for report in reports if report.state[0] == AtoState.ENGAGED]
    assert any(time > 80 for time in engaged)
    assert not [time for time in engaged if STRUCK_S + RATE < time < 80]
    speed = {truth.stamp * 1e-9: truth.velocity[0] for truth in messages(tmp_path, setup, "train/vehicles")}
    assert max(value for time, value in speed.items() if time > 90) > 1.0


@pytest.mark.graph
def test_two_nodes_killed_one_after_the_other_return(tmp_path: Path) -> None:
    """Breaks if the new process of one node waits for ever for that of the other."""
    outcome = struck(metro("duration=165"), tmp_path, ("observer", "controller"))
    assert outcome.failure is None
    assert outcome.summary["restarts"] == {"observer": 1, "controller": 1}


@pytest.mark.graph
def test_a_node_that_ends_again_and_again_fails_the_run(tmp_path: Path) -> None:
    """Breaks if restarts are not bounded, or the train is not stopped after the last one."""
    kills = [{"node": "observer", "do": "kill", "at": at} for at in range(20, 200, 10)]
    setup = metro("duration=200", f"faults={kills}")
    outcome = run_graph(setup, tmp_path, mode="processes", restarts=2, timeout=LIMIT_S, rate=RATE)
    expected = r"node observer failed: its process was ended by SIGKILL; it was restarted 2 times before"
    assert re.fullmatch(expected, outcome.failure or "")
    assert (outcome.summary["status"], outcome.summary["restarts"]) == ("failed", {"observer": 2})
    last = messages(tmp_path, setup, "train/vehicles")[-1]
    assert abs(last.velocity).max() < 0.1
    assert nothing_left(tmp_path)


@pytest.mark.graph
def test_a_planned_kill_of_a_node_acts_once() -> None:
    """Breaks if the new process repeats a fault of the past, or ``restarts`` of the Python interface has no effect."""
    faults = [{"node": "controller", "do": "kill", "at": 20}]
    run = ta.run("demo", mode="processes", restarts=2, set={"duration": 60, "faults": faults})
    assert (run.metrics["status"], run.metrics["restarts"]) == ("done", {"controller": 1})
