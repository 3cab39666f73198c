"""``train-ato plan``: inputs in several formats, files out, bad input in one line."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest

from plant_sim.library import load_consist, load_line
from train_ato.cli.plan import add_arguments, execute, plan_from_options
from train_ato.profile.file import read_profile
from train_ato.profile.planner.planner import plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.scenario.profile_spec import ProfileSpec


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    parser.add_argument("--json", action="store_true")  # train_ato.cli.main adds it to every command
    return parser.parse_args(words)


METRO = ("xuzhou_metro_test", "xuzhou_metro_3")


def test_json_has_the_promised_figures(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(options(*METRO, "--from-km", "0.5", "--to-km", "3", "--json")) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["distance_m"] == 2500.0
    assert 125 < result["running_time_s"] < 150 and 5 < result["energy_kwh"] < 40
    assert result["speed_max_kmh"] == pytest.approx(80, abs=0.1)


def test_the_table_names_them_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(options(*METRO, "--to-km", "1")) == 0
    assert "running_time_s" in capsys.readouterr().out


def test_files_hold_the_profile_and_a_figure(tmp_path: Path) -> None:
    names = [tmp_path / name for name in ("run.csv", "run.yaml", "run.png")]
    result = plan_from_options(
        options(*METRO, "--to-km", "2", *(word for name in names for word in ("--out", str(name))))
    )
    first, second = read_profile(names[0]), read_profile(names[1])
    assert first == second
    assert first.position[-1] + 59 == pytest.approx(2000)
    assert names[2].read_bytes()[:4] == b"\x89PNG" and names[2].stat().st_size > 20_000
    assert result["files"] == [str(name) for name in names]


def test_options_reach_the_plan() -> None:
    slow = plan_from_options(options(*METRO, "--to-km", "2", "--time", "150"))
    assert slow["running_time_s"] == pytest.approx(150, abs=0.1)
    free = plan_from_options(
        options(*METRO, "--to-km", "2", "--jerk", "none", "--force-margin", "0", "--acceleration", "none")
    )
    usual = plan_from_options(options(*METRO, "--to-km", "2"))
    assert free["running_time_s"] < usual["running_time_s"] < slow["running_time_s"]
    capped = plan_from_options(options(*METRO, "--to-km", "2", "--max-speed-kmh", "50"))
    assert capped["speed_max_kmh"] == pytest.approx(50, abs=0.1)


def test_foreign_lines_and_trains_are_read(open_data: Path) -> None:
    path = str(open_data / "limit.json")
    result = plan_from_options(options(path, str(open_data / "longdistance.yaml")))
    assert result["distance_m"] == 48531.0 and result["settings"]["deceleration"] == 0.375
    assert plan_from_options(options(path, "crh380a_one_mass"))["speed_max_kmh"] == pytest.approx(140, abs=0.1)


def test_a_scenario_can_ask_for_a_plan() -> None:
    line, consist = load_line(METRO[0]), load_consist(METRO[1])
    block = ProfileSpec.model_validate({"plan": {"end_km": 2, "force_margin": 0.2}})
    profile = block.build(consist, line, 0.05)
    assert profile == plan_profile(line, consist, PlanSettings(end=2000, force_margin=0.2), 0.05).profile
    assert ProfileSpec.model_validate(block.inlined()) == block
