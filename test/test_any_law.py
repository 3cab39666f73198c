"""Page of every law on every nominal scenario: its definition of nominal, its measurement, and its cells."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from msgs_docs.generate import any_law_page as table
from msgs_docs.generate.__main__ import main
from msgs_docs.generate.rows import read_rows
from train_ato.control.gains import PRINTED
from train_ato.control.registry import LAWS
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[1]
ROWS = read_rows(ROOT / table.MEASURED)


@pytest.mark.parametrize(
    ("name", "nominal"),
    [
        ("demo", True),
        ("crh380a_funnel:planned_ahead", True),
        ("crh380a_gpc:strong", True),
        ("crh380a_funnel:saturated", False),
        ("crh380a_funnel:delay_half_more", False),
        ("crh380a_funnel:lagging", False),
        ("crh380a_funnel:light", False),
        ("crh380a_funnel:noise", False),
        ("crh380a_funnel:replanned", False),
        ("crh380a_gpc:jump", False),
        ("xuzhou_metro:slower", False),
        ("freight_consensus:realistic", False),
    ],
)
def test_nominal_is_a_plant_as_modelled_with_the_force_of_its_profile(name: str, nominal: bool) -> None:
    """Breaks if a disturbance, noise, another mass, delay or lag, or a lack of force counts as nominal."""
    assert table.is_nominal(name) is nominal


def test_a_variant_that_gives_only_gains_has_no_rows() -> None:
    """Breaks if the same eight runs are made twice, or a variant that changes the train is left out."""
    names = table.shipped_names()
    assert "demo" in names and "daqin_heavy_haul:ideal" in names
    assert not [name for name in names if name.endswith(":tuned")]


def test_one_scenario_is_measured_and_the_other_rows_remain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a measurement of one scenario loses others, keeps its old rows or those of a former scenario."""
    monkeypatch.setattr(LAWS, "names", lambda: ["pid"])
    path = tmp_path / table.MEASURED
    path.parent.mkdir()
    kept = {"scenario": "xuzhou_metro:ideal", "law": "pid", "gains": "fitted", "outcome": "lost"}
    path.write_text(json.dumps([kept, {**kept, "scenario": "former"}, {**kept, "scenario": "demo"}]))
    table.measure_any_law(tmp_path, ["demo"])
    rows = json.loads(path.read_text())
    assert [(row["scenario"], row["gains"]) for row in rows] == [
        ("demo", "fitted"), ("demo", "printed"), ("xuzhou_metro:ideal", "fitted"),
    ]  # fmt: skip
    assert rows[0]["outcome"] == "tracked" and rows[2] == kept


@pytest.mark.parametrize("name", ["any_law:xuzhou_metro:slower", "any_law:dema", "faults:demo"])
def test_a_scenario_without_rows_is_refused(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a wrong name is measured as nothing and the page counts as new."""
    with pytest.raises(SystemExit) as stopped:
        main(["--measure", name])
    assert stopped.value.code == 2
    assert f"--measure {name}" in capsys.readouterr().err


def test_the_page_has_every_cell_and_a_reason_for_every_miss() -> None:
    """Breaks if a law has no row, more than five cells are not met, one has no reason, or a reason has no cell."""
    names = [name for name in table.shipped_names() if name in {row["scenario"] for row in ROWS}]
    default = [(row["scenario"], row["law"]) for row in ROWS if row["gains"] != PRINTED]
    assert default == [(name, law) for name in names for law in LAWS.names()]
    missed = [(row["scenario"], row["law"]) for row in table.not_met(ROWS)]
    assert len(missed) <= 5
    assert sorted(missed) == sorted(table.REASONS)
    assert all(row["choice"] != "nearest choice: " for row in ROWS if row["outcome"] == "refused")


def test_the_leaderboard_counts_every_run_once(tmp_path: Path) -> None:
    """Breaks if a run is lost or counted as passed that misses a criterion, or a scenario has two first laws."""
    kept = {"scenario": "demo", "gains": "fitted", "outcome": "tracked", "stop_error_max_m": -0.2}
    rows = [
        {**kept, "law": "pid", "speed_rmse_kmh": 0.2},
        {**kept, "law": "smc", "speed_rmse_kmh": 0.1, "missed": {"jerk": 1.0}},
        {**kept, "law": "gpc", "speed_rmse_kmh": 0.1, "outcome": "limit cycle"},
        {**kept, "law": "mpc", "outcome": "refused"},
        {**kept, "law": "pid", "speed_rmse_kmh": 0.4, "scenario": "xuzhou_metro"},
    ]
    path = tmp_path / table.MEASURED
    path.parent.mkdir()
    path.write_text(json.dumps(rows))
    board = table.page(tmp_path).partition("## Leaderboard")[2].partition("\n\nDefault gains")[0].splitlines()[-4:]
    assert board == [
        "| pid | 2 | 2 | 2 | 0 | 2 | 1 | 0.3 | 0.2 |",
        "| smc | 0 | 1 | 1 | 0 | 0 | 2 | 0.1 | 0.2 |",
        "| gpc | 0 | 0 | 1 | 0 | 0 | 3 | - | - |",
        "| mpc | 0 | 0 | 0 | 1 | 0 | - | - | - |",
    ]


@pytest.mark.campaign
def test_the_page_has_the_nominal_scenarios_that_are_shipped_and_the_gains_of_their_runs() -> None:
    """Breaks if a new nominal scenario has no rows, or a row says `fitted` for gains of the rule."""
    assert list(dict.fromkeys(row["scenario"] for row in ROWS)) == table.nominal_names()
    setups = {name: prepare(*load_scenario(name)) for name in table.nominal_names()}
    for row in ROWS:
        if "source" in row:
            setup, law = setups[row["scenario"]], row["law"]
            given = {
                **setup.controller_parameters.get(law, {}),
                **({"gains": PRINTED} if row["gains"] == PRINTED else {}),
            }
            taken = setup.gains(law, given).source
            assert row["source"] == taken, row
            assert table.gains_text(row) == (taken if row["gains"] else "own")
