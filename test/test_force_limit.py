"""Time at a force limit, titles of runs with changed laws, and remarks on error figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_runs import drive

from train_ato.apps.report.comparison_page import comparison_sections
from train_ato.apps.report.events import detect_events
from train_ato.apps.report.page_data import page_data
from train_ato.apps.report.print_figures import titles
from train_ato.apps.report.run_page import run_sections
from train_ato.apps.report.words import driven_laws
from train_ato.apps.report.writing import comparison_title, write_run
from train_ato.log.recorded import open_recording
from train_ato.loop.engine import run_engine
from train_ato.loop.metrics import summarise
from train_ato.loop.recording import Recording
from train_ato.loop.setup import RunSetup, prepare
from train_ato.loop.tracking import time_at_force_limit
from train_ato.messages.types import Diagnostic
from train_ato.scenario.scenario import load_scenario

SECOND = 1_000_000_000
SWAPPED = ("--set=law_changes=[{at: 10, law: smc}, {at: 20, laws: {smc: {ks: 0.5}}}]",)


def setup_of(*assignments: str) -> RunSetup:
    return prepare(*load_scenario("demo", ("links.command.delay=0.9", *assignments)))


def reported(plant: list[float], controller: list[float]) -> Recording:
    """Return a run with the counts of plant [s] and controller [steps], once a second from 0 s on."""
    reports = [Diagnostic(t * SECOND, "plant", 0, "", {"saturated": str(value)}) for t, value in enumerate(plant)]
    reports += [
        Diagnostic(t * SECOND, "controller", 0, "", {"saturated_steps": str(value)})
        for t, value in enumerate(controller)
    ]
    return Recording(kept_reports=tuple(sorted(reports, key=lambda report: report.stamp)))


def at_limit(plant: list[float], controller: list[float]) -> float:
    found = time_at_force_limit(setup_of(), reported(plant, controller))
    assert found is not None
    return float(found[1][-1])


@pytest.mark.parametrize(
    ("plant", "controller", "wanted"),
    [
        ([0, 0, 0, 0, 0], [0, 10, 20, 20, 20], 2.0),  # clipped by the law alone: the plant sees no excess
        ([0, 0, 1, 2, 2], [0, 0, 0, 0, 0], 2.0),  # limit of the train below that of the model
        ([0, 0, 1, 2, 2], [0, 10, 20, 20, 20], 2.0),  # the same demand in both counts, after delay and tick
        ([0, 1, 1, 1, 1], [0, 0, 0, 10, 10], 2.0),  # one after the other
        ([0, 0, 0, 0, 0], [0, 10, 0, 10, 10], 2.0),  # restarted controller
    ],
)
def test_a_demand_at_a_limit_counts_once_however_it_came_there(
    plant: list[float], controller: list[float], wanted: float
) -> None:
    """Breaks if a demand clipped by the law is missing, or one that both count is counted twice."""
    assert at_limit(plant, controller) == pytest.approx(wanted)


def test_the_metric_is_at_least_the_time_of_the_commands_at_the_limits_of_the_model() -> None:
    """Breaks if the summary has the count of the plant only: 0 s of a law that clips itself."""
    setup = prepare(*load_scenario("demo", ("duration=150", "law=smc", "laws.smc.gains=printed")))
    outcome = run_engine(setup)
    assert outcome.recording is not None
    velocity = outcome.recording.topics["train/measurement"]["velocity"]
    command = outcome.recording.command
    limits = [setup.model.force_limits(row) for row in velocity[: len(command)]]
    clipped = [
        bool(np.any((force != 0) & ((force <= low) | (force >= high))))
        for force, (low, high) in zip(command, limits, strict=True)
    ]
    told = setup.tick * sum(clipped)
    counted = outcome.recording.totals["saturated"]
    assert told > counted + 1.0
    last_report = 1.0  # the controller reports once a second
    assert told - last_report <= outcome.summary["saturated_s"] <= told + counted + 1e-6


def test_lost_and_late_commands_are_metrics() -> None:
    """Breaks if a lost, missed, refused, late or absent command is not in the summary."""
    values = {"commands_lost": "3", "missed ato/command": "5", "refused ato/command": "7"}
    values |= {"wall_late": "9", "wall_held": "11"}
    setup = setup_of("duration=2")
    recording = run_engine(setup).recording
    assert recording is not None
    figures = summarise(setup, replace(recording, kept_reports=(Diagnostic(0, "plant", 0, "", values),)))
    names = ("commands_lost", "commands_missed", "commands_refused", "commands_late")
    assert [figures[name] for name in names] == [3, 5 + 11, 7, 9]


@pytest.fixture(scope="module")
def swapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("swapped"), "swapped", "demo", "--set=duration=30", *SWAPPED)


def test_a_run_with_a_changed_law_says_so_in_every_title(swapped: Path, tmp_path: Path) -> None:
    """Breaks if a title names the first law only."""
    data = page_data(open_recording(swapped))
    laws = "pid → smc at 10 s, parameters changed"
    assert driven_laws(data.summary) == data.facts["law"] == laws
    assert laws in titles(data.summary)[0]
    write_run(data, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert f"<h1>demo: {laws}</h1>" in page and f"<title>demo: {laws}" in page
    assert f"swapped: {laws}" in comparison_title([data, data])
    many = [{"at_s": at, "name": "controller", "value": "smc"} for at in range(1, 9)]
    assert driven_laws({"controller": "pid", "changes": many}).endswith("→ ... (8 changes)")
    assert driven_laws({"controller": "pid"}) == "pid"


def test_error_figures_name_the_part_that_the_metrics_leave_out(tmp_path: Path) -> None:
    """Breaks if the metrics end before the stop and the figure does not say so."""
    run = drive(tmp_path, "cut", "demo", "--set=duration=20", "--set=evaluation.until_km=0.9")
    data = page_data(open_recording(run))
    note = "error metrics end at km 0.9; those of the run include the braking to the stop"
    for sections in (run_sections(data)[0], comparison_sections([data, data])[0]):
        captions = {placed.heading: placed.caption for section in sections for placed in section.placed}
        assert note in captions["Speed error"] and note in captions["Position error"]
        assert note not in captions["Extremes" if "Extremes" in captions else "Largest draft along the train"]


def test_events_at_a_force_limit_include_those_of_the_law() -> None:
    """Breaks if the list of events has only the excess that the plant counts."""
    base = reported([0, 0, 0, 0, 0], [0, 10, 20, 20, 20])
    (event,) = [found for found in detect_events(replace(base, setup=setup_of())) if found.kind == "limit"]
    assert "2.0 s" in event.text
