"""Reaction times from the loss of a message to the demand of the train, at 10 and 50 Hz."""

import pytest
from engine_runs import setup_of

from msgs_docs.generate.fault_page import BASES
from train_ato.judge.protection_record import state_spans
from train_ato.loop.engine import run_engine

NAME, *METRO = BASES["metro"]
LOSS = 20.0
"""Time of the first lost message [s]."""


def reactions_of(topic: str, *sets: str) -> tuple[dict[str, float], float, float]:
    """Return the times from the loss to the reactions of the train, the largest delay of the command, the tick [s]."""
    fault = f"faults=[{{do: drop, topic: {topic}, begin: {LOSS}}}]"
    setup = setup_of(NAME, *METRO, "duration=40", fault, *sets)
    recording = run_engine(setup).recording
    assert recording is not None
    times = {span.state: span.begin - LOSS for span in reversed(state_spans(recording.reports, "plant"))}
    return times, setup.scenario.links.command.longest, setup.tick


@pytest.mark.parametrize("tick", [0.1, 0.02], ids=["10 Hz", "50 Hz"])
@pytest.mark.parametrize("bounds", [(0.5, 1.0, 5.0), (0.2, 0.4, 0.6)], ids=str)
def test_a_lost_command_has_each_reaction_within_two_periods_after_its_bound(tick, bounds):
    """Breaks if the age of a command counts from a wrong event, or a reaction is late."""
    names = ("hold", "coast", "service")
    sets = [f"supervision.failsafe.{name}={bound}" for name, bound in zip(names, bounds, strict=True)]
    times, delay, period = reactions_of("ato/command", f"tick={tick}", *sets)
    for reaction, bound in zip(("coast", "service brake", "emergency brake"), bounds, strict=True):
        assert bound < times[reaction] - delay <= bound + 2.0 * period + 1e-9, reaction


@pytest.mark.parametrize("tick", [0.1, 0.02], ids=["10 Hz", "50 Hz"])
def test_a_lost_brake_release_has_the_emergency_brake_within_two_periods_after_its_bound(tick):
    times, _, period = reactions_of("atp/brake_release", f"tick={tick}", "supervision.failsafe.release=0.5")
    # The last release before the loss is at most one supervision period old.
    assert 0.5 - 0.4 < times["emergency brake"] <= 0.5 + 2.0 * period + 1e-9
