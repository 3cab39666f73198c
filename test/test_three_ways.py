"""The same scenario and seed give the same numbers bit for bit in the engine, in one process and in several."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from train_ato.cli import main
from train_ato.log.difference import compare_logs
from train_ato.log.run_folder import read_run_folder
from train_ato.messages.codec.codec import Wire

ROUGH = [
    "--set=duration=65",
    "--set=links.command={delay: 0.3, varying: {amplitude: 0.2}, jitter: 0.1, loss: 0.05}",
    "--set=plant.sensors={couplers: [0, 52], position_noise: 0.1, velocity_noise: 0.02, force_noise: 1000}",
    "--set=plant.disturbances=[{kind: eq40}]",
    "--set=law_changes=[{at: 30, law: smc}, {at: 45, law: pid}]",
    "--observer=ndo",
]
"""65 s of the 106-vehicle train with varying delay, jitter, loss, noise, a disturbance and two swaps of the law."""
WALL = ("wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99", "mode")


def drive(folder: Path, name: str, *options: str) -> Path:
    out = folder / name
    assert main(["run", "demo", "--json", f"--out={out}", *options]) == 0
    return out


@pytest.fixture(scope="module")
def engine_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("engine"), "run", "--engine", *ROUGH)


@pytest.mark.parametrize("way", [[], ["--processes"]], ids=["composed", "processes"])
def test_every_message_is_equal_in_all_ways(way: list[str], engine_run: Path, tmp_path: Path) -> None:
    """Breaks if a result depends on the order of arrival, on the process of a random number, or on the encoding."""
    run = drive(tmp_path, "run", *way, *ROUGH)
    setup, summary = read_run_folder(run)
    assert compare_logs(engine_run, run, Wire(setup.layout)).first is None
    of_engine = json.loads((engine_run / "summary.json").read_text())
    assert {k: v for k, v in summary.items() if k not in WALL} == {k: v for k, v in of_engine.items() if k not in WALL}
    assert (run / "scenario.yaml").read_text() == (engine_run / "scenario.yaml").read_text()


def test_another_seed_is_seen(engine_run: Path, tmp_path: Path) -> None:
    """Breaks if the comparison above cannot fail."""
    run = drive(tmp_path, "run", "--engine", *ROUGH, "--seed=2")
    setup, _ = read_run_folder(run)
    found = compare_logs(engine_run, run, Wire(setup.layout))
    assert {"ato/command", "train/vehicles", "train/measurement"} <= set(found.topics)


def test_resolved_scenario_alone_reproduces_the_run(
    engine_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a file named by the scenario is not copied into the run folder."""
    assert main(["verify", str(engine_run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["equal"] is True
