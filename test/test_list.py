"""Commands list and compare."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from case_costs import sampled

import train_ato as ta
from plant_sim.library import consist_path, line_path
from train_ato.api.compare import compare
from train_ato.cli import main
from train_ato.cli.list import catalogue
from train_ato.scenario.scenario import shipped_following, shipped_scenarios

NAMES = sorted({name for entries in catalogue().values() for name in entries})


def listed(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict[str, str]]:
    assert main(["list", "--json", *arguments]) == 0
    return dict(json.loads(capsys.readouterr().out))


def test_every_name_has_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    found = listed(capsys)
    assert list(found) == [
        "scenarios", "following", "laws", "observers", "compensations", "consists", "lines", "expected",
    ]  # fmt: skip
    assert all(summary and "\n" not in summary for entries in found.values() for summary in entries.values())
    assert main(["list"]) == 0
    table = capsys.readouterr().out
    assert re.search(r"crh380a_gpc:light +failed +train mass", table)
    assert [name for name in NAMES if name not in table] == []


@pytest.mark.parametrize("name", sampled(NAMES, every=3))
def test_every_listed_name_has_details(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for title, facts in listed(capsys, name).items():
        assert title.endswith(f" {name}") and facts["summary"]


def test_figures_of_a_train_a_line_and_a_law(capsys: pytest.CaptureFixture[str]) -> None:
    """Values by hand of test_plan_checks.py and test_plant_library.py; a parameter with its unit; a law of 004."""
    train = listed(capsys, "hxd1_c80_105")["consist hxd1_c80_105"]
    assert train["balancing speed"].startswith("110 km/h at 0 per mille, 80 km/h at 2 per mille")
    assert train["steepest starting grade"] == "6.3 per mille"
    line = listed(capsys, "daqin_section")["line daqin_section"]
    assert line["grades"] == "-11.2 ... 2 per mille" and line["extent"] == "from km 0 to km 52"
    assert listed(capsys, "pid")["law pid"]["filter_time"].startswith("0.0 s (0 ... 60): time constant")
    assert list(listed(capsys, "none")) == ["observer none", "compensation none"]
    assert listed(capsys, "daqin_heavy_haul:ideal")["scenario daqin_heavy_haul:ideal"]["compensation"] == "none"
    facts = listed(capsys, "crh380a_gpc")["scenario crh380a_gpc"]
    assert (facts["law"], facts["compensation"]) == ("gpc", "preview")


@pytest.mark.parametrize(
    ("path", "name"),
    [
        (consist_path("hxd1_c80_105"), "hxd1_c80_105"),
        (line_path("daqin_section"), "daqin_section"),
        (shipped_scenarios()["crh380a_gpc"], "crh380a_gpc"),
        (shipped_following()["following"], "following"),
    ],
)
def test_a_file_has_the_details_of_its_name(path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a file of a scenario, a consist or a line is refused, or shown differently from its name."""
    (file,) = listed(capsys, str(path)).values()
    (named,) = listed(capsys, name).values()
    assert {key: value for key, value in file.items() if not key.startswith(str(path))} == {
        key: value for key, value in named.items() if not key.startswith(f"{name}:")
    }


def compared(folder: Path, *options: str) -> int:
    short = ["--set=duration=3", "--set=supervision.enabled=false"]
    return main(["compare", *options, *short, f"--out={folder / 'compared'}"])


def test_a_leaderboard_counts_the_laws_over_scenarios_and_seeds(tmp_path: Path, capsys) -> None:
    """Breaks if a run is counted twice or for another law, a seed is repeated, or a refused law has a run."""
    words = ["--laws=pid,lag_smc", "--seeds=2", "--seed=4", "--set=plant.lag=0.4", "--set=model.lag=0"]
    folder = tmp_path / "compared"
    compared(tmp_path, "demo", "xuzhou_metro:ideal", *words)
    told = json.loads((folder / "summary.json").read_text())
    cells = [(row["scenario"], row["seed"], row["controller"]) for rows in told["runs"] for row in rows]
    assert sorted(set(cells)) == sorted(cells) and len(cells) == 8
    assert {cell[:2] for cell in cells} == {(name, seed) for name in ("demo", "xuzhou_metro:ideal") for seed in (4, 5)}
    for law in told["laws"]:
        own = [row for rows in told["runs"] for row in rows if row["controller"] == law["law"]]
        driven = [row for row in own if row["status"] != "refused"]
        assert (law["runs"], law["refused"]) == (len(driven), len(own) - len(driven))
        assert law["passed"] == sum(row.get("verdict") == "passed" for row in driven)
    assert sum(law["first"] for law in told["laws"]) == 4
    assert (folder / "leaderboard.md").read_text().count("\n| ") >= 3 and "leaderboard" in capsys.readouterr().out
    assert main(["compare", "demo", "--seeds=0"]) == 2 and main(["compare", "demo", "--seeds=2", "--keep"]) == 2


def test_ctrl_c_keeps_the_finished_comparisons(tmp_path, monkeypatch, capsys) -> None:
    """Breaks if Ctrl-C in the third of four comparisons loses the first two."""
    done: list[ta.Comparison] = []

    def pressed(*arguments: Any, **options: Any) -> ta.Comparison:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(compare(*arguments, **options))
        return done[-1]

    monkeypatch.setattr("train_ato.api.compare.compare", pressed)
    assert compared(tmp_path, "demo", "--laws=pid", "--seeds=4") == 1
    assert "interrupted after 2 of 4 comparisons, in " in capsys.readouterr().err
    told = json.loads((tmp_path / "compared" / "summary.json").read_text())
    assert [row["seed"] for rows in told["runs"] for row in rows] == [1, 2] and told["laws"][0]["runs"] == 2
    assert "ended after 2 of 4 comparisons" in (tmp_path / "compared" / "leaderboard.md").read_text()


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
    assert "refused: lag_smc: with compensation 'twin'" in shown.out and " overspeed " in shown.out
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
