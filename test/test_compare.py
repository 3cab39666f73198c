"""`train-ato compare`: gains of a law, status of every law, output for people and programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

import train_ato as ta
from train_ato.cli import main
from train_ato.scenario.scenario import raw_scenario, shipped_scenarios, variants_of

SHORT = ["--set=duration=3", "--set=supervision.enabled=false"]


def compared(folder: Path, *options: str) -> int:
    return main(["compare", *options, *SHORT, f"--out={folder / 'compared'}"])


def test_default_gains_are_named_with_the_variant_that_has_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a law runs with gains of another train in silence, or a chosen gain is called a default."""
    assert compared(tmp_path, "daqin_heavy_haul", "--laws=pid,smc,fixed_time_smc", "--engine") == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if line.startswith("train-ato: ")]
    assert notes == [
        "train-ato: fixed_time_smc, smc: default gains, not chosen for this train; set laws.NAME.* before a comparison",
        "train-ato: fixed_time_smc: gains for this train are in daqin_heavy_haul:tuned",
        "train-ato: smc: gains for this train are in daqin_heavy_haul:tuned",
    ]
    rows = {row["controller"]: row for row in json.loads((tmp_path / "compared" / "summary.json").read_text())}
    assert {law: row["gains"] for law, row in rows.items()} == {
        "pid": "chosen", "smc": "default", "fixed_time_smc": "default",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("scenario", "options"), [("daqin_heavy_haul:tuned", []), ("daqin_heavy_haul", ["--set=laws.smc.ks=0"])]
)
def test_chosen_gains_have_no_note(
    scenario: str, options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if gains of the scenario or of an option are called defaults."""
    assert compared(tmp_path, scenario, "--laws=pid,smc", *options) == 0
    assert "gains" not in capsys.readouterr().err


def test_a_refused_law_has_a_row_and_the_others_are_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a refused law stops the comparison, ends with status 0, or is missing in the table or the JSON."""
    laws = ["demo", "--laws=smc,pid", "--compensation=twin"]
    assert compared(tmp_path / "a", *laws) == 1
    shown = capsys.readouterr()
    assert "refused: smc: with compensation 'twin'" in shown.out
    assert "train-ato: smc: with compensation 'twin'" in shown.err
    assert compared(tmp_path / "b", *laws, "--json") == 1
    rows = json.loads(capsys.readouterr().out)
    assert [(row["controller"], row["status"]) for row in rows] == [("pid", "done"), ("smc", "refused")]
    assert "twin" in rows[1]["reason"] and rows[0]["speed_rmse_kmh"] >= 0


def test_gains_of_an_object_are_chosen() -> None:
    """Breaks if the parameters of a law object are called defaults in the table."""
    from train_ato.control.laws.pid import Pid

    changes = {"duration": 2, "supervision.enabled": False}
    assert ta.compare("crh380a_funnel", [Pid, "smc"], set=changes).table["gains"].tolist() == ["chosen", "default"]


def test_every_law_starts_at_the_begin_of_the_profile() -> None:
    """Breaks if a law after the first one starts at position 0, 38 m behind its reference."""
    both = ta.compare("crh380a_gpc:short", ["pid", "smc"], set={"duration": 4})
    for law, error in both.table["position_error_max_m"].items():
        assert error == ta.run("crh380a_gpc:short", law=law, set={"duration": 4}).metrics["position_error_max_m"]


TUNED = [name for name, path in shipped_scenarios().items() if "tuned" in variants_of(path)]


@pytest.mark.parametrize("stem", [name for name in TUNED if name != "daqin_heavy_haul"])
def test_the_tuned_variant_has_no_gains_of_another_train(stem: str) -> None:
    """Breaks if a scenario with a base inherits tuned gains of the train of its base."""
    file = yaml.safe_load(shipped_scenarios()[stem].read_text())
    own = file["variants"]["tuned"]["laws"]
    shipped, variant = raw_scenario(stem)[1].get("laws") or {}, raw_scenario(f"{stem}:tuned")[1]["laws"]
    expected = {law: {**shipped.get(law, {}), **gains} for law, gains in own.items() if gains is not None}
    assert variant == {**shipped, **expected}


def test_a_comparison_of_the_tuned_variant_has_chosen_gains(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if `compare NAME:tuned` marks tuned gains as default."""
    assert compared(tmp_path, "crh380a_gpc:tuned", "--laws=pid,gpc", "--json") == 0
    assert [row["gains"] for row in json.loads(capsys.readouterr().out)] == ["chosen", "chosen"]
