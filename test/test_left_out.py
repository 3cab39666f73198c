"""The page of the choices where the papers give nothing agrees with its data, code and measured runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from msgs_docs.generate.equations.places import source_line
from msgs_docs.generate.left_out import choice_page
from msgs_docs.generate.left_out.choice import CHOICES, Choice, ChoiceRun, ChoiceTable
from msgs_docs.generate.left_out.runs import drive_choice, read_metrics, unmeasured_choices, wanted
from plant_sim.gears import ClipGear

ROOT = Path(__file__).resolve().parents[1]
RUNS = {run.key: run for run, _ in wanted()}


def test_the_page_is_that_of_the_choices_and_their_runs() -> None:
    """Breaks if a choice changes and its runs are not driven again, or the page is older than data or code."""
    assert unmeasured_choices(ROOT) == []
    page = (ROOT / choice_page.PAGE).read_text(encoding="utf-8")
    assert page == choice_page.page(ROOT), "run python -m msgs_docs.generate"


@pytest.mark.parametrize("table", CHOICES, ids=lambda table: table.paper)
def test_every_choice_has_a_place_and_a_sensitivity_or_a_reason(table: ChoiceTable) -> None:
    """Breaks if a choice has no place in the code, no run and no reason, or a paper has fewer than six choices."""
    assert len(table.choices) >= 6
    for choice in table.choices:
        source_line(choice.where, ROOT)
        assert bool(choice.others) != bool(choice.reason), choice.missing
        assert not choice.others or (choice.metric in choice_page.UNITS and choice.base in table.bases), choice.missing


def test_a_run_of_every_choice_is_accepted_and_differs_from_its_base() -> None:
    """Breaks if a key of a scenario or of a train is renamed: the run of a choice then is refused."""
    for run in RUNS.values():
        run.setup()
    for table in CHOICES:
        for choice in table.choices:
            assert table.bases[choice.base].key not in {run.key for run in choice.others} if choice.others else True


def test_a_key_of_the_train_is_changed_in_plant_and_model() -> None:
    """Breaks if the changed train reaches only one of the two, or the other keys of the gear are lost."""
    run = ChoiceRun("demo", (), {"draft_gears": {"mt2_mt2": {"slack_mm": 12}}})
    setup = run.setup()
    for consist in (setup.consist, setup.model.consist):
        gear = consist.draft_gears["mt2_mt2"]
        assert isinstance(gear, ClipGear)
        assert (gear.slack, gear.stroke) == (0.012, 0.166)


def test_an_unmeasured_run_is_listed(tmp_path: Path) -> None:
    """Breaks if a run without figures, or figures without a run, are not found by the check of the pages."""
    (tmp_path / "msgs_docs").mkdir()
    assert len(unmeasured_choices(tmp_path)) == len(RUNS)
    (tmp_path / "msgs_docs" / "left_out_measured.json").write_text('{"other": {}}', encoding="utf-8")
    assert unmeasured_choices(tmp_path)[-1].startswith("choice other: no such run")


def test_a_measured_figure_is_that_of_its_run() -> None:
    """Breaks if a figure of the page is not the result of its run on this code."""
    table, choice = _quick()
    for run in (table.bases[choice.base], choice.others[0]):
        assert drive_choice(run, [choice.metric])[choice.metric] == pytest.approx(
            read_metrics(ROOT)[run.key][choice.metric], rel=0.02
        )


def _quick() -> tuple[ChoiceTable, Choice]:
    """Return the choice of the weight lambda of paper 004, whose runs are short."""
    table = CHOICES[4]
    (choice,) = [choice for choice in table.choices if choice.missing == "weight lambda"]
    return table, choice
