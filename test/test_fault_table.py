"""Every row of the fault table: the train stops before the supervised location, and the log reports the reaction."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from msgs_docs.generate.fault_page import read_figures, unmeasured_faults
from msgs_docs.generate.fault_runs import STANDSTILL, run_row
from msgs_docs.generate.fault_table import NOTHING, ROWS
from train_ato.apps.report.events import detect_events

REACTION_TIME = 1.5
"""Largest time from the detection of a fault to a demand to coast or brake [s]."""
STOPPING_ERROR = 5.0
"""Largest distance from the planned stop of a train that has reached it [m]."""
FIGURES = read_figures(Path(__file__).resolve().parents[1])
FIRST = {key: row.name for row in reversed(ROWS) if not row.slow for key in (row.kind, row.reaction)}
"""First fault of every kind and of every reaction: the quick runs."""
MARKS = {row.name: [] if row.name in FIRST.values() else [pytest.mark.campaign] for row in ROWS}


def test_the_table_has_every_kind_of_fault():
    """Breaks if a row is deleted or hides another one of its name."""
    assert len({row.name for row in ROWS}) == len(ROWS) >= 48
    kinds = {"repetition", "deletion", "insertion", "re-sequencing", "corruption", "delay", "masquerade"}
    assert kinds | {"node", "sensor", "link", "train"} <= {row.kind for row in ROWS}


def test_the_page_has_the_figures_of_every_row():
    """Breaks if a row was changed and not measured again."""
    assert unmeasured_faults(Path(__file__).resolve().parents[1]) == []


@pytest.mark.parametrize("row", [pytest.param(row, id=row.name, marks=MARKS[row.name]) for row in ROWS])
def test_the_train_is_safe_after_a_fault(row):
    """Breaks if a fault leads beyond a place or a speed, ends the run of a moving train, or is reported late."""
    run = run_row(row)
    assert run.result.failure is None or run.result.failure.endswith("; the train was stopped")
    assert run.front < run.supervised_location
    assert run.top_speed < run.largest_speed
    assert run.end_speed < STANDSTILL
    assert abs(FIGURES[row.name]["margin_m"] - (run.supervised_location - run.front)) < 1.0
    assert (abs(run.front - run.stop) < STOPPING_ERROR) == row.arrives
    assert any(re.search(row.reaction, text) for _, text in run.events), [text for _, text in run.events][-20:]
    if not row.arrives and row.reaction != NOTHING:
        assert run.detected is not None
        assert run.reacted is not None
        assert run.reacted - run.detected < REACTION_TIME + 1e-9


def test_the_report_has_the_fault_and_its_refusal():
    """Breaks if a fault of the scenario or a refused message is missing in the events of a report."""
    rows = {row.name: row for row in ROWS}

    def events_of(name):
        run = run_row(rows[name])
        return detect_events(replace(run.recording, setup=run.setup))

    events = [(event.begin, event.text) for event in events_of("command NaN")]
    assert (20.0, "corrupt ato/command: value nan, probability 1.0") in events
    assert any(text == "plant: ato/command: refused a message: force nan" for _, text in events)
    killed = [event.text for event in events_of("profile killed")]
    assert {"node profile: kill", "controller: ato/reference: no valid message"} <= set(killed)
