"""40 random combinations of law, observer, compensation and scenario: each is refused with a reason, tracked, or named.

The check beside the outcome uses only the series of the run, with other formulas than the program.
"""

from __future__ import annotations

import random

import numpy as np
import pytest

from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import RunSetup, prepare
from train_ato.loop.tracking import OUTCOMES, TRACKED
from train_ato.scenario.scenario import load_scenario

SEED = 10
COUNT = 40
SCENARIOS: dict[str, tuple[str, ...]] = {
    "demo": ("duration=150",),
    "daqin_heavy_haul": ("duration=200",),
    "xuzhou_metro": ("duration=100", "step=0.005"),
    "xuzhou_metro:disturbed": ("duration=100", "step=0.005"),
    "xuzhou_metro:long_delay": ("duration=100", "step=0.005"),
    "freight_consensus:aligned": (),
    "freight_consensus:realistic": (),
    "crh380a_gpc:short": ("duration=150",),
    "crh380a_funnel:short": ("duration=150", "control_period=0.2"),
}
"""Scenario and its assignments: short runs, with departure and running at constant speed."""
NEAR, FAR = 1 / 20, 1 / 4
"""Part of the way of the reference: a lost train is farther off than the first, a tracked one nearer."""


def combinations() -> list[tuple[str, str, str, str]]:
    """Return the combinations: scenario, law, observer, compensation."""
    draw = random.Random(SEED)
    kinds = (sorted(SCENARIOS), LAWS.names(), OBSERVERS.names(), COMPENSATIONS.names())
    return [(draw.choice(kinds[0]), *(draw.choice(names) for names in kinds[1:])) for _ in range(COUNT)]


def combined(scenario: str, law: str, observer: str, compensation: str) -> RunSetup:
    choice = {"law": law, "observer": observer, "compensation": compensation}
    return prepare(*load_scenario(scenario, SCENARIOS[scenario], choice))


@pytest.mark.campaign
@pytest.mark.parametrize(("scenario", "law", "observer", "compensation"), combinations())
def test_a_random_combination_is_refused_tracked_or_named(
    scenario: str, law: str, observer: str, compensation: str
) -> None:
    """Breaks if a run without a finding is far off, a lost one is near, or a refusal has no reason."""
    try:
        setup = combined(scenario, law, observer, compensation)
    except ValueError as error:
        text = str(error)
        assert "\n" not in text and f"'{law}'" in text and " set " in text
        return
    result = run_engine(setup)
    if result.failure is not None:
        assert "\n" not in result.failure
        return
    found, findings = result.summary["tracking"], result.summary["tracking_findings"]
    assert found in OUTCOMES and (found == TRACKED) == (not findings)
    assert all(row["text"] and np.isfinite(row["value"]) for row in findings)
    recording = result.recording
    assert recording is not None
    engaged = result.summary.get("ato_disengaged_s")
    rows = recording.time < (np.inf if engaged is None else engaged)
    # position errors of all units at the ticks, speed errors from the way within a second
    wanted = recording.reference_position[rows]
    apart = np.abs(recording.position[rows] - wanted[:, None] + setup.model.offsets)
    second = round(1 / setup.tick)
    ways = [x[second:] - x[:-second] for x in (recording.front_position[rows], wanted)]
    if found == TRACKED:
        assert apart.max() < max(FAR * float(np.ptp(wanted)), 12.0)
        fastest = float(np.abs(recording.reference_velocity).max())
        assert np.median(np.abs(ways[0] - ways[1])) < min(FAR * fastest, 15 / 3.6)
    if found in ("lost", "never departed"):
        swing = float(np.median(np.abs(ways[0] - ways[1]))) / float(np.abs(recording.reference_velocity).max())
        assert apart.max() > NEAR * float(np.ptp(wanted)) or swing > NEAR
    if found == "limit cycle":
        # half of the command's change is in a narrow band of frequencies
        assert peak_share(recording.command[rows], setup) > 0.1


def peak_share(command: np.ndarray, setup: RunSetup) -> float:
    """Return the largest spread of a command within ten seconds that it has again in the next ten, over the force."""
    count = round(10 / setup.tick)
    spreads = [np.ptp(command[i : i + count], axis=0) for i in range(0, len(command) - count, count)]
    again = np.minimum(spreads[:-1], spreads[1:]).max(axis=0) / 2
    force = [max(a.largest(), b.largest()) for a, b in zip(setup.model.traction, setup.model.brake, strict=True)]
    return float((again / force).max())
