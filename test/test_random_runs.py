"""Random runs with supervision: no train is beyond its supervised location."""

from __future__ import annotations

from dataclasses import replace

import pytest

from msgs_docs.generate.random_runs import SCENARIOS, SPREAD, Draw, Figures, draws, drive_draw, summary, with_law
from train_ato.control.registry import LAWS


def test_equal_seeds_give_equal_runs_over_all_laws_and_scenarios():
    """Breaks if a run of the page cannot be repeated, or a law, a scenario or the runs without fault are left out."""
    chosen = list(draws(400, 7))
    assert chosen == list(draws(400, 7))
    assert chosen[:5] != list(draws(5, 8))
    assert {draw.law for draw in chosen} == set(LAWS.names())
    assert {draw.base for draw in chosen} == set(SCENARIOS)
    assert "" in {draw.fault for draw in chosen}


def test_a_new_law_changes_only_the_runs_that_it_takes(monkeypatch):
    """Breaks if a draw depends on the number of laws: one more law then changes the law of nearly all runs."""
    before, names = list(draws(400, 7)), LAWS.names()
    monkeypatch.setattr(LAWS, "names", lambda: [*names, "new"])
    after = list(draws(400, 7))
    assert [replace(draw, law="new", sets=with_law(draw, "new").sets) for draw in after] == [
        with_law(draw, "new") for draw in before
    ]
    changed = {new.law for old, new in zip(before, after, strict=True) if old != new}
    assert changed == {"new"}
    assert abs(sum(draw.law == "new" for draw in after) - 400 / (1 + len(names))) < 4 * (400 / len(names)) ** 0.5


def test_no_fault_replaces_the_spread():
    """Breaks if a draw sets a key of the spread twice, so that the train is weaker than the stated bound."""
    for draw in draws(200, 9):
        for key in (*SPREAD, "plant.adhesion"):
            assert sum(text.startswith(f"{key}=") for text in draw.sets) <= 1


@pytest.mark.parametrize("draw", list(draws(10, 2)), ids=lambda draw: f"{draw.base}, {draw.law}, {draw.fault}")
def test_a_random_run_stays_before_the_supervised_location(draw):
    """Breaks if a fault, a law or the spread of the train takes it beyond the supervised location."""
    _judge(draw)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(6))
def test_many_random_runs_stay_before_the_supervised_location(seed):
    """As above, with draws that are not on the page."""
    for draw in draws(10, 1000 + seed):
        _judge(draw)


def _judge(draw):
    run = drive_draw(draw)
    assert run.margin > 0.0, draw.command
    assert run.excess < 0.0, draw.command


def test_the_verdict_fails_without_supervision():
    """Breaks if the figures of a run cannot show a train beyond the supervised location."""
    name, *sets = SCENARIOS["metro"][1:3]
    frozen = "plant.sensors.freeze=[{begin: 10, end: 9999}]"
    draw = Draw(0, "metro", "pid", "frozen", name, (*sets[0], frozen, "duration=300"))
    assert drive_draw(draw).margin > 0.0
    bare = replace(draw, sets=(*draw.sets, "supervision.enabled=false"))
    assert drive_draw(bare).margin < 0.0


def test_a_run_is_driven_on_until_its_train_is_at_standstill():
    """Breaks if a margin is that of a train on its way, or a train in motion at the last end is not reported."""
    name, sets = SCENARIOS["metro"][1:3]
    whole = drive_draw(Draw(0, "metro", "pid", "", name, sets))
    early = drive_draw(Draw(0, "metro", "pid", "", name, (*sets, "duration=50")))
    assert not early.moving
    assert early.margin == whole.margin
    assert drive_draw(Draw(0, "metro", "pid", "", name, (*sets, "duration=5"))).moving


def test_the_summary_counts_and_names_bad_runs():
    """Breaks if a run beyond the supervised location is missing in the figures of the page."""
    chosen = list(draws(3, 3))
    good = Figures(margin=100.0, short=0.0, excess=-1.0, moving=False, interventions=0, failure="")
    found = summary(chosen, [good, replace(good, margin=-0.5), replace(good, excess=0.2, moving=True)])
    assert found["beyond"] == 1
    assert [row["number"] for row in found["bad"]] == [1, 2]
    assert sum(group["moving_at_end"] for group in found["scenarios"].values()) == 1
