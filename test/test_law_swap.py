"""Changes of the law and takeovers in whole runs: the command keeps the jerk of the profile, the error stays small."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from train_ato.control.laws.pid import Pid
from train_ato.control.registry import LAWS
from train_ato.loop.engine import run_engine
from train_ato.loop.recording import Recording
from train_ato.loop.setup import RunSetup, prepare
from train_ato.scenario.scenario import load_scenario

HELD_S, AFTER_S = 3.0, 20.0
PLACES = {
    "xuzhou_metro": {"standstill": 2, "acceleration": 19, "cruising": 224, "braking": 405, "last 200 m": 416},
    "demo": {"standstill": 20, "acceleration": 133, "cruising": 350, "braking": 534, "last 200 m": 603},
    "daqin_heavy_haul": {
        "standstill": 20, "acceleration": 250, "cruising": 800, "braking": 1400, "last 200 m": 3046
    },
    "crh380a_gpc:short": {"standstill": 2, "acceleration": 60, "cruising": 320, "braking": 500, "last 200 m": 611},
    "crh380a_funnel:short": {"standstill": 6, "acceleration": 60, "cruising": 320, "braking": 500, "last 200 m": 609},
}  # fmt: skip
"""Places of a change of the law by scenario: its time [s]; on daqin_heavy_haul the air brake acts in braking."""
JERK = {
    "xuzhou_metro": 0.6, "demo": 0.002, "daqin_heavy_haul": 0.002, "crh380a_gpc": 0.25, "crh380a_funnel": 0.25,
}  # fmt: skip
"""Jerk of the profile [m/s³]; that of the recorded one of daqin_heavy_haul jumps, its limit is in the scenario."""
SAMPLE = [
    ("xuzhou_metro", "acceleration", "smc", "funnel"),
    ("xuzhou_metro", "acceleration", "rbf_switching_smc", "pid"),
    ("xuzhou_metro", "standstill", "pid", "gpc"),
    ("xuzhou_metro", "acceleration", "pid", "mpc"),
    ("xuzhou_metro", "acceleration", "lag_smc", "mpc"),
    ("crh380a_funnel:short", "standstill", "smc", "mpc"),
    ("crh380a_gpc:short", "cruising", "pid", "gpc"),
    ("daqin_heavy_haul", "acceleration", "pid", "rbf_smc"),
]
ALL = [
    (scenario, place, old, new)
    for scenario, places in PLACES.items()
    for place in places
    for old in LAWS.names()
    for new in LAWS.names()
    if old != new
]


def driven(scenario: str, *changes: str, compiled: bool = True) -> tuple[RunSetup, Recording]:
    setup = prepare(*load_scenario(scenario, changes))
    recording = run_engine(setup, compiled=compiled).recording
    assert recording is not None
    return setup, recording


@lru_cache(maxsize=20)
def error_alone(scenario: str, law: str, begin: float) -> float:
    """Return the largest position error of a law alone from a time on [m]."""
    return error(*driven(scenario, f"law={law}", f"duration={begin + AFTER_S}"), begin)


def error(setup: RunSetup, recording: Recording, begin: float) -> float:
    errors = recording.position + setup.model.offsets - recording.reference_position[:, None]
    return float(np.abs(errors[recording.time >= begin]).max())


def bound(setup: RunSetup) -> np.ndarray:
    """Return jerk x inertia x share x tick of every unit [N]."""
    jerk = JERK[setup.scenario.name.partition(":")[0]]
    return np.asarray(jerk * setup.model.inertia * setup.model.share * setup.tick * (1 + 1e-6))


def change(recording: Recording, begin: float, tick: float, lasting: float = HELD_S) -> np.ndarray:
    """Return the largest change of the command of every unit in one tick from a time on [N]."""
    held = (recording.time >= begin - 1.5 * tick) & (recording.time < begin + lasting - 0.5 * tick)
    return np.asarray(np.abs(np.diff(recording.command[held], axis=0)).max(axis=0))


def check(scenario: str, place: str, old: str, new: str) -> None:
    begin = PLACES[scenario][place]
    swap = f"law_changes=[{{at: {begin}, law: {new}}}]"
    setup, recording = driven(scenario, f"law={old}", swap, f"duration={begin + AFTER_S}")
    assert (change(recording, begin, setup.tick) <= bound(setup)).all()
    alone = max(error_alone(scenario, law, begin) for law in (old, new))
    assert error(setup, recording, begin) <= 2.0 * alone + 0.05


@pytest.mark.parametrize(("scenario", "place", "old", "new"), SAMPLE)
def test_a_swap_keeps_the_jerk_of_the_profile_and_the_error(scenario: str, place: str, old: str, new: str) -> None:
    """Breaks if a tick of the first 3 s exceeds the bound, or the error is above twice that of the worse law alone."""
    check(scenario, place, old, new)


@pytest.mark.campaign
@pytest.mark.parametrize(("scenario", "place", "old", "new"), ALL)
def test_every_swap_keeps_the_jerk_of_the_profile(scenario: str, place: str, old: str, new: str) -> None:
    """Breaks if a tick of the first 3 s exceeds the bound."""
    begin = PLACES[scenario][place]
    swap = f"law_changes=[{{at: {begin}, law: {new}}}]"
    setup, recording = driven(scenario, f"law={old}", swap, f"duration={begin + HELD_S + 1}")
    assert (change(recording, begin, setup.tick) <= bound(setup)).all()


def test_a_change_of_a_gain_keeps_the_jerk_of_the_profile() -> None:
    """Breaks if the new gain acts at once: the command would jump with the speed error."""
    gain = "law_changes=[{at: 19, laws: {pid: {gains: printed, kp: 2.0}}}]"
    setup, recording = driven("xuzhou_metro", "law=pid", gain, "duration=25")
    assert (change(recording, 19.0, setup.tick) <= bound(setup)).all()


def test_the_integral_of_a_law_does_not_come_back_after_a_swap_to_and_fro() -> None:
    """Breaks if the second swap takes up the old object: its integral would be that of 20 s."""
    there = "law_changes=[{at: 20, law: smc}, {at: 25, law: pid}]"
    pid = "laws.pid.integral=speed"
    setup, recording = driven("xuzhou_metro", "law=pid", pid, there, "duration=30")
    assert (change(recording, 25.0, setup.tick) <= bound(setup)).all()


def test_the_braking_law_takes_over_and_gives_back_without_a_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the full brake acts in one tick, or takes longer than 3 s, or the return jumps."""
    step = Pid.step

    def eager(self: Pid, inputs: Any) -> Any:
        output = step(self, inputs)
        output.force[:] = np.maximum(output.force, 60e3)
        return output

    monkeypatch.setattr(Pid, "step", eager)
    setup, recording = driven("xuzhou_metro:disturbed", "law=pid", "duration=80", compiled=False)
    states = [(report.stamp * 1e-9, report.message) for report in recording.reports if report.node == "controller"]
    begin = next(time for time, state in states if state == "braking law")
    end = next(time for time, state in states if state == "engaged" and time > begin)
    brake = float(setup.model.force_limits(np.full(1, 10.0))[0].sum())
    largest = max(float(bound(setup)[0]), (60e3 - brake) * setup.tick / HELD_S)
    assert change(recording, begin, setup.tick, end - begin + HELD_S) <= largest * (1 + 1e-6)
    during = (recording.time >= begin) & (recording.time < begin + HELD_S)
    assert recording.command[during].min() < -100e3
