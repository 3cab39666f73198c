"""Compiled ticks with a supervisor give the messages and the recording of the ticks in Python, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from case_costs import sampled
from span_runs import Both, setup_of

from train_ato.loop.engine import TickLoop
from train_ato.loop.train_protection import TrainProtection, command_age
from train_ato.messages.links import DelayJump

SHORT = {"duration": 130}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "demo to its stop": ("demo", {}),
    "heavy haul": ("daqin_heavy_haul", SHORT),
    "twin, disturbances, noise": ("daqin_heavy_haul:twin+disturbed+noise", SHORT),
    "mismatch, smc": ("daqin_heavy_haul:tuned+strong_mismatch", {**SHORT, "law": "smc", "compensation": "twin"}),
    "overspeed on a line with limits": ("crh380a_gpc", {**SHORT, "law": "pid", "compensation": "preview"}),
    "curve of the service brake": (
        "crh380a_funnel:short", {"law": "pid", "supervision.service_curve": True, "duration": 100}
    ),
    "period of one tick, without assurance": (
        "crh380a_funnel:short",
        {"duration": 60, "law": "funnel", "compensation": "none", "supervision.period": 0.05,
         "supervision.assurance": False},
    ),
    "balises": ("demo", {**SHORT, "plant.odometry": {"balise_spacing": 30.0, "wheel_error": 0.01}}),
    "command held for no time": ("demo", {**SHORT, "supervision.failsafe": {"hold": 0.0}}),
    "varying delay": (
        "demo", {**SHORT, "links.command": {"delay": 0.8, "varying": {"amplitude": 0.3, "omega": 1.0}}}
    ),
    "commands late and lost at random": (
        "demo", {**SHORT, "links.command": {"delay": 0.5, "jitter": 0.2, "loss": 0.2}}
    ),
    "gust": ("demo", {**SHORT, "interventions": [{"do": "gust", "at": 60.05, "acceleration": -0.05, "duration": 9}]}),
    "emergency brake": ("demo", {**SHORT, "interventions": [{"do": "emergency_brake", "at": 90}]}),
    "lost commands and releases": (
        "demo",
        {**SHORT, "interventions": [
            {"do": "message_loss", "at": 60, "topic": "ato/command", "duration": 0.4},
            {"do": "message_loss", "at": 120, "topic": "atp/brake_release", "duration": 0.4},
        ]},
    ),
    "frozen measurement, changed delays": (
        "demo",
        {**SHORT, "interventions": [
            {"do": "message_freeze", "at": 50, "topic": "train/measurement", "duration": 0.6},
            {"do": "delay_jump", "at": 80, "factor": 1.5}, {"do": "delay_jump", "at": 110, "add": -0.5},
        ]},
    ),
    "dropped references, corrupt odometry": (
        "demo",
        {**SHORT, "faults": [
            {"do": "drop", "topic": "ato/reference", "begin": 50, "end": 51, "probability": 0.5},
            {"do": "corrupt", "topic": "train/odometry", "begin": 120, "end": 122, "probability": 0.3, "value": "bit"},
        ]},
    ),
    "late measurements, repeated commands": (
        "demo",
        {**SHORT, "faults": [
            {"do": "delay", "topic": "train/measurement", "begin": 50.1, "end": 53, "delay": 0.3},
            {"do": "repeat", "topic": "ato/command", "begin": 80, "end": 81},
        ]},
    ),
    "ATO disengaged and engaged with a new profile": (
        "crh380a_funnel:short",
        {"law": "pid", "duration": 160,
         "ato_requests": [{"at": 20, "do": "disengage"}, {"at": 30, "do": "engage"}]},
    ),
    "faults without a supervisor": (
        "xuzhou_metro",
        {"duration": 60, "law": "pid", "faults": [
            {"do": "drop", "topic": "ato/command", "begin": 20, "end": 21, "probability": 0.5},
        ]},
    ),
}  # fmt: skip
"""Scenario and changes; together they contain every state of the supervisor, and every reaction of the train."""
FULL = ("daqin_heavy_haul", "daqin_heavy_haul:twin", "daqin_heavy_haul:disturbed+mismatch")


MOSTLY = ("heavy haul", "balises", "gust", "varying delay", "commands late and lost at random")
"""Cases in which most ticks are compiled: a run left to Python would be compared with itself."""


@pytest.mark.parametrize("case", sampled(CASES, every=2))
def test_supervised_ticks_give_messages_and_recording_of_python(case: str) -> None:
    """Breaks if limits, odometry, state, brake release or report of a compiled step differ in one bit."""
    # A fault or an intervention that begins inside a span, a state of a stage that a span does not continue, or a topic
    # of the supervisor with another shape in the recording does too.
    Both(setup_of(*CASES[case])).assert_equal(least=0.8 if case in MOSTLY else 0.0)


@pytest.mark.campaign
@pytest.mark.parametrize("name", FULL)
def test_a_whole_supervised_run_is_equal(name: str) -> None:
    """Breaks if a state drifts over a long run: brake applications, indication and stop at the end of authority."""
    Both(setup_of(name, {})).assert_equal()


def test_a_train_above_its_limit_is_left_to_the_supervisor() -> None:
    """Breaks if a compiled tick goes on beyond a limit: supervisor, assurance and brake must act in Python."""
    setup = setup_of("demo", {"duration": 200, "supervision.assurance": False, "law": "pid"})
    loop = TickLoop(setup, None, compiled=True)
    loop.start()
    while loop.plant.stamp < 100_000_000_000:
        loop.advance()
    assert loop._spans is not None and loop.supervisor is not None
    before, ceilings = loop._spans.ticks, loop.supervisor.supervisor.track.records.ceilings
    assert loop._spans.supervised.is_quiet
    for name in ("permitted", "warning", "service"):
        ceilings[name] = 1.0
    for _ in range(20):
        loop.advance()
    assert loop._spans.ticks <= before + setup.supervision_ticks
    assert loop.supervisor.supervisor.interventions == 1


def test_age_of_the_newest_command_that_has_arrived() -> None:
    """Breaks if the delay of the link, a lost command or a change of the delay counts wrong in the age of a command."""
    setup = setup_of("demo", {**SHORT, "links.command": {"delay": 0.5}})
    protection, tick, ages = TrainProtection(setup), setup.tick_ns, []
    for number in range(30):
        at = number * tick
        if number == 20:
            protection.jump(DelayJump(at=at * 1e-9, add=0.3))
        if number not in (10, 11):
            protection.on_command(at)
        ages.append(int(command_age(protection.age, *protection.stamps.records(at, 0), at, np.zeros((1, 1)))))
    assert tick == 100_000_000  # a command in time is 5 ticks old on arrival, and nominally 6
    assert [age // tick for age in ages[14:19]] == [-1, 0, 1, -1, -1]
    assert [age // tick for age in ages[24:30]] == [-1, 0, 1, 2, 2, 2]
