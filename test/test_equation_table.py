"""The table of the equations of the papers is complete and agrees with the code."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from msgs_docs.generate.equations import page as equation_page
from msgs_docs.generate.equations.check import problems
from msgs_docs.generate.equations.places import source_line
from msgs_docs.generate.equations.row import EQUATION_TABLES, EquationTable, Form
from plant_sim.gears import ClipGear
from plant_sim.library import load_consist
from train_ato.scenario.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[1]
LAST = {"000": 41, "001": 15, "002": 38, "003": 38, "004": 22}
"""Number of the last equation of each paper."""
HEAVY_HAUL = EQUATION_TABLES[0]
SMC, HXD1 = "train_ato.control.laws.smc", "plant_sim/data/consists/hxd1_c80_105.yaml"


@pytest.mark.parametrize("table", EQUATION_TABLES, ids=lambda table: table.paper)
def test_every_equation_has_one_row_that_agrees_with_the_code(table: EquationTable) -> None:
    """Breaks if an equation has no row, a function is renamed, or a setting is refused or without effect."""
    assert table.last == LAST[table.paper]
    assert problems(table, ROOT) == []


def test_the_page_is_that_of_the_tables() -> None:
    """Breaks if a row, or the line of a function, changes and the page does not."""
    page = (ROOT / equation_page.PAGE).read_text(encoding="utf-8")
    assert page == equation_page.page(ROOT), "run python -m msgs_docs.generate"


def broken(number: int, changes: dict[str, Any]) -> list[str]:
    """Return the faults of the table of paper 000 with a changed row."""
    rows = tuple(replace(row, **changes) if row.number == number else row for row in HEAVY_HAUL.rows)
    return problems(replace(HEAVY_HAUL, rows=rows), ROOT)


@pytest.mark.parametrize(
    ("number", "changes", "found"),
    [
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
        (21, {"settings": ("laws.smc.kss=0",)}, ["smc.kss: no such parameter (did you mean 'ks'?)"]),
        (21, {"settings": ("laws.smc.ks=-1",)}, ["smc.ks: -1 is outside 0 ... 100"]),
        (21, {"settings": ("laws.smc.ks=0.5",)}, ["setting 'laws.smc.ks=0.5': is the default"]),
        (21, {"settings": ("plant.lags=0",)}, ["plant.lags"]),
    ],
)  # fmt: skip
def test_the_check_finds_a_broken_row(number: int, changes: dict[str, Any], found: list[str]) -> None:
    """Breaks if the check accepts a table with this fault."""
    lines = broken(number, changes)
    assert len(lines) == len(found)
    for line, text in zip(lines, found, strict=True):
        assert text in line


def test_a_place_is_the_line_of_its_declaration() -> None:
    """Breaks if the page names another line: functions, compiled functions, methods, properties, texts."""
    for place, text in {
        "train_ato.control.laws.smc:Smc.demand": "def demand(",
        "plant_sim.kernel:_clip": "@compiled",
        "plant_sim.brake_data:Shoes.standstill_force": "@property",
        "plant_sim/data/consists/hxd1_c80_105.yaml:default_gear": "default_gear: mt2_mt2",
    }.items():
        path, line = source_line(place, ROOT)
        assert text in (ROOT / path).read_text(encoding="utf-8").splitlines()[line - 1]


def test_shoe_forces_of_paper_000_follow_from_its_table_1() -> None:
    """(13)-(15): breaks if a shoe force of the train is not that of cylinder, lever ratio and radii."""
    vehicles = load_consist("hxd1_c80_105").vehicle_types

    def cylinder(diameter: float, pressure: float, ratio: float, share: float) -> float:
        return math.pi / 4 * diameter**2 * pressure * 0.9 * ratio * share * 1e-3

    pads, shoes = vehicles["hxd1"].shoes, vehicles["c80"].shoes
    assert pads is not None and shoes is not None
    assert pads.force == pytest.approx(cylinder(225, 450, 2.4, 16 / 32) * 448 / 1250, rel=2e-3)
    assert shoes.force == pytest.approx(cylinder(254, 430, 6.6, 1 / 8), rel=2e-3)


def test_printed_gear_of_paper_000_differs_by_its_damping_only() -> None:
    """(9): breaks if the curve of the draft gear changes and that in the settings of the row does not."""
    (row,) = [row for row in HEAVY_HAUL.rows if row.number == 9]
    assert row.form is Form.OPTION
    printed = load_scenario(HEAVY_HAUL.scenario, row.settings)[0].plant.mismatch.gears["mt2_mt2"]
    shipped = load_consist("hxd1_c80_105").draft_gears["mt2_mt2"]
    assert isinstance(printed, ClipGear) and isinstance(shipped, ClipGear)
    assert printed == shipped.model_copy(update={"damping": 0.0, "transition_damping": 0.0})
