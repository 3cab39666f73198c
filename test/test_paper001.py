"""Judges of paper 001: the verdict changes with the figure; the whole reproduction of the paper."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reproduce_results import claim, result, series

from train_ato.cli.main import main
from train_ato.papers.claims import Result, Verdict
from train_ato.papers.p001_metro.cases import CASES, INERTIA, TRAINS
from train_ato.papers.p001_metro.checks import shaking
from train_ato.papers.p001_metro.claims import PAPER
from train_ato.papers.p001_metro.figures import truth_and_estimate

GOOD, ELSEWHERE, BAD = Verdict.REPRODUCED, Verdict.OTHER_SETTING, Verdict.NOT_REPRODUCED


def ms(rms: float, largest: float = 0.05, **more: Any) -> Result:
    """Return a run with these errors in m/s."""
    return result(speed_rmse_kmh=3.6 * rms, speed_error_max_kmh=3.6 * largest, **more)


def shaken(rms: float, variation: float) -> Result:
    """Return a run with an error in m/s and a variation in m/s² per s."""
    return ms(rms, command_variation_kn_per_s=variation * INERTIA / 1e3)


def chatter(sign: tuple[float, float], rbf: tuple[float, float]) -> dict[str, Result]:
    runs = {
        f"ideal {key}{tick}": shaken(*pair) for key, pair in (("sign", sign), ("rbf", rbf)) for tick in ("", " 10 ms")
    }
    return runs | {"ideal tanh": shaken(*rbf)}


def drifted(metres: float, failure: str | None = None) -> dict[str, Result]:
    run = result(position_error_max_m=metres)
    keys = ("ideal literal", "ideal literal disturbed", "literal nominal")
    return {key: Result(run.summary, None, failure) for key in keys}


def swept(worst: float) -> dict[str, Result]:
    keys = ("sweep 0.2", "sweep 0.5", "sweep 0.75", "tanh_predictor disturbed", "rbf long_delay")
    return {key: ms(0.02) for key in keys} | {"tanh_predictor long_delay": ms(worst)}


def swinging(rms: float) -> dict[str, Result]:
    wave = rms * 2**0.5 * np.sin(2 * np.pi * 0.05 * np.arange(9000) / 3.2)
    return {"sign nominal": Result(ms(rms).summary, series(wave, np.zeros(9000))), "ideal sign": ms(0.02)}


def rejected(pid: float, known: float, rbf: float) -> dict[str, Result]:
    runs = {"pid disturbed": ms(pid), "pid_preview disturbed": ms(known), "rbf disturbed": ms(rbf)}
    return runs | {"ideal pid disturbed": ms(pid), "ideal rbf disturbed": ms(rbf)}


def delayed(none: float, pade: float) -> dict[str, Result]:
    return {"rbf none": ms(none), "rbf pade": ms(pade), "rbf nominal": ms(0.002), "rbf_predictor nominal": ms(0.001)}


def used(rbf: float, tanh: float) -> dict[str, Result]:
    keys = ("rbf disturbed", "tanh disturbed", "pid_preview disturbed", "rbf slower", "tanh slower")
    runs = {key: ms(0.03) for key in keys}
    return runs | {"rbf_predictor disturbed": ms(rbf), "tanh_predictor disturbed": ms(tanh)}


def stopped(place: float | None, overspeed: float) -> dict[str, Result]:
    keys = ("tanh_predictor nominal", "tanh_predictor disturbed")
    return {key: result(stop_error_m=place, overspeed_max_kmh=overspeed) for key in keys}


FLIPS: list[tuple[str, Callable[[], dict[str, Result]], Verdict]] = [
    ("the network removes the chattering", lambda: chatter((0.02, 20.0), (0.001, 0.02)), GOOD),
    ("the network removes the chattering", lambda: chatter((0.02, 20.0), (0.001, 0.3)), BAD),
    ("the network removes the chattering", lambda: chatter((0.02, 20.0), (0.03, 0.02)), BAD),
    ("corrected network", lambda: {"ideal rbf": ms(0.0021), "ideal rbf 10 ms": ms(0.0007)}, GOOD),
    ("corrected network", lambda: {"ideal rbf": ms(0.0023), "ideal rbf 10 ms": ms(0.0007)}, BAD),
    ("corrected network", lambda: {"ideal rbf": ms(0.0021), "ideal rbf 10 ms": ms(0.0009)}, BAD),
    ("rejects disturbances", lambda: rejected(0.08, 0.04, 0.03), GOOD),
    ("rejects disturbances", lambda: rejected(0.08, 0.03, 0.04), BAD),
    ("the compensation of the delay", lambda: delayed(0.05, 0.01), GOOD),
    ("the compensation of the delay", lambda: delayed(0.05, 0.03), BAD),
    ("the sliding mode (9)", lambda: swinging(0.04), GOOD),
    ("the sliding mode (9)", lambda: swinging(0.3), ELSEWHERE),
    ("the networks learn", lambda: drifted(4.0), GOOD),
    ("the networks learn", lambda: drifted(20.0), BAD),
    ("the networks learn", lambda: drifted(float("nan")), BAD),
    ("the networks learn", lambda: drifted(1.0, "plant: speed beyond measure"), BAD),
    ("with lag and delay the network", lambda: used(0.01, 0.02), GOOD),
    ("with lag and delay the network", lambda: used(0.02, 0.02), BAD),
    ("goal: disturbed, predictor", lambda: {"tanh_predictor disturbed": ms(0.029, 0.129)}, GOOD),
    ("goal: disturbed, predictor", lambda: {"tanh_predictor disturbed": ms(0.031, 0.1)}, BAD),
    ("goal: disturbed, predictor", lambda: {"tanh_predictor disturbed": ms(0.02, 0.131)}, BAD),
    ("goal: disturbed, rbf", lambda: {"rbf disturbed": ms(0.044)}, GOOD),
    ("goal: disturbed, rbf", lambda: {"rbf disturbed": ms(0.046)}, BAD),
    ("goal: nominal", lambda: {"tanh_predictor nominal": ms(0.0029)}, GOOD),
    ("goal: nominal", lambda: {"tanh_predictor nominal": ms(0.0031)}, BAD),
    ("goal: delays", lambda: swept(0.049), GOOD),
    ("goal: delays", lambda: swept(0.051), BAD),
    ("goal: stop", lambda: stopped(0.049, 0.4), GOOD),
    ("goal: stop", lambda: stopped(-0.051, 0.4), BAD),
    ("goal: stop", lambda: stopped(0.01, 0.6), BAD),
    ("goal: stop", lambda: stopped(None, 0.1), BAD),
]


@pytest.mark.parametrize(("text", "runs", "verdict"), FLIPS)
def test_a_verdict_follows_its_figure(text: str, runs: Callable[[], dict[str, Result]], verdict: Verdict) -> None:
    """Breaks if a judge returns the expected verdict instead of the measured one."""
    entry = claim(PAPER, text)
    results = runs()
    assert set(entry.cases) <= set(results)
    assert entry.judge(results).verdict is verdict


def test_relay_period_is_measured() -> None:
    """An oscillation of 3.2 s is reported; breaks if crossings are miscounted."""
    judgement = claim(PAPER, "the sliding mode (9)").judge(swinging(0.3))
    assert "period 3.2 s" in judgement.measured


def test_variation_is_per_inertial_mass() -> None:
    """192.17 kN/s on 192.17 t is 1 m/s² per s."""
    assert shaking(result(command_variation_kn_per_s=192.17)) == pytest.approx(1.0)


def test_truth_of_the_disturbance_is_what_the_model_leaves() -> None:
    """The running resistance alone at 20 m/s (72 km/h) gives an error of 0; 0.1 m/s² more gives 0.1."""
    resistance = (0.11 + 0.0029 * 72 + 0.00013 * 72**2) * 9.8e-3 * 181_292.5
    run = series(np.zeros(200), np.full(200, resistance - 0.1 * INERTIA))
    _, truth, found = truth_and_estimate(Result({}, run))
    np.testing.assert_allclose(truth, 0.1, atol=1e-9)
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_every_row_of_the_table_is_run() -> None:
    """Breaks if a row of the table loses its law or its train."""
    for law in ("pid", "pid_preview", "rbf", "tanh_predictor"):
        for train, (_, variant) in TRAINS.items():
            assert CASES[f"{law} {train}"].scenario == f"xuzhou_metro{variant}"
    for train in set(TRAINS) - {"nominal"}:
        assert CASES[f"tanh_predictor {train}"].changes["observer"] == "eso"


@pytest.mark.slow
def test_the_whole_paper_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if JSON output, folder or figures of paper 001 are missing."""
    folder = tmp_path / "out"
    assert main(["reproduce", "001", "--json", "--out", str(folder)]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows == json.loads((folder / "reproduce.json").read_text())
    assert [row["claim"] for row in rows] == [entry.text for entry in PAPER.claims]
    verdicts = {row["claim"]: row["verdict"] for row in rows}
    goals = {text: verdict for text, verdict in verdicts.items() if text.startswith("goal")}
    assert len(goals) == 5 and set(goals.values()) == {"reproduced"}
    assert verdicts["the networks learn by (11)-(14) as printed"] == "not reproduced"
    pictures = sorted(folder.glob("*.png"))
    assert len(pictures) == 5 and min(path.stat().st_size for path in pictures) > 20_000
    assert "RBF corrected" in (folder / "paper001.txt").read_text()
