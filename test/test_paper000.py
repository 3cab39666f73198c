"""Judges of paper 000: the verdict changes with the figure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from law_trains import SINGLE, inputs, model
from reproduce_results import claim, result, series

from plant_sim.streams import random_stream
from train_ato.control.laws.rbf_smc import RbfSmcParameters
from train_ato.control.registry import LAWS
from train_ato.papers.claims import Result, Verdict
from train_ato.papers.p000_heavy_haul.cases import CASES, DURATION
from train_ato.papers.p000_heavy_haul.claims import PAPER
from train_ato.papers.p000_heavy_haul.series import LOCOMOTIVE, disturbance_40, network_estimate, unexplained

GOOD, ELSEWHERE, BAD = Verdict.REPRODUCED, Verdict.OTHER_SETTING, Verdict.NOT_REPRODUCED
COUNT = 8000
WAVE = np.sin(0.02 * np.arange(COUNT))
CALM = series(np.zeros(COUNT), np.zeros(COUNT))


def swinging(amplitude_kmh: float) -> Result:
    """Return a run with an oscillating speed error and its figures."""
    run = series(amplitude_kmh / 3.6 * WAVE, np.zeros(COUNT))
    return result(run, speed_rmse_kmh=amplitude_kmh / 2**0.5, speed_error_max_kmh=amplitude_kmh)


def forced(amplitude_kmh: float, sign: float) -> Result:
    """Return a run whose error is the force over 1e7 N/(m/s), with a sign."""
    error = amplitude_kmh / 3.6 * WAVE
    return result(series(error, sign * 1e7 * error), speed_error_max_kmh=amplitude_kmh)


def tracked(rms: float, largest: float = 0.05, **more: Any) -> Result:
    return result(speed_rmse_kmh=rms, speed_error_max_kmh=largest, **more)


def laws(smc: float, smc_ndo: float, rbf: float, rbf_ndo: float, smc_ks: float, rbf_ks: float) -> dict[str, Result]:
    figures = locals()
    return {key: tracked(value) for key, value in figures.items()}


def pulled(high: float, low: float) -> dict[str, Result]:
    keys = ("pid", "smc", "rbf_ndo", "rbf_ndo disturbed")
    return {key: result(coupler_draft_max_kn=high, coupler_buff_max_kn=low) for key in keys}


def delayed(calm: float, lost: float) -> dict[str, Result]:
    return {f"smc delay {t}": swinging(calm if t < 0.08 else lost) for t in (0.05, 0.1, 0.15, 0.2, 0.4)}


def twins(variation: float, noisy: float) -> dict[str, Result]:
    keys = ("nominal", "disturbed", "mismatch", "strong")
    runs = {f"twin_pid {key}": result(command_variation_kn_per_s=variation) for key in keys}
    return runs | {key: result(command_variation_kn_per_s=noisy) for key in ("twin_pid noise", "raw_pid noise")}


def foreseen(nominal: float, strong: float) -> dict[str, Result]:
    figures = {"nominal": nominal, "disturbed": 0.05, "mismatch": 0.1, "strong": strong}
    return {f"predicted {train}": tracked(rms) for train, rms in figures.items()}


def observed(without: float, with_observer: float) -> dict[str, Result]:
    trains = ("nominal", "disturbed", "mismatch", "strong")
    runs = {f"twin_smc {train}": tracked(without) for train in trains}
    return runs | {f"twin_smc_ndo {train}": tracked(with_observer) for train in trains}


FLIPS: list[tuple[str, Callable[[], dict[str, Result]], Verdict]] = [
    ("speed error of RBFNN-SMC", lambda: {"rbf": swinging(0.14), "rbf_ndo": swinging(0.01)}, GOOD),
    ("speed error of RBFNN-SMC", lambda: {"rbf": swinging(0.16), "rbf_ndo": swinging(0.01)}, BAD),
    ("speed error of RBFNN-SMC", lambda: {"rbf": swinging(0.10), "rbf_ndo": swinging(0.2)}, BAD),
    ("speed error of SMC", lambda: {"smc": swinging(0.19)}, GOOD),
    ("speed error of SMC", lambda: {"smc": swinging(0.21)}, BAD),
    ("speed error of PID", lambda: {"pid": forced(0.26, -1.0)}, GOOD),
    ("speed error of PID", lambda: {"pid": forced(0.28, -1.0)}, BAD),
    ("speed error of PID", lambda: {"pid": forced(0.26, 1.0)}, BAD),
    ("RBFNN-SMC tracks best", lambda: laws(0.02, 0, 0.01, 0.005, 0.02, 0.01) | {"pid": tracked(0.1)}, GOOD),
    ("RBFNN-SMC tracks best", lambda: laws(0.01, 0, 0.02, 0.005, 0.02, 0.01) | {"pid": tracked(0.1)}, ELSEWHERE),
    ("RBFNN-SMC tracks best", lambda: laws(0.01, 0, 0.02, 0.05, 0.01, 0.02) | {"pid": tracked(0.1)}, BAD),
    ("RBFNN-SMC with NDO is more accurate than SMC without", lambda: laws(1, 0.7, 1, 0.73, 1, 1), GOOD),
    ("RBFNN-SMC with NDO is more accurate than SMC without", lambda: laws(1, 0.1, 3, 0.1, 1, 0.9), ELSEWHERE),
    ("RBFNN-SMC with NDO is more accurate than SMC without", lambda: laws(1, 1, 3, 1.1, 1, 0.75), ELSEWHERE),
    ("RBFNN-SMC with NDO is more accurate than SMC without", lambda: laws(1, 1, 3, 1.1, 1, 1.1), BAD),
    ("coupler forces stay", lambda: pulled(1900.0, -1900.0), GOOD),
    ("coupler forces stay", lambda: pulled(2100.0, -400.0), BAD),
    ("coupler forces stay", lambda: pulled(400.0, -2100.0), BAD),
    ("the printed law is unstable", lambda: delayed(0.03, 0.3), GOOD),
    ("the printed law is unstable", lambda: delayed(0.03, 0.05), BAD),
    ("the printed law is unstable", lambda: delayed(0.3, 0.3), BAD),
    (
        "goal with lag 0.4 s and delay 0.8 s, twin + PID: nominal",
        lambda: {"twin_pid nominal": tracked(0.019, 0.29)},
        GOOD,
    ),
    (
        "goal with lag 0.4 s and delay 0.8 s, twin + PID: nominal",
        lambda: {"twin_pid nominal": tracked(0.021, 0.1)},
        BAD,
    ),
    (
        "goal with lag 0.4 s and delay 0.8 s, twin + PID: nominal",
        lambda: {"twin_pid nominal": tracked(0.01, 0.31)},
        BAD,
    ),
    (
        "goal with lag 0.4 s and delay 0.8 s, twin + PID: + mismatch",
        lambda: {"twin_pid mismatch": tracked(float("nan"))},
        BAD,
    ),
    ("a printed law works", lambda: foreseen(0.015, 20.0), GOOD),
    ("a printed law works", lambda: foreseen(0.015, 0.2), ELSEWHERE),
    ("a printed law works", lambda: foreseen(0.03, 0.2), BAD),
    ("a printed law works", lambda: foreseen(0.015, 0.1), BAD),
    ("goal: command variation", lambda: twins(14.0, 99.0), GOOD),
    ("goal: command variation", lambda: twins(16.0, 99.0), BAD),
    ("goal: command variation", lambda: twins(14.0, 101.0), BAD),
    ("with lag and delay the NDO", lambda: observed(0.05, 0.04), GOOD),
    ("with lag and delay the NDO", lambda: observed(0.04, 0.05), BAD),
    (
        "the network improves SMC",
        lambda: {"smc": tracked(2.0), "rbf": tracked(1.0), "smc exact": tracked(1.0), "rbf exact": tracked(2.0)},
        GOOD,
    ),
    (
        "the network improves SMC",
        lambda: {"smc": tracked(1.0), "rbf": tracked(2.0), "smc exact": tracked(2.0), "rbf exact": tracked(1.0)},
        ELSEWHERE,
    ),
]


@pytest.mark.parametrize(("text", "runs", "verdict"), FLIPS)
def test_a_verdict_follows_its_figure(text: str, runs: Callable[[], dict[str, Result]], verdict: Verdict) -> None:
    """Breaks if a judge returns the expected verdict instead of the measured one."""
    entry = claim(PAPER, text)
    results = runs()
    assert set(entry.cases) <= set(results)
    assert entry.judge(results).verdict is verdict


def test_unchanged_rmse_is_judged_against_smc() -> None:
    """Breaks if a disturbance with an equal effect on the observed law and on SMC passes."""
    judge = claim(PAPER, "RMSE with NDO unchanged").judge

    def runs(rough: float) -> dict[str, Result]:
        figures = {"rbf_ndo": 0.0005, "rbf_ndo disturbed": rough, "smc": 0.009, "smc disturbed": 0.011}
        return {key: tracked(value) for key, value in figures.items()}

    assert judge(runs(0.001)).verdict is GOOD
    assert judge(runs(0.0029)).verdict is BAD


@pytest.mark.parametrize("clip", [False, True])
def test_network_estimate_is_the_law_s_own(clip: bool) -> None:
    """Breaks if the series drawn as delta_hat is not what `rbf_smc` adds to its force."""
    period, train = 0.05, model(SINGLE)
    learning = LAWS.make("rbf_smc", {"clip": clip}, train, period)
    plain = LAWS.make("smc", {}, train, period)
    random = random_stream(3, "test/network")
    errors, rates = 0.02 * random.standard_normal(40), 0.008 * random.standard_normal(40)
    added = []
    for error, rate in zip(errors, rates, strict=True):
        seen = inputs(train, position=np.array([500.0 + error]), velocity=np.array([10.0 + rate]))
        added.append(float((plain.step(seen).force - learning.step(seen).force)[0]) / train.mass)
    run = series(rates, np.zeros(40), period)
    run.front_position[:] = run.reference_position + errors
    found = network_estimate(run, RbfSmcParameters(clip=clip), period)
    assert np.abs(found).max() > 1e-6
    np.testing.assert_allclose(found, added, rtol=1e-4, atol=1e-9)


def test_unexplained_motion_is_the_model_error_and_the_disturbance() -> None:
    """A locomotive pulled back by 2 m/s² with f_hat = f/1.01: delta = -0.0198; breaks with a wrong sign or share."""
    period, count = 0.05, 200
    time = period * np.arange(count)
    sigma = 0.002 + 0.001 * np.sin(time + period / 2 + 1)
    sigma += 0.0003 * 20.0 * (np.sin(2 * (time + period / 2) + 2) + np.cos(3 * (time + period / 2) + 1))
    still = series(np.zeros(count), LOCOMOTIVE * (2.0 - sigma), period)
    np.testing.assert_allclose(disturbance_40(still, period), sigma, atol=1e-12)
    found = unexplained(still, period, 0.01, disturbance_40(still, period))
    np.testing.assert_allclose(found[:-1], -2.0 * 0.01 / 1.01 + sigma[:-1], atol=1e-9)


def test_both_tables_are_run() -> None:
    """Breaks if a row or a column of the two tables is not run over the whole run."""
    ideal = ("pid", "smc", "rbf", "rbf_ndo", "smc_ks", "rbf_ks", "rbf_ks_ndo")
    lagged = ("twin_pid", "twin_smc_ndo", "predicted")
    wanted = [f"{law}{suffix}" for law in ideal for suffix in ("", " disturbed")]
    wanted += [f"{law} {train}" for law in lagged for train in ("nominal", "disturbed", "mismatch", "strong")]
    for key in wanted:
        case = CASES[key]
        assert case.changes["duration"] == DURATION, key
        assert case.changes.get("tick", 0.05) == (0.01 if key.startswith("pid") else 0.05), key
        assert ("+disturbed" in case.scenario) == (not key.endswith("nominal") and key not in ideal), key
