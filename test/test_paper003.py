"""Paper 003: the verdict changes with the figure; short runs of the law with and without saturation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from reproduce_results import claim
from tracking_results import tracked, with_command

from train_ato.loop.engine import run_engine
from train_ato.loop.recording import Recording
from train_ato.loop.setup import prepare
from train_ato.papers.claims import Case, Result, Verdict
from train_ato.papers.p003_funnel import checks as funnel_judges
from train_ato.papers.p003_funnel.cases import CASES, LAWS, TRAINS
from train_ato.papers.p003_funnel.claims import PAPER
from train_ato.papers.p003_funnel.series import boundaries, last_saturation, off_profile
from train_ato.papers.tracking import last_outside, position_error, speed_error, written
from train_ato.scenario.scenario import load_scenario

GOOD, ELSEWHERE, BAD = Verdict.REPRODUCED, Verdict.OTHER_SETTING, Verdict.NOT_REPRODUCED
COUNT = 2000


def demanding(newton: float) -> Result:
    return with_command(tracked(), np.full(COUNT, newton))


def in_saturation(place: float, speed: float, until: float = 20.0) -> Result:
    """Return a run at the limit from 5 to 15 s with errors up to a given time."""
    t = 0.05 * np.arange(COUNT)
    return with_command(tracked(place, speed, until=until), np.where((t > 5) & (t < 15), -200e3, 0.0))


def lost(whole: float, speed: float, short: float, clipped: float) -> dict[str, Result]:
    runs = {"unhandled 10 ms": short, "unhandled": short, "unhandled clipped": clipped, "unhandled aware": short}
    return {key: tracked(value) for key, value in runs.items()} | {"unhandled long": tracked(whole, speed)}


def finer(long: float, short: float, speed: float) -> dict[str, Result]:
    return {"unhandled long 10 ms": tracked(long, 4.0), "unhandled 1 ms": tracked(short, speed)}


def funnels(dynamic: float, fixed: float, tight: float) -> dict[str, Result]:
    values = {"printed saturated": dynamic, "fixed gains": fixed, "unhandled aware": tight}
    return {key: tracked(value) for key, value in values.items()}


def mismatched(worst: float, noisy: float) -> dict[str, Result]:
    keys = [f"printed {key}" for key in ("half_more", "later", "lagging", "light")]
    runs = {key: tracked(worst) for key in keys}
    return runs | {"printed position noise": tracked(noisy), "corrected position noise": tracked(0.03)}


def noisy(variation: float) -> dict[str, Result]:
    keys = ("printed", "corrected", "pid", "predictor")
    runs = {f"{key} noise": tracked(0.1, command_variation_kn_per_s=500.0) for key in keys}
    return runs | {"quiet noise": tracked(0.1, command_variation_kn_per_s=variation)}


FLIPS: list[tuple[str, Callable[[], dict[str, Result]], Verdict]] = [
    ("tracking without", lambda: {"printed long": tracked(0.08, 0.004), "corrected long": tracked(0.02)}, GOOD),
    ("tracking without", lambda: {"printed long": tracked(0.3, 0.1), "corrected long": tracked(0.02)}, ELSEWHERE),
    ("tracking without", lambda: {"printed long": tracked(0.3, 0.1), "corrected long": tracked(0.2)}, BAD),
    ("Theorem 1", lambda: {"printed long": tracked(0.06), "corrected long": tracked(0.005)}, ELSEWHERE),
    ("Theorem 1", lambda: {"printed long": tracked(0.002), "corrected long": tracked(0.005)}, GOOD),
    ("Theorem 1", lambda: {"printed long": tracked(0.06), "corrected long": tracked(0.05)}, BAD),
    (
        "the delay state",
        lambda: {
            "corrected nominal": tracked(0.03),
            "corrected no delay state": tracked(0.05),
            "pid nominal": tracked(0.03),
            "pid alone": tracked(1.5),
        },
        GOOD,
    ),
    (
        "the delay state",
        lambda: {
            "corrected nominal": tracked(0.05),
            "corrected no delay state": tracked(0.05),
            "pid nominal": tracked(0.03),
            "pid alone": tracked(1.5),
        },
        BAD,
    ),
    ("200 kN are a cut", lambda: {"printed long": demanding(-225.7e3)}, GOOD),
    ("200 kN are a cut", lambda: {"printed long": demanding(-240e3)}, BAD),
    ("stable in saturation", lambda: {"printed long saturated": in_saturation(44.0, 2.2)}, GOOD),
    ("stable in saturation", lambda: {"printed long saturated": in_saturation(90.0, 2.2)}, BAD),
    ("recovery when", lambda: {"printed long saturated": in_saturation(44.0, 2.2, until=30.0)}, GOOD),
    ("recovery when", lambda: {"printed long saturated": in_saturation(44.0, 2.2, until=50.0)}, ELSEWHERE),
    ("recovery when", lambda: {"printed long saturated": in_saturation(44.0, 2.2, until=99.0)}, BAD),
    ("without handling", lambda: lost(7000.0, 30.0, 900.0, 44.0), GOOD),
    ("without handling", lambda: lost(7000.0, 5.4, 900.0, 44.0), ELSEWHERE),
    ("without handling", lambda: lost(70.0, 30.0, 60.0, 44.0), BAD),
    ("the same at finer", lambda: finer(3800.0, 2300.0, 38.0), GOOD),
    ("the same at finer", lambda: finer(3800.0, 2300.0, 5.0), ELSEWHERE),
    ("the same at finer", lambda: finer(200.0, 50.0, 38.0), ELSEWHERE),
    ("the same at finer", lambda: finer(50.0, 50.0, 38.0), BAD),
    ("the dynamic funnel", lambda: funnels(44.1, 44.1, 900.0), ELSEWHERE),
    ("the dynamic funnel", lambda: funnels(20.0, 44.1, 900.0), GOOD),
    ("the dynamic funnel", lambda: funnels(44.1, 44.1, 30.0), BAD),
    ("robust to", lambda: mismatched(0.3, 8.0), ELSEWHERE),
    ("robust to", lambda: mismatched(0.3, 0.3), GOOD),
    ("robust to", lambda: mismatched(3.0, 8.0), BAD),
    ("goal with 0.05", lambda: noisy(55.0), GOOD),
    ("goal with 0.05", lambda: noisy(300.0), BAD),
]


@pytest.mark.parametrize(("text", "results", "verdict"), FLIPS)
def test_judges_flip_with_their_figures(text: str, results: Callable[[], dict[str, Result]], verdict: Verdict) -> None:
    """Breaks if the verdict does not depend on the measured figure."""
    assert claim(PAPER, text).judge(results()).verdict is verdict


@pytest.mark.parametrize(
    ("off", "fast", "own", "verdict"),
    [(11.0, 0.7, 0.02, GOOD), (44.0, 0.7, 0.02, BAD), (11.0, 2.1, 0.02, BAD), (11.0, 0.7, 0.4, BAD)],
)
def test_judge_of_the_planned_run_flips(
    monkeypatch: pytest.MonkeyPatch, off: float, fast: float, own: float, verdict: Verdict
) -> None:
    """Breaks if the judge ignores position, speed, or the tracking of the new profile."""
    monkeypatch.setattr(funnel_judges, "off_profile", lambda recording, scenario: (np.array([off]), np.array([fast])))
    runs = {key: tracked(own) for key in ("predictor planned", "predictor replanned")}
    assert claim(PAPER, "goal at 200 kN").judge(runs).verdict is verdict


def test_every_claim_has_its_cases_and_every_case_a_scenario() -> None:
    """Breaks if a claim names a missing case, or a case a missing scenario or variant."""
    assert {key for entry in PAPER.claims for key in entry.cases} <= set(CASES)
    assert {f"{key} nominal" for key in LAWS} <= set(CASES)
    for case in CASES.values():
        load_scenario(case.scenario, changes=dict(case.changes))


def test_last_saturation_bridges_gaps_and_takes_the_longest() -> None:
    """Breaks if a sample inside the limits splits an interval, or a short interval counts."""
    t = 0.05 * np.arange(COUNT)
    command = np.where((t > 5) & (t < 8), 200e3, 0.0) + np.where(
        (t > 30) & (t < 60) & (np.abs(t - 40) > 2), -200e3, 0.0
    )
    recording = with_command(tracked(), command).recording
    assert recording is not None
    assert last_saturation(recording, 200e3) == pytest.approx((30.05, 59.95), abs=0.06)
    with pytest.raises(ValueError, match="never at its limit"):
        last_saturation(recording, 240e3)


def test_last_outside_and_how_figures_are_written() -> None:
    """Breaks if a later excursion is missed or a unit is wrong by a factor of 1000."""
    time = np.arange(6.0)
    values = np.array([[5.0], [0.0], [-3.0], [0.1], [0.0], [9.0]])
    assert last_outside(time, values, 1.0, end=5.0) == 2.0
    assert np.isnan(last_outside(time, values, 10.0))
    texts = [
        written(0.0024, "m"),
        written(43.97, "m"),
        written(7353.0, "m"),
        written(float("nan"), "s"),
        written(0.698, "m/s"),
    ]
    assert texts == ["2.4 mm", "44 m", "7.35 km", "never", "0.698 m/s"]


def drive(case: Case, **changes: Any) -> Recording:
    outcome = run_engine(prepare(*load_scenario(case.scenario, changes={**case.changes, **changes})))
    assert outcome.recording is not None
    return outcome.recording


def test_printed_law_carries_an_offset_and_the_corrected_one_does_not() -> None:
    """During acceleration the printed law has an offset of h/k1, centimetres; with lambda in 1/s a third of it."""
    found = {}
    for key in ("printed nominal", "corrected nominal"):
        recording = drive(CASES[key], duration=60.0)
        found[key] = np.abs(position_error(recording)[recording.time > 30.0]).max()
    assert 0.02 < found["printed nominal"] < 0.05
    assert found["corrected nominal"] < found["printed nominal"] / 3


@pytest.mark.slow
def test_saturation_recovers_and_its_funnels_are_wide_open() -> None:
    """An error of 44 m returns below 10 cm; the printed funnel ends far wider than the largest error."""
    case = CASES["printed saturated"]
    recording = drive(case)
    error = np.abs(position_error(recording)[:, 0])
    assert 43.0 < error.max() < 46.0
    assert error[-200:].max() < 0.1
    assert np.abs(speed_error(recording)).max() < 4.0
    phi1, phi2 = boundaries(case, recording)
    assert phi1[-1] > 10 * error.max()
    assert phi2[-1] > 100.0
    assert phi2[0] == pytest.approx(0.1)


@pytest.mark.slow
def test_planned_for_200_kn_stays_within_13_m_of_the_other_profile() -> None:
    """Breaks if the shipped variant demands more than the available force, or increases the error."""
    recording = drive(CASES["pid planned"])
    off, fast = off_profile(recording, "crh380a_funnel:short")
    assert 5.0 < np.abs(off).max() < 13.0
    assert np.abs(fast).max() < 1.0
    assert np.abs(position_error(recording)).max() < 0.05


def test_trains_are_variants_of_the_short_run() -> None:
    """Breaks if a mismatch of the plant is also in the model of the law."""
    nominal = prepare(*load_scenario("crh380a_funnel:short"))
    for train in ("half_more", "later", "lagging", "light"):
        setup = prepare(*load_scenario(f"crh380a_funnel:short{TRAINS[train][1]}"))
        assert setup.model.inertia == nominal.model.inertia
        assert setup.model.lag == nominal.model.lag
        assert list(setup.model.delay) == list(nominal.model.delay)
        assert setup.plant != nominal.plant or setup.links != nominal.links
