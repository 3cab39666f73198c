"""Paper 001: series of the judges; the whole reproduction of the paper."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reproduce_results import claim, result, series

from train_ato.cli.main import main
from train_ato.papers.claims import Result
from train_ato.papers.p001_metro.cases import CASES, INERTIA, TRAINS
from train_ato.papers.p001_metro.checks import shaking
from train_ato.papers.p001_metro.claims import PAPER, truth_and_estimate


def ms(rms: float, largest: float = 0.05, **more: Any) -> Result:
    """Return a run with these errors in m/s."""
    return result(speed_rmse_kmh=3.6 * rms, speed_error_max_kmh=3.6 * largest, **more)


def swinging(rms: float) -> dict[str, Result]:
    wave = rms * 2**0.5 * np.sin(2 * np.pi * 0.05 * np.arange(9000) / 3.2)
    return {"sign nominal": Result(ms(rms).summary, series(wave, np.zeros(9000))), "ideal sign": ms(0.02)}


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
    for law in ("pid", "pid_preview", "rbf", "tanh_predictor"):
        for train, (_, variant) in TRAINS.items():
            assert CASES[f"{law} {train}"].scenario == f"xuzhou_metro{variant}"
    for train in set(TRAINS) - {"nominal"}:
        assert CASES[f"tanh_predictor {train}"].changes["observer"] == "eso"


@pytest.mark.campaign
def test_the_whole_paper_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if JSON output, folder or figures of paper 001 are missing."""
    folder = tmp_path / "out"
    assert main(["reproduce", "001", "--json", "--out", str(folder)]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows == json.loads((folder / "reproduce.json").read_text())
    assert [row["claim"] for row in rows] == [entry.text for entry in PAPER.claims]
    verdicts = {row["claim"]: row["verdict"] for row in rows}
    goals = {text: verdict for text, verdict in verdicts.items() if text.startswith("goal")}
    assert [text for text, verdict in goals.items() if verdict != "reproduced"] == [
        "goal: stop and limit on every train"
    ]
    assert len(goals) == 5
    assert verdicts["the networks learn by (11)-(14) as printed"] == "not reproduced"
    pictures = sorted(folder.glob("*.png"))
    assert len(pictures) == 5 and min(path.stat().st_size for path in pictures) > 20_000
    assert "RBF corrected" in (folder / "paper001.txt").read_text()
