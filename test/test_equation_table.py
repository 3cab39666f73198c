"""Tables of the equations and of the open choices of the papers agree with the code."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from msgs_docs.generate import left_out_page
from msgs_docs.generate.equation_page import EQUATION_TABLES, EquationTable, Form, problems, source_line
from msgs_docs.generate.left_out_page import CHOICES, MEASURED, ChoiceRun, ChoiceTable, drive_choice, unmeasured, wanted
from msgs_docs.generate.rows import read_rows
from plant_sim.gears import ClipGear
from plant_sim.library import load_consist
from train_ato.scenario.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[1]
HEAVY_HAUL = EQUATION_TABLES[0]
SMC, HXD1 = "train_ato.control.laws.smc", "plant_sim/data/consists/hxd1_c80_105.yaml"


@pytest.mark.parametrize("table", EQUATION_TABLES, ids=lambda table: table.paper)
def test_every_equation_has_one_row_that_agrees_with_the_code(table: EquationTable) -> None:
    """Breaks if an equation has no row, a function is renamed, or a setting is refused or without effect."""
    assert table.last == {"000": 41, "001": 15, "002": 38, "003": 38, "004": 22}[table.paper], (
        "number of the last equation"
    )
    assert problems(table, ROOT) == []


def broken(number: int, changes: dict[str, Any]) -> list[str]:
    """Return the faults of the table of paper 000 with a changed row; the others have no place and no setting."""
    plain = {"form": Form.NOT_NEEDED, "places": (), "settings": (), "note": "-"}
    rows = tuple(replace(row, **(changes if row.number == number else plain)) for row in HEAVY_HAUL.rows)
    return problems(replace(HEAVY_HAUL, rows=rows), ROOT)


@pytest.mark.parametrize(("number", "changes", "found"), [
    (5, {"number": 6}, ["(5): 0 rows", "(6): 2 rows"]),
    (41, {"number": 42}, ["(41): 0 rows", "(42): no such equation"]),
    (18, {"places": (f"{SMC}:Smc.request",)}, [f"(18): place '{SMC}:Smc.request'"]),
    (18, {"places": ("train_ato.control.laws.slid:Smc",)}, ["(18): place 'train_ato.control.laws.slid:Smc'"]),
    (18, {"places": (f"{SMC}:Smc.uses_feedforward",)}, ["no source"]),
    (1, {"places": (f"{HXD1}:pull:",)}, ["does not contain this text"]),
    (1, {"places": ("plant_sim/data/consists/hxd1.yaml:mass_t",)}, ["no such file"]),
    (18, {"places": ()}, ["(18): no place"]),
    (40, {"form": Form.DEPARTURE, "settings": (), "note": ""}, ["(40): departure without a note"]),
    (21, {"settings": ()}, ["(21): option without settings"]),
    (18, {"settings": ("laws.smc.ks=0",)}, ["(18): literal with settings"]),
    (21, {"settings": ("laws.smc.kss=0",)}, ["smc.kss: no such parameter; did you mean 'ks'?"]),
    (21, {"settings": ("laws.smc.ks=-1",)}, ["smc.ks: -1 is outside 0 ... 100"]),
    (21, {"settings": ("laws.smc.ks=0.5",)}, ["setting 'laws.smc.ks=0.5': is the default"]),
    (21, {"settings": ("plant.lags=0",)}, ["plant.lags"]),
])  # fmt: skip
def test_the_check_finds_a_broken_row(number: int, changes: dict[str, Any], found: list[str]) -> None:
    lines = broken(number, changes)
    assert len(lines) == len(found)
    for line, text in zip(lines, found, strict=True):
        assert text in line


def test_shoes_and_gear_of_paper_000_follow_from_its_tables() -> None:
    """(9), (13)-(15): breaks if a shoe force is not that of cylinder, lever and radii, or the gear changes."""
    vehicles = load_consist("hxd1_c80_105").vehicle_types

    def cylinder(diameter: float, pressure: float, ratio: float, share: float) -> float:
        return math.pi / 4 * diameter**2 * pressure * 0.9 * ratio * share * 1e-3

    pads, shoes = vehicles["hxd1"].shoes, vehicles["c80"].shoes
    assert pads.force == pytest.approx(cylinder(225, 450, 2.4, 16 / 32) * 448 / 1250, rel=2e-3)
    assert shoes.force == pytest.approx(cylinder(254, 430, 6.6, 1 / 8), rel=2e-3)
    (row,) = [row for row in HEAVY_HAUL.rows if row.number == 9]
    assert row.form is Form.OPTION
    printed = load_scenario(HEAVY_HAUL.scenario, row.settings)[0].plant.mismatch.gears["mt2_mt2"]
    shipped = load_consist("hxd1_c80_105").draft_gears["mt2_mt2"]
    assert isinstance(printed, ClipGear) and isinstance(shipped, ClipGear)
    assert printed == shipped.model_copy(update={"damping": 0.0, "transition_damping": 0.0})


RUNS = {run.key: run for run, _ in wanted()}


@pytest.mark.parametrize("table", CHOICES, ids=lambda table: table.paper)
def test_every_choice_has_a_place_and_a_sensitivity_or_a_reason(table: ChoiceTable) -> None:
    """Breaks if a choice has no place in the code, no run and no reason, or a paper has fewer than six choices."""
    assert len(table.choices) >= 6
    for choice in table.choices:
        source_line(choice.where, ROOT)
        assert bool(choice.others) != bool(choice.reason), choice.missing
        assert not choice.others or (choice.metric in left_out_page.UNITS and choice.base in table.bases), (
            choice.missing
        )


def test_a_run_of_every_choice_is_accepted_and_differs_from_its_base() -> None:
    """Breaks if a key of a scenario or of a train is renamed: the run of a choice then is refused."""
    for run in RUNS.values():
        run.setup()
    for table in CHOICES:
        for choice in table.choices:
            assert table.bases[choice.base].key not in {run.key for run in choice.others} if choice.others else True


def test_runs_of_choices_change_plant_and_model_and_are_listed(tmp_path: Path) -> None:
    """Breaks if a changed train reaches only one of the two, loses keys of the gear, or has no row unseen."""
    setup = ChoiceRun("demo", (), {"draft_gears": {"mt2_mt2": {"slack_mm": 12}}}).setup()
    for consist in (setup.consist, setup.model.consist):
        gear = consist.draft_gears["mt2_mt2"]
        assert isinstance(gear, ClipGear) and (gear.slack, gear.stroke) == (0.012, 0.166)
    (tmp_path / "msgs_docs").mkdir()
    assert len(unmeasured(tmp_path)) == len(RUNS)
    (tmp_path / "msgs_docs" / "left_out_measured.json").write_text('{"other": {}}', encoding="utf-8")
    assert unmeasured(tmp_path)[-1].startswith("choice other: no such run")


def test_a_measured_figure_is_that_of_its_run() -> None:
    table = CHOICES[4]
    (choice,) = [choice for choice in table.choices if choice.missing == "weight lambda"]  # its runs are short
    for run in (table.bases[choice.base], choice.others[0]):
        assert drive_choice(run, [choice.metric])[choice.metric] == pytest.approx(
            read_rows(ROOT / MEASURED)[run.key][choice.metric], rel=0.02
        )
