"""Fatigue damage of the couplers of a recorded run: command, ratio to another run, page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rainflow

from train_ato.apps.report.page_data import page_data
from train_ato.apps.runs.coupler_fatigue import CouplerFatigue, relative_fatigue
from train_ato.cli import main
from train_ato.log.recorded import open_recording
from train_ato.loop.recording import TRUTH, Recording

GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train" / "run.mcap"


@pytest.fixture(scope="module")
def recording() -> Recording:
    return open_recording(GOLDEN)


def damage(recording: Recording) -> list[float]:
    """Return the damage of every coupler from all points, without reversals and without a smallest range."""
    found = recording.of(TRUTH, "coupler_force")
    assert found is not None
    columns = found[1][:, :-1].T
    return [sum((size / 1e6) ** 5 * count for size, count in rainflow.count_cycles(force)) for force in columns]


def test_the_command_prints_the_damage_of_a_run(recording: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a coupler is left out, or half cycles count as whole ones."""
    assert main(["info", str(GOLDEN), "--fatigue", str(GOLDEN), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["fatigue"]
    expected = damage(recording)
    # omitted cycles: at most 441 samples of half a cycle below 20 kN in every coupler; figures have 4 decimals
    tolerance = len(expected) * 441 / 2 * 0.02**5 + 1e-4
    assert found["coupler_damage"] == pytest.approx(sum(expected), abs=tolerance)
    assert found["coupler_damage_worst"] == pytest.approx(max(expected), abs=tolerance)
    assert found["ratio"] == 1.0


def test_the_ratio_is_that_of_the_first_run() -> None:
    """Breaks if the ratio is upside down, or divides by a run without damage."""
    runs = [CouplerFatigue(np.array(values), np.zeros(2)) for values in ([0.5, 0.5], [1.5, 0.5], [0.0, 0.0])]
    assert relative_fatigue(runs[0], runs[1])["ratio"] == 0.5
    assert relative_fatigue(runs[0], runs[2])["ratio"] is None


def test_a_page_has_the_damage(recording: Recording) -> None:
    """Breaks if a report omits the damage."""
    assert page_data(recording).summary["coupler_damage"] == pytest.approx(sum(damage(recording)), abs=1e-3)


def test_a_run_without_couplers_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a train of one vehicle gets a damage of 0, or a traceback."""
    run = tmp_path / "run"
    words = ["--engine", "--set=duration=1", f"--out={run}", "--json"]
    assert main(["run", "crh380a_funnel", *words]) == 0
    capsys.readouterr()
    assert main(["info", str(run), "--fatigue"]) == 2
    assert "no coupler forces" in capsys.readouterr().err
