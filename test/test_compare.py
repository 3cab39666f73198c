"""`train-ato compare`: gains of a law, status of every law, output for people and programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import train_ato as ta
from train_ato.cli import main

SHORT = ["--set=duration=3", "--set=supervision.enabled=false"]


def compared(folder: Path, *options: str) -> int:
    return main(["compare", *options, *SHORT, f"--out={folder / 'compared'}"])


def test_gains_of_every_law_have_their_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if printed gains run in silence, fitted ones have a note, or `laws: {}` counts as a choice of gains."""
    options = ["--set=laws.smc.gains=printed", "--set=laws.lag_smc.c1=0.4", "--set=duration=5", "--engine"]
    assert compared(tmp_path, "demo", "--laws=pid,smc,lag_smc,mpc", *options) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if "gains" in line]
    assert len(notes) == 1 and notes[0].startswith("train-ato: smc: printed gains, not made for this train; try ")
    rows = {row["controller"]: row for row in json.loads((tmp_path / "compared" / "summary.json").read_text())}
    assert {law: row["gains"] for law, row in rows.items()} == {
        "pid": "fitted", "smc": "printed", "lag_smc": "fitted", "mpc": "model",
    }  # fmt: skip
    assert "c1 given" in rows["lag_smc"]["gains_reason"]


def test_a_refused_law_has_a_row_and_the_others_are_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a refused law stops the comparison, ends with status 0, or is missing in the table or the JSON."""
    laws = ["demo", "--laws=lag_smc,pid", "--compensation=twin"]
    assert compared(tmp_path / "a", *laws) == 1
    shown = capsys.readouterr()
    assert "refused: lag_smc: with compensation 'twin'" in shown.out
    assert "train-ato: lag_smc: with compensation 'twin'" in shown.err
    assert compared(tmp_path / "b", *laws, "--json") == 1
    rows = json.loads(capsys.readouterr().out)
    assert [(row["controller"], row["status"]) for row in rows] == [("pid", "done"), ("lag_smc", "refused")]
    assert "twin" in rows[1]["reason"] and rows[0]["speed_rmse_kmh"] >= 0


def test_every_law_starts_at_the_begin_of_the_profile() -> None:
    """Breaks if a law after the first one starts at position 0, 38 m behind its reference."""
    both = ta.compare("crh380a_gpc:short", ["pid", "smc"], set={"duration": 4})
    for law, error in both.table["position_error_max_m"].items():
        assert error == ta.run("crh380a_gpc:short", law=law, set={"duration": 4}).metrics["position_error_max_m"]
