"""Paper 004: the verdict changes with the figure; short runs on sampling period and couplers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from recordings import with_series
from reproduce_results import claim
from tracking_results import tracked

from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.papers.claims import Result, Verdict
from train_ato.papers.p004_gpc import checks as gpc_judges
from train_ato.papers.p004_gpc.cases import CASES, LAWS, SAMPLINGS, TRAINS, WEIGHTS
from train_ato.papers.p004_gpc.claims import PAPER
from train_ato.papers.tracking import largest_speed_error
from train_ato.scenario.scenario import load_scenario

GOOD, ELSEWHERE, BAD = Verdict.REPRODUCED, Verdict.OTHER_SETTING, Verdict.NOT_REPRODUCED


def moving(speed: float, place: float = 0.1, **more: float) -> Result:
    return tracked(place, speed, until=100.0, **more)


def compared(ours: float, pid: float, preview: float = 0.05) -> dict[str, Result]:
    return {"gpc long": moving(ours), "pid long": moving(pid), "pid preview long": moving(preview)}


def sampled(slow: float, fast: float) -> dict[str, Result]:
    runs = {f"Ts {period}": moving(fast if period <= 0.4 else slow) for period in SAMPLINGS}
    return runs | {f"Ts 0.4 lambda {weight}": moving(fast) for weight in WEIGHTS}


def offsets(printed: float, held: float) -> dict[str, Result]:
    return {"gpc normal": moving(0.1, printed), "gpc held": moving(0.1, held), "gpc on position": moving(0.1, 0.1)}


def jumped(increments: float, printed: float, pid: float) -> dict[str, Result]:
    values = {"gpc": increments, "gpc fixed": 0.7, "gpc absolute": printed, "pid": pid, "pid preview": 0.45}
    return {f"{key} jump": moving(value) for key, value in values.items()}


def afterwards(increments: float, printed: float) -> dict[str, Result]:
    values = {"gpc jump": increments, "gpc absolute jump": printed, "gpc normal": 0.01}
    return {key: tracked(0.0, value, until=400.0, duration=400.0) for key, value in values.items()}


def unmodelled(kept: float, left_out: float) -> dict[str, Result]:
    return {"gpc normal": moving(kept), "no network": moving(left_out), "raw residual": moving(1.0)}


def units(coupled: float, free: float) -> dict[str, Result]:
    return {"per unit": moving(coupled), "per unit, free": moving(free), "gpc normal": moving(0.01)}


def sturdy(mass: float, delay: float) -> dict[str, Result]:
    values = {"normal": 0.15, "half_more": delay, "half_less": 0.15, "heavy": mass, "light": mass, "noise": 0.15}
    return {f"{key} {train}": moving(value) for key in ("gpc", "pid preview") for train, value in values.items()}


def comfortable(stop: float, acceleration: float) -> dict[str, Result]:
    result = moving(0.1, stop_error_m=stop)
    return {"gpc long": Result({**result.summary, "acceleration_max": acceleration}, result.recording)}


FLIPS: list[tuple[str, Callable[[], dict[str, Result]], Verdict]] = [
    ("more exact than PID", lambda: compared(0.15, 1.5), GOOD),
    ("more exact than PID", lambda: compared(1.6, 1.5), BAD),
    ("N = 3, Nu = 2", lambda: sampled(0.01, 1.0), ELSEWHERE),
    ("N = 3, Nu = 2", lambda: sampled(0.01, 0.01), GOOD),
    ("N = 3, Nu = 2", lambda: sampled(1.0, 1.0), BAD),
    ("(22) leaves", lambda: offsets(1.3, 0.9), ELSEWHERE),
    ("(22) leaves", lambda: offsets(0.1, 0.9), GOOD),
    ("(22) leaves", lambda: offsets(1.3, 2.0), BAD),
    ("a small jump", lambda: jumped(0.47, 1.8, 2.1), ELSEWHERE),
    ("a small jump", lambda: jumped(0.47, 0.5, 2.1), GOOD),
    ("a small jump", lambda: jumped(1.9, 1.8, 2.1), BAD),
    ("after the jump", lambda: afterwards(0.05, 0.5), ELSEWHERE),
    ("after the jump", lambda: afterwards(0.05, 0.012), GOOD),
    ("after the jump", lambda: afterwards(0.4, 0.5), BAD),
    ("the network takes", lambda: unmodelled(0.01, 0.13), GOOD),
    ("the network takes", lambda: unmodelled(0.1, 0.13), BAD),
    ("multivariable", lambda: units(0.3, 0.01), ELSEWHERE),
    ("multivariable", lambda: units(0.01, 0.01), GOOD),
    ("multivariable", lambda: units(0.3, 0.3), BAD),
    ("robust", lambda: sturdy(0.2, 0.6), ELSEWHERE),
    ("robust", lambda: sturdy(0.2, 0.2), GOOD),
    ("robust", lambda: sturdy(0.9, 0.6), BAD),
    ("punctual", lambda: comfortable(0.1, 0.05), GOOD),
    ("punctual", lambda: comfortable(8.0, 0.05), ELSEWHERE),
    ("punctual", lambda: comfortable(0.1, 0.5), BAD),
]


@pytest.mark.parametrize(("text", "results", "verdict"), FLIPS)
def test_judges_flip_with_their_figures(text: str, results: Callable[[], dict[str, Result]], verdict: Verdict) -> None:
    """Breaks if the verdict does not depend on the measured figure."""
    assert claim(PAPER, text).judge(results()).verdict is verdict


@pytest.mark.parametrize(("ours", "off", "verdict"), [(45.0, 11.0, ELSEWHERE), (12.0, 11.0, GOOD), (45.0, 44.0, BAD)])
def test_judge_of_the_limited_run_flips(
    monkeypatch: pytest.MonkeyPatch, ours: float, off: float, verdict: Verdict
) -> None:
    """Breaks if the judge ignores the effect of law or profile with 200 kN."""
    monkeypatch.setattr(gpc_judges, "off_profile", lambda recording, scenario: (np.array([off]), np.array([0.5])))
    keys = ("gpc limited", "pid limited", "pid preview limited", "pid preview planned")
    assert claim(PAPER, "with 200 kN").judge({key: moving(0.1, ours) for key in keys}).verdict is verdict


def test_every_claim_has_its_cases_and_every_case_a_scenario() -> None:
    """Breaks if a claim or the table names a missing case, or a case a missing scenario."""
    assert {key for entry in PAPER.claims for key in entry.cases} <= set(CASES)
    assert {f"{key} {train}" for key in LAWS for train in TRAINS} <= set(CASES)
    for case in CASES.values():
        load_scenario(case.scenario, changes=dict(case.changes))


def test_largest_speed_error_leaves_the_standstill_out() -> None:
    """Breaks if the last cm/s under the holding brake count as tracking."""
    result = moving(0.5)
    assert result.recording is not None
    halted = with_series(result.recording, reference_velocity=np.zeros(result.recording.time.size))
    assert largest_speed_error(result) == pytest.approx(0.5)
    with pytest.raises(ValueError):
        largest_speed_error(Result(result.summary, halted))


def drive(key: str, duration: float) -> Result:
    case = CASES[key]
    outcome = run_engine(prepare(*load_scenario(case.scenario, changes={**case.changes, "duration": duration})))
    return Result(outcome.summary, outcome.recording, outcome.failure)


def test_sampling_period_decides() -> None:
    """N = 3, Nu = 2: tracks at 1.2 s; at 0.4 s the delay is longer than three samples."""
    assert gpc_judges.speed_rms(drive("Ts 1.2", 120.0)) < 0.02
    assert gpc_judges.speed_rms(drive("Ts 0.4", 120.0)) > 0.05


def test_three_laws_lean_on_each_other_through_the_couplers() -> None:
    """Breaks if independent loops are stable with couplers or unstable without them, or the common loop is unstable."""
    duration = 260.0
    assert gpc_judges.coupler(drive("per unit", duration)) > 60.0
    assert gpc_judges.coupler(drive("gpc normal", duration)) < 20.0
    assert gpc_judges.speed_rms(drive("per unit, free", duration)) < 0.02


def test_jump_is_held_on_increments_alone() -> None:
    """Two minutes after the jump a loop identified on the speed itself oscillates by 1 m/s."""
    increments, absolute = (largest_speed_error(drive(f"{key} jump", 260.0)) for key in ("gpc", "gpc absolute"))
    assert increments < 0.6
    assert absolute > 2 * increments
